use super::*;
use fabmap::PlaceId;
use proptest::prelude::*;

fn route(poses: &[PlanarPose]) -> Route {
    let waypoint = |(place, &pose): (PlaceId, &PlanarPose)| Waypoint { place, pose, travel: Travel::Along };
    let waypoints = PlaceId::all().zip(poses).map(waypoint).collect();
    Route { part: PlaceId::new(0), waypoints, length_m: 0.0 }
}

/// Places every half metre along a wavy way.
fn wavy(phase: f64, turn_rad_per_m: f64) -> Vec<PlanarPose> {
    let mut pose = PlanarPose::new(1.0, -2.0, phase);
    let step = |number: u32| {
        let turn_rad = 0.25 * turn_rad_per_m * (phase + f64::from(number) / 3.0).sin();
        let half = PlanarPose::new(0.0, 0.0, turn_rad);
        pose = pose.compose(&half).compose(&PlanarPose::new(0.5, 0.0, 0.0)).compose(&half);
        pose
    };
    use posegraph::Pose;
    (0..20).map(step).collect()
}

proptest! {
    #[test]
    fn the_global_path_goes_through_all_places_at_even_distances(phase in -3.0..3.0f64, turn in 0.0..1.5f64) {
        let places = wavy(phase, turn);
        let settings = PathSettings::default();
        let path = GlobalPath::new(&route(&places), &settings);
        for pair in path.points().windows(2) {
            let step_m = (pair[1] - pair[0]).norm();
            prop_assert!(step_m <= 1.01 * settings.spacing_m && step_m >= 0.9 * settings.spacing_m, "{step_m} m");
        }
        for place in &places {
            let place = Vector2::new(place.x_m(), place.y_m());
            let gap_m = path.points().iter().map(|point| (point - place).norm()).fold(f64::INFINITY, f64::min);
            prop_assert!(gap_m <= settings.spacing_m);
        }
        let length_m: f64 = path.points().windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        prop_assert!((path.length_m() - length_m).abs() < 0.01 * length_m);
    }

    /// Straight from the robot to 40 cm beyond the nearest point, then the rest; targets are
    /// further than 20 cm and never go back.
    #[test]
    fn the_local_path_leads_back(
        phase in -3.0..3.0f64, turn in 0.0..1.5f64, along in 0.0..1.0f64, across_m in -0.5..0.5f64,
    ) {
        let places = wavy(phase, turn);
        let settings = PathSettings::default();
        let path = Arc::new(GlobalPath::new(&route(&places), &settings));
        let index = (along * (path.points().len() - 1) as f64) as usize;
        let on = path.points()[index];
        let ahead = path.direction(index);
        let mut robot = PlanarPose::new(on.x - across_m * ahead.y, on.y + across_m * ahead.x, ahead.y.atan2(ahead.x));
        let nearest = path.nearest(&robot, index, settings.window_m);
        let mut local = path.local(&robot, nearest, &settings);
        let points: Vec<_> = local.points().collect();
        let rejoins = (nearest + 40).min(path.last());
        let rest = path.points().len() - rejoins;
        prop_assert_eq!(&points[points.len() - rest..], &path.points()[rejoins..]);
        let here = Vector2::new(robot.x_m(), robot.y_m());
        prop_assert!(rest == points.len() || (points[0] - here).norm() < 1e-9);
        let straight_m: f64 = points[..=points.len() - rest].windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
        prop_assert!((straight_m - (path.points()[rejoins] - points[0]).norm()).abs() < 1e-6);

        let mut last = 0;
        for _ in 0..200 {
            let target = local.target(&robot, settings.target_m);
            let here = Vector2::new(robot.x_m(), robot.y_m());
            prop_assert!(local.target >= last);
            last = local.target;
            let is_end = last + 1 == local.len();
            prop_assert!(is_end || (target - here).norm() > settings.target_m);
            let step = (target - here).cap_magnitude(0.05);
            robot = PlanarPose::new(here.x + step.x, here.y + step.y, 0.0);
        }
    }
}

#[test]
fn a_crossing_is_no_shortcut() {
    // East, a loop to the left, and south through the first leg.
    let corners = [
        (0.0, 0.0, 0.0),
        (2.0, 0.0, 0.0),
        (3.0, 1.0, 1.57),
        (2.0, 2.0, 3.1),
        (1.0, 1.0, -1.57),
        (1.0, -2.0, -1.57),
    ];
    let places = corners.map(|(x, y, heading)| PlanarPose::new(x, y, heading));
    let path = GlobalPath::new(&route(&places), &PathSettings::default());
    let crossing = PlanarPose::new(1.0, 0.0, 0.0);
    let first = path.nearest(&crossing, 90, 1.0);
    assert!((60..140).contains(&first), "{first}");
    let end = path.points().len() - 1;
    let again = PlanarPose::new(1.0, 0.0, -1.57);
    let second = path.nearest(&again, end - 220, 1.0);
    assert!((end - 230..end - 170).contains(&second), "{second} of {end}");
    // Even where both are within the window, the one counts that is driven that way.
    assert_eq!(path.nearest(&again, end / 2, 10.0), second);
}

#[test]
fn a_route_of_one_place_is_a_point() {
    let settings = PathSettings::default();
    let path = Arc::new(GlobalPath::new(&route(&[PlanarPose::new(2.0, 1.0, 0.0)]), &settings));
    assert_eq!((path.length_m(), path.remaining_m(0)), (0.0, 0.0));
    let robot = PlanarPose::new(0.0, 1.0, 0.0);
    let mut local = path.local(&robot, path.nearest(&robot, 0, 1.0), &settings);
    assert_eq!(local.target(&robot, 5.0), Vector2::new(2.0, 1.0));
    let ahead = local.target(&robot, 0.2);
    assert_eq!(ahead, Vector2::new(2.0, 1.0));
}
