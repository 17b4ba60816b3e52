//! A robot that is led along a line, without pictures: kinematics, closures as they would be
//! measured, and time.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking, helpers included")]

mod held;
mod led_robot;

use fabmap::PlaceId;
use posegraph::PlanarPose;
use proptest::prelude::*;
use waypost_navigation::metric::planning::PlanError;
use waypost_navigation::metric::{
    Driver, Goal, Look, LostBecause, NavigationSettings, Reason, Seen, Sight, Status, WheelReport,
};

use led_robot::{Fixes, LENGTH_M, NOTHING, STEPS_PER_FRAME, World, odometry};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn it_comes_back_to_the_line_and_arrives(
        across_m in -0.5..0.5f64, heading_rad in -1.0..1.0f64, drift in -0.1..0.1f64, scale in -0.08..0.08f64,
    ) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, heading_rad), Fixes::Perfect);
        (world.drift_rad_per_m, world.scale) = (drift, scale);
        world.run(1500);
        prop_assert_eq!(world.status(), Status::Arrived);
        prop_assert!((world.truth.x_m() - LENGTH_M).abs() < 0.15, "{:?}", world.truth);
        prop_assert!(world.across_m(3.0) < 0.06, "{} m", world.across_m(3.0));
        let settings = NavigationSettings::default().steering;
        for command in &world.commands {
            prop_assert!((0.0..=settings.speed_m_s).contains(&command.forward_m_s));
            prop_assert!(command.turn_rad_s.abs() <= settings.max_turn_rad_s && command.valid_ns == settings.valid_ns);
        }
        prop_assert!(world.commands.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    }

    /// A view cannot tell an offset from a turn: the turn that is believed leads back.
    #[test]
    fn an_offset_that_is_taken_for_a_turn_leads_back(across_m in -0.4..0.4f64, depth_m in 2.0..5.0f64, drift in -0.05..0.05f64) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, 0.0), Fixes::OfTheLine { depth_m });
        world.drift_rad_per_m = drift;
        world.run(1500);
        prop_assert_eq!(world.status(), Status::Arrived);
        // After two depths an eighth is left of it, and what the drift has added until it was
        // learnt.
        prop_assert!(world.across_m(0.2 + 2.0 * depth_m) < 0.2 * across_m.abs() + 0.08, "{} m", world.across_m(2.0 * depth_m));
    }

    #[test]
    fn noise_late_answers_and_late_commands_are_borne(
        across_m in -0.3..0.3f64, drift in -0.1..0.1f64, delay_steps in 0..10u64, chance in any::<u64>(),
    ) {
        let mut world = World::new(PlanarPose::new(0.2, across_m, 0.0), Fixes::Noisy(0.12));
        (world.drift_rad_per_m, world.delay_steps, world.chance) = (drift, delay_steps, chance);
        world.run(2000);
        prop_assert_eq!(world.status(), Status::Arrived);
        prop_assert!(world.across_m(3.0) < 0.25, "{} m", world.across_m(3.0));
    }
}

#[test]
fn the_same_calls_give_the_same_commands() {
    let drive = || {
        let mut world = World::new(PlanarPose::new(0.2, 0.3, 0.4), Fixes::Noisy(0.1));
        world.drift_rad_per_m = 0.05;
        world.run(600);
        world.commands
    };
    assert_eq!(drive(), drive());
}

#[test]
fn without_frames_it_goes_on_is_less_and_less_sure_and_at_last_stands_until_one_comes() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(80);
    assert_eq!(world.status(), Status::Following);
    let mut before = world.last.unwrap().localization.unwrap();
    // Five seconds, two metres.
    for _ in 0..5 {
        (0..20).for_each(|_| world.advance(false, true));
        let now = world.last.unwrap().localization.unwrap();
        assert!(now.position_sigma_m > before.position_sigma_m && now.confidence < before.confidence);
        assert!(
            now.since_closure_m > before.since_closure_m && now.since_closure_ns > before.since_closure_ns
        );
        before = now;
    }
    assert_eq!(world.status(), Status::Searching);
    assert!(world.truth.y_m().abs() < 0.05);
    (0..22).for_each(|_| world.advance(false, true));
    let stood = world.truth;
    for _ in 0..2000 {
        world.advance(false, true);
        assert_eq!((world.status(), speed(&world)), (Status::Blocked, [0.0; 2]));
        assert!(
            matches!(world.last.unwrap().reason, Some(Reason::NoFrames { for_ns }) if for_ns >= 6_000_000_000)
        );
    }
    // It is where it was, and knows that.
    assert_eq!(world.truth, stood);
    assert!(world.last.unwrap().localization.is_some());
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn by_few_frames_that_show_too_little_it_is_lost_after_so_many_metres_and_looks_around() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(80);
    world.sees_bare_walls = true;
    let lost_m = NavigationSettings::default().supervision.lost_m;
    let steps = (lost_m / 0.4 / 0.05) as u64 + 30;
    (0..steps).for_each(|step| world.advance(step % 80 < STEPS_PER_FRAME, true));
    assert_eq!(world.status(), Status::Lost);
    assert!(matches!(world.last.unwrap().reason, Some(Reason::Lost(LostBecause::Far { .. }))));
    assert_eq!(world.last.unwrap().localization, None);
    // It stands, and then turns on the spot, until it sees again.
    let stood = world.truth;
    (0..60).for_each(|_| world.advance(true, true));
    world.sees_bare_walls = false;
    assert!(
        (world.truth.x_m() - stood.x_m()).abs() < 0.1 && world.truth.heading_rad() != stood.heading_rad()
    );
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn carried_off_to_where_views_are_clear_it_plans_anew_at_once() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(100);
    world.truth = PlanarPose::new(9.0, 0.1, 0.5);
    for _ in 0..400 {
        world.advance(true, true);
        assert_ne!(world.status(), Status::Lost);
    }
    assert_eq!(world.status(), Status::Arrived);
    assert!(world.truth.x_m() > 9.0);
}

#[test]
fn carried_off_it_forgets_finds_out_and_wants_another_plan() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(100);
    let episode = world.navigator.episode();
    world.truth = PlanarPose::new(9.0, 0.1, 0.5);
    // Views that show that it is elsewhere, and not clearly where.
    world.evidence = 40.0;
    while world.status() != Status::Lost {
        assert_ne!(world.status(), Status::Arrived);
        world.advance(true, true);
    }
    assert!(world.navigator.episode() > episode && world.navigator.localization().is_none());
    world.evidence = 100.0;
    world.run(400);
    assert_eq!(world.status(), Status::Arrived);
    // What was under way from before is not listened to.
    let sight = Sight::Closure(world.closure());
    let (stamp_ns, odometry) = (1 << 50, Some(world.wheels));
    let old = Look { stamp_ns, odometry, sight, evidence: 0.0, glimpses: NOTHING, episode };
    assert_eq!(world.navigator.see(&old), Seen::Stale);
}

/// The first guidance of that status, and how long it took, in seconds of the robot's.
fn until(world: &mut World, status: Status, limit_s: f64, moves: bool) -> f64 {
    let began_ns = world.stamp_ns();
    let elapsed_s = |world: &World| (world.stamp_ns() - began_ns) as f64 * 1e-9;
    while world.status() != status {
        world.advance(true, moves);
        assert!(elapsed_s(world) < limit_s, "{:?} after {limit_s} s", world.last);
    }
    elapsed_s(world)
}

fn speed(world: &World) -> [f64; 2] {
    world.last.map_or([0.0; 2], |told| [told.command.forward_m_s, told.command.turn_rad_s])
}

#[test]
fn why_it_stands_is_said() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.advance(false, true);
    let said =
        |world: &World| world.last.unwrap().reason.map_or_else(String::new, |reason| reason.to_string());
    assert!(said(&world).contains("recognised no place of the map yet: it looks around"), "{}", said(&world));
    world.run(100);
    assert_eq!(said(&world), "");
    (0..80).for_each(|_| world.advance(false, true));
    assert!(said(&world).contains("it goes on by its wheels"), "{}", said(&world));
    world.navigator.cancel();
    world.advance(false, true);
    assert!(said(&world).contains("no goal"), "{}", said(&world));
}

#[test]
fn a_reflex_is_told_of_and_a_cancelled_robot_stands() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(60);
    let report = WheelReport {
        stamp_ns: world.stamp_ns() + 1,
        odometry: odometry(&world.wheels),
        obeyed: None,
        driver: Driver::Reflex,
    };
    assert_eq!(world.navigator.drive(&report).status, Status::Blocked);
    world.navigator.cancel();
    let guidance = world.navigator.drive(&report);
    assert_eq!(
        (guidance.status, guidance.command.forward_m_s, guidance.command.turn_rad_s),
        (Status::Idle, 0.0, 0.0)
    );
    assert!(guidance.localization.is_some() && world.navigator.path().is_none());
}

#[test]
fn a_goal_may_say_where_to_look() {
    for heading_rad in [-2.5, -0.6, 0.0, 1.2, 3.1] {
        let mut world = World::new(PlanarPose::new(0.2, 0.1, 0.0), Fixes::Perfect);
        world.drift_rad_per_m = 0.05;
        world.navigator.go_to_facing(Goal::Place(PlaceId::new(24)), heading_rad).unwrap();
        world.run(1500);
        (0..20).for_each(|_| world.advance(true, true));
        assert_eq!(world.status(), Status::Arrived);
        let off = PlanarPose::new(0.0, 0.0, world.truth.heading_rad() - heading_rad).heading_rad();
        assert!(off.abs() < 0.1 && (world.truth.x_m() - LENGTH_M).abs() < 0.15, "{:?}", world.truth);
    }
    let mut world = World::new(PlanarPose::new(0.2, 0.1, 0.0), Fixes::Perfect);
    assert_eq!(
        world.navigator.go_to_facing(Goal::Place(PlaceId::new(24)), f64::NAN),
        Err(PlanError::NotFinite)
    );
}

/// It looks away from what was taught as it turns to where it is to look: that is no reason to be
/// lost.
#[test]
fn views_that_are_not_those_of_the_way_say_nothing_while_it_is_not_on_it() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.navigator.go_to_facing(Goal::Place(PlaceId::new(24)), 3.0).unwrap();
    while world.truth.heading_rad().abs() < 0.5 {
        world.advance(true, true);
        assert!(world.step < 2000);
    }
    world.knows = false;
    for _ in 0..400 {
        world.advance(true, true);
        assert_ne!(world.status(), Status::Lost);
    }
    assert_eq!(world.status(), Status::Arrived);
    assert!(world.navigator.localization().is_some());
}

#[test]
fn on_its_way_it_is_lost_where_nothing_is_known_and_goes_back_as_it_came() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(150);
    world.knows = false;
    let knew_x_m = world.truth.x_m();
    while world.status() != Status::Lost {
        world.advance(true, true);
        assert!(world.step < 400);
    }
    assert!(world.truth.x_m() - knew_x_m > 0.5);
    let (first, looked_to) = (world.commands.len(), world.truth.heading_rad());
    while world.truth.x_m() > knew_x_m + 0.2 {
        world.advance(true, true);
        assert!((world.truth.heading_rad() - looked_to).abs() < 0.1 && world.step < 1000);
    }
    assert!(world.commands[first..].iter().any(|command| command.forward_m_s < 0.0));
    world.knows = true;
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
}

#[test]
fn somebody_who_stands_before_it_for_a_while_does_not_make_it_lost() {
    let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
    world.run(150);
    world.knows = false;
    let steps = |looks: u32| u64::from(looks) * STEPS_PER_FRAME;
    let standing = NavigationSettings::default().supervision.unknown_looks_standing;
    for _ in 0..steps(standing - 2) {
        world.advance(true, false);
        assert_ne!(world.status(), Status::Lost);
    }
    let mut left = world.clone();
    world.knows = true;
    world.run(1500);
    assert_eq!(world.status(), Status::Arrived);
    // Who never goes away has been mistaken for a wall.
    left.knows = false;
    for _ in 0..steps(4) {
        left.advance(true, false);
    }
    assert_eq!(left.status(), Status::Lost);
}

#[test]
fn its_reflex_may_turn_it_away_for_a_while() {
    let drive = |driver: Driver| {
        let mut world = World::new(PlanarPose::new(0.0, 0.0, 0.0), Fixes::Perfect);
        world.run(150);
        (world.knows, world.driver) = (false, driver);
        let looks = NavigationSettings::default().supervision.unknown_looks + 2;
        (0..u64::from(looks) * STEPS_PER_FRAME).for_each(|_| world.advance(true, true));
        world.navigator.localization().is_some()
    };
    assert!(drive(Driver::Reflex) && !drive(Driver::Commands));
}
