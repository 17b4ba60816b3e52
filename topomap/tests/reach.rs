//! Places that wheels say a robot cannot be at.

use fabmap::appearance::PlaceId;
use posegraph::{PlanarPose, Pose};
use topomap::log::Reason;
use topomap::mapper::OutOfReach;

use crate::building::{Looks, Robot, STEP_M, again_after, ahead, turn_left, unique};
use crate::rewriting::frames;

/// Straight along the corridor, by wheels that are wrong by some share of the way and radians a metre.
fn along(looks: Looks, metres: f64, bias: [f64; 2]) -> Robot {
    let mut robot = Robot::new(looks, PlanarPose::identity(), bias);
    robot.see();
    ahead(&mut robot, (metres / STEP_M).round() as usize);
    robot
}

fn closures(robot: &Robot) -> usize {
    frames(&robot.log).filter(|event| event.decision.reason == Reason::LoopClosure).count()
}

#[test]
fn no_loop_is_closed_onto_a_place_that_the_robot_drove_away_from() {
    for bias in [[0.0, 0.0], [0.05, 0.03], [-0.05, -0.05]] {
        let robot = along(again_after::<15>, 25.0, bias);
        assert_eq!(closures(&robot), 0, "wheels off by {bias:?}");
    }
    // So long that wheels which drift could have led round to it.
    assert!(closures(&along(again_after::<45>, 50.0, [0.0, 0.0])) > 0);
}

#[test]
fn what_is_ruled_out_is_said_in_metres() {
    let start = PlaceId::first(1).next().unwrap();
    let robot = along(again_after::<15>, 15.0, [0.0, 0.0]);
    let OutOfReach { least_m, allowed_m } = robot.mapper.out_of_reach(&robot.input(), start).unwrap();
    // The chord of an arc of 15 m that turns by 0.15 rad a metre.
    assert!((least_m - 2.0 / 0.15 * (0.15_f64 * 15.0 / 2.0).sin()).abs() < 0.3, "{least_m} m");
    assert!((1.5..least_m).contains(&allowed_m), "{allowed_m} m");
    let near = along(again_after::<15>, 1.2, [0.0, 0.0]);
    assert_eq!(near.mapper.out_of_reach(&near.input(), start), None);
}

#[test]
fn who_drives_a_loop_may_be_back() {
    let start = PlaceId::first(1).next().unwrap();
    let mut robot = along(unique, 6.0, [0.05, 0.03]);
    for _ in 0..3 {
        turn_left(&mut robot);
        ahead(&mut robot, 10);
    }
    assert_eq!(robot.mapper.out_of_reach(&robot.input(), start), None);
}
