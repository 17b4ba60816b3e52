//! Which closures agree with odometry and with each other, before anything is relaxed.
//!
//! A closure is compared with the surest way that leads around it: along odometry and closures
//! already accepted. What the two differ by is either noise, whose covariance the way adds up, or
//! the closure is wrong and leads anywhere in the map. The logarithm of how much likelier the first
//! is says how much agreement there is; short ways say much, long ones little. So what is sure is
//! accepted first, and shortens the ways around the rest.

use std::f64::consts::{PI, TAU};

use nalgebra::SMatrix;

use crate::graph::{Edge, EdgeKind, Neighbours, PoseGraph};
use crate::pose::Pose;
use crate::shortest_paths::{ShortestPaths, Step};

/// Agreement from which a closure is accepted, in nats, in rounds: the surest first.
const AGREEMENT_NATS: [f64; 3] = [10.0, 6.0, 3.0];
/// Closures that it takes to say how large noise really is.
const ENOUGH_FOR_SCALE: usize = 10;
/// Least noise, as a share of what the information matrices say: variances.
const LEAST_NOISE: f64 = 1e-3;

/// Most closures that are accepted although little speaks for them.
pub(super) const MAX_UNSURE: usize = 10;

/// How large noise is taken to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Noise {
    /// As the information matrices say.
    AsStated,
    /// As large as the closures show that agree with odometry beyond doubt.
    AsSeen,
}

/// Which closures were accepted.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Accepted {
    /// One for each edge; true of all odometry.
    pub(super) edges: Vec<bool>,
    /// Those that nothing spoke against, and little for.
    pub(super) unsure: Vec<usize>,
}

/// A pose graph, prepared for judging its closures.
pub(super) struct Consensus<'a, P, const D: usize> {
    graph: &'a PoseGraph<P, D>,
    neighbours: Neighbours,
    /// Covariance of each edge, as a step at its end.
    covariances: Vec<SMatrix<f64, D, D>>,
    /// One number for it, in square metres, for finding sure ways.
    uncertainty: Vec<f64>,
    /// Volume of all that a wrong closure may say: positions times rotations.
    log_volume: f64,
    paths: ShortestPaths,
}

/// What is said of one closure.
struct Agreement {
    nats: f64,
    /// Squared Mahalanobis distance.
    squared: f64,
}

impl<'a, P: Pose<D>, const D: usize> Consensus<'a, P, D> {
    /// `poses` say how large the map is, roughly.
    pub(super) fn new(graph: &'a PoseGraph<P, D>, poses: &[P]) -> Self {
        let edges = graph.edges();
        let covariances: Vec<SMatrix<f64, D, D>> = edges.iter().map(covariance_of_step).collect();
        let squares = edges.iter().map(|edge| edge.measurement().position().norm_squared());
        let squared_length = squares.sum::<f64>() / edges.len().max(1) as f64;
        let trace = |covariance: &SMatrix<f64, D, D>, axes: std::ops::Range<usize>| {
            axes.map(|i| covariance[(i, i)]).sum::<f64>()
        };
        let uncertainty = covariances
            .iter()
            .map(|covariance| {
                trace(covariance, 0..P::SPACE) + squared_length * trace(covariance, P::SPACE..D)
            })
            .collect();
        let log_volume = log_volume::<P, D>(poses, squared_length.sqrt());
        let neighbours = Neighbours::of(graph);
        let paths = ShortestPaths::new(graph.poses());
        Self { graph, neighbours, covariances, uncertainty, log_volume, paths }
    }

    /// Accepts closures, all but `excluded`.
    pub(super) fn reach(&mut self, noise: Noise, excluded: &[usize]) -> Accepted {
        let edges = self.graph.edges();
        let odometry: Vec<bool> = edges.iter().map(|edge| edge.kind() == EdgeKind::Odometry).collect();
        let closures: Vec<usize> =
            (0..edges.len()).filter(|&edge| !odometry[edge] && !excluded.contains(&edge)).collect();
        let mut accepted = Accepted { edges: odometry.clone(), unsure: Vec::new() };
        let mut undecided = closures.clone();
        let mut scale = 1.0;
        let squares = self.accept_sure(&mut accepted, &mut undecided, scale);
        if noise == Noise::AsSeen {
            scale = noise_scale::<P, D>(squares);
            (accepted.edges, undecided) = (odometry, closures);
            self.accept_sure(&mut accepted, &mut undecided, scale);
        }
        while accepted.unsure.len() < MAX_UNSURE {
            let Some(closure) = self.least_doubtful(&accepted, &undecided, scale) else { break };
            accepted.edges[closure] = true;
            accepted.unsure.push(closure);
            undecided.retain(|&other| other != closure);
            self.accept_sure(&mut accepted, &mut undecided, scale);
        }
        accepted
    }

    /// Whether nothing speaks against a closure, with these edges accepted.
    pub(super) fn agrees(&mut self, closure: usize, accepted: &[bool]) -> bool {
        self.agreement(closure, accepted, 1.0)
            .is_none_or(|agreement| agreement.squared <= P::CHI_SQUARED_MILLION)
    }

    /// Accepts what has agreement enough, until there is no more; returns squared distances.
    fn accept_sure(&mut self, accepted: &mut Accepted, undecided: &mut Vec<usize>, scale: f64) -> Vec<f64> {
        let mut squares = Vec::new();
        for nats in AGREEMENT_NATS {
            loop {
                let before = undecided.len();
                undecided.retain(|&closure| {
                    let agreement = self.agreement(closure, &accepted.edges, scale);
                    let sure = agreement
                        .filter(|found| found.nats > nats && found.squared <= P::CHI_SQUARED_MILLION);
                    if let Some(found) = &sure {
                        accepted.edges[closure] = true;
                        squares.push(found.squared);
                    }
                    sure.is_none()
                });
                if undecided.len() == before {
                    break;
                }
            }
        }
        squares
    }

    /// Of those that nothing speaks against, the one with most agreement; closures that nothing
    /// leads around last.
    fn least_doubtful(&mut self, accepted: &Accepted, undecided: &[usize], scale: f64) -> Option<usize> {
        let mut best: Option<(f64, usize)> = None;
        for &closure in undecided {
            let nats = match self.agreement(closure, &accepted.edges, scale) {
                Some(found) if found.squared <= P::CHI_SQUARED_MILLION => found.nats,
                Some(_) => continue,
                None => f64::NEG_INFINITY,
            };
            if best.is_none_or(|(most, _)| nats > most) {
                best = Some((nats, closure));
            }
        }
        best.map(|(_, closure)| closure)
    }

    /// How well a closure agrees with the surest way around it; `None` if nothing leads around it.
    fn agreement(&mut self, closure: usize, accepted: &[bool], scale: f64) -> Option<Agreement> {
        let edge = &self.graph.edges()[closure];
        let usable = |other: usize| accepted[other] && other != closure;
        // The way whose uncertainty sums up to least.
        let Self { neighbours, uncertainty, paths, .. } = self;
        let goal = paths.search(
            [edge.from()],
            |pose| pose == edge.to(),
            |pose| {
                let around = neighbours.at(pose).iter().filter(|(other, _)| usable(*other));
                around.map(|&(edge, to)| Step { to, length: uncertainty[edge], edge })
            },
        )?;
        let way: Vec<usize> = paths.way_to(goal).into_iter().filter_map(|(_, edge)| edge).collect();
        let (end, mut covariance) = self.along(edge.from(), &way);
        covariance += self.covariances[closure];
        let by_step = P::linearized(edge.measurement(), &P::identity(), edge.measurement()).by_to;
        // Where the error vanishes, its derivative is diagonal.
        let error = P::error(edge.measurement(), &P::identity(), &end).component_div(&by_step.diagonal());
        let factor = (covariance * scale).cholesky()?;
        let squared = error.dot(&factor.solve(&error));
        let log_deviations: f64 = (0..D).map(|i| factor.l_dirty()[(i, i)].ln()).sum();
        let nats = self.log_volume - 0.5 * squared - log_deviations - 0.5 * D as f64 * TAU.ln();
        Some(Agreement { nats, squared })
    }

    /// Where a way leads from the identity, and the covariance of that, as a step at its end.
    fn along(&self, start: usize, way: &[usize]) -> (P, SMatrix<f64, D, D>) {
        let mut pose = P::identity();
        let mut covariance = SMatrix::zeros();
        let mut at = start;
        for &number in way {
            let edge = &self.graph.edges()[number];
            let (step, noise) = if edge.from() == at {
                at = edge.to();
                (*edge.measurement(), self.covariances[number])
            } else {
                at = edge.from();
                let adjoint = edge.measurement().adjoint();
                (edge.measurement().inverse(), adjoint * self.covariances[number] * adjoint.transpose())
            };
            let adjoint = step.inverse().adjoint();
            covariance = adjoint * covariance * adjoint.transpose() + noise;
            pose = pose.compose(&step);
        }
        (pose, covariance)
    }
}

fn covariance_of_step<P: Pose<D>, const D: usize>(edge: &Edge<P, D>) -> SMatrix<f64, D, D> {
    let by_step = P::linearized(edge.measurement(), &P::identity(), edge.measurement()).by_to;
    let information = by_step.transpose() * edge.information() * by_step;
    // Information is positive definite, or there is no edge.
    information.cholesky().map_or_else(SMatrix::identity, |factor| factor.inverse())
}

/// Logarithm of the box around all positions, a little larger so that it is never flat, times all
/// rotations.
pub(super) fn log_volume<P: Pose<D>, const D: usize>(poses: &[P], margin_m: f64) -> f64 {
    let rotations = if P::SPACE == 2 { TAU } else { 8.0 * PI * PI };
    let extent = |axis: usize| {
        let along = poses.iter().map(|pose| pose.position()[axis]);
        let (low, high) =
            along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        (high - low + margin_m).max(f64::MIN_POSITIVE)
    };
    (0..P::SPACE).map(|axis| extent(axis).ln()).sum::<f64>() + rotations.ln()
}

/// What variances have to be multiplied by for the median of squared distances to be that of χ²;
/// never more than 1.
fn noise_scale<P: Pose<D>, const D: usize>(mut squares: Vec<f64>) -> f64 {
    if squares.len() < ENOUGH_FOR_SCALE {
        return 1.0;
    }
    squares.sort_by(f64::total_cmp);
    (squares[squares.len() / 2] / P::CHI_SQUARED_MEDIAN).clamp(LEAST_NOISE, 1.0)
}
