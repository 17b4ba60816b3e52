//! Goals by name for Nav2, which drives the robot: its action `NavigateToPose`.

use std::pin::Pin;
use std::time::Duration;

use futures::{Stream, StreamExt};
use tokio::sync::{mpsc, watch};
use tokio::time::{MissedTickBehavior, interval, timeout};
use waypost_client::{Client, v1};
use waypost_ros_messages::{
    CancelGoal, CancelWanted, FEEDBACK, Feedback, GetResult, GoalId, GoalTaken, GoalWanted, Header, Outcome,
    Pose, PoseStamped, ResultWanted, SendGoal, Time, decoded,
};

use crate::asks::{Asks, Ticket};
use crate::bus::{Bus, BusError};
use crate::drive::{Wish, no_goal};
use crate::names::{in_dds, type_in_dds};
use crate::plan::Plan;
use crate::raw::Sample;
use crate::state::{Placed, Shared};

/// For Nav2 to say whether it takes a goal, or cancels one.
const ANSWER_PATIENCE: Duration = Duration::from_secs(5);
/// How often it is looked whether Nav2 is there.
const LOOKING_PERIOD: Duration = Duration::from_secs(1);
/// For a goal to be cancelled when the bridge ends.
const FAREWELL: Duration = Duration::from_secs(1);

/// A goal that Nav2 has taken.
#[derive(Clone, Copy)]
struct Active {
    goal_id: GoalId,
    /// Of its result.
    ticket: Ticket,
}

/// What Nav2 is told and tells.
pub(crate) struct Action {
    name: String,
    send_goal: Asks<SendGoal>,
    get_result: Asks<GetResult>,
    cancel_goal: Asks<CancelGoal>,
    feedback: Pin<Box<dyn Stream<Item = Result<Sample, String>> + Send>>,
}

impl Action {
    /// Of a name as in `/navigate_to_pose`.
    pub(crate) fn of(bus: &Bus, name: &str) -> Result<Self, BusError> {
        let part = |part: &str| format!("{name}/_action/{part}");
        // Whoever asks is told from others by a number.
        let caller = getrandom::u64().unwrap_or_else(|_none| u64::from(std::process::id()));
        let (feedback, _) = bus.read_raw(&in_dds(&part("feedback")), &type_in_dds(FEEDBACK))?;
        Ok(Self {
            name: name.to_owned(),
            send_goal: Asks::of(bus, &part("send_goal"), caller)?,
            get_result: Asks::of(bus, &part("get_result"), caller)?,
            cancel_goal: Asks::of(bus, &part("cancel_goal"), caller)?,
            feedback: Box::pin(feedback),
        })
    }

    /// # Errors
    /// If Nav2 is not there, or does not take it.
    async fn begin(&mut self, pose: PoseStamped) -> Result<Active, String> {
        let goal_id = goal_id()?;
        let wanted = GoalWanted { goal_id, pose, behavior_tree: String::new() };
        let ticket = self.send_goal.ask(&wanted).await?;
        let answer = timeout(ANSWER_PATIENCE, self.send_goal.answer(ticket)).await;
        let answer = answer.map_err(|_elapsed| format!("Nav2 does not answer at {}", self.name))?;
        let GoalTaken { accepted, .. } = decoded(&answer).map_err(|error| error.to_string())?;
        if !accepted {
            return Err("Nav2 refuses the goal; its log says why: it may not be active yet".to_owned());
        }
        Ok(Active { goal_id, ticket: self.get_result.ask(&ResultWanted { goal_id }).await? })
    }

    async fn cancel(&mut self, Active { goal_id, .. }: Active) -> Result<(), String> {
        let ticket = self.cancel_goal.ask(&CancelWanted { goal_id, stamp: Time::of_ns(0) }).await?;
        let answer = timeout(ANSWER_PATIENCE, self.cancel_goal.answer(ticket)).await;
        let answer =
            answer.map_err(|_elapsed| "Nav2 does not answer whether it cancels the goal".to_owned())?;
        match decoded::<i8>(&answer) {
            Ok(0) => Ok(()),
            Ok(code) => Err(format!("Nav2 does not cancel the goal (return code {code})")),
            Err(error) => Err(error.to_string()),
        }
    }
}

fn goal_id() -> Result<GoalId, String> {
    let mut id = GoalId::default();
    getrandom::fill(&mut id).map_err(|error| format!("the system has no random numbers: {error}"))?;
    Ok(id)
}

/// Hands goals to Nav2.
pub(crate) struct Nav2 {
    pub(crate) client: Client,
    pub(crate) shared: Shared,
    pub(crate) plans: watch::Receiver<Plan>,
    pub(crate) map_frame: String,
    pub(crate) action: Action,
    pub(crate) wishes: mpsc::Receiver<Wish>,
    pub(crate) ending: watch::Receiver<bool>,
}

/// What has happened.
enum Happened {
    Wished(Wish),
    Over(Result<Outcome, String>),
    Told(Sample),
    Looked,
    Ended,
}

impl Nav2 {
    /// Hands goals over until the bridge ends, and cancels the last.
    pub(crate) async fn run(mut self) {
        let mut active: Option<Active> = None;
        let mut due = interval(LOOKING_PERIOD);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.tell(v1::NavigationStatus::Idle, None, None);
        loop {
            match self.happened(active, &mut due).await {
                Happened::Wished(Wish::Go(goal)) => match self.go(goal).await {
                    Ok(taken) => active = Some(taken),
                    Err(problem) => no_goal(&self.shared, problem),
                },
                Happened::Wished(Wish::Stop) => {
                    if let Some(problem) = self.stop(active).await {
                        no_goal(&self.shared, problem);
                    }
                }
                Happened::Over(outcome) => {
                    active = None;
                    self.over(outcome);
                }
                Happened::Told(sample) => self.told(active, &sample),
                Happened::Looked => {
                    if active.is_some() && self.action.send_goal.server().is_none() {
                        active = None;
                        let gone =
                            "Nav2 has gone while it drove the robot; start it again, and give the goal again";
                        self.tell(v1::NavigationStatus::Blocked, None, Some(gone.to_owned()));
                    }
                }
                Happened::Ended => break,
            }
        }
        // The bridge ends in any case.
        let _ = timeout(FAREWELL, self.stop(active)).await;
    }

    async fn happened(&mut self, active: Option<Active>, due: &mut tokio::time::Interval) -> Happened {
        let Action { get_result, feedback, .. } = &mut self.action;
        let over = async {
            match active {
                Some(Active { ticket, .. }) => {
                    let answer = get_result.answer(ticket).await;
                    Outcome::read(&answer).map_err(|error| format!("Nav2's result cannot be read: {error}"))
                }
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            Some(wish) = self.wishes.recv() => Happened::Wished(wish),
            outcome = over => Happened::Over(outcome),
            Some(Ok(sample)) = feedback.next() => Happened::Told(sample),
            _ = due.tick() => Happened::Looked,
            _ = self.ending.wait_for(|ends| *ends) => Happened::Ended,
        }
    }

    async fn go(&mut self, goal: v1::Goal) -> Result<Active, String> {
        let pose = self.pose_of(goal).await?;
        let header = Header { frame_id: self.map_frame.clone(), ..Header::default() };
        let taken = self.action.begin(PoseStamped { header, pose }).await?;
        self.tell(v1::NavigationStatus::Following, None, None);
        Ok(taken)
    }

    async fn stop(&mut self, active: Option<Active>) -> Option<String> {
        self.action.cancel(active?).await.err()
    }

    fn over(&self, outcome: Result<Outcome, String>) {
        use v1::NavigationStatus::{Arrived, Blocked, Idle};
        match outcome {
            Ok(Outcome::Succeeded) => self.tell(Arrived, None, None),
            Ok(Outcome::Canceled) => self.tell(Idle, None, None),
            Ok(Outcome::Aborted { code, message }) => {
                let code = if code == 0 { String::new() } else { format!(" with code {code}") };
                let said = if message.is_empty() { "its log says why".to_owned() } else { message };
                self.tell(Blocked, None, Some(format!("Nav2 gave up{code}: {said}")));
            }
            Err(problem) => no_goal(&self.shared, problem),
        }
    }

    fn told(&self, active: Option<Active>, sample: &Sample) {
        let Ok(Feedback { goal_id, distance_remaining, .. }) = decoded(&sample.data) else { return };
        if active.is_some_and(|active| active.goal_id == goal_id) {
            self.tell(v1::NavigationStatus::Following, Some(f64::from(distance_remaining)), None);
        }
    }

    fn tell(&self, status: v1::NavigationStatus, remaining_m: Option<f64>, detail: Option<String>) {
        if let Some(detail) = &detail {
            tracing::warn!("{detail}");
        }
        let guidance = v1::Guidance { status: status.into(), remaining_m, detail, ..v1::Guidance::default() };
        self.shared.lock().navigation = Some(guidance);
    }

    /// Where a place is in the frame that the robot has on the map.
    async fn pose_of(&mut self, v1::Goal { target }: v1::Goal) -> Result<Pose, String> {
        use v1::goal::Target::{Label, PlaceNumber};
        let map = self.plans.borrow().map.clone();
        let map = map.ok_or_else(|| "there is no map yet to find the goal on".to_owned())?;
        let placed = self.shared.lock().placed.clone();
        let placed = placed.ok_or_else(|| {
            "it is not known yet where the robot is on the map: drive it by hand until it is recognised"
                .to_owned()
        })?;
        let places = self.client.places(&map).await.map_err(|error| error.to_string())?;
        let name = |number: u32| format!("maps/{map}/places/{number}");
        let named = match &target {
            Some(PlaceNumber(number)) => vec![name(*number)],
            Some(Label(label)) => {
                let labels = self.client.labels(&map).await.map_err(|error| error.to_string())?;
                labels.into_iter().filter(|found| found.label == *label).map(|found| found.place).collect()
            }
            _ => return Err("Nav2 takes goals in metres itself, by its own goal_pose".to_owned()),
        };
        let wanted = match &target {
            Some(PlaceNumber(number)) => format!("place {number}"),
            Some(Label(label)) => format!("place that is called `{label}`"),
            _ => String::new(),
        };
        nearest(&places, &named, &placed).ok_or_else(|| {
            format!(
                "the part of the map that the robot is in has no {wanted}; `waypost map show` lists places"
            )
        })
    }
}

/// The pose of the nearest of some places in the robot's part of the map.
fn nearest(places: &[v1::Place], named: &[String], placed: &Placed) -> Option<Pose> {
    let poses = places.iter().filter(|place| named.contains(&place.name)).filter_map(|place| {
        let pose = place.pose.as_ref().filter(|pose| pose.part == placed.part)?;
        Pose::of(pose.pose.as_ref()?)
    });
    let distance = |pose: &Pose| {
        let (there, here) = (pose.position, placed.robot.position);
        (there.x - here.x).hypot(there.y - here.y)
    };
    poses.min_by(|one, other| distance(one).total_cmp(&distance(other)))
}
