//! `waypost-eval soak`: hours in a life of a server, with robots of all kinds and people at once, kills and restarts.

mod led;
mod levels;
mod material;
mod people;
mod robots;
mod server;
mod stage;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use rand::RngExt;
use serde::Serialize;
use tokio::sync::{Mutex, RwLock};
use tokio::time::sleep;
use waypost_client::{Client, ClientOptions, SessionOptions, v1};

use self::levels::{Levels, grown};
use self::material::Material;
use self::robots::{AT_ONCE, HOME, WORDS};
use self::server::{Between, End, Server};
use self::stage::{Caller, Stage};
use super::load::server::ServerOptions;
use crate::choices::number;
use crate::files;

/// Levels are compared from tenth to tenth.
const TENTHS: usize = 10;

/// The server is killed and stopped in this half; the other one is one life of it, in which it may not grow.
const LAST_LIFE: usize = TENTHS / 2;

/// A tenth that is shorter says nothing of levels: they rise and fall with what is being done.
const JUDGED: Duration = Duration::from_secs(60);

/// Longest quiet at the end of each tenth, and longest life of a server in the first half.
const QUIET: Duration = Duration::from_secs(60);
const LONGEST_LIFE: Duration = Duration::from_secs(60);

/// Robots of words.
const WORD_ROBOTS: u64 = 2;

/// Run a server for hours: robots of all kinds and people at once, with kills and restarts in the first half.
///
/// Ends with exit code 1 if a frame that was acknowledged is lost, answered otherwise or there twice, a call or the log
/// tells of a fault, a map changes that nobody writes to, a led robot obeys a command that has lapsed, or, in ten
/// minutes and more, memory, descriptors, threads or files grow: the median of the last three tenths by more than 10 % and
/// 8 MiB (memory), 8 (descriptors, threads), 15 % and 4 MiB (files) above the second. That is the second of the last half for
/// memory, descriptors and threads, in which the server is one and connections alone are cut. The JSON report goes to stdout
/// then, too.
#[derive(Args)]
pub(crate) struct SoakOptions {
    /// How long, without the setting up.
    #[arg(long, value_name = "H", default_value_t = 1.0, value_parser = number(0.005..=1000.0))]
    hours: f64,
    /// Of everything that is drawn. Counts of other seeds add up.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    server: ServerOptions,
}

/// What came of it.
#[derive(Serialize)]
pub(crate) struct SoakReport {
    pub seed: u64,
    pub hours: f64,
    /// What was done how often.
    pub counts: BTreeMap<String, u64>,
    /// What the server took in each tenth.
    pub tenths: Vec<Levels>,
    /// The same at the end of each, when nobody had asked it anything for up to a minute; none in less than ten minutes.
    pub in_quiet: Vec<Levels>,
    /// What should not have been; empty if all was well.
    pub failures: Vec<String>,
}

impl SoakReport {
    /// What failed, if anything did.
    pub(crate) fn verdict(&self) -> Result<()> {
        if self.failures.is_empty() {
            return Ok(());
        }
        bail!("seed {}: {}", self.seed, self.failures.join("; "))
    }
}

/// Runs the server, and all who call it.
pub(crate) fn run(options: &SoakOptions) -> Result<SoakReport> {
    let material = Material::new(&options.server.model, options.seed)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    let runtime = runtime.context("no threads can be started; end other programs")?;
    runtime.block_on(soak(options, &material))
}

async fn soak(options: &SoakOptions, material: &Material) -> Result<SoakReport> {
    let SoakOptions { hours, seed, server } = options;
    let stage_before = Arc::new(Stage::new(*seed));
    let mut server = Server::start(server).await?;
    let endpoint = server.endpoint();
    let (client, home) = set_up(options, material, &endpoint, &stage_before).await?;
    let stage = Arc::new(Stage::new(*seed));
    let caller = Caller { client, stage: stage.clone() };
    let backup = server.backup();
    let whole = Duration::from_secs_f64(3600.0 * hours);
    let (mut tenths, mut in_quiet) = (Vec::new(), Vec::new());
    let rewriting = RwLock::new(());
    let shared = Mutex::new(&mut server);
    let came = tokio::try_join!(
        read_levels(&stage, &shared, whole, (&mut tenths, &mut in_quiet)),
        disturb(&caller, &shared, whole, &home),
        robots::words(&caller, material, 0, &rewriting),
        robots::words(&caller, material, WORD_ROBOTS - 1, &rewriting),
        robots::localizing(&caller, material),
        robots::panoramic(&caller, material),
        led::led(&caller, material),
        people::maps_in_metres(&caller, material),
        people::clerk(&caller, &endpoint, &backup, &home),
    );
    let mut failures: Vec<String> = came
        .err()
        .map(|error| format!("after {:.0} s: {error:#}", stage.elapsed().as_secs_f64()))
        .into_iter()
        .collect();
    let lives = stage.lives();
    if failures.is_empty() {
        if whole / TENTHS as u32 >= JUDGED {
            failures.extend(grown(&tenths, LAST_LIFE));
        }
        let end = async {
            people::is_as_it_was(&caller, &home).await?;
            server.end(End::Stop, &stage).await?;
            server.deep_check().await
        };
        failures.extend(end.await.err().map(|error| format!("at the end: {error:#}")));
    }
    let mut counts = stage.counts();
    counts.insert("lives of the server".to_owned(), lives);
    Ok(SoakReport { seed: *seed, hours: *hours, counts, tenths, in_quiet, failures })
}

/// A model, a token for all who call, the maps that stay; and the state of the one that nobody writes to.
async fn set_up(
    options: &SoakOptions,
    material: &Material,
    endpoint: &str,
    stage: &Arc<Stage>,
) -> Result<(Client, String)> {
    let anybody = Client::connect(endpoint).await?;
    let model = &options.server.model;
    let file = tokio::fs::File::open(model).await.map_err(files::not_read(model))?;
    for shipped in anybody.models().await? {
        anybody.delete_model(&shipped.name).await?;
    }
    anybody.import_model("soak", file).await?;
    let (_, secret) = anybody.create_token("operator", v1::token::Role::Admin).await?;
    let client = Client::connect(ClientOptions::new(endpoint).with_token(&secret)).await?;
    let caller = Caller { client: client.clone(), stage: stage.clone() };
    robots::make(&caller, HOME, None).await?;
    let by_words = v1::MapSettings {
        verification: v1::map_settings::Verification::None.into(),
        ..v1::MapSettings::default()
    };
    robots::make(&caller, WORDS, Some(by_words)).await?;
    let camera = Some(material.camera.clone());
    let options = SessionOptions { camera, ..robots::session(HOME, "robot") };
    robots::drive(&caller, options, &material.drive, AT_ONCE).await?;
    let home = caller.state_hash(HOME).await?;
    Ok((client, home))
}

/// Reads levels every second, and has quiet at the end of each tenth; then all is over.
async fn read_levels(
    stage: &Stage,
    server: &Mutex<&mut Server>,
    whole: Duration,
    (tenths, in_quiet): (&mut Vec<Levels>, &mut Vec<Levels>),
) -> Result<()> {
    let tenth = whole / TENTHS as u32;
    let quiet = if tenth < JUDGED { Duration::ZERO } else { QUIET.min(tenth / 6) };
    for number in 1..=TENTHS {
        let mut read = Vec::new();
        while stage.elapsed() + quiet < tenth * number as u32 || read.is_empty() {
            sleep(Duration::from_secs(1).min(tenth)).await;
            read.push(server.lock().await.levels()?);
        }
        if !quiet.is_zero() {
            let _all = stage.quiet.write().await;
            sleep(quiet).await;
            in_quiet.push(server.lock().await.levels()?);
        }
        let Some(levels) = Levels::of(&read) else { continue };
        eprintln!(
            "{:6.0} s, tenth {number} of {TENTHS}: {levels:.1?}, {} lives, {} frames answered",
            stage.elapsed().as_secs_f64(),
            stage.lives(),
            stage.counts().get("frames answered").copied().unwrap_or(0)
        );
        tenths.push(levels);
    }
    stage.end();
    Ok(())
}

/// Ends the server at random and starts it again, in the first half; in the other one connections alone are cut.
async fn disturb(caller: &Caller, server: &Mutex<&mut Server>, whole: Duration, home: &str) -> Result<()> {
    let stage = &caller.stage;
    let mut random = stage.random(600);
    let longest_s = LONGEST_LIFE.min(whole / 8).as_secs_f64();
    loop {
        // Short lives are as likely as long ones.
        sleep(Duration::from_secs_f64(longest_s * 0.05_f64.powf(random.random()))).await;
        let Some(_step) = stage.step().await else { return Ok(()) };
        let [end, check, pause, cut]: [f64; 4] = random.random();
        let server = &mut *server.lock().await;
        if stage.elapsed() >= whole / 2 || cut < 0.25 {
            server.cut();
            stage.count("connections cut");
            continue;
        }
        let end = if end < 0.6 { End::Kill } else { End::Stop };
        let between = if check < 0.3 { Between::DeepCheck } else { Between::Nothing };
        server.restart(end, between, Duration::from_secs_f64(2.0 * pause * pause), stage).await?;
        stage.count(match end {
            End::Kill => "kill -9",
            End::Stop => "SIGTERM",
        });
        if between == Between::DeepCheck {
            stage.count("checks of all data");
        }
        people::is_as_it_was(caller, home).await?;
    }
}
