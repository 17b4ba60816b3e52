//! The map layer alone, on a drive whose poses are known and whose images are not: true loops stand in for recognition,
//! simulated wheels for odometry.

use std::path::Path;
use std::time::Instant;

use anyhow::{Result, bail};
use posegraph::{PlanarPose, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use topomap::evidence::ClosureNoise;
use topomap::log::{Link, LinkKind};
use topomap::map::PlacePoses;
use topomap::metric::{OdometryNoise, RelativePose};
use waypost_sim::robot::WheelOdometry;

use super::WheelChoice;
use super::alignment::{Alignment, rmse_m};
use super::drive::{planar, sent_odometry};
use crate::dataset::pairs;
use crate::error::refused;
use crate::files;

/// What came out.
#[derive(Serialize)]
pub(crate) struct KittiReport {
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

/// Maps the drive in a folder with `poses.txt` (3 x 4, row by row, of a camera: x right, y down, z ahead) and
/// `loops.csv`, and holds the map against the truth. The seed is that of wheels and closures.
pub(super) fn run(folder: &Path, seed: u64, wheels: WheelChoice) -> Result<KittiReport> {
    let truth = poses(&folder.join("poses.txt"))?;
    let noise = OdometryNoise::default();
    let Driven { mut links, felt, length_m } = driven(&truth, wheels, seed, &noise)?;
    let errors = wheels.errors(seed);
    let spacing_m = length_m / truth.len() as f64;
    let closures = closures(&folder.join("loops.csv"), &truth, spacing_m, seed)?;
    let closed = closures.len();
    links.extend(closures);
    let began = Instant::now();
    let map = PlacePoses::new(vec![0; truth.len()], &links, &noise);
    Ok(KittiReport {
        places: truth.len(),
        length_m,
        closures: closed,
        scale_error: errors.scale,
        drift_rad_per_m: errors.drift_rad_per_m,
        drift_found_rad_per_m: map.drift_rad_per_m(0),
        odometry_rmse_m: rmse_m(&felt, &truth, Alignment::FirstPose),
        map_rmse_m: rmse_m(map.poses(), &truth, Alignment::FirstPose),
        map_rmse_rigid_m: rmse_m(map.poses(), &truth, Alignment::Rigid),
        map_rmse_scaled_m: rmse_m(map.poses(), &truth, Alignment::Similarity),
        map_contradicted_links: map.contradicted().count(),
        map_ms: began.elapsed().as_secs_f64() * 1e3,
    })
}

/// What wheels say of a drive from place to place.
pub(crate) struct Driven {
    pub(crate) links: Vec<Link>,
    /// Where they put each place.
    felt: Vec<PlanarPose>,
    length_m: f64,
}

/// Rolls simulated wheels along a drive.
pub(crate) fn driven(
    truth: &[PlanarPose],
    wheels: WheelChoice,
    seed: u64,
    noise: &OdometryNoise,
) -> Result<Driven> {
    let mut wheels = WheelOdometry::new(wheels.errors(seed), seed).map_err(refused)?;
    let mut driven = Driven { links: Vec::new(), felt: vec![PlanarPose::identity()], length_m: 0.0 };
    let mut before = sent_odometry(wheels.reading())?;
    for (place, pair) in (1..).zip(truth.windows(2)) {
        let motion = pair[0].inverse().compose(&pair[1]);
        let metres = motion.x_m().hypot(motion.y_m());
        wheels.add(metres, motion.heading_rad());
        let now = sent_odometry(wheels.reading())?;
        let kind = LinkKind::Driven(noise.between(&before, &now));
        driven.links.push(Link { from: place - 1, to: place, kind });
        driven.felt.push(planar(&wheels.reading().pose));
        driven.length_m += metres;
        before = now;
    }
    Ok(driven)
}

/// Poses as seen from above.
pub(crate) fn poses(path: &Path) -> Result<Vec<PlanarPose>> {
    let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
    let pose = |(number, line): (usize, &str)| {
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
        match numbers.as_slice() {
            &[_, _, right, x, _, _, _, _, _, _, ahead, z] => {
                Ok(PlanarPose::new(z, -x, (-right).atan2(ahead)))
            }
            _ => bail!(
                "{} line {} is no pose; write 12 numbers, the rows of a 3 x 4 matrix",
                path.display(),
                number + 1
            ),
        }
    };
    text.lines().enumerate().map(pose).collect()
}

/// At each frame with a loop, the nearest earlier one, as recognition would measure it: at the same place, the heading
/// with the noise that it is held to have.
pub(crate) fn closures(path: &Path, truth: &[PlanarPose], spacing_m: f64, seed: u64) -> Result<Vec<Link>> {
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
