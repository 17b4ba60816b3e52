//! Goals in, and speeds out: Waypost's navigation at the wheels of a robot.

use std::time::Duration;

use futures::StreamExt;
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::{MissedTickBehavior, interval};
use waypost_bags::{Frame, Kind, live, live::LivePose};
use waypost_client::{
    Client, Command, Error, FrameContent, FrameInput, Navigation, NavigationEvent, NavigationOptions,
    Reading, v1,
};

use crate::bus::Outgoing;
use crate::camera::odometry_message;
use crate::intake::Wheels;
use crate::plan::Plan;
use crate::raw::Incoming;
use crate::session::{camera, reconnection};
use crate::settings::Settings;
use crate::state::{Declared, Shared};
use waypost_ros_messages::{Twist, Vector3};

/// 20 Hz.
const PERIOD: Duration = Duration::from_millis(50);
/// Without odometry for this long the robot stops: nobody sees any more what it does.
const ODOMETRY_PATIENCE: Duration = Duration::from_millis(500);
/// Stops that are told after a drive, before others may have the wheels: one could be lost.
const LAST_STOPS: u32 = 10;
/// About two frames a second are wanted.
const SEEING_NS: i64 = 450_000_000;
/// A navigation that the server ended is opened again after this time.
const OPENING_PAUSE: Duration = Duration::from_secs(2);
/// For the last stop to reach the wheels.
const FAREWELL: Duration = Duration::from_millis(300);
/// Goals that wait for the navigation to be open; of those only the latest counts.
const GOALS_AHEAD: usize = 8;

/// What somebody wants of the robot.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Wish {
    /// Go there.
    Go(v1::Goal),
    /// Stop.
    Stop,
}

/// Why a goal is not taken.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum NoGoal {
    /// Its message cannot be read.
    #[error("a goal cannot be read: {0}")]
    Unreadable(String),
    /// It is in a frame that is not the map's.
    #[error(
        "a goal in the frame `{found}` is not taken; give it in `{wanted}`, which is RViz's fixed frame then"
    )]
    Frame {
        /// As the goal has it.
        found: String,
        /// The map's.
        wanted: String,
    },
}

/// Takes goals from both topics, until the bridge ends.
pub(crate) async fn goals(
    mut poses: Incoming,
    mut names: Incoming,
    map_frame: String,
    shared: Shared,
    wishes: mpsc::Sender<Wish>,
) {
    loop {
        let wish = tokio::select! {
            Some(data) = poses.next() => pose_goal(&data, &map_frame, &shared),
            Some(data) = names.next() => {
                live::text(&data).map(|text| named(&text)).map_err(|problem| NoGoal::Unreadable(problem.to_string()))
            }
            else => return,
        };
        match wish {
            Ok(wish) => {
                tracing::info!("wished: {wish:?}");
                shared.lock().goal_problem = None;
                // Whoever drives has ended.
                if wishes.send(wish).await.is_err() {
                    return;
                }
            }
            Err(problem) => no_goal(&shared, problem.to_string()),
        }
    }
}

pub(crate) fn no_goal(shared: &Shared, problem: String) {
    tracing::error!("{problem}");
    shared.lock().goal_problem = Some(problem);
}

fn pose_goal(data: &[u8], map_frame: &str, shared: &Shared) -> Result<Wish, NoGoal> {
    let read = live::pose(Kind::PoseStamped, data);
    let pose = read.map_err(|problem| NoGoal::Unreadable(problem.to_string()))?;
    let part = shared.lock().placed.as_ref().map_or(0, |placed| placed.part);
    position(&pose, map_frame, part)
}

fn position(pose: &LivePose, map_frame: &str, part: u32) -> Result<Wish, NoGoal> {
    if pose.frame_id != map_frame {
        return Err(NoGoal::Frame { found: pose.frame_id.clone(), wanted: map_frame.to_owned() });
    }
    let ([x_m, y_m, _], [x, y, z, w]) = (pose.pose.position_m, pose.pose.orientation);
    let heading_rad = Some((2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)));
    let target =
        v1::goal::Target::Position(v1::PositionGoal { part, x_m: Some(x_m), y_m: Some(y_m), heading_rad });
    Ok(Wish::Go(v1::Goal { target: Some(target) }))
}

/// A place by its number or its label; an empty name is a stop.
fn named(text: &str) -> Wish {
    let text = text.trim();
    let target = match text.parse() {
        Ok(number) => v1::goal::Target::PlaceNumber(number),
        Err(_) if text.is_empty() => return Wish::Stop,
        Err(_) => v1::goal::Target::Label(text.to_owned()),
    };
    Wish::Go(v1::Goal { target: Some(target) })
}

/// Drives the robot.
pub(crate) struct Drive {
    pub(crate) client: Client,
    pub(crate) shared: Shared,
    pub(crate) declared: watch::Receiver<Declared>,
    pub(crate) wheels: broadcast::Receiver<Wheels>,
    pub(crate) seen: broadcast::Receiver<Frame>,
    pub(crate) wishes: mpsc::Receiver<Wish>,
    pub(crate) cmd_vel: Outgoing<Twist>,
    pub(crate) plans: watch::Receiver<Plan>,
    pub(crate) ending: watch::Receiver<bool>,
}

/// Where goals wait for the one who drives.
pub(crate) fn wishes() -> (mpsc::Sender<Wish>, mpsc::Receiver<Wish>) {
    mpsc::channel(GOALS_AHEAD)
}

impl Drive {
    /// Drives until the bridge ends, and leaves the robot standing.
    pub(crate) async fn run(mut self, settings: &Settings) {
        let mut ending = self.ending.clone();
        tokio::select! {
            () = self.drive(settings) => {}
            _ = ending.wait_for(|ends| *ends) => {}
        }
        self.stop();
        self.cmd_vel.flush(FAREWELL);
    }

    fn stop(&self) {
        for _ in 0..LAST_STOPS {
            self.cmd_vel.publish(Twist::default());
        }
    }

    async fn drive(&mut self, settings: &Settings) {
        let Some(camera) = camera(&mut self.declared).await else { return };
        let mut plans = self.plans.clone();
        loop {
            let Some(map) = chosen(&mut plans).await else { return };
            let clock = plans.borrow().clock;
            let mut options = NavigationOptions::new(&map, camera.clone());
            options.reconnection = reconnection();
            options.driving.speed_m_s = settings.speed_m_s;
            options.navigation_id.clone_from(&settings.session);
            let client = self.client.clone();
            let following = async {
                match client.navigate(options).await {
                    Ok(navigation) => self.follow(navigation).await,
                    Err(error) => Err(error),
                }
            };
            let ended = tokio::select! {
                ended = following => ended,
                _another = plans.wait_for(|plan| plan.map.as_ref() != Some(&map) || plan.clock != clock) => Ok(()),
            };
            self.stop();
            self.shared.lock().navigation = None;
            if let Err(error) = ended {
                no_goal(&self.shared, format!("the navigation ended: {error}"));
            }
            tokio::time::sleep(OPENING_PAUSE).await;
        }
    }

    /// # Errors
    /// Why the navigation is over.
    async fn follow(&mut self, mut navigation: Navigation) -> Result<(), Error> {
        tracing::info!("{} is open: goals are taken", navigation.opened().navigation);
        let mut due = interval(PERIOD);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut last_stops = LastStops::default();
        let mut seen_ns = i64::MIN;
        loop {
            tokio::select! {
                _ = due.tick() => self.steer(&navigation, &mut last_stops),
                wheels = self.wheels.recv() => {
                    // Late ones are of no use.
                    let Ok(Wheels { stamp_ns, pose }) = wheels else { continue };
                    let odometry = odometry_message(&pose);
                    navigation.report(Reading { stamp_ns, odometry, reflex: false });
                }
                frame = self.seen.recv() => {
                    let Ok(frame) = frame else { continue };
                    if frame.stamp_ns.saturating_sub(seen_ns) >= SEEING_NS && frame.pose.is_some() {
                        seen_ns = frame.stamp_ns;
                        navigation.see(frame_input(frame));
                    }
                }
                Some(wish) = self.wishes.recv() => match wish {
                    Wish::Go(goal) => navigation.go_to(goal).await?,
                    Wish::Stop => navigation.stop().await?,
                },
                event = navigation.next() => match event? {
                    Some(event) => self.event(event),
                    None => return Ok(()),
                },
            }
        }
    }

    fn steer(&self, navigation: &Navigation, last_stops: &mut LastStops) {
        let guidance = navigation.guidance().borrow().clone();
        let is_under_way = guidance.as_ref().is_some_and(|guidance| is_under_way(guidance.status()));
        let mut state = self.shared.lock();
        let is_blind = state.odometry.age().is_none_or(|age| age > ODOMETRY_PATIENCE);
        state.navigation = guidance;
        drop(state);
        if !is_under_way {
            if last_stops.take() {
                self.cmd_vel.publish(Twist::default());
            }
            return;
        }
        last_stops.renew();
        // A command that is asked for counts as obeyed.
        let command = if is_blind { Command::default() } else { navigation.command() };
        self.cmd_vel.publish(twist(command));
    }

    fn event(&self, event: NavigationEvent) {
        match event {
            NavigationEvent::GoalRefused(refusal) => {
                let why = refusal.status.map(|status| status.message).unwrap_or_default();
                no_goal(&self.shared, format!("the goal is refused: {why}"));
            }
            NavigationEvent::FrameRefused(refusal) => {
                let why = refusal.status.map(|status| status.message).unwrap_or_default();
                tracing::warn!("a frame is refused while driving: {why}");
            }
            NavigationEvent::WheelsRefused(refusal) => {
                let why = refusal.status.map(|status| status.message).unwrap_or_default();
                tracing::warn!("odometry is refused while driving: {why}");
            }
            NavigationEvent::Disconnected { reason } => {
                tracing::warn!("the robot stands: the server was lost ({reason})");
            }
            NavigationEvent::Reconnected { resumed } => {
                tracing::info!(
                    "the server is back; the navigation {}",
                    if resumed { "goes on" } else { "begins anew" }
                );
            }
            NavigationEvent::Seen(_) => {}
        }
    }
}

/// The map, once there is one; none when the bridge ends.
async fn chosen(plans: &mut watch::Receiver<Plan>) -> Option<String> {
    plans.wait_for(|plan| plan.map.is_some()).await.ok()?.map.clone()
}

fn frame_input(Frame { number, stamp_ns, image, pose }: Frame) -> FrameInput {
    FrameInput {
        odometry: pose.as_ref().map(odometry_message),
        ..FrameInput::new(number, stamp_ns, FrameContent::Image(image))
    }
}

fn twist(Command { forward_m_s, turn_rad_s }: Command) -> Twist {
    Twist {
        linear: Vector3 { x: forward_m_s, ..Vector3::default() },
        angular: Vector3 { z: turn_rad_s, ..Vector3::default() },
    }
}

/// Whether the robot has a goal that it has not reached.
fn is_under_way(status: v1::NavigationStatus) -> bool {
    use v1::NavigationStatus::{Arrived, Blocked, Following, Idle, Lost, Searching, Unspecified};
    match status {
        Following | Searching | Lost | Blocked => true,
        Idle | Arrived | Unspecified => false,
    }
}

/// Stops that are told after a drive, and at the beginning; then others may have the wheels.
struct LastStops {
    left: u32,
}

impl Default for LastStops {
    fn default() -> Self {
        Self { left: LAST_STOPS }
    }
}

impl LastStops {
    /// The robot drives: all of them are needed after it.
    fn renew(&mut self) {
        self.left = LAST_STOPS;
    }

    /// Takes one, if one is left.
    fn take(&mut self) -> bool {
        let is_left = self.left > 0;
        self.left = self.left.saturating_sub(1);
        is_left
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use waypost_bags::Pose;

    fn goal(target: v1::goal::Target) -> Wish {
        Wish::Go(v1::Goal { target: Some(target) })
    }

    #[test]
    fn a_name_is_a_place_or_a_label_and_nothing_is_a_stop() {
        assert_eq!(named(" 12 "), goal(v1::goal::Target::PlaceNumber(12)));
        assert_eq!(named("kitchen"), goal(v1::goal::Target::Label("kitchen".to_owned())));
        assert_eq!(named(" "), Wish::Stop);
    }

    #[test]
    fn a_pose_is_a_goal_with_a_heading_in_the_maps_frame_alone() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let pose = Pose { position_m: [1.0, 2.0, 0.0], orientation: [0.0, 0.0, half, half] };
        let frame_id = "map".to_owned();
        let goal = LivePose { stamp_ns: 1, frame_id, child_frame: String::new(), pose };
        let Ok(Wish::Go(v1::Goal { target: Some(v1::goal::Target::Position(position)) })) =
            super::position(&goal, "map", 3)
        else {
            panic!("no position");
        };
        assert_eq!((position.part, position.x_m, position.y_m), (3, Some(1.0), Some(2.0)));
        assert!((position.heading_rad.unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let other = LivePose { frame_id: "odom".to_owned(), ..goal };
        let told = super::position(&other, "map", 0).unwrap_err().to_string();
        assert!(told.contains("`odom` is not taken; give it in `map`"), "{told}");
    }

    #[test]
    fn after_a_drive_a_few_stops_are_told_and_then_nothing() {
        let mut last_stops = LastStops::default();
        assert_eq!((0..40).filter(|_| last_stops.take()).count(), LAST_STOPS as usize);
        last_stops.renew();
        assert_eq!((0..40).filter(|_| last_stops.take()).count(), LAST_STOPS as usize);
    }
}
