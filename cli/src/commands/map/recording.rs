//! `waypost map recording`: a session as MCAP, for Foxglove and ROS 2.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde_json::json;
use waypost_client::v1::export_poses_request as request;
use waypost_client::v1::get_frame_image_request::Size;
use waypost_client::{Client, Code, Error, v1};
use waypost_ros_messages::{
    CompressedImage, Covariance, DrawnMap, Float64, Header, Line, MarkerArray, Odometry, Path as PathMessage,
    Pose, PoseStamped, PoseWithCovarianceStamped, Recording, RecordingError, TransformStamped, Transforms,
    Twist, Vector3,
};

use crate::failure::Failure;
use crate::files::Replacing;
use crate::names::short_map;
use crate::output::{Output, mebibytes};
use crate::progress;

const MAP_FRAME: &str = "map";
const ODOMETRY_FRAME: &str = "odom";
const BASE_FRAME: &str = "base_link";
const CAMERA_FRAME: &str = "camera";

/// Write a session as MCAP, for Foxglove and ROS 2: map -> odom, poses, path, places, loop closures and images
///
/// Poses are as the map has them now, and probabilities as the robot was told them. Topics are those of the bridge.
#[derive(clap::Args)]
pub(crate) struct ToRecord {
    /// Name of the map
    name: String,
    /// Name of the session
    session: String,
    /// File to write
    #[arg(long)]
    out: PathBuf,
    /// The images of frames: the largest that the map keeps, thumbnails, or none
    #[arg(long, value_enum, default_value = "largest")]
    images: Images,
    /// Replace a file that is there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Images {
    Largest,
    Thumbnails,
    None,
}

/// A session, as far as it is recorded.
struct Session {
    name: String,
    frames: Vec<v1::FrameRecord>,
    /// The robot on the map as it is now, by stamp; nothing where the map has no metres.
    path: Vec<(i64, Isometry3<f64>)>,
    map: DrawnMap,
}

pub(super) async fn record(client: &Client, asked: ToRecord, output: Output) -> Result<(), Failure> {
    let ToRecord { name, session, out, images, force } = asked;
    let replacing = Replacing::of(force);
    replacing.check_wanted(Some(&out))?;
    let session = Session::fetch(client, short_map(&name), &session).await?;
    let mut partial = out.as_os_str().to_owned();
    partial.push(".partial");
    let partial = PathBuf::from(partial);
    let file = File::create(&partial).map_err(Failure::file("write", &partial))?;
    let written = write(client, &session, images, BufWriter::new(file), output).await;
    let file = match written.map_err(|failure| failure.about(&partial)) {
        Ok(file) => {
            file.into_inner().map_err(|error| Failure::file("write", &partial)(error.into_error()))?
        }
        Err(failure) => {
            std::fs::remove_file(&partial).map_err(Failure::file("remove", &partial))?;
            return Err(failure);
        }
    };
    file.sync_all().map_err(Failure::file("write", &partial))?;
    let size_bytes = file.metadata().map_err(Failure::file("read", &partial))?.len();
    std::fs::rename(&partial, &out).map_err(Failure::file("write", &out))?;
    let Session { name, frames, path, map } = session;
    let told = json!({
        "session": name, "file": out, "frames": frames.len(), "poses": path.len(),
        "loop_closures": map.closures.len(), "size_bytes": size_bytes,
    });
    output.result(&told, |stdout| {
        let metres = if path.is_empty() { "; no metres are known, so there are no poses" } else { "" };
        writeln!(stdout, "{} frames in {} ({}){metres}", frames.len(), out.display(), mebibytes(size_bytes))
    })
}

impl Session {
    async fn fetch(client: &Client, map: &str, session: &str) -> Result<Self, Failure> {
        let name = format!("maps/{map}/sessions/{session}");
        let frames = client.frames(&name).await?;
        let places = client.places(map).await?;
        let mut closures = client.loop_closures(map).await?;
        closures.retain(|closure| {
            closure.correction.is_none() && closure.frame.as_ref().is_some_and(|frame| frame.session == name)
        });
        let part = part_of(&frames, &places);
        let map = DrawnMap { part, labels: client.labels(map).await?, places, closures };
        let path = match poses(client, &name).await {
            Ok(path) => path,
            Err(Error::Status { code: Code::FailedPrecondition, .. }) => Vec::new(),
            Err(error) => return Err(error.into()),
        };
        Ok(Self { name, frames, path, map })
    }
}

/// The part of the map in which most of the session's frames are: others have frames of their own.
fn part_of(frames: &[v1::FrameRecord], places: &[v1::Place]) -> u32 {
    let parts: HashMap<&str, u32> = places
        .iter()
        .filter_map(|place| Some((place.name.rsplit('/').next()?, place.pose.as_ref()?.part)))
        .collect();
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    for place in frames.iter().filter_map(|frame| frame.answer.as_ref()?.place_number) {
        if let Some(part) = parts.get(place.to_string().as_str()) {
            *counts.entry(*part).or_default() += 1;
        }
    }
    counts
        .into_iter()
        .max_by_key(|(part, count)| (*count, std::cmp::Reverse(*part)))
        .map_or(0, |(part, _)| part)
}

/// The robot on the map as it is now.
async fn poses(client: &Client, session: &str) -> Result<Vec<(i64, Isometry3<f64>)>, Error> {
    let request = v1::ExportPosesRequest {
        name: session.to_owned(),
        format: request::Format::Tum.into(),
        frame: request::Frame::Map.into(),
        body: request::Body::Base.into(),
        every: 0,
    };
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    Ok(String::from_utf8_lossy(&text).lines().filter_map(stamped).collect())
}

/// A line of TUM's format: stamp in seconds, position, quaternion.
fn stamped(line: &str) -> Option<(i64, Isometry3<f64>)> {
    let (stamp, numbers) = line.split_once(' ')?;
    let (seconds, nanoseconds) = stamp.split_once('.')?;
    let stamp_ns: i64 = format!("{seconds}{nanoseconds:0<9}").parse().ok()?;
    let numbers: Vec<f64> = numbers.split(' ').map(str::parse).collect::<Result<_, _>>().ok()?;
    let [x, y, z, i, j, k, w] = numbers.try_into().ok()?;
    Some((stamp_ns, isometry([x, y, z], [i, j, k, w])))
}

fn isometry([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k)),
    )
}

/// None if a part is missing.
fn by_wheels(odometry: &v1::Odometry) -> Option<Isometry3<f64>> {
    let v1::Pose { position_m, orientation } = odometry.pose.as_ref()?;
    let v1::Vector3 { x, y, z } = position_m.as_ref()?;
    let v1::Quaternion { x: i, y: j, z: k, w } = orientation.as_ref()?;
    Some(isometry([*x, *y, *z], [*i, *j, *k, *w]))
}

fn in_ros(pose: &Isometry3<f64>) -> Option<Pose> {
    let (at, turned) = (pose.translation, pose.rotation);
    let position_m = Some(v1::Vector3 { x: at.x, y: at.y, z: at.z });
    let orientation = Some(v1::Quaternion { x: turned.i, y: turned.j, z: turned.k, w: turned.w });
    Pose::of(&v1::Pose { position_m, orientation })
}

/// What stopped a recording.
enum Stopped {
    Recording(RecordingError),
    Failure(Failure),
}

impl Stopped {
    fn about(self, path: &Path) -> Failure {
        match self {
            Self::Recording(error) => Failure::file("write", path)(std::io::Error::other(error)),
            Self::Failure(failure) => failure,
        }
    }
}

impl From<RecordingError> for Stopped {
    fn from(error: RecordingError) -> Self {
        Self::Recording(error)
    }
}

async fn write<W: Write + Seek>(
    client: &Client,
    session: &Session,
    images: Images,
    file: W,
    output: Output,
) -> Result<W, Stopped> {
    let mut recording = Recording::create(file)?;
    let bar = progress::counter(output, format!("recording {}", session.name), session.frames.len());
    if let Some(first) = session.frames.first() {
        write_map(&mut recording, session, first.stamp_ns)?;
    }
    let closures = session.lines();
    let poses: HashMap<i64, Isometry3<f64>> = session.path.iter().copied().collect();
    for frame in &session.frames {
        write_frame(&mut recording, frame, poses.get(&frame.stamp_ns))?;
        if let Some(line) = closures.get(frame.name.as_str()) {
            let header = Header::new(frame.stamp_ns, MAP_FRAME);
            let closed = MarkerArray::of_closure(&header, line.clone());
            recording.write("/waypost/closures", frame.stamp_ns, &closed)?;
        }
        if let Some(image) = image(client, frame, images).await.map_err(Stopped::Failure)? {
            recording.write("/camera/image_raw/compressed", frame.stamp_ns, &image)?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(recording.finish()?)
}

/// What holds for the whole session, at its beginning: whoever opens the file sees it at once.
fn write_map<W: Write + Seek>(
    recording: &mut Recording<W>,
    Session { path, map, .. }: &Session,
    stamp_ns: i64,
) -> Result<(), RecordingError> {
    if path.is_empty() {
        return Ok(());
    }
    let header = Header::new(stamp_ns, MAP_FRAME);
    let at = |(stamp_ns, pose): &(i64, Isometry3<f64>)| {
        Some(PoseStamped { header: Header::new(*stamp_ns, MAP_FRAME), pose: in_ros(pose)? })
    };
    let driven = PathMessage { header: header.clone(), poses: path.iter().filter_map(at).collect() };
    recording.write("/waypost/path", stamp_ns, &driven)?;
    recording.write("/waypost/markers", stamp_ns, &MarkerArray::of_map(&header, map))
}

/// What the robot said, where the map has it, and how sure of that it was.
fn write_frame<W: Write + Seek>(
    recording: &mut Recording<W>,
    frame: &v1::FrameRecord,
    robot: Option<&Isometry3<f64>>,
) -> Result<(), RecordingError> {
    let stamp_ns = frame.stamp_ns;
    let Some(answer) = &frame.answer else { return Ok(()) };
    let between = |parent: &str, child: &str, pose: Option<Isometry3<f64>>| {
        let (header, child_frame_id) = (Header::new(stamp_ns, parent), child.to_owned());
        Some(TransformStamped { header, child_frame_id, transform: in_ros(&pose?)? })
    };
    let odometry = frame.odometry.as_ref().and_then(by_wheels);
    let map_to_odom = robot.zip(odometry).map(|(robot, odometry)| robot * odometry.inverse());
    let transforms =
        [between(MAP_FRAME, ODOMETRY_FRAME, map_to_odom), between(ODOMETRY_FRAME, BASE_FRAME, odometry)];
    let transforms: Vec<TransformStamped> = transforms.into_iter().flatten().collect();
    if !transforms.is_empty() {
        recording.write("/tf", stamp_ns, &Transforms { transforms })?;
    }
    if let Some(pose) = odometry.as_ref().and_then(in_ros) {
        let told = Odometry {
            header: Header::new(stamp_ns, ODOMETRY_FRAME),
            child_frame_id: BASE_FRAME.to_owned(),
            pose,
            covariance: Covariance::UNKNOWN,
            twist: Twist::default(),
            twist_covariance: Covariance::UNKNOWN,
        };
        recording.write("/odom", stamp_ns, &told)?;
    }
    if let Some(pose) = robot.and_then(in_ros) {
        // How sure it was is not kept.
        let (header, covariance) = (Header::new(stamp_ns, MAP_FRAME), Covariance::UNKNOWN);
        recording.write(
            "/waypost/pose",
            stamp_ns,
            &PoseWithCovarianceStamped { header, pose, covariance },
        )?;
    }
    recording.write("/waypost/new_place", stamp_ns, &Float64 { data: answer.new_place_posterior })?;
    if let Some(likely) = answer.places.first() {
        recording.write("/waypost/most_probable_place", stamp_ns, &Float64 { data: likely.posterior })?;
    }
    let sure = answer.r#match.as_ref().and_then(|matched| Some(matched.geometry.as_ref()?.probability));
    match sure {
        Some(data) => recording.write("/waypost/match", stamp_ns, &Float64 { data }),
        None => Ok(()),
    }
}

impl Session {
    /// The loop closures, each by the frame that closed it, where metres are known.
    fn lines(&self) -> HashMap<String, Line> {
        let positions: BTreeMap<u32, Vector3> = self.map.positions();
        let stamps: HashMap<u64, i64> = self
            .frames
            .iter()
            .filter_map(|frame| Some((frame.answer.as_ref()?.sequence, frame.stamp_ns)))
            .collect();
        let robot: HashMap<i64, Vector3> = self
            .path
            .iter()
            .filter_map(|(stamp_ns, pose)| Some((*stamp_ns, in_ros(pose)?.position)))
            .collect();
        let line = |(id, closure): (i32, &v1::LoopClosure)| {
            let frame = closure.frame.as_ref()?;
            let from = *robot.get(stamps.get(&frame.sequence)?)?;
            let to = *positions.get(&closure.place_number)?;
            let sure = closure.probability.unwrap_or(closure.posterior);
            let text = format!("place {}, {sure:.3}", closure.place_number);
            Some((format!("{}/frames/{}", frame.session, frame.sequence), Line { id, from, to, text }))
        };
        (0..).zip(&self.map.closures).filter_map(line).collect()
    }
}

async fn image(
    client: &Client,
    frame: &v1::FrameRecord,
    images: Images,
) -> Result<Option<CompressedImage>, Failure> {
    let size = match images {
        Images::Largest => Size::Largest,
        Images::Thumbnails => Size::Thumbnail,
        Images::None => return Ok(None),
    };
    match client.frame_image(&frame.name, size).await {
        Ok(v1::GetFrameImageResponse { content_type, image: data }) => {
            let format = content_type.trim_start_matches("image/").to_owned();
            Ok(Some(CompressedImage { header: Header::new(frame.stamp_ns, CAMERA_FRAME), format, data }))
        }
        // The map keeps none of it.
        Err(Error::Status { code: Code::NotFound, .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_tum_keep_their_nanoseconds() {
        let (stamp_ns, pose) = stamped("12.000000003 1 2.5 0 0 0 0.6 0.8").unwrap();
        assert_eq!((stamp_ns, pose.translation.y), (12_000_000_003, 2.5));
        assert_eq!(stamped("-0.5 1 2 3 0 0 0 1").map(|(stamp_ns, _)| stamp_ns), Some(-500_000_000));
        for bad in ["", "12.0", "12.0 1 2 3", "x.y 1 2 3 0 0 0 1"] {
            assert_eq!(stamped(bad), None, "{bad}");
        }
    }
}
