//! A robot that the server leads through the building of the map that nobody writes to.

use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};
use rand::RngExt;
use tokio::task::JoinHandle;
use tokio::time::{MissedTickBehavior, interval};
use waypost_client::{
    Error, FrameInput, Navigation, NavigationEvent, NavigationOptions, Reading, Reconnection, v1,
};
use waypost_sim::drive::TWICE_A_SECOND;
use waypost_sim::robot::{Command, WheelErrors};
use waypost_sim::simulation::{Obedience, Simulation};

use super::material::{Material, odometry, seen};
use super::robots::HOME;
use super::stage::Caller;

/// Longest way to one goal.
const LEG: Duration = Duration::from_secs(20);

/// A command holds for half a second from its arrival; what is left is for messages that are on their way and for
/// machines that are busy.
const LAPSED: Duration = Duration::from_millis(1000);

/// Steps of 20 ms from wheel report to wheel report.
const STEPS_PER_REPORT: u64 = 2;

/// Led from the way's start to one place after the other.
pub(super) async fn led(caller: &Caller, material: &Material) -> Result<()> {
    let mut random = caller.stage.random(400);
    let places = caller.read("places listed", async |client| client.places(HOME).await).await?.len();
    while let Some(_step) = caller.stage.step().await {
        let goal = random.random_range(0..places.min(10)) as u32;
        let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(goal)) };
        let reconnection = Reconnection { longest_delay: Duration::from_secs(1), ..Reconnection::default() };
        let options = NavigationOptions {
            navigation_id: "cart".to_owned(),
            goal: Some(goal.clone()),
            reconnection,
            ..NavigationOptions::new(HOME, material.camera.clone())
        };
        let navigation = match caller.client.navigate(options).await {
            Ok(navigation) => navigation,
            // The stream of the leg before is ending still.
            Err(Error::Status { code: waypost_client::Code::FailedPrecondition, .. }) => {
                caller.stage.count("legs put off");
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let seed = random.random_range(0..1_000_000);
        let robot = material.building.robot(WheelErrors::drawn(seed), seed, TWICE_A_SECOND)?;
        drive(caller, material, robot, navigation, goal).await?;
    }
    Ok(())
}

/// One leg: commands are obeyed in real time, and none of them when it has lapsed.
async fn drive(
    caller: &Caller,
    material: &Material,
    mut robot: Simulation,
    mut navigation: Navigation,
    goal: v1::Goal,
) -> Result<()> {
    let mut steps = interval(Duration::from_nanos(robot.settings().period_ns.unsigned_abs()));
    steps.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut guidance = navigation.guidance();
    let began = Instant::now();
    let mut told_at = began;
    let mut obeyed_lapsed = false;
    let mut developing: Option<JoinHandle<Result<FrameInput>>> = None;
    let mut step = 0_u64;
    while began.elapsed() < LEG {
        steps.tick().await;
        // Asked for first: a command that comes after this is obeyed in the next step.
        let command = navigation.command();
        let told = {
            let told = guidance.borrow_and_update();
            if told.has_changed() {
                told_at = Instant::now();
            }
            told.clone().unwrap_or_default()
        };
        let moves = command != waypost_client::Command::default();
        let down = caller.stage.down_for().unwrap_or_default();
        let ago = told_at.elapsed().max(down);
        // The client has a command a moment before its guidance: what has lapsed is still obeyed in the next step.
        let obeys_lapsed = moves && ago >= LAPSED;
        ensure!(
            !(obeys_lapsed && obeyed_lapsed),
            "a robot obeys a command that came {:?} ago, of a server that ended {down:?} ago",
            told_at.elapsed()
        );
        obeyed_lapsed = obeys_lapsed;
        if !moves && down > LAPSED {
            caller.stage.count("steps of robots that stand without a server");
        }
        let valid_ns = 2 * robot.settings().period_ns;
        robot.command(Command { forward_m_s: command.forward_m_s, turn_rad_s: command.turn_rad_s, valid_ns });
        let tick = robot.advance();
        if step.is_multiple_of(STEPS_PER_REPORT) {
            let reflex = tick.obedience == Obedience::Reflex;
            navigation.report(Reading {
                stamp_ns: tick.stamp_ns + 1,
                odometry: odometry(&tick.odometry),
                reflex,
            });
        }
        step += 1;
        if let Some(frame) = tick.frame.filter(|_| developing.is_none()) {
            let building = material.building.clone();
            developing = Some(tokio::task::spawn_blocking(move || seen(&building, &frame)));
        }
        if let Some(taken) = developing.take_if(|taken| taken.is_finished()) {
            navigation.see(taken.await??);
        }
        while let Some(event) = navigation.try_next() {
            met(caller, &mut navigation, event, &goal).await?;
        }
        if told.status() == v1::NavigationStatus::Arrived {
            caller.stage.count("legs, arrived");
            return Ok(());
        }
    }
    caller.stage.count("legs, not at their goal in time");
    Ok(())
}

async fn met(
    caller: &Caller,
    navigation: &mut Navigation,
    event: NavigationEvent,
    goal: &v1::Goal,
) -> Result<()> {
    match event {
        NavigationEvent::Seen(seen) => {
            let what = if seen.place_number.is_some() { "seen, a place" } else { "seen, no place" };
            caller.stage.count(what);
        }
        NavigationEvent::Reconnected { resumed: false } => navigation.go_to(goal.clone()).await?,
        NavigationEvent::Disconnected { .. } | NavigationEvent::Reconnected { resumed: true } => {}
        // Of a robot that is lost, or was carried off by its own wheels.
        NavigationEvent::GoalRefused(_) => caller.stage.count("goals refused"),
        NavigationEvent::FrameRefused(refusal) => bail!("a led robot's frame was refused: {refusal:?}"),
        NavigationEvent::WheelsRefused(refusal) => bail!("a wheel report was refused: {refusal:?}"),
    }
    Ok(())
}
