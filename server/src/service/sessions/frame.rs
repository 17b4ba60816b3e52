//! A frame as it comes from a robot.

use topomap::metric::Odometry;

use crate::error::ServiceError;
use crate::ingest::content::Content;
use crate::open_map::Opener;

/// A frame as a robot sends it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) sequence: u64,
    pub(crate) stamp_ns: i64,
    pub(crate) content: Content,
    pub(crate) odometry: Option<Odometry>,
}

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
        Ok(())
    }
}

/// What a robot says of itself.
#[derive(Clone, Debug)]
pub(crate) struct Robot<'a> {
    /// Of the words that it sends; empty if it sends images.
    pub(crate) words_hash: &'a str,
    /// Tells the runs apart of a robot that localizes by one name; empty if it is not said.
    pub(crate) run: &'a str,
    pub(crate) opener: Opener,
}
