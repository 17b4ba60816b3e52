//! Where relaxation starts from: along a spanning tree, or rotations first.

use std::collections::VecDeque;

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::block_cholesky::BlockCholesky;
use crate::graph::{Edge, EdgeKind, Neighbours, PoseGraph};
use crate::pose::Pose;

/// Poses along a spanning tree, from those that are known: along odometry as far as it goes, by
/// closures where nothing else leads. Parts without a known pose begin with the identity.
pub(super) fn spanning_tree<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    known: &[Option<P>],
) -> Vec<P> {
    let neighbours = Neighbours::of(graph);
    let mut poses: Vec<Option<P>> =
        (0..graph.poses()).map(|pose| known.get(pose).copied().flatten()).collect();
    let mut fresh: Vec<usize> = (0..poses.len()).filter(|&pose| poses[pose].is_some()).collect();
    let [mut by_odometry, mut by_closure] = [VecDeque::new(), VecDeque::new()];
    let mut lowest = 0;
    loop {
        for pose in std::mem::take(&mut fresh) {
            for &(edge, other) in neighbours.at(pose) {
                if poses[other].is_none() {
                    match graph.edges()[edge].kind() {
                        EdgeKind::Odometry => by_odometry.push_back((edge, other)),
                        EdgeKind::Closure => by_closure.push_back((edge, other)),
                    }
                }
            }
        }
        if let Some((edge, other)) = by_odometry.pop_front().or_else(|| by_closure.pop_front()) {
            if poses[other].is_none() {
                let at = across(&graph.edges()[edge], other, &poses);
                poses[other] = Some(at);
                fresh.push(other);
            }
        } else if let Some(next) = (lowest..graph.poses()).find(|&pose| poses[pose].is_none()) {
            lowest = next;
            poses[next] = Some(P::identity());
            fresh.push(next);
        } else {
            return poses.into_iter().map(|pose| pose.unwrap_or_else(P::identity)).collect();
        }
    }
}

/// The pose at one end of an edge whose other end has one.
fn across<P: Pose<D>, const D: usize>(edge: &Edge<P, D>, pose: usize, poses: &[Option<P>]) -> P {
    let at = |end: usize| poses[end].unwrap_or_else(P::identity);
    if pose == edge.to() {
        at(edge.from()).compose(edge.measurement())
    } else {
        at(edge.to()).compose(&edge.measurement().inverse())
    }
}

/// Rotations first, and then the positions that fit them: both are linear least squares.
///
/// Rotations are relaxed as plain matrices (minimal Σ κ |R_j - R_i R_ij|²) and brought back to the
/// nearest rotation; see L. Carlone and others, "Initialization Techniques for 3D SLAM", ICRA 2015.
/// Anchors stay where `start` has them.
pub(super) fn chordal<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    start: Vec<P>,
    weights: &[f64],
) -> Vec<P> {
    if P::SPACE == 2 {
        chordal_in::<P, D, 2>(graph, start, weights)
    } else {
        chordal_in::<P, D, 3>(graph, start, weights)
    }
}

fn chordal_in<P: Pose<D>, const D: usize, const S: usize>(
    graph: &PoseGraph<P, D>,
    start: Vec<P>,
    weights: &[f64],
) -> Vec<P> {
    let mut unknown: Vec<Option<usize>> = vec![Some(0); graph.poses()];
    graph.anchors().into_iter().for_each(|anchor| unknown[anchor] = None);
    let mut unknowns = 0;
    for unknown in unknown.iter_mut().flatten() {
        *unknown = unknowns;
        unknowns += 1;
    }
    let ends = |edge: &Edge<P, D>| unknown[edge.from()].zip(unknown[edge.to()]);
    let pairs: Vec<(usize, usize)> = graph.edges().iter().filter_map(ends).collect();
    let mut matrix = BlockCholesky::<S>::new(unknowns, &pairs);
    let weighted = || graph.edges().iter().zip(weights.iter().map(|&weight| f64::max(weight, LEAST_WEIGHT)));

    // Rows of rotation matrices do not depend on each other: one matrix, S right sides.
    let mut rows = vec![0.0; S * S * unknowns];
    let begin = |row: usize, unknown: usize| (row * unknowns + unknown) * S;
    for (edge, weight) in weighted() {
        let weight = weight * rotation_weight::<P, D>(edge.information());
        let relative = edge.measurement().rotation();
        let from = unknown[edge.from()];
        let to = unknown[edge.to()];
        let block = SMatrix::<f64, S, S>::identity() * weight;
        [from, to].into_iter().flatten().for_each(|unknown| matrix.add_diagonal(unknown, &block));
        match (from, to) {
            (Some(from), Some(to)) => {
                // r_j = R_ijᵀ r_i for each row, as a column.
                let block = -relative.fixed_view::<S, S>(0, 0) * weight;
                matrix.add(matrix.slot(from, to), &block);
            }
            (None, Some(to)) => {
                let expected = start[edge.from()].rotation() * relative * weight;
                add_rows::<S>(&mut rows, &expected, |row| begin(row, to));
            }
            (Some(from), None) => {
                let expected = start[edge.to()].rotation() * relative.transpose() * weight;
                add_rows::<S>(&mut rows, &expected, |row| begin(row, from));
            }
            (None, None) => {}
        }
    }
    if matrix.solve(&mut rows).is_err() {
        return start;
    }
    let turned = |(pose, unknown): (&P, &Option<usize>)| match *unknown {
        Some(unknown) => {
            let mut relaxed = Matrix3::identity();
            for row in 0..S {
                (0..S).for_each(|column| relaxed[(row, column)] = rows[begin(row, unknown) + column]);
            }
            P::nearest(&relaxed, &pose.position())
        }
        None => *pose,
    };
    let turned: Vec<P> = start.iter().zip(&unknown).map(turned).collect();

    matrix.clear();
    let mut positions = vec![0.0; S * unknowns];
    for (edge, weight) in weighted() {
        let rotation = turned[edge.from()].rotation();
        let frame = rotation * edge.measurement().rotation();
        let mut information = Matrix3::zeros();
        information.fixed_view_mut::<S, S>(0, 0).copy_from(&edge.information().fixed_view::<S, S>(0, 0));
        let information = frame * information * frame.transpose() * weight;
        let block = information.fixed_view::<S, S>(0, 0).into_owned();
        let mut moved = rotation * edge.measurement().position();
        let from = unknown[edge.from()];
        let to = unknown[edge.to()];
        [from, to].into_iter().flatten().for_each(|unknown| matrix.add_diagonal(unknown, &block));
        match (from, to) {
            (Some(from), Some(to)) => matrix.add(matrix.slot(from, to), &-block),
            (None, Some(_)) => moved += turned[edge.from()].position(),
            (Some(_), None) => moved -= turned[edge.to()].position(),
            (None, None) => {}
        }
        let pull: Vector3<f64> = information * moved;
        for (unknown, sign) in [(from, -1.0), (to, 1.0)] {
            if let Some(unknown) = unknown {
                (0..S).for_each(|i| positions[unknown * S + i] += sign * pull[i]);
            }
        }
    }
    if matrix.solve(&mut positions).is_err() {
        return turned;
    }
    let moved = |(pose, unknown): (&P, &Option<usize>)| match *unknown {
        Some(unknown) => {
            let mut position = Vector3::zeros();
            (0..S).for_each(|i| position[i] = positions[unknown * S + i]);
            P::nearest(&pose.rotation(), &position)
        }
        None => *pose,
    };
    turned.iter().zip(&unknown).map(moved).collect()
}

/// Keeps parts joined that hang together by closures of no weight alone.
const LEAST_WEIGHT: f64 = 1e-9;

/// κ: the dimensions over the trace of the rotation's covariance.
fn rotation_weight<P: Pose<D>, const D: usize>(information: &SMatrix<f64, D, D>) -> f64 {
    let covariance = information.cholesky().map(|factor| factor.inverse());
    let trace = covariance.map_or(0.0, |covariance| (P::SPACE..D).map(|i| covariance[(i, i)]).sum());
    if trace > 0.0 { (D - P::SPACE) as f64 / trace } else { 1.0 }
}

fn add_rows<const S: usize>(rows: &mut [f64], matrix: &Matrix3<f64>, begin: impl Fn(usize) -> usize) {
    for row in 0..S {
        (0..S).for_each(|column| rows[begin(row) + column] += matrix[(row, column)]);
    }
}
