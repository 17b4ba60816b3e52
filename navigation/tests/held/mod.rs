//! A robot that something holds, and one before a bare wall.

use posegraph::PlanarPose;
use waypost_navigation::metric::{LostBecause, Obstacle, Reason, Status};

use super::led_robot::{Fixes, World};
use super::{speed, until};

/// Late by up to 0.5 s each way. The wheels are held: it is told to stop within 2 s, goes back a little, and tries again.
#[test]
fn a_robot_that_presses_against_something_is_stopped_backs_off_and_tries_again() {
    for delay_steps in [0, 6, 10] {
        let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
        world.delay_steps = delay_steps;
        world.run(100);
        assert_eq!(world.status(), Status::Following);
        let late_s = 2.0 * delay_steps as f64 * 0.05;
        let noticed_s = until(&mut world, Status::Blocked, 2.0 + late_s, false);
        assert!(noticed_s > 1.0, "{noticed_s} s");
        assert_eq!(speed(&world), [0.0; 2]);
        assert_eq!(world.last.unwrap().reason, Some(Reason::Held(Obstacle::WheelsStand)));
        // It waits, and then goes back: that way it is free.
        let held_m = world.truth.x_m();
        let mut told = Vec::new();
        while !told.iter().any(|forward_m_s| *forward_m_s > 0.0) {
            let moves = speed(&world)[0] <= 0.0;
            world.advance(true, moves);
            told.push(speed(&world)[0]);
            assert!(told.len() < 400, "it does not try again");
        }
        assert!(told.iter().any(|forward_m_s| *forward_m_s < 0.0));
        let back_m = held_m - world.truth.x_m();
        assert!((0.2..0.7).contains(&back_m), "{back_m} m back");
        world.run(1500);
        assert_eq!(world.status(), Status::Arrived);
    }
}

/// Nothing moves it, forwards or back: it stands for longer and longer, and is told of as blocked all along.
#[test]
fn a_robot_that_stays_held_is_left_in_peace_more_and_more() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(100);
    let mut pressed_s = Vec::new();
    for _ in 0..3 {
        let mut pressed = 0_u32;
        for _ in 0..400 {
            world.advance(true, false);
            pressed += u32::from(speed(&world) != [0.0; 2]);
        }
        pressed_s.push(f64::from(pressed) * 0.05);
    }
    assert!(pressed_s[2] < pressed_s[0] && pressed_s[2] < 6.0, "{pressed_s:?} s of each 20 s");
    assert!(matches!(world.status(), Status::Blocked | Status::Following | Status::Searching));
}

/// Once wheels have slipped further than places are apart, what the robot sees is taken for no place any more. What structure
/// measures of it still says that it stays.
#[test]
fn wheels_that_slip_are_found_by_what_stays_in_view_and_is_taken_for_no_place() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    // Measured by structure.
    world.along_m2 = 0.0025;
    world.run(150);
    let mut drives_on = world.clone();
    (world.slips, world.doubts_what_it_sees) = (true, true);
    until(&mut world, Status::Blocked, 3.0, true);
    assert_eq!(world.last.unwrap().reason, Some(Reason::Held(Obstacle::WheelsSlip)));
    // One that drives on sees it go by.
    drives_on.doubts_what_it_sees = true;
    for _ in 0..55 {
        drives_on.advance(true, true);
        assert_ne!(drives_on.status(), Status::Blocked);
    }
}

#[test]
fn wheels_that_slip_before_what_is_known_are_found_by_what_stays_in_view() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Noisy(0.08));
    world.delay_steps = 6;
    world.run(150);
    world.slips = true;
    let noticed_s = until(&mut world, Status::Blocked, 6.0, true);
    assert!(noticed_s > 2.0, "{noticed_s} s");
    assert_eq!(world.last.unwrap().reason, Some(Reason::Held(Obstacle::WheelsSlip)));
    assert_eq!(speed(&world), [0.0; 2]);
    world.slips = false;
    world.run(1800);
    assert_eq!(world.status(), Status::Arrived);
}

/// Frames that show too little count as not recognised, and so does time: metres are what the wheels make of it.
#[test]
fn before_a_bare_wall_it_is_lost_within_ten_seconds_and_stands() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.delay_steps = 6;
    world.run(150);
    (world.slips, world.sees_bare_walls) = (true, true);
    let lost_s = until(&mut world, Status::Lost, 10.0, true);
    assert!(lost_s > 5.0, "{lost_s} s");
    assert_eq!(speed(&world), [0.0; 2]);
    let Some(Reason::Lost(LostBecause::NothingRecognised { frames, driven_ns })) = world.last.unwrap().reason
    else {
        panic!("{:?}", world.last)
    };
    assert!(frames >= 8 && driven_ns >= 6_000_000_000);
    // One that stands in the dark is still where it was.
    let mut stands = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    stands.run(1500);
    stands.sees_bare_walls = true;
    (0..2000).for_each(|_| stands.advance(true, true));
    assert!(stands.navigator.localization().is_some());
}
