//! Robots that are led: seen, sent and stopped. They themselves are led over gRPC.

use std::fmt::Display;
use std::sync::Arc;

use axum::Extension;
use axum::Json;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use fabmap::PlaceId;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};
use waypost_proto::v1;

use super::HttpError;
use super::bodies::WholeBody;
use super::description::{BodyRefusals, Refusals};
use super::frames::ImageFile;
use super::parameters::{InPath, InQuery, MapPath, NavigationPath, Nothing, Paging, Parameters};
use crate::error::ServiceError;
use crate::names::{map_name, navigation_name};
use crate::pages::Page;
use crate::service::Service;
use crate::service::navigation::{self, Goal, GoalRequest};
use crate::service::tokens::Caller;
use crate::wire::navigations::{goal_request, navigation as message, way};

/// The robots that are led along a map, by name. One whose stream is gone is forgotten after a minute.
#[utoipa::path(get, path = "/v1/maps/{map}/navigations", tag = "navigations", params(MapPath, Paging),
    responses((status = 200, description = "A page of navigations.", body = v1::ListNavigationsResponse), Refusals))]
pub(super) async fn list_navigations(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Paging { page_size, page_token }): InQuery<Paging>,
) -> Result<Json<v1::ListNavigationsResponse>, HttpError> {
    let Page { items, next } = service.navigation.list(&map_name(&map), page_size, &page_token).await?;
    let navigations = items.into_iter().map(message).collect();
    Ok(Json(v1::ListNavigationsResponse { navigations, next_page_token: next }))
}

/// A robot that is led, or was a moment ago.
#[utoipa::path(get, path = "/v1/maps/{map}/navigations/{navigation}", tag = "navigations", params(NavigationPath),
    responses((status = 200, description = "The navigation.", body = v1::Navigation), Refusals))]
pub(super) async fn get_navigation(
    State(service): State<Arc<Service>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Navigation>, HttpError> {
    Ok(Json(message(service.navigation.get(&navigation_name(&map, &navigation)).await?)))
}

/// Sends the robot to a goal, in place of where it was going.
#[utoipa::path(put, path = "/v1/maps/{map}/navigations/{navigation}/goal", tag = "navigations", params(NavigationPath),
    request_body(content((GoalBody = "application/json"), (ImageFile = "image/jpeg"), (ImageFile = "image/png")),
        description = "A place, the place nearest to a position, or a label. By appearance also a panorama: the robot goes \
                       to where it was taken."),
    responses((status = 200, description = "The navigation.", body = v1::Navigation), Refusals, BodyRefusals))]
pub(super) async fn set_goal(
    State(service): State<Arc<Service>>,
    Extension(caller): Extension<Arc<Caller>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
    headers: HeaderMap,
    WholeBody(body): WholeBody,
) -> Result<Json<v1::Navigation>, HttpError> {
    let goal = wanted(&headers, body)?;
    let view = service.navigation.set_goal(&caller, &navigation_name(&map, &navigation), goal).await?;
    Ok(Json(message(view)))
}

/// What a body asks for.
fn wanted(headers: &HeaderMap, body: Bytes) -> Result<GoalRequest, ServiceError> {
    let unfit = |why: &dyn Display| {
        ServiceError::invalid(format_args!(
            "{why}; send {{\"place_number\": NUMBER}}, {{\"position\": {{\"x_m\": X, \"y_m\": Y}}}} or \
             {{\"label\": \"kitchen\"}} as application/json, or a panorama as image/jpeg or image/png"
        ))
    };
    let declared = headers.get(CONTENT_TYPE).map_or("", |declared| declared.to_str().unwrap_or("not text"));
    match declared.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "image/jpeg" | "image/png" => Ok(GoalRequest::Image(body)),
        "application/json" => {
            let goal: GoalBody = serde_json::from_slice(&body).map_err(|error| unfit(&error))?;
            goal_request(Some(goal.message()?))
        }
        _ => Err(unfit(&format_args!("the body is declared as {declared:?}, which no goal is"))),
    }
}

/// Takes the robot's goal away: it stops.
#[utoipa::path(delete, path = "/v1/maps/{map}/navigations/{navigation}/goal", tag = "navigations",
    params(NavigationPath), responses((status = 200, description = "The navigation.", body = v1::Navigation), Refusals))]
pub(super) async fn cancel_goal(
    State(service): State<Arc<Service>>,
    InPath(NavigationPath { map, navigation }): InPath<NavigationPath>,
    InQuery(Nothing {}): InQuery<Nothing>,
) -> Result<Json<v1::Navigation>, HttpError> {
    Ok(Json(message(service.navigation.cancel_goal(&navigation_name(&map, &navigation)).await?)))
}

#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct Ends {
    /// Place to start from.
    #[param(example = 0)]
    from_place_number: u32,
    /// Place to go to.
    #[param(example = 1)]
    to_place_number: u32,
    /// Whether ways may be driven in the direction opposite to the one in which they were taught; then they count four
    /// times their length.
    #[param(inline)]
    #[serde(default)]
    reverse_travel: ReverseTravel,
}

/// Whether ways may be driven in the direction opposite to the one in which they were taught.
#[derive(Clone, Copy, Debug, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum ReverseTravel {
    #[default]
    Forbidden,
    Costly,
}

impl Parameters for Ends {
    const TAKES: &str =
        "from_place_number=NUMBER, to_place_number=NUMBER and reverse_travel=forbidden or costly";
}

/// Which way a robot would take from one place to another. By appearance it has neither poses nor metres.
#[utoipa::path(get, path = "/v1/maps/{map}/route", tag = "navigations", params(MapPath, Ends),
    responses((status = 200, description = "The way.", body = v1::Route), Refusals))]
pub(super) async fn plan_route(
    State(service): State<Arc<Service>>,
    InPath(MapPath { map }): InPath<MapPath>,
    InQuery(Ends { from_place_number, to_place_number, reverse_travel }): InQuery<Ends>,
) -> Result<Json<v1::Route>, HttpError> {
    let reverse = match reverse_travel {
        ReverseTravel::Forbidden => navigation::ReverseTravel::Forbidden,
        ReverseTravel::Costly => navigation::ReverseTravel::Costly,
    };
    let goal = Goal::Place(PlaceId::new(to_place_number));
    let planned = service.navigation.plan_route(&map_name(&map), from_place_number, goal, reverse).await?;
    Ok(Json(way(planned)))
}

/// Where to go. Either a place, a position or a label.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = GoalRequest, example = json!({"place_number": 17}))]
pub(super) struct GoalBody {
    #[serde(default)]
    place_number: Option<u32>,
    #[serde(default)]
    position: Option<PositionBody>,
    /// A place with this label. By appearance several places may have it: the robot goes to the nearest along the graph, or
    /// rather to the middle of the labelled places that links connect with it. Otherwise only one place may have it.
    #[serde(default)]
    label: Option<String>,
}

/// A position on the map.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PositionRequest)]
struct PositionBody {
    /// The part of the map whose frame it is in: usually 0, which it is if left out.
    #[serde(default)]
    part: u32,
    x_m: f64,
    y_m: f64,
    /// The robot's heading at the goal, in the same frame; any if left out.
    #[serde(default)]
    heading_rad: Option<f64>,
}

impl GoalBody {
    fn message(self) -> Result<v1::Goal, ServiceError> {
        use v1::goal::Target;
        let Self { place_number, position, label } = self;
        let position = position.map(|PositionBody { part, x_m, y_m, heading_rad }| {
            Target::Position(v1::PositionGoal { part, x_m: Some(x_m), y_m: Some(y_m), heading_rad })
        });
        let named = [place_number.map(Target::PlaceNumber), position, label.map(Target::Label)];
        let mut named = named.into_iter().flatten();
        let target = named.next();
        if named.next().is_some() {
            return Err(ServiceError::invalid("send a place, a position or a label, and one of them alone"));
        }
        Ok(v1::Goal { target })
    }
}
