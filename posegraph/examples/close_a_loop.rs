//! A robot drives three times around a square with wheels that drift. Where it is at a corner again
//! a loop is closed; one of the closures is wrong, and is found out. The result is printed as g2o.
//!
//! `cargo run -p posegraph --example close_a_loop`

use std::error::Error;
use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix3, Vector3};
use posegraph::g2o::{G2o, NamedGraph};
use posegraph::{Edge, EdgeKind, PlanarGraph, PlanarPose, Pose, RelaxationSettings, Start, relax};

const CORNERS: usize = 4;
const ROUNDS: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    // Information is the inverse of the covariance: 5 cm and 2 degrees a step, 10 cm and 3 degrees
    // a closure.
    let information = |position_m: f64, heading_rad: f64| {
        let deviations = Vector3::new(position_m, position_m, heading_rad);
        Matrix3::from_diagonal(&deviations.map(|deviation| deviation.powi(-2)))
    };
    let of_odometry = information(0.05, 2_f64.to_radians());
    let of_closures = information(0.1, 3_f64.to_radians());

    let mut graph = PlanarGraph::new(CORNERS * ROUNDS + 1);
    for from in 0..CORNERS * ROUNDS {
        // Three metres ahead and a quarter turn, which the wheels measure 1.5 degrees too wide.
        let driven = PlanarPose::new(3.0, 0.0, FRAC_PI_2 + 1.5_f64.to_radians());
        graph.add_edge(Edge::new(from, from + 1, driven, of_odometry, EdgeKind::Odometry)?)?;
    }
    // The same corner a round later: the robot is where it was.
    for to in CORNERS..=CORNERS * ROUNDS {
        let same = PlanarPose::identity();
        graph.add_edge(Edge::new(to - CORNERS, to, same, of_closures, EdgeKind::Closure)?)?;
    }
    // Opposite corners look alike: one was taken for the other.
    let wrong = graph.edges().len();
    graph.add_edge(Edge::new(1, 7, PlanarPose::identity(), of_closures, EdgeKind::Closure)?)?;

    let relaxed = relax(&graph, Start::Best, &RelaxationSettings::default());
    println!("# cost {:.2} after {} steps", relaxed.cost, relaxed.iterations);
    println!("# the wrong closure has weight {}", relaxed.weights[wrong]);

    let ids = (0..graph.poses() as u64).collect();
    let written = G2o::Planar(NamedGraph::new(ids, graph, Some(relaxed.poses))?).write();
    print!("{}", String::from_utf8(written)?);
    Ok(())
}
