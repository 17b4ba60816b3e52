//! Poses that agree with all measurements as well as they can.
//!
//! [`relax`] minimises the sum of eᵀΩe over the edges of a [`PoseGraph`], in the plane or in space, from odometry
//! alone or from where the poses were before.

mod block_cholesky;
mod graph;
mod levenberg;
mod pose;
mod starts;

pub use graph::{Edge, EdgeError, EdgeKind, MissingPose, PlanarGraph, PoseGraph, SpatialGraph};
pub use pose::{Linearized, PlanarPose, Pose};

use levenberg::{Minimum, NormalEquations, Stop};

/// Where relaxation starts from. What is fixed is where it is fixed, whatever the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start<'a, P> {
    /// Along odometry from the first pose on.
    Odometry,
    /// Rotations first, then positions: both are linear, so nothing is lost however odometry drifts.
    Chordal,
    /// Both of these; the lower minimum counts.
    Best,
    /// From these poses; those that are not among them follow along odometry.
    Poses(&'a [P]),
}

/// Settings of relaxation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxationSettings {
    /// It ends where the next step would lower the cost by less than this share.
    pub relative_gain: f64,
    /// It ends after so many steps.
    pub max_iterations: usize,
}

impl Default for RelaxationSettings {
    fn default() -> Self {
        Self { relative_gain: 1e-6, max_iterations: 200 }
    }
}

/// What relaxation came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Relaxed<P> {
    /// A pose for each of the graph's.
    pub poses: Vec<P>,
    /// Sum of eᵀΩe over the edges that were not judged wrong.
    pub cost: f64,
    /// Steps taken or tried, from all starts.
    pub iterations: usize,
    /// Weight of each edge: 0 of closures that were judged wrong, else 1.
    pub weights: Vec<f64>,
}

/// Relaxes a graph.
#[must_use]
pub fn relax<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    start: Start<'_, P>,
    settings: &RelaxationSettings,
) -> Relaxed<P> {
    let stop = Stop { relative_gain: settings.relative_gain, max_iterations: settings.max_iterations };
    let weights = vec![1.0; graph.edges().len()];
    let mut equations = NormalEquations::new(graph);
    let known = |poses: &[P]| {
        let mut known: Vec<Option<P>> = poses.iter().copied().map(Some).collect();
        known.resize(graph.poses(), None);
        for (&pose, &at) in graph.fixed() {
            known[pose] = Some(at);
        }
        known
    };
    let odometry = || starts::spanning_tree(graph, &known(&[]));
    let minimum: Minimum<P> = match start {
        Start::Odometry => equations.minimize(odometry(), &weights, stop),
        Start::Chordal => equations.minimize(starts::chordal(graph, odometry(), &weights), &weights, stop),
        Start::Poses(poses) => equations.minimize(starts::spanning_tree(graph, &known(poses)), &weights, stop),
        Start::Best => {
            let one = equations.minimize(starts::chordal(graph, odometry(), &weights), &weights, stop);
            let other = equations.minimize(odometry(), &weights, stop);
            let iterations = one.iterations + other.iterations;
            let best = if other.cost < one.cost { other } else { one };
            Minimum { iterations, ..best }
        }
    };
    let Minimum { poses, cost, iterations } = minimum;
    Relaxed { poses, cost, iterations, weights }
}
