//! A simulated robot maps a building by camera and wheels.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;
use waypost_client::launch::ServerProcess;
use waypost_client::{Client, FrameOutcome, FrameSender, Outcomes, SessionOptions, v1};
use waypost_sim::drawing::{Layer, Marks, plan_svg};
use waypost_sim::drive::{Building, SPEED_M_S, WHEN_MOVED};
use waypost_sim::pose::Pose;
use waypost_sim::simulation::{CameraFrame, Recording};

use super::super::model;
use super::{Demo, tell_where_it_is};
use crate::failure::Failure;
use crate::output::Output;
use crate::progress;
use crate::simulated::{building, camera, frame_input, jpeg, planar, robot, unfit};

const MAP: &str = "building";
const SESSION: &str = "drive";

/// What `--json` prints. Errors are root mean squares over the frames, with the first pose laid to the true one.
#[derive(Serialize)]
struct Report {
    world: String,
    route: &'static str,
    seed: u64,
    driven_m: f64,
    collisions: u64,
    frames: usize,
    wheels_error_m: f64,
    map_error_m: f64,
    map: v1::Map,
    picture: String,
    closures: Vec<SeenAgain>,
}

/// A loop closure, held against where the robot really was.
#[derive(Serialize)]
struct SeenAgain {
    frame: u64,
    earlier_frame: u64,
    probability: Option<f64>,
    /// How far apart the robot really was at the two frames.
    apart_m: f64,
}

pub(super) async fn run(
    demo: &Demo,
    world: &str,
    route: Option<&str>,
    seed: u64,
    output: Output,
) -> Result<(), Failure> {
    let (building, route_name) = building(world, route, seed)?;
    let recording =
        robot(&building, seed, 0, WHEN_MOVED)?.drive_along(&building.route, SPEED_M_S).map_err(unfit)?;
    let model_file = demo.model_file();
    let (mapped, data_dir) = demo
        .with_server(output, async |server, data_dir| {
            let mapped = map(server, &model_file, &building, &recording, output).await?;
            Ok((mapped, data_dir.to_owned()))
        })
        .await?;
    let picture = data_dir.join("building.svg");
    let svg = plan_svg(building.scene.plan(), &layers(&building, &recording, &mapped));
    std::fs::write(&picture, svg).map_err(Failure::file("write", &picture))?;
    let by_wheels: Vec<Pose> = recording.frames().map(|frame| frame.odometry.pose).collect();
    let report = Report {
        world: world.to_owned(),
        route: route_name,
        seed,
        driven_m: recording.length_m(),
        collisions: recording.collisions,
        frames: recording.frames().count(),
        wheels_error_m: error_m(&recording, &by_wheels),
        map_error_m: error_m(&recording, &mapped.poses),
        map: mapped.map,
        picture: picture.to_string_lossy().into_owned(),
        closures: mapped.closures,
    };
    output.result(&report, |out| write_report(&report, &data_dir, out))
}

/// What the server made of the drive.
pub(super) struct Mapped {
    closures: Vec<SeenAgain>,
    /// Where the map has the robot at each frame.
    poses: Vec<Pose>,
    pub(super) map: v1::Map,
}

async fn map(
    server: &ServerProcess,
    model_file: &Path,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<Mapped, Failure> {
    let client = Client::connect(&server.endpoint()).await?;
    let model = model::import(&client, model_file, "demo", output).await?;
    map_along(&client, &model.name, MAP, SESSION, building, recording, output).await
}

/// Streams a drive into a new map.
pub(super) async fn map_along(
    client: &Client,
    model: &str,
    map: &str,
    session: &str,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<Mapped, Failure> {
    client
        .create_map(v1::CreateMapRequest { map_id: map.to_owned(), model: model.to_owned(), settings: None })
        .await?;
    let camera = Some(camera(building));
    let options = SessionOptions { session_id: session.to_owned(), camera, ..SessionOptions::new(map) };
    let session = client.open_session(options).await?;
    let name = session.opened().session.clone();
    let frames: Vec<&CameraFrame> = recording.frames().collect();
    output.line(format_args!(
        "driving {:.0} m and streaming {} images into {name}\n",
        recording.length_m(),
        frames.len()
    ))?;
    let (sender, outcomes) = session.split();
    let receiving = receive(outcomes, &frames, output);
    let (sent, closures) = tokio::join!(send(sender, building, &frames), receiving);
    let closures = closures?;
    sent?;
    let poses = trajectory(client, &name).await?;
    let map = client.map(map, v1::MapView::Full).await?;
    Ok(Mapped { closures, poses, map })
}

async fn send(mut sender: FrameSender, building: &Building, frames: &[&CameraFrame]) -> Result<(), Failure> {
    for frame in frames {
        let image = tokio::task::block_in_place(|| jpeg(building, &frame.shot))?;
        let input = frame_input(frame, image);
        sender.send(input).await?;
    }
    Ok(())
}

async fn receive(
    mut outcomes: Outcomes,
    frames: &[&CameraFrame],
    output: Output,
) -> Result<Vec<SeenAgain>, Failure> {
    let bar = progress::counter(output, "frames answered", frames.len());
    let mut closures = Vec::new();
    while let Some(outcome) = outcomes.next().await? {
        bar.inc(1);
        let answer = match outcome {
            FrameOutcome::Answer(answer) => answer,
            FrameOutcome::Refusal(refusal) => {
                let said = refusal.status.unwrap_or_default().message;
                return Err(Failure::Unfit(format!("frame {} was refused: {said}", refusal.sequence)));
            }
        };
        if let Some(closure) = seen_again(&answer, frames) {
            let SeenAgain { frame, earlier_frame, probability, apart_m } = &closure;
            let sure = probability.map_or_else(String::new, |sure| format!(", probability {sure:.3}"));
            bar.suspend(|| {
                output.line(format_args!(
                    "frame {frame:3} is where frame {earlier_frame:3} was{sure}; truth: {apart_m:.2} m apart"
                ))
            })?;
            closures.push(closure);
        }
    }
    bar.finish_and_clear();
    Ok(closures)
}

fn seen_again(answer: &v1::FrameAnswer, frames: &[&CameraFrame]) -> Option<SeenAgain> {
    if answer.reason() != v1::Reason::LoopClosure {
        return None;
    }
    let closure = answer.r#match.as_ref()?;
    let earlier_frame = closure.frame.as_ref()?.sequence;
    let truth = |sequence: u64| Some(&frames.get(usize::try_from(sequence.checked_sub(1)?).ok()?)?.shot.pose);
    let apart_m = truth(answer.sequence)?.distance_m(truth(earlier_frame)?);
    let probability = closure.geometry.as_ref().map(|geometry| geometry.probability);
    Some(SeenAgain { frame: answer.sequence, earlier_frame, probability, apart_m })
}

/// Where the map has the robot at each frame, by its own export.
async fn trajectory(client: &Client, session: &str) -> Result<Vec<Pose>, Failure> {
    use v1::export_poses_request::{Body, Format, Frame};
    let request = v1::ExportPosesRequest {
        name: session.to_owned(),
        format: Format::Tum.into(),
        frame: Frame::Map.into(),
        body: Body::Base.into(),
    };
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    let rows = crate::odometry::parse(&String::from_utf8_lossy(&text)).map_err(unfit)?;
    Ok(rows.iter().filter_map(|row| planar(row.odometry.pose.as_ref()?)).collect())
}

/// Poses in the frame of the first, laid to where the robot really started.
fn laid(building: &Building, poses: &[Pose]) -> Vec<Pose> {
    let Some(first) = poses.first() else { return Vec::new() };
    poses.iter().map(|pose| building.route.start().compose(&first.relative(pose))).collect()
}

fn error_m(recording: &Recording, poses: &[Pose]) -> f64 {
    let truth: Vec<Pose> = recording.frames().map(|frame| frame.shot.pose).collect();
    let (Some(first), Some(true_first)) = (poses.first(), truth.first()) else { return 0.0 };
    let squares = poses.iter().zip(&truth).map(|(pose, truth)| {
        let apart_m = true_first.compose(&first.relative(pose)).distance_m(truth);
        apart_m * apart_m
    });
    (squares.sum::<f64>() / poses.len() as f64).sqrt()
}

fn layers(building: &Building, recording: &Recording, mapped: &Mapped) -> Vec<Layer> {
    let positions = |poses: Vec<Pose>| poses.iter().map(Pose::position).collect::<Vec<_>>();
    let truth = positions(recording.ticks.iter().map(|tick| tick.truth).collect());
    let wheels: Vec<Pose> = recording.ticks.iter().map(|tick| tick.odometry.pose).collect();
    let map = positions(laid(building, &mapped.poses));
    let again = mapped.closures.iter().filter_map(|closure| map.get(closure.frame as usize - 1).copied());
    let again = Marks::Dots(again.collect());
    [
        ("truth", "#1459aa", Marks::Path(truth)),
        ("wheels alone", "#e0a040", Marks::Path(positions(laid(building, &wheels)))),
        ("map", "#208050", Marks::Path(map)),
        ("recognised where it had been", "#d01020", again),
    ]
    .map(|(name, colour, marks)| Layer { name: name.to_owned(), colour: colour.to_owned(), marks })
    .to_vec()
}

fn write_report(report: &Report, data: &Path, out: &mut dyn Write) -> io::Result<()> {
    let Report { driven_m, frames, wheels_error_m, map_error_m, map, picture, closures, collisions, .. } =
        report;
    let farthest_m = closures.iter().map(|closure| closure.apart_m).fold(0.0, f64::max);
    writeln!(out)?;
    writeln!(out, "driven                          {driven_m:8.2} m, {collisions} collisions")?;
    writeln!(out, "frames                          {frames:5}")?;
    writeln!(out, "loop closures                   {:5}, at most {farthest_m:.2} m off", closures.len())?;
    writeln!(out, "places in the map               {:5}", map.places)?;
    writeln!(out, "links in the map                {:5}", map.links)?;
    writeln!(out, "error by wheels alone           {wheels_error_m:8.2} m")?;
    writeln!(out, "error of the map                {map_error_m:8.2} m")?;
    writeln!(out)?;
    writeln!(out, "Truth, wheels and map are drawn in {picture}")?;
    tell_where_it_is(out, data, MAP)
}
