//! How well one map knows how its places lie to each other.

use fabmap::appearance::PlaceId;
use nalgebra::{Matrix3, Vector3};

use crate::map::PlacePoses;
use crate::metric::wheel_drift::RANDOM_TURN;
use crate::metric::{OdometryNoise, RelativePose};
use posegraph::shortest_paths::{ShortestPaths, Step};
use posegraph::{EdgeKind, Pose};

/// A closure on the way is as uncertain as so many metres more.
const CLOSURE_M: f64 = 1.0;

/// The ways along a map's links.
pub(super) struct Ways<'a> {
    poses: &'a PlacePoses,
    noise: OdometryNoise,
    /// Of each place: the places that links lead to, and how far it is along them.
    neighbours: Vec<Vec<(PlaceId, f64)>>,
}

impl<'a> Ways<'a> {
    pub(super) fn of(poses: &'a PlacePoses, noise: OdometryNoise) -> Self {
        let mut neighbours = vec![Vec::new(); poses.poses().len()];
        for edge in poses.trusted_edges() {
            let length_m = edge.measurement().x_m().hypot(edge.measurement().y_m());
            let length_m = match edge.kind() {
                EdgeKind::Odometry => length_m,
                EdgeKind::Closure => length_m + CLOSURE_M,
            };
            neighbours[edge.from()].push((edge.to() as PlaceId, length_m));
            neighbours[edge.to()].push((edge.from() as PlaceId, length_m));
        }
        Self { poses, noise, neighbours }
    }

    /// Metres along links from a place to each; infinite where none leads.
    pub(super) fn lengths_m(&self, from: PlaceId) -> Vec<f64> {
        self.paths([from]).lengths().to_vec()
    }

    /// Metres along links to the nearest of some places, and which of them that is.
    pub(super) fn nearest(&self, places: impl IntoIterator<Item = PlaceId>) -> Vec<(f64, PlaceId)> {
        let paths = self.paths(places);
        let origin = |origin: Option<usize>| origin.map_or(PlaceId::MAX, |origin| origin as PlaceId);
        let origins = paths.origins().into_iter().map(origin);
        paths.lengths().iter().copied().zip(origins).collect()
    }

    fn paths(&self, places: impl IntoIterator<Item = PlaceId>) -> ShortestPaths {
        let mut paths = ShortestPaths::new(self.neighbours.len());
        let steps = |place: usize| {
            let to = self.neighbours[place].iter();
            to.map(|&(to, length)| Step { to: to as usize, length, edge: 0 })
        };
        paths.search(places.into_iter().map(|place| place as usize), |_| false, steps);
        paths
    }

    /// How one place lies to another that is so many metres away along links: as the map's poses
    /// say, with what wheels turn at random on the way, and what they drift by where no loop has
    /// shown it.
    pub(super) fn between(&self, from: PlaceId, to: PlaceId, length_m: f64) -> Option<RelativePose> {
        let pose = self.poses.pose(from)?.inverse().compose(self.poses.pose(to)?);
        let drifts = self.poses.maker(from).into_iter().chain(self.poses.maker(to));
        let drift_known = drifts.into_iter().all(|session| self.poses.drift_rad_per_m(session) != 0.0);
        let drift = if drift_known { 0.0 } else { self.noise.heading_rad_per_m * length_m };
        let heading = self.noise.heading_floor_rad.hypot(RANDOM_TURN * length_m.sqrt()).hypot(drift);
        let straight_m = pose.x_m().hypot(pose.y_m());
        let position = self.noise.position_floor_m.hypot(self.noise.translation_share * straight_m);
        let position = position.hypot(heading * length_m / 2.0);
        let deviations = Vector3::new(position, position, heading);
        let variances = Matrix3::from_diagonal(&deviations.map(|deviation| deviation * deviation));
        RelativePose::new(pose, variances).ok()
    }
}
