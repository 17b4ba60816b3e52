//! The drive that follows the map: robot, link and server, in simulated time.

mod stuck;

use std::f64::consts::PI;

use anyhow::Result;
use fabmap::model::Model;
use nalgebra::Vector2;
use posegraph::{PlanarPose, Pose as _};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use topomap::ids::FrameId;
use waypost_navigation::metric::settings::SupervisionSettings;
use waypost_navigation::metric::{
    Driver, Guidance, NavigationSettings, Seen, Sight, Status, VelocityCommand, WheelReport,
};
use waypost_sim::drive::{SPEED_M_S, TWICE_A_SECOND};
use waypost_sim::light::Light;
use waypost_sim::link::{Link, LinkSettings, Order};
use waypost_sim::pose::Pose;
use waypost_sim::robot::{Command, OdometryReading, WheelErrors};
use waypost_sim::simulation::{CameraFrame, Obedience, Simulation, SimulationSettings, Tick};
use waypost_vision::features::Extractor;

pub(super) use self::stuck::stuck;
pub(crate) use self::stuck::{StuckReport, StuckRun};
use super::guide::Guide;
use super::teaching::Taught;
use super::{Lighting, NavigateOptions, Trial};
use crate::commands::map::drive::{planar, sent_odometry};
use crate::commands::map::judgement::{FALSE_M, FALSE_RAD};
use crate::error::refused;

/// What the robot sees by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Vision {
    All,
    /// It is told where it is, and goes on by its wheels.
    OnlyBeforeStarting,
}

/// A drive as it was.
#[derive(Debug, Default)]
pub(super) struct Drive {
    /// Where the robot really was, step by step.
    pub(super) path: Vec<Vector2<f64>>,
    pub(super) collisions: u64,
    pub(super) status: Option<Status>,
    pub(super) end: [f64; 2],
    pub(super) end_heading_rad: f64,
    /// Where the robot was to look at the end, from how the place there was taught.
    pub(super) facing_rad: Option<f64>,
    pub(super) planned_m: Option<f64>,
    pub(super) looks: Vec<Looked>,
    /// Seconds in each status.
    pub(super) seconds_in: std::collections::BTreeMap<&'static str, f64>,
    pub(super) kidnapping: Option<Kidnapping>,
    pub(super) times_lost: u32,
}

/// A frame that was looked at, and what was true of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Looked {
    pub(super) position: Vector2<f64>,
    pub(super) seen: Seen,
    /// Of where the closure puts the robot from where it was: metres and radians.
    pub(super) apart: Option<(f64, f64)>,
    /// Whether the robot had started and was not lost.
    pub(super) on_the_way: bool,
    pub(super) recognised: Option<FrameId>,
}

/// What came of carrying the robot off.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Kidnapping {
    pub(super) at_s: f64,
    /// Seconds until the robot knew.
    pub(super) noticed_s: Option<f64>,
    /// Seconds until it knew where it was.
    pub(super) found_s: Option<f64>,
    /// What it turned on the spot for that, in radians.
    pub(super) turned_rad: f64,
    /// How far it drove before it knew, in metres.
    pub(super) driven_m: f64,
    /// Whether any belief after it, from the first one on, was of another place.
    pub(super) believed_elsewhere: u32,
}

const PERIOD_NS: i64 = 40_000_000;
/// What a server needs for a frame.
const COMPUTING_NS: i64 = 30_000_000;
/// Images of sparse drives, in metres and radians.
const SPARSE: (f64, f64) = (0.4, 0.35);

struct SentFrame {
    frame: CameraFrame,
    truth: PlanarPose,
}

struct SentWheels {
    stamp_ns: i64,
    reading: OdometryReading,
    obeyed: Option<u64>,
    driver: Driver,
}

/// Robot, link and server.
struct Course<'a> {
    options: &'a NavigateOptions,
    taught: &'a Taught,
    vision: Vision,
    simulation: Simulation,
    guide: Guide<'a>,
    frames: Link<SentFrame>,
    wheels: Link<SentWheels>,
    commands: Link<VelocityCommand>,
    obeyed: Option<u64>,
    last_sent: Option<OdometryReading>,
    status: Status,
    random: ChaCha8Rng,
    blind_from_ns: i64,
    kidnapped_at_m: f64,
    /// Speed ahead of the last command that the robot heard.
    told_m_s: f64,
    /// Whether all that it sees is a wall without anything on it.
    sees_bare_wall: bool,
    drive: Drive,
}

pub(super) fn repeat(
    options: &NavigateOptions,
    seed: u64,
    taught: &Taught,
    model: (&Model, Extractor),
    vision: Vision,
) -> Result<Drive> {
    let mut course = Course::new(options, seed, taught, model, vision)?;
    let limit_s = 120.0 + 3.0 * taught.length_m() / SPEED_M_S;
    let mut way_m = 0.0;
    loop {
        let tick = course.step()?;
        let position = tick.truth.position();
        if let Some(last) = course.drive.path.last() {
            way_m += (position - last).norm();
        }
        course.drive.path.push(position);
        course.kidnap(way_m, &tick)?;
        let given_up = tick.stamp_ns as f64 * 1e-9 > limit_s;
        let done = course.status == Status::Arrived || course.status == Status::Idle && way_m > 0.0;
        if given_up || done && course.simulation.robot().speed()[0].abs() < 1e-3 {
            break;
        }
    }
    let Course { mut drive, simulation, guide, status, .. } = course;
    let end = simulation.robot().pose();
    drive.collisions = simulation.collisions();
    drive.end_heading_rad = end.heading_rad;
    drive.status = Some(status);
    drive.end = [end.x_m, end.y_m];
    drive.planned_m = guide.planned_m;
    Ok(drive)
}

impl<'a> Course<'a> {
    fn new(
        options: &'a NavigateOptions,
        seed: u64,
        taught: &'a Taught,
        model: (&'a Model, Extractor),
        vision: Vision,
    ) -> Result<Self> {
        let wheels = WheelErrors::drawn(2 * seed + 1);
        let settings = SimulationSettings {
            wheels,
            seed: 2 * seed + 1,
            period_ns: PERIOD_NS,
            trigger: TWICE_A_SECOND,
            ..SimulationSettings::new(taught.building.rig.clone())
        };
        let mut simulation =
            Simulation::new(taught.drive.scene.clone(), taught.building.route.start(), settings)?;
        let conditions = &options.conditions;
        match conditions.lighting {
            Lighting::AsTaught => {}
            Lighting::Another => simulation.set_light(Light::drawn(seed)),
        }
        for (person, behaviour) in taught.people_beside(conditions.people) {
            simulation.add_person(person, behaviour)?;
        }
        let ns = |seconds: f64| (seconds * 1e9) as i64;
        let link = LinkSettings {
            latency_ns: ns(conditions.delay_s),
            jitter_ns: ns(conditions.jitter_s),
            loss: 0.0,
            order: Order::AsSent,
        };
        let of_frames =
            LinkSettings { latency_ns: link.latency_ns + COMPUTING_NS, loss: conditions.drop, ..link };
        let navigation = match vision {
            Vision::All => NavigationSettings::default(),
            Vision::OnlyBeforeStarting => unsupervised(NavigationSettings::default()),
        };
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let expected_s = taught.length_m() / SPEED_M_S;
        let blind_from_ns = ns(expected_s * random.random_range(0.15..0.75));
        let kidnapped_at_m = taught.length_m() * random.random_range(0.2..0.7);
        let facing_rad = match options.trial {
            Trial::Facing => Some(random.random_range(-PI..PI)),
            Trial::Repeat | Trial::Shortcut | Trial::Sparse | Trial::Kidnapped | Trial::Stuck => None,
        };
        Ok(Self {
            options,
            taught,
            vision,
            simulation,
            guide: Guide::new(taught, model, navigation, facing_rad)?,
            frames: Link::new(of_frames, 4 * seed).map_err(refused)?,
            wheels: Link::new(link, 4 * seed + 1).map_err(refused)?,
            commands: Link::new(link, 4 * seed + 2).map_err(refused)?,
            obeyed: None,
            last_sent: None,
            status: Status::Idle,
            random,
            blind_from_ns,
            kidnapped_at_m,
            told_m_s: 0.0,
            sees_bare_wall: false,
            drive: Drive { facing_rad, ..Drive::default() },
        })
    }

    /// A period passes: the robot moves and sends, the server answers, the robot hears.
    fn step(&mut self) -> Result<Tick> {
        let mut tick = self.simulation.advance();
        let now_ns = tick.stamp_ns;
        let driver = match tick.obedience {
            Obedience::Commanded | Obedience::Idle => Driver::Commands,
            Obedience::Reflex => Driver::Reflex,
        };
        let wheels = SentWheels { stamp_ns: now_ns, reading: tick.odometry, obeyed: self.obeyed, driver };
        self.wheels.send(now_ns, wheels);
        if let Some(frame) = tick.frame.take().filter(|frame| self.is_sent(frame)) {
            self.last_sent = Some(frame.odometry);
            self.frames.send(now_ns, SentFrame { frame, truth: planar(&tick.truth) });
        }
        while let Some((_, SentFrame { frame, truth })) = self.frames.receive(now_ns) {
            self.look(&frame, &truth)?;
        }
        while let Some((_, wheels)) = self.wheels.receive(now_ns) {
            let SentWheels { stamp_ns, reading, obeyed, driver } = wheels;
            let report = WheelReport { stamp_ns, odometry: sent_odometry(&reading)?, obeyed, driver };
            let guidance = self.guide.drive(&report)?;
            self.note(&guidance);
            self.commands.send(now_ns, guidance.command);
        }
        while let Some((_, command)) = self.commands.receive(now_ns) {
            let VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns } = command;
            self.simulation.command(Command { forward_m_s, turn_rad_s, valid_ns });
            (self.obeyed, self.told_m_s) = (Some(number), forward_m_s);
        }
        Ok(tick)
    }

    /// Whether the robot sends a frame, or has it to send.
    fn is_sent(&self, frame: &CameraFrame) -> bool {
        let blind_until_ns = self.blind_from_ns + (self.options.conditions.blind_s * 1e9) as i64;
        let dark = (self.blind_from_ns..blind_until_ns).contains(&frame.stamp_ns);
        let unwanted = self.vision == Vision::OnlyBeforeStarting && self.has_started();
        let dense = match (self.options.trial, &self.last_sent) {
            (Trial::Sparse, Some(last)) if self.has_started() && self.status != Status::Lost => {
                let moved = last.pose.relative(&frame.odometry.pose);
                moved.position().norm() >= SPARSE.0 || moved.heading_rad.abs() >= SPARSE.1
            }
            (
                Trial::Repeat
                | Trial::Shortcut
                | Trial::Sparse
                | Trial::Kidnapped
                | Trial::Facing
                | Trial::Stuck,
                Some(_) | None,
            ) => true,
        };
        !dark && !unwanted && dense
    }

    fn has_started(&self) -> bool {
        self.guide.planned_m.is_some()
    }

    fn look(&mut self, frame: &CameraFrame, truth: &PlanarPose) -> Result<()> {
        let on_the_way = self.has_started() && self.status != Status::Lost;
        let (look, seen) = {
            let odometry = sent_odometry(&frame.odometry)?;
            let image =
                if self.sees_bare_wall { stuck::bare_wall()? } else { self.taught.image(&frame.shot)? };
            self.guide.see(frame.stamp_ns, odometry, &image)?
        };
        let closure = match look.sight {
            Sight::Closure(closure) => Some(closure),
            Sight::Unknown | Sight::TooLittle => None,
        };
        let apart = closure.and_then(|closure| {
            let said = self.taught.truth(closure.frame)?.compose(&closure.from_view);
            let apart = said.inverse().compose(truth);
            Some((apart.x_m().hypot(apart.y_m()), apart.heading_rad().abs()))
        });
        let recognised = closure.map(|closure| closure.frame);
        let position = Vector2::new(truth.x_m(), truth.y_m());
        self.drive.looks.push(Looked { position, seen, apart, on_the_way, recognised });
        self.judge_kidnapping(frame.stamp_ns, seen);
        Ok(())
    }

    fn judge_kidnapping(&mut self, stamp_ns: i64, seen: Seen) {
        let robot = planar(self.simulation.robot().pose());
        let believed = self.guide.believed().and_then(|(place, from_place)| {
            let apart = self.taught.truth_of_place(place)?.compose(&from_place).inverse().compose(&robot);
            Some((apart.x_m().hypot(apart.y_m()), apart.heading_rad().abs()))
        });
        let Some(kidnapping) = &mut self.drive.kidnapping else { return };
        let seconds = stamp_ns as f64 * 1e-9;
        if seconds <= kidnapping.at_s {
            return;
        }
        let elsewhere = believed.is_some_and(|(metres, radians)| metres > FALSE_M || radians > FALSE_RAD);
        match seen {
            Seen::Corrected | Seen::Found if elsewhere => kidnapping.believed_elsewhere += 1,
            Seen::Corrected | Seen::Found => {
                kidnapping.found_s.get_or_insert(seconds - kidnapping.at_s);
            }
            Seen::Unconfirmed | Seen::Kidnapped | Seen::Stale | Seen::Nothing => {}
        }
    }

    fn note(&mut self, guidance: &Guidance) {
        if guidance.status == Status::Lost && self.status != Status::Lost {
            self.drive.times_lost += 1;
        }
        self.status = guidance.status;
        *self.drive.seconds_in.entry(name(guidance.status)).or_insert(0.0) += PERIOD_NS as f64 * 1e-9;
        let now_s = self.simulation.now_ns() as f64 * 1e-9;
        let [forward_m_s, turn_rad_s] = self.simulation.robot().speed();
        if let Some(kidnapping) = self.drive.kidnapping.as_mut().filter(|carried| carried.found_s.is_none()) {
            match (guidance.status, kidnapping.noticed_s) {
                (Status::Lost, None) => kidnapping.noticed_s = Some(now_s - kidnapping.at_s),
                (_, None) => kidnapping.driven_m += forward_m_s.abs() * PERIOD_NS as f64 * 1e-9,
                (Status::Lost, Some(_)) => {
                    kidnapping.turned_rad += turn_rad_s.abs() * PERIOD_NS as f64 * 1e-9;
                }
                (_, Some(_)) => {}
            }
        }
    }

    /// Carries the robot to another part of the way, looking anywhere.
    fn kidnap(&mut self, way_m: f64, tick: &Tick) -> Result<()> {
        let is_due = self.options.trial == Trial::Kidnapped && way_m >= self.kidnapped_at_m;
        if !is_due || self.drive.kidnapping.is_some() {
            return Ok(());
        }
        let ticks = &self.taught.drive.recording.ticks;
        loop {
            let there = ticks[self.random.random_range(0..ticks.len())].truth;
            let heading_rad = self.random.random_range(-PI..PI);
            if there.distance_m(&tick.truth) >= 4.0 {
                self.simulation.kidnap(Pose { heading_rad, ..there })?;
                break;
            }
        }
        let at_s = tick.stamp_ns as f64 * 1e-9;
        self.drive.kidnapping = Some(Kidnapping { at_s, ..Kidnapping::default() });
        Ok(())
    }
}

/// It never gives up, however unsure it is.
fn unsupervised(settings: NavigationSettings) -> NavigationSettings {
    let supervision = SupervisionSettings { lost_sigma_m: 1000.0, lost_m: 1e6, ..settings.supervision };
    NavigationSettings { supervision, ..settings }
}

pub(super) fn name(status: Status) -> &'static str {
    match status {
        Status::Idle => "idle",
        Status::Following => "following",
        Status::Searching => "searching",
        Status::Lost => "lost",
        Status::Arrived => "arrived",
        Status::Blocked => "blocked",
    }
}
