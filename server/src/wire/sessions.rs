//! Sessions and frames, to and from messages.

use std::time::Duration;

use bytes::Bytes;
use fabmap::PlaceId;
use waypost_proto::v1;
use waypost_proto::v1::frame::Content as FrameContent;

use super::corrections::correction;
use super::geometry::{camera_message, map_pose_message, odometry, odometry_message};
use super::recognition::{found, reason_code};
use crate::error::ServiceError;
use crate::ingest::content::{Content, WordList};
use crate::metrics::FrameTimings;
use crate::names::token_name;
use crate::open_map::answers::FrameAnswer;
use crate::service::frames::SessionSummary;
use crate::service::frames::{FrameBytes, FrameView, SessionView};
use crate::service::sessions::{Frame, ReceivedFrame, RefusedFrame, SessionMode, StreamView};

pub(crate) fn session(view: SessionView) -> v1::Session {
    let SessionView { name, summary } = view;
    let SessionSummary {
        number: _,
        name: _,
        camera,
        opened_ns,
        frames,
        loop_closures,
        first_sequence,
        last_sequence,
        first_stamp_ns,
        last_stamp_ns,
        owner,
        kept_bytes,
    } = summary;
    v1::Session {
        name,
        create_time_ns: opened_ns,
        camera: camera.as_ref().map(camera_message),
        frames,
        loop_closures,
        first_sequence,
        last_sequence,
        first_stamp_ns,
        last_stamp_ns,
        owner: owner.map(|owner| token_name(&owner)).unwrap_or_default(),
        kept_bytes,
    }
}

pub(crate) fn open_stream(view: StreamView) -> v1::OpenStream {
    let StreamView { session, mode, opened_ns, answered, refused, last_frame_ns, last_delay, last_answer } =
        view;
    let mode = match mode {
        SessionMode::Map => v1::SessionMode::Map,
        SessionMode::Localize => v1::SessionMode::Localize,
    };
    v1::OpenStream {
        session,
        mode: mode.into(),
        open_time_ns: opened_ns,
        answered_frames: answered,
        refused_frames: refused,
        last_frame_time_ns: last_frame_ns,
        last_delay_ns: last_delay.map(|delay| i64::try_from(delay.as_nanos()).unwrap_or(i64::MAX)),
        last_answer: last_answer.map(answer),
    }
}

pub(crate) fn frame_record(view: FrameView) -> v1::FrameRecord {
    let FrameView { name, stamp_ns, note, answer: told, odometry, learnt, observation, bytes, corrections } =
        view;
    let FrameBytes { log, features, thumbnail, image } = bytes;
    let (words, counts) = observation.histogram();
    v1::FrameRecord {
        name,
        stamp_ns,
        answer: Some(v1::FrameAnswer { resent: false, ..answer(told) }),
        odometry: odometry.as_ref().map(odometry_message),
        learnt,
        storage: Some(v1::FrameStorage {
            log_bytes: log,
            features_bytes: features,
            thumbnail_bytes: thumbnail,
            image_bytes: image,
        }),
        histogram: Some(v1::WordHistogram { words, counts }),
        note,
        corrections: corrections.into_iter().map(correction).collect(),
    }
}

/// As it is in a list: without its words.
pub(crate) fn listed_frame(view: FrameView) -> v1::FrameRecord {
    v1::FrameRecord { histogram: None, ..frame_record(view) }
}

pub(crate) fn answer(answer: FrameAnswer) -> v1::FrameAnswer {
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
        place_number: place.map(PlaceId::number),
        posterior,
        new_place_posterior,
        places: places
            .into_iter()
            .map(|(place_number, posterior)| v1::PlaceProbability {
                place_number: place_number.number(),
                posterior,
            })
            .collect(),
        r#match: closure.map(found),
        best_candidate: proposal.map(found),
        words: u32::try_from(words).unwrap_or(u32::MAX),
        resent: timings.is_none(),
        timings: timings.map(timings_message),
        map_pose: map_pose.as_ref().map(map_pose_message),
    }
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

/// A frame, or what is wrong with it.
pub(crate) fn frame(message: v1::Frame) -> ReceivedFrame {
    let v1::Frame { sequence, stamp_ns, content, odometry: moved, note } = message;
    let refused = |error| RefusedFrame { sequence, error };
    let content = match content {
        Some(FrameContent::Image(image)) => Content::Image(Bytes::from(image)),
        Some(FrameContent::Histogram(words)) => histogram(words),
        Some(FrameContent::Words(words)) => word_list(words),
        None => {
            let message = "the frame has no image and no words; send a JPEG, a PNG, or words";
            return Err(refused(ServiceError::invalid(message)));
        }
    };
    let moved = moved.map(odometry).transpose().map_err(refused)?;
    Ok(Frame { sequence, stamp_ns, content, odometry: moved, note })
}

pub(crate) fn histogram(message: v1::WordHistogram) -> Content {
    let v1::WordHistogram { words, counts } = message;
    Content::Histogram { words: words.into_iter().map(Into::into).collect(), counts }
}

pub(crate) fn word_list(message: v1::WordList) -> Content {
    let v1::WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px } = message;
    let words = words.into_iter().map(Into::into).collect();
    Content::Words(WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px })
}
