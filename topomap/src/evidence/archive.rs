//! Earlier frames, for a search over all of a map.

use fabmap::observation::Observation;

use crate::ids::FrameId;
use crate::metric::RelativePose;

/// Gives back what earlier frames showed; whoever keeps the log implements it.
pub trait FrameArchive {
    /// The observation of a frame that a place learnt from; `None` if it is lost for good: the
    /// frame is then left out of the comparison.
    ///
    /// # Errors
    /// [`ArchiveError`] if it cannot be read now.
    fn observation(&self, frame: FrameId) -> Result<Option<Observation>, ArchiveError>;

    /// Where in its place's frame the robot was at that frame ([`crate::log::FrameEvent::at`]);
    /// `None` if that was not measured or is lost.
    ///
    /// # Errors
    /// [`ArchiveError`] if it cannot be read now.
    fn at(&self, frame: FrameId) -> Result<Option<RelativePose>, ArchiveError>;
}

/// An earlier frame could not be read back.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("frame {frame} of the map could not be read back: {why}; send the frame again")]
pub struct ArchiveError {
    /// The frame.
    pub frame: FrameId,
    /// What happened.
    pub why: String,
}
