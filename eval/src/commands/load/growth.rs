//! A map that grows to many places on a real server: what frames wait for while checkpoints are written, and how long
//! the map takes to open.

use std::num::NonZeroUsize;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::{Model, ModelTrainingError};
use fabmap::observation::Observation;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use tokio::time::Instant;
use waypost_client::{Client, FrameInput, FrameOutcome, SessionOptions};
use waypost_vision::features::{Feature, FeatureSettings};

use super::ServerOptions;
use super::contents::{Contents, histogram};
use super::report::{LatencyReport, ServerUse};
use super::robot::Answered;
use super::server::{MAP, ServerUnderLoad};
use super::words::Fleet;
use crate::error::EvalError;
use crate::progress;
use crate::workload::{Use, Workload, WorkloadSettings};

/// Frames on their way at once while the map grows.
const WINDOW: NonZeroUsize = NonZeroUsize::new(64).unwrap();

/// Images that the model remembers.
const SAMPLES: u32 = 1_000;

/// Different looks at the grown map's places.
const LOOKS: u32 = 2_000;

/// How large a map, and how it is then looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct GrowthOptions {
    /// The distribution that places and looks are drawn from.
    pub workload: WorkloadSettings,
    /// Frames that are streamed, each of another place.
    pub places: u32,
    /// Looks a second at places of the grown map, each of which changes one.
    pub rate_hz: f64,
    /// For how long.
    pub duration: Duration,
}

/// What the robot saw of the server.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GrowthReport {
    /// Name of the scenario.
    pub scenario: &'static str,
    /// See [`GrowthOptions::places`].
    pub frames: u32,
    /// Words of the vocabulary.
    pub words: u32,
    /// Places that the frames made.
    pub places: u64,
    /// Frames a second while it grew, as fast as the server took them.
    pub growth_frames_per_s: f64,
    /// What the server took then.
    pub server: ServerUse,
    /// See [`GrowthOptions::rate_hz`].
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

pub(super) async fn run(binary: Option<PathBuf>, options: &GrowthOptions) -> Result<GrowthReport, EvalError> {
    let GrowthOptions { workload: settings, places, rate_hz, duration } = options;
    let workload = Workload::new(*settings)?;
    let features = FeatureSettings::new(Feature::Orb, 500, 640).map_err(EvalError::FeatureSettings)?;
    let model = model(&workload, settings, features)?;
    let words_hash = model.words_hash().to_string();
    let model_file = tempfile::NamedTempFile::new().map_err(temporary)?;
    std::fs::write(model_file.path(), model.to_bytes()).map_err(temporary)?;
    let options = ServerOptions { binary, model: model_file.path().to_owned() };
    let server = ServerUnderLoad::start(&options).await?;

    let (began, cpu_s) = (Instant::now(), server.cpu_s()?);
    grow(&server.endpoint(), &workload, &words_hash, *places).await?;
    let grown_s = began.elapsed().as_secs_f64();
    let cpu_cores = (server.cpu_s()? - cpu_s) / grown_s;
    let server_use = ServerUse { cpu_cores, rss_mib: server.rss_mib()? };

    let looks: Vec<Observation> = (0..LOOKS)
        .into_par_iter()
        .map(|look| workload.revisit_to_one_of(look, *places).observation)
        .collect();
    let contents = Arc::new(Contents { frames: looks.iter().map(histogram).collect(), words_hash });
    let fleet = Fleet { prefix: "looker", robots: 1, rate_hz: *rate_hz, duration: *duration };
    let robots = fleet.open(&server.endpoint(), &contents).await?;
    let record = fleet.drive(robots).await?;
    let latency = |of: fn(&Answered) -> Duration| LatencyReport::of(record.answered.iter().map(of));

    let server = server.restart(&options).await?;
    let open_ms = first_answer_ms(&server.endpoint(), &contents).await?;
    let server = server.kill_and_restart(&options).await?;
    let open_after_kill_ms = first_answer_ms(&server.endpoint(), &contents).await?;
    let map = Client::connect(&server.endpoint()).await?.map(MAP, waypost_client::v1::MapView::Full).await?;
    let storage = map.storage.unwrap_or_default();
    server.stop().await?;
    let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    Ok(GrowthReport {
        scenario: "growth",
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

/// A model whose words nobody will ever see: its tree and samples are the workload's.
fn model(
    workload: &Workload,
    settings: &WorkloadSettings,
    features: FeatureSettings,
) -> Result<Model, ModelTrainingError> {
    let mut rows = vec![0; settings.words as usize * 32];
    ChaCha8Rng::seed_from_u64(settings.seed).fill_bytes(&mut rows);
    let descriptors = Descriptors::new(DescriptorKind::Binary, 32, rows)?;
    let vocabulary = VocabularySettings { words: settings.words, seed: settings.seed, iterations: 1 };
    let vocabulary = Vocabulary::train(&descriptors, &vocabulary, &mut |_| ControlFlow::Continue(()))?;
    let (tree, samples) = (workload.tree().clone(), workload.images(Use::Training, SAMPLES));
    Ok(Model::new(features.to_string(), vocabulary, tree, DetectorModel::default(), samples)?)
}

/// Streams a frame of each place, as fast as they are taken.
async fn grow(endpoint: &str, workload: &Workload, words_hash: &str, places: u32) -> Result<(), EvalError> {
    let options = SessionOptions {
        session_id: "growing".to_owned(),
        words_hash: words_hash.to_owned(),
        window_frames: WINDOW,
        ..SessionOptions::new(MAP)
    };
    let (mut sender, mut outcomes) = Client::connect(endpoint).await?.open_session(options).await?.split();
    let workload = workload.clone();
    let sending = tokio::spawn(async move {
        for place in 0..places {
            let content = histogram(&workload.image(Use::Place, place));
            let sequence = u64::from(place) + 1;
            let frame = FrameInput { sequence, stamp_ns: sequence as i64, content, odometry: None };
            sender.send(frame).await?;
        }
        Ok::<(), EvalError>(())
    });
    let progress = progress::bar("frames", places as usize);
    while let Some(outcome) = outcomes.next().await? {
        if let FrameOutcome::Refusal(refusal) = outcome {
            let why = refusal.status.unwrap_or_default().message;
            return Err(EvalError::Server {
                problem: format!("it refused a frame: {why}"),
                log: String::new(),
            });
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    sending.await?
}

/// Asks where one image was taken.
async fn first_answer_ms(endpoint: &str, contents: &Contents) -> Result<f64, EvalError> {
    let client = Client::connect(endpoint).await?;
    let begun = Instant::now();
    client.query(MAP, contents.frames[0].clone(), &contents.words_hash, 0).await?;
    Ok(begun.elapsed().as_secs_f64() * 1e3)
}

fn temporary(reason: std::io::Error) -> EvalError {
    EvalError::Write { path: std::env::temp_dir(), reason }
}

impl GrowthReport {
    pub(super) fn table(&self) -> String {
        let Self {
            scenario: _,
            frames,
            words,
            places,
            growth_frames_per_s,
            server: ServerUse { cpu_cores, rss_mib },
            looks_per_s,
            beyond_computing,
            computing,
            open_ms,
            open_after_kill_ms,
            checkpoint_mib,
            log_mib,
        } = self;
        format!(
            "map                {places} places of {frames} frames, {words} words\n\
             growing            {growth_frames_per_s:.0} frames/s, {cpu_cores:.2} cores, {rss_mib:.0} MiB\n\
             {looks_per_s} looks/s:\n\
             beyond computing   {}\n\
             computing          {}\n\
             opened in          {open_ms:.0} ms, after a kill {open_after_kill_ms:.0} ms\n\
             on the disk        checkpoint {checkpoint_mib:.1} MiB, log {log_mib:.1} MiB\n",
            beyond_computing.text(),
            computing.text(),
        )
    }
}
