use fabmap::PlaceId;
use futures::stream::{self, BoxStream, StreamExt};
use tonic::{Request, Response, Status, Streaming};
use waypost_proto::v1;
use waypost_proto::v1::session_service_server::SessionService;
use waypost_proto::v1::{stream_request, stream_response};

use super::Adapter;
use super::reach::{with_caller, within};
use crate::error::ServiceError;
use crate::names::model_name;
use crate::open_map::{Opener, SessionMode};
use crate::pages::Page;
use crate::service::frames::{FrameImage, FramesWanted, ImageSize};
use crate::service::pictures::{Beside, FramePicture};
use crate::service::sessions::{FrameOutcome, Robot, SessionStream};
use crate::service::tokens::{Access, Caller};
use crate::wire::geometry::{camera, map_pose_message, measured};
use crate::wire::jobs::job;
use crate::wire::known;
use crate::wire::recognition::explanation;
use crate::wire::sessions::{answer, frame, frame_record, listed_frame, open_stream, session};
use crate::wire::status::as_message;

#[tonic::async_trait]
impl SessionService for Adapter {
    type StreamStream = BoxStream<'static, Result<v1::StreamResponse, Status>>;

    async fn stream(
        &self,
        request: Request<Streaming<v1::StreamRequest>>,
    ) -> Result<Response<Self::StreamStream>, Status> {
        let (caller, mut requests) = with_caller(request)?;
        let first = self.first(&mut requests).await?.and_then(|first| first.content);
        let Some(stream_request::Content::Open(open)) = first else {
            return Err(Status::invalid_argument("the first message of a stream must open a session"));
        };
        let session = self.open(open, &caller).await?;
        let opened = stream::iter([Ok(opened(&session))]);
        let frames = requests.map(|request| match request?.content {
            Some(stream_request::Content::Frame(message)) => Ok(frame(message)),
            Some(stream_request::Content::Open(_)) | None => {
                Err(Status::invalid_argument("after the first message of a stream, each must be a frame"))
            }
        });
        let outcomes = session.run(frames).map(|run| outcome(run?));
        Ok(Response::new(opened.chain(outcomes).boxed()))
    }

    async fn list_sessions(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let v1::ListSessionsRequest { map, page_size, page_token } = within(request)?;
        let Page { items, next } = self.service.frames.sessions(&map, page_size, &page_token).await?;
        let sessions = items.into_iter().map(session).collect();
        Ok(Response::new(v1::ListSessionsResponse { sessions, next_page_token: next }))
    }

    async fn list_open_streams(
        &self,
        request: Request<v1::ListOpenStreamsRequest>,
    ) -> Result<Response<v1::ListOpenStreamsResponse>, Status> {
        let (caller, v1::ListOpenStreamsRequest { map }) = with_caller(request)?;
        let streams = self.service.sessions.open_streams(&caller, &map).await?;
        let streams = streams.into_iter().map(open_stream).collect();
        Ok(Response::new(v1::ListOpenStreamsResponse { streams }))
    }

    async fn get_session(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let v1::GetSessionRequest { name } = within(request)?;
        Ok(Response::new(session(self.service.frames.session(&name).await?)))
    }

    async fn list_frames(
        &self,
        request: Request<v1::ListFramesRequest>,
    ) -> Result<Response<v1::ListFramesResponse>, Status> {
        let v1::ListFramesRequest { session, page_size, page_token, note, from_sequence } = within(request)?;
        let wanted = FramesWanted { note: &note, from_sequence };
        let Page { items, next } = self.service.frames.list(&session, wanted, page_size, &page_token).await?;
        let frames = items.into_iter().map(listed_frame).collect();
        Ok(Response::new(v1::ListFramesResponse { frames, next_page_token: next }))
    }

    async fn get_frame(
        &self,
        request: Request<v1::GetFrameRequest>,
    ) -> Result<Response<v1::FrameRecord>, Status> {
        let v1::GetFrameRequest { name } = within(request)?;
        Ok(Response::new(frame_record(self.service.frames.get(&name).await?)))
    }

    async fn get_frame_image(
        &self,
        request: Request<v1::GetFrameImageRequest>,
    ) -> Result<Response<v1::GetFrameImageResponse>, Status> {
        use v1::get_frame_image_request::Size;
        let v1::GetFrameImageRequest { name, size } = within(request)?;
        let size = match known("size", size)? {
            Size::Unspecified | Size::Largest => ImageSize::Best,
            Size::Original => ImageSize::Original,
            Size::Thumbnail => ImageSize::Thumbnail,
        };
        let FrameImage { content_type, image } = self.service.frames.image(&name, size).await?;
        Ok(Response::new(v1::GetFrameImageResponse { content_type: content_type.to_owned(), image }))
    }

    async fn explain_frame(
        &self,
        request: Request<v1::ExplainFrameRequest>,
    ) -> Result<Response<v1::FrameExplanation>, Status> {
        let v1::ExplainFrameRequest { name, place_number, max_words } = within(request)?;
        let explanation =
            self.service.queries.explain(&name, place_number.map(PlaceId::new), max_words).await?;
        Ok(Response::new(self::explanation(explanation)))
    }

    async fn get_frame_picture(
        &self,
        request: Request<v1::GetFramePictureRequest>,
    ) -> Result<Response<v1::GetFramePictureResponse>, Status> {
        let v1::GetFramePictureRequest { name, place_number, beside_frame, expected_words } =
            within(request)?;
        let beside = Beside::asked(place_number, beside_frame)?;
        let FramePicture { content_type, picture } =
            self.service.pictures.frame(&name, beside, &expected_words).await?;
        Ok(Response::new(v1::GetFramePictureResponse { content_type: content_type.to_owned(), picture }))
    }

    async fn add_relative_pose(
        &self,
        request: Request<v1::AddRelativePoseRequest>,
    ) -> Result<Response<v1::AddRelativePoseResponse>, Status> {
        let v1::AddRelativePoseRequest { frame, earlier_frame, pose, covariance } = within(request)?;
        let measured = measured(pose, covariance)?;
        let map_pose = self.service.measurements.add(&frame, &earlier_frame, measured).await?;
        let map_pose = map_pose.as_ref().map(map_pose_message);
        Ok(Response::new(v1::AddRelativePoseResponse { map_pose }))
    }

    async fn delete_session(
        &self,
        request: Request<v1::DeleteSessionRequest>,
    ) -> Result<Response<v1::Job>, Status> {
        let v1::DeleteSessionRequest { name } = within(request)?;
        Ok(Response::new(job(self.service.rewriting.delete_session(&name).await?)))
    }
}

impl Adapter {
    async fn open(&self, message: v1::OpenSession, caller: &Caller) -> Result<SessionStream, ServiceError> {
        let v1::OpenSession { map, session_id, mode, camera: declared, words_hash, run_id } = message;
        caller.check_resource(&map)?;
        let mode = match known("mode", mode)? {
            v1::SessionMode::Map => SessionMode::Map,
            v1::SessionMode::Localize => SessionMode::Localize,
            v1::SessionMode::Unspecified => {
                return Err(ServiceError::invalid(
                    "say which mode the session has: SESSION_MODE_MAP lets the map grow, SESSION_MODE_LOCALIZE \
                     only looks",
                ));
            }
        };
        caller.check(match mode {
            SessionMode::Map => Access::STREAM,
            SessionMode::Localize => Access::LOCALIZE,
        })?;
        let camera = declared.map(camera).transpose()?;
        let opener = Opener { token: caller.token.clone(), role: caller.role };
        let robot = Robot { words_hash: &words_hash, run: &run_id, opener: Some(opener) };
        self.service.sessions.open(&map, &session_id, mode, camera, robot).await
    }
}

fn opened(session: &SessionStream) -> v1::StreamResponse {
    respond(stream_response::Content::Opened(v1::SessionOpened {
        session: session.name().to_owned(),
        last_committed_sequence: session.last_committed(),
        model: model_name(session.model_hash()),
        words_hash: session.words_hash().to_owned(),
    }))
}

fn outcome(outcome: FrameOutcome) -> Result<v1::StreamResponse, Status> {
    match outcome {
        FrameOutcome::Answered(answered) => Ok(respond(stream_response::Content::Answer(answer(*answered)))),
        FrameOutcome::Refused { sequence, last_committed, error } => {
            let status = Some(as_message(&error));
            let refusal = v1::FrameRefusal { sequence, last_committed_sequence: last_committed, status };
            Ok(respond(stream_response::Content::Refusal(refusal)))
        }
        FrameOutcome::Ended(error) => Err(error.into()),
    }
}

fn respond(content: stream_response::Content) -> v1::StreamResponse {
    v1::StreamResponse { content: Some(content) }
}
