//! The map layer alone, on a drive whose poses are known and whose images are not: true loops stand in for recognition,
//! simulated wheels for odometry.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use topomap::event::{Link, LinkKind};
use topomap::odometry::Odometry;
use topomap::place_poses::PlacePoses;
use topomap::relative_pose::{ClosureNoise, OdometryNoise, RelativePose};
use topomap::relaxation::{PlanarPose, Pose};
use waypost_sim::robot::WheelOdometry;

use super::alignment::{Alignment, rmse_m};
use super::drive::planar;
use super::{MapError, WheelChoice};
use crate::dataset::pairs;
use crate::error::EvalError;
use crate::files;

/// Which drive, and what is simulated of it.
#[derive(Clone, Debug, PartialEq)]
pub struct KittiOptions {
    /// Folder with `poses.txt` (3 x 4, row by row, of a camera: x right, y down, z ahead) and `loops.csv`.
    pub folder: PathBuf,
    /// Of wheels and closures.
    pub seed: u64,
    /// How wrong the wheels are.
    pub wheels: WheelChoice,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KittiReport {
    /// Poses, each of them a place.
    pub places: usize,
    /// Metres that were driven.
    pub length_m: f64,
    /// Loops that were closed: at each frame with a loop, with the nearest earlier place.
    pub closures: usize,
    /// The wheels' scale error.
    pub scale_error: f64,
    /// Their drift, in radians per metre.
    pub drift_rad_per_m: f64,
    /// The drift that the map has found.
    pub drift_found_rad_per_m: f64,
    /// The wheels' error, laid over the truth at the first pose.
    pub odometry_rmse_m: f64,
    /// The map's, laid over the truth at the first pose.
    pub map_rmse_m: f64,
    /// The same, after the best rigid alignment.
    pub map_rmse_rigid_m: f64,
    /// The same, after the best alignment that may also scale.
    pub map_rmse_scaled_m: f64,
    /// Closures that were left out.
    pub map_contradicted_links: usize,
    /// From the links to all poses, at once, in milliseconds, on one thread.
    pub map_ms: f64,
}

/// Maps the drive from all that was measured, and holds the map against the truth.
///
/// # Errors
/// [`EvalError`] if the files cannot be used.
pub fn run(options: &KittiOptions) -> Result<KittiReport, EvalError> {
    let KittiOptions { folder, seed, wheels } = options;
    let truth = poses(&folder.join("poses.txt"))?;
    let mut errors = WheelOdometry::new(wheels.errors(*seed), *seed).map_err(MapError::OutOfRange)?;
    let noise = OdometryNoise::default();
    let (mut links, mut felt) = (Vec::new(), vec![PlanarPose::identity()]);
    let mut length_m = 0.0;
    let mut before = reading(&errors)?;
    for (place, pair) in (1..).zip(truth.windows(2)) {
        let motion = pair[0].inverse().compose(&pair[1]);
        let metres = motion.x_m().hypot(motion.y_m());
        errors.add(metres, motion.heading_rad());
        length_m += metres;
        let now = reading(&errors)?;
        let kind = LinkKind::Driven(noise.between(&before, &now));
        links.push(Link { from: place - 1, to: place, kind });
        felt.push(planar(&errors.reading().pose));
        before = now;
    }
    let spacing_m = length_m / truth.len() as f64;
    let closures = closures(&folder.join("loops.csv"), &truth, spacing_m, *seed)?;
    let closed = closures.len();
    links.extend(closures);
    let began = Instant::now();
    let map = PlacePoses::new(vec![0; truth.len()], &links, &noise);
    let report = KittiReport {
        places: truth.len(),
        length_m,
        closures: closed,
        scale_error: errors.errors().scale,
        drift_rad_per_m: errors.errors().drift_rad_per_m,
        drift_found_rad_per_m: map.drift_rad_per_m(0),
        odometry_rmse_m: rmse_m(&felt, &truth, Alignment::FirstPose),
        map_rmse_m: rmse_m(map.poses(), &truth, Alignment::FirstPose),
        map_rmse_rigid_m: rmse_m(map.poses(), &truth, Alignment::Rigid),
        map_rmse_scaled_m: rmse_m(map.poses(), &truth, Alignment::Similarity),
        map_contradicted_links: map.contradicted().count(),
        map_ms: began.elapsed().as_secs_f64() * 1e3,
    };
    eprintln!(
        "{} places, {:.0} m, {} closures, {} left out: wheels {:.1} m off, map {:.2} m, after the best rigid alignment \
         {:.2} m, scaled {:.2} m; {:.1} ms",
        report.places,
        report.length_m,
        report.closures,
        report.map_contradicted_links,
        report.odometry_rmse_m,
        report.map_rmse_m,
        report.map_rmse_rigid_m,
        report.map_rmse_scaled_m,
        report.map_ms,
    );
    Ok(report)
}

pub(crate) fn reading(wheels: &WheelOdometry) -> Result<Odometry, MapError> {
    let (position_m, orientation) = wheels.reading().position_and_orientation();
    Odometry::new(position_m, orientation, Some(&wheels.reading().covariance_6x6()))
        .map_err(MapError::Odometry)
}

/// Poses as seen from above.
pub(crate) fn poses(path: &Path) -> Result<Vec<PlanarPose>, EvalError> {
    let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
    let pose = |(number, line): (usize, &str)| {
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
        match numbers.as_slice() {
            &[_, _, right, x, _, _, _, _, _, _, ahead, z] => {
                Ok(PlanarPose::new(z, -x, (-right).atan2(ahead)))
            }
            _ => Err(MapError::Poses { path: path.to_owned(), line: number + 1 }),
        }
    };
    Ok(text.lines().enumerate().map(pose).collect::<Result<_, _>>()?)
}

/// At each frame with a loop, the nearest earlier one, as recognition would measure it: at the same place, the heading
/// with the noise that it is held to have.
pub(crate) fn closures(
    path: &Path,
    truth: &[PlanarPose],
    spacing_m: f64,
    seed: u64,
) -> Result<Vec<Link>, EvalError> {
    let noise = ClosureNoise::of_spacing(spacing_m);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut nearest: std::collections::BTreeMap<usize, (f64, usize)> = std::collections::BTreeMap::new();
    for (query, earlier) in pairs(path, truth.len())? {
        let apart = truth[earlier].inverse().compose(&truth[query]);
        let found = (apart.x_m().hypot(apart.y_m()), earlier);
        let best = nearest.entry(query).or_insert(found);
        if found < *best {
            *best = found;
        }
    }
    let within = nearest.into_iter().filter(|(_, (metres, _))| *metres <= spacing_m);
    let link = |(query, (_, earlier)): (usize, (f64, usize))| {
        let turned = truth[query].inverse().compose(&truth[earlier]).heading_rad();
        // Twelve even numbers are as good as normal.
        let sum: f64 = (0..12).map(|_| random.random::<f64>() - 0.5).sum();
        let heading = PlanarPose::new(0.0, 0.0, turned + noise.heading_rad * sum);
        let deviations = nalgebra::Vector3::new(noise.position_m, noise.position_m, noise.heading_rad);
        let variances = nalgebra::Matrix3::from_diagonal(&deviations.map(|deviation| deviation * deviation));
        let measured = RelativePose::new(heading, variances).ok()?;
        Some(Link { from: query as u32, to: earlier as u32, kind: LinkKind::Closed(measured) })
    };
    Ok(within.filter_map(link).collect())
}
