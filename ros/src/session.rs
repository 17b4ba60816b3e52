//! The session with the server: frames out, and what the map says of them back.

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;
use waypost_bags::Frame;
use waypost_client::{
    Client, Error, FrameInput, FrameOutcome, FrameSender, Outcomes, Reconnection, SessionOptions, v1,
};

use crate::camera::odometry_message;
use crate::outbox::Outbox;
use crate::plan::Plan;
use crate::robot_words::{ContentMaker, SessionError, WordForm};
use crate::settings::{Mode, Settings};
use crate::state::{Declared, Placed, Shared, Turned};
use crate::telling::{Sureness, Telling};
use waypost_ros_messages::Pose;

/// A robot drives on without its server, whatever the time: it is the operator who gives up.
const GIVE_UP_AFTER: Duration = Duration::from_secs(10 * 365 * 24 * 3600);
/// Time for the last answers when the bridge ends.
const LAST_ANSWERS: Duration = Duration::from_secs(3);
/// A model is asked for again after this time.
const MODEL_PAUSE: Duration = Duration::from_secs(1);
/// While localizing, frames that wait for answers are soon too old to matter.
const LOCALIZING_WINDOW: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);

/// How connections are mended.
pub(crate) fn reconnection() -> Reconnection {
    let longest_delay = Duration::from_secs(2);
    Reconnection { give_up_after: GIVE_UP_AFTER, longest_delay, ..Reconnection::default() }
}

/// What the session works with.
pub(crate) struct Streaming {
    pub(crate) client: Client,
    pub(crate) shared: Shared,
    pub(crate) outbox: Arc<Outbox>,
    pub(crate) telling: Telling,
    pub(crate) sureness: Sureness,
    pub(crate) words: Option<WordForm>,
    /// Of the session before; the same model is not downloaded again.
    pub(crate) contents: ContentMaker,
    /// Numbers and stamps of frames that have no answer yet.
    pub(crate) unanswered: Arc<Mutex<VecDeque<(u64, i64)>>>,
}

impl Streaming {
    /// Streams frames, from when the camera is known until the session is to stop. A planned name is used up once it is
    /// open.
    ///
    /// # Errors
    /// What the server refuses for good, as a map that it does not have.
    pub(crate) async fn run(
        &mut self,
        settings: &Settings,
        plan: &Plan,
        mut declared: watch::Receiver<Declared>,
        mut stopping: watch::Receiver<bool>,
        plans: &watch::Sender<Plan>,
    ) -> Result<(), SessionError> {
        self.unanswered.lock().unwrap_or_else(PoisonError::into_inner).clear();
        let camera = tokio::select! {
            camera = camera(&mut declared) => camera,
            _ = stopping.wait_for(|stops| *stops) => return Ok(()),
        };
        tracing::info!("opening the session at {}", settings.server);
        let contents = tokio::select! {
            contents = self.contents_for(plan) => contents?,
            _ = stopping.wait_for(|stops| *stops) => return Ok(()),
        };
        let options = SessionOptions { words_hash: contents.words_hash(), ..options(plan, camera) };
        let opening = self.client.open_session(options);
        let session = tokio::select! {
            session = opening => session?,
            _ = stopping.wait_for(|stops| *stops) => return Ok(()),
        };
        let opened = session.opened().clone();
        tracing::info!("{} is open", opened.session);
        plans.send_if_modified(|now| {
            if now.turn == plan.turn && now.next_session == plan.next_session {
                now.next_session.clear();
            }
            // Nobody has to do anything about it.
            false
        });
        {
            let mut state = self.shared.lock();
            state.session = Some(opened.session.clone());
            state.turned = Some(Turned { turn: plan.turn, to: Ok(opened.session) });
        }
        let (sender, mut outcomes) = session.split();
        let sending = tokio::spawn(send(
            sender,
            contents,
            opened.last_committed_sequence.unwrap_or(0),
            self.outbox.clone(),
            self.shared.clone(),
            self.unanswered.clone(),
            stopping.clone(),
        ));
        // Until it has ended it hears answers to frames from before the robot's clock was set back.
        let is_of_now = || plans.borrow().clock == plan.clock;
        let taken = self.take(&mut outcomes, stopping, is_of_now).await;
        sending.abort();
        Ok(taken?)
    }

    /// Waits for a server that is away.
    async fn contents_for(&mut self, plan: &Plan) -> Result<ContentMaker, SessionError> {
        let map = plan.map.as_deref().unwrap_or_default();
        loop {
            match self.contents.clone().for_map(&self.client, map, self.words).await {
                Ok(contents) => {
                    self.contents = contents.clone();
                    return Ok(contents);
                }
                Err(SessionError::Server(Error::Connection { .. })) => tokio::time::sleep(MODEL_PAUSE).await,
                Err(error) => return Err(error),
            }
        }
    }

    async fn take(
        &mut self,
        outcomes: &mut Outcomes,
        mut stopping: watch::Receiver<bool>,
        is_of_now: impl Fn() -> bool,
    ) -> Result<(), Error> {
        loop {
            let outcome = tokio::select! {
                outcome = outcomes.next() => outcome?,
                _ = stopping.wait_for(|stops| *stops) => break,
            };
            let Some(outcome) = outcome else { return Ok(()) };
            self.outcome(outcome, is_of_now());
        }
        let unanswered = self.unanswered.clone();
        let last = tokio::time::timeout(LAST_ANSWERS, async {
            while let Some(outcome) = outcomes.next().await? {
                self.outcome(outcome, is_of_now());
            }
            Ok(())
        });
        last.await.unwrap_or_else(|_elapsed| {
            let count = unanswered.lock().unwrap_or_else(PoisonError::into_inner).len();
            tracing::warn!(
                "{count} frames had no answer when their session ended; they may be in the map all the same"
            );
            Ok(())
        })
    }

    /// What was known of the robot was of another map, or of odometry before the robot's clock was set back.
    pub(crate) fn begin_anew(&mut self) {
        self.shared.lock().placed = None;
        self.telling.begin_anew();
    }

    fn outcome(&mut self, outcome: FrameOutcome, is_of_now: bool) {
        let stamp_ns = self.answered(outcome.sequence());
        match outcome {
            FrameOutcome::Answer(answer) => self.answer(&answer, stamp_ns, is_of_now),
            FrameOutcome::Refusal(refusal) => {
                let message = refusal.status.map(|status| status.message).unwrap_or_default();
                let mut state = self.shared.lock();
                state.frames.refused += 1;
                state.frames.last_heard = Some(Instant::now());
                if state.frames.refusal.as_ref() != Some(&message) {
                    tracing::warn!("frame {} was refused: {message}", refusal.sequence);
                }
                state.frames.refusal = Some(message);
            }
        }
    }

    /// Forgets frames up to this one, and says when it was taken.
    fn answered(&self, sequence: u64) -> Option<i64> {
        let mut unanswered = self.unanswered.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = None;
        while let Some((number, stamp_ns)) =
            unanswered.front().copied().filter(|(number, _)| *number <= sequence)
        {
            unanswered.pop_front();
            if number == sequence {
                found = Some(stamp_ns);
            }
        }
        found
    }

    fn answer(&mut self, answer: &v1::FrameAnswer, stamp_ns: Option<i64>, is_of_now: bool) {
        self.sureness.answered(answer);
        let placed = answer.map_pose.as_ref().filter(|_| is_of_now).and_then(placed);
        let mut state = self.shared.lock();
        state.frames.answered += 1;
        state.frames.last_heard = Some(Instant::now());
        state.frames.closures += u64::from(answer.reason() == v1::Reason::LoopClosure);
        let Some(placed) = placed else { return };
        if state.placed.as_ref().is_some_and(|before| before.part != placed.part) {
            tracing::info!(
                "the robot is in part {} of the map now, which has a frame of its own",
                placed.part
            );
        }
        state.placed = Some(placed.clone());
        drop(state);
        if let Some(stamp_ns) = stamp_ns {
            self.telling.placed(&placed, stamp_ns);
        }
    }
}

fn placed(v1::MapPose { part, robot, map_to_odom }: &v1::MapPose) -> Option<Placed> {
    let robot = robot.as_ref().and_then(Pose::of)?;
    let map_to_odom = map_to_odom.as_ref().and_then(Pose::of)?;
    Some(Placed { part: *part, robot, map_to_odom, at: Instant::now() })
}

/// The camera, once it is declared.
pub(crate) async fn camera(declared: &mut watch::Receiver<Declared>) -> Option<v1::Camera> {
    loop {
        if let Declared::As(camera) = &*declared.borrow_and_update() {
            return camera.clone();
        }
        if declared.changed().await.is_err() {
            // Nobody is left who would say; the bridge is ending.
            std::future::pending::<()>().await;
        }
    }
}

fn options(plan: &Plan, camera: Option<v1::Camera>) -> SessionOptions {
    let mut options = SessionOptions::new(plan.map.as_deref().unwrap_or_default());
    options.session_id.clone_from(&plan.next_session);
    options.camera = camera;
    options.reconnection = reconnection();
    match plan.mode {
        Mode::Map => options.mode = v1::SessionMode::Map,
        Mode::Localize | Mode::Drive => {
            options.mode = v1::SessionMode::Localize;
            options.window_frames = LOCALIZING_WINDOW;
            // A bridge that is started again begins anew; one that reconnects goes on.
            options.run_id = format!("ros-{}-{}", std::process::id(), since_epoch_ms());
        }
    }
    options
}

fn since_epoch_ms() -> u128 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_millis())
}

/// Sends frames one after another, until the session is to stop.
async fn send(
    mut sender: FrameSender,
    contents: ContentMaker,
    last_committed: u64,
    outbox: Arc<Outbox>,
    shared: Shared,
    unanswered: Arc<Mutex<VecDeque<(u64, i64)>>>,
    mut stopping: watch::Receiver<bool>,
) {
    let mut sequence = last_committed;
    loop {
        let Frame { number: _, stamp_ns, image, pose } = tokio::select! {
            frame = outbox.take() => frame,
            _ = stopping.wait_for(|stops| *stops) => return,
        };
        sequence += 1;
        // Before words are made of it, which takes a while: whoever ends the session waits for it.
        unanswered.lock().unwrap_or_else(PoisonError::into_inner).push_back((sequence, stamp_ns));
        let content = match contents.content(image).await {
            Ok(content) => content,
            Err(problem) => {
                unanswered.lock().unwrap_or_else(PoisonError::into_inner).pop_back();
                sequence -= 1;
                tracing::warn!("an image gives no words: {problem}");
                shared.lock().images.bad(problem);
                continue;
            }
        };
        let frame = FrameInput {
            odometry: pose.as_ref().map(odometry_message),
            ..FrameInput::new(sequence, stamp_ns, content)
        };
        // If the session is over, its outcomes say why.
        if sender.send(frame).await.is_err() {
            return;
        }
        shared.lock().frames.sent += 1;
    }
}
