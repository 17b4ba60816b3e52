//! Which way leads there: Dijkstra over places, with the way that the robot looks.

use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

use fabmap::appearance::PlaceId;

use super::settings::{AgainstTheWay, PlanningSettings};
use crate::map::Map;
use crate::place_poses::PlacePoses;
use crate::relaxation::{PlanarPose, Pose};

/// Where a robot is to go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// A place.
    Place(PlaceId),
    /// The place that is nearest to a position of a part of the map.
    Position {
        /// The part's lowest place.
        part: PlaceId,
        /// x and y in its frame, in metres.
        position_m: [f64; 2],
    },
}

/// Where on the map something is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPosition {
    /// The lowest place of the part of the map, in whose frame the pose is.
    pub part: PlaceId,
    /// The pose.
    pub pose: PlanarPose,
}

/// A way over places. Poses are those of when it was planned: a map that is relaxed later does not move it.
#[derive(Clone, Debug, PartialEq)]
pub struct Route {
    /// The lowest place of the part of the map that it runs in.
    pub part: PlaceId,
    /// From the place nearest to the robot to the goal; at least one.
    pub waypoints: Vec<Waypoint>,
    /// From waypoint to waypoint, in metres.
    pub length_m: f64,
}

/// A place on a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// The place.
    pub place: PlaceId,
    /// Where it is, and how the robot that learnt it stood there.
    pub pose: PlanarPose,
    /// How the robot comes there.
    pub travel: Travel,
}

/// How a link is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Travel {
    /// As it was taught.
    Along,
    /// The other way round.
    Against,
}

/// Why there is no way.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The map has no such place.
    #[error("the map has no place {place}; list its places")]
    UnknownPlace {
        /// As given.
        place: PlaceId,
    },
    /// No way was ever driven from one to the other.
    #[error(
        "no way that was driven joins place {goal} with where the robot is; drive from one to the other while mapping, \
         or name a place of the part of the map that begins with place {part}"
    )]
    OtherPart {
        /// The goal.
        goal: PlaceId,
        /// The part that the robot is in.
        part: PlaceId,
    },
    /// Links are one-way.
    #[error(
        "place {goal} cannot be reached in the direction in which ways were driven; allow driving against it, or teach \
         the way back"
    )]
    OneWay {
        /// The goal.
        goal: PlaceId,
    },
    /// The robot is nowhere near a place.
    #[error(
        "the nearest place is {distance_m:.1} m away, more than {reach_m} m; bring the robot nearer to the map"
    )]
    TooFar {
        /// To the nearest place, in metres.
        distance_m: f64,
        /// The setting.
        reach_m: f64,
    },
    /// A position or a heading that is no number.
    #[error("the goal's position or heading is not finite; give metres and radians in the map's frame")]
    NotFinite,
}

/// The cheapest way from where a robot is to a goal. What was driven as a detour is not driven again where a closure
/// joins its ends.
///
/// # Errors
/// [`PlanError`] if there is none.
pub fn plan(
    map: &Map,
    poses: &PlacePoses,
    from: &MapPosition,
    goal: Goal,
    settings: &PlanningSettings,
) -> Result<Route, PlanError> {
    let goal = goal_place(poses, from.part, goal)?;
    if poses.part(goal) != Some(from.part) {
        return Err(PlanError::OtherPart { goal, part: from.part });
    }
    let graph = Graph::new(map, poses, settings);
    for start in starts(poses, from, settings)? {
        if let Some(steps) = graph.cheapest(start, goal) {
            return Ok(route(poses, from.part, &steps));
        }
    }
    Err(PlanError::OneWay { goal })
}

fn goal_place(poses: &PlacePoses, part: PlaceId, goal: Goal) -> Result<PlaceId, PlanError> {
    match goal {
        Goal::Place(place) if poses.pose(place).is_some() => Ok(place),
        Goal::Place(place) => Err(PlanError::UnknownPlace { place }),
        Goal::Position { part: goal_part, position_m } => {
            if position_m.iter().any(|value| !value.is_finite()) {
                return Err(PlanError::NotFinite);
            }
            let nearest = of_part(poses, goal_part)
                .min_by(|(_, a), (_, b)| distance_m(a, position_m).total_cmp(&distance_m(b, position_m)));
            let (goal, _) = nearest.ok_or(PlanError::UnknownPlace { place: goal_part })?;
            if goal_part == part { Ok(goal) } else { Err(PlanError::OtherPart { goal, part }) }
        }
    }
}

fn of_part(poses: &PlacePoses, part: PlaceId) -> impl Iterator<Item = (PlaceId, &PlanarPose)> {
    (0..).zip(poses.poses()).filter(move |&(place, _)| poses.part(place) == Some(part))
}

fn distance_m(pose: &PlanarPose, [x_m, y_m]: [f64; 2]) -> f64 {
    (pose.x_m() - x_m).hypot(pose.y_m() - y_m)
}

/// Places within reach of the robot, those first that it need neither drive nor turn far for.
fn starts(
    poses: &PlacePoses,
    from: &MapPosition,
    settings: &PlanningSettings,
) -> Result<Vec<PlaceId>, PlanError> {
    let position_m = [from.pose.x_m(), from.pose.y_m()];
    let mut near: Vec<(f64, PlaceId)> = Vec::new();
    let mut nearest_m = f64::INFINITY;
    for (place, pose) in of_part(poses, from.part) {
        let distance_m = distance_m(pose, position_m);
        nearest_m = nearest_m.min(distance_m);
        if distance_m <= settings.reach_m {
            let turn_rad = pose.inverse().compose(&from.pose).heading_rad().abs();
            near.push((distance_m + settings.turn_m_per_rad * turn_rad, place));
        }
    }
    if near.is_empty() {
        return Err(PlanError::TooFar { distance_m: nearest_m, reach_m: settings.reach_m });
    }
    near.sort_by(|(a, first), (b, second)| a.total_cmp(b).then(first.cmp(second)));
    Ok(near.into_iter().map(|(_, place)| place).collect())
}

/// What can be driven, and what it costs.
struct Graph<'a> {
    poses: &'a PlacePoses,
    settings: &'a PlanningSettings,
    /// Of each place: where its links lead.
    ways: Vec<Vec<(PlaceId, Travel)>>,
}

/// A place, and whether the robot looks there as it was taught to.
type Node = (PlaceId, Travel);

impl<'a> Graph<'a> {
    fn new(map: &Map, poses: &'a PlacePoses, settings: &'a PlanningSettings) -> Self {
        let contradicted: BTreeSet<usize> = poses.contradicted().collect();
        let mut ways = vec![Vec::new(); poses.poses().len()];
        for (number, link) in map.links().iter().enumerate() {
            if contradicted.contains(&number) || poses.part(link.from) != poses.part(link.to) {
                continue;
            }
            ways[link.from as usize].push((link.to, Travel::Along));
            ways[link.to as usize].push((link.from, Travel::Against));
        }
        Self { poses, settings, ways }
    }

    /// Cost of a link in metres; `None` if it is not to be driven so.
    fn cost_m(&self, (from, looks): Node, (to, travel): Node) -> Option<f64> {
        let between = self.poses.pose(from)?.inverse().compose(self.poses.pose(to)?);
        let length_m = between.x_m().hypot(between.y_m());
        let factor = match (travel, self.settings.against) {
            (Travel::Along, _) => 1.0,
            (Travel::Against, AgainstTheWay::Costs { factor }) => factor,
            (Travel::Against, AgainstTheWay::Forbidden) => return None,
        };
        let turned_about = if looks == travel { 0.0 } else { std::f64::consts::PI };
        let turn_rad = between.heading_rad().abs() + turned_about;
        Some(factor * length_m + self.settings.turn_m_per_rad * turn_rad)
    }

    /// The nodes of the cheapest way, from start to goal, however the robot looks there.
    fn cheapest(&self, start: PlaceId, goal: PlaceId) -> Option<Vec<Node>> {
        let index = |(place, travel): Node| 2 * place as usize + usize::from(travel == Travel::Against);
        let mut costs = vec![f64::INFINITY; 2 * self.ways.len()];
        let mut before: Vec<Option<Node>> = vec![None; costs.len()];
        let mut open = BinaryHeap::from([Open { cost_m: 0.0, node: (start, Travel::Along) }]);
        costs[index((start, Travel::Along))] = 0.0;
        while let Some(Open { cost_m, node }) = open.pop() {
            if node.0 == goal {
                let back = |&node: &Node| before[index(node)];
                let mut nodes: Vec<Node> = std::iter::successors(Some(node), back).collect();
                nodes.reverse();
                return Some(nodes);
            }
            if cost_m > costs[index(node)] {
                continue;
            }
            for &next in &self.ways[node.0 as usize] {
                let Some(step_m) = self.cost_m(node, next) else { continue };
                let cost_m = cost_m + step_m;
                if cost_m < costs[index(next)] {
                    costs[index(next)] = cost_m;
                    before[index(next)] = Some(node);
                    open.push(Open { cost_m, node: next });
                }
            }
        }
        None
    }
}

fn route(poses: &PlacePoses, part: PlaceId, nodes: &[Node]) -> Route {
    let waypoint = |&(place, travel): &Node| Some(Waypoint { place, pose: *poses.pose(place)?, travel });
    let waypoints: Vec<Waypoint> = nodes.iter().filter_map(waypoint).collect();
    let between = |pair: &[Waypoint]| distance_m(&pair[0].pose, [pair[1].pose.x_m(), pair[1].pose.y_m()]);
    let length_m = waypoints.windows(2).map(between).sum();
    Route { part, waypoints, length_m }
}

/// A node on the edge of what is known, the cheapest first.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Open {
    cost_m: f64,
    node: Node,
}

impl Eq for Open {}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost_m.total_cmp(&self.cost_m).then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::{Link, LinkKind};
    use crate::map::Place;
    use crate::relative_pose::{OdometryNoise, RelativePose};
    use proptest::prelude::*;

    /// A map whose places are where `poses` says, joined by these links: driven ones, then closures.
    fn map(poses: &[PlanarPose], driven: &[(u32, u32)], closed: &[(u32, u32)]) -> (Map, PlacePoses) {
        let measured = |&(from, to): &(u32, u32)| {
            let pose = poses[from as usize].inverse().compose(&poses[to as usize]);
            RelativePose::new(pose, nalgebra::Matrix3::from_diagonal_element(1e-4)).unwrap()
        };
        let link = |kind: fn(RelativePose) -> LinkKind| {
            move |ends: &(u32, u32)| Link { from: ends.0, to: ends.1, kind: kind(measured(ends)) }
        };
        let links: Vec<Link> = driven
            .iter()
            .map(link(LinkKind::Driven))
            .chain(closed.iter().map(link(LinkKind::Closed)))
            .collect();
        let place_poses = PlacePoses::new(poses.iter().map(|_| 0), &links, &OdometryNoise::default());
        let places = vec![Place::default(); poses.len()];
        (Map::from_parts(places, links, std::collections::BTreeMap::new(), 0).unwrap(), place_poses)
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
        let route = plan(&map, &poses, &at(&poses, 0), Goal::Place(6), &settings).unwrap();
        assert_eq!(places(&route), [0, 1, 2, 6]);
        assert!((route.length_m - 3.0).abs() < 1e-3);
    }

    #[test]
    fn what_cannot_be_planned_says_why() {
        // Two corridors that nothing joins; the second begins at place 4.
        let (map, poses) = map(&corridor(8), &[(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)], &[]);
        let forbidden = settings(AgainstTheWay::Forbidden);
        let tried = |from, goal, settings| plan(&map, &poses, &from, goal, settings);
        let from = at(&poses, 2);
        assert_eq!(tried(from, Goal::Place(8), &forbidden), Err(PlanError::UnknownPlace { place: 8 }));
        assert_eq!(tried(from, Goal::Place(5), &forbidden), Err(PlanError::OtherPart { goal: 5, part: 0 }));
        assert_eq!(tried(from, Goal::Place(0), &forbidden), Err(PlanError::OneWay { goal: 0 }));
        let nowhere = Goal::Position { part: 0, position_m: [f64::NAN, 0.0] };
        assert_eq!(tried(from, nowhere, &forbidden), Err(PlanError::NotFinite));
        let far = MapPosition { part: 0, pose: PlanarPose::new(1.0, 5.0, 0.0) };
        let too_far = PlanError::TooFar { distance_m: 5.0, reach_m: forbidden.reach_m };
        assert_eq!(tried(far, Goal::Place(3), &forbidden), Err(too_far));

        let costs = settings(AgainstTheWay::Costs { factor: 2.0 });
        let back = tried(from, Goal::Place(0), &costs).unwrap();
        assert_eq!(places(&back), [2, 1, 0]);
        let travels: Vec<Travel> = back.waypoints.iter().map(|waypoint| waypoint.travel).collect();
        assert_eq!(travels, [Travel::Along, Travel::Against, Travel::Against]);
        let nearest = Goal::Position { part: 0, position_m: [2.9, 0.4] };
        assert_eq!(places(&tried(from, nearest, &forbidden).unwrap()), [2, 3]);
        assert_eq!(places(&tried(from, Goal::Place(2), &forbidden).unwrap()), [2]);
    }

    /// Metres that a way costs, from the definition.
    fn cost_m(poses: &[PlanarPose], nodes: &[Node], settings: &PlanningSettings) -> f64 {
        let step = |pair: &[Node]| {
            let ((from, looked), (to, travel)) = (pair[0], pair[1]);
            let (from, to) = (&poses[from as usize], &poses[to as usize]);
            let length_m = (to.x_m() - from.x_m()).hypot(to.y_m() - from.y_m());
            let turn_rad =
                PlanarPose::new(0.0, 0.0, to.heading_rad() - from.heading_rad()).heading_rad().abs();
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
        links: &[(u32, u32)],
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
            factor in 1.0..3.0f64, forbidden in any::<bool>(), goal in 0..5u32,
        ) {
            let links: Vec<_> = links.into_iter().filter(|(from, to)| from != to).collect();
            let (map, place_poses) = map(&poses, &links, &[]);
            let settings = settings(if forbidden { AgainstTheWay::Forbidden } else { AgainstTheWay::Costs { factor } });
            let found = plan(&map, &place_poses, &at(&place_poses, 0), Goal::Place(goal), &settings);
            let least_m = cheapest_of_all(&poses, &links, goal, &settings, &mut vec![(0, Travel::Along)]);
            match found {
                Ok(route) => {
                    let nodes: Vec<Node> = route.waypoints.iter().map(|waypoint| (waypoint.place, waypoint.travel)).collect();
                    prop_assert_eq!((nodes[0].0, nodes[nodes.len() - 1].0), (0, goal));
                    prop_assert!((cost_m(&poses, &nodes, &settings) - least_m).abs() < 1e-6, "{} m, not {least_m} m", cost_m(&poses, &nodes, &settings));
                }
                Err(PlanError::OneWay { .. } | PlanError::OtherPart { .. }) => prop_assert!(least_m.is_infinite()),
                Err(error) => prop_assert!(false, "{error}"),
            }
        }
    }
}
