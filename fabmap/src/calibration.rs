//! Likelihoods that deserve to be compared: detector rates and an exponent, learnt from the model's
//! own training images.
//!
//! Words are less independent than the Chow-Liu model has it, so that plain likelihoods lie too
//! far apart, and posteriors are near 0 or 1 and often wrong. Raising
//! every likelihood to a power below 1 (a power posterior) is the smallest cure: one number, and it
//! leaves the order of places within a frame as it is.
//!
//! [`learn`] needs no truth: training images that follow each other and overlap are held to be two
//! looks at one place, the far ones to be other places. From them it stages revisits and new
//! places, and takes what gives the right answers the highest probability.

mod learning;
mod pairs;

pub use crate::evidence_exponent::{EvidenceExponent, EvidenceExponentError};
pub use learning::{Calibration, LearnError, Rates, calibrate, learn};
