//! A frame as it comes from a robot.

use topomap::metric::Odometry;

use crate::error::ServiceError;
use crate::ingest::content::Content;
use crate::metrics::FrameTimings;
use crate::open_map::Opener;
use crate::open_map::answers::FrameAnswer;
use crate::storage::reason_name;

/// A frame as a robot sends it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) content: Content,
    pub(crate) odometry: Option<Odometry>,
    /// What the robot calls it; empty if nothing.
    pub(crate) note: String,
}

/// What became of a frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum FrameOutcome {
    Answered(Box<FrameAnswer>),
    Refused {
        sequence: u64,
        last_committed: Option<u64>,
        error: ServiceError,
    },
    /// The stream is over.
    Ended(ServiceError),
}

impl FrameOutcome {
    /// What became of the frame, as the metrics call it, and where its time went if it was decided.
    pub(super) fn counted(&self) -> (&'static str, Option<FrameTimings>) {
        match self {
            FrameOutcome::Answered(answer) if answer.timings.is_none() => ("resent", None),
            FrameOutcome::Answered(answer) => (reason_name(answer.reason), answer.timings),
            FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error) => (error.code_name(), None),
        }
    }
}

/// Longest note, in bytes: a file's name, or a short path.
const MAX_NOTE_BYTES: usize = 200;

impl Frame {
    /// Refuses numbers that cannot be stored, and frames without a stamp.
    pub(in crate::service) fn check(&self) -> Result<(), ServiceError> {
        if i64::try_from(self.sequence).is_err() {
            return Err(ServiceError::invalid("the sequence number must be below 2^63"));
        }
        if self.stamp_ns <= 0 {
            return Err(ServiceError::invalid(
                "the frame has no stamp; send when the image was taken, in nanoseconds above 0",
            ));
        }
        check_note(&self.note)
    }
}

/// Refuses what cannot stand in a line.
pub(in crate::service) fn check_note(note: &str) -> Result<(), ServiceError> {
    if note.len() > MAX_NOTE_BYTES {
        return Err(ServiceError::invalid(format_args!(
            "the frame's note has {} bytes; {MAX_NOTE_BYTES} are kept: send a file's name, and not its content",
            note.len()
        )));
    }
    if note.chars().any(char::is_control) {
        return Err(ServiceError::invalid(
            "the frame's note has a control character, as a line break is one; send one line of text",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_one_short_line() {
        for good in ["", "000147.jpg", "left/0001 (Küche).png", &"x".repeat(200)] {
            assert_eq!(check_note(good), Ok(()), "{good}");
        }
        for bad in ["a\nb", "a\u{7f}", &"x".repeat(201), &"ä".repeat(101)] {
            assert!(matches!(check_note(bad), Err(ServiceError::InvalidArgument { .. })), "{bad:?}");
        }
    }
}

/// What a robot says of itself.
#[derive(Clone, Debug)]
pub(crate) struct Robot<'a> {
    /// Of the words that it sends; empty if it sends images.
    pub(crate) words_hash: &'a str,
    /// Tells the runs apart of a robot that localizes by one name; empty if it is not said.
    pub(crate) run: &'a str,
    /// None if the server itself sends again what a log has: nobody sees that as a robot.
    pub(crate) opener: Option<Opener>,
}
