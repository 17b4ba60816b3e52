//! What all who take part share: the time, when to be quiet, what is counted; and calls that outlive the server.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow, bail};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use tokio::sync::{RwLock, RwLockReadGuard};
use tokio::time::sleep;
use waypost_client::{Client, Code, Error, v1};

/// Longer than the server is ever away.
const PATIENCE: Duration = Duration::from_secs(60);
const RETRY: Duration = Duration::from_millis(200);

/// Shared by all who take part.
#[derive(Debug)]
pub(super) struct Stage {
    seed: u64,
    began: Instant,
    over: AtomicBool,
    /// Held by each who does something; taken whole to have quiet.
    pub(super) quiet: RwLock<()>,
    counts: Mutex<BTreeMap<String, u64>>,
    /// Servers that have been started so far.
    lives: AtomicU64,
    down_since: Mutex<Option<Instant>>,
}

impl Stage {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            seed,
            began: Instant::now(),
            over: AtomicBool::new(false),
            quiet: RwLock::new(()),
            counts: Mutex::default(),
            lives: AtomicU64::new(1),
            down_since: Mutex::new(None),
        }
    }

    /// To be held while a step is done; waits while there is to be quiet. None when all is over.
    pub(super) async fn step(&self) -> Option<RwLockReadGuard<'_, ()>> {
        let step = self.quiet.read().await;
        (!self.over.load(Ordering::Relaxed)).then_some(step)
    }

    /// Nobody begins another step.
    pub(super) fn end(&self) {
        self.over.store(true, Ordering::Relaxed);
    }

    pub(super) fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    /// Chance of its own for each who takes part.
    pub(super) fn random(&self, stream: u64) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream);
        random
    }

    pub(super) fn count(&self, what: &str) {
        self.count_many(what, 1);
    }

    pub(super) fn count_many(&self, what: &str, many: usize) {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        *counts.entry(what.to_owned()).or_default() += many as u64;
    }

    pub(super) fn counts(&self) -> BTreeMap<String, u64> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn lives(&self) -> u64 {
        self.lives.load(Ordering::SeqCst)
    }

    /// The server has ended.
    pub(super) fn went_down(&self) {
        *self.down_since.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        self.lives.fetch_add(1, Ordering::SeqCst);
    }

    /// Another one runs in its place.
    pub(super) fn came_up(&self) {
        *self.down_since.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// For how long there has been no server, if there is none.
    pub(super) fn down_for(&self) -> Option<Duration> {
        let since = *self.down_since.lock().unwrap_or_else(PoisonError::into_inner);
        since.map(|since| since.elapsed())
    }
}

/// Somebody who calls the server, and calls again where it was away.
#[derive(Clone, Debug)]
pub(super) struct Caller {
    pub(super) client: Client,
    pub(super) stage: Arc<Stage>,
}

impl Caller {
    /// Calls until it is answered. None if it was refused after an attempt that broke: that one may have done it already.
    ///
    /// # Errors
    /// Whatever else is refused: nobody here asks for what may be.
    pub(super) async fn ask<T>(
        &self,
        what: &str,
        call: impl AsyncFn(&Client) -> Result<T, Error>,
    ) -> Result<Option<T>> {
        Ok(self.asked(what, call).await?.0)
    }

    /// The same, and whether an attempt broke.
    async fn asked<T>(
        &self,
        what: &str,
        call: impl AsyncFn(&Client) -> Result<T, Error>,
    ) -> Result<(Option<T>, bool)> {
        let began = Instant::now();
        let mut broke = false;
        loop {
            match call(&self.client).await {
                Ok(told) => {
                    self.stage.count(what);
                    return Ok((Some(told), broke));
                }
                Err(Error::Connection { .. } | Error::Status { code: Code::Unavailable, .. })
                    if began.elapsed() < PATIENCE =>
                {
                    broke = true;
                    sleep(RETRY).await;
                }
                Err(Error::Status {
                    code: Code::NotFound | Code::AlreadyExists | Code::FailedPrecondition | Code::Aborted,
                    ..
                }) if broke => {
                    self.stage.count("refused after a call that broke");
                    return Ok((None, broke));
                }
                Err(error) => return Err(anyhow!(error).context(what.to_owned())),
            }
        }
    }

    /// The same for what changes nothing, and so is answered.
    pub(super) async fn read<T>(
        &self,
        what: &str,
        call: impl AsyncFn(&Client) -> Result<T, Error>,
    ) -> Result<T> {
        self.ask(what, call).await?.with_context(|| format!("{what}: it is not there any more"))
    }

    /// Has a job done, and waits for it; whether it was surely: a server that ended meanwhile may have cut it off, and one whose
    /// connection broke may have done it.
    pub(super) async fn job(
        &self,
        what: &str,
        start: impl AsyncFn(&Client) -> Result<String, Error>,
    ) -> Result<bool> {
        let lives = self.stage.lives();
        let (Some(job), false) = self.asked(what, start).await? else {
            self.stage.count("jobs begun by calls that broke");
            self.at_rest().await?;
            return Ok(false);
        };
        let ended = async |client: &Client| {
            let mut progress = client.watch_job(&job).await?;
            let mut last = None;
            while let Some(now) = progress.next().await? {
                last = Some(now);
            }
            Ok(last)
        };
        let last = self.read("jobs followed", ended).await?;
        match last.as_ref().map(v1::Job::state) {
            Some(v1::job::State::Succeeded) => Ok(true),
            Some(v1::job::State::Failed) if lives != self.stage.lives() => {
                self.stage.count("jobs cut off");
                Ok(false)
            }
            _ => bail!("{what}: {last:?}"),
        }
    }

    /// Waits until no job runs.
    pub(super) async fn at_rest(&self) -> Result<()> {
        loop {
            let jobs = self.read("jobs listed", async |client| client.jobs().await).await?;
            if !jobs.iter().any(|job| job.state() == v1::job::State::Running) {
                return Ok(());
            }
            sleep(RETRY).await;
        }
    }

    /// The state hash of a map.
    pub(super) async fn state_hash(&self, map: &str) -> Result<String> {
        let map =
            self.read("maps looked at", async |client| client.map(map, v1::MapView::Full).await).await?;
        map.state_hash.context("a map without a state hash")
    }
}
