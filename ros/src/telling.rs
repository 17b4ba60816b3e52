//! Where the robot is, told on the pose's and the path's topics.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::bus::Outgoing;
use crate::state::Placed;
use waypost_client::v1;
use waypost_ros_messages::{Covariance, Float64, Header, Path, Pose, PoseStamped, PoseWithCovarianceStamped};

/// Poses of a path; when there are more, every second one goes.
const MOST_POSES: usize = 2000;
const FIRST_SPACING_M: f64 = 0.05;
/// A path is long, and nobody drives by it.
const PATH_PERIOD: Duration = Duration::from_secs(1);

/// Publishes where the robot is.
pub(crate) struct Telling {
    pub(crate) pose: Outgoing<PoseWithCovarianceStamped>,
    pub(crate) path: Outgoing<Path>,
    pub(crate) map_frame: String,
    pub(crate) covariance: Covariance,
    track: Track,
    path_told: Option<Instant>,
}

impl Telling {
    pub(crate) fn new(
        pose: Outgoing<PoseWithCovarianceStamped>,
        path: Outgoing<Path>,
        map_frame: String,
        covariance: Covariance,
    ) -> Self {
        Self { pose, path, map_frame, covariance, track: Track::default(), path_told: None }
    }

    /// The path begins anew.
    pub(crate) fn begin_anew(&mut self) {
        self.track = Track::default();
    }

    /// The map has the robot there, at the stamp of a frame.
    pub(crate) fn placed(&mut self, placed: &Placed, stamp_ns: i64) {
        let header = Header::new(stamp_ns, &self.map_frame);
        let (pose, covariance) = (placed.robot, self.covariance);
        self.pose.publish(PoseWithCovarianceStamped { header: header.clone(), pose, covariance });
        self.track.add(placed.part, stamp_ns, placed.robot);
        if self.path_told.is_none_or(|told| told.elapsed() >= PATH_PERIOD) {
            self.path_told = Some(Instant::now());
            let poses = self.track.poses.iter().map(|(stamp_ns, pose)| PoseStamped {
                header: Header::new(*stamp_ns, &self.map_frame),
                pose: *pose,
            });
            self.path.publish(Path { header, poses: poses.collect() });
        }
    }
}

/// Publishes how sure each answer is: numbers to plot.
pub(crate) struct Sureness {
    pub(crate) new_place: Outgoing<Float64>,
    pub(crate) most_probable_place: Outgoing<Float64>,
    pub(crate) matched: Outgoing<Float64>,
}

impl Sureness {
    pub(crate) fn answered(&self, answer: &v1::FrameAnswer) {
        self.new_place.publish(Float64 { data: answer.new_place_posterior });
        if let Some(likely) = answer.places.first() {
            self.most_probable_place.publish(Float64 { data: likely.posterior });
        }
        let geometry = answer.r#match.as_ref().and_then(|matched| matched.geometry.as_ref());
        if let Some(geometry) = geometry {
            self.matched.publish(Float64 { data: geometry.probability });
        }
    }
}

/// Where the robot was believed to be, frame by frame, at the time.
struct Track {
    /// In whose frame it is.
    part: u32,
    poses: VecDeque<(i64, Pose)>,
    spacing_m: f64,
}

impl Default for Track {
    fn default() -> Self {
        Self { part: 0, poses: VecDeque::new(), spacing_m: FIRST_SPACING_M }
    }
}

impl Track {
    fn add(&mut self, part: u32, stamp_ns: i64, pose: Pose) {
        if part != self.part {
            *self = Self { part, ..Self::default() };
        }
        let moved = |(_, last): &(i64, Pose)| {
            let (here, there) = (pose.position, last.position);
            (here.x - there.x).hypot(here.y - there.y) >= self.spacing_m
        };
        if !self.poses.back().is_none_or(moved) {
            return;
        }
        self.poses.push_back((stamp_ns, pose));
        if self.poses.len() > MOST_POSES {
            let mut index = 0_usize;
            self.poses.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            self.spacing_m *= 2.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use waypost_ros_messages::Vector3;

    fn at(x: f64) -> Pose {
        Pose { position: Vector3 { x, y: 0.0, z: 0.0 }, ..Pose::ORIGIN }
    }

    #[test]
    fn a_path_has_bounds_and_both_ends() {
        let mut track = Track::default();
        for step in 0..10_000_i32 {
            track.add(0, i64::from(step), at(f64::from(step) * 0.1));
        }
        assert!(track.poses.len() <= MOST_POSES, "{}", track.poses.len());
        assert_eq!(track.poses[0].1, at(0.0));
        assert!(track.poses.back().unwrap().1.position.x > 990.0);
    }

    #[test]
    fn standing_adds_nothing_and_another_part_begins_anew() {
        let mut track = Track::default();
        (0..9).for_each(|stamp_ns| track.add(0, stamp_ns, at(1.0)));
        assert_eq!(track.poses.len(), 1);
        track.add(4, 10, at(1.0));
        assert_eq!((track.part, track.poses.len()), (4, 1));
    }
}
