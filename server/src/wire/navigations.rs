//! Navigations, guidance, goals and routes, to and from messages.

use bytes::Bytes;
use fabmap::PlaceId;
use waypost_navigation::metric::planning::{MapPosition, Route, Travel, Waypoint};
use waypost_navigation::metric::{Driver, Guidance, Localization, Seen, VelocityCommand};
use waypost_proto::v1;
use waypost_proto::v1::goal;

use super::geometry::{odometry, planar_pose};
use super::known;
use super::status::as_message;
use crate::error::ServiceError;
use crate::service::navigation::{
    AppearanceView, BodyReport, FrameSeen, Goal, GoalRefusal, GoalRequest, NavigationView, PlannedWay,
    ReverseTravel, Told, WayByLooks,
};

pub(crate) fn navigation(view: NavigationView) -> v1::Navigation {
    let NavigationView {
        name,
        connected,
        guidance: told,
        goal,
        route: way,
        goal_refusal: refusal,
        frames,
        closures,
    } = view;
    v1::Navigation {
        name,
        connected,
        guidance: told.map(guidance),
        goal: goal.map(goal_message),
        route: way.map(route),
        goal_refusal: refusal.map(goal_refusal),
        frames,
        recognitions: closures,
    }
}

pub(crate) fn guidance(told: Told) -> v1::Guidance {
    let detail = told.detail();
    // Both say why: the detail is made of them.
    let Told { stamp_ns, guidance, appearance, waiting: _ } = told;
    let Guidance { command, status, localization, remaining_m, heading_to_target_rad, reason: _ } = guidance;
    let VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns } = command;
    v1::Guidance {
        stamp_ns,
        command: Some(v1::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns }),
        status: status_code(status).into(),
        localization: localization.map(localization_message),
        remaining_m,
        target_heading_rad: heading_to_target_rad,
        appearance: appearance.map(appearance_guidance),
        detail,
    }
}

fn appearance_guidance(view: AppearanceView) -> v1::AppearanceGuidance {
    let AppearanceView { heading_rad, subgoal, goal, similarity, left, unjoined: _ } = view;
    v1::AppearanceGuidance {
        heading_rad,
        subgoal_place_number: subgoal.map(PlaceId::number),
        goal_place_number: goal.map(PlaceId::number),
        similarity,
        remaining_cost: left,
    }
}

fn status_code(status: waypost_navigation::metric::Status) -> v1::NavigationStatus {
    use waypost_navigation::metric::Status;
    match status {
        Status::Idle => v1::NavigationStatus::Idle,
        Status::Following => v1::NavigationStatus::Following,
        Status::Searching => v1::NavigationStatus::Searching,
        Status::Lost => v1::NavigationStatus::Lost,
        Status::Arrived => v1::NavigationStatus::Arrived,
        Status::Blocked => v1::NavigationStatus::Blocked,
    }
}

fn localization_message(localization: Localization) -> v1::Localization {
    let Localization {
        node,
        at: MapPosition { part, pose },
        position_sigma_m,
        heading_sigma_rad,
        confidence,
        since_closure_ns,
        since_closure_m,
    } = localization;
    v1::Localization {
        place_number: node.number(),
        part: part.number(),
        pose: Some(planar_pose(&pose)),
        position_sigma_m,
        heading_sigma_rad,
        confidence,
        since_recognition_ns: since_closure_ns,
        since_recognition_m: since_closure_m,
    }
}

pub(crate) fn seen(frame: FrameSeen) -> v1::FrameSeen {
    use v1::frame_seen::Outcome;
    let FrameSeen { sequence, seen, place, probability } = frame;
    let outcome = match seen {
        Some(Seen::Corrected) => Outcome::Corrected,
        Some(Seen::Found) => Outcome::Found,
        Some(Seen::Unconfirmed) => Outcome::Unconfirmed,
        Some(Seen::Kidnapped) => Outcome::Kidnapped,
        Some(Seen::Stale) => Outcome::Stale,
        Some(Seen::Nothing) => Outcome::Nothing,
        None => Outcome::Skipped,
    };
    v1::FrameSeen { sequence, outcome: outcome.into(), place_number: place.map(PlaceId::number), probability }
}

fn goal_message(goal: Goal) -> v1::Goal {
    let target = match goal {
        Goal::Place(place) => goal::Target::PlaceNumber(place.number()),
        Goal::Position { part, position_m: [x_m, y_m], heading_rad } => {
            let [x_m, y_m] = [Some(x_m), Some(y_m)];
            goal::Target::Position(v1::PositionGoal { part: part.number(), x_m, y_m, heading_rad })
        }
        Goal::Label(label) => goal::Target::Label(label),
    };
    v1::Goal { target: Some(target) }
}

pub(crate) fn goal_refusal(refusal: GoalRefusal) -> v1::GoalRefusal {
    let GoalRefusal { goal, error } = refusal;
    v1::GoalRefusal { goal: goal.map(goal_message), status: Some(as_message(&error)) }
}

fn route(route: Route) -> v1::Route {
    let Route { part, waypoints, length_m } = route;
    let waypoint = |Waypoint { place, pose, travel }| v1::Waypoint {
        place_number: place.number(),
        pose: Some(planar_pose(&pose)),
        reverse: match travel {
            Travel::Along => false,
            Travel::Against => true,
        },
    };
    let waypoints = waypoints.into_iter().map(waypoint).collect();
    v1::Route { part: Some(part.number()), waypoints, length_m: Some(length_m), appearance_cost: None }
}

pub(crate) fn way(planned: PlannedWay) -> v1::Route {
    match planned {
        PlannedWay::Measured(measured) => route(measured),
        PlannedWay::ByLooks(WayByLooks { places, length }) => {
            let waypoint =
                |place: PlaceId| v1::Waypoint { place_number: place.number(), pose: None, reverse: false };
            let waypoints = places.into_iter().map(waypoint).collect();
            v1::Route { part: None, waypoints, length_m: None, appearance_cost: Some(length) }
        }
    }
}

pub(crate) fn reverse(message: i32) -> Result<ReverseTravel, ServiceError> {
    Ok(match known("reverse_travel", message)? {
        v1::ReverseTravel::Unspecified | v1::ReverseTravel::Forbidden => ReverseTravel::Forbidden,
        v1::ReverseTravel::Costly => ReverseTravel::Costly,
    })
}

pub(crate) fn goal_request(message: Option<v1::Goal>) -> Result<GoalRequest, ServiceError> {
    match message.and_then(|message| message.target) {
        Some(goal::Target::PlaceNumber(place)) => Ok(GoalRequest::Goal(Goal::Place(PlaceId::new(place)))),
        Some(goal::Target::Position(position)) => position_goal(&position).map(GoalRequest::Goal),
        Some(goal::Target::Label(label)) => Ok(GoalRequest::Goal(Goal::Label(label))),
        Some(goal::Target::Image(image)) if !image.is_empty() => Ok(GoalRequest::Image(Bytes::from(image))),
        Some(goal::Target::Image(_)) => {
            Err(ServiceError::invalid("the goal has no image; send a JPEG or PNG that was taken there"))
        }
        None => Err(ServiceError::invalid("the goal is empty; name a place, a position or a label")),
    }
}

fn position_goal(position: &v1::PositionGoal) -> Result<Goal, ServiceError> {
    let v1::PositionGoal { part, x_m, y_m, heading_rad } = *position;
    let (Some(x_m), Some(y_m)) = (x_m, y_m) else {
        return Err(ServiceError::invalid(
            "the goal's position lacks x_m or y_m; give both, in metres in the map's frame: a heading alone is no goal",
        ));
    };
    if !(x_m + y_m + heading_rad.unwrap_or(0.0)).is_finite() {
        return Err(ServiceError::invalid(
            "the goal's position or heading is not finite; give metres and radians in the map's frame",
        ));
    }
    Ok(Goal::Position { part: PlaceId::new(part), position_m: [x_m, y_m], heading_rad })
}

pub(crate) fn body_report(message: v1::WheelReport) -> Result<BodyReport, ServiceError> {
    let v1::WheelReport { stamp_ns, odometry: moved, obeyed_number, reflex } = message;
    if stamp_ns <= 0 {
        return Err(ServiceError::invalid(
            "the report has no stamp; send when the odometry was read, in nanoseconds above 0",
        ));
    }
    Ok(BodyReport {
        stamp_ns,
        odometry: moved.map(odometry).transpose()?,
        obeyed: obeyed_number,
        driver: if reflex { Driver::Reflex } else { Driver::Commands },
    })
}
