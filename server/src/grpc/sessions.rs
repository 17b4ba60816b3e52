use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use futures::stream::{self, BoxStream, Stream, StreamExt};
use prost::Message;
use tonic::{Request, Response, Status, Streaming};
use topomap::event::Reason;
use topomap::verification::Similarity;
use waypost_proto::v1;
use waypost_proto::v1::session_service_server::SessionService;
use waypost_proto::v1::{frame, query_request, stream_request, stream_response};

use super::Adapter;
use super::convert::{self, camera, histogram, known, odometry, word_list};
use super::frames;
use super::maps::frame_reference;
use super::status::as_message;
use crate::error::ServiceError;
use crate::service::content::Content;
use crate::service::frames::{FrameImage, ImageSize};
use crate::service::models::Page;
use crate::service::names::model_name;
use crate::service::pictures::FramePicture;
use crate::service::sessions::{
    Frame, FrameAnswer, FrameOutcome, FrameTimings, GeometryView, MatchView, SessionMode, SessionStream,
};

/// Frames of one stream that are turned into words side by side.
const PREPARED_AHEAD: usize = 2;

/// Frames of one stream that wait for their commit.
const SUBMITTED_AHEAD: usize = 8;

#[tonic::async_trait]
impl SessionService for Adapter {
    type StreamStream = BoxStream<'static, Result<v1::StreamResponse, Status>>;

    async fn stream(
        &self,
        request: Request<Streaming<v1::StreamRequest>>,
    ) -> Result<Response<Self::StreamStream>, Status> {
        let mut requests = request.into_inner();
        let first = self.first(&mut requests).await?.and_then(|first| first.content);
        let Some(stream_request::Content::Open(open)) = first else {
            return Err(Status::invalid_argument("the first message of a stream must open a session"));
        };
        let session = self.open(open).await?;
        let opened = stream::iter([Ok(opened(&session))]);
        let responses = opened.chain(until_over(session.clone(), frames(session, requests)));
        Ok(Response::new(responses.boxed()))
    }

    async fn query(&self, request: Request<v1::QueryRequest>) -> Result<Response<v1::QueryResponse>, Status> {
        let v1::QueryRequest { map, content, words_hash, explained_words } = request.into_inner();
        let content = match content {
            Some(query_request::Content::Image(image)) => Content::Image(Bytes::from(image)),
            Some(query_request::Content::Histogram(words)) => histogram(words),
            Some(query_request::Content::Words(words)) => word_list(words),
            None => return Err(Status::invalid_argument("the query shows nothing; send an image or words")),
        };
        let answer = self.service.query(&map, content, &words_hash, explained_words).await?;
        Ok(Response::new(frames::query_response(answer)))
    }

    async fn list_sessions(
        &self,
        request: Request<v1::ListSessionsRequest>,
    ) -> Result<Response<v1::ListSessionsResponse>, Status> {
        let v1::ListSessionsRequest { map, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_sessions(&map, page_size, &page_token).await?;
        let sessions = items.into_iter().map(frames::session).collect::<Result<_, _>>()?;
        Ok(Response::new(v1::ListSessionsResponse { sessions, next_page_token: next }))
    }

    async fn get_session(
        &self,
        request: Request<v1::GetSessionRequest>,
    ) -> Result<Response<v1::Session>, Status> {
        let v1::GetSessionRequest { name } = request.into_inner();
        Ok(Response::new(frames::session(self.service.session(&name).await?)?))
    }

    async fn list_frames(
        &self,
        request: Request<v1::ListFramesRequest>,
    ) -> Result<Response<v1::ListFramesResponse>, Status> {
        let v1::ListFramesRequest { session, page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.list_frames(&session, page_size, &page_token).await?;
        let listed = items.into_iter().map(|view| v1::FrameRecord { histogram: None, ..frames::frame(view) });
        Ok(Response::new(v1::ListFramesResponse { frames: listed.collect(), next_page_token: next }))
    }

    async fn get_frame(
        &self,
        request: Request<v1::GetFrameRequest>,
    ) -> Result<Response<v1::FrameRecord>, Status> {
        let v1::GetFrameRequest { name } = request.into_inner();
        Ok(Response::new(frames::frame(self.service.frame(&name).await?)))
    }

    async fn get_frame_image(
        &self,
        request: Request<v1::GetFrameImageRequest>,
    ) -> Result<Response<v1::GetFrameImageResponse>, Status> {
        use v1::get_frame_image_request::Size;
        let v1::GetFrameImageRequest { name, size } = request.into_inner();
        let size = match known("size", size)? {
            Size::Unspecified => ImageSize::Best,
            Size::Original => ImageSize::Original,
            Size::Thumbnail => ImageSize::Thumbnail,
        };
        let FrameImage { content_type, image } = self.service.frame_image(&name, size).await?;
        Ok(Response::new(v1::GetFrameImageResponse { content_type: content_type.to_owned(), image }))
    }

    async fn explain_frame(
        &self,
        request: Request<v1::ExplainFrameRequest>,
    ) -> Result<Response<v1::FrameExplanation>, Status> {
        let v1::ExplainFrameRequest { name, place, words } = request.into_inner();
        Ok(Response::new(frames::explanation(self.service.explain_frame(&name, place, words).await?)))
    }

    async fn get_frame_picture(
        &self,
        request: Request<v1::GetFramePictureRequest>,
    ) -> Result<Response<v1::GetFramePictureResponse>, Status> {
        let v1::GetFramePictureRequest { name, place } = request.into_inner();
        let FramePicture { content_type, picture } = self.service.frame_picture(&name, place).await?;
        Ok(Response::new(v1::GetFramePictureResponse { content_type: content_type.to_owned(), picture }))
    }

    async fn measure_closure(
        &self,
        request: Request<v1::MeasureClosureRequest>,
    ) -> Result<Response<v1::MeasureClosureResponse>, Status> {
        let v1::MeasureClosureRequest { frame, earlier_frame, pose, covariance } = request.into_inner();
        let measured = convert::measured(pose, covariance)?;
        let map_pose = self.service.measure_closure(&frame, &earlier_frame, measured).await?;
        let map_pose = map_pose.as_ref().map(convert::map_pose);
        Ok(Response::new(v1::MeasureClosureResponse { map_pose }))
    }
}

/// `frames`, until the session is over; then why.
fn until_over(
    session: SessionStream,
    frames: impl Stream<Item = Result<v1::StreamResponse, Status>> + Send + 'static,
) -> impl Stream<Item = Result<v1::StreamResponse, Status>> + Send {
    let over = async move { session.over().await }.boxed();
    stream::unfold(Some((frames.boxed(), over)), |state| async {
        let (mut frames, mut over) = state?;
        tokio::select! {
            // What was answered before the end is still said.
            biased;
            response = frames.next() => response.map(|response| (response, Some((frames, over)))),
            error = &mut over => Some((Err(error.into()), None)),
        }
    })
}

impl Adapter {
    async fn open(&self, message: v1::OpenSession) -> Result<SessionStream, ServiceError> {
        let v1::OpenSession { map, session_id, mode, camera: declared, words_hash, run_id } = message;
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
        let encoded = match declared {
            Some(declared) => {
                let encoded = declared.encode_to_vec();
                camera(declared)?;
                Some(encoded)
            }
            None => None,
        };
        self.service.open_session(&map, &session_id, mode, encoded, &words_hash, &run_id).await
    }
}

/// Frames in, outcomes out, in the order they were sent; at most a few are under way at once.
fn frames(
    session: SessionStream,
    requests: Streaming<v1::StreamRequest>,
) -> impl Stream<Item = Result<v1::StreamResponse, Status>> + Send {
    let (submitting, waiting) = (session.clone(), session.clone());
    requests
        .map(move |request| {
            let session = session.clone();
            async move {
                match request?.content {
                    Some(stream_request::Content::Frame(message)) => {
                        Ok(session.prepare(frame(message)).await)
                    }
                    Some(stream_request::Content::Open(_)) | None => Err(Status::invalid_argument(
                        "after the first message of a stream, each must be a frame",
                    )),
                }
            }
        })
        .buffered(PREPARED_AHEAD)
        .then(move |prepared| {
            let session = submitting.clone();
            async move {
                match prepared {
                    Ok(prepared) => Ok(session.submit(prepared).await),
                    Err(status) => Err(status),
                }
            }
        })
        .map(move |pending| {
            let session = waiting.clone();
            async move { outcome(session.counted(session.outcome(pending?).await)) }
        })
        .buffered(SUBMITTED_AHEAD)
}

/// A frame, or its number and what is wrong with it.
pub(super) fn frame(message: v1::Frame) -> Result<Frame, (u64, ServiceError)> {
    let v1::Frame { sequence, stamp_ns, content, odometry: moved } = message;
    let invalid = |message: &str| (sequence, ServiceError::invalid(message));
    if i64::try_from(sequence).is_err() {
        return Err(invalid("the sequence number must be below 2^63"));
    }
    if stamp_ns <= 0 {
        return Err(invalid("the frame has no stamp; send when the image was taken, in nanoseconds above 0"));
    }
    let content = match content {
        Some(frame::Content::Image(image)) => Content::Image(Bytes::from(image)),
        Some(frame::Content::Histogram(words)) => histogram(words),
        Some(frame::Content::Words(words)) => word_list(words),
        None => return Err(invalid("the frame has no image and no words; send a JPEG, a PNG, or words")),
    };
    let moved = moved.map(odometry).transpose().map_err(|error| (sequence, error))?;
    Ok(Frame { sequence, stamp_ns, content, odometry: moved })
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

pub(super) fn answer(answer: FrameAnswer) -> v1::FrameAnswer {
    let FrameAnswer {
        sequence,
        last_committed,
        reason,
        place,
        posterior,
        new_place_posterior,
        places,
        closure,
        proposal,
        words,
        timings,
        map_pose,
    } = answer;
    v1::FrameAnswer {
        sequence,
        last_committed_sequence: last_committed,
        reason: reason_code(reason).into(),
        place,
        posterior,
        new_place_posterior,
        places: places
            .into_iter()
            .map(|(place, posterior)| v1::PlaceProbability { place, posterior })
            .collect(),
        closure: closure.map(found),
        proposal: proposal.map(found),
        words: u32::try_from(words).unwrap_or(u32::MAX),
        resent: timings.is_none(),
        timings: timings.map(timings_message),
        map_pose: map_pose.as_ref().map(convert::map_pose),
    }
}

pub(super) fn reason_code(reason: Reason) -> v1::Reason {
    match reason {
        Reason::NewPlace => v1::Reason::NewPlace,
        Reason::SamePlace => v1::Reason::SamePlace,
        Reason::LoopClosure => v1::Reason::LoopClosure,
        Reason::BelowThreshold => v1::Reason::BelowThreshold,
        Reason::TooFewWords => v1::Reason::TooFewWords,
        Reason::GeometryRefused => v1::Reason::GeometryRefused,
    }
}

pub(super) fn found(found: MatchView) -> v1::Match {
    let MatchView { place, posterior, log_odds, frame, geometry } = found;
    let geometry = geometry.map(geometry_message);
    v1::Match { place, posterior, log_odds, frame: Some(frame_reference(frame)), geometry }
}

fn geometry_message(geometry: GeometryView) -> v1::Geometry {
    let GeometryView { matches, inliers, evidence, probability, similarity } = geometry;
    let similarity = similarity.map(|similarity| {
        let Similarity { rotation_rad, ln_scale, translation_widths: [x_widths, y_widths] } = similarity;
        v1::Similarity { rotation_rad, ln_scale, x_widths, y_widths }
    });
    v1::Geometry { matches, inliers, evidence, similarity, probability }
}

fn timings_message(timings: FrameTimings) -> v1::Timings {
    let FrameTimings { extract, quantize, likelihood, new_place, filter, verification, commit, total } =
        timings;
    let ms = |duration: Duration| duration.as_secs_f64() * 1e3;
    v1::Timings {
        extract_ms: ms(extract),
        quantize_ms: ms(quantize),
        likelihood_ms: ms(likelihood),
        new_place_ms: ms(new_place),
        filter_ms: ms(filter),
        verification_ms: ms(verification),
        commit_ms: ms(commit),
        total_ms: ms(total),
    }
}
