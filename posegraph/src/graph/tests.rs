use nalgebra::Matrix3;

use super::*;

fn edge(from: usize, to: usize, information: Matrix3<f64>) -> Result<Edge<PlanarPose, 3>, EdgeError> {
    Edge::new(from, to, PlanarPose::identity(), information, EdgeKind::Closure)
}

#[test]
fn what_measures_nothing_is_refused() {
    assert_eq!(edge(3, 3, Matrix3::identity()), Err(EdgeError::Loop { pose: 3 }));
    let refused = Err(EdgeError::NotPositiveDefinite { from: 1, to: 2 });
    assert_eq!(edge(1, 2, Matrix3::zeros()), refused);
    assert_eq!(edge(1, 2, Matrix3::from_diagonal(&[1.0, 1.0, -1.0].into())), refused);
    assert_eq!(edge(1, 2, Matrix3::new(1.0, 2.0, 0.0, 2.0, 1.0, 0.0, 0.0, 0.0, 1.0)), refused);
    assert_eq!(edge(1, 2, Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)), refused);
    assert_eq!(edge(1, 2, Matrix3::identity() * f64::NAN), Err(EdgeError::NotFinite { from: 1, to: 2 }));
    let pose = PlanarPose::new(f64::INFINITY, 0.0, 0.0);
    let edge = Edge::new(0, 1, pose, Matrix3::identity(), EdgeKind::Odometry);
    assert_eq!(edge, Err(EdgeError::NotFinite { from: 0, to: 1 }));
}

#[test]
fn units_that_differ_by_far_are_no_fault() {
    assert!(edge(1, 2, Matrix3::from_diagonal(&[1e-9, 1.0, 1e12].into())).is_ok());
}

#[test]
fn ends_must_exist() {
    let mut graph = PlanarGraph::new(1);
    let edge = edge(0, 1, Matrix3::identity()).unwrap();
    assert_eq!(graph.add_edge(edge), Err(MissingPose { pose: 1, poses: 1 }));
    assert_eq!(graph.add_pose(), 1);
    assert_eq!(graph.add_edge(edge), Ok(0));
    assert_eq!(graph.fix(7, PlanarPose::identity()), Err(MissingPose { pose: 7, poses: 2 }));
}

#[test]
fn what_nothing_is_known_of_is_left_out() {
    let mut graph = PlanarGraph::new(7);
    for (from, to) in [(5, 1), (5, 4)] {
        graph.add_edge(edge(from, to, Matrix3::identity()).unwrap()).unwrap();
    }
    let at = PlanarPose::new(1.0, 2.0, 0.5);
    graph.fix(3, at).unwrap();
    let (known, part) = graph.known_part();
    assert_eq!(known, [1, 3, 4, 5]);
    let ends: Vec<(usize, usize)> = part.edges().iter().map(|edge| (edge.from, edge.to)).collect();
    assert_eq!((part.poses(), ends, part.fixed()), (4, vec![(3, 0), (3, 2)], &BTreeMap::from([(1, at)])));
    assert_eq!(PlanarGraph::new(3).known_part(), (Vec::new(), PlanarGraph::new(0)));
}

#[test]
fn every_part_is_held_somewhere() {
    let mut graph = PlanarGraph::new(6);
    for (from, to) in [(1, 0), (3, 2), (4, 3)] {
        graph.add_edge(edge(from, to, Matrix3::identity()).unwrap()).unwrap();
    }
    assert_eq!(graph.anchors(), [0, 2, 5]);
    graph.fix(3, PlanarPose::identity()).unwrap();
    assert_eq!(graph.anchors(), [0, 3, 5]);
}
