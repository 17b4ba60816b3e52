//! Weighted nonlinear least squares over a pose graph, by Levenberg and Marquardt.

use nalgebra::{SMatrix, SVector};

use super::block_cholesky::{BlockCholesky, Slot};
use crate::graph::PoseGraph;
use crate::pose::Pose;

/// The problem's structure, analysed once: which poses move, and what the normal equations look
/// like.
pub(super) struct NormalEquations<'a, P, const D: usize> {
    graph: &'a PoseGraph<P, D>,
    /// Unknown of each pose; `None` for anchors.
    unknown: Vec<Option<usize>>,
    /// Where the block between an edge's ends lies; `None` if either is an anchor.
    slots: Vec<Option<Slot>>,
    matrix: BlockCholesky<D>,
    /// Half of the cost's gradient, unknown by unknown.
    gradient: Vec<f64>,
}

/// When a minimisation ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stop {
    /// Share of the cost that the next step would have to gain.
    pub(super) relative_gain: f64,
    /// Most steps, refused ones among them.
    pub(super) max_iterations: usize,
    /// The cost that another start has come to: one that costs [`HOPELESS`] times as much after [`FIRST_ITERATIONS`] is
    /// given up.
    pub(super) rival_cost: f64,
}

/// Steps after which one start, or alternative, is compared with the best one so far.
pub(super) const FIRST_ITERATIONS: usize = 20;
/// How many times as much as the best one it may cost then.
pub(super) const HOPELESS: f64 = 2.0;

/// Where a minimisation ended.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Minimum<P> {
    pub(super) poses: Vec<P>,
    /// Weighted.
    pub(super) cost: f64,
    pub(super) iterations: usize,
}

/// First damping after a step that did not go down, as a share of the diagonal. Long chains are
/// soft: their least eigenvalues are a millionth of the diagonal and less, and more damping would
/// make steps creep.
const FIRST_DAMPING: f64 = 1e-9;
/// Damping beyond which a step no longer moves anything.
const LAST_DAMPING: f64 = 1e12;
/// Keeps parts in place that hang by edges of no weight alone; too little to slow anything down.
const LEAST_DAMPING: f64 = 1e-10;

impl<'a, P: Pose<D>, const D: usize> NormalEquations<'a, P, D> {
    pub(super) fn new(graph: &'a PoseGraph<P, D>) -> Self {
        let mut unknown: Vec<Option<usize>> = vec![Some(0); graph.poses()];
        graph.anchors().into_iter().for_each(|anchor| unknown[anchor] = None);
        let mut unknowns = 0;
        for unknown in unknown.iter_mut().flatten() {
            *unknown = unknowns;
            unknowns += 1;
        }
        let ends = |edge: &crate::graph::Edge<P, D>| unknown[edge.from()].zip(unknown[edge.to()]);
        let pairs: Vec<(usize, usize)> = graph.edges().iter().filter_map(ends).collect();
        let matrix = BlockCholesky::new(unknowns, &pairs);
        let slots =
            graph.edges().iter().map(|edge| ends(edge).map(|(from, to)| matrix.slot(from, to))).collect();
        Self { graph, unknown, slots, matrix, gradient: vec![0.0; unknowns * D] }
    }

    /// Sum of w eᵀΩe.
    pub(super) fn cost(&self, poses: &[P], weights: &[f64]) -> f64 {
        let edges = self.graph.edges().iter().zip(weights).filter(|&(_, &weight)| weight > 0.0);
        edges.map(|(edge, weight)| weight * edge.cost(poses)).sum()
    }

    /// JᵀWΩJ and JᵀWΩe at these poses.
    fn linearize(&mut self, poses: &[P], weights: &[f64]) {
        self.matrix.clear();
        self.gradient.fill(0.0);
        for ((edge, slot), &weight) in self.graph.edges().iter().zip(&self.slots).zip(weights) {
            if weight == 0.0 {
                continue;
            }
            let from = edge.from();
            let to = edge.to();
            let linear = P::linearized(edge.measurement(), &poses[from], &poses[to]);
            let information = edge.information() * weight;
            let weighted_to = linear.by_to.transpose() * information;
            if let Some(to) = self.unknown[to] {
                self.matrix.add_diagonal(to, &(weighted_to * linear.by_to));
                add(&mut self.gradient, to, &(weighted_to * linear.error));
            }
            if let Some(slot) = *slot {
                // (by_toᵀ Ω by_from)ᵀ
                self.matrix.add(slot, &(weighted_to * linear.by_from).transpose());
            }
            if let Some(from) = self.unknown[from] {
                let weighted_from = linear.by_from.transpose() * information;
                self.matrix.add_diagonal(from, &(weighted_from * linear.by_from));
                add(&mut self.gradient, from, &(weighted_from * linear.error));
            }
        }
    }

    /// Poses of least weighted cost near `start`, whose cost they never exceed.
    pub(super) fn minimize(&mut self, start: Vec<P>, weights: &[f64], stop: Stop) -> Minimum<P> {
        let least = if weights.contains(&0.0) { LEAST_DAMPING } else { 0.0 };
        let mut minimum = Minimum { cost: self.cost(&start, weights), poses: start, iterations: 0 };
        let mut damping = least;
        let mut growth = 2.0;
        let mut step = Vec::new();
        let mut diagonal = Vec::new();
        let mut current = false;
        while minimum.iterations < stop.max_iterations {
            if minimum.iterations == FIRST_ITERATIONS && minimum.cost > HOPELESS * stop.rival_cost {
                break;
            }
            if !current {
                self.linearize(&minimum.poses, weights);
                diagonal = self.matrix.diagonal();
                current = true;
            }
            minimum.iterations += 1;
            self.matrix.set_diagonal(diagonal.iter().map(|value| value * (1.0 + damping)));
            step.clear();
            step.extend(self.gradient.iter().map(|value| -value));
            let solved = self.matrix.solve(&mut step);
            let promised = if solved.is_ok() {
                promised_gain(&step, &self.gradient, &diagonal, damping)
            } else {
                f64::NAN
            };
            let candidate = self.stepped(&minimum.poses, &step);
            let cost = if promised.is_nan() { f64::NAN } else { self.cost(&candidate, weights) };
            if cost < minimum.cost {
                let ratio = (minimum.cost - cost) / promised;
                let converged = minimum.cost - cost <= stop.relative_gain * minimum.cost
                    && promised <= stop.relative_gain * minimum.cost;
                (minimum.poses, minimum.cost, current) = (candidate, cost, false);
                if converged {
                    break;
                }
                // Nielsen's rule: less damping the better the promise was kept.
                damping *= (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0);
                if damping < FIRST_DAMPING {
                    damping = least;
                }
                growth = 2.0;
            } else {
                if promised <= stop.relative_gain * minimum.cost || damping > LAST_DAMPING {
                    break;
                }
                damping = (damping * growth).max(FIRST_DAMPING);
                growth *= 2.0;
            }
        }
        minimum
    }

    fn stepped(&self, poses: &[P], step: &[f64]) -> Vec<P> {
        let one = |(pose, unknown): (&P, &Option<usize>)| match *unknown {
            Some(unknown) => pose.retract(&SVector::from_column_slice(&step[unknown * D..(unknown + 1) * D])),
            None => *pose,
        };
        poses.iter().zip(&self.unknown).map(one).collect()
    }
}

fn add<const D: usize>(gradient: &mut [f64], unknown: usize, part: &SMatrix<f64, D, 1>) {
    gradient[unknown * D..(unknown + 1) * D].iter_mut().zip(part.iter()).for_each(|(sum, part)| *sum += part);
}

/// By how much the quadratic model of the cost falls: -gᵀs + λ sᵀDs, where (H + λD) s = -g.
fn promised_gain(step: &[f64], gradient: &[f64], diagonal: &[f64], damping: f64) -> f64 {
    let terms = step.iter().zip(gradient).zip(diagonal);
    terms.map(|((step, gradient), diagonal)| step * (damping * diagonal * step - gradient)).sum()
}
