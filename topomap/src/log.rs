//! What a map's log holds: facts and decisions, never what can be computed from them.

mod correction;
mod encoding;
mod event;
mod link;
mod moved_place;

pub use correction::{
    Confirmation, Correction, CorrectionEvent, Relinked, Resumed, Stood, Undoing, Withdrawal,
};
pub use event::{Decision, FrameEvent, MapEvent, MeasuredEvent, Reason};
pub use link::{Link, LinkKind};
pub(crate) use moved_place::MovedPlace;
