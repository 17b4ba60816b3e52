//! Drives to goals, by looks alone, people in the way or not.

use std::f64::consts::PI;

use anyhow::Result;
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use waypost_navigation::appearance::graph::{ImageId, Overlap, Panorama};
use waypost_navigation::appearance::navigator::{
    AppearanceNavigator, Body, Guidance, HeadingSteering, NavigationSettings, NavigationStatus, Sight,
};
use waypost_sim::drive::REFLEX_IN_DOORS;
use waypost_sim::people::{Behaviour, Person, Walker};
use waypost_sim::pose::Pose;
use waypost_sim::range_sensor::RangeScan;
use waypost_sim::robot::{Body as RobotBody, Command};
use waypost_sim::simulation::{CameraTrigger, Obedience, Simulation, SimulationSettings};
use waypost_sim::worlds::{NamedRoute, NamedWorld};
use waypost_vision::panorama::PanoramicView;

use super::eye::{Eye, TaughtMap};

/// From image to image of a map, in metres.
pub(crate) const SPACING_M: f64 = 0.5;

/// From observation to observation, in nanoseconds.
const OBSERVATION_NS: i64 = 250_000_000;

/// Seconds after which a drive is given up, per metre of the shortest path, and in all.
const LIMIT_S: (f64, f64) = (10.0, 100.0);

/// A drive to one goal.
#[derive(Serialize)]
pub(crate) struct Drive {
    /// Of the building, the start and the noise.
    pub seed: u64,
    /// Whose ends it goes between.
    pub route: &'static str,
    /// Who is in the way.
    pub people: usize,
    /// Whether the robot said that it had arrived.
    pub arrived: bool,
    /// How often it touched something.
    pub collisions: u64,
    /// Metres that it drove.
    pub driven_m: f64,
    /// From where it stopped to the goal.
    pub left_m: f64,
    /// Metres over the graph's images, by links along which a robot has room.
    pub shortest_m: f64,
    /// (driven + left) / shortest.
    pub path_ratio: f64,
    /// Observations of each status: driving, recovering, lost, blocked.
    pub statuses: [usize; 4],
    /// Seconds with somebody nearer to the hull than 30 cm.
    pub beside_people_s: f64,
    /// Comparisons with images of the map per observation, mean.
    pub compared_mean: f64,
    /// Where it went.
    #[serde(skip)]
    pub path: Vec<Vector2<f64>>,
}

/// A building, and the drives in it.
pub(crate) struct DrivenMap {
    /// The building with its images.
    pub map: TaughtMap,
    /// Where the robot was sent in it.
    pub drives: Vec<Drive>,
}

/// What the robot sees now, with all that it may be compared with.
struct Observation<'a> {
    eye: &'a Eye,
    map: &'a TaughtMap,
    view: &'a PanoramicView,
    before: Option<&'a PanoramicView>,
}

impl Panorama for Observation<'_> {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        self.view.compare(&self.map.views[image as usize], &self.eye.search).overlap
    }
}

impl Sight for Observation<'_> {
    fn turned_rad(&self) -> Option<f64> {
        let overlap = self.view.compare(self.before?, &self.eye.search).overlap?;
        // The one before looked further to the left by R if the robot has turned right by it.
        Some(-overlap.motion.rotation_rad())
    }

    fn relocalization_candidates(&self) -> Vec<ImageId> {
        (0..self.map.views.len() as ImageId).collect()
    }
}

/// Drives to the ends of all routes of the paper's office in buildings of these seeds.
pub(crate) fn drive_all(eye: &Eye, seeds: &[u64], people: &[usize]) -> Result<Vec<DrivenMap>> {
    let drives = seeds.par_iter().map(|&seed| {
        let map = TaughtMap::new(eye, NamedWorld::BooijOffice.plan(seed), SPACING_M, seed)?;
        let routes = NamedWorld::BooijOffice.routes();
        let mut drives = Vec::new();
        for &people in people {
            // People are met on the longer way.
            let routes = if people == 0 { &routes[..] } else { &routes[..1] };
            for route in routes {
                drives.push(drive(eye, &map, route, seed, people)?);
            }
        }
        Ok(DrivenMap { map, drives })
    });
    drives.collect()
}

/// One drive from the image nearest to a route's start to the one nearest to its end.
fn drive(eye: &Eye, map: &TaughtMap, route: &NamedRoute, seed: u64, people: usize) -> Result<Drive> {
    let [start, goal] =
        [route.corners[0], route.corners[route.corners.len() - 1]].map(|end| map.nearest(end));
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(31) + people as u64);
    let from = map.poses[start];
    let turned = PI * (2.0 * random.random::<f64>() - 1.0);
    let mut simulation = simulation(eye, map, Pose::new(from.x_m, from.y_m, turned), seed)?;
    let path = shortest_path(map, start, goal);
    for position in waiting_places(map, &path, people) {
        let look = random.random::<u64>();
        let person = Person { pose: Pose::new(position.x, position.y, 0.0), look };
        let behaviour = Behaviour::Blocking { notice_m: 2.0, patience_s: 6.0, speed_m_s: 0.7 };
        simulation.add_person(person, behaviour)?;
    }
    let shortest_m: f64 = path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let followed = follow(eye, map, &mut simulation, goal as ImageId, LIMIT_S.1 + LIMIT_S.0 * shortest_m)?;
    let driven_m: f64 = followed.path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let left_m = simulation.robot().pose().distance_m(&map.poses[goal]);
    let observations = followed.statuses.iter().sum::<usize>().max(1) as f64;
    Ok(Drive {
        seed,
        route: route.name,
        people,
        arrived: followed.arrived,
        collisions: simulation.collisions(),
        driven_m,
        left_m,
        shortest_m,
        path_ratio: (driven_m + left_m) / shortest_m,
        statuses: followed.statuses,
        beside_people_s: followed.beside_people_s,
        compared_mean: followed.compared as f64 / observations,
        path: followed.path,
    })
}

fn simulation(eye: &Eye, map: &TaughtMap, start: Pose, seed: u64) -> Result<Simulation> {
    let settings = SimulationSettings {
        trigger: CameraTrigger::Period { period_ns: OBSERVATION_NS },
        seed,
        reflex: Some(REFLEX_IN_DOORS),
        ..SimulationSettings::new(eye.rig.clone())
    };
    Ok(Simulation::new(map.scene.clone(), start, settings)?)
}

/// What came of following a navigator.
struct Followed {
    arrived: bool,
    path: Vec<Vector2<f64>>,
    statuses: [usize; 4],
    compared: usize,
    beside_people_s: f64,
}

fn follow(
    eye: &Eye,
    map: &TaughtMap,
    simulation: &mut Simulation,
    goal: ImageId,
    limit_s: f64,
) -> Result<Followed> {
    let mut navigator = AppearanceNavigator::new(&map.graph, goal, NavigationSettings::default())?;
    let mut followed =
        Followed { arrived: false, path: Vec::new(), statuses: [0; 4], compared: 0, beside_people_s: 0.0 };
    let mut before: Option<PanoramicView> = None;
    let mut obedience = Obedience::Idle;
    while (simulation.now_ns() as f64) * 1e-9 < limit_s {
        let mut shot = simulation.look();
        // Each image has noise of its own.
        shot.seed = shot.seed.wrapping_add(simulation.now_ns() as u64);
        let view = eye.see(&map.scene, &shot)?;
        let sight = Observation { eye, map, view: &view, before: before.as_ref() };
        let body = if obedience == Obedience::Reflex { Body::Held } else { Body::Free };
        let guidance = navigator.observe(&map.graph, &sight, body);
        followed.compared += guidance.compared;
        before = Some(view);
        match guidance.status {
            NavigationStatus::Arrived => {
                followed.arrived = true;
                break;
            }
            NavigationStatus::Driving => followed.statuses[0] += 1,
            NavigationStatus::Recovering => followed.statuses[1] += 1,
            NavigationStatus::Lost => followed.statuses[2] += 1,
            NavigationStatus::Blocked => followed.statuses[3] += 1,
        }
        simulation.command(command(&guidance, simulation.scan()));
        let until_ns = simulation.now_ns() + OBSERVATION_NS;
        while simulation.now_ns() < until_ns {
            let tick = simulation.advance();
            obedience = tick.obedience;
            followed.path.push(tick.truth.position());
            if is_beside_people(simulation) {
                followed.beside_people_s += simulation.settings().period_ns as f64 * 1e-9;
            }
        }
    }
    Ok(followed)
}

fn is_beside_people(simulation: &Simulation) -> bool {
    let reach_m = RobotBody::default().radius_m + Person::RADIUS_M + 0.3;
    simulation.people().iter().any(|person| person.pose.distance_m(simulation.robot().pose()) < reach_m)
}

/// Turns to the heading, and drives the faster the less there is to turn. A robot that does not know where to go looks
/// around.
fn command(guidance: &Guidance, scan: &RangeScan) -> Command {
    let valid_ns = OBSERVATION_NS + OBSERVATION_NS / 2;
    let heading_rad =
        guidance.heading_rad.map(|heading| scan.free_heading_rad(heading, RobotBody::default().radius_m));
    let [forward_m_s, turn_rad_s] = HeadingSteering::default().steer(heading_rad);
    Command { forward_m_s, turn_rad_s, valid_ns }
}

/// Positions of the images along the metrically shortest way from one to another, over links that a robot can drive.
pub(crate) fn shortest_path(map: &TaughtMap, start: usize, goal: usize) -> Vec<Vector2<f64>> {
    let radius_m = RobotBody::default().radius_m;
    let count = map.poses.len();
    let mut distance = vec![f64::INFINITY; count];
    let mut next = vec![usize::MAX; count];
    let mut is_done = vec![false; count];
    distance[goal] = 0.0;
    let nearest = |distance: &[f64], is_done: &[bool]| {
        let open = (0..count).filter(|&image| !is_done[image] && distance[image].is_finite());
        open.min_by(|&a, &b| distance[a].total_cmp(&distance[b]))
    };
    while let Some(here) = nearest(&distance, &is_done) {
        is_done[here] = true;
        let from = map.poses[here].position();
        for link in map.graph.neighbours(here as ImageId) {
            let to = link.to as usize;
            let total = distance[here] + (map.poses[to].position() - from).norm();
            if total < distance[to] && map.scene.plan().is_free_line(from, map.poses[to].position(), radius_m)
            {
                distance[to] = total;
                next[to] = here;
            }
        }
    }
    let mut path = vec![start];
    while let Some(&here) = path.last().filter(|&&here| here != goal && next[here] != usize::MAX) {
        path.push(next[here]);
    }
    path.into_iter().map(|image| map.poses[image].position()).collect()
}

/// Places beside a path where people wait, evenly along it, who come to the robot and stand before its camera.
fn waiting_places(map: &TaughtMap, path: &[Vector2<f64>], people: usize) -> Vec<Vector2<f64>> {
    let plan = map.scene.plan();
    let radius_m = RobotBody::default().radius_m;
    let lengths: Vec<f64> = path.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    let whole: f64 = lengths.iter().sum();
    let along = |share: f64| {
        let mut left = share * whole;
        for (pair, length) in path.windows(2).zip(&lengths) {
            if left <= *length {
                return pair[0] + (pair[1] - pair[0]) * (left / length.max(1e-9));
            }
            left -= length;
        }
        path[path.len() - 1]
    };
    let room_m = Person::RADIUS_M + 2.0 * radius_m + Walker::DISTANCE_M;
    (0..people)
        .filter_map(|person| {
            let middle = along((person as f64 + 1.0) / (people as f64 + 1.0));
            // Where there is room, and the robot can pass.
            let around = (0..400).map(|step| {
                let angle = f64::from(step) * 2.4;
                let distance = 0.3 + 0.004 * f64::from(step);
                middle + distance * Vector2::new(angle.cos(), angle.sin())
            });
            let is_aside = |place: &Vector2<f64>| {
                let gap =
                    path.windows(2).map(|pair| distance_to_line(*place, pair)).fold(f64::INFINITY, f64::min);
                gap >= room_m - Walker::DISTANCE_M && plan.clearance_m(*place) >= Person::RADIUS_M + 0.02
            };
            let places: Vec<Vector2<f64>> = around.collect();
            places.iter().find(|place| is_aside(place)).copied().or_else(|| {
                let roomy = |place: &&Vector2<f64>| plan.clearance_m(**place) >= Person::RADIUS_M + 0.02;
                let gap = |place: &Vector2<f64>| {
                    path.windows(2).map(|pair| distance_to_line(*place, pair)).fold(f64::INFINITY, f64::min)
                };
                places.iter().filter(roomy).max_by(|a, b| gap(a).total_cmp(&gap(b))).copied()
            })
        })
        .collect()
}

fn distance_to_line(point: Vector2<f64>, line: &[Vector2<f64>]) -> f64 {
    let from = line[0];
    let way = line[1] - from;
    let share = ((point - from).dot(&way) / way.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (from + way * share - point).norm()
}
