//! Poses joined by edges that measure how they lie to each other.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nalgebra::{Isometry3, SMatrix};

use crate::planar::PlanarPose;
use crate::pose::Pose;

/// A pose graph in the plane.
pub type PlanarGraph = PoseGraph<PlanarPose, 3>;
/// A pose graph in space.
pub type SpatialGraph = PoseGraph<Isometry3<f64>, 6>;

/// What kind of evidence an edge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Measured by wheels between one pose and the next: noisy, but never of another place.
    Odometry,
    /// A place recognised: it may be wrong.
    Closure,
}

/// One measurement: the pose `to`, seen from the pose `from`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge<P, const D: usize> {
    from: usize,
    to: usize,
    measurement: P,
    information: SMatrix<f64, D, D>,
    kind: EdgeKind,
}

/// An edge that measures nothing.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EdgeError {
    /// Both ends are the same pose.
    #[error("the edge {pose} -> {pose} leads to where it comes from; leave it out")]
    Loop {
        /// The pose.
        pose: usize,
    },
    /// A number is NaN or infinite.
    #[error("the edge {from} -> {to} has a number that is not finite; leave the edge out")]
    NotFinite {
        /// Pose that the edge leaves.
        from: usize,
        /// Pose that it leads to.
        to: usize,
    },
    /// The information matrix is not symmetric and positive definite.
    #[error(
        "the information matrix of the edge {from} -> {to} is not positive definite; give the inverse of the \
         measurement's covariance, small but above zero along what was not measured"
    )]
    NotPositiveDefinite {
        /// Pose that the edge leaves.
        from: usize,
        /// Pose that it leads to.
        to: usize,
    },
}

/// An edge or a fixed pose that the graph has no pose for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no pose {pose}, the graph has {poses}; add the pose first")]
pub struct MissingPose {
    /// What was named.
    pub pose: usize,
    /// How many there are.
    pub poses: usize,
}

impl<P: Pose<D>, const D: usize> Edge<P, D> {
    /// `information` is the inverse of the covariance of the error as [`Pose::error`] has it.
    ///
    /// # Errors
    /// [`EdgeError`] if the ends are one, a number is not finite or the information not positive
    /// definite.
    pub fn new(
        from: usize,
        to: usize,
        measurement: P,
        information: SMatrix<f64, D, D>,
        kind: EdgeKind,
    ) -> Result<Self, EdgeError> {
        if from == to {
            return Err(EdgeError::Loop { pose: from });
        }
        if !measurement.is_finite() || information.iter().any(|value| !value.is_finite()) {
            return Err(EdgeError::NotFinite { from, to });
        }
        if !is_positive_definite(&information) {
            return Err(EdgeError::NotPositiveDefinite { from, to });
        }
        Ok(Self { from, to, measurement, information, kind })
    }

    /// Pose that the edge leaves.
    #[must_use]
    pub fn from(&self) -> usize {
        self.from
    }

    /// Pose that it leads to.
    #[must_use]
    pub fn to(&self) -> usize {
        self.to
    }

    /// The pose `to`, seen from the pose `from`.
    #[must_use]
    pub fn measurement(&self) -> &P {
        &self.measurement
    }

    /// Inverse of the error's covariance.
    #[must_use]
    pub fn information(&self) -> &SMatrix<f64, D, D> {
        &self.information
    }

    /// Odometry or closure.
    #[must_use]
    pub fn kind(&self) -> EdgeKind {
        self.kind
    }

    /// eᵀΩe: how badly poses meet the measurement.
    #[must_use]
    pub fn cost(&self, poses: &[P]) -> f64 {
        let error = P::error(&self.measurement, &poses[self.from], &poses[self.to]);
        error.dot(&(self.information * error))
    }
}

/// Whether Cholesky's pivots are all clearly above zero, however different the units.
fn is_positive_definite<const D: usize>(matrix: &SMatrix<f64, D, D>) -> bool {
    let scale: [f64; D] = std::array::from_fn(|i| matrix[(i, i)].sqrt());
    if scale.iter().any(|&scale| scale.is_nan() || scale <= 0.0) {
        return false;
    }
    let scaled =
        SMatrix::<f64, D, D>::from_fn(|row, column| matrix[(row, column)] / (scale[row] * scale[column]));
    let symmetric = (scaled - scaled.transpose()).amax() <= 1e-9;
    // 1e-6, squared, of the unit diagonal.
    symmetric && scaled.cholesky().is_some_and(|factor| (0..D).all(|i| factor.l_dirty()[(i, i)] > 1e-6))
}

/// Poses, numbered from 0, and edges between them.
///
/// Where nothing is fixed, each connected part is held by its lowest pose: parts that no edge joins
/// stay where they are to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseGraph<P, const D: usize> {
    poses: usize,
    edges: Vec<Edge<P, D>>,
    fixed: BTreeMap<usize, P>,
}

impl<P: Pose<D>, const D: usize> PoseGraph<P, D> {
    /// A graph without edges.
    #[must_use]
    pub fn new(poses: usize) -> Self {
        Self { poses, edges: Vec::new(), fixed: BTreeMap::new() }
    }

    /// One pose more; returns its number.
    pub fn add_pose(&mut self) -> usize {
        self.poses += 1;
        self.poses - 1
    }

    /// One edge more; returns its number.
    ///
    /// # Errors
    /// [`MissingPose`] if it has an end that the graph has not; the graph is as before then.
    pub fn add_edge(&mut self, edge: Edge<P, D>) -> Result<usize, MissingPose> {
        self.has(edge.from)?;
        self.has(edge.to)?;
        self.edges.push(edge);
        Ok(self.edges.len() - 1)
    }

    /// Holds a pose where it is known to be.
    ///
    /// # Errors
    /// [`MissingPose`] if the graph has it not.
    pub fn fix(&mut self, pose: usize, at: P) -> Result<(), MissingPose> {
        self.has(pose)?;
        self.fixed.insert(pose, at);
        Ok(())
    }

    fn has(&self, pose: usize) -> Result<(), MissingPose> {
        if pose < self.poses { Ok(()) } else { Err(MissingPose { pose, poses: self.poses }) }
    }

    /// How many poses there are.
    #[must_use]
    pub fn poses(&self) -> usize {
        self.poses
    }

    /// The edges, in the order in which they were added.
    #[must_use]
    pub fn edges(&self) -> &[Edge<P, D>] {
        &self.edges
    }

    /// What was fixed, and where.
    #[must_use]
    pub fn fixed(&self) -> &BTreeMap<usize, P> {
        &self.fixed
    }

    /// Sum of eᵀΩe over all edges, without a factor of one half: what g2o calls chi2.
    ///
    /// # Panics
    /// If there are fewer `at` than the graph has poses.
    #[must_use]
    pub fn cost(&self, at: &[P]) -> f64 {
        self.edges.iter().map(|edge| edge.cost(at)).sum()
    }

    /// The poses that an edge or a fixing says something of, by their numbers in ascending order, and
    /// the graph of these alone, where they have the numbers from 0 on.
    #[must_use]
    pub fn known_part(&self) -> (Vec<usize>, Self) {
        let ends = self.edges.iter().flat_map(|edge| [edge.from, edge.to]);
        let known: Vec<usize> =
            ends.chain(self.fixed.keys().copied()).collect::<BTreeSet<_>>().into_iter().collect();
        let renumbered: BTreeMap<usize, usize> = known.iter().copied().zip(0..).collect();
        let edges = self.edges.iter();
        let edges =
            edges.map(|edge| Edge { from: renumbered[&edge.from], to: renumbered[&edge.to], ..*edge });
        let fixed = self.fixed.iter().map(|(pose, at)| (renumbered[pose], *at));
        let part = Self { poses: known.len(), edges: edges.collect(), fixed: fixed.collect() };
        (known, part)
    }

    /// The poses that do not move: what is fixed, and the lowest of each part where nothing is.
    pub(super) fn anchors(&self) -> Vec<usize> {
        let neighbours = Neighbours::of(self);
        let mut reached = vec![false; self.poses];
        let mut anchors: Vec<usize> = self.fixed.keys().copied().collect();
        for &anchor in self.fixed.keys() {
            neighbours.flood(anchor, &mut reached);
        }
        for pose in 0..self.poses {
            if !reached[pose] {
                anchors.push(pose);
                neighbours.flood(pose, &mut reached);
            }
        }
        anchors.sort_unstable();
        anchors
    }
}

/// The edges at each pose, by their numbers, in order.
pub(super) struct Neighbours {
    begins: Vec<usize>,
    edges: Vec<(usize, usize)>,
}

impl Neighbours {
    pub(super) fn of<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>) -> Self {
        let mut begins = vec![0; graph.poses + 1];
        for edge in &graph.edges {
            begins[edge.from + 1] += 1;
            begins[edge.to + 1] += 1;
        }
        for pose in 0..graph.poses {
            begins[pose + 1] += begins[pose];
        }
        let mut free = begins.clone();
        let mut edges = vec![(0, 0); 2 * graph.edges.len()];
        for (number, edge) in graph.edges.iter().enumerate() {
            for (end, other) in [(edge.from, edge.to), (edge.to, edge.from)] {
                edges[free[end]] = (number, other);
                free[end] += 1;
            }
        }
        Self { begins, edges }
    }

    /// Number of the edge, and the pose at its other end.
    pub(super) fn at(&self, pose: usize) -> &[(usize, usize)] {
        &self.edges[self.begins[pose]..self.begins[pose + 1]]
    }

    fn flood(&self, start: usize, reached: &mut [bool]) {
        let mut waiting = VecDeque::from([start]);
        reached[start] = true;
        while let Some(pose) = waiting.pop_front() {
            for &(_, other) in self.at(pose) {
                if !std::mem::replace(&mut reached[other], true) {
                    waiting.push_back(other);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
