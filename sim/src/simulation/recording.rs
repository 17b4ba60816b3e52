//! A drive as it was: to teach a map, and to judge one.

use rayon::prelude::*;

use super::{CameraFrame, Simulation, Tick};
use crate::image::GreyImage;
use crate::render::CameraRig;
use crate::robot::Command;
use crate::route::{Route, RouteFollower};
use crate::scene::Scene;

/// A drive along a route, step by step.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Every step: truth and odometry.
    pub ticks: Vec<Tick>,
    /// How often the robot ran into something on the way.
    pub collisions: u64,
}

/// The robot did not reach the end of its route.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "after {seconds:.0} s the robot was {along_m:.1} m along its route of {length_m:.1} m; something is in its way"
)]
pub struct DriveError {
    /// Since it began.
    pub seconds: f64,
    /// How far it came.
    pub along_m: f64,
    /// How far it should have come.
    pub length_m: f64,
}

impl Simulation {
    /// Drives along a route by the true pose, at `speed_m_s` where it is straight.
    ///
    /// # Errors
    /// [`DriveError`] if that takes four times as long as it should, and a minute more.
    pub fn drive_along(&mut self, route: &Route, speed_m_s: f64) -> Result<Recording, DriveError> {
        let mut follower = RouteFollower::new(route.clone());
        let started_ns = self.now_ns();
        let collisions_before = self.collisions();
        // Also an end for a speed that is none.
        let limit_s = (60.0 + 4.0 * route.length_m() / speed_m_s).min(10_000.0);
        let mut ticks = Vec::new();
        while let Some([forward_m_s, turn_rad_s]) = follower.steer(self.robot().pose(), speed_m_s) {
            let seconds = (self.now_ns() - started_ns) as f64 * 1e-9;
            if seconds > limit_s {
                return Err(DriveError { seconds, along_m: follower.along_m(), length_m: route.length_m() });
            }
            self.command(Command { forward_m_s, turn_rad_s, valid_ns: 2 * self.settings().period_ns });
            ticks.push(self.advance());
        }
        Ok(Recording { ticks, collisions: self.collisions() - collisions_before })
    }
}

impl Recording {
    /// The images that were taken, not yet rendered.
    pub fn frames(&self) -> impl Iterator<Item = &CameraFrame> {
        self.ticks.iter().filter_map(|tick| tick.frame.as_ref())
    }

    /// All images, rendered on all threads.
    #[must_use]
    pub fn images(&self, scene: &Scene, rig: &CameraRig) -> Vec<GreyImage> {
        let frames: Vec<&CameraFrame> = self.frames().collect();
        frames.par_iter().map(|frame| scene.render(rig, &frame.shot)).collect()
    }

    /// Metres that the robot really drove.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.ticks.windows(2).map(|pair| pair[0].truth.distance_m(&pair[1].truth)).sum()
    }
}
