use bytes::Bytes;
use futures::stream::BoxStream;
use futures::{FutureExt, StreamExt};
use prost::Message;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use topomap::navigation::planning::{MapPosition, Route, Travel, Waypoint};
use topomap::navigation::{Driver, Guidance, Localization, Seen, VelocityCommand};
use waypost_proto::v1;
use waypost_proto::v1::navigation_service_server::NavigationService;
use waypost_proto::v1::{goal, navigate_request, navigate_response};

use super::Adapter;
use super::convert::{camera, known, odometry, planar_pose};
use super::sessions::frame;
use super::status::as_message;
use crate::error::ServiceError;
use crate::service::models::Page;
use crate::service::names::model_name;
use crate::service::navigations::{
    Against, AppearanceView, BodyReport, Driving, FrameSeen, Goal, GoalRefusal, GoalRequest, Looked,
    NavigationOpening, NavigationStream, NavigationView, PlannedWay, Told, WayByLooks,
};
use crate::service::sessions::Frame;

/// Answers that wait for a robot to read them; a robot that does not read is not led on.
const ANSWERS_AHEAD: usize = 16;

/// Frames that wait while one is looked at.
const FRAMES_AHEAD: usize = 2;

type Responses = mpsc::Sender<Result<v1::NavigateResponse, Status>>;

/// A frame, or its number and what is wrong with it.
type TakenFrame = Result<Frame, (u64, ServiceError)>;

#[tonic::async_trait]
impl NavigationService for Adapter {
    type NavigateStream = BoxStream<'static, Result<v1::NavigateResponse, Status>>;

    async fn navigate(
        &self,
        request: Request<Streaming<v1::NavigateRequest>>,
    ) -> Result<Response<Self::NavigateStream>, Status> {
        let mut requests = request.into_inner();
        let first = self.first(&mut requests).await?.and_then(|first| first.content);
        let Some(navigate_request::Content::Open(open)) = first else {
            return Err(Status::invalid_argument("the first message of a stream must open a navigation"));
        };
        let stream = self.service.open_navigation(opening(open)?).await?;
        let (responses, receiver) = mpsc::channel(ANSWERS_AHEAD);
        tokio::spawn(lead(stream, requests, responses));
        Ok(Response::new(ReceiverStream::new(receiver).boxed()))
    }

    async fn set_goal(
        &self,
        request: Request<v1::SetGoalRequest>,
    ) -> Result<Response<v1::SetGoalResponse>, Status> {
        let v1::SetGoalRequest { name, goal, image_goal } = request.into_inner();
        let goal = match (goal, image_goal) {
            (None, Some(image)) => self::image_goal(image)?,
            (goal, None) => GoalRequest::Goal(needed(goal)?),
            (Some(_), Some(_)) => {
                return Err(ServiceError::invalid("send a goal or an image, not both").into());
            }
        };
        let view = self.service.set_goal(&name, goal).await?;
        Ok(Response::new(v1::SetGoalResponse { navigation: Some(navigation(view)) }))
    }

    async fn cancel_goal(
        &self,
        request: Request<v1::CancelGoalRequest>,
    ) -> Result<Response<v1::CancelGoalResponse>, Status> {
        let v1::CancelGoalRequest { name } = request.into_inner();
        let view = self.service.cancel_goal(&name).await?;
        Ok(Response::new(v1::CancelGoalResponse { navigation: Some(navigation(view)) }))
    }

    async fn get_navigation(
        &self,
        request: Request<v1::GetNavigationRequest>,
    ) -> Result<Response<v1::Navigation>, Status> {
        let v1::GetNavigationRequest { name } = request.into_inner();
        Ok(Response::new(navigation(self.service.navigation(&name).await?)))
    }

    async fn list_navigations(
        &self,
        request: Request<v1::ListNavigationsRequest>,
    ) -> Result<Response<v1::ListNavigationsResponse>, Status> {
        let v1::ListNavigationsRequest { map, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_navigations(&map, page_size, &page_token).await?;
        let navigations = items.into_iter().map(navigation).collect();
        Ok(Response::new(v1::ListNavigationsResponse { navigations, next_page_token: next }))
    }

    async fn plan_route(
        &self,
        request: Request<v1::PlanRouteRequest>,
    ) -> Result<Response<v1::PlanRouteResponse>, Status> {
        let v1::PlanRouteRequest { map, from_place, goal, against_the_way } = request.into_inner();
        let against = against(against_the_way)?;
        let planned = self.service.plan_route(&map, from_place, needed(goal)?, against).await?;
        Ok(Response::new(v1::PlanRouteResponse { route: Some(way(planned)) }))
    }
}

/// Serves a robot until either side ends. Odometry is answered at once, whatever a frame is waiting for.
async fn lead(stream: NavigationStream, mut requests: Streaming<v1::NavigateRequest>, responses: Responses) {
    let (resumed, last_sequence) = stream.resumed();
    let opened = v1::NavigationOpened {
        navigation: stream.name(),
        model: model_name(stream.model_hash()),
        words_hash: stream.words_hash().to_owned(),
        resumed,
        last_sequence,
    };
    if responses.send(respond(navigate_response::Content::Opened(opened))).await.is_err() {
        return;
    }
    let (frames, looking) = mpsc::channel(FRAMES_AHEAD);
    let looks = tokio::spawn(look(stream.clone(), looking, responses.clone()));
    let mut refusals = stream.refusals();
    let mut over = Box::pin(stream.over().fuse());
    loop {
        let response = tokio::select! {
            error = &mut over => Some(Err(error.into())),
            Ok(()) = refusals.changed() => {
                let refusal = refusals.borrow_and_update().clone();
                refusal.map(|refusal| respond(navigate_response::Content::GoalRefusal(goal_refusal(refusal))))
            }
            request = requests.message() => match request {
                Ok(Some(request)) => answer(&stream, request, &frames),
                Ok(None) => break,
                Err(status) => Some(Err(status)),
            },
        };
        let ends = matches!(response, Some(Err(_)));
        if let Some(response) = response
            && responses.send(response).await.is_err()
        {
            break;
        }
        if ends {
            break;
        }
    }
    // Frames that wait are looked at no more; the robot stops when its last command lapses.
    looks.abort();
}

/// What is said to a message at once, if anything is.
fn answer(
    stream: &NavigationStream,
    request: v1::NavigateRequest,
    frames: &mpsc::Sender<TakenFrame>,
) -> Option<Result<v1::NavigateResponse, Status>> {
    let content = match request.content {
        Some(navigate_request::Content::Wheels(message)) => {
            let stamp_ns = message.stamp_ns;
            match body_report(message).and_then(|report| stream.report(report)) {
                Ok(told) => navigate_response::Content::Guidance(guidance(told)),
                Err(error) => navigate_response::Content::WheelRefusal(v1::WheelRefusal {
                    stamp_ns,
                    status: Some(as_message(&error)),
                }),
            }
        }
        Some(navigate_request::Content::Frame(message)) => {
            let sequence = message.sequence;
            match frames.try_send(frame(message)) {
                Ok(()) => return None,
                Err(_) => navigate_response::Content::Seen(seen(FrameSeen {
                    sequence,
                    seen: None,
                    place: None,
                    probability: None,
                })),
            }
        }
        Some(navigate_request::Content::Goal(message)) => match needed(Some(message)) {
            Ok(goal) => {
                stream.go_to(GoalRequest::Goal(goal));
                return None;
            }
            Err(error) => return Some(Err(error.into())),
        },
        Some(navigate_request::Content::ImageGoal(message)) => match image_goal(message) {
            Ok(goal) => {
                stream.go_to(goal);
                return None;
            }
            Err(error) => return Some(Err(error.into())),
        },
        Some(navigate_request::Content::Stop(v1::StopNavigation {})) => {
            stream.stop();
            return None;
        }
        Some(navigate_request::Content::Open(_)) | None => {
            return Some(Err(Status::invalid_argument(
                "after the first message of a stream, each must be a wheel report, a frame, a goal or a stop",
            )));
        }
    };
    Some(respond(content))
}

/// Looks at frames, one after the other.
async fn look(stream: NavigationStream, mut frames: mpsc::Receiver<TakenFrame>, responses: Responses) {
    while let Some(frame) = frames.recv().await {
        let looked = match frame {
            Ok(frame) => {
                let sequence = frame.sequence;
                stream.look(frame).await.map_err(|error| (sequence, error))
            }
            Err(refused) => Err(refused),
        };
        let contents = match looked {
            Ok(Looked { seen: what, told }) => {
                let told = told.map(|told| navigate_response::Content::Guidance(guidance(told)));
                [Some(navigate_response::Content::Seen(seen(what))), told]
            }
            Err((sequence, error)) => {
                let refusal = navigate_response::Content::Refusal(v1::FrameRefusal {
                    sequence,
                    last_committed_sequence: None,
                    status: Some(as_message(&error)),
                });
                [Some(refusal), None]
            }
        };
        for content in contents.into_iter().flatten() {
            if responses.send(respond(content)).await.is_err() {
                return;
            }
        }
    }
}

fn respond(content: navigate_response::Content) -> Result<v1::NavigateResponse, Status> {
    Ok(v1::NavigateResponse { content: Some(content) })
}

fn opening(message: v1::OpenNavigation) -> Result<NavigationOpening, ServiceError> {
    let v1::OpenNavigation { map, navigation_id, run_id, camera: declared, words_hash, goal, driving } =
        message;
    let encoded = declared.as_ref().map(Message::encode_to_vec);
    declared.map(camera).transpose()?;
    let v1::DrivingSettings { speed_m_s, max_turn_rad_s, against_the_way } = driving.unwrap_or_default();
    Ok(NavigationOpening {
        map,
        navigation: navigation_id,
        run: run_id,
        camera: encoded,
        words_hash,
        goal: goal.map(|goal| needed(Some(goal))).transpose()?,
        driving: Driving { speed_m_s, max_turn_rad_s, against: against(against_the_way)? },
    })
}

fn against(message: i32) -> Result<Against, ServiceError> {
    Ok(match known("against_the_way", message)? {
        v1::AgainstTheWay::Unspecified | v1::AgainstTheWay::Forbidden => Against::Forbidden,
        v1::AgainstTheWay::Costly => Against::Costly,
    })
}

fn needed(message: Option<v1::Goal>) -> Result<Goal, ServiceError> {
    match message.and_then(|message| message.target) {
        Some(goal::Target::Place(place)) => Ok(Goal::Place(place)),
        Some(goal::Target::Position(v1::PositionGoal { part, x_m, y_m, heading_rad }))
            if (x_m + y_m + heading_rad.unwrap_or(0.0)).is_finite() =>
        {
            Ok(Goal::Position { part, position_m: [x_m, y_m], heading_rad })
        }
        Some(goal::Target::Label(label)) => Ok(Goal::Label(label)),
        Some(goal::Target::Position(_)) => Err(ServiceError::invalid(
            "the goal's position or heading is not finite; give metres and radians in the map's frame",
        )),
        None => Err(ServiceError::invalid("the goal is empty; name a place, a position or a label")),
    }
}

fn image_goal(message: v1::ImageGoal) -> Result<GoalRequest, ServiceError> {
    let v1::ImageGoal { image } = message;
    if image.is_empty() {
        return Err(ServiceError::invalid("the goal has no image; send a JPEG or PNG that was taken there"));
    }
    Ok(GoalRequest::Image(Bytes::from(image)))
}

fn body_report(message: v1::WheelReport) -> Result<BodyReport, ServiceError> {
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

fn guidance(told: Told) -> v1::Guidance {
    let detail = told.detail();
    let Told { stamp_ns, guidance, appearance } = told;
    let Guidance { command, status, localization, left_m, heading_to_target_rad } = guidance;
    let VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns } = command;
    v1::Guidance {
        stamp_ns,
        command: Some(v1::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns }),
        status: status_code(status).into(),
        localization: localization.map(localization_message),
        left_m,
        target_heading_rad: heading_to_target_rad,
        appearance: appearance.map(appearance_guidance),
        detail,
    }
}

fn appearance_guidance(view: AppearanceView) -> v1::AppearanceGuidance {
    let AppearanceView { heading_rad, subgoal, goal, similarity, left, unjoined: _ } = view;
    v1::AppearanceGuidance { heading_rad, subgoal_place: subgoal, goal_place: goal, similarity, left }
}

fn status_code(status: topomap::navigation::Status) -> v1::NavigationStatus {
    use topomap::navigation::Status;
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
        place: node,
        part,
        pose: Some(planar_pose(&pose)),
        position_sigma_m,
        heading_sigma_rad,
        confidence,
        since_closure_ns,
        since_closure_m,
    }
}

fn seen(frame: FrameSeen) -> v1::FrameSeen {
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
    v1::FrameSeen { sequence, outcome: outcome.into(), place, probability }
}

fn goal_message(goal: Goal) -> v1::Goal {
    let target = match goal {
        Goal::Place(place) => goal::Target::Place(place),
        Goal::Position { part, position_m: [x_m, y_m], heading_rad } => {
            goal::Target::Position(v1::PositionGoal { part, x_m, y_m, heading_rad })
        }
        Goal::Label(label) => goal::Target::Label(label),
    };
    v1::Goal { target: Some(target) }
}

fn goal_refusal(refusal: GoalRefusal) -> v1::GoalRefusal {
    let GoalRefusal { goal, message } = refusal;
    v1::GoalRefusal { goal: goal.map(goal_message), message }
}

fn navigation(view: NavigationView) -> v1::Navigation {
    let NavigationView { name, connected, guidance: told, goal, route: way, goal_refusal, frames, closures } =
        view;
    v1::Navigation {
        name,
        connected,
        guidance: told.map(guidance),
        goal: goal.map(goal_message),
        route: way.map(route),
        goal_refusal: goal_refusal.map_or_else(String::new, |GoalRefusal { goal: _, message }| message),
        frames,
        closures,
    }
}

fn route(route: Route) -> v1::Route {
    let Route { part, waypoints, length_m } = route;
    let waypoint = |Waypoint { place, pose, travel }| v1::Waypoint {
        place,
        pose: Some(planar_pose(&pose)),
        against: match travel {
            Travel::Along => false,
            Travel::Against => true,
        },
    };
    let waypoints = waypoints.into_iter().map(waypoint).collect();
    v1::Route { part, waypoints, length_m, appearance_length: None }
}

fn way(planned: PlannedWay) -> v1::Route {
    match planned {
        PlannedWay::Measured(measured) => route(measured),
        PlannedWay::ByLooks(WayByLooks { places, length }) => {
            let waypoint = |place| v1::Waypoint { place, pose: None, against: false };
            let waypoints = places.into_iter().map(waypoint).collect();
            v1::Route { part: 0, waypoints, length_m: 0.0, appearance_length: Some(length) }
        }
    }
}
