//! A robot with wheels and a camera that drives rounds, and maps them.

use std::f64::consts::{FRAC_PI_2, TAU};

use crate::words::{WORDS, model_of, view_of};
use fabmap::model::Model;
use fabmap::observation::Observation;
use nalgebra::Matrix3;
use posegraph::{PlanarPose, Pose};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use topomap::evidence::{Placement, Similarity, TwoView, ViewMotion};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{FrameInput, Localizer, Mapper, MeasureError, Measurement};
use topomap::metric::{Odometry, RelativePose};
use topomap::settings::MapperSettings;

pub(crate) const FOCAL_LENGTH_WIDTHS: f64 = 0.8;

/// A robot that drives on a plane, its wheels, and a camera that sees words by where it is.
pub(crate) struct Robot {
    pub(crate) mapper: Mapper,
    pub(crate) log: Vec<MapEvent>,
    /// True pose of each event's frame; anything for openings.
    pub(crate) truth: Vec<PlanarPose>,
    pub(crate) pose: PlanarPose,
    /// What the wheels believe.
    pub(crate) odometry: PlanarPose,
    /// Of the wheels: share of each distance, and radians per metre.
    pub(crate) bias: [f64; 2],
    pub(crate) session: u32,
    pub(crate) sequence: u64,
}

/// What the camera sees of earlier frames.
pub(crate) struct Camera<'a> {
    pub(crate) robot: &'a Robot,
    pub(crate) model: CameraModel,
}

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum CameraModel {
    Known,
    Unknown,
}

impl Views for Camera<'_> {
    /// Near frames look alike, shifted by the turn between them.
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let apart = self.robot.truth[earlier as usize].inverse().compose(&self.robot.pose);
        let near = apart.x_m().hypot(apart.y_m()) < 0.6 && apart.heading_rad().abs() < 0.4;
        let shift = FOCAL_LENGTH_WIDTHS * apart.heading_rad().tan();
        let motion =
            Similarity { rotation_rad: 0.0, ln_scale: 0.05 * apart.x_m(), translation_widths: [shift, 0.0] };
        let inliers = if near { 450 } else { 3 };
        let motion = near.then_some(ViewMotion::Similarity(motion));
        let placement = Placement::Unknown;
        Some(TwoView { matches: 500, inliers, distinct_inliers: inliers, motion, placement })
    }

    fn focal_length_widths(&self) -> Option<f64> {
        (self.model == CameraModel::Known).then_some(FOCAL_LENGTH_WIDTHS)
    }
}

impl Robot {
    pub(crate) fn new(settings: MapperSettings, bias: [f64; 2]) -> Self {
        let mut robot = Self {
            mapper: Mapper::new(&model(), settings).unwrap(),
            log: Vec::new(),
            truth: Vec::new(),
            pose: PlanarPose::identity(),
            odometry: PlanarPose::identity(),
            bias,
            session: 0,
            sequence: 0,
        };
        robot.begin();
        robot
    }

    /// Begins a session where the robot stands.
    pub(crate) fn begin(&mut self) {
        self.session = self.mapper.map().next_session();
        self.odometry = PlanarPose::identity();
        let event = MapEvent::SessionOpened { session: self.session };
        self.mapper.apply(&event).unwrap();
        self.log.push(event);
        self.truth.push(self.pose);
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
        let motion = PlanarPose::new(distance_m, 0.0, turn_rad);
        self.pose = self.pose.compose(&motion);
        let [share, drift] = self.bias;
        let felt = PlanarPose::new(distance_m * (1.0 + share), 0.0, turn_rad + drift * distance_m.abs());
        self.odometry = self.odometry.compose(&felt);
    }

    pub(crate) fn input(&mut self) -> FrameInput {
        self.sequence += 1;
        let ground = self.odometry.on_the_ground();
        let (position, rotation) = (ground.translation, ground.rotation.coords);
        let odometry = Odometry::new(
            [position.x, position.y, 0.0],
            [rotation.x, rotation.y, rotation.z, rotation.w],
            None,
        );
        FrameInput {
            session: self.session,
            sequence: self.sequence,
            stamp_ns: self.sequence as i64 * 1_000_000_000,
            odometry: Some(odometry.unwrap()),
            observation: view(&self.pose, self.sequence),
        }
    }

    pub(crate) fn see(&mut self) -> FrameEvent {
        let input = self.input();
        self.take(input, CameraModel::Known)
    }

    pub(crate) fn take(&mut self, input: FrameInput, model: CameraModel) -> FrameEvent {
        let decided =
            in_memory::decide(&self.mapper, &self.log, input, &Camera { robot: self, model }, &mut ())
                .unwrap();
        let event = MapEvent::Frame(Box::new(decided.event.clone()));
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(stored, event);
        self.mapper.apply(&stored).unwrap();
        self.log.push(stored);
        self.truth.push(self.pose);
        decided.event
    }

    /// What a robot that only looks is told where this one is.
    pub(crate) fn localize(&self, localizer: &Localizer, input: FrameInput) -> FrameEvent {
        let camera = Camera { robot: self, model: CameraModel::Known };
        in_memory::localize(&self.mapper, localizer, &self.log, input, &camera).unwrap().event
    }

    /// The robot measures where it was at a frame, seen from an earlier one; wrong by `wrong`.
    pub(crate) fn measure(
        &mut self,
        later: FrameId,
        earlier: FrameId,
        wrong: &PlanarPose,
    ) -> Result<(), MeasureError> {
        self.measure_within(0.01, later, earlier, wrong)
    }

    /// The same, known to within `sigma`, in metres and radians.
    pub(crate) fn measure_within(
        &mut self,
        sigma: f64,
        later: FrameId,
        earlier: FrameId,
        wrong: &PlanarPose,
    ) -> Result<(), MeasureError> {
        let pose = self.truth[earlier as usize].inverse().compose(&self.truth[later as usize]).compose(wrong);
        let pose = RelativePose::new(pose, Matrix3::identity() * (sigma * sigma)).unwrap();
        let before = self.log[..later as usize].iter().rev().find_map(|event| match event {
            MapEvent::Frame(event) if event.session == self.event(later).session => Some(event.as_ref()),
            MapEvent::Frame(_)
            | MapEvent::SessionOpened { .. }
            | MapEvent::Measured(_)
            | MapEvent::Corrected(_) => None,
        });
        let (later, earlier) = (self.event(later), self.event(earlier));
        let event = self.mapper.measure(&Measurement { later, before, earlier, pose })?;
        let event = MapEvent::Measured(Box::new(event));
        let stored = MapEvent::from_bytes(&event.to_bytes(), WORDS as usize).unwrap();
        assert_eq!(stored, event);
        self.mapper.apply(&stored).unwrap();
        self.log.push(stored);
        self.truth.push(self.pose);
        Ok(())
    }

    /// Where the map puts the robot.
    pub(crate) fn on_the_map(&self) -> PlanarPose {
        self.mapper.map_pose(self.mapper.map().session(self.session).unwrap()).unwrap().robot
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

pub(crate) fn model() -> Model {
    let far = |place: u64| view(&PlanarPose::new(1e3 + place as f64, -1e3, 0.0), place);
    model_of((0..200).map(far).collect(), WORDS)
}

/// A round of 4 m a side, in steps of 0.4 m.
pub(crate) fn round(robot: &mut Robot) -> Vec<FrameEvent> {
    let mut events = Vec::new();
    for _ in 0..4 {
        for _ in 0..10 {
            robot.go(0.4, 0.0);
            events.push(robot.see());
        }
        for _ in 0..6 {
            robot.go(0.0, FRAC_PI_2 / 6.0);
            events.push(robot.see());
        }
    }
    events
}

pub(crate) fn apart_m(a: &PlanarPose, b: &PlanarPose) -> f64 {
    (a.x_m() - b.x_m()).hypot(a.y_m() - b.y_m())
}
