//! A simulated robot that drives as a server tells it.

pub(crate) mod by_looks;
pub(crate) mod mapping;

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::builder::{PossibleValuesParser, TypedValueParser};
use tokio::task::JoinHandle;
use tokio::time::MissedTickBehavior;
use waypost_client::{FrameContent, FrameInput, Navigation, NavigationEvent, Reading, v1};
use waypost_sim::drive::Building;
use waypost_sim::pose::Pose;
use waypost_sim::range_sensor::RangeScan;
use waypost_sim::render::{Mount, Shot};
use waypost_sim::robot::{Body, Command, OdometryReading, WheelErrors};
use waypost_sim::simulation::{CameraFrame, CameraTrigger, Obedience, Simulation, Tick};
use waypost_sim::worlds::NamedWorld;

use crate::failure::Failure;
use crate::panorama::camera_of;

/// How a robot that is led by looks turns to a heading: in 1/s and rad/s, and the heading from which it stands.
const TURN_PER_S: f64 = 1.8;
const MAX_TURN_RAD_S: f64 = 1.2;
const STOP_FROM_RAD: f64 = 0.8;
/// And how fast it drives where that is straight ahead, in m/s.
const AHEAD_M_S: f64 = 0.4;

/// Of 20 ms each.
const STEPS_PER_REPORT: usize = 2;

/// The world of that name with a way of that name, or its first; and the way's name.
pub(crate) fn building(
    world: NamedWorld,
    route: Option<&str>,
    seed: u64,
) -> Result<(Building, &'static str), Failure> {
    let routes = world.routes();
    let wanted = match route {
        Some(name) => routes.iter().find(|route| route.name == name),
        None => routes.first(),
    };
    let named = wanted.ok_or_else(|| {
        let routes = routes.iter().map(|route| route.name).collect::<Vec<_>>().join(", ");
        Failure::Unfit(format!("{} has no such route; there are {routes}", world.name()))
    })?;
    let building = Building::named(world, seed, named).map_err(unfit)?;
    Ok((building, named.name))
}

/// Names of buildings on the command line.
pub(crate) fn worlds() -> impl TypedValueParser<Value = NamedWorld> {
    let names = PossibleValuesParser::new(NamedWorld::ALL.map(NamedWorld::name));
    names.try_map(|name| NamedWorld::from_name(&name).ok_or("there is no such building"))
}

/// A robot at the way's start, whose wheels are as bad as the building's seed and another number say.
pub(crate) fn robot(
    building: &Building,
    seed: u64,
    number: u64,
    trigger: CameraTrigger,
) -> Result<Simulation, Failure> {
    let seed = seed.wrapping_add(number.wrapping_mul(1_000));
    building.robot(WheelErrors::drawn(seed), seed, trigger).map_err(unfit)
}

/// A map with the settings that it has by default.
pub(crate) fn new_map(map: &str, model: &str) -> v1::CreateMapRequest {
    v1::CreateMapRequest { map_id: map.to_owned(), model: model.to_owned(), settings: None }
}

/// What the camera takes, as JPEG.
pub(crate) fn jpeg(building: &Building, shot: &Shot) -> Result<Vec<u8>, Failure> {
    building.image(shot).to_jpeg().map_err(unfit)
}

/// What the robot's sessions declare of its camera.
pub(crate) fn camera(building: &Building) -> v1::Camera {
    let Mount { forward_m, height_m, yaw_rad } = *building.rig.mount();
    let camera = building.rig.camera();
    let size_px = (camera.width_px(), camera.height_px());
    if let Some(panorama) = camera.panorama() {
        return camera_of(panorama.into(), size_px);
    }
    let horizontal_rad = camera.field_of_view_rad();
    v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad })),
        image_width_px: Some(camera.width_px()),
        image_height_px: Some(camera.height_px()),
        base_to_camera: Some(pose_message([forward_m, 0.0, height_m], turned(yaw_rad))),
    }
}

/// What came of a drive that the server led.
pub(crate) struct LedDrive {
    /// Every step.
    pub(crate) ticks: Vec<Tick>,
    /// Frames that were answered, with where the robot really was at them.
    pub(crate) seen: Vec<(v1::FrameSeen, Pose)>,
}

/// An image that the camera took, on its way.
struct Developing {
    image: JoinHandle<Result<Vec<u8>, Failure>>,
    frame: CameraFrame,
}

/// When a drive that the server leads is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// When the robot has arrived; that takes no longer than this.
    OnArrival(Duration),
    /// Never by itself: goals come and go.
    Never,
}

/// Lets the robot drive as it is told, in real time; `on_seen` hears what its frames showed.
pub(crate) async fn drive(
    building: &Arc<Building>,
    robot: &mut Simulation,
    navigation: &mut Navigation,
    ending: Ending,
    mut on_seen: impl FnMut(&v1::FrameSeen, &Pose) -> Result<(), Failure>,
) -> Result<LedDrive, Failure> {
    let period = Duration::from_nanos(u64::try_from(robot.settings().period_ns).unwrap_or(u64::MAX));
    let mut steps = tokio::time::interval(period);
    steps.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let guidance = navigation.guidance();
    let began = Instant::now();
    let mut ticks = Vec::new();
    let mut steps_taken = 0_usize;
    let mut seen = Vec::new();
    let mut poses = BTreeMap::new();
    let mut developing: Option<Developing> = None;
    loop {
        steps.tick().await;
        let mut tick = step(building, robot, navigation, steps_taken.is_multiple_of(STEPS_PER_REPORT));
        steps_taken = steps_taken.wrapping_add(1);
        if let Some(frame) = tick.frame.take().filter(|_| developing.is_none()) {
            poses.insert(frame.number + 1, frame.shot.pose);
            let building = building.clone();
            let shot = frame.shot.clone();
            let image = tokio::task::spawn_blocking(move || jpeg(&building, &shot));
            developing = Some(Developing { image, frame });
        }
        ticks.push(tick);
        if let Some(Developing { image, frame }) = developing.take_if(|taken| taken.image.is_finished()) {
            navigation.see(frame_input(building, &frame, image.await.map_err(unfit)??));
        }
        while let Some(event) = navigation.try_next() {
            let Some(what) = shown(event)? else { continue };
            let Some(pose) = poses.remove(&what.sequence) else { continue };
            on_seen(&what, &pose)?;
            seen.push((what, pose));
        }
        let Ending::OnArrival(patience) = ending else {
            // A drive without an end is not kept.
            ticks.clear();
            seen.clear();
            continue;
        };
        let told = guidance.borrow().clone().unwrap_or_default();
        if told.status() == v1::NavigationStatus::Arrived {
            return Ok(LedDrive { ticks, seen });
        }
        if began.elapsed() > patience {
            return Err(Failure::Unfit(format!(
                "the robot has not arrived after {:.0} s; it is {:?}, with {:.1} m to go",
                patience.as_secs_f64(),
                told.status(),
                told.remaining_m.unwrap_or(f64::NAN)
            )));
        }
    }
}

/// A step as the last command says, and what the wheels say of it, if that is to be reported.
fn step(building: &Building, robot: &mut Simulation, navigation: &Navigation, report_is_due: bool) -> Tick {
    let is_led_by_looks = building.rig.camera().panorama().is_some();
    let told = navigation.command();
    let waypost_client::Command { forward_m_s, turn_rad_s } =
        if is_led_by_looks { past_corners(told, navigation, robot.scan()) } else { told };
    let valid_ns = 2 * robot.settings().period_ns;
    robot.command(Command { forward_m_s, turn_rad_s, valid_ns });
    let tick = robot.advance();
    if report_is_due {
        // Stamps begin above 0.
        let stamp_ns = tick.stamp_ns + 1;
        let reflex = tick.obedience == Obedience::Reflex;
        if is_led_by_looks {
            navigation.report_reflex(stamp_ns, reflex);
        } else {
            navigation.report(Reading { stamp_ns, odometry: odometry(&tick.odometry), reflex });
        }
    }
    tick
}

/// Turns the heading that was told to where the robot's own range sensor finds room: a camera sees past corners that a hull
/// does not get past. A stop stays one.
fn past_corners(
    told: waypost_client::Command,
    navigation: &Navigation,
    scan: &RangeScan,
) -> waypost_client::Command {
    let guidance = navigation.guidance();
    let heading_rad = guidance
        .borrow()
        .as_ref()
        .and_then(|guidance| guidance.appearance.as_ref())
        .and_then(|by_looks| by_looks.heading_rad);
    match heading_rad {
        Some(heading_rad) if told != waypost_client::Command::default() => {
            let free_rad = scan.free_heading_rad(heading_rad, Body::default().radius_m);
            waypost_client::Command {
                forward_m_s: AHEAD_M_S * (1.0 - free_rad.abs() / STOP_FROM_RAD).max(0.0),
                turn_rad_s: (TURN_PER_S * free_rad).clamp(-MAX_TURN_RAD_S, MAX_TURN_RAD_S),
            }
        }
        Some(_) | None => told,
    }
}

/// A frame as it goes to the server: with odometry, unless the robot goes by looks alone.
pub(crate) fn frame_input(building: &Building, frame: &CameraFrame, image: Vec<u8>) -> FrameInput {
    let goes_by_metres = building.rig.camera().panorama().is_none();
    FrameInput {
        sequence: frame.number + 1,
        stamp_ns: frame.stamp_ns + 1,
        content: FrameContent::Image(image),
        odometry: goes_by_metres.then(|| odometry(&frame.odometry)),
        note: String::new(),
    }
}

/// What a frame showed, if the event is of that; what was refused ends the drive.
fn shown(event: NavigationEvent) -> Result<Option<v1::FrameSeen>, Failure> {
    let refused = |what: &str, message: &str| Failure::Unfit(format!("a {what} was refused: {message}"));
    match event {
        NavigationEvent::Seen(seen) => Ok(Some(seen)),
        NavigationEvent::GoalRefused(refusal) => {
            Err(Failure::Unfit(refusal.status.unwrap_or_default().message))
        }
        NavigationEvent::FrameRefused(refusal) => {
            Err(refused("frame", &refusal.status.unwrap_or_default().message))
        }
        NavigationEvent::WheelsRefused(refusal) => {
            Err(refused("wheel report", &refusal.status.unwrap_or_default().message))
        }
        NavigationEvent::Disconnected { .. } | NavigationEvent::Reconnected { .. } => Ok(None),
    }
}

/// What the wheels say, as a frame carries it.
pub(crate) fn odometry(reading: &OdometryReading) -> v1::Odometry {
    let (position_m, orientation) = reading.position_and_orientation();
    v1::Odometry {
        pose: Some(pose_message(position_m, orientation)),
        covariance: reading.covariance_6x6().to_vec(),
    }
}

/// A pose on the ground, of a message that has one.
pub(crate) fn planar(message: &v1::Pose) -> Option<Pose> {
    let v1::Vector3 { x, y, .. } = message.position_m.as_ref()?;
    let v1::Quaternion { z, w, .. } = message.orientation.as_ref()?;
    Some(Pose::new(*x, *y, 2.0 * z.atan2(*w)))
}

/// For `map_err` of what the simulation refuses.
pub(crate) fn unfit(error: impl Display) -> Failure {
    Failure::Unfit(error.to_string())
}

fn turned(yaw_rad: f64) -> [f64; 4] {
    let (sin, cos) = (yaw_rad / 2.0).sin_cos();
    [0.0, 0.0, sin, cos]
}

fn pose_message([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> v1::Pose {
    v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: i, y: j, z: k, w }),
    }
}
