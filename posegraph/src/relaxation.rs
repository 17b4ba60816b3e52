//! Poses that agree with all measurements as well as they can.
//!
//! [`relax`] minimises the sum of eᵀΩe over the edges of a [`PoseGraph`], in the plane or in space,
//! from odometry alone or from where the poses were before. A map that grows keeps its graph and
//! the last [`Relaxed`], adds poses and edges to the graph, and relaxes it from [`Start::Earlier`].

mod block_cholesky;
mod consensus;
mod levenberg;
mod robust;
mod starts;

use crate::graph::PoseGraph;
use crate::pose::Pose;
use levenberg::{Minimum, NormalEquations, Stop};
use robust::Judging;

/// Where relaxation starts from. What is fixed is where it is fixed, whatever the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start<'a, P> {
    /// Along odometry from the first pose on.
    Odometry,
    /// Rotations first, then positions: both are linear, so nothing is lost however odometry
    /// drifts.
    Chordal,
    /// Both of these; the lower minimum counts. Odometry is not tried where rotations first leave no more
    /// than noise, which no start gets below but by chance; and it is given up after 20 steps if it costs
    /// twice as much then.
    Best,
    /// From these poses; those that are not among them follow along odometry.
    Poses(&'a [P]),
    /// From what the graph was relaxed to before poses and edges were added to it; only closures
    /// that were added are judged, where closures are. Poses that are new follow along odometry.
    Earlier(&'a Relaxed<P>),
}

/// Whether closures may be wrong. Odometry is trusted always.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Closures {
    /// They are judged, and left out where they contradict what most agree on.
    #[default]
    Judged,
    /// None is wrong: least squares over all edges.
    Trusted,
}

/// Settings of relaxation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelaxationSettings {
    /// Whether closures may be wrong.
    pub closures: Closures,
    /// It ends where the next step would lower the cost by less than this share.
    pub relative_gain: f64,
    /// It ends after so many steps from one start.
    pub max_iterations: usize,
}

impl Default for RelaxationSettings {
    fn default() -> Self {
        Self { closures: Closures::default(), relative_gain: 1e-6, max_iterations: 200 }
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

/// Relaxes a graph: the poses at which the sum of eᵀΩe over its edges is least, as far as the start
/// leads there.
///
/// Where closures are trusted, the cost never exceeds that of the start. What is fixed does not
/// move; where nothing is, the lowest pose of each connected part stays where it starts. One
/// thread, the same bits always.
#[must_use]
pub fn relax<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    start: Start<'_, P>,
    settings: &RelaxationSettings,
) -> Relaxed<P> {
    let stop = Stop {
        relative_gain: settings.relative_gain,
        max_iterations: settings.max_iterations,
        rival_cost: f64::INFINITY,
    };
    let first = first_poses(graph, start);
    match settings.closures {
        Closures::Judged => {
            let judging = Judging::new(graph, &first, stop);
            match start {
                Start::Earlier(earlier) => judging.judge_added(earlier, &first),
                Start::Odometry | Start::Chordal | Start::Best | Start::Poses(_) => {
                    judging.judge_all(start, &first)
                }
            }
        }
        Closures::Trusted => {
            let weights = vec![1.0; graph.edges().len()];
            let mut equations = NormalEquations::new(graph);
            let chordal = || starts::chordal(graph, first.clone(), &weights);
            let Minimum { poses, cost, iterations } = match start {
                Start::Odometry | Start::Poses(_) | Start::Earlier(_) => {
                    equations.minimize(first, &weights, stop)
                }
                Start::Chordal => equations.minimize(chordal(), &weights, stop),
                Start::Best => {
                    let one = equations.minimize(chordal(), &weights, stop);
                    if is_noise(graph, &one) {
                        let Minimum { poses, cost, iterations } = one;
                        return Relaxed { poses, cost, iterations, weights };
                    }
                    let other = equations.minimize(first, &weights, Stop { rival_cost: one.cost, ..stop });
                    let iterations = one.iterations + other.iterations;
                    let lower = if other.cost < one.cost { other } else { one };
                    Minimum { iterations, ..lower }
                }
            };
            Relaxed { poses, cost, iterations, weights }
        }
    }
}

/// Whether what a minimum leaves over is noise as the edges state it, or less, and spread over them as noise is. A map that
/// is bent or folded keeps large errors at a few edges, also where all information is understated.
fn is_noise<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>, minimum: &Minimum<P>) -> bool {
    let unknowns = graph.poses() - graph.anchors().len();
    let freedom = (D * graph.edges().len().saturating_sub(unknowns)) as f64;
    // In a smaller graph one edge could hold all that is left over.
    if freedom <= P::CHI_SQUARED_MILLION {
        return false;
    }
    // Chi squared has this mean, and twice that as its variance.
    let most = freedom + 3.0 * (2.0 * freedom).sqrt();
    let most_at_an_edge = P::CHI_SQUARED_MILLION * (minimum.cost / freedom).min(1.0);
    minimum.cost <= most && graph.edges().iter().all(|edge| edge.cost(&minimum.poses) <= most_at_an_edge)
}

/// A pose for each of the graph's, before anything is relaxed: along odometry from what is known.
fn first_poses<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>, start: Start<'_, P>) -> Vec<P> {
    let given = match start {
        Start::Odometry | Start::Chordal | Start::Best => &[],
        Start::Poses(poses) => poses,
        Start::Earlier(earlier) => &earlier.poses,
    };
    let mut known: Vec<Option<P>> = given.iter().copied().map(Some).collect();
    known.resize(graph.poses(), None);
    for (&pose, &at) in graph.fixed() {
        known[pose] = Some(at);
    }
    starts::spanning_tree(graph, &known)
}
