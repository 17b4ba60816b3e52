use std::cell::RefCell;
use std::f64::consts::PI;

use nalgebra::{Point2, Vector2};
use proptest::prelude::*;

use super::*;
use crate::appearance::epipolar::PlanarMotion;

/// A robot on an open floor with an image every half metre of a line. What is seen of an image
/// fades with distance.
struct OnTheFloor {
    position: Point2<f64>,
    heading_rad: f64,
    turned_rad: Option<f64>,
    images: Vec<Point2<f64>>,
    seen: RefCell<usize>,
    reach_m: f64,
}

impl OnTheFloor {
    fn new(images: &[[f64; 2]], at: [f64; 2], heading_rad: f64) -> Self {
        let images = images.iter().map(|&[x, y]| Point2::new(x, y)).collect();
        let position = Point2::new(at[0], at[1]);
        Self { position, heading_rad, turned_rad: None, images, seen: RefCell::new(0), reach_m: 1.2 }
    }

    fn overlap_of(from: Point2<f64>, heading_rad: f64, to: Point2<f64>, reach_m: f64) -> Option<Overlap> {
        let way = to - from;
        let similarity = 0.5 * (1.0 - way.norm() / reach_m);
        let motion = PlanarMotion::new(-heading_rad, way.y.atan2(way.x) - heading_rad);
        (similarity > 0.0).then_some(Overlap {
            constrained: (similarity * 1000.0) as u32,
            features: 1000,
            motion,
        })
    }

    fn graph(&self) -> AppearanceGraph {
        let mut graph = AppearanceGraph::default();
        for (image, &position) in self.images.iter().enumerate() {
            graph.add_image();
            for (other, &there) in self.images[..image].iter().enumerate() {
                let overlap = Self::overlap_of(position, 0.0, there, self.reach_m);
                let similarity = overlap.map_or(0.0, |overlap| overlap.similarity());
                graph.link(image as u32, other as u32, similarity);
            }
        }
        graph
    }

    /// Drives as a robot that turns no faster than half a radian a step.
    fn follow(&mut self, guidance: &Guidance) {
        let Some(wanted) = guidance.heading_rad else { return };
        let turn = wanted.clamp(-0.5, 0.5);
        self.turned_rad = Some(turn);
        self.heading_rad += turn;
        let ahead = Vector2::new(self.heading_rad.cos(), self.heading_rad.sin());
        self.position += ahead * if wanted.abs() < 1.0 { 0.1 } else { 0.0 };
    }
}

impl Panorama for OnTheFloor {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        *self.seen.borrow_mut() += 1;
        let there = self.images[image as usize];
        Self::overlap_of(self.position, self.heading_rad, there, self.reach_m)
    }
}

impl Sight for OnTheFloor {
    fn turned_rad(&self) -> Option<f64> {
        self.turned_rad
    }

    fn relocalization_candidates(&self) -> Vec<ImageId> {
        (0..self.images.len() as ImageId).collect()
    }
}

/// Along x, then along y.
fn corner() -> Vec<[f64; 2]> {
    let along = (0..8).map(|step| [0.5 * f64::from(step), 0.0]);
    along.chain((1..8).map(|step| [3.5, 0.5 * f64::from(step)])).collect()
}

#[test]
fn the_robot_comes_to_the_goal_whichever_way_it_looks_at_first() {
    for start_rad in [0.0, 1.6, -2.0, 3.1] {
        let images = corner();
        let mut robot = OnTheFloor::new(&images, [0.1, 0.05], start_rad);
        let graph = robot.graph();
        let goal = images.len() as u32 - 1;
        let mut navigator = AppearanceNavigator::new(&graph, goal, NavigationSettings::default()).unwrap();
        let mut remaining = f64::INFINITY;
        let arrived = (0..200).any(|_| {
            let guidance = navigator.observe(&graph, &robot, Body::Free);
            assert!(guidance.remaining.unwrap() <= remaining, "never back to an earlier subgoal");
            remaining = guidance.remaining.unwrap();
            robot.follow(&guidance);
            guidance.status == NavigationStatus::Arrived
        });
        assert!(arrived, "from {start_rad}");
        let there = robot.images[goal as usize];
        // Where the similarity is 0.6 times that of half a metre.
        assert!((robot.position - there).norm() < 0.8, "{}", robot.position);
    }
}

#[test]
fn a_robot_that_sees_nothing_keeps_its_heading_and_then_looks_for_itself() {
    let images = corner();
    let mut robot = OnTheFloor::new(&images, [0.1, 0.3], 0.0);
    let graph = robot.graph();
    let mut navigator = AppearanceNavigator::new(&graph, 14, NavigationSettings::default()).unwrap();
    let first = navigator.observe(&graph, &robot, Body::Free);
    assert_eq!(first.status, NavigationStatus::Driving);
    robot.reach_m = 1e-9;
    robot.turned_rad = Some(0.2);
    for miss in 1..=10 {
        let guidance = navigator.observe(&graph, &robot, Body::Free);
        assert_eq!(guidance.status, NavigationStatus::Recovering, "{miss}");
        assert!(
            (guidance.heading_rad.unwrap() - (first.heading_rad.unwrap() - 0.2 * f64::from(miss))).abs()
                < 1e-9
        );
    }
    *robot.seen.borrow_mut() = 0;
    let lost = navigator.observe(&graph, &robot, Body::Free);
    assert_eq!((lost.status, *robot.seen.borrow()), (NavigationStatus::Lost, images.len()));
    // Carried to the other end of the map meanwhile.
    robot.reach_m = 1.2;
    robot.position = Point2::new(3.4, 2.2);
    let found = navigator.observe(&graph, &robot, Body::Held);
    assert_eq!(found.status, NavigationStatus::Blocked);
    assert!(found.subgoal.unwrap() >= 11, "{found:?}");
    assert_eq!(navigator.observe(&graph, &robot, Body::Free).status, NavigationStatus::Driving);
}

#[test]
fn a_robot_that_comes_no_nearer_looks_for_itself() {
    let images = corner();
    let mut robot = OnTheFloor::new(&images, [0.1, 0.3], 0.0);
    let graph = robot.graph();
    let settings = NavigationSettings::default();
    let mut navigator = AppearanceNavigator::new(&graph, 14, settings).unwrap();
    navigator.observe(&graph, &robot, Body::Free);
    // It sees the subgoal, but a wall keeps it from it.
    robot.position = Point2::new(0.02, 0.3);
    for count in 0..settings.stall_patience {
        *robot.seen.borrow_mut() = 0;
        let guidance = navigator.observe(&graph, &robot, Body::Free);
        assert!(*robot.seen.borrow() < images.len(), "{count}: {guidance:?}");
    }
    *robot.seen.borrow_mut() = 0;
    navigator.observe(&graph, &robot, Body::Free);
    assert!(*robot.seen.borrow() >= images.len());
}

#[test]
fn a_goal_that_nothing_leads_to_is_never_driven_to() {
    let mut images = corner();
    images.push([20.0, 20.0]);
    let robot = OnTheFloor::new(&images, [0.1, 0.0], 0.0);
    let graph = robot.graph();
    let mut navigator = AppearanceNavigator::new(&graph, 15, NavigationSettings::default()).unwrap();
    let guidance = navigator.observe(&graph, &robot, Body::Free);
    assert_eq!((guidance.status, guidance.heading_rad), (NavigationStatus::Lost, None));
    assert!(AppearanceNavigator::new(&graph, 16, NavigationSettings::default()).is_err());
}

proptest! {
    /// The recursion is the weighted mean of all headings, each where it lies after all later
    /// turns.
    #[test]
    fn smoothing_is_the_weighted_mean(steps in prop::collection::vec((-3.0..3.0f64, -1.0..1.0f64), 1..8)) {
        let mut smoothed = SmoothedHeading::new(0.6);
        for &(heading, turned) in &steps {
            smoothed.turn(turned);
            smoothed.take(heading);
        }
        let mean: Vector2<f64> = (0..steps.len()).map(|step| {
            let later: f64 = steps[step + 1..].iter().map(|(_, turned)| turned).sum();
            let angle = steps[step].0 - later;
            0.6_f64.powi((steps.len() - 1 - step) as i32) * Vector2::new(angle.cos(), angle.sin())
        }).sum();
        prop_assume!(mean.norm() > 0.01);
        let apart = smoothed.heading_rad().unwrap() - mean.y.atan2(mean.x);
        prop_assert!(((apart + PI).rem_euclid(2.0 * PI) - PI).abs() < 1e-9);
    }
}
