use super::*;
use proptest::prelude::*;
use topomap::log::{Link, LinkKind};
use topomap::map::Place;
use topomap::metric::{OdometryNoise, RelativePose};

/// A map whose places are where `poses` says, joined by these links: driven ones, then closures.
fn map(poses: &[PlanarPose], driven: &[(u32, u32)], closed: &[(u32, u32)]) -> (Map, PlacePoses) {
    let measured = |&(from, to): &(u32, u32)| {
        let pose = poses[from as usize].inverse().compose(&poses[to as usize]);
        RelativePose::new(pose, nalgebra::Matrix3::from_diagonal_element(1e-4)).unwrap()
    };
    let link = |kind: fn(RelativePose) -> LinkKind| {
        move |ends: &(u32, u32)| Link {
            from: PlaceId::new(ends.0),
            to: PlaceId::new(ends.1),
            kind: kind(measured(ends)),
        }
    };
    let links: Vec<Link> =
        driven.iter().map(link(LinkKind::Driven)).chain(closed.iter().map(link(LinkKind::Closed))).collect();
    let place_poses = PlacePoses::new(poses.iter().map(|_| 0), &links, &OdometryNoise::default());
    let places = vec![Place::default(); poses.len()];
    (
        Map::from_parts(places, links, std::collections::BTreeMap::new(), Default::default(), 0).unwrap(),
        place_poses,
    )
}

fn at(poses: &PlacePoses, place: PlaceId) -> MapPosition {
    MapPosition { part: poses.part(place).unwrap(), pose: *poses.pose(place).unwrap() }
}

fn places(route: &Route) -> Vec<PlaceId> {
    route.waypoints.iter().map(|waypoint| waypoint.place).collect()
}

/// A corridor of places 1 m apart, driven from left to right.
fn corridor(count: u32) -> Vec<PlanarPose> {
    (0..count).map(|place| PlanarPose::new(f64::from(place), 0.0, 0.0)).collect()
}

fn settings(against: AgainstTheWay) -> PlanningSettings {
    PlanningSettings { against, reach_m: 0.1, ..PlanningSettings::default() }
}

#[test]
fn a_detour_is_not_repeated_where_a_closure_joins_its_ends() {
    // 0 1 2, round by 3 4 5 and back to 2, then on to 6.
    let poses = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, -1), (3, 0)]
        .map(|(x, y)| PlanarPose::new(f64::from(x), f64::from(y), 0.0));
    let (map, poses) = map(&poses, &[(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (2, 6)], &[(5, 2)]);
    let settings = settings(AgainstTheWay::Forbidden);
    let route =
        plan(&map, &poses, &at(&poses, PlaceId::new(0)), Goal::Place(PlaceId::new(6)), &settings).unwrap();
    assert_eq!(places(&route), [0, 1, 2, 6].map(PlaceId::new));
    assert!((route.length_m - 3.0).abs() < 1e-3);
}

#[test]
fn what_cannot_be_planned_says_why() {
    // Two corridors that nothing joins; the second begins at place 4.
    let (map, poses) = map(&corridor(8), &[(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)], &[]);
    let forbidden = settings(AgainstTheWay::Forbidden);
    let tried = |from, goal, settings| plan(&map, &poses, &from, goal, settings);
    let from = at(&poses, PlaceId::new(2));
    assert_eq!(
        tried(from, Goal::Place(PlaceId::new(8)), &forbidden),
        Err(PlanError::UnknownPlace { place: PlaceId::new(8) })
    );
    assert_eq!(
        tried(from, Goal::Place(PlaceId::new(5)), &forbidden),
        Err(PlanError::OtherPart { goal: PlaceId::new(5), part: PlaceId::new(0) })
    );
    assert_eq!(
        tried(from, Goal::Place(PlaceId::new(0)), &forbidden),
        Err(PlanError::OneWay { goal: PlaceId::new(0) })
    );
    let nowhere = Goal::Position { part: PlaceId::new(0), position_m: [f64::NAN, 0.0] };
    assert_eq!(tried(from, nowhere, &forbidden), Err(PlanError::NotFinite));
    // No place is near, or no such part is there: wherever the robot is.
    let off_the_map = Goal::Position { part: PlaceId::new(0), position_m: [3.0, 1000.0] };
    let Err(PlanError::GoalTooFar { place, distance_m, reach_m: 0.1 }) = tried(from, off_the_map, &forbidden)
    else {
        panic!("a goal that is 1 km from the map")
    };
    assert_eq!(place, PlaceId::new(3));
    assert!((distance_m - 1000.0).abs() < 1e-9);
    let no_part = Goal::Position { part: PlaceId::new(1), position_m: [1.0, 0.0] };
    assert_eq!(tried(from, no_part, &forbidden), Err(PlanError::UnknownPart { part: PlaceId::new(1) }));
    let far = MapPosition { part: PlaceId::new(0), pose: PlanarPose::new(1.0, 5.0, 0.0) };
    let too_far = PlanError::TooFar { distance_m: 5.0, reach_m: forbidden.reach_m };
    assert_eq!(tried(far, Goal::Place(PlaceId::new(3)), &forbidden), Err(too_far));

    let costs = settings(AgainstTheWay::Costs { factor: 2.0 });
    let back = tried(from, Goal::Place(PlaceId::new(0)), &costs).unwrap();
    assert_eq!(places(&back), [2, 1, 0].map(PlaceId::new));
    let travels: Vec<Travel> = back.waypoints.iter().map(|waypoint| waypoint.travel).collect();
    assert_eq!(travels, [Travel::Along, Travel::Against, Travel::Against]);
    let nearest = Goal::Position { part: PlaceId::new(0), position_m: [2.95, 0.05] };
    assert_eq!(places(&tried(from, nearest, &forbidden).unwrap()), [2, 3].map(PlaceId::new));
    let stays = tried(from, Goal::Place(PlaceId::new(2)), &forbidden).unwrap();
    assert_eq!(places(&stays), [2].map(PlaceId::new));
    // Not -0.0, which JSON would show.
    assert!(stays.length_m == 0.0 && stays.length_m.is_sign_positive());
}

#[test]
fn a_map_without_metres_has_no_goals_and_its_only_place_is_one() {
    let settings = PlanningSettings::default();
    let position = |x_m| Goal::Position { part: PlaceId::new(0), position_m: [x_m, 0.0] };
    let (_, apart) = map(&corridor(2), &[], &[]);
    for goal in [Goal::Place(PlaceId::new(0)), Goal::Place(PlaceId::new(1)), position(0.0)] {
        assert_eq!(goal_place(&apart, goal, &settings), Err(PlanError::NoMetres), "{goal:?}");
    }
    // What is wrong whatever the map is like is said first.
    let nowhere = PlaceId::new(9);
    assert_eq!(
        goal_place(&apart, Goal::Place(nowhere), &settings),
        Err(PlanError::UnknownPlace { place: nowhere })
    );
    assert_eq!(goal_place(&apart, position(f64::NAN), &settings), Err(PlanError::NotFinite));
    // The third place was never joined with the others.
    let (_, mixed) = map(&corridor(3), &[(0, 1)], &[]);
    let third = PlaceId::new(2);
    assert_eq!(
        goal_place(&mixed, Goal::Place(third), &settings),
        Err(PlanError::Unmeasured { place: third })
    );
    assert_eq!(goal_place(&mixed, Goal::Place(PlaceId::new(1)), &settings), Ok(PlaceId::new(1)));
    let (_, alone) = map(&corridor(1), &[], &[]);
    for goal in [Goal::Place(PlaceId::new(0)), position(0.0)] {
        assert_eq!(goal_place(&alone, goal, &settings), Ok(PlaceId::new(0)), "{goal:?}");
    }
}

/// Metres that a way costs, from the definition.
fn cost_m(poses: &[PlanarPose], nodes: &[Node], settings: &PlanningSettings) -> f64 {
    let step = |pair: &[Node]| {
        let ((from, looked), (to, travel)) = (pair[0], pair[1]);
        let from = &poses[from.index()];
        let to = &poses[to.index()];
        let length_m = (to.x_m() - from.x_m()).hypot(to.y_m() - from.y_m());
        let turn_rad = PlanarPose::new(0.0, 0.0, to.heading_rad() - from.heading_rad()).heading_rad().abs();
        let factor = match (travel, settings.against) {
            (Travel::Against, AgainstTheWay::Costs { factor }) => factor,
            (Travel::Against, AgainstTheWay::Forbidden) => f64::INFINITY,
            (Travel::Along, _) => 1.0,
        };
        let about_rad = if looked == travel { 0.0 } else { std::f64::consts::PI };
        factor * length_m + settings.turn_m_per_rad * (turn_rad + about_rad)
    };
    nodes.windows(2).map(step).sum()
}

/// Of all ways that come past no node twice, the cost of the cheapest.
fn cheapest_of_all(
    poses: &[PlanarPose],
    links: &[(PlaceId, PlaceId)],
    goal: PlaceId,
    settings: &PlanningSettings,
    way: &mut Vec<Node>,
) -> f64 {
    let here = way[way.len() - 1].0;
    if here == goal {
        return cost_m(poses, way, settings);
    }
    let mut least = f64::INFINITY;
    for &(from, to) in links {
        for (start, next) in [(from, (to, Travel::Along)), (to, (from, Travel::Against))] {
            if start == here && !way.contains(&next) {
                way.push(next);
                least = least.min(cheapest_of_all(poses, links, goal, settings, way));
                way.pop();
            }
        }
    }
    least
}

fn pose() -> impl Strategy<Value = PlanarPose> {
    (-9.0..9.0f64, -9.0..9.0f64, -3.0..3.0f64).prop_map(|(x, y, heading)| PlanarPose::new(x, y, heading))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_way_is_cheaper(
        poses in proptest::collection::vec(pose(), 5), links in proptest::collection::vec((0..5u32, 0..5u32), 0..6),
        factor in 1.0..3.0f64, forbidden in any::<bool>(), goal in (0..5u32).prop_map(PlaceId::new),
    ) {
        let links: Vec<_> = links.into_iter().filter(|(from, to)| from != to).collect();
        let of_places: Vec<_> =
            links.iter().map(|&(from, to)| (PlaceId::new(from), PlaceId::new(to))).collect();
        let (map, place_poses) = map(&poses, &links, &[]);
        let settings = settings(if forbidden { AgainstTheWay::Forbidden } else { AgainstTheWay::Costs { factor } });
        let found = plan(&map, &place_poses, &at(&place_poses, PlaceId::new(0)), Goal::Place(goal), &settings);
        let least_m = cheapest_of_all(&poses, &of_places, goal, &settings, &mut vec![(PlaceId::new(0), Travel::Along)]);
        match found {
            Ok(route) => {
                let nodes: Vec<Node> = route.waypoints.iter().map(|waypoint| (waypoint.place, waypoint.travel)).collect();
                prop_assert_eq!((nodes[0].0, nodes[nodes.len() - 1].0), (PlaceId::new(0), goal));
                prop_assert!((cost_m(&poses, &nodes, &settings) - least_m).abs() < 1e-6, "{} m, not {least_m} m", cost_m(&poses, &nodes, &settings));
            }
            Err(PlanError::OneWay { .. } | PlanError::OtherPart { .. }) => prop_assert!(least_m.is_infinite()),
            Err(PlanError::NoMetres) => prop_assert!(links.is_empty()),
            Err(PlanError::Unmeasured { place }) => {
                prop_assert!(place == goal && of_places.iter().all(|&(from, to)| ![from, to].contains(&goal)));
            }
            Err(error) => prop_assert!(false, "{error}"),
        }
    }
}
