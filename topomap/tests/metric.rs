//! Places joined by metres: spacing, poses that loop closures correct, the prior with odometry, bad
//! odometry.

use std::f64::consts::FRAC_PI_2;

use fabmap::PlaceId;
use fabmap::observation::Observation;
use posegraph::{PlanarPose, Pose};
use topomap::in_memory::{self};
use topomap::log::{FrameEvent, LinkKind, Reason};
use topomap::mapper::{FrameError, FrameInput, Localizer, Mapper, MeasureError};
use topomap::metric::{Odometry, PlaceSpacing, RelativePose};
use topomap::settings::{MapperError, MapperSettings};

use crate::rounds::{Camera, CameraModel, Robot, apart_m, model, round};

#[test]
fn a_robot_that_stays_within_the_spacing_stays_at_its_place() {
    let mut robot = Robot::new(MapperSettings::default(), [0.0; 2]);
    let first = robot.see();
    assert_eq!((first.decision.reason, first.at), (Reason::NewPlace, Some(RelativePose::none())));
    for _ in 0..4 {
        robot.go(0.1, 0.02);
        let event = robot.see();
        assert_eq!((event.decision.reason, event.decision.place), (Reason::SamePlace, Some(PlaceId::new(0))));
    }
    assert!(apart_m(&robot.on_the_map(), &robot.pose) < 1e-9);
    robot.go(0.15, 0.0);
    let gone = robot.see();
    assert_eq!((gone.decision.reason, gone.decision.place), (Reason::NewPlace, Some(PlaceId::new(1))));
    // The link leads from the place's origin, not from where its last frame was.
    let LinkKind::Driven(measured) = gone.link.unwrap().kind else { panic!("{:?}", gone.link) };
    assert!((measured.pose().x_m() - robot.pose.x_m()).abs() < 1e-9, "{measured:?}");
    robot.go(0.0, 0.2);
    assert_eq!(robot.see().decision.reason, Reason::NewPlace, "it has turned by more than ten degrees");
}

#[test]
fn closures_undo_what_wheels_have_drifted() {
    let mut robot = Robot::new(MapperSettings::default(), [0.05, 2_f64.to_radians()]);
    robot.see();
    let first = round(&mut robot);
    let drifted_m = apart_m(&robot.odometry, &robot.pose);
    assert!(drifted_m > 1.0, "{drifted_m} m");
    let second = round(&mut robot);
    let closures = |events: &[FrameEvent]| {
        events.iter().filter(|event| event.decision.reason == Reason::LoopClosure).count()
    };
    assert!(closures(&first) <= 2 && closures(&second) > 20, "{} {}", closures(&first), closures(&second));
    let measured = robot.mapper.map().links().iter().any(|link| matches!(link.kind, LinkKind::Closed(_)));
    assert!(measured, "no closure measured anything");
    let drift_rad_per_m = robot.mapper.poses().drift_rad_per_m(robot.session);
    assert!((drift_rad_per_m.to_degrees() - 2.0).abs() < 0.4, "{} degrees/m", drift_rad_per_m.to_degrees());
    // All places, by the frames that made them.
    let mut errors = Vec::new();
    for (place, pose) in robot.mapper.map().places().iter().zip(robot.mapper.poses().poses()) {
        errors.push(apart_m(pose, &robot.truth[place.frames[0].frame as usize]).powi(2));
    }
    let rmse_m = (errors.iter().sum::<f64>() / errors.len() as f64).sqrt();
    assert!(rmse_m < 0.4, "{rmse_m} m");
    let robot_m = apart_m(&robot.on_the_map(), &robot.pose);
    let wheels_m = apart_m(&robot.odometry, &robot.pose);
    assert!(robot_m < 0.6 && wheels_m > 4.0 * robot_m, "{robot_m} m by the map, {wheels_m} m by wheels");

    // A replay comes to the same state, and to the same poses as near as relaxation ends.
    let mut replayed = Mapper::new(&model(), MapperSettings::default()).unwrap();
    robot.log.iter().for_each(|event| replayed.fold(event).unwrap());
    replayed.relax();
    assert_eq!(replayed.state_hash(), robot.mapper.state_hash());
    for (a, b) in replayed.poses().poses().iter().zip(robot.mapper.poses().poses()) {
        assert!(apart_m(a, b) < 0.02, "{a:?} {b:?}");
    }
}

#[test]
fn odometry_turned_into_map_poses_is_where_the_map_puts_the_robot() {
    let mut robot = Robot::new(MapperSettings::default(), [0.03, 0.02]);
    robot.see();
    round(&mut robot);
    round(&mut robot);
    let session = robot.mapper.map().session(robot.session).unwrap();
    let pose = robot.mapper.map_pose(session).unwrap();
    let corrected = pose.odom.compose(&robot.odometry);
    assert!(apart_m(&corrected, &pose.robot) < 1e-9);
    assert!((corrected.heading_rad() - pose.robot.heading_rad()).abs() < 1e-9);
    assert_eq!(pose.part, PlaceId::new(0));
    // In the dark wheels go on.
    robot.go(0.4, 0.0);
    let dark = FrameInput { observation: Observation::default(), ..robot.input() };
    assert_eq!(robot.take(dark, CameraModel::Known).decision.reason, Reason::TooFewWords);
    let expected = pose.robot.compose(&PlanarPose::new(0.4 * 1.03, 0.0, 0.02 * 0.4));
    assert!(apart_m(&robot.on_the_map(), &expected) < 1e-9);
}

#[test]
fn a_second_session_joins_the_map_when_it_recognises_a_place() {
    let mut robot = Robot::new(MapperSettings::default(), [0.0; 2]);
    robot.see();
    round(&mut robot);
    let places = PlaceId::from_index(robot.mapper.map().places().len());
    // It begins beside the round, where nobody has been, facing it.
    robot.pose = PlanarPose::new(2.0, -2.0, FRAC_PI_2);
    robot.begin();
    let first = robot.see();
    assert_eq!(first.decision.place, Some(places));
    assert_eq!(robot.mapper.poses().part(places), Some(places), "a frame of its own");
    for _ in 0..5 {
        robot.go(0.4, 0.0);
        robot.see();
    }
    for _ in 0..6 {
        robot.go(0.0, -FRAC_PI_2 / 6.0);
        robot.see();
    }
    for _ in 0..3 {
        robot.go(0.4, 0.0);
        robot.see();
    }
    assert_eq!(robot.mapper.poses().part(places), Some(PlaceId::new(0)), "it never recognised anything");
    let joined = robot.mapper.poses().pose(places).unwrap();
    assert!(apart_m(joined, &PlanarPose::new(2.0, -2.0, 0.0)) < 0.6, "{joined:?}");
    assert!(apart_m(&robot.on_the_map(), &robot.pose) < 0.6);
}

#[test]
fn frames_without_odometry_measure_nothing_and_join_nothing() {
    let mut robot = Robot::new(MapperSettings::default(), [0.0; 2]);
    robot.see();
    robot.go(0.6, 0.0);
    let input = FrameInput { odometry: None, ..robot.input() };
    let event = robot.take(input, CameraModel::Known);
    assert_eq!((event.at, event.link.unwrap().kind), (None, LinkKind::Session));
    assert_eq!(robot.mapper.poses().part(PlaceId::new(1)), Some(PlaceId::new(1)));
    assert_eq!(robot.mapper.map_pose(robot.mapper.map().session(0).unwrap()), None);
    robot.go(0.6, 0.0);
    // Wheels went on turning meanwhile: they tell the way from where they were last heard of.
    let link = robot.see().link.unwrap();
    let LinkKind::Driven(measured) = link.kind else { panic!("{link:?}") };
    assert_eq!((link.from, link.to), (PlaceId::new(0), PlaceId::new(2)));
    assert!((measured.pose().x_m() - 1.2).abs() < 1e-9);
    assert_eq!(robot.mapper.poses().part(PlaceId::new(2)), Some(PlaceId::new(0)));
}

/// Wheels say nothing of how places lie that were mapped without: their links do.
#[test]
fn a_robot_with_odometry_is_expected_along_the_links_of_a_map_without() {
    let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.0; 2]);
    for _ in 0..12 {
        let input = FrameInput { odometry: None, ..robot.input() };
        robot.take(input, CameraModel::Known);
        robot.go(0.8, 0.0);
    }
    robot.pose = PlanarPose::new(3.2, 0.0, 0.0);
    robot.begin();
    assert_eq!(robot.see().decision.place, Some(PlaceId::new(4)));
    robot.go(0.8, 0.0);
    let input = robot.input();
    let camera = Camera { robot: &robot, model: CameraModel::Known };
    let prior =
        in_memory::decide(&robot.mapper, &robot.log, input, &camera, &mut ()).unwrap().recognition.prior;
    let [next, far] = [5, 10].map(|place| prior.of(PlaceId::new(place)).unwrap());
    assert!(next > 2.0 * far, "{next} for the next place, {far} for a far one");
}

/// Wheels that say nothing would keep the robot at one place for ever; those of a robot that stands
/// may.
#[test]
fn odometry_that_stands_still_while_the_robot_drives_is_refused() {
    let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.0; 2]);
    robot.see();
    robot.go(0.8, 0.0);
    for _ in 0..40 {
        assert_eq!(robot.see().decision.place, Some(PlaceId::new(1)), "it stands");
    }
    let hash = robot.mapper.state_hash();
    robot.pose = PlanarPose::new(9.0, 4.0, 1.0);
    let input = robot.input();
    let refused = in_memory::decide(
        &robot.mapper,
        &robot.log,
        input.clone(),
        &Camera { robot: &robot, model: CameraModel::Known },
        &mut (),
    );
    let Err(FrameError::OdometryStandsStill { frames }) = refused else { panic!("{refused:?}") };
    assert!(frames > 30, "{frames}");
    assert_eq!(robot.mapper.state_hash(), hash);
    // One that only looks is told where it is.
    let mut localizer = Localizer::new();
    for sequence in 1..=50 {
        let input =
            FrameInput { session: Localizer::SESSION, sequence, stamp_ns: sequence as i64, ..input.clone() };
        let event = robot.localize(&localizer, input);
        localizer.follow(&event, &robot.mapper);
    }
    // The wheels turn again.
    robot.go(0.8, 0.0);
    robot.see();
}

/// The largest numbers that odometry may have are measured and logged like any others.
#[test]
fn odometry_at_its_bounds_is_logged_and_read_again() {
    let mut robot = Robot::new(MapperSettings::default(), [0.0; 2]);
    let most = Odometry::MAX_POSITION_M;
    for step in 0..6_u32 {
        let mut covariance = [0.0; 36];
        (0..6).for_each(|axis| covariance[7 * axis] = Odometry::MAX_VARIANCE / f64::from(8 - step));
        let (sine, cosine) = (0.3 * f64::from(step)).sin_cos();
        let odometry = Odometry::new([most, -most, most], [0.0, 0.0, sine, cosine], Some(&covariance));
        let input = FrameInput { odometry: Some(odometry.unwrap()), ..robot.input() };
        // Reads back what it logs.
        let event = robot.take(input, CameraModel::Known);
        assert!(event.at.is_some_and(|at| at.pose().is_finite()), "{:?}", event.at);
        assert!(robot.on_the_map().is_finite());
        robot.go(0.8, 0.0);
    }
}

#[test]
fn without_a_camera_model_a_turned_view_measures_nothing() {
    for (model, turn_rad, measures) in [
        (CameraModel::Known, 0.2, true),
        (CameraModel::Unknown, 0.2, false),
        (CameraModel::Unknown, 0.05, true),
    ] {
        let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.0; 2]);
        robot.see();
        for _ in 0..8 {
            robot.go(0.6, 0.0);
            robot.see();
        }
        robot.pose = PlanarPose::new(0.0, 0.0, turn_rad);
        robot.odometry = PlanarPose::new(0.7, 0.0, 0.0);
        let input = robot.input();
        let event = robot.take(input, model);
        assert_eq!(
            (event.decision.reason, event.decision.place),
            (Reason::LoopClosure, Some(PlaceId::new(0)))
        );
        let link = event.link.unwrap();
        assert_eq!(matches!(link.kind, LinkKind::Closed(_)), measures, "{turn_rad}: {link:?}");
        if model == CameraModel::Known {
            assert!((event.at.unwrap().pose().heading_rad() - turn_rad).abs() < 1e-9);
        }
    }
}

/// A closure puts the robot where the place is; what it measures itself says where it really is.
#[test]
fn what_a_robot_measures_is_used() {
    let settings = MapperSettings { guard_frames: 4, ..MapperSettings::default() };
    let mut robot = Robot::new(settings, [0.05, 0.0]);
    robot.see();
    let first = robot.log.len() as u64 - 1;
    for _ in 0..12 {
        robot.go(0.8, 0.0);
        robot.see();
    }
    // Back, to beside where it began.
    robot.go(-9.6, 0.0);
    robot.pose = PlanarPose::new(0.05, 0.15, 0.0);
    let event = robot.see();
    let (closure, links) = (event.decision.closure.unwrap(), robot.mapper.map().links().len());
    assert_eq!((event.decision.reason, closure.frame), (Reason::LoopClosure, first));
    assert!(apart_m(&robot.on_the_map(), &robot.pose) > 0.14, "{:?}", robot.on_the_map());

    // One that is worse than the closure leaves the robot where the closure put it.
    let closed = robot.on_the_map();
    robot.measure_within(20.0, event.frame, first, &PlanarPose::new(8.0, 0.0, 0.0)).unwrap();
    assert!(apart_m(&robot.on_the_map(), &closed) < 0.02, "{:?}", robot.on_the_map());
    let links = links + 1;

    robot.measure(event.frame, first, &PlanarPose::identity()).unwrap();
    assert!(apart_m(&robot.on_the_map(), &robot.pose) < 1e-9, "{:?}", robot.on_the_map());
    assert_eq!(robot.mapper.map().links().len(), links + 1);
    let link = robot.mapper.map().links()[links];
    assert!(matches!(link.kind, LinkKind::Closed(_)) && link.to == PlaceId::new(0), "{link:?}");

    // Wheels go on from there.
    robot.go(0.0, 0.3);
    robot.see();
    let off = robot.pose.inverse().compose(&robot.on_the_map());
    assert!(off.x_m().hypot(off.y_m()) < 0.02 && off.heading_rad().abs() < 0.02, "{off:?}");

    // Between places that no recognition joined: the map's scale shows.
    let wheels_m = 1.05 * 0.8 * 6.0;
    let [a, b] = [1, 7].map(|frame| robot.event(first + frame).decision.place.unwrap());
    let apart = |robot: &Robot| {
        let poses = robot.mapper.poses();
        apart_m(poses.pose(a).unwrap(), poses.pose(b).unwrap())
    };
    assert!((apart(&robot) - wheels_m).abs() < 0.05, "{}", apart(&robot));
    robot.measure(first + 7, first + 1, &PlanarPose::identity()).unwrap();
    assert!((apart(&robot) - 4.8).abs() < 0.02, "{}", apart(&robot));

    // A replay of the log comes to the same.
    let mut again = Mapper::new(&model(), settings).unwrap();
    robot.log.iter().for_each(|event| again.apply(event).unwrap());
    assert_eq!(again.state_hash(), robot.mapper.state_hash());
}

#[test]
fn measurements_that_contradict_the_rest_do_not_bend_the_map() {
    let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.01, 0.0]);
    robot.see();
    round(&mut robot);
    round(&mut robot);
    let before: Vec<PlanarPose> = robot.mapper.poses().poses().to_vec();
    let last = robot.log.len() as u64 - 1;
    robot.measure(last - 20, 12, &PlanarPose::new(5.0, -4.0, 1.5)).unwrap();
    let moved = before.iter().zip(robot.mapper.poses().poses()).map(|(a, b)| apart_m(a, b));
    let most_m = moved.fold(0.0, f64::max);
    assert!(most_m < 0.1, "{most_m} m");
    let wrong = robot.mapper.map().links().len() - 1;
    assert!(robot.mapper.poses().contradicted().any(|link| link == wrong));
}

#[test]
fn measurements_that_nothing_follows_from_are_refused() {
    let mut robot = Robot::new(MapperSettings { guard_frames: 4, ..MapperSettings::default() }, [0.0; 2]);
    robot.see();
    robot.go(0.8, 0.0);
    robot.see();
    robot.see();
    robot.go(0.8, 0.0);
    let input = FrameInput { odometry: None, ..robot.input() };
    let blind = robot.take(input, CameraModel::Known).frame;
    let right = PlanarPose::identity();
    let hash = robot.mapper.state_hash();
    for (later, earlier, error) in [
        (1, 1, MeasureError::NotEarlier),
        (1, 2, MeasureError::NotEarlier),
        (blind, 1, MeasureError::NoMetres { which: "later" }),
        // Two looks from one stay, and the robot is elsewhere by now.
        (3, 2, MeasureError::TooLate),
    ] {
        assert_eq!(robot.measure(later, earlier, &right), Err(error), "{later} from {earlier}");
    }
    robot.go(0.8, 0.0);
    robot.see();
    let stays = robot.see().frame;
    let unsure = robot.measure_within(3.0, stays, stays - 1, &right);
    assert!(matches!(unsure, Err(MeasureError::TooUnsure { spacing_m: 0.5, .. })), "{unsure:?}");
    robot.go(0.8, 0.0);
    let last = robot.see().frame;
    assert_eq!(robot.measure(last, blind, &right), Err(MeasureError::NoMetres { which: "earlier" }));
    assert_ne!(robot.mapper.state_hash(), hash);
}

#[test]
fn settings_in_metres_out_of_range_are_refused() {
    let refused = |settings| Mapper::new(&model(), settings).unwrap_err();
    for distance_m in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let place_spacing = PlaceSpacing { distance_m, ..PlaceSpacing::default() };
        let error = refused(MapperSettings { place_spacing, ..MapperSettings::default() });
        assert!(matches!(error, MapperError::Metric { quantity: "place spacing", .. }), "{error}");
    }
    for prior_frames in [0, 5] {
        let error = refused(MapperSettings { prior_frames, ..MapperSettings::default() });
        assert_eq!(error, MapperError::PriorFrames { value: prior_frames });
    }
}
