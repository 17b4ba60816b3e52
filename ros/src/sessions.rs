//! One session after another, as they are planned.

use std::collections::VecDeque;
use std::pin::pin;
use std::sync::Mutex;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;
use waypost_client::{Code, Error};

use crate::outbox::Outbox;
use crate::plan::Plan;
use crate::robot_words::SessionError;
use crate::session::Streaming;
use crate::settings::{Mode, Settings};
use crate::state::{Declared, Shared, Turned};

/// Frames that wait for a server while it is away: some minutes at two a second.
const BUFFER_FRAMES: usize = 512;
/// While localizing, an old frame says little: the newest ones are worth most.
const LOCALIZING_BUFFER_FRAMES: usize = 2;
/// For the next answer to frames that were taken before a session was to end.
pub(crate) const LAST_FRAMES: Duration = Duration::from_secs(10);
const LOOKING_PERIOD: Duration = Duration::from_millis(20);

/// Opens and ends sessions.
pub(crate) struct Sessions {
    pub(crate) streaming: Streaming,
    pub(crate) plans: watch::Sender<Plan>,
    pub(crate) declared: watch::Receiver<Declared>,
    pub(crate) ending: watch::Receiver<bool>,
}

impl Sessions {
    /// Streams until the bridge ends.
    ///
    /// # Errors
    /// What the server refuses for good, as a map that it does not have. Where services choose, they tell it, and wait.
    pub(crate) async fn run(mut self, settings: &Settings) -> Result<(), SessionError> {
        let mut before: Option<Plan> = None;
        while let Some(plan) = self.wanted().await {
            if before.is_some_and(|before| !plan.goes_on_from(&before)) {
                self.streaming.begin_anew();
            }
            before = Some(plan.clone());
            let ended = self.session(settings, &plan).await;
            self.streaming.shared.lock().session = None;
            let is_next_planned = ended.is_ok() && self.plans.borrow().turn != plan.turn;
            if *self.ending.borrow() || !(settings.is_served || is_next_planned) {
                return ended;
            }
            if let Err(error) = ended {
                tracing::error!("the session is over: {error}");
                self.plans.send_if_modified(|now| {
                    let is_same = now.turn == plan.turn;
                    now.is_wanted &= !is_same;
                    // A name that was refused would be refused again.
                    if is_same
                        && matches!(
                            &error,
                            SessionError::Server(Error::Status { code: Code::InvalidArgument, .. })
                        )
                    {
                        now.next_session.clear();
                    }
                    is_same
                });
                let turned = Turned { turn: plan.turn, to: Err(error.to_string()) };
                self.streaming.shared.lock().turned = Some(turned);
            }
        }
        Ok(())
    }

    /// The plan, once a session is wanted; none when the bridge ends.
    async fn wanted(&mut self) -> Option<Plan> {
        let mut plans = self.plans.subscribe();
        tokio::select! {
            plan = plans.wait_for(|plan| plan.wanted_map().is_some()) => plan.ok().map(|plan| plan.clone()),
            _ = self.ending.wait_for(|ends| *ends) => None,
        }
    }

    async fn session(&mut self, settings: &Settings, plan: &Plan) -> Result<(), SessionError> {
        let own_frames = match plan.mode {
            Mode::Map => BUFFER_FRAMES,
            Mode::Localize | Mode::Drive => LOCALIZING_BUFFER_FRAMES,
        };
        let (outbox, unanswered) = (self.streaming.outbox.clone(), self.streaming.unanswered.clone());
        let shared = self.streaming.shared.clone();
        outbox.open(settings.buffer_frames.unwrap_or(own_frames));
        let (stop, stopping) = watch::channel(false);
        let mut plans = self.plans.subscribe();
        let mut ending = self.ending.clone();
        let mut session =
            pin!(self.streaming.run(settings, plan, self.declared.clone(), stopping, &self.plans));
        let is_over = tokio::select! {
            ended = &mut session => Some(ended),
            _ = plans.wait_for(|now| now.turn != plan.turn) => None,
            _ = ending.wait_for(|ends| *ends) => None,
        };
        outbox.shut();
        let ended = match is_over {
            Some(ended) => ended,
            None => tokio::select! {
                ended = &mut session => ended,
                () = sent_or_late(&shared, &outbox, &unanswered) => {
                    stop.send_replace(true);
                    session.await
                }
            },
        };
        let left = outbox.clear();
        if left > 0 {
            tracing::warn!("{left} frames were not sent before their session ended, and are lost");
        }
        let finished = {
            let mut state = shared.lock();
            state.frames.dropped += left;
            state.session.take()
        };
        if let Some(finished) = finished {
            tracing::info!("{finished} is finished");
            let now = self.plans.borrow().clone();
            if ended.is_ok() && !now.is_wanted {
                shared.lock().turned = Some(Turned { turn: now.turn, to: Ok(finished) });
            }
        }
        ended
    }
}

/// Waits until all that was taken for a session is answered, or no answer has come for long. At once if none is open.
async fn sent_or_late(shared: &Shared, outbox: &Outbox, unanswered: &Mutex<VecDeque<(u64, i64)>>) {
    let waits = || outbox.len() > 0 || unanswered.lock().is_ok_and(|waiting| !waiting.is_empty());
    let (mut idle, mut answered, mut late) = (0, 0, Instant::now() + LAST_FRAMES);
    // Twice, as a frame may just be on its way from one to the other.
    while idle < 2 && Instant::now() < late {
        let heard = {
            let state = shared.lock();
            state.session.as_ref().map(|_open| state.frames.answered + state.frames.refused)
        };
        let Some(now) = heard else { return };
        if now != answered {
            (answered, late) = (now, Instant::now() + LAST_FRAMES);
        }
        idle = if waits() { 0 } else { idle + 1 };
        tokio::time::sleep(LOOKING_PERIOD).await;
    }
}
