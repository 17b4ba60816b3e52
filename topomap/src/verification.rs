//! When does geometry agree that two frames show the same place?
//!
//! Whoever holds keypoints compares two views and says what was found ([`TwoView`]); here is what that is
//! worth ([`Candidate::evidence`]) and whether it is enough ([`VerificationSettings::verdict`]).

use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::{Quaternion, UnitQuaternion, UnitVector3, Vector3};

use crate::event::{FrameId, Match, decode_option, encode_option};
use crate::mapper::ArchiveError;
use crate::standing::TurnedView;

/// Compares the frame that is being decided with earlier ones; whoever keeps keypoints implements it.
pub trait Views {
    /// What geometry finds between the current frame and `earlier`; `None` if one of the two has no
    /// keypoints.
    ///
    /// # Errors
    /// [`ArchiveError`] if the earlier one cannot be read now.
    fn compare(&self, earlier: FrameId) -> Result<Option<TwoView>, ArchiveError>;

    /// The same for several earlier frames, in their order; whoever can compares them side by side.
    ///
    /// # Errors
    /// [`ArchiveError`] if one cannot be read now.
    fn compare_all(&self, earlier: &[FrameId]) -> Result<Vec<Option<TwoView>>, ArchiveError> {
        earlier.iter().map(|&frame| self.compare(frame)).collect()
    }

    /// What the current frame and `earlier` have in common if the robot has at most turned on the spot; `None` if one of the
    /// two does not show all around.
    ///
    /// # Errors
    /// [`ArchiveError`] if the earlier one cannot be read now.
    fn turned(&self, _earlier: FrameId) -> Result<Option<TurnedView>, ArchiveError> {
        Ok(None)
    }

    /// Focal length of the current frame's camera along x, in image widths; `None` if its model is not known.
    fn focal_length_widths(&self) -> Option<f64>;
}

/// There are no keypoints at all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoViews;

impl Views for NoViews {
    fn compare(&self, _earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        Ok(None)
    }

    fn focal_length_widths(&self) -> Option<f64> {
        None
    }
}

/// What geometry found between the current frame and an earlier one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoView {
    /// Features that look alike.
    pub matches: u32,
    /// Those that one motion explains.
    pub inliers: u32,
    /// Those of the inliers that look like nothing else in either view.
    pub distinct_inliers: u32,
    /// The motion, refitted to the inliers; `None` if no motion explains any.
    pub motion: Option<Motion>,
}

/// How the view has moved from the earlier frame to the current one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// In the image plane.
    Similarity(Similarity),
    /// In space, by a camera of known intrinsics: x_current = R x_earlier + t, |t| unknown.
    Essential {
        /// R.
        rotation: UnitQuaternion<f64>,
        /// t / |t|.
        direction: UnitVector3<f64>,
    },
    /// In space, by an unknown camera: rows of F with x_currentᵀ F x_earlier = 0, of norm 1, in image widths
    /// from the image's centre.
    Fundamental([[f64; 3]; 3]),
}

/// x_current = s R x_earlier + t about the images' centres, in image widths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Angle of R in (-π, π], from x to the right towards y down.
    pub rotation_rad: f64,
    /// ln s: above 0 if the current view is nearer.
    pub ln_scale: f64,
    /// t: to the right and down, in image widths.
    pub translation_widths: [f64; 2],
}

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
    /// Posterior from which a place is compared, in [0, 1]. Geometry is worth far more than the words that the
    /// posterior is made of, so the default compares the most probable places however improbable they are.
    pub min_posterior: f64,
    /// Fewest inliers, at least 1.
    pub min_inliers: u32,
    /// Largest |rotation|, in radians, above 0.
    pub max_rotation_rad: f64,
    /// Largest |ln s|, above 0.
    pub max_ln_scale: f64,
    /// Largest |t|, in image widths, above 0; infinite where a robot steers by the shift.
    pub max_translation_widths: f64,
    /// Least [`Candidate::evidence`] for a closure that the words alone are not sure of, above 0. Offices whose
    /// floors look alike reach 260.
    pub min_evidence: f64,
    /// Earlier frames of the session whose matches speak for those near them; 0 lets each frame stand alone.
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
            min_evidence: 350.0,
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
            (Quantity::Evidence, self.min_evidence),
        ];
        if let Some(&(quantity, value)) = bounds.iter().find(|(_, value)| value.is_nan() || *value <= 0.0) {
            return Err(VerificationError::Bound { quantity, value });
        }
        if self.consistency_frames > Self::MAX_CONSISTENCY_FRAMES {
            return Err(VerificationError::ConsistencyFrames { value: self.consistency_frames });
        }
        Ok(())
    }

    /// Whether the candidate is the same place, with each number and what is asked of it. `closure_threshold` is the
    /// posterior from which words are sure enough, see [`crate::mapper::MapperSettings::closure_threshold`]. Where a
    /// frame has no keypoints, they decide alone.
    #[must_use]
    pub fn verdict(&self, candidate: &Candidate, closure_threshold: f64) -> Verdict {
        let at_least = |quantity, value, least| Check { quantity, value, bound: Bound::AtLeast(least) };
        let posterior = at_least(Quantity::Posterior, candidate.matched.posterior, closure_threshold);
        match &candidate.view {
            Some(view) => Verdict {
                all: self.of_one_scene(view),
                one: vec![at_least(Quantity::Evidence, candidate.evidence(), self.min_evidence), posterior],
            },
            None => Verdict { all: Vec::new(), one: vec![posterior] },
        }
    }

    /// What two views of one scene have to show, whichever scene it is.
    #[must_use]
    pub fn of_one_scene(&self, view: &TwoView) -> Vec<Check> {
        let at_most = |quantity, value: f64, most| Check { quantity, value, bound: Bound::AtMost(most) };
        let inliers = Check {
            quantity: Quantity::Inliers,
            value: f64::from(view.inliers),
            bound: Bound::AtLeast(f64::from(self.min_inliers)),
        };
        let rotation = |radians: f64| at_most(Quantity::RotationRad, radians.abs(), self.max_rotation_rad);
        match view.motion {
            Some(Motion::Similarity(motion)) => {
                let shift = motion.translation_length_widths();
                vec![
                    inliers,
                    rotation(motion.rotation_rad),
                    at_most(Quantity::LnScale, motion.ln_scale.abs(), self.max_ln_scale),
                    at_most(Quantity::TranslationWidths, shift, self.max_translation_widths),
                ]
            }
            Some(Motion::Essential { rotation: turned, .. }) => vec![inliers, rotation(turned.angle())],
            Some(Motion::Fundamental(_)) | None => vec![inliers],
        }
    }
}

impl Similarity {
    /// |t|, in image widths.
    #[must_use]
    pub fn translation_length_widths(&self) -> f64 {
        self.translation_widths[0].hypot(self.translation_widths[1])
    }
}

impl TwoView {
    /// What this pair of frames says by itself, in inliers: an inlier that looks like others counts half, and
    /// those that chance alone brings together are taken off. 0 if there is nothing to say.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        let by_chance = match self.motion {
            None => return 0.0,
            Some(Motion::Similarity(_)) => SIMILAR_BY_CHANCE,
            Some(Motion::Essential { .. } | Motion::Fundamental(_)) => EPIPOLAR_BY_CHANCE,
        };
        ((f64::from(self.inliers) + f64::from(self.distinct_inliers)) / 2.0 - by_chance).max(0.0)
    }

    /// How far the motion moves the points of an image, root mean square over it, where it moves them within the image. A
    /// robot that has driven on down a corridor sees its end larger and not elsewhere: |t| alone would not tell.
    pub(crate) fn distance_widths(&self) -> f64 {
        match self.motion {
            Some(Motion::Similarity(Similarity { rotation_rad, ln_scale, translation_widths: [x, y] })) => {
                let scale = ln_scale.exp();
                let about_centre = scale * scale - 2.0 * scale * rotation_rad.cos() + 1.0;
                (x * x + y * y + MEAN_SQUARED_RADIUS_WIDTHS * about_centre).sqrt()
            }
            Some(Motion::Essential { .. } | Motion::Fundamental(_)) | None => 0.0,
        }
    }
}

/// Of the points of an image about its centre, three high for every four wide: (1² + (3/4)²) / 12.
const MEAN_SQUARED_RADIUS_WIDTHS: f64 = 0.13;

/// Inliers, the ambiguous ones at half, that the best similarity finds between images of different places:
/// the median over the development sequences is 1 to 3.
const SIMILAR_BY_CHANCE: f64 = 3.0;

/// The same for a fundamental matrix, which has seven degrees of freedom in place of four, and constrains a
/// match to a line in place of a point.
const EPIPOLAR_BY_CHANCE: f64 = 6.0;

/// Evidence of a pair of frames that lets the frames before speak in full. Recall at full precision on the
/// development sequences is the same from 10 to 30.
const ENOUGH: f64 = 20.0;

/// a, b, c of [`Candidate::probability`]: logistic regression over the proposals of the development sequences,
/// each sequence of the same weight.
const LOG_ODDS_WEIGHTS: [f64; 3] = [-0.80, 0.68, 0.17];

/// A place that a frame was compared with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The place, and the frame of it that was compared.
    pub matched: Match,
    /// What geometry found; `None` if one of the two frames has no keypoints.
    pub view: Option<TwoView>,
    /// What the session's last frames said for a place near this one, in inliers.
    pub support: f64,
}

#[cfg(test)]
impl Candidate {
    /// A view that a good deal speaks for, whose image has grown and shifted by so much.
    pub(crate) fn shifted(ln_scale: f64, shift_widths: f64) -> Self {
        let motion = Similarity { rotation_rad: 0.0, ln_scale, translation_widths: [shift_widths, 0.0] };
        let motion = Some(Motion::Similarity(motion));
        let view = TwoView { matches: 90, inliers: 80, distinct_inliers: 80, motion };
        let matched = Match { place: 0, posterior: 1.0, log_odds: 9.0, frame: 1 };
        Self { matched, view: Some(view), support: 0.0 }
    }
}

impl Candidate {
    /// min(1, e / 20) (e + support) with e the pair's own evidence, in inliers: what this frame and the last ones
    /// say together, once this one says enough. A robot that has just left its old way still has the support, and
    /// no match.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        let own = self.own_evidence();
        (own / ENOUGH).min(1.0) * (own + self.support)
    }

    /// See [`TwoView::evidence`].
    #[must_use]
    pub fn own_evidence(&self) -> f64 {
        self.view.as_ref().map_or(0.0, TwoView::evidence)
    }

    /// What proposals are ranked by: first those that geometry has evidence for, by that; then all others by the
    /// log-odds of their posterior, less [`Candidate::UNVERIFIED`].
    #[must_use]
    pub fn score(&self) -> f64 {
        let evidence = self.evidence();
        if evidence > 0.0 { evidence } else { self.matched.log_odds - Self::UNVERIFIED }
    }

    /// That both frames show the same place, in [0, 1], by words and geometry together:
    /// ln [p / (1 - p)] = a + b ln (1 + evidence) + c ln [posterior / (1 - posterior)]. Without keypoints the
    /// posterior itself.
    #[must_use]
    pub fn probability(&self) -> f64 {
        if self.view.is_none() {
            return self.matched.posterior;
        }
        let [offset, of_evidence, of_posterior] = LOG_ODDS_WEIGHTS;
        let log_odds = offset + of_evidence * self.evidence().ln_1p() + of_posterior * self.matched.log_odds;
        1.0 / (1.0 + (-log_odds).exp())
    }

    /// More than any log-odds.
    pub const UNVERIFIED: f64 = 1000.0;
}

/// Whether a candidate is the same place, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// What must hold altogether, in the order of checking: both views may be of one scene.
    pub all: Vec<Check>,
    /// Of these one must hold: look-alike scenes pass for one too, so geometry has to be sure, or the words.
    pub one: Vec<Check>,
}

/// One number of a verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Check {
    /// What was looked at.
    pub quantity: Quantity,
    /// What was found.
    pub value: f64,
    /// What is asked for.
    pub bound: Bound,
}

/// What is asked of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// It must not be less.
    AtLeast(f64),
    /// It must not be more.
    AtMost(f64),
}

/// What a verdict looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quantity {
    /// [`TwoView::inliers`].
    Inliers,
    /// [`Candidate::evidence`].
    Evidence,
    /// Of the place.
    Posterior,
    /// |rotation|, in the image plane or in space, in radians.
    RotationRad,
    /// |ln s|.
    LnScale,
    /// |t|, in image widths.
    TranslationWidths,
}

impl std::fmt::Display for Quantity {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Quantity::Inliers => "inliers",
            Quantity::Evidence => "evidence",
            Quantity::Posterior => "posterior",
            Quantity::RotationRad => "rotation",
            Quantity::LnScale => "scale",
            Quantity::TranslationWidths => "translation",
        })
    }
}

impl Verdict {
    /// Whether it is accepted.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.failed().is_none()
    }

    /// The first check for which it is refused.
    #[must_use]
    pub fn failed(&self) -> Option<&Check> {
        let unmet = || if self.one.iter().any(Check::passed) { None } else { self.one.first() };
        self.all.iter().find(|check| !check.passed()).or_else(unmet)
    }
}

impl Check {
    /// Whether the value keeps to the bound.
    #[must_use]
    pub fn passed(&self) -> bool {
        match self.bound {
            Bound::AtLeast(least) => self.value >= least,
            Bound::AtMost(most) => self.value <= most,
        }
    }
}

impl Candidate {
    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Candidate { matched, view, support } = self;
        matched.encode(writer);
        encode_option(view.as_ref(), writer, TwoView::encode);
        writer.f64(*support);
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Candidate {
            matched: Match::decode(reader)?,
            view: decode_option(reader, TwoView::decode)?,
            support: not_negative(reader.f64()?)?,
        })
    }
}

impl TwoView {
    fn encode(&self, writer: &mut Writer) {
        let TwoView { matches, inliers, distinct_inliers, motion } = self;
        for count in [matches, inliers, distinct_inliers] {
            writer.varint(u64::from(*count));
        }
        encode_option(motion.as_ref(), writer, Motion::encode);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (matches, inliers, distinct_inliers) =
            (reader.varint_u32()?, reader.varint_u32()?, reader.varint_u32()?);
        if inliers > matches || distinct_inliers > inliers {
            return Err(DecodeError::invalid(format_args!(
                "{distinct_inliers} distinct of {inliers} inliers of {matches} matches"
            )));
        }
        Ok(TwoView { matches, inliers, distinct_inliers, motion: decode_option(reader, Motion::decode)? })
    }
}

const SIMILARITY: u8 = 0;
const ESSENTIAL: u8 = 1;
const FUNDAMENTAL: u8 = 2;

impl Motion {
    fn encode(&self, writer: &mut Writer) {
        let (kind, values) = match self {
            Motion::Similarity(Similarity { rotation_rad, ln_scale, translation_widths: [x, y] }) => {
                (SIMILARITY, vec![*rotation_rad, *ln_scale, *x, *y])
            }
            Motion::Essential { rotation, direction } => {
                (ESSENTIAL, rotation.coords.iter().chain(direction.iter()).copied().collect())
            }
            Motion::Fundamental(rows) => (FUNDAMENTAL, rows.concat()),
        };
        writer.u8(kind);
        values.into_iter().for_each(|value| writer.f64(value));
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let kind = reader.u8()?;
        let mut value = || finite(reader.f64()?);
        match kind {
            SIMILARITY => Ok(Motion::Similarity(Similarity {
                rotation_rad: value()?,
                ln_scale: value()?,
                translation_widths: [value()?, value()?],
            })),
            ESSENTIAL => {
                let (x, y, z, w) = (value()?, value()?, value()?, value()?);
                let (rotation, direction) =
                    (Quaternion::new(w, x, y, z), Vector3::new(value()?, value()?, value()?));
                let is_unit = |norm: f64| (norm - 1.0).abs() < 1e-6;
                if !is_unit(rotation.norm()) || !is_unit(direction.norm()) {
                    return Err(DecodeError::invalid(
                        "a motion whose rotation or direction is not of length 1",
                    ));
                }
                Ok(Motion::Essential {
                    rotation: UnitQuaternion::new_unchecked(rotation),
                    direction: UnitVector3::new_unchecked(direction),
                })
            }
            FUNDAMENTAL => {
                let mut rows = [[0.0; 3]; 3];
                for entry in rows.as_flattened_mut() {
                    *entry = value()?;
                }
                Ok(Motion::Fundamental(rows))
            }
            other => Err(DecodeError::invalid(format_args!("motion kind {other}"))),
        }
    }
}

fn finite(value: f64) -> Result<f64, DecodeError> {
    if value.is_finite() { Ok(value) } else { Err(DecodeError::invalid("a motion that is not finite")) }
}

pub(crate) fn not_negative(value: f64) -> Result<f64, DecodeError> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(DecodeError::invalid(format_args!("evidence of {value}")))
    }
}
