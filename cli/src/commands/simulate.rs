//! `waypost simulate`: a simulated robot for a server's own map.

use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use waypost_client::v1::map_settings::NavigationStrategy;
use waypost_client::{Client, ClientOptions, NavigationOptions, v1};
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::drive::{Building, EVERY_HALF_METRE, FOUR_A_SECOND, SPEED_M_S, TWICE_A_SECOND, WHEN_MOVED};
use waypost_sim::pose::Pose;
use waypost_sim::worlds::NamedWorld;

use super::navigate::status_name;
use crate::failure::{EXIT_CODES, Failure};
use crate::files::Replacing;
use crate::names::short_map;
use crate::output::Output;
use crate::panorama::Projection;
use crate::simulated::by_looks::map_by_looks;
use crate::simulated::mapping::{SeenAgain, error_m, layers, map_along};
use crate::simulated::{Ending, LedDrive, building, camera, drive, robot, unfit, worlds};

/// Longest drive to a goal.
const PATIENCE: Duration = Duration::from_secs(600);

/// Wheels of robots that map, and of those that are led: other errors, as of another day.
const MAPPING_WHEELS: u64 = 0;
const LED_WHEELS: u64 = 1;

/// Drive a simulated robot through a building, on a map of any server
///
/// Without --navigate, the robot is driven along a route, and its images and odometry are streamed
/// into the map, as a real robot's would be. With --navigate, a robot starts where that route
/// starts and drives as the server tells it: to --to or --to-label, or wherever `waypost navigate`
/// sends it, until it is interrupted. Use the same --world, --route and --seed that the map was
/// made with. With --panorama, the robot has a camera that sees all around and no odometry: its map
/// has links by looks, and it is led by headings.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// Map to drive in; `waypost map create` makes one
    #[arg(long)]
    map: String,
    /// Building to drive in
    #[arg(long, value_name = "NAME", value_parser = worlds(), default_value = "office")]
    world: NamedWorld,
    /// Route through the building; if left out, its first. An unknown name lists all
    #[arg(long, value_name = "NAME")]
    route: Option<String>,
    /// Seed of the building's textures, the wheel errors and the camera noise
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// The robot sees all around in this projection, and goes by looks alone, without odometry. For
    /// maps with the navigation strategy appearance
    #[arg(long, value_enum, value_name = "PROJECTION")]
    panorama: Option<Projection>,
    /// Name of the session to stream into; if left out, the server chooses one
    #[arg(
        long,
        value_name = "ID",
        default_value = "",
        hide_default_value = true,
        conflicts_with = "navigate"
    )]
    session: String,
    /// Do not add to the map: be led along it
    #[arg(long)]
    navigate: bool,
    /// Name of the robot that is led
    #[arg(long, value_name = "ID", default_value = "simulated", requires = "navigate")]
    robot: String,
    /// Place to go to; the robot stops there and the command ends
    #[arg(long, value_name = "PLACE", requires = "navigate", conflicts_with = "to_label")]
    to: Option<u32>,
    /// Label to go to
    #[arg(long, value_name = "LABEL", requires = "navigate")]
    to_label: Option<String>,
    /// Write the truth, the odometry and the map as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "picture")]
    force: bool,
}

/// What `--json` prints of a drive that was streamed. Errors are root mean squares over the frames, with the first pose
/// laid to the true one.
#[derive(Serialize)]
struct Streamed {
    session: String,
    route: &'static str,
    driven_m: f64,
    frames: usize,
    wheels_error_m: f64,
    map_error_m: f64,
    map: v1::Map,
    closures: Vec<SeenAgain>,
}

/// What `--json` prints of a drive that was streamed into a map by looks.
#[derive(Serialize)]
struct StreamedByLooks {
    session: String,
    route: &'static str,
    driven_m: f64,
    frames: usize,
    /// Of the map's appearance graph.
    links_by_looks: usize,
    /// How far the ends of the drive's own links really are from each other; null where there are none.
    links_apart_median_m: Option<f64>,
    links_apart_most_m: Option<f64>,
    map: v1::Map,
}

/// What `--json` prints of a drive that the server led.
#[derive(Serialize)]
struct Led {
    navigation: String,
    driven_m: f64,
    frames: usize,
    recognised: usize,
    /// Where the robot really is.
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments {
        map,
        world,
        route,
        seed,
        panorama,
        session,
        navigate,
        robot,
        to,
        to_label,
        picture,
        force,
    } = arguments;
    let replacing = Replacing::of(force);
    replacing.check_wanted(picture.as_deref())?;
    let (building, route) = building(world, route.as_deref(), seed)?;
    let building = match panorama {
        Some(projection) => building.seen_all_around(projection.into()),
        None => building,
    };
    let client = Client::connect(server).await?;
    let map = short_map(&map);
    check_strategy(&client, map, panorama).await?;
    let working = async {
        if !navigate {
            let drive = (&building, route);
            return match panorama {
                None => stream(&client, map, &session, drive, seed, output).await,
                Some(_) => stream_by_looks(&client, map, &session, drive, seed, output).await,
            };
        }
        let target = to.map(v1::goal::Target::PlaceNumber).or(to_label.map(v1::goal::Target::Label));
        let goal = target.map(|target| v1::Goal { target: Some(target) });
        let options = NavigationOptions {
            navigation_id: robot,
            goal,
            ..NavigationOptions::new(map, camera(&building))
        };
        lead(&client, options, &Arc::new(building), seed, output).await
    };
    let svg = tokio::select! {
        done = working => done?,
        interrupt = tokio::signal::ctrl_c() => {
            interrupt.map_err(Failure::Runtime)?;
            return Err(Failure::Interrupted("stopped; the robot stands".to_owned()));
        }
    };
    match picture {
        Some(file) => replacing.write(&file, svg.as_bytes()),
        None => Ok(()),
    }
}

/// A robot by metres is none for a map of panoramas, nor the other way round. A map that is not there is made later, or named
/// then.
async fn check_strategy(client: &Client, map: &str, panorama: Option<Projection>) -> Result<(), Failure> {
    let Ok(found) = client.map(map, v1::MapView::Basic).await else { return Ok(()) };
    let strategy = found.settings.unwrap_or_default().navigation_strategy();
    match (strategy, panorama) {
        (NavigationStrategy::Appearance, None) => Err(Failure::Unfit(format!(
            "the map {map} is navigated by appearance, which takes panoramas, and the simulated robot's camera looks ahead; give it \
             another one with --panorama cylindrical, or name a map of metres"
        ))),
        (NavigationStrategy::Unspecified | NavigationStrategy::TopoMetric, Some(_)) => {
            Err(Failure::Unfit(format!(
                "the map {map} is navigated by metres, and the simulated robot that sees all around has no odometry; leave out \
                 --panorama, or name a map that was created with --navigation-strategy appearance"
            )))
        }
        (NavigationStrategy::Appearance, Some(_))
        | (NavigationStrategy::Unspecified | NavigationStrategy::TopoMetric, None) => Ok(()),
    }
}

/// Drives along the route and streams what the robot sees; gives the picture of the drive.
async fn stream(
    client: &Client,
    map: &str,
    session: &str,
    (building, route): (&Building, &'static str),
    seed: u64,
    output: Output,
) -> Result<String, Failure> {
    let mut robot = robot(building, seed, MAPPING_WHEELS, WHEN_MOVED)?;
    let recording = robot.drive_along(&building.route, SPEED_M_S).map_err(unfit)?;
    let mapped = map_along(client, map, session, building, &recording, output).await?;
    let svg = plan_svg(building.scene.plan(), &layers(building, &recording, &mapped));
    let by_wheels: Vec<Pose> = recording.frames().map(|frame| frame.odometry.pose).collect();
    let streamed = Streamed {
        route,
        driven_m: recording.length_m(),
        frames: recording.frames().count(),
        wheels_error_m: error_m(&recording, &by_wheels),
        map_error_m: error_m(&recording, &mapped.poses),
        session: mapped.session,
        map: mapped.map,
        closures: mapped.closures,
    };
    output.result(&streamed, |out| write_streamed(&streamed, out))?;
    Ok(svg)
}

fn write_streamed(streamed: &Streamed, out: &mut dyn Write) -> io::Result<()> {
    let Streamed { session, route, driven_m, frames, wheels_error_m, map_error_m, map, closures } = streamed;
    writeln!(out)?;
    writeln!(out, "{session}: route {route}, {driven_m:.1} m, {frames} frames")?;
    writeln!(out, "loop closures         {:8}", closures.len())?;
    writeln!(out, "places in the map     {:8}", map.places)?;
    writeln!(out, "error by wheels alone {wheels_error_m:8.2} m")?;
    writeln!(out, "error of the map      {map_error_m:8.2} m")
}

/// The same for a robot that sees all around.
async fn stream_by_looks(
    client: &Client,
    map: &str,
    session: &str,
    (building, route): (&Building, &'static str),
    seed: u64,
    output: Output,
) -> Result<String, Failure> {
    let mut robot = robot(building, seed, MAPPING_WHEELS, EVERY_HALF_METRE)?;
    let recording = robot.drive_along(&building.route, SPEED_M_S).map_err(unfit)?;
    let mapped = map_by_looks(client, map, session, building, &recording, output).await?;
    let svg = plan_svg(building.scene.plan(), &mapped.layers(&recording));
    let apart_m = mapped.apart_m();
    let streamed = StreamedByLooks {
        route,
        driven_m: recording.length_m(),
        frames: recording.frames().count(),
        links_apart_median_m: apart_m.map(|(median_m, _)| median_m),
        links_apart_most_m: apart_m.map(|(_, most_m)| most_m),
        session: mapped.session,
        links_by_looks: mapped.links,
        map: mapped.map,
    };
    output.result(&streamed, |out| write_streamed_by_looks(&streamed, out))?;
    Ok(svg)
}

fn write_streamed_by_looks(streamed: &StreamedByLooks, out: &mut dyn Write) -> io::Result<()> {
    let StreamedByLooks { session, route, driven_m, frames, links_by_looks, map, .. } = streamed;
    writeln!(out)?;
    writeln!(out, "{session}: route {route}, {driven_m:.1} m, {frames} panoramas")?;
    writeln!(out, "places in the map     {:8}", map.places)?;
    writeln!(out, "links by looks        {links_by_looks:8}")?;
    let (Some(median_m), Some(most_m)) = (streamed.links_apart_median_m, streamed.links_apart_most_m) else {
        return Ok(());
    };
    writeln!(out, "their ends are apart  {median_m:8.2} m in the median, {most_m:.2} m at most, in truth")
}

/// Lets the server lead the robot; gives the picture of the drive.
async fn lead(
    client: &Client,
    options: NavigationOptions,
    building: &Arc<Building>,
    seed: u64,
    output: Output,
) -> Result<String, Failure> {
    let ending = if options.goal.is_some() { Ending::OnArrival(PATIENCE) } else { Ending::Never };
    let map = options.map.clone();
    let mut navigation = client.navigate(options).await?;
    let name = navigation.opened().navigation.clone();
    let id = name.rsplit('/').next().unwrap_or_default();
    output.line(match ending {
        Ending::OnArrival(_) => format!("{name} drives"),
        Ending::Never => {
            format!("{name} waits for a goal: `waypost navigate {} {id} --to PLACE`", short_map(&map))
        }
    })?;
    let told = tell_states(navigation.guidance(), output);
    let trigger = match building.rig.camera().panorama() {
        Some(_) => FOUR_A_SECOND,
        None => TWICE_A_SECOND,
    };
    let mut robot = robot(building, seed, LED_WHEELS, trigger)?;
    let driving = drive(building, &mut robot, &mut navigation, ending, |seen, pose| {
        let Some(place) = seen.place_number else { return Ok(()) };
        // By looks there is none.
        let sure = seen.probability.map_or_else(String::new, |sure| format!(", probability {sure:.3}"));
        output.line(format_args!(
            "frame {:3} shows place {place:3}{sure}; truth: ({:.2}, {:.2}) m",
            seen.sequence, pose.x_m, pose.y_m
        ))
    });
    let led = tokio::select! {
        led = driving => led?,
        told = told => return Err(told),
    };
    finish(name, building, &led, output)
}

/// A robot that is lost for longer does not find out: it has turned around more than three times.
const LOST_FOR: Duration = Duration::from_secs(60);

/// A line for each state of the navigation, until stdout is closed.
async fn tell_states(
    mut guidance: tokio::sync::watch::Receiver<Option<v1::Guidance>>,
    output: Output,
) -> Failure {
    let mut before = None;
    let mut was_lost = false;
    let mut lost_since = None;
    loop {
        let told = guidance.borrow_and_update().clone().unwrap_or_default();
        let state = (told.status(), told.detail.clone());
        if before.as_ref() != Some(&state) {
            let why = state.1.as_deref().map_or_else(String::new, |why| format!(": {why}"));
            if let Err(failure) = output.line(format_args!("{}{why}", status_name(state.0))) {
                return failure;
            }
            if state.0 == v1::NavigationStatus::Lost && !was_lost {
                was_lost = true;
                // If stderr is closed, the hint is lost.
                let _ = writeln!(
                    io::stderr(),
                    "if it stays lost: was the map made with another --world, --route or --seed?"
                );
            }
            lost_since =
                (state.0 == v1::NavigationStatus::Lost).then(|| lost_since.unwrap_or_else(Instant::now));
            before = Some(state);
        }
        let patience =
            lost_since.map_or(Duration::MAX, |since: Instant| LOST_FOR.saturating_sub(since.elapsed()));
        match tokio::time::timeout(patience, guidance.changed()).await {
            Ok(Ok(())) => {}
            // The drive says why.
            Ok(Err(_)) => std::future::pending().await,
            Err(_) => {
                let told = "the robot stays lost: give the --world, --route and --seed of the map";
                return Failure::Unfit(told.to_owned());
            }
        }
    }
}

fn finish(name: String, building: &Building, led: &LedDrive, output: Output) -> Result<String, Failure> {
    let truth: Vec<Pose> = led.ticks.iter().map(|tick| tick.truth).collect();
    let end = truth.last().copied().unwrap_or_else(|| building.route.start());
    let report = Led {
        navigation: name,
        driven_m: truth.windows(2).map(|pair| pair[0].distance_m(&pair[1])).sum(),
        frames: led.seen.len(),
        recognised: led.seen.iter().filter(|(seen, _)| seen.place_number.is_some()).count(),
        x_m: end.x_m,
        y_m: end.y_m,
        heading_rad: end.heading_rad,
    };
    output.result(&report, |out| {
        writeln!(
            out,
            "{} has arrived: {:.1} m, {} of {} frames recognised; truth: ({:.2}, {:.2}) m, {:.0}°",
            report.navigation,
            report.driven_m,
            report.recognised,
            report.frames,
            report.x_m,
            report.y_m,
            report.heading_rad.to_degrees()
        )
    })?;
    let positions = truth.iter().map(Pose::position).collect();
    let layer =
        Layer { name: "truth".to_owned(), colour: "#1459aa".to_owned(), marks: Marks::Path(positions) };
    Ok(plan_svg(building.scene.plan(), &[layer]))
}
