//! Which way leads there: Dijkstra over places, with the way that the robot looks.

use std::collections::BTreeSet;

use fabmap::appearance::PlaceId;

use super::settings::{AgainstTheWay, PlanningSettings};
use posegraph::shortest_paths::{ShortestPaths, Step};
use posegraph::{PlanarPose, Pose};
use topomap::map::{Map, PlacePoses};

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

/// A way over places. Poses are those of when it was planned: a map that is relaxed later does not
/// move it.
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
    /// The map has no such part.
    #[error(
        "no part of the map begins with place {part}; list its places, each names the part that it is in"
    )]
    UnknownPart {
        /// As given.
        part: PlaceId,
    },
    /// A map whose places no odometry joins.
    #[error(
        "the map has no metres, and a robot is led by them: no two of its places are joined by odometry; drive the way while \
         frames bring odometry, or make a map with the navigation strategy appearance of panoramas"
    )]
    NoMetres,
    /// A place that no odometry joins with another, on a map that has metres elsewhere.
    #[error(
        "no way to place {place} was measured, so no robot is led there: drive there while frames bring odometry, or name \
         another place"
    )]
    Unmeasured {
        /// As given, or the nearest to the position.
        place: PlaceId,
    },
    /// A position that no way leads to.
    #[error(
        "the goal is {distance_m:.1} m from the nearest place, {place}, and a robot goes only where it was driven; name \
         a position within {reach_m} m of a place, or that place"
    )]
    GoalTooFar {
        /// The nearest place.
        place: PlaceId,
        /// To it, in metres.
        distance_m: f64,
        /// The setting.
        reach_m: f64,
    },
    /// No way was ever driven from one to the other.
    #[error(
        "no way that was driven joins place {goal} with the start, which is in the part of the map that begins with \
         place {part}; drive from one to the other while mapping, or name a place of that part"
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

/// The cheapest way from where a robot is to a goal. What was driven as a detour is not driven
/// again where a closure joins its ends.
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
    let goal = goal_place(poses, goal, settings)?;
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

/// The place that a goal means, wherever the robot is.
///
/// # Errors
/// [`PlanError`] if the map has none there, or no way to it was measured.
pub fn goal_place(poses: &PlacePoses, goal: Goal, settings: &PlanningSettings) -> Result<PlaceId, PlanError> {
    let place = match goal {
        Goal::Place(place) if poses.pose(place).is_some() => place,
        Goal::Place(place) => return Err(PlanError::UnknownPlace { place }),
        Goal::Position { part, position_m } => nearest(poses, part, position_m, settings)?,
    };
    // No way is needed to the only place.
    if poses.is_joined(place) || poses.poses().len() == 1 {
        Ok(place)
    } else if poses.has_metres() {
        Err(PlanError::Unmeasured { place })
    } else {
        Err(PlanError::NoMetres)
    }
}

/// The place of a part that is nearest to a position, if it is near.
fn nearest(
    poses: &PlacePoses,
    part: PlaceId,
    position_m: [f64; 2],
    settings: &PlanningSettings,
) -> Result<PlaceId, PlanError> {
    if position_m.iter().any(|value| !value.is_finite()) {
        return Err(PlanError::NotFinite);
    }
    let apart = of_part(poses, part).map(|(place, pose)| (place, distance_m(pose, position_m)));
    let nearest = apart.min_by(|(_, a), (_, b)| a.total_cmp(b));
    let (place, distance_m) = nearest.ok_or(PlanError::UnknownPart { part })?;
    let reach_m = settings.reach_m;
    if distance_m <= reach_m { Ok(place) } else { Err(PlanError::GoalTooFar { place, distance_m, reach_m }) }
}

fn of_part(poses: &PlacePoses, part: PlaceId) -> impl Iterator<Item = (PlaceId, &PlanarPose)> {
    PlaceId::all().zip(poses.poses()).filter(move |&(place, _)| poses.part(place) == Some(part))
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
        let standing = map.standing_links().filter(|(number, link)| {
            !contradicted.contains(number) && poses.part(link.from) == poses.part(link.to)
        });
        let standing = standing.map(|(_, link)| (link.from, link.to));
        for (from, to) in standing.chain(poses.past_contradicted()) {
            ways[from.index()].push((to, Travel::Along));
            ways[to.index()].push((from, Travel::Against));
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
        let index = |(place, travel): Node| 2 * place.index() + usize::from(travel == Travel::Against);
        let node = |index: usize| -> Node {
            (
                PlaceId::from_index(index / 2),
                if index.is_multiple_of(2) { Travel::Along } else { Travel::Against },
            )
        };
        let mut paths = ShortestPaths::new(2 * self.ways.len());
        let steps = |from: usize| {
            let step = move |&to: &Node| {
                let length = self.cost_m(node(from), to)?;
                Some(Step { to: index(to), length, edge: 0 })
            };
            self.ways[from / 2].iter().filter_map(step)
        };
        let is_goal = |index: usize| node(index).0 == goal;
        let end = paths.search([index((start, Travel::Along))], is_goal, steps)?;
        Some(paths.way_to(end).into_iter().map(|(index, _)| node(index)).collect())
    }
}

fn route(poses: &PlacePoses, part: PlaceId, nodes: &[Node]) -> Route {
    let waypoint = |&(place, travel): &Node| Some(Waypoint { place, pose: *poses.pose(place)?, travel });
    let waypoints: Vec<Waypoint> = nodes.iter().filter_map(waypoint).collect();
    let between = |pair: &[Waypoint]| distance_m(&pair[0].pose, [pair[1].pose.x_m(), pair[1].pose.y_m()]);
    // An empty sum of floats is -0.0.
    let length_m = waypoints.windows(2).map(between).fold(0.0, |sum_m, metres| sum_m + metres);
    Route { part, waypoints, length_m }
}

#[cfg(test)]
mod tests;
