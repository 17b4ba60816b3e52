//! What relaxation costs: a step, a whole graph, and a closure in a map that is relaxed already.
//!
//! `cargo bench -p posegraph --bench relaxation`
#![expect(clippy::unwrap_used, reason = "a benchmark's own inputs are valid")]

#[path = "../tests/driven/mod.rs"]
mod driven;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use driven::{drive, wrong_closure};
use posegraph::{Closures, PlanarPose, Pose, PoseGraph, RelaxationSettings, Start, relax};

const PLACES: usize = 1000;

fn graphs<P: Pose<D>, const D: usize>(
    criterion: &mut Criterion,
    space: &str,
    lift: impl Fn(PlanarPose) -> P,
) {
    let mut group = criterion.benchmark_group(format!("{PLACES} places in {space}"));
    let drive = drive::<P, D>(PLACES, 1, lift);
    let judged = RelaxationSettings::default();
    let trusted = RelaxationSettings { closures: Closures::Trusted, ..judged };
    let step = RelaxationSettings { max_iterations: 1, ..trusted };
    group.bench_function("one step", |bencher| {
        bencher.iter(|| relax(black_box(&drive.graph), Start::Odometry, &step));
    });
    for (name, settings) in [("trusted", &trusted), ("judged", &judged)] {
        group.bench_function(format!("from odometry, closures {name}"), |bencher| {
            bencher.iter(|| relax(black_box(&drive.graph), Start::Odometry, settings));
        });
    }

    let (last, edges) = drive.graph.edges().split_last().unwrap();
    let mut graph = PoseGraph::new(PLACES);
    edges.iter().for_each(|edge| assert!(graph.add_edge(*edge).is_ok()));
    let earlier = relax(&graph, Start::Best, &judged);
    for (name, closure) in [("right", *last), ("wrong", wrong_closure(120, 970))] {
        let mut graph = graph.clone();
        graph.add_edge(closure).unwrap();
        group.bench_function(format!("a {name} closure is added"), |bencher| {
            bencher.iter(|| relax(black_box(&graph), Start::Earlier(&earlier), &judged));
        });
    }
    group.finish();
}

fn plane(criterion: &mut Criterion) {
    graphs(criterion, "the plane", |pose| pose);
}

fn space(criterion: &mut Criterion) {
    graphs(criterion, "space", |pose| pose.on_the_ground());
}

criterion_group!(benches, plane, space);
criterion_main!(benches);
