// long: the life of one led robot, from its first image to its last command.
//! A robot that is led along places that wheels measured. Commands come of odometry at once, beside the stream; the map's
//! writer is asked for looks and plans alone.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fabmap::appearance::PlaceId;
use tokio::sync::watch;
use topomap::ids::SessionId;
use topomap::mapper::{FrameInput, Localizer};
use topomap::metric::{Odometry, OdometryNoise};
use waypost_navigation::metric::planning::{self, PlanError, Route};
use waypost_navigation::metric::settings::{NavigationSettings, PlanningSettings};
use waypost_navigation::metric::{Lookout, Navigator, Reason, Sight, Status, WheelReport};

use super::asked::AskedGoals;
use super::{
    BodyReport, Driving, FrameSeen, Goal, GoalRefusal, GoalRequest, Identity, Navigation, NavigationView,
    Told,
};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::Tracker;
use crate::ingest::content::Words;
use crate::ingest::intrinsics::Intrinsics;
use crate::ingest::observed::Observed;
use crate::map_settings::{Keep, MapSettings};
use crate::names::navigation_name;
use crate::open_map::{LookRequest, Looked, PlanFrom};
use crate::service::sessions::Frame;
use crate::storage::MapRow;

/// Leads one robot.
#[derive(Debug)]
pub(super) struct TopoMetricGuide {
    identity: Identity,
    intrinsics: Intrinsics,
    settings: NavigationSettings,
    /// Of the map: odometry that is faster has jumped.
    max_speed_m_per_s: f64,
    /// One frame is looked at after the other.
    eyes: tokio::sync::Mutex<Eyes>,
    state: Mutex<State>,
    refusals: watch::Sender<Option<GoalRefusal>>,
}

/// What is remembered of the frames that the robot has sent.
#[derive(Debug)]
struct Eyes {
    lookout: Lookout,
    tracker: Tracker,
}

#[derive(Debug)]
struct State {
    navigator: Navigator,
    last_report: Option<(i64, Odometry)>,
    told: Option<Told>,
    goals: AskedGoals,
    goal: Option<MeasuredGoal>,
    /// Where it was going until it was sent there, for as long as no way there is planned.
    goal_before: Option<MeasuredGoal>,
    route: Option<Route>,
    goal_refusal: Option<GoalRefusal>,
    planning: Planning,
    last_sequence: Option<u64>,
    frames: u64,
    closures: u64,
}

/// Where to go, and where to look there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeasuredGoal {
    pub(super) goal: planning::Goal,
    heading_rad: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Planning {
    No,
    UnderWay,
}

impl State {
    /// What was said of the goal before counts no more: a caller that waits for the arrival must not take it for that at this one.
    fn set_out(&mut self, goal: MeasuredGoal) {
        match goal.heading_rad {
            None => self.navigator.go_to(goal.goal),
            // Looked at when it came in: it is finite.
            Some(heading_rad) => {
                if let Err(error) = self.navigator.go_to_facing(goal.goal, heading_rad) {
                    tracing::error!(%error, "a goal's heading was not checked");
                }
            }
        }
        (self.goal, self.route, self.told) = (Some(goal), None, None);
    }
}

impl MeasuredGoal {
    fn place(place: PlaceId) -> Self {
        Self { goal: planning::Goal::Place(place), heading_rad: None }
    }
}

impl From<MeasuredGoal> for Goal {
    fn from(MeasuredGoal { goal, heading_rad }: MeasuredGoal) -> Self {
        match goal {
            planning::Goal::Place(place) => Self::Place(place),
            planning::Goal::Position { part, position_m } => Self::Position { part, position_m, heading_rad },
        }
    }
}

/// Refuses a camera, and a map, by which no robot can be steered.
pub(super) fn check(map: &str, camera: Option<&Camera>, settings: &MapSettings) -> Result<(), ServiceError> {
    intrinsics(camera)?;
    if settings.mapper.verification.method.verifies() {
        return Ok(());
    }
    Err(ServiceError::precondition(format_args!(
        "the map {map} recognises by words alone, and by words no robot can be steered; make a map with verification"
    )))
}

fn intrinsics(camera: Option<&Camera>) -> Result<Intrinsics, ServiceError> {
    camera.and_then(Intrinsics::of_camera).ok_or_else(|| {
        ServiceError::invalid(
            "a robot is steered by how far its image has shifted: declare a camera with a pinhole calibration or a \
             field of view; panoramas are for maps with the navigation strategy appearance",
        )
    })
}

impl Navigation {
    /// A goal on a map with metres, which a robot may be sent to.
    async fn measured_goal(&self, row: &MapRow, goal: GoalRequest) -> Result<MeasuredGoal, ServiceError> {
        let goal = self.meant_goal(row, goal).await?;
        let map = self.open_maps.open_of(row).await?;
        map.check_goal(goal.goal, PlanningSettings::default()).await?.map_err(not_planned)?;
        Ok(goal)
    }

    /// The place or the position that is meant, whether there is one or not.
    pub(super) async fn meant_goal(
        &self,
        row: &MapRow,
        goal: GoalRequest,
    ) -> Result<MeasuredGoal, ServiceError> {
        let goal = match goal {
            GoalRequest::Goal(Goal::Place(place)) => MeasuredGoal::place(place),
            GoalRequest::Goal(Goal::Position { part, position_m, heading_rad }) => {
                MeasuredGoal { goal: planning::Goal::Position { part, position_m }, heading_rad }
            }
            GoalRequest::Goal(Goal::Label(label)) => {
                match self.labels.labelled(row, &label).await?.as_slice() {
                    [place] => MeasuredGoal::place(*place),
                    places => {
                        let numbers: Vec<String> = places.iter().map(PlaceId::to_string).collect();
                        return Err(ServiceError::precondition(format_args!(
                            "{label:?} are {} places of the map {}, and a robot goes to one: name it by its number ({})",
                            places.len(),
                            row.name,
                            numbers.join(", ")
                        )));
                    }
                }
            }
            GoalRequest::Image(_) => {
                return Err(ServiceError::precondition(format_args!(
                    "where an image was taken is a goal on maps with the navigation strategy appearance; on the map {} \
                     ask with a query which place it shows, and go there",
                    row.name
                )));
            }
        };
        Ok(goal)
    }
}

/// Why there is no way, as a refusal.
pub(super) fn not_planned(error: PlanError) -> ServiceError {
    match error {
        PlanError::UnknownPlace { .. } | PlanError::UnknownPart { .. } => ServiceError::not_found(error),
        PlanError::NotFinite => ServiceError::invalid(error),
        PlanError::NoMetres
        | PlanError::Unmeasured { .. }
        | PlanError::GoalTooFar { .. }
        | PlanError::OtherPart { .. }
        | PlanError::OneWay { .. }
        | PlanError::TooFar { .. } => ServiceError::precondition(error),
    }
}

impl TopoMetricGuide {
    pub(super) fn new(
        identity: Identity,
        camera: Option<&Camera>,
        driving: Driving,
        max_speed_m_per_s: f64,
    ) -> Result<Self, ServiceError> {
        let intrinsics = intrinsics(camera)?;
        let settings = driving.settings()?;
        let navigator = Navigator::new(settings).map_err(ServiceError::invalid)?;
        Ok(Self {
            identity,
            intrinsics,
            settings,
            max_speed_m_per_s,
            eyes: tokio::sync::Mutex::new(Eyes {
                lookout: Lookout::new(),
                tracker: Tracker::new(OdometryNoise::default()),
            }),
            state: Mutex::new(State {
                navigator,
                last_report: None,
                told: None,
                goals: AskedGoals::default(),
                goal: None,
                goal_before: None,
                route: None,
                goal_refusal: None,
                planning: Planning::No,
                last_sequence: None,
                frames: 0,
                closures: 0,
            }),
            refusals: watch::Sender::new(None),
        })
    }

    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    pub(super) fn view(&self, connected: bool) -> NavigationView {
        let state = self.state();
        let State { told, goal, route, goal_refusal, frames, closures, .. } = &*state;
        NavigationView {
            name: navigation_name(&self.identity.map, &self.identity.name),
            connected,
            guidance: *told,
            goal: goal.map(Goal::from),
            route: route.clone(),
            goal_refusal: goal_refusal.clone(),
            frames: *frames,
            closures: *closures,
        }
    }

    pub(super) fn last_sequence(&self) -> Option<u64> {
        self.state().last_sequence
    }

    pub(super) fn refusals(&self) -> watch::Receiver<Option<GoalRefusal>> {
        self.refusals.subscribe()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends the robot to a goal. One that does not exist, or that no way leads to from where the robot is, is refused, and
    /// the robot goes on to the one that it had.
    pub(super) async fn go_to(
        self: &Arc<Self>,
        navigation: &Navigation,
        goal: GoalRequest,
    ) -> Result<(), ServiceError> {
        let asked = self.state().goals.ask();
        self.set_out(navigation, goal, asked).await
    }

    /// The same without waiting; refusals tell why it was refused.
    pub(super) fn go_to_in_time(self: Arc<Self>, navigation: &Navigation, goal: GoalRequest) {
        let asked = self.state().goals.ask_in_time();
        self.leave_reached_goal();
        let navigation = navigation.clone();
        tokio::spawn(async move {
            let named = goal.goal();
            if let Err(error) = self.set_out(&navigation, goal, asked).await {
                self.refuse(asked, GoalRefusal { goal: named, error });
            }
        });
    }

    /// A caller that waits for the arrival at the next goal must not take that at the last one for it.
    fn leave_reached_goal(&self) {
        let mut state = self.state();
        if state.told.is_some_and(|told| told.guidance.status == Status::Arrived) {
            state.navigator.cancel();
            (state.goal, state.route, state.told) = (None, None, None);
        }
    }

    async fn set_out(
        self: &Arc<Self>,
        navigation: &Navigation,
        goal: GoalRequest,
        asked: u64,
    ) -> Result<(), ServiceError> {
        let row = navigation.open_maps.row(&self.identity.map).await?;
        if row.id != self.identity.map_id {
            return Err(self.identity.replaced());
        }
        let goal = navigation.measured_goal(&row, goal).await?;
        let here = self.state().navigator.localization();
        if let Some(here) = here {
            self.planned(navigation, PlanFrom::Robot(here.at), goal.goal).await?;
        }
        self.head_for(goal, asked);
        self.plan_if_wanted(navigation);
        Ok(())
    }

    /// Unless a later goal was taken meanwhile.
    fn head_for(&self, goal: MeasuredGoal, asked: u64) {
        let mut state = self.state();
        if !state.goals.take(asked) {
            return;
        }
        let before =
            state.goal.filter(|_| state.told.is_none_or(|told| told.guidance.status != Status::Arrived));
        state.set_out(goal);
        (state.goal_before, state.goal_refusal) = (before, None);
    }

    pub(super) fn stop(&self) {
        let mut state = self.state();
        state.navigator.cancel();
        state.goals.stop();
        (state.goal, state.goal_before, state.route, state.goal_refusal) = (None, None, None, None);
        state.told = None;
    }

    /// Unless a later goal was taken meanwhile.
    fn refuse(&self, asked: u64, refusal: GoalRefusal) {
        let mut state = self.state();
        if state.goals.refuse(asked) {
            state.goal_refusal = Some(refusal.clone());
            drop(state);
            self.refusals.send_replace(Some(refusal));
        }
    }

    /// Has a way planned if the robot waits for one. It stands meanwhile.
    fn plan_if_wanted(self: &Arc<Self>, navigation: &Navigation) {
        let wanted = {
            let mut state = self.state();
            let Some(wanted) = state.navigator.wanted_route().filter(|_| state.planning == Planning::No)
            else {
                return;
            };
            state.planning = Planning::UnderWay;
            wanted
        };
        let guide = self.clone();
        let navigation = navigation.clone();
        tokio::spawn(async move {
            let planned = guide.planned(&navigation, PlanFrom::Robot(wanted.from), wanted.goal).await;
            let mut state = guide.state();
            state.planning = Planning::No;
            let Some(goal) = state.goal.filter(|goal| goal.goal == wanted.goal) else { return };
            match planned {
                Ok(route) => {
                    state.navigator.follow(&route);
                    (state.route, state.goal_before) = (Some(route), None);
                }
                // The map is opened anew: the next report asks again.
                Err(ServiceError::Unavailable { .. }) => {}
                Err(error) => {
                    let asked = state.goals.taken();
                    match state.goal_before.take() {
                        Some(before) => state.set_out(before),
                        None => {
                            state.navigator.cancel();
                            state.goal = None;
                        }
                    }
                    drop(state);
                    let goal = Some(goal.into());
                    guide.refuse(asked, GoalRefusal { goal, error });
                    guide.plan_if_wanted(&navigation);
                }
            }
        });
    }

    async fn planned(
        &self,
        navigation: &Navigation,
        from: PlanFrom,
        goal: planning::Goal,
    ) -> Result<Route, ServiceError> {
        let map = navigation.open_maps.open(&self.identity.map).await?;
        if map.id() != self.identity.map_id {
            return Err(self.identity.replaced());
        }
        map.plan(from, goal, self.settings.planning).await?.map_err(not_planned)
    }

    /// A wheel report that no wheels make.
    fn check(&self, report: &WheelReport) -> Result<(), ServiceError> {
        let state = self.state();
        let Some((last_ns, before)) = &state.last_report else { return Ok(()) };
        if report.stamp_ns <= *last_ns {
            return Err(ServiceError::precondition(format_args!(
                "the stamp {} ns is not after {last_ns} ns, the last report's; send reports in order, with the \
                 robot's own steady clock",
                report.stamp_ns
            )));
        }
        let elapsed_s = (report.stamp_ns - last_ns) as f64 * 1e-9;
        if report.odometry.has_jumped(before, elapsed_s, self.max_speed_m_per_s) {
            let distance_m = report.odometry.distance_m(before);
            return Err(ServiceError::invalid(format_args!(
                "the odometry jumped {distance_m:.1} m in {elapsed_s:.3} s; if the odom frame was reset, open a new \
                 navigation; if not, check units (metres, nanoseconds)"
            )));
        }
        Ok(())
    }

    /// Answers odometry with a command.
    pub(super) fn report(
        self: &Arc<Self>,
        navigation: &Navigation,
        report: BodyReport,
    ) -> Result<Told, ServiceError> {
        let BodyReport { stamp_ns, odometry, obeyed, driver } = report;
        let odometry = odometry.ok_or_else(|| {
            ServiceError::invalid("the report has no odometry; send where the wheels put the robot")
        })?;
        let report = WheelReport { stamp_ns, odometry, obeyed, driver };
        self.check(&report)?;
        let told = {
            let mut state = self.state();
            let mut guidance = state.navigator.drive(&report);
            if guidance.status == Status::Idle && state.goals.is_looking_up() {
                // It stands, but who waits for the end of its way must not take that for it.
                (guidance.status, guidance.reason) = (Status::Following, Some(Reason::Planning));
            }
            let told = Told { stamp_ns, guidance, appearance: None, waiting: None };
            state.told = Some(told);
            state.last_report = Some((report.stamp_ns, report.odometry));
            told
        };
        self.plan_if_wanted(navigation);
        Ok(told)
    }

    /// Looks at a frame, after those before it.
    pub(super) async fn look(
        self: &Arc<Self>,
        navigation: &Navigation,
        frame: Frame,
        words: Words,
        stream: u64,
    ) -> Result<FrameSeen, ServiceError> {
        let Frame { sequence, stamp_ns, content, odometry, note: _ } = frame;
        if odometry.is_none() {
            return Err(ServiceError::invalid(
                "the frame has no odometry; while a robot is led, send where its wheels were when the image was taken",
            ));
        }
        let mut eyes = self.eyes.lock().await;
        let episode = self.state().navigator.episode();
        let model = self.identity.model.clone();
        let observed =
            navigation.extraction.observe(model, content, words, Keep::Words, None, Some(stream)).await?;
        let Observed { observation, features, media: _, extract: _, quantize: _ } = observed;
        if let Some(features) = &features {
            self.intrinsics.check(features.image_size_px())?;
        }
        let session: SessionId = Localizer::SESSION;
        let request = LookRequest {
            lookout: eyes.lookout.clone(),
            tracker: eyes.tracker.clone(),
            episode,
            settings: self.settings.localization,
            input: FrameInput { session, sequence, stamp_ns, odometry, observation },
            features,
            intrinsics: self.intrinsics,
        };
        let map = navigation.open_maps.open(&self.identity.map).await?;
        if map.id() != self.identity.map_id {
            return Err(self.identity.replaced());
        }
        let Looked { lookout, tracker, look } = map.look(request).await?;
        *eyes = Eyes { lookout, tracker };
        let closure = match look.sight {
            Sight::Closure(closure) => Some(closure),
            Sight::Unknown | Sight::TooLittle => None,
        };
        let seen = {
            let mut state = self.state();
            state.last_sequence = Some(sequence);
            state.frames += 1;
            state.closures += u64::from(closure.is_some());
            state.navigator.see(&look)
        };
        self.plan_if_wanted(navigation);
        Ok(FrameSeen {
            sequence,
            seen: Some(seen),
            place: closure.map(|closure| closure.place),
            probability: closure.map(|closure| closure.probability),
        })
    }
}
