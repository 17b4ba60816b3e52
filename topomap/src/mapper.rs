//! The story of a frame, as values: recognise, propose, decide; then fold what was decided into the
//! map.
//!
//! 1. [`Mapper::recognize`] refuses bad frames, recognises, and names the earlier frames whose
//!    words are wanted.
//! 2. [`Recognized::propose`] takes those and names the views that are to be compared.
//! 3. [`Proposed::decide`] takes the comparisons and makes the event that the log keeps.
//! 4. [`Mapper::apply`] folds the event into the map.
//!
//! The caller reads and compares in between; nothing here calls it. [`crate::in_memory`] does so
//! for logs in memory.

mod candidates;
mod correcting;
mod deciding;
mod errors;
mod frame;
mod gates;
mod in_step;
mod link_prior;
mod localizer;
mod measuring;
mod odometry_prior;
mod poses;
mod proposing;
mod reach;
mod recognizing;
mod sight;
mod state;
mod support;

pub use candidates::AS_GOOD;
pub use correcting::{Heard, Said, SamePlace, Visit};
pub use deciding::Decided;
pub use errors::{CorrectError, FoldError, FrameError, MeasureError, RestoreError};
pub use frame::FrameInput;
pub use gates::{Gate, Gates};
pub use localizer::{Localizer, Queried};
pub use measuring::Measurement;
pub use poses::MapPose;
pub use proposing::{Comparisons, Proposed, WantedViews};
pub use reach::OutOfReach;
pub use recognizing::{EarlierFrame, EarlierFrames, Recognized};
pub use state::Mapper;
