//! Sessions to merge: drives, cut and moved.

use std::ops::Range;
use std::sync::Arc;

use anyhow::Result;
use nalgebra::{Matrix3, Rotation2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use waypost_sim::drive::{Building, WHEN_MOVED};
use waypost_sim::pose::Pose;
use waypost_sim::robot::OdometryReading;
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;

use crate::commands::map::drive::{self, Drive, DrivenFrame};
use crate::commands::map::{WheelChoice, named_route};

/// Metres that a session may be moved by along each axis.
const MOVED_M: f64 = 50.0;

/// Cuts `length` frames into so many pieces that differ in length by a half of it at most.
pub(super) fn cuts(length: usize, pieces: usize, random: &mut ChaCha8Rng) -> Vec<Range<usize>> {
    let weights: Vec<f64> = (0..pieces).map(|_| 0.75 + 0.5 * random.random::<f64>()).collect();
    let total: f64 = weights.iter().sum();
    let mut begin = 0;
    let mut along = 0.0;
    let piece = |weight: &f64| {
        along += weight;
        let end = ((along / total) * length as f64).round() as usize;
        let piece = begin..end;
        begin = end;
        piece
    };
    weights.iter().map(piece).collect()
}

/// A piece of a drive, in an odometry frame of its own.
pub(super) fn moved(frames: &[DrivenFrame], random: &mut ChaCha8Rng) -> Vec<DrivenFrame> {
    let within = |most: f64| most * (2.0 * random.random::<f64>() - 1.0);
    let [x_m, y_m, turn_rad] = [MOVED_M, MOVED_M, std::f64::consts::PI].map(within);
    let turned = Rotation2::new(turn_rad);
    let mut axes = Matrix3::identity();
    axes.fixed_view_mut::<2, 2>(0, 0).copy_from(turned.matrix());
    let moved = |frame: &DrivenFrame| {
        let OdometryReading { pose, covariance } = frame.odometry;
        let position = turned * pose.position();
        let pose = Pose::new(x_m + position.x, y_m + position.y, pose.heading_rad + turn_rad);
        let odometry = OdometryReading { pose, covariance: axes * covariance * axes.transpose() };
        DrivenFrame { odometry, ..frame.clone() }
    };
    frames.iter().map(moved).collect()
}

/// A drive of a route, cut into two to four sessions.
pub(super) fn cut_drive(
    world: NamedWorld,
    route: &str,
    seed: u64,
    wheels: WheelChoice,
) -> Result<(Drive, Vec<Vec<DrivenFrame>>)> {
    let route = named_route(world, route)?;
    let drive = drive::drive(world, &route, seed, wheels.errors(seed))?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let pieces = random.random_range(2..=4);
    let cuts = cuts(drive.frames.len(), pieces, &mut random);
    let sessions = cuts.into_iter().map(|cut| moved(&drive.frames[cut], &mut random)).collect();
    Ok((drive, sessions))
}

/// Robots in one building, each on a piece of another of its routes, with wheels and a camera of its own.
pub(super) fn robots(
    world: NamedWorld,
    seed: u64,
    wheels: WheelChoice,
) -> Result<(Arc<Scene>, Vec<Vec<DrivenFrame>>)> {
    let scene = Arc::new(Scene::new(world.plan(seed)));
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut sessions = Vec::new();
    for (robot, route) in (0..).zip(world.routes()) {
        // Robots of one building, and of the next, are all different.
        let robot_seed = 100 * seed + robot;
        let building = Building { rig: world.camera_rig(), ..Building::new(scene.clone(), &route)? };
        let drive = drive::drive_through(&building, robot_seed, wheels.errors(robot_seed), WHEN_MOVED)?;
        let longest = drive.frames.len();
        let length = ((0.5 + 0.5 * random.random::<f64>()) * longest as f64) as usize;
        let begin = random.random_range(0..=longest - length);
        sessions.push(moved(&drive.frames[begin..begin + length], &mut random));
    }
    Ok((scene, sessions))
}

/// One drive in each of two buildings with the same offices in another arrangement.
pub(super) fn look_alikes(seed: u64, wheels: WheelChoice) -> Result<(Drive, Vec<Vec<DrivenFrame>>)> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut drive_through = |world: NamedWorld| {
        let drive = drive::drive(world, &named_route(world, "offices")?, seed, wheels.errors(seed))?;
        let session = moved(&drive.frames, &mut random);
        Ok::<_, anyhow::Error>((drive, session))
    };
    let (drive, first) = drive_through(NamedWorld::BuildingA)?;
    let (_, second) = drive_through(NamedWorld::BuildingB)?;
    Ok((drive, vec![first, second]))
}
