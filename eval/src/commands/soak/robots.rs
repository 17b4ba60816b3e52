//! Robots that stream: words, images in metres, panoramas, and those that only look.

use std::time::Duration;

use anyhow::{Result, anyhow, bail, ensure};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use tokio::sync::RwLock;
use tokio::time::{MissedTickBehavior, interval};
use waypost_client::v1::trim_map_request::Mode;
use waypost_client::{Client, FrameInput, FrameOutcome, Reconnection, SessionOptions, v1};

use super::material::Material;
use super::stage::Caller;

/// The map that is made once, and that nobody writes to afterwards.
pub(super) const HOME: &str = "home";

/// The map that all robots with words share.
pub(super) const WORDS: &str = "words";

/// Frames of a robot with words in one session, and its sessions that are kept.
const WORDS_FRAMES: usize = 40;
const WORDS_SESSIONS: u64 = 2;
const WORDS_PLACES: u32 = 60;

/// Frames that are sent again after each drive.
const SENT_AGAIN: usize = 4;

/// From frame to frame.
pub(super) const AT_ONCE: Duration = Duration::from_millis(1);
const OF_WORDS: Duration = Duration::from_millis(50);
pub(super) const OF_IMAGES: Duration = Duration::from_millis(100);
const OF_LOOKS: Duration = Duration::from_millis(150);

/// A session of that name, whose robot comes back soon.
pub(super) fn session(map: &str, name: &str) -> SessionOptions {
    let reconnection = Reconnection { longest_delay: Duration::from_secs(1), ..Reconnection::default() };
    SessionOptions { session_id: name.to_owned(), reconnection, ..SessionOptions::new(map) }
}

/// A map with all defaults, if it is not there.
pub(super) async fn make(caller: &Caller, map: &str, settings: Option<v1::MapSettings>) -> Result<()> {
    let request = v1::CreateMapRequest { map_id: map.to_owned(), model: String::new(), settings };
    caller.ask("maps made", async |client| client.create_map(request.clone()).await).await.map(drop)
}

/// Streams frames at a pace; their answers, which all get.
pub(super) async fn drive(
    caller: &Caller,
    options: SessionOptions,
    frames: &[FrameInput],
    period: Duration,
) -> Result<Vec<v1::FrameAnswer>> {
    let name = format!("{}, session {}", options.map, options.session_id);
    let (mut sender, mut outcomes) = caller.client.open_session(options).await?.split();
    let sending = async move {
        let mut pace = interval(period);
        pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        for frame in frames {
            pace.tick().await;
            sender.send(frame.clone()).await?;
        }
        Ok::<(), anyhow::Error>(())
    };
    let receiving = async move {
        let mut answers = Vec::new();
        while let Some(outcome) = outcomes.next().await? {
            match outcome {
                FrameOutcome::Answer(answer) => answers.push(answer),
                FrameOutcome::Refusal(refusal) => {
                    bail!("frame {} was refused: {refusal:?}", refusal.sequence)
                }
            }
        }
        Ok(answers)
    };
    let (sent, answers) = tokio::join!(sending, receiving);
    let answers: Vec<v1::FrameAnswer> = answers.map_err(|error| error.context(name.clone()))?;
    sent?;
    let [sent, answered] =
        [frames.iter().map(|frame| frame.sequence).collect(), sequences(&answers)].map(|of: Vec<u64>| of);
    ensure!(sent == answered, "{name}: {sent:?} were sent, {answered:?} answered");
    caller.stage.count_many("frames answered", answers.len());
    Ok(answers)
}

fn sequences(answers: &[v1::FrameAnswer]) -> Vec<u64> {
    answers.iter().map(|answer| answer.sequence).collect()
}

/// An answer but for what is of the moment.
fn decided(answer: &v1::FrameAnswer) -> v1::FrameAnswer {
    let answer = answer.clone();
    v1::FrameAnswer { last_committed_sequence: 0, timings: None, resent: false, map_pose: None, ..answer }
}

fn alike(name: &str, before: &[v1::FrameAnswer], now: &[v1::FrameAnswer]) -> Result<()> {
    ensure!(
        sequences(before) == sequences(now),
        "{name}: frames {:?} were acknowledged, and there are {:?}",
        sequences(before),
        sequences(now)
    );
    let differing = before.iter().zip(now).find(|(before, now)| decided(before) != decided(now));
    differing.map_or(Ok(()), |(before, now)| {
        Err(anyhow!("{name}: a frame is answered otherwise: {before:?}, then {now:?}"))
    })
}

/// Each frame that was acknowledged is there once, as it was answered, and is answered alike when it is sent again.
pub(super) async fn kept(
    caller: &Caller,
    options: SessionOptions,
    frames: &[FrameInput],
    answers: &[v1::FrameAnswer],
    random: &mut ChaCha8Rng,
) -> Result<()> {
    let name = format!("{}/sessions/{}", options.map, options.session_id);
    let listed = caller.read("sessions read through", async |client| client.frames(&name).await).await?;
    let listed: Vec<v1::FrameAnswer> = listed.into_iter().filter_map(|frame| frame.answer).collect();
    alike(&name, answers, &listed)?;
    let mut chosen: Vec<usize> = (0..SENT_AGAIN).map(|_| random.random_range(0..frames.len())).collect();
    chosen.sort_unstable();
    chosen.dedup();
    let again: Vec<FrameInput> = chosen.iter().map(|&index| frames[index].clone()).collect();
    let before: Vec<v1::FrameAnswer> = chosen.iter().map(|&index| answers[index].clone()).collect();
    let now = drive(caller, options, &again, AT_ONCE).await?;
    alike(&name, &before, &now)?;
    let new = now.iter().find(|answer| !answer.resent);
    caller.stage.count_many("frames sent again", now.len());
    new.map_or(Ok(()), |new| Err(anyhow!("{name}: frame {} was lost", new.sequence)))
}

/// Words of one robot, round and round, into a map that is kept small; others do the same.
pub(super) async fn words(
    caller: &Caller,
    material: &Material,
    robot: u64,
    rewriting: &RwLock<()>,
) -> Result<()> {
    let mut random = caller.stage.random(100 + robot);
    let mut number = 0;
    while let Some(_step) = caller.stage.step().await {
        number += 1;
        let of_map = rewriting.read().await;
        let options = SessionOptions {
            words_hash: material.words_hash.clone(),
            ..session(WORDS, &format!("robot-{robot}-{number}"))
        };
        let first = random.random_range(0..material.words.len().saturating_sub(WORDS_FRAMES).max(1));
        let frames = &material.words[first..material.words.len().min(first + WORDS_FRAMES)];
        let answers = drive(caller, options.clone(), frames, OF_WORDS).await?;
        kept(caller, options, frames, &answers, &mut random).await?;
        drop(of_map);
        // What follows changes how the frames of others are told: places get other numbers.
        let _whole_map = rewriting.write().await;
        if number > WORDS_SESSIONS {
            let old = format!("maps/{WORDS}/sessions/robot-{robot}-{}", number - WORDS_SESSIONS);
            let delete = async |client: &Client| client.delete_session(&old).await.map(|job| job.name);
            let is_there = async |client: &Client| {
                let sessions = client.sessions(WORDS).await?;
                Ok(sessions.iter().any(|session| session.name == old))
            };
            // Cut off, it is asked for again.
            while caller.read("sessions listed", is_there).await? {
                caller.job("sessions deleted", delete).await?;
            }
            let left = caller.read("sessions listed", async |client| client.sessions(WORDS).await).await?;
            let own =
                left.iter().filter(|session| session.name.contains(&format!("/robot-{robot}-"))).count();
            ensure!(
                own as u64 == WORDS_SESSIONS,
                "{own} sessions of robot {robot} are left of {WORDS_SESSIONS}: {left:?}"
            );
        }
        if random.random_range(0..3) == 0 {
            let name = format!("maps/{WORDS}");
            let trim = v1::TrimMapRequest { name, max_places: WORDS_PLACES, mode: Mode::Apply.into() };
            caller.ask("maps trimmed", async |client| client.trim_map(trim.clone()).await).await?;
        }
        if random.random_range(0..3) == 0 {
            let before = caller.state_hash(WORDS).await?;
            caller.job("maps compacted", async |client| Ok(client.compact_map(WORDS).await?.name)).await?;
            let now = caller.state_hash(WORDS).await?;
            ensure!(before == now, "a map that was compacted is another: {before}, then {now}");
        }
    }
    Ok(())
}

/// Looks at the map that nobody writes to: what is seen from one life of the server to its end is answered alike.
pub(super) async fn localizing(caller: &Caller, material: &Material) -> Result<()> {
    let frames: Vec<FrameInput> = material.drive.iter().step_by(3).cloned().collect();
    let mut first: Option<Vec<v1::FrameAnswer>> = None;
    let mut run = 0;
    while let Some(_step) = caller.stage.step().await {
        run += 1;
        let options = SessionOptions {
            mode: v1::SessionMode::Localize,
            run_id: format!("run-{run}"),
            camera: Some(material.camera.clone()),
            ..session(HOME, "looker")
        };
        let lives = caller.stage.lives();
        let answers = drive(caller, options, &frames, OF_LOOKS).await?;
        if lives != caller.stage.lives() {
            caller.stage.count("looks around, cut off");
            continue;
        }
        caller.stage.count("looks around");
        alike("a look around", first.get_or_insert_with(|| answers.clone()), &answers)?;
    }
    Ok(())
}

/// Panoramas into a map that is navigated by appearance, which is made and deleted.
pub(super) async fn panoramic(caller: &Caller, material: &Material) -> Result<()> {
    const MAP: &str = "looks";
    let mut random = caller.stage.random(300);
    let settings = v1::MapSettings {
        navigation_strategy: v1::map_settings::NavigationStrategy::Appearance.into(),
        ..v1::MapSettings::default()
    };
    let mut links = None;
    while let Some(_step) = caller.stage.step().await {
        make(caller, MAP, Some(settings)).await?;
        let camera = Some(material.panoramic_camera.clone());
        let options = SessionOptions { camera, ..session(MAP, "robot") };
        let answers = drive(caller, options.clone(), &material.panoramas, OF_LOOKS).await?;
        kept(caller, options, &material.panoramas, &answers, &mut random).await?;
        let graph =
            caller.read("appearance graphs", async |client| client.appearance_graph(MAP).await).await?;
        let before = *links.get_or_insert(graph.links.len());
        ensure!(
            before == graph.links.len() && before > 0,
            "the same panoramas had {before} links, and have {}",
            graph.links.len()
        );
        caller.ask("maps deleted", async |client| client.delete_map(MAP).await).await?;
    }
    Ok(())
}
