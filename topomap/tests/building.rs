//! Robots that drive through a building that words tell apart, and map it.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, TAU};

use crate::words::{self, view_of};
use fabmap::model::Model;
use fabmap::observation::Observation;
use posegraph::{PlanarPose, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, Similarity, TwoView, ViewMotion};
use topomap::ids::{FrameId, SessionId};
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{FrameInput, Mapper};
use topomap::merging::{
    KnownMap, Layout, MergePlan, MergeSettings, PairComparison, PlaceMatch, PlacePair, Verdict, find_matches,
    join, judge, pairs_to_compare,
};
use topomap::metric::Odometry;
use topomap::settings::MapperSettings;

pub(crate) use crate::words::WORDS;

pub(crate) const FOCAL_LENGTH_WIDTHS: f64 = 0.8;

/// What stands where: a pose of the building to one that looks the same.
pub(crate) type Looks = fn(&PlanarPose) -> PlanarPose;

/// A building in which nothing looks like anything else.
pub(crate) fn unique(pose: &PlanarPose) -> PlanarPose {
    *pose
}

/// A corridor that looks like its first metre once more, so many metres further on.
pub(crate) fn again_after<const METRES: u32>(pose: &PlanarPose) -> PlanarPose {
    let metres = f64::from(METRES);
    let there = (metres - 0.1..metres + 1.5).contains(&pose.x_m()) && pose.y_m().abs() < 0.5;
    PlanarPose::new(pose.x_m() - if there { metres } else { 0.0 }, pose.y_m(), pose.heading_rad())
}

/// A map, and where the robots that made it truly were.
#[derive(Clone)]
pub(crate) struct Robot {
    pub(crate) mapper: Mapper,
    pub(crate) log: Vec<MapEvent>,
    /// Of each event's frame, in the building; anything for openings.
    pub(crate) truth: Vec<PlanarPose>,
    pub(crate) looks: Looks,
    /// Who drives.
    pub(crate) session: SessionId,
    pub(crate) runs: BTreeMap<SessionId, Run>,
    sequence: u64,
}

/// A robot that drives.
#[derive(Clone)]
pub(crate) struct Run {
    pose: PlanarPose,
    /// Where its wheels put it, if it has any that are read.
    pub(crate) odometry: Option<PlanarPose>,
    /// Share of each distance, and radians a metre, that wheels are wrong by.
    bias: [f64; 2],
}

pub(crate) fn seen(looks: Looks, earlier: &PlanarPose, current: &PlanarPose) -> TwoView {
    let apart = looks(earlier).inverse().compose(&looks(current));
    let near = apart.x_m().hypot(apart.y_m()) < 0.6 && apart.heading_rad().abs() < 0.4;
    let shift = FOCAL_LENGTH_WIDTHS * apart.heading_rad().tan();
    let motion =
        Similarity { rotation_rad: 0.0, ln_scale: 0.05 * apart.x_m(), translation_widths: [shift, 0.0] };
    let inliers = if near { 120 } else { 3 };
    let motion = near.then_some(ViewMotion::Similarity(motion));
    TwoView { matches: 500, inliers, distinct_inliers: inliers, motion, placement: Placement::Unknown }
}

impl Views for Robot {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        Some(seen(self.looks, &self.truth[earlier as usize], &self.runs[&self.session].pose))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(FOCAL_LENGTH_WIDTHS)
    }
}

impl Robot {
    pub(crate) fn new(looks: Looks, pose: PlanarPose, bias: [f64; 2]) -> Self {
        let mapper = Mapper::new(&model(), MapperSettings::default()).unwrap();
        let (log, truth, runs) = (Vec::new(), Vec::new(), BTreeMap::new());
        let mut robot = Self { mapper, log, truth, looks, session: 0, runs, sequence: 0 };
        robot.begin(pose, bias);
        robot
    }

    /// Another robot drives from here.
    pub(crate) fn begin(&mut self, pose: PlanarPose, bias: [f64; 2]) {
        self.session = self.mapper.map().next_session();
        self.runs.insert(self.session, Run { pose, odometry: Some(PlanarPose::new(3.0, -7.0, 1.0)), bias });
        self.take(MapEvent::SessionOpened { session: self.session }, pose);
    }

    pub(crate) fn take(&mut self, event: MapEvent, truth: PlanarPose) {
        self.mapper.apply(&event).unwrap();
        self.log.push(event);
        self.truth.push(truth);
    }

    pub(crate) fn event(&self, frame: FrameId) -> &FrameEvent {
        match &self.log[frame as usize] {
            MapEvent::Frame(event) => event,
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => {
                panic!("{frame} is no frame")
            }
        }
    }

    pub(crate) fn go(&mut self, distance_m: f64, turn_rad: f64) {
        let run = self.runs.get_mut(&self.session).unwrap();
        run.pose = run.pose.compose(&PlanarPose::new(distance_m, 0.0, turn_rad));
        let [share, drift] = run.bias;
        let felt = PlanarPose::new(distance_m * (1.0 + share), 0.0, turn_rad + drift * distance_m);
        run.odometry = run.odometry.map(|odometry| odometry.compose(&felt));
        self.see();
    }

    /// What it sees next.
    pub(crate) fn input(&self) -> FrameInput {
        let Run { pose, odometry, .. } = self.runs[&self.session].clone();
        let on_the_ground = |odometry: PlanarPose| {
            let ground = odometry.on_the_ground();
            let (position, rotation) = (ground.translation, ground.rotation.coords);
            let orientation = [rotation.x, rotation.y, rotation.z, rotation.w];
            Odometry::new([position.x, position.y, 0.0], orientation, None).unwrap()
        };
        let sequence = self.sequence + 1;
        FrameInput {
            session: self.session,
            sequence,
            stamp_ns: sequence as i64 * 1_000_000_000,
            odometry: odometry.map(on_the_ground),
            observation: view(&(self.looks)(&pose), sequence),
        }
    }

    pub(crate) fn see(&mut self) {
        let pose = self.runs[&self.session].pose;
        let input = self.input();
        self.sequence = input.sequence;
        let event = in_memory::decide(&self.mapper, &self.log, input, self, &mut ()).unwrap().event;
        self.take(MapEvent::Frame(Box::new(event)), pose);
    }

    pub(crate) fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, log: &self.log }
    }

    pub(crate) fn layout(&self) -> Layout<'_> {
        let settings = self.mapper.settings();
        Layout { poses: self.mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
    }

    /// The target after the source has joined it.
    pub(crate) fn joined_by(&self, source: &Robot, plan: &MergePlan) -> Robot {
        let mut joined = self.clone();
        for event in join((&source.mapper, &self.mapper), plan, &source.log).unwrap() {
            let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
            assert_eq!(stored, event);
            joined.mapper.fold(&stored).unwrap();
            joined.log.push(stored);
        }
        joined.mapper.relax();
        joined.truth.extend(&source.truth);
        joined
    }
}

/// What is seen from a cell of 0.4 m and 30 degrees, and of its neighbours.
pub(crate) fn view(pose: &PlanarPose, noise: u64) -> Observation {
    let mut noise = ChaCha8Rng::seed_from_u64(noise);
    let cell = |value: f64, side: f64| (value / side).round() as i64;
    let sector = cell(pose.heading_rad(), TAU / 12.0).rem_euclid(12);
    let seed = (cell(pose.x_m(), 0.4) * 1_000 + cell(pose.y_m(), 0.4)) * 100 + sector;
    view_of(seed as u64, 0.85, 5, &mut noise)
}

pub(crate) fn model_of(words: u32) -> Model {
    let image = |seed: u64| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let seen: Vec<u32> = (0..40).map(|_| random.random_range(0..words)).collect();
        Observation::from_words(seen, words as usize).unwrap()
    };
    words::model_of((0..200).map(image).collect(), words)
}

pub(crate) fn model() -> Model {
    model_of(WORDS)
}

pub(crate) const STEP_M: f64 = 0.6;

pub(crate) fn ahead(robot: &mut Robot, steps: usize) {
    (0..steps).for_each(|_| robot.go(STEP_M, 0.0));
}

pub(crate) fn turn_left(robot: &mut Robot) {
    (0..6).for_each(|_| robot.go(0.0, FRAC_PI_2 / 6.0));
}

/// Along a corridor of 18 m, and on round its corner.
pub(crate) fn first(looks: Looks) -> Robot {
    let mut robot = Robot::new(looks, PlanarPose::new(0.1, 0.0, 0.0), [0.01, 0.003]);
    ahead(&mut robot, 30);
    turn_left(&mut robot);
    ahead(&mut robot, 10);
    robot
}

/// Out of a side corridor, along the last half of it, round the corner and further.
pub(crate) fn second(looks: Looks) -> Robot {
    let mut robot = Robot::new(looks, PlanarPose::new(9.2, 6.0, -FRAC_PI_2), [-0.01, -0.003]);
    ahead(&mut robot, 10);
    turn_left(&mut robot);
    ahead(&mut robot, 15);
    turn_left(&mut robot);
    ahead(&mut robot, 16);
    robot
}

/// The views of two maps; buildings look as the source's does.
fn compared(source: &Robot, target: &Robot, pair: &PlacePair) -> PairComparison {
    let current = (source.looks)(&source.truth[pair.source_frame as usize]);
    let earlier = (target.looks)(&target.truth[pair.target_frame as usize]);
    let view = Some(seen(unique, &earlier, &current));
    PairComparison { view, focal_length_widths: Some(FOCAL_LENGTH_WIDTHS) }
}

pub(crate) fn matches(source: &Robot, target: &Robot) -> Vec<PlaceMatch> {
    let settings = MergeSettings::default();
    let pairs = pairs_to_compare(source.known(), target.known(), &settings, &()).unwrap();
    let comparisons: Vec<PairComparison> = pairs.iter().map(|pair| compared(source, target, pair)).collect();
    find_matches(source.known(), target.known(), &pairs, &comparisons, &settings)
}

pub(crate) fn judged(source: &Robot, target: &Robot, matches: &[PlaceMatch]) -> Verdict {
    judge(source.layout(), target.layout(), matches, &MergeSettings::default())
}

pub(crate) fn plan(source: &Robot, target: &Robot) -> MergePlan {
    match judged(source, target, &matches(source, target)) {
        Verdict::Overlap(plan) => plan,
        Verdict::Apart(apart) => panic!("{apart}"),
    }
}

pub(crate) fn apart_m(a: &PlanarPose, b: &PlanarPose) -> f64 {
    (a.x_m() - b.x_m()).hypot(a.y_m() - b.y_m())
}
