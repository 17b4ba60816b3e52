//! What geometry says of two views: the features that look alike, and the one motion that explains
//! most of them.
//!
//! The motion is searched by RANSAC (Fischler & Bolles, CACM 1981) with a fixed seed, so two views
//! always give the same answer. Whether that is enough is not decided here but in
//! [`topomap::evidence`].

mod correspondence;
mod epipolar;
mod epipolar_matrices;
mod rigid_motion;
mod similarity;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, TwoView, VerificationMethod, VerificationSettings, ViewMotion};

use crate::feature_record::FeatureRecord;
use crate::structure::{self, Located, Locating, RobotCamera, Sight};
use correspondence::Correspondence;

pub use crate::camera::{Distortion, Pinhole};
pub use crate::matching::Match;

/// Compares views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verifier {
    settings: VerificationSettings,
    seed: u64,
}

/// The features of a frame, and how its camera projects if that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View<'a> {
    /// Keypoints, words and perhaps descriptors.
    pub features: &'a FeatureRecord,
    /// The camera, for the essential matrix and for metres.
    pub camera: Option<RobotCamera>,
}

/// What was found between two views, with what it was found by.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The motion, and how much speaks for it.
    pub view: TwoView,
    /// The matches that the motion explains.
    pub inliers: Vec<Match>,
    /// The matches that structure measured by.
    pub placed: Vec<Match>,
}

impl<'a> Sight<'a> {
    fn of(view: View<'a>) -> Option<Self> {
        Some(Self { features: view.features, camera: view.camera? })
    }
}

impl Verifier {
    /// Looks for the motion that `settings` ask for; all random choices start from `seed`.
    #[must_use]
    pub fn new(settings: VerificationSettings, seed: u64) -> Self {
        Self { settings, seed }
    }

    /// What is found between two views.
    ///
    /// Features are matched by their descriptors if both views have them, else by their words. A
    /// pair that is turned or scaled by more than the settings allow a whole view to be is left
    /// out. Swapped views give the inverse motion, but for the random choices.
    #[must_use]
    pub fn compare(&self, earlier: View<'_>, current: View<'_>) -> TwoView {
        self.compare_with_matches(earlier, current).view
    }

    /// The same as [`Verifier::compare`], with the matches behind it.
    #[must_use]
    pub fn compare_with_matches(&self, earlier: View<'_>, current: View<'_>) -> Comparison {
        let mut matches = crate::matching::matches(earlier.features, current.features);
        matches.retain(|matched| self.may_be_of_one_motion(matched, earlier.features, current.features));
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let (placement, placed) = self.place(earlier, current, &matches);
        let found = match self.settings.method {
            VerificationMethod::None => None,
            VerificationMethod::Similarity => {
                similarity::estimate(&in_widths(&matches, earlier, current), &mut random)
                    .map(|(motion, inliers)| (ViewMotion::Similarity(motion), inliers))
            }
            VerificationMethod::Epipolar => match (earlier.camera, current.camera) {
                (Some(from), Some(to)) => {
                    let rays = rays(&matches, (earlier, from.pinhole), (current, to.pinhole));
                    let tolerance = epipolar::TOLERANCE_WIDTHS * width(current) / to.pinhole.focal_px[0];
                    epipolar::essential(&rays, tolerance, &mut random)
                }
                (None | Some(_), None | Some(_)) => {
                    epipolar::fundamental(&in_widths(&matches, earlier, current), &mut random)
                }
            },
        };
        let (motion, inliers) = found.map_or((None, Vec::new()), |(motion, inliers)| (Some(motion), inliers));
        let inliers: Vec<Match> = inliers.into_iter().map(|inlier| inlier.of).collect();
        let view = TwoView {
            matches: count(matches.len()),
            inliers: count(inliers.len()),
            distinct_inliers: count(inliers.iter().filter(|inlier| inlier.distinct).count()),
            motion,
            placement,
        };
        Comparison { view, inliers, placed }
    }

    /// Where structure puts the robot, with the matches that say so.
    fn place(&self, earlier: View<'_>, current: View<'_>, matches: &[Match]) -> (Placement, Vec<Match>) {
        let (Some(earlier), Some(current)) = (Sight::of(earlier), Sight::of(current)) else {
            return (Placement::Unknown, Vec::new());
        };
        match structure::locate(earlier, current, matches, self.seed) {
            Locating::Unknown => (Placement::Unknown, Vec::new()),
            Locating::Nowhere => (Placement::Nowhere, Vec::new()),
            Locating::At(Located { pose, inliers }) => {
                (Placement::At { pose, inliers: count(inliers.len()) }, inliers)
            }
        }
    }

    /// Keypoints turn and grow with the view. Those whose orientation or size is unknown may have
    /// done either.
    fn may_be_of_one_motion(
        &self,
        matched: &Match,
        earlier: &FeatureRecord,
        current: &FeatureRecord,
    ) -> bool {
        let VerificationSettings { max_rotation_rad, max_ln_scale, .. } = self.settings;
        let from = earlier.keypoints()[matched.earlier];
        let to = current.keypoints()[matched.current];
        let turn_rad = f64::from(to.angle_rad - from.angle_rad);
        let turn_rad = turn_rad.sin().atan2(turn_rad.cos()).abs();
        let widths =
            f64::from(earlier.image_size_px().0.max(1)) / f64::from(current.image_size_px().0.max(1));
        let ln_scale = (f64::from(to.size_px) / f64::from(from.size_px) * widths).ln().abs();
        let exceeds = |value: f64, most: f64| value.is_finite() && value > most;
        !exceeds(turn_rad, max_rotation_rad) && !exceeds(ln_scale, max_ln_scale)
    }
}

fn in_widths(matches: &[Match], earlier: View<'_>, current: View<'_>) -> Vec<Correspondence> {
    correspondences(matches, (earlier, centred_in_widths(earlier)), (current, centred_in_widths(current)))
}

fn rays(
    matches: &[Match],
    (earlier, from): (View<'_>, Pinhole),
    (current, to): (View<'_>, Pinhole),
) -> Vec<Correspondence> {
    correspondences(matches, (earlier, from), (current, to))
}

/// Where features are, after taking off a centre and dividing by a length. Those that lie nowhere
/// are left out.
fn correspondences(
    matches: &[Match],
    (earlier, from): (View<'_>, Pinhole),
    (current, to): (View<'_>, Pinhole),
) -> Vec<Correspondence> {
    let pairs = matches.iter().map(|matched| Correspondence {
        earlier: from.ray(&earlier.features.keypoints()[matched.earlier]),
        current: to.ray(&current.features.keypoints()[matched.current]),
        of: *matched,
    });
    pairs.filter(|pair| pair.earlier.is_finite() && pair.current.is_finite()).collect()
}

/// Image widths from the image's centre: the centre, so that a turn of the camera is not taken for
/// a shift; widths, so that thresholds hold for images of any size.
fn centred_in_widths(view: View<'_>) -> Pinhole {
    let height = f64::from(view.features.image_size_px().1);
    Pinhole::ideal([width(view); 2], [(width(view) - 1.0) / 2.0, (height - 1.0) / 2.0])
}

fn width(view: View<'_>) -> f64 {
    f64::from(view.features.image_size_px().0)
}

fn count(len: usize) -> u32 {
    u32::try_from(len).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests;
