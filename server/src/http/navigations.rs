//! Robots that are led: seen, sent and stopped. They themselves are led over gRPC.

use std::fmt::Display;
use std::sync::Arc;

use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::extract::rejection::BytesRejection;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use serde::{Deserialize, Serialize};
use topomap::navigation::planning::{self, Travel};
use topomap::navigation::{self as leading};
use utoipa::{IntoParams, ToSchema};

use super::HttpError;
use super::description::Refusals;
use super::frames::ImageFile;
use super::geometry::Pose;
use super::parameters::{InPath, InQuery, MapPath, NavigationPath, Nothing, Paging, Parameters};
use crate::error::ServiceError;
use crate::service::Service;
use crate::service::models::Page;
use crate::service::names::{map_name, navigation_name};
use crate::service::navigations::{
    Against, AppearanceView, Goal as Wanted, GoalRefusal, GoalRequest, NavigationView, PlannedWay, Told,
    WayByLooks,
};

/// The robots that are led along a map, by name. One whose stream is gone is forgotten after a minute.
#[utoipa::path(get, path = "/v1/maps/{map}/navigations", tag = "navigations", params(MapPath, Paging),
    responses((status = 200, description = "A page of navigations.", body = NavigationList), Refusals))]
pub(super) async fn list_navigations(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<NavigationList>, HttpError> {
    let Page { items, next } = service.list_navigations(&map_name(&map), page_size, &page_token).await?;
    let navigations = items.into_iter().map(Navigation::from).collect();
    Ok(Json(NavigationList { navigations, next_page_token: next }))
}

/// A robot that is led, or was a moment ago.
#[utoipa::path(get, path = "/v1/maps/{map}/navigations/{navigation}", tag = "navigations", params(NavigationPath),
    responses((status = 200, description = "The navigation.", body = Navigation), Refusals))]
pub(super) async fn get_navigation(
    State(service): State<Arc<Service>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Navigation>, HttpError> {
    Ok(Json(service.navigation(&navigation_name(&map, &navigation)).await?.into()))
}

/// Sends the robot to a goal, in place of where it was going.
#[utoipa::path(put, path = "/v1/maps/{map}/navigations/{navigation}/goal", tag = "navigations", params(NavigationPath),
    request_body(content((Goal = "application/json"), (ImageFile = "image/jpeg"), (ImageFile = "image/png")),
        description = "A place, the place nearest to a position, or a label. By appearance also a panorama: the robot goes \
                       to where it was taken."),
    responses((status = 200, description = "The navigation.", body = Navigation), Refusals))]
pub(super) async fn set_goal(
    State(service): State<Arc<Service>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Json<Navigation>, HttpError> {
    let goal = wanted(&headers, body)?;
    let view = service.set_goal(&navigation_name(&map, &navigation), goal).await?;
    Ok(Json(view.into()))
}

/// What a body asks for.
fn wanted(headers: &HeaderMap, body: Result<Bytes, BytesRejection>) -> Result<GoalRequest, ServiceError> {
    let unfit = |why: &dyn Display| {
        ServiceError::invalid(format_args!(
            "{why}; send {{\"place\": NUMBER}}, {{\"position\": {{\"part\": 0, \"x_m\": X, \"y_m\": Y}}}} or \
             {{\"label\": \"kitchen\"}} as application/json, or a panorama as image/jpeg or image/png"
        ))
    };
    let body = body.map_err(|rejection| unfit(&rejection.body_text()))?;
    let declared = headers.get(CONTENT_TYPE).map_or("", |declared| declared.to_str().unwrap_or("not text"));
    match declared.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "image/jpeg" | "image/png" => Ok(GoalRequest::Image(body)),
        "application/json" => {
            let goal: Goal = serde_json::from_slice(&body).map_err(|error| unfit(&error))?;
            Ok(GoalRequest::Goal(goal.try_into()?))
        }
        _ => Err(unfit(&format_args!("the body is declared as {declared:?}, which no goal is"))),
    }
}

/// Takes the robot's goal away: it stops.
#[utoipa::path(delete, path = "/v1/maps/{map}/navigations/{navigation}/goal", tag = "navigations",
    params(NavigationPath), responses((status = 200, description = "The navigation.", body = Navigation), Refusals))]
pub(super) async fn cancel_goal(
    State(service): State<Arc<Service>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<Navigation>, HttpError> {
    Ok(Json(service.cancel_goal(&navigation_name(&map, &navigation)).await?.into()))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Ends {
    /// Place to start from.
    #[param(example = 0)]
    from: u32,
    /// Place to go to.
    #[param(example = 1)]
    to: u32,
    /// Whether ways may be driven the other way round than they were taught, at four times their length.
    #[param(inline)]
    #[serde(default)]
    against_the_way: AgainstTheWay,
}

/// Whether ways may be driven the other way round than they were taught, at four times their length.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum AgainstTheWay {
    #[default]
    Forbidden,
    Costly,
}

impl Parameters for Ends {
    const TAKES: &str = "from=PLACE, to=PLACE and against_the_way=forbidden or costly";
}

/// Which way a robot would take from one place to another. By appearance it has neither poses nor metres.
#[utoipa::path(get, path = "/v1/maps/{map}/route", tag = "navigations", params(MapPath, Ends),
    responses((status = 200, description = "The way.", body = Route), Refusals))]
pub(super) async fn plan_route(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Ends { from, to, against_the_way }): InQuery<Ends>,
) -> Result<Json<Route>, HttpError> {
    let against = match against_the_way {
        AgainstTheWay::Forbidden => Against::Forbidden,
        AgainstTheWay::Costly => Against::Costly,
    };
    let goal = Wanted::Place(to);
    Ok(Json(service.plan_route(&map_name(&map), from, goal, against).await?.into()))
}

/// A page of navigations.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct NavigationList {
    navigations: Vec<Navigation>,
    /// Asks for the next page; empty on the last.
    next_page_token: String,
}

/// A robot that is led.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Navigation {
    /// `maps/{map}/navigations/{navigation}`
    #[schema(example = "maps/demo/navigations/robot-7")]
    name: String,
    /// Whether the robot has a stream open.
    connected: bool,
    /// What it was told last; null before its first wheel report since it has its goal.
    #[schema(required)]
    guidance: Option<Guidance>,
    #[schema(required)]
    goal: Option<Goal>,
    /// The way that it is on; null where there is none.
    #[schema(required)]
    route: Option<Route>,
    /// Why it was not led to its last goal; empty if it was.
    goal_refusal: String,
    /// Frames that were looked at, and those of them that recognised a place.
    frames: u64,
    closures: u64,
}

/// What a robot is to do, and how it goes.
#[derive(Debug, Serialize, ToSchema)]
struct Guidance {
    /// Of the wheel report that it answers, by the robot's clock.
    stamp_ns: i64,
    command: VelocityCommand,
    status: Status,
    /// Null while it is not known where the robot is.
    #[schema(required)]
    localization: Option<Localization>,
    /// What is left of the way, in metres.
    #[schema(required)]
    left_m: Option<f64>,
    /// Where to the robot is to look, in the map's frame.
    #[schema(required)]
    target_heading_rad: Option<f64>,
    /// By appearance; null before the robot has a goal and has seen something.
    #[schema(required)]
    appearance: Option<AppearanceGuidance>,
    /// Why it goes so, and how to mend it; empty where there is nothing to say.
    detail: String,
}

/// Where to drive by what a panorama shows.
#[derive(Debug, Serialize, ToSchema)]
struct AppearanceGuidance {
    /// From straight ahead to the left; null where nothing has shown it, and at the goal.
    #[schema(required)]
    heading_rad: Option<f64>,
    /// The place that the robot steers to.
    #[schema(required)]
    subgoal_place: Option<u32>,
    /// The place that it goes to.
    #[schema(required)]
    goal_place: Option<u32>,
    /// What the panorama and the subgoal's image have in common.
    #[schema(required, minimum = 0, maximum = 1)]
    similarity: Option<f64>,
    /// Sum of 1 / similarity along the path from the subgoal to the goal.
    #[schema(required)]
    left: Option<f64>,
}

/// How fast to drive.
#[derive(Debug, Serialize, ToSchema)]
struct VelocityCommand {
    number: u64,
    forward_m_s: f64,
    /// To the left.
    turn_rad_s: f64,
    /// From when it arrives at the robot.
    valid_ns: i64,
}

/// How it goes: `searching` means by wheels alone for a while, or by appearance that it recovers and keeps its heading;
/// `blocked` that it is to move and does not, or by appearance that no links lead to its goal: then `detail` says so.
#[derive(Debug, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum Status {
    Idle,
    Following,
    Searching,
    Lost,
    Arrived,
    Blocked,
}

/// Where a robot is on the map.
#[derive(Debug, Serialize, ToSchema)]
struct Localization {
    /// The place that was recognised last.
    place: u32,
    /// The part of the map whose frame the pose is in.
    part: u32,
    /// Of `base_link`.
    pose: Pose,
    position_sigma_m: f64,
    heading_sigma_rad: f64,
    /// From 0 to 1: 0 where the robot would be given up for lost.
    confidence: f64,
    /// Since something was recognised, by the robot's clock and wheels.
    since_closure_ns: i64,
    since_closure_m: f64,
}

/// Where to go. Either a place, a position or a label.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"place": 17}))]
pub(super) struct Goal {
    #[serde(default)]
    place: Option<u32>,
    #[serde(default)]
    position: Option<Position>,
    /// What somebody has called a place, or several. By appearance, the robot goes to the nearest by the shortest path, or
    /// rather to the middle of those that links join with that one; else one place alone may have it.
    #[serde(default)]
    label: Option<String>,
}

/// A position on the map.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
struct Position {
    /// The part of the map whose frame it is in: 0 as a rule.
    part: u32,
    x_m: f64,
    y_m: f64,
    /// Where to the robot is to look once it is there, in the same frame; null for any way.
    #[serde(default)]
    heading_rad: Option<f64>,
}

/// A way over places.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Route {
    /// The part of the map that it runs in; 0 by appearance.
    part: u32,
    waypoints: Vec<Waypoint>,
    /// 0 by appearance.
    length_m: f64,
    /// By appearance: the sum of 1 / similarity from waypoint to waypoint.
    #[schema(required)]
    appearance_length: Option<f64>,
}

/// A place on a way.
#[derive(Debug, Serialize, ToSchema)]
struct Waypoint {
    place: u32,
    /// Where it is, and how the robot that learnt it stood there; null by appearance.
    #[schema(required)]
    pose: Option<Pose>,
    /// Whether it is come to the other way round than it was taught.
    against: bool,
}

impl From<NavigationView> for Navigation {
    fn from(view: NavigationView) -> Self {
        let NavigationView { name, connected, guidance, goal, route, goal_refusal, frames, closures } = view;
        Self {
            name,
            connected,
            guidance: guidance.map(Guidance::from),
            goal: goal.map(Goal::from),
            route: route.map(Route::from),
            goal_refusal: goal_refusal.map_or_else(String::new, |GoalRefusal { goal: _, message }| message),
            frames,
            closures,
        }
    }
}

impl From<Told> for Guidance {
    fn from(told: Told) -> Self {
        let detail = told.detail();
        let Told { stamp_ns, guidance, appearance } = told;
        let leading::Guidance { command, status, localization, left_m, heading_to_target_rad } = guidance;
        let leading::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns } = command;
        Self {
            stamp_ns,
            command: VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns },
            status: status.into(),
            localization: localization.map(Localization::from),
            left_m,
            target_heading_rad: heading_to_target_rad,
            appearance: appearance.map(AppearanceGuidance::from),
            detail,
        }
    }
}

impl From<AppearanceView> for AppearanceGuidance {
    fn from(view: AppearanceView) -> Self {
        let AppearanceView { heading_rad, subgoal, goal, similarity, left, unjoined: _ } = view;
        Self { heading_rad, subgoal_place: subgoal, goal_place: goal, similarity, left }
    }
}

impl From<leading::Status> for Status {
    fn from(status: leading::Status) -> Self {
        match status {
            leading::Status::Idle => Self::Idle,
            leading::Status::Following => Self::Following,
            leading::Status::Searching => Self::Searching,
            leading::Status::Lost => Self::Lost,
            leading::Status::Arrived => Self::Arrived,
            leading::Status::Blocked => Self::Blocked,
        }
    }
}

impl From<leading::Localization> for Localization {
    fn from(localization: leading::Localization) -> Self {
        let leading::Localization {
            node,
            at: planning::MapPosition { part, pose },
            position_sigma_m,
            heading_sigma_rad,
            confidence,
            since_closure_ns,
            since_closure_m,
        } = localization;
        Self {
            place: node,
            part,
            pose: pose.on_the_ground().into(),
            position_sigma_m,
            heading_sigma_rad,
            confidence,
            since_closure_ns,
            since_closure_m,
        }
    }
}

impl From<Wanted> for Goal {
    fn from(goal: Wanted) -> Self {
        let empty = Self { place: None, position: None, label: None };
        match goal {
            Wanted::Place(place) => Self { place: Some(place), ..empty },
            Wanted::Position { part, position_m: [x_m, y_m], heading_rad } => {
                Self { position: Some(Position { part, x_m, y_m, heading_rad }), ..empty }
            }
            Wanted::Label(label) => Self { label: Some(label), ..empty },
        }
    }
}

impl TryFrom<Goal> for Wanted {
    type Error = ServiceError;

    fn try_from(goal: Goal) -> Result<Self, ServiceError> {
        let Goal { place, position, label } = goal;
        let position = position.map(|Position { part, x_m, y_m, heading_rad }| Self::Position {
            part,
            position_m: [x_m, y_m],
            heading_rad,
        });
        let mut named = [place.map(Self::Place), position, label.map(Self::Label)].into_iter().flatten();
        match (named.next(), named.next()) {
            (Some(goal), None) => Ok(goal),
            (None, _) => Err(ServiceError::invalid("the goal is empty; name a place, a position or a label")),
            (Some(_), Some(_)) => {
                Err(ServiceError::invalid("send a place, a position or a label, and one of them alone"))
            }
        }
    }
}

impl From<planning::Route> for Route {
    fn from(route: planning::Route) -> Self {
        let planning::Route { part, waypoints, length_m } = route;
        let waypoint = |planning::Waypoint { place, pose, travel }| Waypoint {
            place,
            pose: Some(pose.on_the_ground().into()),
            against: match travel {
                Travel::Along => false,
                Travel::Against => true,
            },
        };
        let waypoints = waypoints.into_iter().map(waypoint).collect();
        Self { part, waypoints, length_m, appearance_length: None }
    }
}

impl From<PlannedWay> for Route {
    fn from(planned: PlannedWay) -> Self {
        match planned {
            PlannedWay::Measured(route) => route.into(),
            PlannedWay::ByLooks(WayByLooks { places, length }) => {
                let waypoint = |place| Waypoint { place, pose: None, against: false };
                let waypoints = places.into_iter().map(waypoint).collect();
                Self { part: 0, waypoints, length_m: 0.0, appearance_length: Some(length) }
            }
        }
    }
}
