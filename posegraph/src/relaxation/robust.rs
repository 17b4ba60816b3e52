//! Relaxation where closures may be wrong: what agrees is relaxed, and what then fits is taken in.

use std::f64::consts::LN_2;

use super::consensus::{Consensus, MAX_UNSURE, Noise, log_volume};
use super::levenberg::{FIRST_ITERATIONS, HOPELESS, Minimum, NormalEquations, Stop};
use super::{Relaxed, Start, starts};
use crate::graph::{EdgeKind, PoseGraph};
use crate::pose::Pose;

/// How many wrong closures may fit by chance, if all of them were wrong and led anywhere in the
/// map.
const BY_CHANCE: f64 = 0.01;
/// A closure that misses by more standard deviations is wrong, however large the map. Real ones
/// miss by that many where information matrices are overconfident.
const MOST_DEVIATIONS: f64 = 30.0;
/// Closures that are excluded at once, at most.
const MAX_EXCLUDED: usize = 4;
/// Changes of mind about single closures.
const MAX_ROUNDS: usize = 20;

/// A graph being relaxed with its closures judged.
pub(super) struct Judging<'a, P, const D: usize> {
    graph: &'a PoseGraph<P, D>,
    equations: NormalEquations<'a, P, D>,
    /// Where an edge's cost shows that it is wrong.
    limits: Vec<f64>,
    stop: Stop,
    iterations: usize,
}

impl<'a, P: Pose<D>, const D: usize> Judging<'a, P, D> {
    /// `poses` say how large the map is, roughly.
    pub(super) fn new(graph: &'a PoseGraph<P, D>, poses: &[P], stop: Stop) -> Self {
        let equations = NormalEquations::new(graph);
        let limits = limits(graph, poses);
        Self { graph, equations, limits, stop, iterations: 0 }
    }

    /// Judges all closures again.
    ///
    /// How large noise is decides much, and so does each closure that little speaks for: all that
    /// is tried, and what truncated squares are least of counts.
    pub(super) fn judge_all(mut self, start: Start<'_, P>, first: &[P]) -> Relaxed<P> {
        let mut consensus = Consensus::new(self.graph, first);
        let mut best: Option<(f64, Relaxed<P>)> = None;
        for noise in [Noise::AsSeen, Noise::AsStated] {
            let mut excluded = Vec::new();
            let mut unsure = self.try_without(noise, &excluded, start, first, &mut consensus, &mut best).0;
            // Greedily: of the closures that little speaks for, the one is excluded without which
            // most is gained.
            while unsure.len() < MAX_UNSURE && excluded.len() < MAX_EXCLUDED {
                let mut gained = None;
                for &closure in &unsure {
                    let without = [&excluded[..], &[closure]].concat();
                    let (left, better) =
                        self.try_without(noise, &without, start, first, &mut consensus, &mut best);
                    if better {
                        gained = Some((without, left));
                    }
                }
                let Some(better) = gained else { break };
                (excluded, unsure) = better;
            }
        }
        let relaxed = match best {
            Some((_, relaxed)) => self.without_misfits(relaxed),
            None => self.settle(first.to_vec(), vec![1.0; self.graph.edges().len()]),
        };
        Relaxed { iterations: self.iterations, ..relaxed }
    }

    /// Relaxes what is agreed on without some closures, and keeps it if it is better than the best
    /// so far. Returns the closures that were accepted although little spoke for them, and whether
    /// it was better.
    fn try_without(
        &mut self,
        noise: Noise,
        excluded: &[usize],
        start: Start<'_, P>,
        first: &[P],
        consensus: &mut Consensus<'_, P, D>,
        best: &mut Option<(f64, Relaxed<P>)>,
    ) -> (Vec<usize>, bool) {
        let accepted = consensus.reach(noise, excluded);
        let weights: Vec<f64> = accepted.edges.into_iter().map(weight).collect();
        if best.as_ref().is_some_and(|(_, best)| best.weights == weights) {
            return (accepted.unsure, false);
        }
        let from = match start {
            Start::Chordal | Start::Best => starts::chordal(self.graph, first.to_vec(), &weights),
            Start::Odometry | Start::Poses(_) | Start::Earlier(_) => first.to_vec(),
        };
        let tried = self.minimize(from, &weights, FIRST_ITERATIONS);
        let hopeless = |(least, _): &(f64, Relaxed<P>)| self.truncated(&tried.poses) > HOPELESS * least;
        if best.as_ref().is_some_and(hopeless) {
            return (accepted.unsure, false);
        }
        let relaxed = self.settle(tried.poses, weights);
        let truncated = self.truncated(&relaxed.poses);
        let better = best.as_ref().is_none_or(|(least, _)| truncated < *least);
        if better {
            *best = Some((truncated, relaxed));
        }
        (accepted.unsure, better)
    }

    /// Judges only what was added since `earlier`, and all if that leaves a contradiction.
    ///
    /// A closure that is added is wrong if the surest way around it leads elsewhere. It may be,
    /// though, that one accepted before is the wrong one. So all are judged if one that is kept no
    /// longer fits, or those that were added raise the cost by more than noise would; and when two,
    /// four, eight and so on have been left out.
    pub(super) fn judge_added(mut self, earlier: &Relaxed<P>, first: &[P]) -> Relaxed<P> {
        let edges = self.graph.edges();
        let known = earlier.weights.len().min(edges.len());
        let mut accepted: Vec<bool> = earlier.weights[..known].iter().map(|&weight| weight > 0.0).collect();
        let left_out = |accepted: &[bool]| accepted.iter().filter(|&&accepted| !accepted).count();
        let left_out_before = left_out(&accepted);
        accepted.extend(edges[known..].iter().map(|edge| edge.kind() == EdgeKind::Odometry));
        let added: Vec<usize> = (known..edges.len()).filter(|&edge| !accepted[edge]).collect();
        if !added.is_empty() {
            let mut consensus = Consensus::new(self.graph, first);
            for &closure in &added {
                accepted[closure] = consensus.agrees(closure, &accepted);
            }
        }
        let left_out = left_out(&accepted);
        if left_out > left_out_before && left_out >= 2 && left_out.ilog2() > left_out_before.max(1).ilog2() {
            return self.judge_all(Start::Earlier(earlier), first);
        }
        let weights: Vec<f64> = accepted.into_iter().map(weight).collect();
        let Minimum { poses, cost, iterations: _ } = self.minimize(first.to_vec(), &weights, usize::MAX);
        let raised = cost - earlier.cost > P::CHI_SQUARED_MILLION * added.len() as f64;
        if !added.is_empty() && (raised || weights != self.fitting(&poses, &weights)) {
            return self.judge_all(Start::Earlier(earlier), first);
        }
        Relaxed { poses, cost, iterations: self.iterations, weights }
    }

    /// Relaxes, and changes its mind about closures that do not fit, or fit after all, until it
    /// stays.
    fn settle(&mut self, start: Vec<P>, mut weights: Vec<f64>) -> Relaxed<P> {
        let mut minimum = self.minimize(start, &weights, usize::MAX);
        for _ in 0..MAX_ROUNDS {
            let judged = self.fitting(&minimum.poses, &vec![1.0; weights.len()]);
            if judged == weights {
                break;
            }
            weights = judged;
            minimum = self.minimize(minimum.poses, &weights, usize::MAX);
        }
        let Minimum { poses, cost, iterations: _ } = minimum;
        Relaxed { poses, cost, iterations: self.iterations, weights }
    }

    /// Leaves out closures that cost more than noise mostly does, worst first, where that gains
    /// more than it takes; and takes in what fits well then.
    fn without_misfits(&mut self, relaxed: Relaxed<P>) -> Relaxed<P> {
        let mut best = relaxed;
        let mut least = self.truncated(&best.poses);
        for misfit in self.misfits(&best) {
            let mut weights = best.weights.clone();
            weights[misfit] = 0.0;
            let mut minimum = self.minimize(best.poses.clone(), &weights, usize::MAX);
            for (weight, edge) in weights.iter_mut().zip(self.graph.edges()) {
                if edge.cost(&minimum.poses) <= P::CHI_SQUARED_HUNDRED {
                    *weight = 1.0;
                }
            }
            minimum = self.minimize(minimum.poses, &weights, usize::MAX);
            let truncated = self.truncated(&minimum.poses);
            if truncated < least {
                best = Relaxed {
                    poses: minimum.poses,
                    cost: minimum.cost,
                    iterations: self.iterations,
                    weights,
                };
                least = truncated;
            }
        }
        best
    }

    /// The closures kept that cost most, worst first.
    fn misfits(&self, relaxed: &Relaxed<P>) -> Vec<usize> {
        let mut misfits = Vec::new();
        for (number, edge) in self.graph.edges().iter().enumerate() {
            let cost = edge.cost(&relaxed.poses);
            let kept = edge.kind() == EdgeKind::Closure && relaxed.weights[number] > 0.0;
            if kept && cost > P::CHI_SQUARED_HUNDRED {
                misfits.push((cost, number));
            }
        }
        misfits.sort_by(|one, other| other.0.total_cmp(&one.0));
        misfits.into_iter().take(MAX_UNSURE).map(|(_, closure)| closure).collect()
    }

    /// Weights without the closures that do not fit.
    fn fitting(&self, poses: &[P], weights: &[f64]) -> Vec<f64> {
        let edges = self.graph.edges().iter().zip(&self.limits);
        let fits = |(edge, limit): (&crate::graph::Edge<P, D>, &f64)| {
            edge.kind() == EdgeKind::Odometry || edge.cost(poses) <= *limit
        };
        edges.map(fits).zip(weights).map(|(fits, &given)| if fits { given } else { 0.0 }).collect()
    }

    fn minimize(&mut self, start: Vec<P>, weights: &[f64], max_iterations: usize) -> Minimum<P> {
        let stop = Stop { max_iterations: max_iterations.min(self.stop.max_iterations), ..self.stop };
        let minimum = self.equations.minimize(start, weights, stop);
        self.iterations += minimum.iterations;
        minimum
    }

    /// The cost of all edges, where no closure costs more than one may that is kept.
    fn truncated(&self, poses: &[P]) -> f64 {
        let truncated = |edge: &crate::graph::Edge<P, D>| match edge.kind() {
            EdgeKind::Odometry => edge.cost(poses),
            EdgeKind::Closure => edge.cost(poses).min(P::CHI_SQUARED_MILLION),
        };
        self.graph.edges().iter().map(truncated).sum()
    }
}

fn weight(accepted: bool) -> f64 {
    if accepted { 1.0 } else { 0.0 }
}

/// Squared distances up to which a closure is kept: as far as few wrong ones would come by chance,
/// if they led anywhere in the map. Real closures have worse tails than their information matrices
/// say.
fn limits<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>, poses: &[P]) -> Vec<f64> {
    let closures = graph.edges().iter().filter(|edge| edge.kind() == EdgeKind::Closure).count();
    // Errors of rotations in space are sines of half angles: half as large in each of three directions.
    let halves = if P::SPACE == 3 { 3.0 * LN_2 } else { 0.0 };
    let log_volume = log_volume::<P, D>(poses, 0.0) - halves;
    let share = (BY_CHANCE / closures.max(1) as f64).ln() + log_volume - P::UNIT_BALL.ln();
    let limit = |edge: &crate::graph::Edge<P, D>| {
        let log_deviations = edge
            .information()
            .cholesky()
            .map_or(0.0, |factor| (0..D).map(|i| factor.l_dirty()[(i, i)].ln()).sum::<f64>());
        let chance = ((share + log_deviations) * 2.0 / D as f64).exp();
        chance.clamp(P::CHI_SQUARED_MILLION, MOST_DEVIATIONS * MOST_DEVIATIONS)
    };
    graph.edges().iter().map(limit).collect()
}
