//! What speaks for two frames showing the same place.
//!
//! The holder of keypoints compares two views and says what was found ([`TwoView`]); here is what
//! that is worth ([`Candidate::evidence`]), how probable it makes the place beside what look-alikes
//! show ([`ProbabilityWeights`]), whether it is enough
//! ([`VerificationSettings::verdict`]) and what it measures ([`ClosureNoise`]).

mod candidate;
mod closure_noise;
mod look_alikes;
mod placement;
mod probability;
mod turned_view;
mod two_view;
mod verdict;
mod verification;

pub use candidate::{Candidate, Match};
pub use closure_noise::ClosureNoise;
pub use look_alikes::LookAlikesSeen;
pub(crate) use look_alikes::{Compared, of_kind, of_unknown_kind, over_frames, unknown_over_frames};
pub use placement::Placement;
pub use probability::{Contributions, ProbabilityWeights};
pub use turned_view::TurnedView;
pub(crate) use two_view::CandidateForm;
pub use two_view::{Similarity, TwoView, ViewMotion};
pub use verdict::{Bound, Check, Quantity, Verdict};
pub use verification::{VerificationError, VerificationMethod, VerificationSettings};
