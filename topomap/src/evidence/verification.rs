//! When does geometry agree that two frames show the same place?

use super::candidate::Candidate;
use super::placement::Placement;
use super::probability::ProbabilityWeights;
use super::two_view::{TwoView, ViewMotion};
use super::verdict::{Bound, Check, Quantity, Verdict};
use crate::metric::PlaceSpacing;

/// How closures are verified.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum VerificationMethod {
    /// Not at all: the posterior decides alone.
    None,
    /// By a motion in the image plane, x' = s R x + t: the camera is back very close.
    #[default]
    Similarity,
    /// By epipolar geometry: the camera may have moved sideways, if the scene has depth.
    Epipolar,
}

impl VerificationMethod {
    /// Whether geometry has a say at all.
    #[must_use]
    pub fn verifies(self) -> bool {
        match self {
            VerificationMethod::None => false,
            VerificationMethod::Similarity | VerificationMethod::Epipolar => true,
        }
    }
}

/// What a closure has to show; every value is checked by [`crate::mapper::Mapper::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VerificationSettings {
    /// How closures are verified.
    pub method: VerificationMethod,
    /// Posterior from which a place is compared, in [0, 1]. Geometry is worth far more than the
    /// words that the posterior is made of, so the default compares the most probable places
    /// however improbable they are.
    pub min_posterior: f64,
    /// Fewest inliers, at least 1.
    pub min_inliers: u32,
    /// Largest |rotation|, in radians, above 0.
    pub max_rotation_rad: f64,
    /// Largest |ln s|, above 0.
    pub max_ln_scale: f64,
    /// Largest |t|, in image widths, above 0; infinite where a robot steers by the shift.
    pub max_translation_widths: f64,
    /// What the probability of a candidate is made of.
    pub weights: ProbabilityWeights,
    /// Earlier frames of the session whose matches speak for those near them; 0 lets each frame
    /// stand alone.
    pub consistency_frames: u64,
}

impl Default for VerificationSettings {
    fn default() -> Self {
        Self {
            method: VerificationMethod::default(),
            min_posterior: 0.0,
            min_inliers: 8,
            max_rotation_rad: 0.5,
            max_ln_scale: 0.8,
            max_translation_widths: 0.5,
            weights: ProbabilityWeights::default(),
            consistency_frames: 8,
        }
    }
}

/// A setting of the verification is out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum VerificationError {
    /// The least posterior is no probability.
    #[error(
        "the posterior from which places are verified must lie in 0 to 1, not {value}; 0 is a good start"
    )]
    MinPosterior {
        /// The value given.
        value: f64,
    },
    /// Without inliers nothing is verified.
    #[error("a verified closure needs at least 1 inlier; 8 is a good start")]
    MinInliers,
    /// A bound that nothing could keep.
    #[error(
        "the verification's {quantity} must be bounded by a number above 0, not {value}; leave it out for the default"
    )]
    Bound {
        /// What is bounded.
        quantity: Quantity,
        /// The value given.
        value: f64,
    },
    /// A memory without bound.
    #[error(
        "matches of {value} frames are too many to remember; use at most {max}",
        max = VerificationSettings::MAX_CONSISTENCY_FRAMES
    )]
    ConsistencyFrames {
        /// The value given.
        value: u64,
    },
}

impl VerificationSettings {
    /// Places that a frame is compared with at most.
    pub const MAX_CANDIDATES: usize = 8;

    /// Features of known depth that have to agree where the robot is.
    pub const MIN_PLACED_INLIERS: u32 = 16;

    /// Most earlier frames that may be remembered.
    pub const MAX_CONSISTENCY_FRAMES: u64 = 100;

    /// No verification.
    #[must_use]
    pub fn none() -> Self {
        Self { method: VerificationMethod::None, ..Self::default() }
    }

    /// # Errors
    /// [`VerificationError`] if a setting is out of range.
    pub fn check(&self) -> Result<(), VerificationError> {
        if !(0.0..=1.0).contains(&self.min_posterior) {
            return Err(VerificationError::MinPosterior { value: self.min_posterior });
        }
        if self.min_inliers == 0 {
            return Err(VerificationError::MinInliers);
        }
        let bounds = [
            (Quantity::RotationRad, self.max_rotation_rad),
            (Quantity::LnScale, self.max_ln_scale),
            (Quantity::TranslationWidths, self.max_translation_widths),
        ];
        if let Some(&(quantity, value)) = bounds.iter().find(|(_, value)| value.is_nan() || *value <= 0.0) {
            return Err(VerificationError::Bound { quantity, value });
        }
        if self.consistency_frames > Self::MAX_CONSISTENCY_FRAMES {
            return Err(VerificationError::ConsistencyFrames { value: self.consistency_frames });
        }
        Ok(())
    }

    /// Whether the candidate is the same place, with each number and what is asked of it, where
    /// places are `spacing` apart. `closure_threshold` is the probability from which a loop is
    /// closed, see [`crate::settings::MapperSettings::closure_threshold`]. Where a frame has no
    /// keypoints, that is the posterior: words decide alone.
    #[must_use]
    pub fn verdict(&self, candidate: &Candidate, closure_threshold: f64, spacing: &PlaceSpacing) -> Verdict {
        let bound = Bound::AtLeast(closure_threshold);
        let reaches = |quantity| Check { quantity, value: candidate.probability(), bound };
        let checks = match &candidate.view {
            Some(view) => {
                let mut checks = self.of_one_place(view, spacing);
                checks.push(reaches(Quantity::Probability));
                checks
            }
            None => vec![reaches(Quantity::Posterior)],
        };
        Verdict { checks }
    }

    fn placed_inliers(value: u32) -> Check {
        let bound = Bound::AtLeast(f64::from(Self::MIN_PLACED_INLIERS));
        Check { quantity: Quantity::PlacedInliers, value: f64::from(value), bound }
    }

    /// What two views have to show for the robot to have been at one place, where places are
    /// `spacing` apart: that they are of one scene and, where structure measures it, how near to
    /// each other they were taken.
    #[must_use]
    pub fn of_one_place(&self, view: &TwoView, spacing: &PlaceSpacing) -> Vec<Check> {
        let mut checks = self.of_one_scene(view);
        if let Placement::At { pose, inliers: _ } = &view.placement {
            let pose = pose.pose();
            let distance_m = pose.x_m().hypot(pose.y_m());
            let reach = spacing.reach();
            checks.push(at_most(Quantity::DistanceM, distance_m, reach.distance_m));
            checks.push(at_most(Quantity::HeadingRad, pose.heading_rad().abs(), reach.angle_rad));
        }
        checks
    }

    /// What two views of one scene have to show, whichever scene it is, from wherever they see it.
    #[must_use]
    pub fn of_one_scene(&self, view: &TwoView) -> Vec<Check> {
        let inliers = Check {
            quantity: Quantity::Inliers,
            value: f64::from(view.inliers),
            bound: Bound::AtLeast(f64::from(self.min_inliers)),
        };
        match &view.placement {
            Placement::Unknown => {}
            Placement::Nowhere => return vec![inliers, Self::placed_inliers(0)],
            Placement::At { pose: _, inliers: placed } => {
                return vec![inliers, Self::placed_inliers(*placed)];
            }
        }
        let rotation = |radians: f64| at_most(Quantity::RotationRad, radians.abs(), self.max_rotation_rad);
        match view.motion {
            Some(ViewMotion::Similarity(motion)) => {
                let shift = motion.translation_length_widths();
                vec![
                    inliers,
                    rotation(motion.rotation_rad),
                    at_most(Quantity::LnScale, motion.ln_scale.abs(), self.max_ln_scale),
                    at_most(Quantity::TranslationWidths, shift, self.max_translation_widths),
                ]
            }
            Some(ViewMotion::Essential { rotation: turned, .. }) => vec![inliers, rotation(turned.angle())],
            Some(ViewMotion::Fundamental(_)) | None => vec![inliers],
        }
    }
}

fn at_most(quantity: Quantity, value: f64, most: f64) -> Check {
    Check { quantity, value, bound: Bound::AtMost(most) }
}
