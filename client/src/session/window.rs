//! The frames that have no outcome yet, in the order they were sent.

use std::collections::VecDeque;
use std::time::Duration;

use prost::Message;
use tonic::Code;
use tonic_types::pb::RetryInfo;
use waypost_proto::google::rpc::Status;
use waypost_proto::v1;

use crate::MAX_IMAGE_BYTES;
use crate::error::Error;
use crate::frame::{FrameContent, FrameInput, FrameOutcome};

/// Every frame from when the application gives it until it gets its outcome back.
#[derive(Debug, Default)]
pub(super) struct Window {
    entries: VecDeque<Entry>,
    last_acknowledged: Option<u64>,
    /// Most frames in flight after the server has postponed one. Frames behind one that is
    /// postponed again would be uploaded for nothing.
    in_flight_limit: Option<usize>,
}

#[derive(Debug)]
struct Entry {
    frame: FrameInput,
    progress: Progress,
}

#[derive(Debug)]
enum Progress {
    /// Not yet sent over this connection.
    Waiting,
    /// Sent over this connection.
    InFlight,
    /// The server asked to send it again later.
    Postponed,
    Done(Box<FrameOutcome>),
}

/// What became of a frame with a response.
#[derive(Debug, PartialEq)]
pub(super) enum Settled {
    /// The frame is done.
    Done,
    /// The frame is to be sent again, after the delay that the server asks for.
    Postponed { message: String, delay: Duration },
}

impl Window {
    /// Adds a frame. An image that is too long for any server is refused here.
    pub(super) fn push(&mut self, frame: FrameInput) {
        let progress = match &frame.content {
            FrameContent::Image(image) if image.len() > MAX_IMAGE_BYTES => {
                Progress::Done(Box::new(FrameOutcome::Refusal(self.too_long(frame.sequence, image.len()))))
            }
            FrameContent::Image(_) | FrameContent::Histogram(_) | FrameContent::Words(_) => Progress::Waiting,
        };
        self.entries.push_back(Entry { frame, progress });
    }

    /// The next frame to send, which then counts as sent. No frame overtakes a postponed one: once
    /// a higher number is committed, the server takes no lower one.
    pub(super) fn next_to_send(&mut self) -> Option<v1::Frame> {
        let in_flight = self.entries.iter().filter(|entry| matches!(entry.progress, Progress::InFlight));
        if self.in_flight_limit.is_some_and(|limit| in_flight.count() >= limit) {
            return None;
        }
        for entry in &mut self.entries {
            match entry.progress {
                Progress::Waiting => {
                    entry.progress = Progress::InFlight;
                    return Some(entry.frame.clone().into());
                }
                Progress::Postponed => return None,
                Progress::InFlight | Progress::Done(_) => {}
            }
        }
        None
    }

    /// Records a response of the server.
    pub(super) fn settle(&mut self, outcome: FrameOutcome) -> Result<Settled, Error> {
        let sequence = outcome.sequence();
        let entry = self
            .entries
            .iter_mut()
            .find(|entry| entry.frame.sequence == sequence && matches!(entry.progress, Progress::InFlight))
            .ok_or(Error::Protocol("it answered a frame that was not sent"))?;
        if let FrameOutcome::Refusal(v1::FrameRefusal { status: Some(status), .. }) = &outcome
            && matches!(Code::from(status.code), Code::Unavailable | Code::ResourceExhausted)
        {
            entry.progress = Progress::Postponed;
            self.in_flight_limit = Some(1);
            return Ok(Settled::Postponed { message: status.message.clone(), delay: retry_delay(status) });
        }
        if let FrameOutcome::Answer(answer) = &outcome {
            self.last_acknowledged = self.last_acknowledged.max(Some(answer.sequence));
            self.in_flight_limit = self.in_flight_limit.map(|limit| limit.saturating_mul(2));
        }
        entry.progress = Progress::Done(Box::new(outcome));
        Ok(Settled::Done)
    }

    /// The outcome of the oldest frame, which then leaves the window.
    pub(super) fn take_outcome(&mut self) -> Option<FrameOutcome> {
        let Entry { frame, progress } = self.entries.pop_front()?;
        match progress {
            Progress::Done(outcome) => Some(*outcome),
            Progress::Waiting | Progress::InFlight | Progress::Postponed => {
                self.entries.push_front(Entry { frame, progress });
                None
            }
        }
    }

    /// Whether all frames that were sent are settled, and some of them are to be sent again.
    pub(super) fn only_postponed_left(&self) -> bool {
        let in_flight = self.entries.iter().any(|entry| matches!(entry.progress, Progress::InFlight));
        let postponed = self.entries.iter().any(|entry| matches!(entry.progress, Progress::Postponed));
        postponed && !in_flight
    }

    /// Postponed frames may go again.
    pub(super) fn release_postponed(&mut self) {
        for entry in &mut self.entries {
            if matches!(entry.progress, Progress::Postponed) {
                entry.progress = Progress::Waiting;
            }
        }
    }

    /// After a broken connection: every frame without an outcome is sent again, also those that
    /// were committed while their answer was lost. They get the stored answer.
    pub(super) fn send_again(&mut self) {
        for entry in &mut self.entries {
            match entry.progress {
                Progress::InFlight | Progress::Postponed => entry.progress = Progress::Waiting,
                Progress::Waiting | Progress::Done(_) => {}
            }
        }
    }

    /// Frames in the window.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// The last frame that the server reported as durable.
    pub(super) fn last_acknowledged(&self) -> Option<u64> {
        self.last_acknowledged
    }

    fn too_long(&self, sequence: u64, length_bytes: usize) -> v1::FrameRefusal {
        let message = format!(
            "the image has {length_bytes} bytes, more than {MAX_IMAGE_BYTES}; make it smaller or compress it harder"
        );
        let status = Status { code: Code::InvalidArgument.into(), message, details: Vec::new() };
        v1::FrameRefusal { sequence, last_committed_sequence: self.last_acknowledged, status: Some(status) }
    }
}

/// The delay of a `google.rpc.RetryInfo`, or zero.
fn retry_delay(status: &Status) -> Duration {
    let hint = status
        .details
        .iter()
        .find(|detail| detail.type_url.ends_with("/google.rpc.RetryInfo"))
        .and_then(|detail| RetryInfo::decode(detail.value.as_slice()).ok())
        .and_then(|hint| hint.retry_delay);
    hint.and_then(|delay| Duration::try_from(delay).ok()).unwrap_or_default()
}

#[cfg(test)]
mod tests;
