//! Frames decided in one call where log and views are in memory: what is wanted is fetched,
//! compared and handed in.

use fabmap::observation::Observation;
use fabmap::recognizer::{Stage, StageObserver};

use crate::evidence::{TurnedView, TwoView};
use crate::ids::FrameId;
use crate::log::MapEvent;
use crate::mapper::{
    Comparisons, Decided, EarlierFrame, EarlierFrames, FrameError, FrameInput, Localizer, Mapper, Proposed,
    Queried, Recognized, WantedViews,
};

/// Compares the frame in hand with earlier ones.
pub trait Views {
    /// What geometry finds between the current frame and `earlier`; `None` if one of the two has no
    /// keypoints.
    fn compare(&self, earlier: FrameId) -> Option<TwoView>;

    /// What the current frame and `earlier` have in common if the robot has at most turned on the
    /// spot; `None` if one of the two does not show all around.
    fn turned(&self, _earlier: FrameId) -> Option<TurnedView> {
        None
    }

    /// Focal length of the current frame's camera along x, in image widths; `None` if its model is
    /// not known.
    fn focal_length_widths(&self) -> Option<f64>;
}

/// There are no keypoints at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoViews;

impl Views for NoViews {
    fn compare(&self, _earlier: FrameId) -> Option<TwoView> {
        None
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

/// Decides a frame of a session of the log; see [`Mapper::recognize`].
///
/// # Errors
/// [`FrameError`] if the frame cannot be taken.
pub fn decide(
    mapper: &Mapper,
    log: &[MapEvent],
    input: FrameInput,
    views: &impl Views,
    observer: &mut dyn StageObserver,
) -> Result<Decided, FrameError> {
    let (proposed, comparisons) = compared(mapper.recognize(input, observer)?, log, views);
    if mapper.verifies() {
        observer.completed(Stage::Verification);
    }
    proposed.decide(&comparisons)
}

/// Decides a frame of a robot that leaves nothing behind; see [`Mapper::localize`].
///
/// # Errors
/// [`FrameError`] if the frame cannot be taken.
pub fn localize(
    mapper: &Mapper,
    localizer: &Localizer,
    log: &[MapEvent],
    input: FrameInput,
    views: &impl Views,
) -> Result<Decided, FrameError> {
    let (proposed, comparisons) = compared(mapper.localize(localizer, input, &mut ())?, log, views);
    proposed.decide(&comparisons)
}

/// Where one observation was made; see [`Mapper::query`].
///
/// # Errors
/// [`FrameError::ForeignWord`].
pub fn query(
    mapper: &Mapper,
    log: &[MapEvent],
    observation: &Observation,
    views: &impl Views,
) -> Result<Queried, FrameError> {
    let (proposed, comparisons) = compared(mapper.query(observation.clone(), &mut ())?, log, views);
    Ok(proposed.answer(&comparisons))
}

/// Fetches what a recognised frame wants of the log, and compares.
pub fn compared<'a>(
    recognized: Recognized<'a>,
    log: &[MapEvent],
    views: &impl Views,
) -> (Proposed<'a>, Comparisons) {
    let earlier: EarlierFrames =
        recognized.wanted_frames().filter_map(|frame| Some((frame, earlier_frame(log, frame)?))).collect();
    let proposed = recognized.propose(&earlier);
    let WantedViews { compared, turned, .. } = proposed.wanted_views();
    let compare = |&frame: &FrameId| Some((frame, views.compare(frame)?));
    let comparisons = Comparisons {
        views: compared.iter().filter_map(compare).collect(),
        turned: turned.and_then(|frame| views.turned(frame)),
        focal_length_widths: views.focal_length_widths(),
    };
    (proposed, comparisons)
}

/// What a frame of the log showed; `None` if there is no such frame.
#[must_use]
pub fn earlier_frame(log: &[MapEvent], frame: FrameId) -> Option<EarlierFrame> {
    match log.get(usize::try_from(frame).ok()?)? {
        MapEvent::Frame(event) => Some(EarlierFrame { observation: event.observation.clone(), at: event.at }),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    }
}
