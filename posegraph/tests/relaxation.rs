//! Relaxed poses are where the cost is least, and wrong closures do not move them.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

mod driven;

use driven::{LAP, drive, wrong_closure};
use nalgebra::{Isometry3, SMatrix, SVector, Vector3};
use posegraph::{
    Closures, Edge, EdgeKind, PlanarPose, Pose, PoseGraph, RelaxationSettings, Relaxed, Start, relax,
};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

const POSES: usize = 8;

fn trusted() -> RelaxationSettings {
    RelaxationSettings { closures: Closures::Trusted, ..RelaxationSettings::default() }
}

/// To the last digit, where a test looks at single digits.
fn exact() -> RelaxationSettings {
    RelaxationSettings { relative_gain: 1e-15, max_iterations: 500, ..trusted() }
}

fn planar(numbers: [f64; 6]) -> PlanarPose {
    PlanarPose::new(numbers[0], numbers[1], numbers[2])
}

fn spatial(numbers: [f64; 6]) -> Isometry3<f64> {
    let [x, y, z, i, j, k] = numbers;
    Isometry3::new(Vector3::new(x, y, z), Vector3::new(i, j, k))
}

/// Poses, some closures between them, and noise for each edge.
#[derive(Clone, Debug)]
struct Sketch {
    poses: Vec<[f64; 6]>,
    closures: Vec<(usize, usize)>,
    noise: Vec<[f64; 6]>,
    weights: Vec<f64>,
}

fn sketch(noise: f64) -> impl Strategy<Value = Sketch> {
    let numbers = |scale: f64| prop::array::uniform6(-scale..=scale);
    let edges = POSES - 1 + 6;
    (
        prop::collection::vec(numbers(1.2), POSES),
        prop::collection::vec((0..POSES, 0..POSES), 1..6),
        prop::collection::vec(numbers(noise), edges),
        prop::collection::vec(0.5..20.0f64, edges),
    )
        .prop_map(|(poses, closures, noise, weights)| Sketch { poses, closures, noise, weights })
}

fn drawn<P: Pose<D>, const D: usize>(
    sketch: &Sketch,
    pose: impl Fn([f64; 6]) -> P,
) -> (PoseGraph<P, D>, Vec<P>) {
    let truth: Vec<P> = sketch.poses.iter().map(|&numbers| pose(numbers)).collect();
    let odometry = (1..POSES).map(|to| (to - 1, to, EdgeKind::Odometry));
    let closures = sketch.closures.iter().filter(|(from, to)| from != to);
    let closures = closures.map(|&(from, to)| (from, to, EdgeKind::Closure));
    let mut graph = PoseGraph::new(POSES);
    for (number, (from, to, kind)) in odometry.chain(closures).enumerate() {
        let noise = SVector::<f64, D>::from_fn(|i, _| sketch.noise[number][i]);
        let measurement = truth[from].inverse().compose(&truth[to]).retract(&noise);
        let mut information = SMatrix::<f64, D, D>::identity() * sketch.weights[number];
        (information[(0, 1)], information[(1, 0)]) = (0.2, 0.2);
        graph.add_edge(Edge::new(from, to, measurement, information, kind).unwrap()).unwrap();
    }
    (graph, truth)
}

/// The largest slope of the cost along any step of any pose but the first, by central differences.
fn steepest<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>, poses: &[P]) -> f64 {
    let cost = |pose: usize, step: &SVector<f64, D>| {
        let mut moved = poses.to_vec();
        moved[pose] = moved[pose].retract(step);
        graph.cost(&moved)
    };
    let slope = |pose: usize, i: usize| {
        let mut step = SVector::<f64, D>::zeros();
        step[i] = 1e-6;
        ((cost(pose, &step) - cost(pose, &-step)) / 2e-6).abs()
    };
    (1..poses.len())
        .flat_map(|pose| (0..D).map(move |i| (pose, i)))
        .map(|(pose, i)| slope(pose, i))
        .fold(0.0, f64::max)
}

fn distance<P: Pose<D>, const D: usize>(some: &[P], others: &[P]) -> f64 {
    let far = |(one, other): (&P, &P)| P::error(&P::identity(), one, other).amax();
    some.iter().zip(others).map(far).fold(0.0, f64::max)
}

fn check_minimum<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>) {
    let settings = exact();
    let chain = relax(graph, Start::Odometry, &RelaxationSettings { max_iterations: 0, ..settings });
    assert_eq!((chain.iterations, chain.cost), (0, graph.cost(&chain.poses)));
    let relaxed = relax(graph, Start::Odometry, &settings);
    assert!(relaxed.cost <= chain.cost);
    assert_eq!(relaxed.poses[0], P::identity());
    assert!((relaxed.cost - graph.cost(&relaxed.poses)).abs() <= 1e-12 * relaxed.cost);
    let slope = steepest(graph, &relaxed.poses);
    assert!(slope < 1e-6 * (1.0 + chain.cost), "slope {slope} where the cost is {}", relaxed.cost);

    let best = relax(graph, Start::Best, &settings);
    assert!(best.cost <= relaxed.cost * (1.0 + 1e-9));
    assert!(best.cost <= relax(graph, Start::Chordal, &settings).cost);

    let mut backwards = PoseGraph::new(graph.poses());
    graph.edges().iter().rev().for_each(|edge| assert!(backwards.add_edge(*edge).is_ok()));
    let again = relax(&backwards, Start::Poses(&relaxed.poses), &settings);
    assert!(
        distance(&again.poses, &relaxed.poses) < 1e-6
            && (again.cost - relaxed.cost).abs() < 1e-9 * (1.0 + relaxed.cost)
    );
}

/// A way to and fro over a hill, with odometry that soon does not know where it looks, and closures between its rows.
///
/// The variance of their noise is 0.02.
fn hill(rows: usize, columns: usize, seed: u64, information: f64) -> PoseGraph<Isometry3<f64>, 6> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let at = |row: usize, step: usize| {
        let column = if row.is_multiple_of(2) { step } else { columns - 1 - step };
        let (x, y) = (column as f64, row as f64);
        let turned = Vector3::new(0.3 * x.sin(), 0.3 * y.cos(), if row.is_multiple_of(2) { 0.0 } else { PI });
        Isometry3::new(Vector3::new(x, y, x.sin() * y.cos()), turned)
    };
    let number = |row: usize, step: usize| row * columns + step;
    let truth: Vec<Isometry3<f64>> =
        (0..rows * columns).map(|pose| at(pose / columns, pose % columns)).collect();
    let mut graph = PoseGraph::new(truth.len());
    let mut join = |from: usize, to: usize, kind| {
        let noise = SVector::<f64, 6>::from_fn(|_, _| random.random_range(-0.25..0.25));
        let measured = truth[from].inverse().compose(&truth[to]).retract(&noise);
        graph
            .add_edge(Edge::new(from, to, measured, SMatrix::identity() * information, kind).unwrap())
            .unwrap();
    };
    (1..truth.len()).for_each(|to| join(to - 1, to, EdgeKind::Odometry));
    for row in 1..rows {
        (0..columns - 1)
            .for_each(|step| join(number(row - 1, columns - 1 - step), number(row, step), EdgeKind::Closure));
    }
    graph
}

#[test]
fn a_start_that_cannot_win_is_not_tried_or_given_up() {
    // As it is, understated a hundred times, and overstated three times: only that is more than noise.
    for (information, tried) in [(48.0, 0), (0.48, 0), (144.0, 20)] {
        let hill = hill(28, 28, 1, information);
        let [odometry, chordal, best] =
            [Start::Odometry, Start::Chordal, Start::Best].map(|start| relax(&hill, start, &trusted()));
        assert!(odometry.cost > chordal.cost && odometry.iterations > 40);
        assert_eq!((best.cost, &best.poses), (chordal.cost, &chordal.poses));
        assert_eq!(best.iterations, chordal.iterations + tried, "{information}");
    }
}

/// A ring whose way home is measured half a turn off, and that understates what it knows so much that all of it together
/// looks like noise.
#[test]
fn one_edge_that_bears_it_all_is_no_noise() {
    const POSES: usize = 60;
    let mut ring = PoseGraph::<PlanarPose, 3>::new(POSES);
    let step = PlanarPose::new(1.0, 0.0, 2.0 * PI / POSES as f64);
    let mut join = |from, to, measured, information, kind| {
        let information = SMatrix::identity() * information;
        ring.add_edge(Edge::new(from, to, measured, information, kind).unwrap()).unwrap();
    };
    (1..POSES).for_each(|to| join(to - 1, to, step, 1.0, EdgeKind::Odometry));
    (2..POSES).for_each(|to| join(to - 2, to, step.compose(&step), 1.0, EdgeKind::Closure));
    join(POSES - 1, 0, PlanarPose::new(1.0, 0.0, step.heading_rad() + PI), 0.1, EdgeKind::Closure);
    let [chordal, best] = [Start::Chordal, Start::Best].map(|start| relax(&ring, start, &trusted()));
    assert!(best.cost < 3.0 * POSES as f64, "as a whole it looks like more than noise: {}", best.cost);
    assert!(best.iterations > chordal.iterations, "odometry was not tried");
}

fn check_recovery<P: Pose<D>, const D: usize>(graph: &PoseGraph<P, D>, truth: &[P]) {
    let in_frame: Vec<P> = truth.iter().map(|pose| truth[0].inverse().compose(pose)).collect();
    for start in [Start::Odometry, Start::Chordal] {
        let relaxed = relax(graph, start, &trusted());
        assert!(distance(&relaxed.poses, &in_frame) < 1e-9);
    }
    // From poses that are a little off, and with what is known held.
    let mut held = graph.clone();
    held.fix(3, truth[3]).unwrap();
    let off: Vec<P> = truth.iter().map(|pose| pose.retract(&SVector::repeat(0.01))).collect();
    let relaxed = relax(&held, Start::Poses(&off[..POSES - 2]), &exact());
    assert_eq!(relaxed.poses[3], truth[3]);
    assert!(distance(&relaxed.poses, truth) < 1e-9);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn relaxed_poses_are_a_minimum(sketch in sketch(0.1)) {
        check_minimum(&drawn(&sketch, planar).0);
        check_minimum(&drawn(&sketch, spatial).0);
    }

    #[test]
    fn without_noise_the_truth_comes_back(sketch in sketch(0.0)) {
        let (graph, truth) = drawn(&sketch, planar);
        check_recovery(&graph, &truth);
        let (graph, truth) = drawn(&sketch, spatial);
        check_recovery(&graph, &truth);
    }

    #[test]
    fn parts_that_nothing_joins_stay_apart(sketch in sketch(0.1)) {
        let (part, _) = drawn(&sketch, planar);
        let mut both = PoseGraph::new(2 * POSES + 1);
        for shift in [0, POSES] {
            for edge in part.edges() {
                let (from, to) = (edge.from() + shift, edge.to() + shift);
                both.add_edge(Edge::new(from, to, *edge.measurement(), *edge.information(), edge.kind()).unwrap()).unwrap();
            }
        }
        let (one, two) = (relax(&part, Start::Odometry, &exact()), relax(&both, Start::Odometry, &exact()));
        prop_assert!((two.cost - 2.0 * one.cost).abs() <= 1e-6 * one.cost);
        prop_assert_eq!(two.poses[POSES], PlanarPose::identity());
        prop_assert!(distance(&two.poses[..POSES], &one.poses) < 1e-4);
    }
}

#[test]
fn nothing_is_no_problem() {
    for poses in [0, 1, 3] {
        let relaxed =
            relax(&PoseGraph::<PlanarPose, 3>::new(poses), Start::Best, &RelaxationSettings::default());
        assert_eq!((relaxed.poses, relaxed.cost), (vec![PlanarPose::identity(); poses], 0.0));
    }
}

#[test]
fn the_same_bits_on_any_thread() {
    let bits = || {
        let drive = drive(500, 5, |pose| pose.on_the_ground());
        let relaxed = relax(&drive.graph, Start::Best, &RelaxationSettings::default());
        let numbers =
            relaxed.poses.iter().flat_map(|pose| [pose.translation.x, pose.rotation.i, pose.rotation.w]);
        (numbers.map(f64::to_bits).collect::<Vec<_>>(), relaxed.cost.to_bits())
    };
    let here = bits();
    let there = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..3).map(|_| scope.spawn(bits)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
    });
    assert!(there.into_iter().all(|bits| bits == here));
}

/// Wrong closures among the right ones of a drive, as many as a tenth of them.
fn check_wrong_closures<P: Pose<D>, const D: usize>(lift: impl Fn(PlanarPose) -> P) {
    for seed in 0..5 {
        let mut drive = drive::<P, D>(1000, seed, &lift);
        let optimum = relax(&drive.graph, Start::Best, &trusted());
        let right = drive.graph.clone();
        for wrong in 0..8 {
            let from = (wrong * 117 + 13 * seed as usize) % 900;
            drive.graph.add_edge(wrong_closure(from, from + 50 + wrong)).unwrap();
        }
        let relaxed = relax(&drive.graph, Start::Best, &RelaxationSettings::default());
        let edges = right.edges().len();
        assert!(relaxed.weights[..edges].iter().all(|&weight| weight == 1.0), "seed {seed}");
        assert!(relaxed.weights[edges..].iter().all(|&weight| weight == 0.0), "seed {seed}");
        assert!((right.cost(&relaxed.poses) / optimum.cost - 1.0).abs() < 1e-6);
        assert!((relaxed.cost / optimum.cost - 1.0).abs() < 1e-6);
        // Trusted, they would bend the map.
        assert!(right.cost(&relax(&drive.graph, Start::Best, &trusted()).poses) > 2.0 * optimum.cost);
    }
}

#[test]
fn wrong_closures_are_left_out() {
    check_wrong_closures(|pose| pose);
    check_wrong_closures(|pose| pose.on_the_ground());
}

/// The graph before its last closure, what it relaxes to, and that closure.
fn before_the_last_closure<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
) -> (PoseGraph<P, D>, Relaxed<P>, Edge<P, D>) {
    let mut before = PoseGraph::new(graph.poses());
    let (last, edges) = graph.edges().split_last().unwrap();
    edges.iter().for_each(|edge| assert!(before.add_edge(*edge).is_ok()));
    let relaxed = relax(&before, Start::Best, &RelaxationSettings::default());
    (before, relaxed, *last)
}

fn check_live<P: Pose<D>, const D: usize>(lift: impl Fn(PlanarPose) -> P) {
    // At the end of the second lap, so that this closure decides much.
    for poses in [LAP + 10, 2 * LAP, 1000] {
        let drive = drive::<P, D>(poses, 3, &lift);
        let (mut graph, earlier, last) = before_the_last_closure(&drive.graph);
        let settings = RelaxationSettings::default();

        graph.add_edge(wrong_closure(20, poses - 30)).unwrap();
        let after_wrong = relax(&graph, Start::Earlier(&earlier), &settings);
        if poses > LAP + 10 {
            assert_eq!(after_wrong.weights.last(), Some(&0.0), "{poses} poses");
            assert!(distance(&after_wrong.poses, &earlier.poses) < 1e-3);
        }

        graph.add_edge(last).unwrap();
        let after_right = relax(&graph, Start::Earlier(&after_wrong), &settings);
        let optimum = relax(&drive.graph, Start::Best, &trusted());
        if poses > LAP + 10 {
            assert_eq!(after_right.weights.last(), Some(&1.0), "{poses} poses");
            assert!((after_right.cost / optimum.cost - 1.0).abs() < 1e-4);
        }
    }
}

#[test]
fn a_closure_at_a_time_is_judged_as_it_comes() {
    check_live(|pose| pose);
    check_live(|pose| pose.on_the_ground());
}

/// Nothing contradicts the first closure of a map; those that come later do.
fn check_outvoted<P: Pose<D>, const D: usize>(lift: impl Fn(PlanarPose) -> P) {
    let drive = drive::<P, D>(2 * LAP, 4, &lift);
    let settings = RelaxationSettings::default();
    let mut graph = PoseGraph::<P, D>::new(2 * LAP);
    let (odometry, closures): (Vec<&Edge<P, D>>, Vec<&Edge<P, D>>) =
        drive.graph.edges().iter().partition(|edge| edge.kind() == EdgeKind::Odometry);
    odometry.into_iter().for_each(|edge| assert!(graph.add_edge(*edge).is_ok()));
    let mut relaxed = relax(&graph, Start::Odometry, &settings);
    // A drift that odometry could have: the pose a lap later, but three metres further on.
    let wrong = graph.add_edge(wrong_closure(8, LAP + 2)).unwrap();
    relaxed = relax(&graph, Start::Earlier(&relaxed), &settings);
    for &closure in closures.iter().skip(2) {
        graph.add_edge(*closure).unwrap();
        relaxed = relax(&graph, Start::Earlier(&relaxed), &settings);
    }
    assert_eq!(relaxed.weights.iter().filter(|&&weight| weight == 0.0).count(), 1);
    assert_eq!(relaxed.weights[wrong], 0.0);
}

#[test]
fn a_wrong_closure_that_slipped_through_is_outvoted() {
    check_outvoted(|pose| pose);
    check_outvoted(|pose| pose.on_the_ground());
}
