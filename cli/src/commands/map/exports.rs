//! `waypost map trajectory`, `waypost map graph`: poses as files for other tools.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use serde_json::json;
use waypost_client::v1::export_poses_request as request;
use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::files::Replacing;
use crate::names::short_map;
use crate::output::Output;

/// Write the poses of a session's frames, for tools that compare trajectories
#[derive(clap::Args)]
pub(crate) struct Trajectory {
    /// Name of the map
    name: String,
    /// Name of the session
    session: String,
    #[arg(long, value_enum, default_value = "tum")]
    format: Format,
    /// Coordinate frame of the poses
    #[arg(long, value_enum, default_value = "map")]
    frame: request::Frame,
    /// What the poses are of
    #[arg(long, value_enum, default_value = "base")]
    body: request::Body,
    /// File to write
    #[arg(long)]
    out: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    force: bool,
}

/// Write the map's pose graph as g2o: a vertex for each place, an edge for each measured way
#[derive(clap::Args)]
pub(crate) struct Graph {
    /// Name of the map
    name: String,
    /// File to write
    #[arg(long)]
    out: PathBuf,
    /// Replace a file that is there
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    /// A line for each frame: stamp in seconds, position, quaternion
    Tum,
    /// A line for each frame: the upper three rows of the pose's matrix
    Kitti,
}

pub(super) async fn trajectory(client: &Client, asked: Trajectory, output: Output) -> Result<(), Failure> {
    let Trajectory { name, session, format, frame, body, out, force } = asked;
    let format = match format {
        Format::Tum => request::Format::Tum,
        Format::Kitti => request::Format::Kitti,
    };
    let request = v1::ExportPosesRequest {
        name: format!("maps/{}/sessions/{session}", short_map(&name)),
        format: format.into(),
        frame: frame.into(),
        body: body.into(),
        every: 0,
    };
    // Before the poses: frames that come meanwhile are none that were left out.
    let frames = client.session(&request.name).await?.frames;
    let lines = poses(client, request, &out, Replacing::of(force)).await?;
    let left_out = frames.saturating_sub(lines);
    output.result(&json!({ "file": out, "lines": lines, "frames_left_out": left_out }), |text| {
        writeln!(text, "{lines} lines in {}", out.display())?;
        if left_out > 0 {
            let why = match frame {
                request::Frame::Odom => "have no odometry",
                request::Frame::Map | request::Frame::Unspecified => {
                    "have no pose in the map, being without odometry or at places that nothing measured joins to it"
                }
            };
            writeln!(text, "{left_out} frames {why}, and are left out")?;
        }
        Ok(())
    })
}

pub(super) async fn graph(client: &Client, asked: Graph, output: Output) -> Result<(), Failure> {
    let Graph { name, out, force } = asked;
    let request = v1::ExportPosesRequest {
        name: format!("maps/{}", short_map(&name)),
        format: request::Format::G2o.into(),
        ..v1::ExportPosesRequest::default()
    };
    let lines = poses(client, request, &out, Replacing::of(force)).await?;
    output.result(&json!({ "file": out, "lines": lines }), |text| {
        writeln!(text, "{lines} lines in {}", out.display())
    })
}

/// Writes poses to a file, which appears only when it is complete. How many lines that are.
async fn poses(
    client: &Client,
    request: v1::ExportPosesRequest,
    path: &Path,
    replacing: Replacing,
) -> Result<u64, Failure> {
    replacing.check_wanted(Some(path))?;
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    replacing.write(path, &text)?;
    Ok(text.iter().filter(|&&byte| byte == b'\n').count() as u64)
}
