//! A simulated robot is taught a way, and drives it again as the server says.

use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use waypost_client::{Client, NavigationOptions, v1};
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::drive::{Building, SPEED_M_S as TEACHING_SPEED_M_S, TWICE_A_SECOND, WHEN_MOVED};
use waypost_sim::pose::Pose;
use waypost_sim::simulation::Recording;
use waypost_sim::worlds::NamedWorld;

use crate::failure::Failure;
use crate::output::Output;
use crate::simulated::mapping::map_along;
use crate::simulated::{Ending, LedDrive, building, camera, drive, new_map, robot, unfit};

const WORLD: NamedWorld = NamedWorld::Office;
const ROUTE: &str = "teach";
const SEED: u64 = 1;
const MAP: &str = "taught";
const SESSION: &str = "teaching";
const ROBOT: &str = "robot";
const SPEED_M_S: f64 = 0.5;
/// The way takes a minute.
const PATIENCE: Duration = Duration::from_secs(150);

/// What `--json` prints of it.
#[derive(Serialize)]
pub(super) struct Repeated {
    taught_m: f64,
    driven_m: f64,
    seconds: f64,
    collisions: u64,
    frames: usize,
    recognised: Vec<Recognised>,
    /// From the true way that was taught, root mean square and most.
    off_the_way_m: f64,
    most_off_the_way_m: f64,
    /// How far its wheels alone would have put it beside the goal.
    wheels_error_m: f64,
    goal_error_m: f64,
    picture: String,
}

/// A frame by which the robot knew where it was.
#[derive(Serialize)]
struct Recognised {
    frame: u64,
    place: u32,
    probability: Option<f64>,
    off_the_way_m: f64,
}

/// Teaches and repeats, and draws it into `picture`.
pub(super) async fn run(
    client: &Client,
    model: &str,
    picture: &Path,
    output: Output,
) -> Result<Repeated, Failure> {
    let (building, _) = building(WORLD, Some(ROUTE), SEED)?;
    let building = Arc::new(building);
    output
        .line(format_args!("\na simulated robot is taught the way {ROUTE} through the {}", WORLD.name()))?;
    let mut teacher = robot(&building, SEED, 0, WHEN_MOVED)?;
    let taught = teacher.drive_along(&building.route, TEACHING_SPEED_M_S).map_err(unfit)?;
    client.create_map(new_map(MAP, model)).await?;
    let mapped = map_along(client, MAP, SESSION, &building, &taught, output).await?;

    let goal = v1::goal::Target::PlaceNumber(u32::try_from(mapped.map.places.saturating_sub(1)).unwrap_or(0));
    let goal = Some(v1::Goal { target: Some(goal) });
    let driving = v1::DrivingSettings { speed_m_s: Some(SPEED_M_S), ..v1::DrivingSettings::default() };
    let options = NavigationOptions {
        navigation_id: ROBOT.to_owned(),
        goal,
        driving,
        ..NavigationOptions::new(MAP, camera(&building))
    };
    let mut navigation = client.navigate(options).await?;
    output.line(format_args!(
        "\nand drives it again, with other wheels, as {} says\n",
        navigation.opened().navigation
    ))?;
    let mut robot = robot(&building, SEED, 1, TWICE_A_SECOND)?;
    let began = Instant::now();
    let led = drive(&building, &mut robot, &mut navigation, Ending::OnArrival(PATIENCE), |seen, pose| {
        let Some(place) = seen.place_number else { return Ok(()) };
        let off_m = off_the_way_m(&taught, pose);
        let sure = seen.probability.unwrap_or_default();
        output.line(format_args!(
            "frame {:3} shows place {place:3}, probability {sure:.3}; truth: {off_m:.2} m off the way",
            seen.sequence
        ))
    })
    .await?;
    let seconds = began.elapsed().as_secs_f64();
    let svg = plan_svg(building.scene.plan(), &layers(&building, &taught, &led));
    std::fs::write(picture, svg).map_err(Failure::file("write", picture))?;
    Ok(judged(&building, &taught, &led, seconds, robot.collisions(), picture))
}

fn judged(
    building: &Building,
    taught: &Recording,
    led: &LedDrive,
    seconds: f64,
    collisions: u64,
    picture: &Path,
) -> Repeated {
    let off: Vec<f64> = led.ticks.iter().map(|tick| off_the_way_m(taught, &tick.truth)).collect();
    let squares: f64 = off.iter().map(|off_m| off_m * off_m).sum();
    let end = led.ticks.last();
    let by_wheels =
        |tick: &waypost_sim::simulation::Tick| building.route.start().compose(&tick.odometry.pose);
    let goal = taught.ticks.last().map(|tick| tick.truth);
    let recognised = led.seen.iter().filter_map(|(seen, pose)| {
        let place = seen.place_number?;
        let probability = seen.probability;
        Some(Recognised {
            frame: seen.sequence,
            place,
            probability,
            off_the_way_m: off_the_way_m(taught, pose),
        })
    });
    Repeated {
        taught_m: taught.length_m(),
        driven_m: led.ticks.windows(2).map(|pair| pair[0].truth.distance_m(&pair[1].truth)).sum(),
        seconds,
        collisions,
        frames: led.seen.len(),
        recognised: recognised.collect(),
        off_the_way_m: (squares / off.len().max(1) as f64).sqrt(),
        most_off_the_way_m: off.iter().copied().fold(0.0, f64::max),
        wheels_error_m: end.map_or(0.0, |tick| by_wheels(tick).distance_m(&tick.truth)),
        goal_error_m: end.zip(goal).map_or(0.0, |(tick, goal)| tick.truth.distance_m(&goal)),
        picture: picture.to_string_lossy().into_owned(),
    }
}

fn off_the_way_m(taught: &Recording, pose: &Pose) -> f64 {
    taught.ticks.iter().map(|tick| tick.truth.distance_m(pose)).fold(f64::INFINITY, f64::min)
}

fn layers(building: &Building, taught: &Recording, led: &LedDrive) -> Vec<Layer> {
    let start = building.route.start();
    let wheels = led.ticks.iter().map(|tick| start.compose(&tick.odometry.pose).position()).collect();
    let recognised = led.seen.iter().filter(|(seen, _)| seen.place_number.is_some());
    [
        ("taught", "#1459aa", Marks::Path(taught.ticks.iter().map(|tick| tick.truth.position()).collect())),
        ("driven, as its wheels saw it", "#e0a040", Marks::Path(wheels)),
        ("driven", "#208050", Marks::Path(led.ticks.iter().map(|tick| tick.truth.position()).collect())),
        (
            "a place was recognised",
            "#d01020",
            Marks::Dots(recognised.map(|(_, pose)| pose.position()).collect()),
        ),
    ]
    .map(|(name, colour, marks)| Layer { name: name.to_owned(), colour: colour.to_owned(), marks })
    .to_vec()
}

pub(super) fn write(repeated: &Repeated, out: &mut dyn Write) -> io::Result<()> {
    let Repeated { taught_m, driven_m, seconds, collisions, frames, recognised, off_the_way_m, .. } =
        repeated;
    let Repeated { most_off_the_way_m, wheels_error_m, goal_error_m, picture, .. } = repeated;
    writeln!(out)?;
    writeln!(
        out,
        "taught and driven again   {taught_m:7.2} m, {driven_m:.2} m in {seconds:.0} s, {collisions} collisions"
    )?;
    writeln!(out, "frames that showed a place  {:5} of {frames}", recognised.len())?;
    writeln!(
        out,
        "off the way taught        {off_the_way_m:7.2} m (root mean square), at most {most_off_the_way_m:.2} m"
    )?;
    writeln!(
        out,
        "beside the goal           {goal_error_m:7.2} m; by its wheels it is {wheels_error_m:.2} m elsewhere"
    )?;
    writeln!(out, "drawn in                    {picture}")
}
