//! What geometry finds between two views, and what that is worth.

use fabmap::codec::{DecodeError, Reader, Writer};
use nalgebra::{Quaternion, UnitQuaternion, UnitVector3, Vector3};

use super::placement::Placement;
use crate::bytes::{decode_option, encode_option, finite};

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
    pub motion: Option<ViewMotion>,
    /// Where features of known depth put the robot.
    pub placement: Placement,
}

/// How the view has moved from the earlier frame to the current one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ViewMotion {
    /// In the image plane.
    Similarity(Similarity),
    /// In space, by a camera of known intrinsics: x_current = R x_earlier + t, |t| unknown.
    Essential {
        /// R.
        rotation: UnitQuaternion<f64>,
        /// t / |t|.
        direction: UnitVector3<f64>,
    },
    /// In space, by an unknown camera: rows of F with x_currentᵀ F x_earlier = 0, of norm 1, in
    /// image widths from the image's centre.
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

impl Similarity {
    /// |t|, in image widths.
    #[must_use]
    pub fn translation_length_widths(&self) -> f64 {
        self.translation_widths[0].hypot(self.translation_widths[1])
    }
}

impl TwoView {
    /// What this pair of frames says by itself, in inliers: an inlier that looks like others counts
    /// half, and those that chance alone brings together are taken off. 0 if there is nothing to
    /// say.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        let by_chance = match self.motion {
            None => return 0.0,
            Some(ViewMotion::Similarity(_)) => SIMILAR_BY_CHANCE,
            Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) => EPIPOLAR_BY_CHANCE,
        };
        ((f64::from(self.inliers) + f64::from(self.distinct_inliers)) / 2.0 - by_chance).max(0.0)
    }

    /// How far the motion moves the points of an image, root mean square over it, where it moves
    /// them within the image. A robot that has driven on down a corridor sees its end larger and
    /// not elsewhere: |t| alone would not tell.
    pub(crate) fn distance_widths(&self) -> f64 {
        match self.motion {
            Some(ViewMotion::Similarity(Similarity {
                rotation_rad,
                ln_scale,
                translation_widths: [x, y],
            })) => {
                let scale = ln_scale.exp();
                let about_centre = scale * scale - 2.0 * scale * rotation_rad.cos() + 1.0;
                (x * x + y * y + MEAN_SQUARED_RADIUS_WIDTHS * about_centre).sqrt()
            }
            Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => 0.0,
        }
    }
}

/// Of the points of an image about its centre, three high for every four wide: (1² + (3/4)²) / 12.
const MEAN_SQUARED_RADIUS_WIDTHS: f64 = 0.13;

/// Inliers, the ambiguous ones at half, that the best similarity finds between images of different
/// places: the median over the development sequences is 1 to 3.
const SIMILAR_BY_CHANCE: f64 = 3.0;

/// The same for a fundamental matrix, which has seven degrees of freedom in place of four, and
/// constrains a match to a line in place of a point.
const EPIPOLAR_BY_CHANCE: f64 = 6.0;

impl TwoView {
    pub(super) fn encode(&self, writer: &mut Writer) {
        let TwoView { matches, inliers, distinct_inliers, motion, placement } = self;
        for count in [matches, inliers, distinct_inliers] {
            writer.varint(u64::from(*count));
        }
        encode_option(motion.as_ref(), writer, ViewMotion::encode);
        placement.encode(writer);
    }

    pub(super) fn decode(form: CandidateForm, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (matches, inliers, distinct_inliers) =
            (reader.varint_u32()?, reader.varint_u32()?, reader.varint_u32()?);
        if inliers > matches || distinct_inliers > inliers {
            return Err(DecodeError::invalid(format_args!(
                "{distinct_inliers} distinct of {inliers} inliers of {matches} matches"
            )));
        }
        let motion = decode_option(reader, ViewMotion::decode)?;
        let placement = match form {
            CandidateForm::WithoutPlacement => Placement::Unknown,
            CandidateForm::WithPlacement | CandidateForm::WithProbability => Placement::decode(reader)?,
        };
        Ok(TwoView { matches, inliers, distinct_inliers, motion, placement })
    }
}

/// Which byte form a log of some version has candidates in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CandidateForm {
    WithoutPlacement,
    WithPlacement,
    WithProbability,
}

const SIMILARITY: u8 = 0;
const ESSENTIAL: u8 = 1;
const FUNDAMENTAL: u8 = 2;

impl ViewMotion {
    fn encode(&self, writer: &mut Writer) {
        let (kind, values) = match self {
            ViewMotion::Similarity(Similarity { rotation_rad, ln_scale, translation_widths: [x, y] }) => {
                (SIMILARITY, vec![*rotation_rad, *ln_scale, *x, *y])
            }
            ViewMotion::Essential { rotation, direction } => {
                (ESSENTIAL, rotation.coords.iter().chain(direction.iter()).copied().collect())
            }
            ViewMotion::Fundamental(rows) => (FUNDAMENTAL, rows.concat()),
        };
        writer.u8(kind);
        values.into_iter().for_each(|value| writer.f64(value));
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let kind = reader.u8()?;
        let mut value = || finite(reader.f64()?);
        match kind {
            SIMILARITY => Ok(ViewMotion::Similarity(Similarity {
                rotation_rad: value()?,
                ln_scale: value()?,
                translation_widths: [value()?, value()?],
            })),
            ESSENTIAL => {
                let x = value()?;
                let y = value()?;
                let z = value()?;
                let w = value()?;
                let (rotation, direction) =
                    (Quaternion::new(w, x, y, z), Vector3::new(value()?, value()?, value()?));
                let is_unit = |norm: f64| (norm - 1.0).abs() < 1e-6;
                if !is_unit(rotation.norm()) || !is_unit(direction.norm()) {
                    return Err(DecodeError::invalid(
                        "a motion whose rotation or direction is not of length 1",
                    ));
                }
                Ok(ViewMotion::Essential {
                    rotation: UnitQuaternion::new_unchecked(rotation),
                    direction: UnitVector3::new_unchecked(direction),
                })
            }
            FUNDAMENTAL => {
                let mut rows = [[0.0; 3]; 3];
                for entry in rows.as_flattened_mut() {
                    *entry = value()?;
                }
                Ok(ViewMotion::Fundamental(rows))
            }
            other => Err(DecodeError::invalid(format_args!("motion kind {other}"))),
        }
    }
}
