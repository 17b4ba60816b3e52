//! Robots that drive, by their numbers.
#![expect(clippy::unwrap_used, reason = "a test's own inputs are valid")]

use std::sync::{Arc, LazyLock};

use nalgebra::Vector2;
use proptest::prelude::*;
use waypost_sim::camera::Camera;
use waypost_sim::image::GreyImage;
use waypost_sim::people::{Behaviour, Person, PersonError};
use waypost_sim::pose::{Pose, wrapped};
use waypost_sim::render::{CameraRig, Mount, Sensor};
use waypost_sim::robot::{Command, WheelErrors};
use waypost_sim::route::{Route, RouteFollower};
use waypost_sim::scene::Scene;
use waypost_sim::simulation::{
    CameraTrigger, Obedience, Simulation, SimulationError, SimulationSettings, Tick,
};
use waypost_sim::worlds::NamedWorld;

static LOOP: LazyLock<Arc<Scene>> = LazyLock::new(|| Arc::new(Scene::new(NamedWorld::Loop.plan(1))));

fn settings(seed: u64) -> SimulationSettings {
    let camera = Camera::of_field_of_view(65_f64.to_radians(), (160, 120)).unwrap();
    let rig = CameraRig::new(camera, Mount::default(), Sensor::default()).unwrap();
    SimulationSettings { seed, ..SimulationSettings::new(rig) }
}

fn once_round() -> Route {
    let world = NamedWorld::Loop;
    Route::named(LOOP.plan(), &world.route("once").unwrap(), 0.25).unwrap()
}

fn drive(seed: u64, wheels: WheelErrors) -> (Vec<Tick>, Vec<GreyImage>) {
    let route = once_round();
    let settings = SimulationSettings { wheels, ..settings(seed) };
    let mut simulation = Simulation::new(LOOP.clone(), route.start(), settings.clone()).unwrap();
    let recording = simulation.drive_along(&route, 0.6).unwrap();
    assert_eq!(recording.collisions, 0);
    let images = recording.images(&LOOP, &settings.rig);
    (recording.ticks, images)
}

#[test]
fn a_seed_is_a_drive_to_the_bit_on_any_number_of_threads() {
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let painted = |threads| {
        let scene = pool(threads).install(|| Scene::new(NamedWorld::BooijOffice.plan(4)));
        let settings = settings(1);
        let shot = Simulation::new(Arc::new(scene), Pose::new(5.0, 0.8, 1.5), settings.clone()).unwrap();
        let look = shot.look();
        pool(threads).install(|| shot.scene().render(&settings.rig, &look))
    };
    assert_eq!(painted(1), painted(4));
    let run = |threads| pool(threads).install(|| drive(7, WheelErrors::drawn(7)));
    let (one, four) = (run(1), run(4));
    assert!(one == four, "one thread and four differ");
    let other = drive(8, WheelErrors::drawn(8));
    assert!(one.0 != other.0 && one.1 != other.1, "another seed gives the same drive");
}

#[test]
fn a_drive_follows_its_route_and_takes_images_on_the_way() {
    let route = once_round();
    let (ticks, images) = drive(3, WheelErrors::NONE);
    let off = ticks.iter().map(|tick| route.distance_m(tick.truth.position())).fold(0.0, f64::max);
    assert!(off < 0.1, "{off} m off the route");
    let end = ticks.last().unwrap();
    assert!((end.truth.position() - route.at(route.length_m())).norm() < 0.15);
    // Wheels that are right say what is true, in a frame that starts where the robot did.
    let expected = route.start().relative(&end.truth);
    assert!(expected.distance_m(&end.odometry.pose) < 1e-6);
    let frames: Vec<_> = ticks.iter().filter_map(|tick| tick.frame.as_ref()).collect();
    assert_eq!(frames.len(), images.len());
    assert!((92..140).contains(&frames.len()), "{} images on 46 m with four corners", frames.len());
    assert!(frames.iter().enumerate().all(|(number, frame)| frame.number == number as u64));
    for pair in frames.windows(2) {
        let moved = pair[0].odometry.pose.relative(&pair[1].odometry.pose);
        let way = Vector2::new(moved.x_m, moved.y_m).norm();
        assert!(
            way < 0.53 && moved.heading_rad.abs() < 0.21 && (way > 0.49 || moved.heading_rad.abs() > 0.17)
        );
    }
}

#[test]
fn images_also_come_by_the_clock() {
    let trigger = CameraTrigger::Period { period_ns: 500_000_000 };
    let start = once_round().start();
    let mut simulation =
        Simulation::new(LOOP.clone(), start, SimulationSettings { trigger, ..settings(1) }).unwrap();
    let stamps: Vec<i64> =
        (0..200).filter_map(|_| simulation.advance().frame).map(|frame| frame.stamp_ns).collect();
    assert_eq!(stamps.len(), 8);
    assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 500_000_000));
}

#[test]
fn a_command_lapses() {
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(3.0, 1.0, 0.0), settings(1)).unwrap();
    simulation.command(Command { forward_m_s: 0.4, turn_rad_s: 0.0, valid_ns: 500_000_000 });
    let ticks: Vec<Tick> = (0..100).map(|_| simulation.advance()).collect();
    assert!(ticks[..25].iter().all(|tick| tick.obedience == Obedience::Commanded));
    assert!(ticks[25..].iter().all(|tick| tick.obedience == Obedience::Idle));
    // 0.4 m/s for half a second, speeding up at first and braking in the end alike.
    assert!((ticks[99].truth.x_m - 3.2).abs() < 0.01, "came to {}", ticks[99].truth.x_m);
    assert_eq!(ticks[98].truth, ticks[99].truth);
    simulation.command(Command { forward_m_s: f64::NAN, turn_rad_s: 0.0, valid_ns: i64::MAX });
    assert_eq!(simulation.advance().truth, ticks[99].truth);
}

/// Error of the odometry over a straight way: (scale, turn per metre).
fn errors_of(seed: u64, wheels: WheelErrors) -> [f64; 2] {
    let settings = SimulationSettings { wheels, reflex: None, ..settings(seed) };
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(1.0, 1.0, 0.0), settings).unwrap();
    simulation.command(Command { forward_m_s: 0.8, turn_rad_s: 0.0, valid_ns: i64::MAX });
    let mut measured = 0.0;
    let mut last = Pose::default();
    let mut end = simulation.advance();
    for _ in 0..600 {
        measured += last.distance_m(&end.odometry.pose);
        last = end.odometry.pose;
        end = simulation.advance();
    }
    measured += last.distance_m(&end.odometry.pose);
    let driven = end.truth.x_m - 1.0;
    [measured / driven - 1.0, wrapped(end.odometry.pose.heading_rad) / driven]
}

#[test]
fn odometry_is_as_wrong_as_it_was_set() {
    let (scale, drift) = (0.03, -0.02);
    let runs: Vec<[f64; 2]> =
        (0..60).map(|seed| errors_of(seed, WheelErrors::biased(scale, drift))).collect();
    let statistics = |axis: usize| {
        let mean = runs.iter().map(|run| run[axis]).sum::<f64>() / runs.len() as f64;
        let variance =
            runs.iter().map(|run| (run[axis] - mean).powi(2)).sum::<f64>() / (runs.len() - 1) as f64;
        (mean, variance.sqrt())
    };
    // Over 9.4 m noise of 0.01 m/√m makes a scale error of 0.0033, and 0.005 rad/√m a drift of
    // 0.0016 rad/m.
    let ((scale_mean, scale_sigma), (drift_mean, drift_sigma)) = (statistics(0), statistics(1));
    assert!((scale_mean - scale).abs() < 0.003, "scale {scale_mean}");
    assert!((0.0022..0.0048).contains(&scale_sigma), "scale sigma {scale_sigma}");
    assert!((drift_mean - drift).abs() < 0.001, "drift {drift_mean}");
    assert!((0.0011..0.0023).contains(&drift_sigma), "drift sigma {drift_sigma}");
}

#[test]
fn drawn_wheels_are_uniform_within_their_bounds() {
    let drawn: Vec<WheelErrors> = (0..2000).map(WheelErrors::drawn).collect();
    let check = |values: Vec<f64>, most: f64| {
        assert!(values.iter().all(|value| value.abs() <= most));
        let mean = values.iter().sum::<f64>() / 2000.0;
        let variance = values.iter().map(|value| value * value).sum::<f64>() / 2000.0;
        assert!(
            mean.abs() < 0.05 * most && (variance / (most * most / 3.0) - 1.0).abs() < 0.1,
            "{mean} {variance}"
        );
    };
    check(drawn.iter().map(|wheels| wheels.scale).collect(), 0.05);
    check(drawn.iter().map(|wheels| wheels.drift_rad_per_m).collect(), 3_f64.to_radians());
}

#[test]
fn the_covariance_covers_the_error() {
    // Mahalanobis distances of the odometry of 40 uncalibrated robots after 3 m.
    let far = (0..40).filter(|&seed| {
        let settings = SimulationSettings { wheels: WheelErrors::drawn(seed), ..settings(seed) };
        let start = Pose::new(3.0, 1.0, 0.0);
        let mut simulation = Simulation::new(LOOP.clone(), start, settings).unwrap();
        simulation.command(Command { forward_m_s: 0.5, turn_rad_s: 0.0, valid_ns: i64::MAX });
        let tick = (0..300).map(|_| simulation.advance()).last().unwrap();
        let truth = start.relative(&tick.truth);
        let (x, y) = (tick.odometry.pose.x_m - truth.x_m, tick.odometry.pose.y_m - truth.y_m);
        let error = nalgebra::Vector3::new(x, y, wrapped(tick.odometry.pose.heading_rad - truth.heading_rad));
        let inverse = tick.odometry.covariance.try_inverse().expect("a covariance");
        // The 99 % quantile of chi² with three degrees of freedom, tripled: a bias is no noise.
        (error.transpose() * inverse * error)[0] > 3.0 * 11.34
    });
    assert!(far.count() <= 2);
}

#[test]
fn a_slipping_wheel_turns_the_robot_and_not_its_odometry() {
    let wheels = WheelErrors { slips_per_m: 3.0, slip_m: 0.05, ..WheelErrors::NONE };
    let settings = SimulationSettings { wheels, reflex: None, ..settings(2) };
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(2.0, 1.0, 0.0), settings).unwrap();
    simulation.command(Command { forward_m_s: 0.4, turn_rad_s: 0.0, valid_ns: i64::MAX });
    let ticks: Vec<Tick> = (0..100).map(|_| simulation.advance()).collect();
    assert!(ticks.iter().all(|tick| tick.odometry.pose.heading_rad.abs() < 1e-9));
    // One wheel stands for 5 cm: a turn of 0.05 / 0.32 rad.
    let most = ticks.iter().map(|tick| tick.truth.heading_rad.abs()).fold(0.0, f64::max);
    assert!(most > 0.14, "turned by {most}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    /// Whatever it is told: it touches nothing as long as its reflex is awake.
    #[test]
    fn the_reflex_prevents_collisions(seed in 0..1000_u64, wishes in prop::collection::vec((0.1..0.8f64, -1.0..1.0f64), 60)) {
        let mut simulation = Simulation::new(LOOP.clone(), Pose::new(3.0, 1.0, 0.0), settings(seed)).unwrap();
        let walking = Behaviour::Walking { corners: vec![Vector2::new(12.5, 1.0)], speed_m_s: 0.5 };
        simulation.add_person(Person { pose: Pose::new(8.0, 1.0, 0.0), look: 1 }, walking).unwrap();
        let mut reflexes = 0;
        for (forward_m_s, turn_rad_s) in wishes {
            simulation.command(Command { forward_m_s, turn_rad_s, valid_ns: i64::MAX });
            reflexes += (0..100).filter(|_| simulation.advance().obedience == Obedience::Reflex).count();
        }
        prop_assert!(reflexes > 0);
        prop_assert_eq!(simulation.collisions(), 0);
    }
}

#[test]
fn without_a_reflex_collisions_are_counted() {
    let settings = SimulationSettings { reflex: None, ..settings(1) };
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(3.0, 1.0, 1.57), settings).unwrap();
    simulation.command(Command { forward_m_s: 0.5, turn_rad_s: 0.0, valid_ns: 4_000_000_000 });
    (0..300).for_each(|_| drop(simulation.advance()));
    assert_eq!(simulation.collisions(), 1);
    assert!(simulation.scene().plan().clearance_m(simulation.robot().pose().position()) >= 0.2);
}

#[test]
fn somebody_who_blocks_comes_near_stands_and_goes_away() {
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(3.0, 1.0, 0.0), settings(1)).unwrap();
    let person = Person { pose: Pose::new(6.0, 1.0, 0.0), look: 2 };
    let blocking = Behaviour::Blocking { notice_m: 4.0, patience_s: 3.0, speed_m_s: 1.0 };
    simulation.add_person(person, blocking).unwrap();
    let gaps: Vec<f64> = (0..600)
        .map(|_| {
            simulation.advance();
            simulation.people()[0].pose.distance_m(simulation.robot().pose()) - 0.2 - Person::RADIUS_M
        })
        .collect();
    let nearest = gaps.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((nearest - 0.2).abs() < 0.03, "came as near as {nearest} m");
    assert!(gaps[400..].iter().any(|&gap| gap > 1.5), "never left");
    assert_eq!(simulation.collisions(), 0);
    let in_wall = Person { pose: Pose::new(6.0, 0.1, 0.0), look: 2 };
    assert_eq!(
        simulation.add_person(in_wall, Behaviour::Standing),
        Err(PersonError::NoRoom { x_m: 6.0, y_m: 0.1 })
    );
}

#[test]
fn somebody_who_walks_goes_there_and_back_and_waits_for_the_robot() {
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(12.5, 6.0, 0.0), settings(1)).unwrap();
    let corners = vec![Vector2::new(6.0, 1.0), Vector2::new(9.0, 1.0)];
    let person = Person { pose: Pose::new(3.0, 1.0, 0.0), look: 3 };
    simulation.add_person(person, Behaviour::Walking { corners, speed_m_s: 1.0 }).unwrap();
    let x_at = |simulation: &Simulation| simulation.people()[0].pose.x_m;
    let xs: Vec<f64> = (0..1300).map(|_| (simulation.advance(), x_at(&simulation)).1).collect();
    let seconds = |second: usize| xs[50 * second - 1];
    // 6 m there, 6 m back, and there again; a step is lost at each corner.
    let expected = [(2, 5.0), (5, 8.0), (8, 7.0), (11, 4.0), (14, 5.0)];
    assert!(expected.iter().all(|&(second, x): &(usize, f64)| (seconds(second) - x).abs() < 0.15));
    // Now a robot stands in the way.
    simulation.kidnap(Pose::new(6.0, 0.8, 0.0)).unwrap();
    let mut nearest = f64::INFINITY;
    for _ in 0..500 {
        simulation.advance();
        nearest = nearest.min(simulation.people()[0].pose.distance_m(simulation.robot().pose()));
    }
    assert!(nearest >= 0.2 + Person::RADIUS_M, "came as near as {nearest} m");
    assert_eq!(simulation.collisions(), 0);
}

#[test]
fn settings_that_make_no_simulation_are_refused() {
    let start = Pose::new(3.0, 1.0, 0.0);
    let refused = |settings| match Simulation::new(LOOP.clone(), start, settings) {
        Err(SimulationError::OutOfRange(refused)) => refused.setting,
        other => panic!("{other:?}"),
    };
    let wheels = WheelErrors { drift_rad_per_m: f64::NAN, ..WheelErrors::NONE };
    assert_eq!(refused(SimulationSettings { wheels, ..settings(1) }), "drift_rad_per_m");
    assert_eq!(refused(SimulationSettings { period_ns: 0, ..settings(1) }), "period_ns");
    let trigger = CameraTrigger::Moved { distance_m: -1.0, angle_rad: 0.1 };
    assert_eq!(refused(SimulationSettings { trigger, ..settings(1) }), "distance_m");
    let outside = Simulation::new(LOOP.clone(), Pose::new(f64::NAN, 1.0, 0.0), settings(1));
    assert!(matches!(outside, Err(SimulationError::NoRoom { .. })));
}

#[test]
fn a_kidnapped_robot_does_not_feel_it() {
    let mut simulation = Simulation::new(LOOP.clone(), Pose::new(3.0, 1.0, 0.0), settings(1)).unwrap();
    simulation.kidnap(Pose::new(1.0, 6.0, 1.0)).unwrap();
    let tick = simulation.advance();
    assert_eq!((tick.truth, tick.odometry.pose), (Pose::new(1.0, 6.0, 1.0), Pose::default()));
    let refused = simulation.kidnap(Pose::new(6.0, 6.0, 1.0));
    assert_eq!(refused, Err(SimulationError::NoRoom { x_m: 6.0, y_m: 6.0 }));
}

#[test]
fn every_world_can_be_driven() {
    for world in NamedWorld::ALL {
        let scene = Arc::new(Scene::new(world.plan(1)));
        for named in world.routes() {
            let route = Route::named(scene.plan(), &named, 0.25).unwrap();
            let mut simulation = Simulation::new(scene.clone(), route.start(), settings(1)).unwrap();
            let recording = simulation.drive_along(&route, 0.8);
            let recording =
                recording.unwrap_or_else(|error| panic!("{} {}: {error}", world.name(), named.name));
            assert_eq!(recording.collisions, 0, "{} {}", world.name(), named.name);
            let obeyed = recording.ticks.iter().all(|tick| tick.obedience == Obedience::Commanded);
            assert!(obeyed, "the reflex acts on {} {}", world.name(), named.name);
            assert!((recording.length_m() / route.length_m() - 1.0).abs() < 0.06);
            assert_eq!(RouteFollower::new(route.clone()).along_m(), 0.0);
        }
    }
}

/// Blocks of 8 x 8 pixels with strong edges in two directions (J. Shi and C. Tomasi, Good features
/// to track, CVPR 1994).
fn blocks_with_corners(image: &GreyImage) -> usize {
    let slope = |x: u32, y: u32| {
        let difference = |a: u8, b: u8| (f64::from(b) - f64::from(a)) / 2.0;
        [
            difference(image.at(x - 1, y), image.at(x + 1, y)),
            difference(image.at(x, y - 1), image.at(x, y + 1)),
        ]
    };
    let least_eigenvalue = |left: u32, upper: u32| {
        let slopes = (upper..upper + 8).flat_map(|y| (left..left + 8).map(move |x| slope(x, y)));
        let [xx, xy, yy] = slopes.fold([0.0; 3], |[xx, xy, yy], [x, y]| [xx + x * x, xy + x * y, yy + y * y]);
        ((xx + yy) - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt()) / 2.0 / 64.0
    };
    let corners = (1..image.width_px() - 9)
        .step_by(8)
        .flat_map(|x| (1..image.height_px() - 9).step_by(8).map(move |y| (x, y)));
    // Noise of 2 grey values alone makes 2.
    corners.filter(|&(left, upper)| least_eigenvalue(left, upper) > 20.0).count()
}

#[test]
fn there_is_something_to_see_everywhere() {
    for world in NamedWorld::ALL {
        let rig = world.camera_rig();
        let scene = Arc::new(Scene::new(world.plan(5)));
        let route = Route::named(scene.plan(), &world.routes()[0], 0.25).unwrap();
        let settings = SimulationSettings::new(rig.clone());
        let recording =
            Simulation::new(scene.clone(), route.start(), settings).unwrap().drive_along(&route, 0.8);
        let images = recording.unwrap().images(&scene, &rig);
        let mut corners: Vec<usize> = images.iter().map(blocks_with_corners).collect();
        corners.sort_unstable();

        let [least, tenth, median] = [0, corners.len() / 10, corners.len() / 2].map(|index| corners[index]);
        let name = world.name();
        assert!(least >= 15 && tenth >= 120 && median >= 200, "{name}: {least}, {tenth}, {median} blocks");
    }
}
