use futures::stream::BoxStream;
use futures::{FutureExt, StreamExt};
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::navigation_service_server::NavigationService;
use waypost_proto::v1::{navigate_request, navigate_response};

use super::Adapter;
use super::reach::{with_caller, within, within_by};
use crate::error::ServiceError;
use crate::names::model_name;
use crate::pages::Page;
use crate::service::navigation::{
    Driving, FrameSeen, GoalRequest, Looked, NavigationOpening, NavigationStream,
};
use crate::service::sessions::{ReceivedFrame, RefusedFrame};
use crate::wire::geometry::camera;
use crate::wire::navigations::{
    body_report, goal_refusal, goal_request, guidance, navigation, reverse, seen, way,
};
use crate::wire::sessions::frame;
use crate::wire::status::as_message;

/// Answers that wait for a robot to read them; a robot that does not read is not led on.
const ANSWERS_AHEAD: usize = 16;

/// Frames that wait while one is looked at.
const FRAMES_AHEAD: usize = 2;

type Responses = mpsc::Sender<Result<v1::NavigateResponse, Status>>;

#[tonic::async_trait]
impl NavigationService for Adapter {
    type NavigateStream = BoxStream<'static, Result<v1::NavigateResponse, Status>>;

    async fn navigate(
        &self,
        request: Request<Streaming<v1::NavigateRequest>>,
    ) -> Result<Response<Self::NavigateStream>, Status> {
        let (caller, mut requests) = with_caller(request)?;
        let first = self.first(&mut requests).await?.and_then(|first| first.content);
        let Some(navigate_request::Content::Open(open)) = first else {
            return Err(Status::invalid_argument("the first message of a stream must open a navigation"));
        };
        caller.check_resource(&open.map)?;
        let stream = self.service.navigation.open(&caller, opening(open)?).await?;
        let (responses, receiver) = mpsc::channel(ANSWERS_AHEAD);
        tokio::spawn(lead(stream, requests, responses));
        Ok(Response::new(ReceiverStream::new(receiver).boxed()))
    }

    async fn set_goal(
        &self,
        request: Request<v1::SetGoalRequest>,
    ) -> Result<Response<v1::SetGoalResponse>, Status> {
        let (caller, v1::SetGoalRequest { name, goal }) = within_by(request)?;
        let view = self.service.navigation.set_goal(&caller, &name, goal_request(goal)?).await?;
        Ok(Response::new(v1::SetGoalResponse { navigation: Some(navigation(view)) }))
    }

    async fn cancel_goal(
        &self,
        request: Request<v1::CancelGoalRequest>,
    ) -> Result<Response<v1::CancelGoalResponse>, Status> {
        let v1::CancelGoalRequest { name } = within(request)?;
        let view = self.service.navigation.cancel_goal(&name).await?;
        Ok(Response::new(v1::CancelGoalResponse { navigation: Some(navigation(view)) }))
    }

    async fn get_navigation(
        &self,
        request: Request<v1::GetNavigationRequest>,
    ) -> Result<Response<v1::Navigation>, Status> {
        let v1::GetNavigationRequest { name } = within(request)?;
        Ok(Response::new(navigation(self.service.navigation.get(&name).await?)))
    }

    async fn list_navigations(
        &self,
        request: Request<v1::ListNavigationsRequest>,
    ) -> Result<Response<v1::ListNavigationsResponse>, Status> {
        let v1::ListNavigationsRequest { map, page_size, page_token } = within(request)?;
        let Page { items, next } = self.service.navigation.list(&map, page_size, &page_token).await?;
        let navigations = items.into_iter().map(navigation).collect();
        Ok(Response::new(v1::ListNavigationsResponse { navigations, next_page_token: next }))
    }

    async fn plan_route(
        &self,
        request: Request<v1::PlanRouteRequest>,
    ) -> Result<Response<v1::PlanRouteResponse>, Status> {
        let v1::PlanRouteRequest { map, from_place_number, goal, reverse_travel } = within(request)?;
        let reverse = reverse(reverse_travel)?;
        let GoalRequest::Goal(goal) = goal_request(goal)? else {
            let message =
                "a route is planned to a place, a position or a label; only a robot is sent to an image";
            return Err(ServiceError::invalid(message).into());
        };
        let planned = self.service.navigation.plan_route(&map, from_place_number, goal, reverse).await?;
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
                refusal.map(|refusal| {
                    stream.note_refused(&refusal.error);
                    respond(navigate_response::Content::GoalRefusal(goal_refusal(refusal)))
                })
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
    frames: &mpsc::Sender<ReceivedFrame>,
) -> Option<Result<v1::NavigateResponse, Status>> {
    let content = match request.content {
        Some(navigate_request::Content::Wheels(message)) => {
            let stamp_ns = message.stamp_ns;
            match body_report(message).and_then(|report| stream.report(report)) {
                Ok(told) => navigate_response::Content::Guidance(guidance(told)),
                Err(error) => {
                    stream.note_refused(&error);
                    navigate_response::Content::WheelRefusal(v1::WheelRefusal {
                        stamp_ns,
                        status: Some(as_message(&error)),
                    })
                }
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
        Some(navigate_request::Content::Goal(message)) => match goal_request(Some(message.clone())) {
            Ok(goal) => {
                stream.go_to(goal);
                return None;
            }
            // The robot goes on to the goal that it had.
            Err(error) => {
                stream.note_refused(&error);
                navigate_response::Content::GoalRefusal(v1::GoalRefusal {
                    goal: Some(message),
                    status: Some(as_message(&error)),
                })
            }
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
async fn look(stream: NavigationStream, mut frames: mpsc::Receiver<ReceivedFrame>, responses: Responses) {
    while let Some(frame) = frames.recv().await {
        let looked = match frame {
            Ok(frame) => {
                let sequence = frame.sequence;
                stream.look(frame).await.map_err(|error| RefusedFrame { sequence, error })
            }
            Err(refused) => Err(refused),
        };
        let contents = match looked {
            Ok(Looked { seen: what, told }) => {
                let told = told.map(|told| navigate_response::Content::Guidance(guidance(told)));
                [Some(navigate_response::Content::Seen(seen(what))), told]
            }
            Err(RefusedFrame { sequence, error }) => {
                stream.note_refused(&error);
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
    let v1::DrivingSettings { speed_m_s, max_turn_rad_s, reverse_travel } = driving.unwrap_or_default();
    Ok(NavigationOpening {
        map,
        navigation: navigation_id,
        run: run_id,
        camera: declared.map(camera).transpose()?,
        words_hash,
        goal: goal.map(|goal| goal_request(Some(goal))).transpose()?,
        driving: Driving { speed_m_s, max_turn_rad_s, reverse_travel: reverse(reverse_travel)? },
    })
}
