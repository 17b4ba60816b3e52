//! What speaks for two frames showing the same place.
//!
//! The holder of keypoints compares two views and says what was found ([`TwoView`]); here is what
//! that is worth ([`Candidate::evidence`]), whether it is enough
//! ([`VerificationSettings::verdict`]) and what it measures ([`ClosureNoise`]).

mod candidate;
mod closure_noise;
mod placement;
mod turned_view;
mod two_view;
mod verdict;
mod verification;

pub use candidate::{Candidate, Match};
pub use closure_noise::ClosureNoise;
pub use placement::Placement;
pub use turned_view::TurnedView;
pub(crate) use two_view::CandidateForm;
pub use two_view::{Similarity, TwoView, ViewMotion};
pub use verdict::{Bound, Check, Quantity, Verdict};
pub use verification::{VerificationError, VerificationMethod, VerificationSettings};
