//! A simulated drive, streamed into a map and held against the truth.

use std::collections::BTreeMap;

use serde::Serialize;
use waypost_client::{Client, FrameOutcome, FrameSender, Outcomes, SessionOptions, v1};
use waypost_sim::drawing::{Layer, Marks};
use waypost_sim::drive::Building;
use waypost_sim::pose::Pose;
use waypost_sim::simulation::{CameraFrame, Recording};

use super::{camera, frame_input, jpeg, planar, unfit};
use crate::failure::Failure;
use crate::odometry::pose_message;
use crate::output::Output;
use crate::progress;

/// A loop closure, held against where the robot really was.
#[derive(Serialize)]
pub(crate) struct SeenAgain {
    pub(crate) frame: u64,
    pub(crate) earlier_frame: u64,
    pub(crate) probability: Option<f64>,
    /// How far apart the robot really was at the two frames.
    pub(crate) apart_m: f64,
}

/// What the server made of the drive.
pub(crate) struct Mapped {
    /// maps/{map}/sessions/{session}
    pub(crate) session: String,
    pub(crate) closures: Vec<SeenAgain>,
    /// Where the map has the robot at each frame.
    pub(crate) poses: Vec<Pose>,
    pub(crate) map: v1::Map,
}

/// What was answered to a drive's frames.
pub(super) struct Answered {
    /// maps/{map}/sessions/{session}
    pub(super) session: String,
    pub(super) closures: Vec<SeenAgain>,
    /// The places that frames made, and where the robot really was at those.
    pub(super) places: BTreeMap<u32, Pose>,
}

/// Streams a drive into a session of a map that there is.
pub(crate) async fn map_along(
    client: &Client,
    map: &str,
    session: &str,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<Mapped, Failure> {
    let Answered { session, closures, places: _ } =
        stream_along(client, map, session, building, recording, output).await?;
    let poses = trajectory(client, &session).await?;
    let map = client.map(map, v1::MapView::Full).await?;
    Ok(Mapped { session, closures, poses, map })
}

/// Streams a drive; what is made of it is asked for later.
pub(super) async fn stream_along(
    client: &Client,
    map: &str,
    session: &str,
    building: &Building,
    recording: &Recording,
    output: Output,
) -> Result<Answered, Failure> {
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
    let (sent, received) = tokio::join!(send(sender, building, &frames), receiving);
    let (closures, places) = received?;
    sent?;
    Ok(Answered { session: name, closures, places })
}

async fn send(mut sender: FrameSender, building: &Building, frames: &[&CameraFrame]) -> Result<(), Failure> {
    for frame in frames {
        let image = tokio::task::block_in_place(|| jpeg(building, &frame.shot))?;
        let input = frame_input(building, frame, image);
        sender.send(input).await?;
    }
    Ok(())
}

async fn receive(
    mut outcomes: Outcomes,
    frames: &[&CameraFrame],
    output: Output,
) -> Result<(Vec<SeenAgain>, BTreeMap<u32, Pose>), Failure> {
    let bar = progress::counter(output, "frames answered", frames.len());
    let mut closures = Vec::new();
    let mut places = BTreeMap::new();
    while let Some(outcome) = outcomes.next().await? {
        bar.inc(1);
        let answer = match outcome {
            FrameOutcome::Answer(answer) => answer,
            FrameOutcome::Refusal(refusal) => {
                let said = refusal.status.unwrap_or_default().message;
                return Err(Failure::Unfit(format!("frame {} was refused: {said}", refusal.sequence)));
            }
        };
        // The first frame of a place made it.
        if let (Some(place), Some(pose)) = (answer.place_number, true_pose(frames, answer.sequence)) {
            places.entry(place).or_insert(*pose);
        }
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
    Ok((closures, places))
}

/// Where the robot really was at a frame.
fn true_pose<'a>(frames: &[&'a CameraFrame], sequence: u64) -> Option<&'a Pose> {
    let index = usize::try_from(sequence.checked_sub(1)?).ok()?;
    Some(&frames.get(index)?.shot.pose)
}

fn seen_again(answer: &v1::FrameAnswer, frames: &[&CameraFrame]) -> Option<SeenAgain> {
    if answer.reason() != v1::Reason::LoopClosure {
        return None;
    }
    let closure = answer.r#match.as_ref()?;
    let earlier_frame = closure.frame.as_ref()?.sequence;
    let apart_m = true_pose(frames, answer.sequence)?.distance_m(true_pose(frames, earlier_frame)?);
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
        every: 0,
    };
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    let rows = crate::odometry::parse(&String::from_utf8_lossy(&text)).map_err(unfit)?;
    Ok(rows.iter().filter_map(|row| planar(&pose_message(&row.pose))).collect())
}

/// Poses in the frame of the first, laid to where the robot really started.
fn laid(building: &Building, poses: &[Pose]) -> Vec<Pose> {
    let Some(first) = poses.first() else { return Vec::new() };
    poses.iter().map(|pose| building.route.start().compose(&first.relative(pose))).collect()
}

/// Root mean square of how far poses are off, with the first laid to the true one.
pub(crate) fn error_m(recording: &Recording, poses: &[Pose]) -> f64 {
    let truth: Vec<Pose> = recording.frames().map(|frame| frame.shot.pose).collect();
    let (Some(first), Some(true_first)) = (poses.first(), truth.first()) else { return 0.0 };
    let squares = poses.iter().zip(&truth).map(|(pose, truth)| {
        let apart_m = true_first.compose(&first.relative(pose)).distance_m(truth);
        apart_m * apart_m
    });
    (squares.sum::<f64>() / poses.len() as f64).sqrt()
}

/// The truth, the wheels and the map, for a picture.
pub(crate) fn layers(building: &Building, recording: &Recording, mapped: &Mapped) -> Vec<Layer> {
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
