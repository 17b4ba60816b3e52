//! Where a robot is that sees features of known depth again.

use nalgebra::{Matrix2, Matrix2x5, Matrix5, Vector2, Vector3, Vector5};
use posegraph::{PlanarPose, Pose};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::metric::RelativePose;

use super::depths::SAME_FEATURE_CHI_SQUARED;
use super::motion::symmetric;
use super::nodding::Motion;
use super::resection::{Bearing, observer_of};
use super::robot_camera::{RobotCamera, Sighted};
use crate::depth::{InverseDepth, Structure};
use crate::feature_record::FeatureRecord;
use crate::matching::Match;

/// A frame: what it shows, how far that is, and by which camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight<'a> {
    /// Its features, with their depths.
    pub(crate) features: &'a FeatureRecord,
    /// The camera.
    pub(crate) camera: RobotCamera,
}

/// Where the later robot was, and what says so.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Located {
    /// Pose of `base_link` at the later frame in that of the earlier one.
    pub(crate) pose: RelativePose,
    /// The matches that agree with it.
    pub(crate) inliers: Vec<Match>,
}

/// What came of locating.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Locating {
    /// Too few of the matches have a depth in either frame.
    Unknown,
    /// They have, and too few agree on any pose.
    Nowhere,
    /// There.
    At(Located),
}

/// Sets of three matches that are tried. With a third of them right, one of 125 is of three right
/// ones with a chance of 99%.
const DRAWS: usize = 125;

/// What a hypothesis from three matches may be off by, in standard deviations of where features
/// lie: their depths are not all known well.
const COARSE_SIGMAS: f64 = 4.0;

/// Features whose depth is known worse than to this share help with the direction alone.
const MAX_DEPTH_SHARE: f64 = 0.5;

/// Fits to those that agree; and steps of one fit.
const REFITS: usize = 6;
const STEPS: usize = 5;

/// For derivatives, in metres and radians.
const DIFFERENCE: f64 = 1e-5;

/// Landmarks below which nothing is measured.
const LEAST_LANDMARKS: usize = 20;

/// A frame with so many depths shows where it is: of those that come back, more than the least
/// would look alike.
const KNOWN_WELL: usize = 60;

/// Landmarks that have to agree.
const LEAST_INLIERS: usize = 8;

/// Of all depths alike: what wheels may take a metre for, as a share.
const SCALE_SIGMA: f64 = 0.02;

/// Where the robot was at `current`, seen from where it was at `earlier`, by the features of either
/// whose depths are known. Random choices start from `seed`.
pub(crate) fn locate(earlier: Sight<'_>, current: Sight<'_>, matches: &[Match], seed: u64) -> Locating {
    let landmarks = landmarks_of(&earlier, &current, matches);
    if landmarks.len() < LEAST_LANDMARKS {
        // Much of what was near is not seen again: whatever looks alike, the robot is not there.
        let known_well = |sight: &Sight<'_>| {
            sight.features.structure().depths().iter().flatten().filter(|depth| is_known_well(depth)).count()
        };
        return if known_well(&earlier).max(known_well(&current)) < KNOWN_WELL {
            Locating::Unknown
        } else {
            Locating::Nowhere
        };
    }
    located(&landmarks, &mut ChaCha8Rng::seed_from_u64(seed)).map_or(Locating::Nowhere, Locating::At)
}

fn located(landmarks: &[Landmark<'_>], random: &mut ChaCha8Rng) -> Option<Located> {
    let mut motion = Motion::level(most_agreed(landmarks, random)?);
    let mut information = Matrix5::zeros();
    for _ in 0..REFITS {
        (motion, information) = refitted(landmarks, motion)?;
    }
    let agreeing: Vec<&Landmark<'_>> = landmarks.iter().filter(|landmark| landmark.agrees(&motion)).collect();
    let mut inliers: Vec<Match> = agreeing.iter().map(|landmark| landmark.of).collect();
    inliers.dedup();
    if inliers.len() < LEAST_INLIERS {
        return None;
    }
    let spread = agreeing.iter().filter_map(|landmark| Some(landmark.off(&motion)?.squared)).sum::<f64>()
        / (2 * agreeing.len()) as f64;
    // Of the motion over the floor, whatever the tilt.
    let covariance = information.try_inverse()?.fixed_view::<3, 3>(0, 0).into_owned() * spread.max(1.0);
    let pose = motion.planar();
    // Along the pose's own axes, as the covariance is.
    let along = pose.inverse();
    let scale = Vector3::new(along.x_m(), along.y_m(), 0.0) * SCALE_SIGMA;
    let covariance = symmetric(&covariance) + scale * scale.transpose();
    Some(Located { pose: RelativePose::new(pose, covariance).ok()?, inliers })
}

/// Which of the two frames knows the depth of a landmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum KnownBy {
    Earlier,
    Current,
}

/// A feature of known depth in one frame that the other frame sees too.
struct Landmark<'a> {
    of: Match,
    known_by: KnownBy,
    /// In `base_link` of the frame that knows it.
    point_m: Vector3<f64>,
    /// The same, where it would be a standard deviation nearer.
    nearer_m: Vector3<f64>,
    /// Where the other frame sees it.
    seen: Sighted,
    by: &'a RobotCamera,
}

fn is_known_well(depth: &InverseDepth) -> bool {
    depth.sigma_per_m <= MAX_DEPTH_SHARE * depth.per_m
}

/// How far from where it is seen a landmark is expected.
struct Off {
    residual: Vector2<f64>,
    information: Matrix2<f64>,
    /// In squared standard deviations.
    squared: f64,
}

fn landmarks_of<'a>(earlier: &'a Sight<'a>, current: &'a Sight<'a>, matches: &[Match]) -> Vec<Landmark<'a>> {
    let from = earlier.camera.sighted(earlier.features);
    let to = current.camera.sighted(current.features);
    let mut landmarks = Vec::new();
    for &of in matches {
        let (Some(in_earlier), Some(in_current)) = (from[of.earlier], to[of.current]) else { continue };
        let depth = |structure: &Structure, feature: usize| {
            let depth = structure.depths().get(feature).copied().flatten();
            depth.filter(is_known_well)
        };
        let landmark = |known_by, depth: InverseDepth, camera: &RobotCamera, known: &Sighted, seen, by| {
            let nearer = InverseDepth { per_m: depth.per_m + depth.sigma_per_m, ..depth };
            let (point_m, nearer_m) = (depth.point(camera, known), nearer.point(camera, known));
            Landmark { of, known_by, point_m, nearer_m, seen, by }
        };
        if let Some(depth) = depth(earlier.features.structure(), of.earlier) {
            let by = &current.camera;
            landmarks.push(landmark(KnownBy::Earlier, depth, &earlier.camera, &in_earlier, in_current, by));
        }
        if let Some(depth) = depth(current.features.structure(), of.current) {
            let by = &earlier.camera;
            landmarks.push(landmark(KnownBy::Current, depth, &current.camera, &in_current, in_earlier, by));
        }
    }
    landmarks
}

impl Landmark<'_> {
    /// A point of the frame that knows the landmark, in the other frame.
    fn moved(&self, motion: &Motion, point: &Vector3<f64>) -> Vector3<f64> {
        match self.known_by {
            KnownBy::Earlier => motion.seen_from(point),
            KnownBy::Current => motion.carried(point),
        }
    }

    fn expected(&self, motion: &Motion, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.by.project(&self.moved(motion, point))
    }

    fn off(&self, motion: &Motion) -> Option<Off> {
        let expected = self.expected(motion, &self.point_m)?;
        let residual = expected - self.seen.at;
        let by_depth = self.expected(motion, &self.nearer_m)? - expected;
        // The same pixels of noise where the landmark was seen first.
        let pixels = Matrix2::from_diagonal_element(2.0 * self.seen.sigma.powi(2));
        let information = (pixels + by_depth * by_depth.transpose()).try_inverse()?;
        let squared = residual.dot(&(information * residual));
        Some(Off { residual, information, squared })
    }

    fn agrees(&self, motion: &Motion) -> bool {
        self.off(motion).is_some_and(|off| off.squared <= SAME_FEATURE_CHI_SQUARED)
    }

    fn agrees_coarsely(&self, motion: &Motion) -> bool {
        self.expected(motion, &self.point_m)
            .is_some_and(|expected| (expected - self.seen.at).norm() <= COARSE_SIGMAS * self.seen.sigma)
    }

    fn bearing(&self) -> Bearing {
        let ray = self.by.rotation() * self.seen.ray();
        Bearing { x_m: self.point_m.x, y_m: self.point_m.y, azimuth_rad: ray.y.atan2(ray.x) }
    }
}

/// Of poses from three landmarks each, the one that most landmarks agree with.
fn most_agreed(landmarks: &[Landmark<'_>], random: &mut ChaCha8Rng) -> Option<PlanarPose> {
    let [earlier, current] = [KnownBy::Earlier, KnownBy::Current].map(|known_by| -> Vec<usize> {
        (0..landmarks.len()).filter(|&index| landmarks[index].known_by == known_by).collect()
    });
    let mut best: Option<(usize, PlanarPose)> = None;
    for _ in 0..DRAWS {
        let known_earlier = random.random_range(0..landmarks.len().max(1)) < earlier.len();
        let known = if known_earlier { &earlier } else { &current };
        if known.len() < 3 {
            continue;
        }
        let first = random.random_range(0..known.len());
        let second = (first + random.random_range(1..known.len())) % known.len();
        let third = random.random_range(0..known.len());
        if third == first || third == second {
            continue;
        }
        let bearings = [first, second, third].map(|index| landmarks[known[index]].bearing());
        let by = landmarks[known[first]].by;
        // What is found is where the camera is, seen from the frame that knows the landmarks.
        let Some(camera) = observer_of(&bearings) else { continue };
        let center_m = by.center_m();
        let base = camera.compose(&PlanarPose::new(-center_m.x, -center_m.y, 0.0));
        let pose = if known_earlier { base } else { base.inverse() };
        let motion = Motion::level(pose);
        let agreeing = landmarks.iter().filter(|landmark| landmark.agrees_coarsely(&motion)).count();
        if best.is_none_or(|(most, _)| agreeing > most) {
            best = Some((agreeing, pose));
        }
    }
    best.filter(|&(agreeing, _)| agreeing >= LEAST_INLIERS).map(|(_, pose)| pose)
}

/// The motion that those agree on best that agree with `start`, and the information on it: least
/// squares with the kernel of Cauchy.
fn refitted(landmarks: &[Landmark<'_>], start: Motion) -> Option<(Motion, Matrix5<f64>)> {
    let agreeing: Vec<&Landmark<'_>> = landmarks
        .iter()
        .filter(|landmark| landmark.agrees(&start) || landmark.agrees_coarsely(&start))
        .collect();
    let prior = Motion::information_on_tilt();
    let mut motion = start;
    let mut information = prior;
    for _ in 0..STEPS {
        information = prior;
        let mut gradient: Vector5<f64> = prior * motion.tilt();
        let varied = Motion::AXES.map(|axis| motion.varied(axis, DIFFERENCE));
        for landmark in &agreeing {
            let Some(off) = landmark.off(&motion) else { continue };
            let expected = off.residual + landmark.seen.at;
            let mut slope = Matrix2x5::zeros();
            for (axis, varied) in varied.iter().enumerate() {
                let Some(moved) = landmark.expected(varied, &landmark.point_m) else { continue };
                slope.set_column(axis, &((moved - expected) / DIFFERENCE));
            }
            let weight = 1.0 / (1.0 + off.squared / 2.0);
            let weighted = slope.transpose() * off.information * weight;
            information += weighted * slope;
            gradient += weighted * off.residual;
        }
        let step = -information.cholesky()?.solve(&gradient);
        motion = motion.retract(&step);
    }
    motion.planar().is_finite().then_some((motion, information))
}
