//! Pose graphs of a robot that drives laps through a building, for tests and benchmarks.

use nalgebra::{SMatrix, SVector};
use posegraph::{Edge, EdgeKind, PlanarPose, Pose, PoseGraph};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Poses of a lap, half a metre apart: 30 by 20 m.
pub(crate) const LAP: usize = 200;
/// From one closure to the next, in poses.
const BETWEEN_CLOSURES: usize = 10;
/// Standard deviations of odometry from one pose to the next, metres and radians.
const ODOMETRY: [f64; 2] = [0.02, 0.01];
/// Standard deviations of closures, metres and radians.
const CLOSURE: [f64; 2] = [0.25, 0.052];

/// What was measured on the way.
pub(crate) struct Drive<P, const D: usize> {
    pub(crate) graph: PoseGraph<P, D>,
}

/// Drives so many poses; `lift` takes the plane to where poses are.
pub(crate) fn drive<P: Pose<D>, const D: usize>(
    poses: usize,
    seed: u64,
    lift: impl Fn(PlanarPose) -> P,
) -> Drive<P, D> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let truth: Vec<P> = (0..poses).map(|pose| lift(on_the_lap(pose % LAP))).collect();
    let mut graph = PoseGraph::new(poses);
    for to in 1..poses {
        let odometry = edge(&truth, (to - 1, to), ODOMETRY, EdgeKind::Odometry, &mut random);
        graph.add_edge(odometry).unwrap();
        if to >= LAP && to % BETWEEN_CLOSURES == BETWEEN_CLOSURES - 1 {
            let closure = edge(&truth, (to - LAP, to), CLOSURE, EdgeKind::Closure, &mut random);
            graph.add_edge(closure).unwrap();
        }
    }
    Drive { graph }
}

/// A closure that says that two poses are where they are not.
pub(crate) fn wrong_closure<P: Pose<D>, const D: usize>(from: usize, to: usize) -> Edge<P, D> {
    Edge::new(from, to, P::identity(), information::<P, D>(CLOSURE), EdgeKind::Closure).unwrap()
}

fn on_the_lap(pose: usize) -> PlanarPose {
    let along = pose as f64 * 0.5;
    let quarter_turn = std::f64::consts::FRAC_PI_2;
    match along {
        x if x < 30.0 => PlanarPose::new(x, 0.0, 0.0),
        y if y < 50.0 => PlanarPose::new(30.0, y - 30.0, quarter_turn),
        x if x < 80.0 => PlanarPose::new(80.0 - x, 20.0, 2.0 * quarter_turn),
        y => PlanarPose::new(0.0, 100.0 - y, -quarter_turn),
    }
}

fn edge<P: Pose<D>, const D: usize>(
    truth: &[P],
    (from, to): (usize, usize),
    deviations: [f64; 2],
    kind: EdgeKind,
    random: &mut ChaCha8Rng,
) -> Edge<P, D> {
    let noise = SVector::<f64, D>::from_fn(|i, _| {
        // The sum of twelve uniform numbers is near enough to normal.
        let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        normal * deviations[usize::from(i >= P::SPACE)]
    });
    let measurement = truth[from].inverse().compose(&truth[to]).retract(&noise);
    Edge::new(from, to, measurement, information::<P, D>(deviations), kind).unwrap()
}

fn information<P: Pose<D>, const D: usize>([position, rotation]: [f64; 2]) -> SMatrix<f64, D, D> {
    // In space the error has the sine of half the angle.
    let rotation = if P::SPACE == 2 { rotation } else { rotation / 2.0 };
    let deviation = |i: usize| if i < P::SPACE { position } else { rotation };
    SMatrix::from_diagonal(&SVector::from_fn(|i, _| deviation(i).powi(-2)))
}
