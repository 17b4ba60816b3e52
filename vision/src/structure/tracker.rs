//! Frame after frame of one robot.

use std::collections::VecDeque;
use std::sync::Arc;

use posegraph::Pose;
use topomap::metric::{Agreement, Odometry, OdometryNoise, RelativePose};

use super::depths::{Change, Tracked, tracked};
use super::robot_camera::RobotCamera;
use crate::feature_record::FeatureRecord;

/// Gives the features of a robot's frames their depths as they come in.
///
/// A frame is held against the latest one that the robot has moved away from since: images that come
/// every few centimetres would otherwise have no parallax.
#[derive(Clone, Debug)]
pub struct Tracker {
    noise: OdometryNoise,
    /// The latest frames, oldest first.
    frames: VecDeque<TrackedFrame>,
    /// How many times as far as the wheels the images turned at the latest turns, oldest first.
    turns: VecDeque<f64>,
    /// How much images changed over the latest long ways, oldest first.
    changes: VecDeque<Change>,
}

/// A frame that later ones are held against.
#[derive(Clone, Debug)]
pub struct TrackedFrame {
    /// Its features, with their depths as far as they are known.
    pub features: Arc<FeatureRecord>,
    /// Where the wheels put the robot then.
    pub odometry: Odometry,
}

/// Long ways that are too few to say that wheels are of another unit.
const LEAST_CHANGES: usize = 5;

/// Way and turn that a frame must be away to be held against, in metres and radians.
const APART_M: f64 = 0.25;
const APART_RAD: f64 = 8.0 / 180.0 * std::f64::consts::PI;

impl Tracker {
    /// Frames that it looks back on, at most.
    pub const MAX_FRAMES: usize = 32;

    /// A tracker of a robot whose wheels are as good as that.
    #[must_use]
    pub fn new(noise: OdometryNoise) -> Self {
        Self::resumed(noise, Vec::new())
    }

    /// Goes on after these frames, the last [`Tracker::MAX_FRAMES`] of a robot, oldest first.
    #[must_use]
    pub fn resumed(noise: OdometryNoise, frames: Vec<TrackedFrame>) -> Self {
        Self { noise, frames: frames.into(), turns: VecDeque::new(), changes: VecDeque::new() }
    }

    /// A frame's features with their depths, by a camera; `odometry` is where the wheels put the
    /// robot. Without either nothing is known, and tracking starts over.
    pub fn track(
        &mut self,
        features: Arc<FeatureRecord>,
        camera: Option<&RobotCamera>,
        odometry: Option<&Odometry>,
    ) -> Arc<FeatureRecord> {
        let (Some(camera), Some(odometry)) = (camera, odometry) else {
            self.frames.clear();
            self.turns.clear();
            self.changes.clear();
            return features;
        };
        let features = match self.held_against(odometry) {
            Some((earlier, motion)) => {
                let Tracked { structure, images_per_wheels, change } =
                    tracked(camera, &earlier.features, &features, &motion);
                self.turns.extend(images_per_wheels);
                if change != Change::Unknown {
                    self.changes.push_back(change);
                }
                Arc::new(FeatureRecord::clone(&features).with_structure(structure))
            }
            None => features,
        };
        self.frames.push_back(TrackedFrame { features: features.clone(), odometry: odometry.clone() });
        if self.frames.len() > Self::MAX_FRAMES {
            self.frames.pop_front();
        }
        if self.turns.len() > Self::MAX_FRAMES {
            self.turns.pop_front();
        }
        if self.changes.len() > Self::MAX_FRAMES {
            self.changes.pop_front();
        }
        features
    }

    /// How far the images turned, beside the wheels, at the last [`Tracker::MAX_FRAMES`] turns since it
    /// began; `None` if it has seen too few.
    #[must_use]
    pub fn turning(&self) -> Option<Agreement> {
        Agreement::of(self.turns.iter().copied())
    }

    /// Whether images hardly changed over most of the latest long ways, as if half of what is seen were 150 m away and
    /// more. Positions in centimetres or millimetres look so.
    #[must_use]
    pub fn hardly_moves(&self) -> bool {
        let hardly = self.changes.iter().filter(|change| **change == Change::HardlyAny).count();
        self.changes.len() >= LEAST_CHANGES && 2 * hardly > self.changes.len()
    }

    /// The latest frame that the robot has moved away from, or else the oldest, and the way since.
    fn held_against(&self, now: &Odometry) -> Option<(&TrackedFrame, RelativePose)> {
        let since = |frame: &TrackedFrame| self.noise.between(&frame.odometry, now);
        let apart = self.frames.iter().rev().find(|frame| is_apart(&since(frame)));
        let frame = apart.or(self.frames.front())?;
        Some((frame, since(frame)))
    }
}

fn is_apart(motion: &RelativePose) -> bool {
    let pose = motion.pose();
    pose.position().norm() >= APART_M || pose.heading_rad().abs() >= APART_RAD
}
