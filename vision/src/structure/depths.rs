//! How far the features of a frame are.

use nalgebra::{Matrix2x5, Vector2, Vector3};
use topomap::metric::{RelativePose, median};

use super::motion::{Pair, Refined, refined};
use super::nodding::Motion;
use super::robot_camera::{RobotCamera, Sighted};
use super::turning::images_per_wheels;
use crate::depth::{InverseDepth, Structure};
use crate::feature_record::FeatureRecord;
use crate::matching::{Match as FeatureMatch, matches as feature_matches};

/// Beyond so many squared standard deviations of two degrees of freedom, one in a hundred, two
/// sights are not of one feature.
pub(super) const SAME_FEATURE_CHI_SQUARED: f64 = 9.21;

/// The same of one degree of freedom, for depths.
const SAME_DEPTH_CHI_SQUARED: f64 = 6.63;

/// Way below which two views have no parallax to speak of, in metres.
const LEAST_BASE_M: f64 = 0.05;

/// Steps in which a depth is found.
const STEPS: usize = 4;

/// Depth in metres that half of what a robot or a car sees does not reach.
const FURTHEST_M: f64 = 150.0;

/// A way from which on images have to change, in metres, whatever the wheels are worth.
const LONG_M: f64 = 5.0;

/// A turn up to which a way is straight, in radians.
const STRAIGHT_RAD: f64 = 0.05;

/// Features whose median says how far an image moved.
const LEAST_FEATURES: usize = 20;

/// Mean distance of features from the middle of the image, in its widths. Over a straight way b a feature of depth Z
/// moves by b/Z of its distance from the middle.
const OUT_WIDTHS: f64 = 0.25;

/// Depths beyond and before this are none, in 1/m.
const PER_M: std::ops::RangeInclusive<f64> = 0.005..=5.0;

impl InverseDepth {
    /// Where the feature is in `base_link`.
    pub(super) fn point(&self, camera: &RobotCamera, sighted: &Sighted) -> Vector3<f64> {
        camera.center_m() + camera.rotation() * (sighted.ray() / self.per_m)
    }

    /// To the precision that is stored: read back, it is the same.
    fn as_stored(self) -> Self {
        let rounded = |value: f64| f64::from(value as f32);
        Self { per_m: rounded(self.per_m), sigma_per_m: rounded(self.sigma_per_m) }
    }

    fn variance(&self) -> f64 {
        self.sigma_per_m * self.sigma_per_m
    }

    /// Both as one; `None` if they contradict each other.
    fn fused(self, other: Self) -> Option<Self> {
        let variances = self.variance() + other.variance();
        if (self.per_m - other.per_m).powi(2) > SAME_DEPTH_CHI_SQUARED * variances {
            return None;
        }
        let per_m = (self.per_m * other.variance() + other.per_m * self.variance()) / variances;
        let sigma_per_m = (self.variance() * other.variance() / variances).sqrt();
        Some(Self { per_m, sigma_per_m })
    }
}

/// What two frames of a robot say.
pub(super) struct Tracked {
    /// Of how far the later one's features are.
    pub(super) structure: Structure,
    /// Of how many times as far as the wheels the images turned; `None` if they do not say.
    pub(super) images_per_wheels: Option<f64>,
    /// How much the image changed over the way.
    pub(super) change: Change,
}

/// How much of an image changed, beside what the wheels say of the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    /// The way was short or bent, or too little is seen from both its ends.
    Unknown,
    /// As much as it does over such a way.
    Enough,
    /// So little that half of what is seen would be further away than [`FURTHEST_M`].
    HardlyAny,
}

/// What the way from an earlier frame says of the depths of a later one's features, and what
/// the earlier one knew of them. `wheels` is the pose of `base_link` at the later frame, seen
/// from where it was at the earlier one.
pub(super) fn tracked(
    camera: &RobotCamera,
    earlier: &FeatureRecord,
    later: &FeatureRecord,
    wheels: &RelativePose,
) -> Tracked {
    let mut depths = vec![None; later.keypoints().len()];
    let (from, to) = (camera.sighted(earlier), camera.sighted(later));
    let matches = feature_matches(earlier, later);
    let pairs: Vec<(usize, usize, Pair)> = matches
        .iter()
        .filter_map(|found| {
            let pair = Pair { earlier: from[found.earlier]?, later: to[found.current]? };
            Some((found.earlier, found.current, pair))
        })
        .collect();
    let base_m = wheels.pose().x_m().hypot(wheels.pose().y_m());
    let has_parallax = base_m >= LEAST_BASE_M;
    let sights: Vec<Pair> = pairs.iter().map(|(.., pair)| *pair).collect();
    let moved = if has_parallax { refined(camera, &sights, wheels) } else { Refined::by(wheels) };
    let known = earlier.structure().depths();
    let views = TwoViews::new(camera, &moved);
    for (earlier, later, pair) in pairs {
        let before = known.get(earlier).copied().flatten();
        let carried = before.and_then(|depth| views.carried(&depth, &pair));
        let measured = if has_parallax { views.triangulated(&pair) } else { None };
        let depth = match (carried, measured) {
            (Some(carried), Some(measured)) => carried.fused(measured),
            // What is known and did not move is as it was; what moved has no parallax here.
            (Some(carried), None) if !has_parallax || views.is_seen(&carried, &pair) => Some(carried),
            (Some(_), None) => None,
            (None, measured) => measured,
        };
        depths[later] = depth.map(InverseDepth::as_stored);
    }
    Tracked {
        structure: Structure::new(depths),
        images_per_wheels: images_per_wheels(camera, &sights, wheels),
        change: change((earlier, later), &matches, wheels),
    }
}

/// By how far features moved in the image, which needs no depths.
fn change(
    (earlier, later): (&FeatureRecord, &FeatureRecord),
    matches: &[FeatureMatch],
    wheels: &RelativePose,
) -> Change {
    let way = wheels.pose();
    let way_m = way.x_m().hypot(way.y_m());
    if way_m < LONG_M || way.heading_rad().abs() > STRAIGHT_RAD || matches.len() < LEAST_FEATURES {
        return Change::Unknown;
    }
    let moved_px = |found: &FeatureMatch| {
        let (before, now) = (&earlier.keypoints()[found.earlier], &later.keypoints()[found.current]);
        f64::from(now.x_px - before.x_px).hypot(f64::from(now.y_px - before.y_px))
    };
    let mut moved_px: Vec<f64> = matches.iter().map(moved_px).collect();
    let moved_widths = median(&mut moved_px).unwrap_or(0.0) / f64::from(later.image_size_px().0);
    if moved_widths < OUT_WIDTHS * way_m / FURTHEST_M { Change::HardlyAny } else { Change::Enough }
}

/// Two views of one camera, by how it moved in between.
struct TwoViews<'a> {
    camera: &'a RobotCamera,
    motion: Motion,
    /// The motion, a little further by each of its standard deviations.
    varied: [Motion; 5],
    /// Of the position, in metres.
    position_sigma_m: f64,
}

impl<'a> TwoViews<'a> {
    fn new(camera: &'a RobotCamera, moved: &Refined) -> Self {
        let Refined { motion, covariance } = *moved;
        // The columns of a square root of the covariance.
        let root = covariance.cholesky().map(|factor| factor.l()).unwrap_or_default();
        let varied = Motion::AXES.map(|axis| motion.retract(&root.column(axis).into_owned()));
        let position = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let position_sigma_m = position.symmetric_eigenvalues().max().max(0.0).sqrt();
        Self { camera, motion, varied, position_sigma_m }
    }

    /// Where the earlier camera sees what the later one sees at that depth.
    fn in_earlier(&self, motion: &Motion, later: &Sighted, per_m: f64) -> Option<Vector2<f64>> {
        let depth = InverseDepth { per_m, sigma_per_m: 0.0 };
        self.camera.project(&motion.carried(&depth.point(self.camera, later)))
    }

    /// The depth in the later view at which the earlier one sees the feature best, with what is not
    /// known of pixels and motion. `None` if there is none.
    fn triangulated(&self, pair: &Pair) -> Option<InverseDepth> {
        let mut per_m = 0.2;
        let mut slope = Vector2::zeros();
        for _ in 0..STEPS {
            let here = self.in_earlier(&self.motion, &pair.later, per_m)?;
            let further = self.in_earlier(&self.motion, &pair.later, per_m * 1.001)?;
            slope = (further - here) / (per_m * 0.001);
            let square = slope.norm_squared();
            if square <= f64::MIN_POSITIVE {
                return None;
            }
            per_m = (per_m - slope.dot(&(here - pair.earlier.at)) / square).clamp(1e-4, 20.0);
        }
        let here = self.in_earlier(&self.motion, &pair.later, per_m)?;
        let off = here - pair.earlier.at;
        let pixel_variance = pair.earlier.sigma.powi(2) + pair.later.sigma.powi(2);
        // What the motion may be wrong by moves the feature along the line that depth moves it on.
        let along = slope.normalize();
        let mut shifts = Matrix2x5::zeros();
        for (axis, varied) in self.varied.iter().enumerate() {
            shifts.set_column(axis, &(self.in_earlier(varied, &pair.later, per_m)? - here));
        }
        let of_motion = (shifts.transpose() * along).norm_squared();
        let across = Vector2::new(-along.y, along.x);
        let off_across = off.dot(&across).powi(2);
        let variance_across = pixel_variance + (shifts.transpose() * across).norm_squared();
        if off_across > SAME_DEPTH_CHI_SQUARED * variance_across || !PER_M.contains(&per_m) {
            return None;
        }
        let sigma_per_m = ((pixel_variance + of_motion) / slope.norm_squared()).sqrt();
        Some(InverseDepth { per_m, sigma_per_m })
    }

    /// What the earlier view knew, in the later one.
    fn carried(&self, before: &InverseDepth, pair: &Pair) -> Option<InverseDepth> {
        let depth_m = |point: &Vector3<f64>| {
            let in_camera = self.camera.base_to_camera.inverse_transform_point(&(*point).into());
            in_camera.x
        };
        let point = before.point(self.camera, &pair.earlier);
        let now_m = depth_m(&self.motion.seen_from(&point));
        let per_m = 1.0 / now_m;
        if now_m <= 0.0 || !PER_M.contains(&per_m) {
            return None;
        }
        // d(1/z') = (z/z')² d(1/z) for a camera that moves along its axis.
        let stretched = (per_m / before.per_m).powi(2) * before.sigma_per_m;
        let of_motion = self.position_sigma_m * per_m * per_m;
        Some(InverseDepth { per_m, sigma_per_m: stretched.hypot(of_motion) })
    }

    /// Whether the earlier view shows the feature where that depth puts it.
    fn is_seen(&self, depth: &InverseDepth, pair: &Pair) -> bool {
        let Some(here) = self.in_earlier(&self.motion, &pair.later, depth.per_m) else { return false };
        let nearer = depth.per_m + depth.sigma_per_m;
        let by_depth =
            self.in_earlier(&self.motion, &pair.later, nearer).map_or(0.0, |near| (near - here).norm());
        let variance = pair.earlier.sigma.powi(2) + pair.later.sigma.powi(2) + by_depth * by_depth;
        (here - pair.earlier.at).norm_squared() <= SAME_FEATURE_CHI_SQUARED * variance
    }
}
