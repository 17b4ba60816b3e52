use nalgebra::{SMatrix, Vector3};
use proptest::prelude::*;

use super::*;
use crate::{Edge, EdgeKind};

const TRIANGLE: &str = "1 0 0 1 0 1";

fn error(text: &str) -> G2oError {
    G2o::read(text.as_bytes()).unwrap_err()
}

fn at(line: usize, problem: LineProblem) -> G2oError {
    G2oError::Line { line, problem }
}

fn planar(text: &str) -> NamedGraph<PlanarPose, 3> {
    match G2o::read(text.as_bytes()).unwrap() {
        G2o::Planar(graph) => graph,
        G2o::Spatial(_) => panic!("spatial"),
    }
}

#[test]
fn a_text_with_all_that_may_be_in_it() {
    let text = format!(
        "# a comment\r\nVERTEX_SE2 7 1 2 0.5\r\n\r\nVERTEX_SE2 3 0 0 4 # beyond half a turn\r\nFIX 3\r\n\
         EDGE_SE2 3 7 1 2 .5 2 0.5 0 3 0 1e1\r\n  EDGE_SE2\t7   8 0 0 0 {TRIANGLE}\nVERTEX_SE2 8 1 1 1"
    );
    let graph = planar(&text);
    assert_eq!(graph.ids(), [3, 7, 8]);
    let fixed = PlanarPose::new(0.0, 0.0, 4.0);
    assert_eq!(graph.poses().unwrap()[..2], [fixed, PlanarPose::new(1.0, 2.0, 0.5)]);
    assert_eq!(graph.graph().fixed().iter().collect::<Vec<_>>(), [(&0, &fixed)]);
    let edges = graph.graph().edges();
    assert_eq!((edges[0].from(), edges[0].to(), edges[0].kind()), (0, 1, EdgeKind::Closure));
    let information = SMatrix::<f64, 3, 3>::new(2.0, 0.5, 0.0, 0.5, 3.0, 0.0, 0.0, 0.0, 10.0);
    assert_eq!(*edges[0].information(), information);
    assert_eq!((edges[1].from(), edges[1].to(), edges[1].kind()), (1, 2, EdgeKind::Odometry));
    assert_eq!(G2o::read(&G2o::Planar(graph.clone()).write()), Ok(G2o::Planar(graph)));
}

#[test]
fn edges_alone_are_enough() {
    let graph = planar(&format!("FIX 9\nEDGE_SE2 9 4 1 0 0 {TRIANGLE}\n"));
    assert_eq!((graph.ids(), graph.poses()), (&[4, 9][..], None));
    assert_eq!(graph.graph().fixed().keys().collect::<Vec<_>>(), [&1]);
}

#[test]
fn errors_name_the_line() {
    use LineProblem::*;
    assert_eq!(error(""), G2oError::Empty);
    assert_eq!(error("# nothing\n\n"), G2oError::Empty);
    assert_eq!(error("\nVERTEX_XY 1 0 0"), at(2, UnknownTag("VERTEX_XY".to_owned())));
    let short = Columns { tag: "VERTEX_SE2", expected: 4, found: 3 };
    assert_eq!(error("VERTEX_SE2 0 0 0"), at(1, short));
    let short = Columns { tag: "EDGE_SE2", expected: 11, found: 5 };
    assert_eq!(error("EDGE_SE2 0 1 0 0 0"), at(1, short));
    assert_eq!(error("VERTEX_SE2 0 0 x 0"), at(1, NotANumber("x".to_owned())));
    assert_eq!(error("VERTEX_SE2 0 0 NaN 0"), at(1, NotANumber("NaN".to_owned())));
    assert_eq!(error("VERTEX_SE2 -1 0 0 0"), at(1, NotAnId("-1".to_owned())));
    let mixed = at(2, MixedDimensions("VERTEX_SE3:QUAT"));
    assert_eq!(error("VERTEX_SE2 0 0 0 0\nVERTEX_SE3:QUAT 1 0 0 0 0 0 0 1"), mixed);
    assert_eq!(error("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 0 0 0"), at(2, VertexTwice(0)));
    let missing = at(2, MissingVertex(1));
    assert_eq!(error(&format!("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 0 0 0 {TRIANGLE}")), missing);
    assert_eq!(error("VERTEX_SE2 0 0 0 0\nFIX 1"), missing);
    assert_eq!(error(&format!("EDGE_SE2 0 1 0 0 0 {TRIANGLE}\nFIX 0 1")), missing);
    assert_eq!(error("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 0"), at(1, NoRotation));
    assert_eq!(error(&format!("EDGE_SE2 2 2 0 0 0 {TRIANGLE}")), at(1, Loop(2)));
    let indefinite = at(1, NotPositiveDefinite { from: 1, to: 2 });
    assert_eq!(error("EDGE_SE2 1 2 0 0 0 1 2 0 1 0 1"), indefinite);
    assert_eq!(G2o::read(b"\xff"), Err(at(1, NotText)));
    let text = at(12, NotANumber("x".to_owned())).to_string();
    assert_eq!(text, "line 12: x is not a finite number; write numbers like -1.25e-3, with a point");
}

#[test]
fn names_must_fit() {
    let graph = PoseGraph::<PlanarPose, 3>::new(2);
    let named = |ids: &[u64]| NamedGraph::new(ids.to_vec(), graph.clone(), None).map(|_| ());
    assert_eq!(named(&[1]), Err(NamingError::Count { given: 1, poses: 2 }));
    assert_eq!(named(&[2, 2]), Err(NamingError::NotAscending(2)));
    assert_eq!(named(&[2, 5]), Ok(()));
    let poses = Some(vec![PlanarPose::identity()]);
    assert_eq!(NamedGraph::new(vec![0, 1], graph, poses), Err(NamingError::Count { given: 1, poses: 2 }));
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-1e3..1e3f64, -1e-12..1e-12f64, Just(-0.0), Just(1e300), Just(f64::MIN_POSITIVE)]
}

/// A text that anybody may have written.
fn text(dimensions: &'static str) -> impl Strategy<Value = String> {
    let numbers = if dimensions == "SE2" { 3 } else { 7 };
    let pose = prop::collection::vec(number(), numbers - 1).prop_map(|pose| {
        // The last number is an angle, or what keeps a quaternion from zero.
        pose.iter().chain(&[1.25]).map(|number| format!("{number:e}")).collect::<Vec<_>>().join(" ")
    });
    let triangle = if dimensions == "SE2" {
        "2.1 0.3 0 1e4 0 .7"
    } else {
        "2.1 .3 0 0 0 0 3 0 0 0 0 4 0 0 0 5 0 .1 6 0 7"
    };
    prop::collection::vec((pose, 0..5usize), 5).prop_map(move |rows| {
        let mut text = String::new();
        for (id, (pose, other)) in rows.iter().enumerate() {
            text += &format!("VERTEX_{dimensions} {id} {pose}\n");
            if *other != id {
                text += &format!("EDGE_{dimensions} {id} {other} {pose} {triangle}\n");
            }
        }
        text
    })
}

proptest! {
    #[test]
    fn what_was_read_is_written_and_read_back_to_the_bit(
        text in prop_oneof![text("SE2"), text("SE3:QUAT")],
    ) {
        let graph = G2o::read(text.as_bytes()).unwrap();
        let written = graph.write();
        prop_assert_eq!(G2o::read(&written).unwrap(), graph);
        prop_assert_eq!(G2o::read(&written).unwrap().write(), written);
    }

    #[test]
    fn no_bytes_do_harm(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        prop_assert!(G2o::read(&bytes).is_err());
    }

    #[test]
    fn computed_poses_come_back_to_the_bit(axis in prop::array::uniform3(-2.0..2.0), angle in -20.0..20.0f64) {
        let turned = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::from(axis));
        let poses = vec![Isometry3::identity(), turned * turned * turned];
        let mut graph = PoseGraph::new(2);
        let edge = Edge::new(0, 1, turned, SMatrix::identity(), EdgeKind::Odometry).unwrap();
        graph.add_edge(edge).unwrap();
        let graph = G2o::Spatial(NamedGraph::new(vec![0, 1], graph, Some(poses)).unwrap());
        prop_assert_eq!(G2o::read(&graph.write()).unwrap(), graph);

        let turned = PlanarPose::new(1.0 / 3.0, 0.1, angle);
        let mut graph = PoseGraph::new(2);
        let edge = Edge::new(0, 1, turned, SMatrix::identity(), EdgeKind::Odometry).unwrap();
        graph.add_edge(edge).unwrap();
        let poses = vec![turned, turned.compose(&turned).inverse()];
        let graph = G2o::Planar(NamedGraph::new(vec![0, 1], graph, Some(poses)).unwrap());
        prop_assert_eq!(G2o::read(&graph.write()).unwrap(), graph);
    }
}
