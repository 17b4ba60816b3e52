//! The frames that have no outcome yet, in the order they were sent.

use std::collections::VecDeque;
use std::time::Duration;

use prost::Message;
use tonic::Code;
use tonic_types::pb::RetryInfo;
use waypost_proto::google::rpc::Status;
use waypost_proto::v1;

use super::{FrameContent, FrameInput, FrameOutcome};
use crate::MAX_IMAGE_BYTES;
use crate::error::Error;

/// Every frame from when the application gives it until it gets its outcome back.
#[derive(Debug, Default)]
pub(super) struct Window {
    entries: VecDeque<Entry>,
    last_acknowledged: Option<u64>,
    /// Frames that may be on their way at once, since the server refused one for now: those behind a frame
    /// that is refused again would be sent for nothing.
    in_flight_limit: Option<usize>,
}

#[derive(Debug)]
struct Entry {
    frame: FrameInput,
    progress: Progress,
}

#[derive(Debug)]
enum Progress {
    /// To be sent over the present connection.
    Waiting,
    /// Sent over the present connection.
    InFlight,
    /// The server asked to send it again later.
    Postponed,
    Done(Box<FrameOutcome>),
}

/// What an outcome of the server did.
#[derive(Debug, PartialEq)]
pub(super) enum Settled {
    /// The frame is done.
    Done,
    /// The frame is to be sent again, after the delay that the server asks for.
    Postponed { message: String, delay: Duration },
}

impl Window {
    /// Takes a frame. One that no server would take is refused here.
    pub(super) fn push(&mut self, frame: FrameInput) {
        let progress = match &frame.content {
            FrameContent::Image(image) if image.len() > MAX_IMAGE_BYTES => {
                Progress::Done(Box::new(FrameOutcome::Refusal(self.too_long(frame.sequence, image.len()))))
            }
            FrameContent::Image(_) | FrameContent::Histogram(_) | FrameContent::Words(_) => Progress::Waiting,
        };
        self.entries.push_back(Entry { frame, progress });
    }

    /// The next frame to send, which then counts as sent. Nothing overtakes a postponed frame: once a
    /// later one were durable, it could not be any more.
    pub(super) fn next_to_send(&mut self) -> Option<v1::Frame> {
        let in_flight = self.entries.iter().filter(|entry| matches!(entry.progress, Progress::InFlight));
        if self.in_flight_limit.is_some_and(|limit| in_flight.count() >= limit) {
            return None;
        }
        for entry in &mut self.entries {
            match entry.progress {
                Progress::Waiting => {
                    entry.progress = Progress::InFlight;
                    return Some(wire(entry.frame.clone()));
                }
                Progress::Postponed => return None,
                Progress::InFlight | Progress::Done(_) => {}
            }
        }
        None
    }

    /// Takes an outcome from the server.
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

    /// The connection broke: everything without an outcome has to go over the next one, also frames
    /// that were committed while their answer was lost. Those get the stored answer.
    pub(super) fn send_again(&mut self) {
        for entry in &mut self.entries {
            match entry.progress {
                Progress::InFlight | Progress::Postponed => entry.progress = Progress::Waiting,
                Progress::Waiting | Progress::Done(_) => {}
            }
        }
    }

    /// Frames that the application is owed an outcome for.
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Last frame that the server said was durable.
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

fn wire(FrameInput { sequence, stamp_ns, content, odometry }: FrameInput) -> v1::Frame {
    let content = match content {
        FrameContent::Image(image) => v1::frame::Content::Image(image),
        FrameContent::Histogram(histogram) => v1::frame::Content::Histogram(histogram),
        FrameContent::Words(words) => v1::frame::Content::Words(words),
    };
    v1::Frame { sequence, stamp_ns, odometry, content: Some(content) }
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
mod tests {
    use super::*;

    fn frame(sequence: u64) -> FrameInput {
        FrameInput { sequence, stamp_ns: 0, content: FrameContent::Image(vec![1]), odometry: None }
    }

    fn window(sequences: std::ops::RangeInclusive<u64>) -> Window {
        let mut window = Window::default();
        sequences.for_each(|sequence| window.push(frame(sequence)));
        window
    }

    fn answer(sequence: u64) -> FrameOutcome {
        FrameOutcome::Answer(v1::FrameAnswer { sequence, ..Default::default() })
    }

    fn refusal(sequence: u64, code: Code) -> FrameOutcome {
        let status = Status { code: code.into(), message: "because".to_owned(), details: Vec::new() };
        FrameOutcome::Refusal(v1::FrameRefusal {
            sequence,
            last_committed_sequence: None,
            status: Some(status),
        })
    }

    fn sent(window: &mut Window) -> Vec<u64> {
        std::iter::from_fn(|| window.next_to_send().map(|frame| frame.sequence)).collect()
    }

    fn taken(window: &mut Window) -> Vec<u64> {
        std::iter::from_fn(|| window.take_outcome().map(|outcome| outcome.sequence())).collect()
    }

    #[test]
    fn outcomes_leave_in_the_order_of_frames() {
        let mut window = window(1..=3);
        assert_eq!(sent(&mut window), [1, 2, 3]);
        assert_eq!(window.settle(answer(2)).unwrap(), Settled::Done);
        assert!(taken(&mut window).is_empty());
        assert_eq!(window.settle(refusal(1, Code::InvalidArgument)).unwrap(), Settled::Done);
        assert_eq!(taken(&mut window), [1, 2]);
        assert_eq!((window.len(), window.last_acknowledged()), (1, Some(2)));
    }

    #[test]
    fn all_frames_without_an_outcome_are_sent_again() {
        let mut window = window(1..=4);
        assert_eq!(sent(&mut window), [1, 2, 3, 4]);
        window.settle(answer(1)).unwrap();
        window.settle(answer(3)).unwrap();
        window.send_again();
        assert_eq!(sent(&mut window), [2, 4]);
    }

    #[test]
    fn nothing_overtakes_a_postponed_frame() {
        let mut window = window(1..=2);
        assert_eq!(sent(&mut window), [1, 2]);
        let settled = window.settle(refusal(1, Code::ResourceExhausted)).unwrap();
        assert_eq!(settled, Settled::Postponed { message: "because".to_owned(), delay: Duration::ZERO });
        window.push(frame(3));
        assert!(sent(&mut window).is_empty());
        assert!(!window.only_postponed_left());
        window.settle(refusal(2, Code::Unavailable)).unwrap();
        assert!(window.only_postponed_left());
        window.release_postponed();
        assert!(!window.only_postponed_left());
        assert_eq!(sent(&mut window), [1]);
    }

    #[test]
    fn after_a_refusal_frames_go_one_by_one_and_then_more_and_more() {
        let mut window = window(1..=9);
        assert_eq!(sent(&mut window).len(), 9);
        for sequence in 1..=9 {
            window.settle(refusal(sequence, Code::Unavailable)).unwrap();
        }
        window.release_postponed();
        assert_eq!(sent(&mut window), [1]);
        window.settle(answer(1)).unwrap();
        assert_eq!(sent(&mut window), [2, 3]);
        // One that is refused for good says nothing of how much the server can take.
        window.settle(refusal(2, Code::InvalidArgument)).unwrap();
        assert_eq!(sent(&mut window), [4]);
        window.settle(answer(3)).unwrap();
        assert_eq!(sent(&mut window), [5, 6, 7]);
        window.settle(answer(4)).unwrap();
        assert_eq!(sent(&mut window), [8, 9]);
    }

    #[test]
    fn the_server_may_say_how_long_to_wait() {
        let hint = RetryInfo { retry_delay: Some(prost_types::Duration { seconds: 1, nanos: 500_000_000 }) };
        let detail = prost_types::Any {
            type_url: "type.googleapis.com/google.rpc.RetryInfo".to_owned(),
            value: hint.encode_to_vec(),
        };
        let status = Status { code: 8, message: String::new(), details: vec![detail] };
        assert_eq!(retry_delay(&status), Duration::from_millis(1500));
    }

    #[test]
    fn an_answer_to_nothing_is_an_error() {
        let mut window = window(1..=1);
        assert!(matches!(window.settle(answer(1)), Err(Error::Protocol(_))));
        assert_eq!(sent(&mut window), [1]);
        window.settle(answer(1)).unwrap();
        assert!(matches!(window.settle(answer(1)), Err(Error::Protocol(_))));
    }

    #[test]
    fn an_image_that_is_too_long_is_refused_in_its_turn() {
        let mut window = window(1..=1);
        window.push(FrameInput { content: FrameContent::Image(vec![0; MAX_IMAGE_BYTES + 1]), ..frame(2) });
        window.push(frame(3));
        assert_eq!(sent(&mut window), [1, 3]);
        window.settle(answer(1)).unwrap();
        assert!(matches!(window.take_outcome(), Some(FrameOutcome::Answer(_))));
        let Some(FrameOutcome::Refusal(refusal)) = window.take_outcome() else { panic!("not refused") };
        assert_eq!(refusal.status.unwrap().code, i32::from(Code::InvalidArgument));
        assert_eq!(window.take_outcome(), None);
    }
}
