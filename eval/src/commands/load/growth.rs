//! A map that grows to many places on a real server: what frames wait for while checkpoints are written, and how long
//! the map takes to open.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use fabmap::observation::Observation;
use rayon::prelude::*;
use serde::Serialize;
use tokio::time::Instant;
use waypost_client::{Client, FrameInput, SessionOptions, v1};

use super::contents::{Contents, histogram};
use super::report::{LatencyReport, ServerUse};
use super::robot::{Answered, stream_all};
use super::server::{MAP, ServerOptions, ServerUnderLoad};
use super::words::Fleet;
use super::{positive, seconds};
use crate::error::refused;
use crate::workload::{Use, Workload, WorkloadSettings};
use crate::{files, progress};

/// Frames on their way at once while the map grows.
const WINDOW: NonZeroUsize = NonZeroUsize::new(64).unwrap();

/// Places of a lane, and how many of their distances lanes lie apart.
const LANE: u32 = 300;
const LANE_WIDTHS: f64 = 4.0;

const SECOND_NS: i64 = 1_000_000_000;

/// Different looks at the grown map's places.
const LOOKS: u32 = 2_000;

/// A map that grows large: what looks wait for beside its checkpoints, and how long it takes to open. Its words
/// are drawn, and so is its model.
#[derive(Args)]
pub(super) struct GrowthOptions {
    /// Frames, each of another place.
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    places: u32,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "V", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
    words: u32,
    /// Looks a second at places of the grown map, each of which changes one.
    #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = positive)]
    rate_hz: f64,
    /// How long.
    #[arg(long = "seconds", value_name = "S", default_value = "60", value_parser = seconds)]
    duration: Duration,
    /// Metres between places: frames carry odometry of a drive to and fro, 300 places a lane. Without it, none.
    #[arg(long, value_name = "M", value_parser = positive)]
    metres_apart: Option<f64>,
    /// Keep the server's data in a new folder, for a server to show: its folder `data`.
    #[arg(long, value_name = "DIRECTORY")]
    keep_data: Option<PathBuf>,
}

/// What the robot saw of the server.
#[derive(Serialize)]
pub(crate) struct GrowthReport {
    pub frames: u32,
    /// Words of the vocabulary.
    pub words: u32,
    /// Places that the frames made.
    pub places: u64,
    /// Frames a second while it grew, as fast as the server took them.
    pub growth_frames_per_s: f64,
    /// What the server took then.
    pub server: ServerUse,
    pub looks_per_s: f64,
    /// Round trip of a look less what the server spent on it: commits and checkpoints among it.
    pub beyond_computing: LatencyReport,
    /// What the server spent on a look.
    pub computing: LatencyReport,
    /// From the request to the answer of the first question after a stop by SIGTERM.
    pub open_ms: f64,
    /// The same after the server was killed.
    pub open_after_kill_ms: f64,
    /// Size of the checkpoint.
    pub checkpoint_mib: f64,
    /// Size of the log.
    pub log_mib: f64,
}

pub(super) async fn run(server: &ServerOptions, options: &GrowthOptions) -> Result<GrowthReport> {
    let GrowthOptions { places, words, rate_hz, duration, metres_apart, keep_data } = options;
    if let Some(kept) = keep_data.as_deref().filter(|kept| kept.exists()) {
        return Err(refused(format_args!("{} is there already; name a new folder", kept.display())));
    }
    let settings = WorkloadSettings { words: *words, ..WorkloadSettings::default() };
    let workload = Workload::new(settings)?;
    let model = workload.model()?;
    let words_hash = model.words_hash().to_string();
    let model_file = tempfile::NamedTempFile::new().map_err(files::not_written(&std::env::temp_dir()))?;
    files::write(model_file.path(), &model.to_bytes())?;
    let options =
        ServerOptions { model: model_file.path().to_owned(), kept: keep_data.clone(), ..server.clone() };
    let server = ServerUnderLoad::start(&options).await?;

    let began = Instant::now();
    let cpu_s = server.cpu_s()?;
    grow(&server.endpoint(), &workload, &words_hash, *places, *metres_apart).await?;
    let grown_s = began.elapsed().as_secs_f64();
    let cpu_cores = (server.cpu_s()? - cpu_s) / grown_s;
    let server_use = ServerUse { cpu_cores, rss_mib: server.rss_mib()? };

    let looks: Vec<Observation> = (0..LOOKS)
        .into_par_iter()
        .map(|look| workload.revisit_to_one_of(look, *places).observation)
        .collect();
    let contents = Arc::new(Contents { frames: looks.iter().map(histogram).collect(), words_hash });
    let fleet = Fleet { prefix: "looker", robots: 1, maps: 1, rate_hz: *rate_hz, duration: *duration };
    let robots = fleet.open(&[server.endpoint()], &contents).await?;
    let record = fleet.drive(robots).await?;
    let latency = |of: fn(&Answered) -> Duration| LatencyReport::of(record.answered.iter().map(of));

    let server = server.restart(&options)?;
    let open_ms = first_answer_ms(&server.endpoint(), &contents).await?;
    let server = server.kill_and_restart(&options)?;
    let open_after_kill_ms = first_answer_ms(&server.endpoint(), &contents).await?;
    let map = Client::connect(&server.endpoint()).await?.map(MAP, waypost_client::v1::MapView::Full).await?;
    let storage = map.storage.unwrap_or_default();
    server.stop()?;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    Ok(GrowthReport {
        frames: *places,
        words: settings.words,
        places: map.places,
        growth_frames_per_s: f64::from(*places) / grown_s,
        server: server_use,
        looks_per_s: *rate_hz,
        beyond_computing: latency(Answered::beyond_computing),
        computing: latency(|answered| answered.computing),
        open_ms,
        open_after_kill_ms,
        checkpoint_mib: mib(storage.checkpoint_bytes),
        log_mib: mib(storage.log_bytes),
    })
}

/// Streams a frame of each place, as fast as they are taken.
async fn grow(
    endpoint: &str,
    workload: &Workload,
    words_hash: &str,
    places: u32,
    metres_apart: Option<f64>,
) -> Result<()> {
    let options = SessionOptions {
        session_id: "growing".to_owned(),
        words_hash: words_hash.to_owned(),
        window_frames: WINDOW,
        ..SessionOptions::new(MAP)
    };
    let client = Client::connect(endpoint).await?;
    let workload = workload.clone();
    let frames = (0..places).map(move |place| {
        let content = histogram(&workload.image(Use::Place, place));
        let sequence = u64::from(place) + 1;
        let odometry = metres_apart.map(|metres_apart| to_and_fro(place, metres_apart));
        let stamp_ns = SECOND_NS * i64::from(place + 1);
        FrameInput { sequence, stamp_ns, content, odometry, note: String::new() }
    });
    let progress = progress::bar("frames", places as usize);
    stream_all(&client, options, frames, || progress.inc(1)).await?;
    progress.finish_and_clear();
    Ok(())
}

/// Where a robot that ploughs a field is at a place.
fn to_and_fro(place: u32, metres_apart: f64) -> v1::Odometry {
    let (lane, along) = (place / LANE, place % LANE);
    let back = lane % 2 == 1;
    let along = if back { LANE - 1 - along } else { along };
    let heading_rad = if back { std::f64::consts::PI } else { 0.0 };
    let (z, w) = (heading_rad / 2.0_f64).sin_cos();
    let position_m = v1::Vector3 {
        x: f64::from(along) * metres_apart,
        y: f64::from(lane) * LANE_WIDTHS * metres_apart,
        z: 0.0,
    };
    let pose =
        v1::Pose { position_m: Some(position_m), orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z, w }) };
    v1::Odometry { pose: Some(pose), ..v1::Odometry::default() }
}

/// Asks where one image was taken.
async fn first_answer_ms(endpoint: &str, contents: &Contents) -> Result<f64> {
    let client = Client::connect(endpoint).await?;
    let begun = Instant::now();
    client.query(MAP, contents.frames[0].clone(), &contents.words_hash, Some(0)).await?;
    Ok(begun.elapsed().as_secs_f64() * 1e3)
}
