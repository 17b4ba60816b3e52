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
    poses(client, request, &out, Replacing::of(force), output).await
}

pub(super) async fn graph(client: &Client, asked: Graph, output: Output) -> Result<(), Failure> {
    let Graph { name, out, force } = asked;
    let request = v1::ExportPosesRequest {
        name: format!("maps/{}", short_map(&name)),
        format: request::Format::G2o.into(),
        ..v1::ExportPosesRequest::default()
    };
    poses(client, request, &out, Replacing::of(force), output).await
}

/// Writes poses to a file, which appears only when it is complete.
async fn poses(
    client: &Client,
    request: v1::ExportPosesRequest,
    path: &Path,
    replacing: Replacing,
    output: Output,
) -> Result<(), Failure> {
    replacing.check_wanted(Some(path))?;
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    replacing.write(path, &text)?;
    let lines = text.iter().filter(|&&byte| byte == b'\n').count();
    output.result(&json!({ "file": path, "lines": lines }), |out| {
        writeln!(out, "{lines} lines in {}", path.display())
    })
}
