//! Robots that are led along a map. Commands come of odometry at once, beside the stream; the map's writer is asked
//! for looks and plans alone.

mod registry;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio_util::sync::CancellationToken;
use topomap::event::SessionId;
use topomap::mapper::{FrameInput, Localizer};
use topomap::navigation::planning::{Goal, Route};
use topomap::navigation::settings::{AgainstTheWay, NavigationSettings};
use topomap::navigation::{Guidance, Look, Lookout, Navigator, Seen, Sight, WheelReport};
use topomap::odometry::Odometry;

pub(crate) use self::registry::Navigations;
use super::Service;
use super::camera::Intrinsics;
use super::content::Words;
use super::map_settings::{self, Keep};
use super::map_writer::{LookRequest, PlanFrom};
use super::models::Page;
use super::names::{check_id, map_in, navigation_in, navigation_name, page_size};
use super::sessions::{Frame, taken_over};
use crate::error::ServiceError;
use crate::extraction::{LoadedModel, Observed};
use crate::storage::MapId;

/// What a way costs that is driven the other way round, in times its length.
const AGAINST_THE_WAY_FACTOR: f64 = 4.0;

/// Whom to lead, and how.
#[derive(Clone, Debug)]
pub(crate) struct NavigationOpening {
    pub(crate) map: String,
    /// Made up if empty.
    pub(crate) navigation: String,
    /// Empty if the robot did not say.
    pub(crate) run: String,
    /// As it was encoded.
    pub(crate) camera: Option<Vec<u8>>,
    pub(crate) words_hash: String,
    pub(crate) goal: Option<Goal>,
    pub(crate) driving: Driving,
}

/// What may be chosen of how a robot drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Driving {
    pub(crate) speed_m_s: Option<f64>,
    pub(crate) max_turn_rad_s: Option<f64>,
    pub(crate) against: Against,
}

/// Whether a way may be driven the other way round.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Against {
    #[default]
    Forbidden,
    Costly,
}

/// A navigation as it is now.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NavigationView {
    pub(crate) name: String,
    pub(crate) connected: bool,
    /// What the robot was told last, and the stamp of the report that it answered.
    pub(crate) guidance: Option<(i64, Guidance)>,
    pub(crate) goal: Option<Goal>,
    pub(crate) route: Option<Route>,
    pub(crate) goal_refusal: Option<GoalRefusal>,
    pub(crate) frames: u64,
    pub(crate) closures: u64,
}

/// Why a robot is not led to its goal.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GoalRefusal {
    pub(crate) goal: Goal,
    pub(crate) message: String,
}

/// What a frame showed, and what came of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameSeen {
    pub(crate) sequence: u64,
    /// None if it was not looked at.
    pub(crate) seen: Option<(Look, Seen)>,
}

/// A robot that is led: it outlives its stream for a while.
#[derive(Debug)]
pub(crate) struct Navigation {
    map_id: MapId,
    map: String,
    name: String,
    run: String,
    model: Arc<LoadedModel>,
    intrinsics: Intrinsics,
    settings: NavigationSettings,
    /// Of the map: odometry that is faster has jumped.
    max_speed_m_per_s: f64,
    /// The navigator's clock begins here.
    since: Instant,
    /// One frame is looked at after the other.
    lookout: tokio::sync::Mutex<Lookout>,
    state: Mutex<State>,
    refusals: watch::Sender<Option<GoalRefusal>>,
}

#[derive(Debug)]
struct State {
    navigator: Navigator,
    last_report: Option<(i64, Odometry)>,
    guidance: Option<(i64, Guidance)>,
    goal: Option<Goal>,
    route: Option<Route>,
    goal_refusal: Option<GoalRefusal>,
    planning: Planning,
    last_sequence: Option<u64>,
    frames: u64,
    closures: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Planning {
    No,
    UnderWay,
}

/// A stream by which a robot is led.
#[derive(Clone, Debug)]
pub(crate) struct NavigationStream {
    service: Arc<Service>,
    navigation: Arc<Navigation>,
    words: Words,
    stream: u64,
    resumed: bool,
    taken_over: CancellationToken,
    _room: Arc<OwnedSemaphorePermit>,
}

impl Service {
    /// Begins to lead a robot, or goes on where its last stream broke off.
    pub(crate) async fn open_navigation(
        self: &Arc<Self>,
        opening: NavigationOpening,
    ) -> Result<NavigationStream, ServiceError> {
        let NavigationOpening { map, navigation, run, camera, words_hash, goal, driving } = opening;
        let settings = driving.settings()?;
        let map = map_in(&map)?.to_owned();
        if !run.is_empty() {
            check_id("run id", &run)?;
        }
        let intrinsics = camera.as_deref().and_then(Intrinsics::of_camera).ok_or_else(|| {
            ServiceError::invalid(
                "a robot is steered by how far its image has shifted: declare a camera with a pinhole calibration or a \
                 field of view",
            )
        })?;
        let room = self.room_for_a_stream()?;
        let row = self.map_row(&map).await?;
        let model = self.loaded_model(&row.model).await?;
        let words = Words::declared(&words_hash, &model)?;
        let mapper = map_settings::from_json(&row.settings)?.mapper;
        if !mapper.verification.method.verifies() {
            return Err(ServiceError::precondition(format_args!(
                "the map {map} recognises by words alone, and by words no robot can be steered; make a map with \
                 verification"
            )));
        }
        self.open_map_of(&row).await?;
        let navigation = match navigation.as_str() {
            "" => self.navigations.unused_name(row.id),
            name => check_id("navigation name", name)?.to_owned(),
        };
        let (stream, taken_over) = (self.new_stream(), CancellationToken::new());
        let fresh = || {
            let (named, driven) =
                ((row.id, map.as_str(), navigation.as_str()), (settings, mapper.max_speed_m_per_s));
            Navigation::new(named, run.clone(), model.clone(), intrinsics, driven)
        };
        let opened = self.navigations.open((row.id, &navigation), &run, (&room, &taken_over), fresh)?;
        let stream = NavigationStream {
            service: self.clone(),
            navigation: opened.navigation,
            words,
            stream,
            resumed: opened.resumed,
            taken_over,
            _room: room,
        };
        if let Some(goal) = goal.filter(|_| !stream.resumed) {
            stream.go_to(goal);
        }
        Ok(stream)
    }

    pub(crate) async fn navigation(&self, name: &str) -> Result<NavigationView, ServiceError> {
        Ok(self.navigations.view(&*self.led(name).await?))
    }

    /// The navigations in a map, by name.
    pub(crate) async fn list_navigations(
        &self,
        map: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<NavigationView>, ServiceError> {
        let (map, size) = (map_in(map)?, page_size(size)? as usize);
        let row = self.map_row(map).await?;
        let mut items: Vec<NavigationView> = self
            .navigations
            .of_map(row.id)
            .iter()
            .map(|navigation| self.navigations.view(navigation))
            .filter(|view| view.name.as_str() > token)
            .collect();
        let more = items.len() > size;
        items.truncate(size);
        let next = items.last().filter(|_| more).map_or_else(String::new, |last| last.name.clone());
        Ok(Page { items, next })
    }

    /// Sends a robot that is led to a goal.
    pub(crate) async fn set_goal(
        self: &Arc<Self>,
        name: &str,
        goal: Goal,
    ) -> Result<NavigationView, ServiceError> {
        let navigation = self.led(name).await?;
        navigation.go_to(goal);
        navigation.plan_if_wanted(self);
        Ok(self.navigations.view(&navigation))
    }

    pub(crate) async fn cancel_goal(&self, name: &str) -> Result<NavigationView, ServiceError> {
        let navigation = self.led(name).await?;
        navigation.stop();
        Ok(self.navigations.view(&navigation))
    }

    /// Which way would be taken.
    pub(crate) async fn plan_route(
        self: &Arc<Self>,
        map: &str,
        from: u32,
        goal: Goal,
        against: Against,
    ) -> Result<Route, ServiceError> {
        let map = self.open_map(map_in(map)?).await?;
        let settings = Driving { against, ..Driving::default() }.settings()?.planning;
        map.plan(PlanFrom::Place(from), goal, settings).await?.map_err(ServiceError::precondition)
    }

    async fn led(&self, name: &str) -> Result<Arc<Navigation>, ServiceError> {
        let (map, navigation) = navigation_in(name)?;
        let row = self.map_row(map).await?;
        self.navigations.find((row.id, navigation)).ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "no robot {navigation} is being led in the map {map}; list its navigations to see who is"
            ))
        })
    }
}

impl Driving {
    fn settings(self) -> Result<NavigationSettings, ServiceError> {
        let Self { speed_m_s, max_turn_rad_s, against } = self;
        let mut settings = NavigationSettings::default();
        settings.steering.speed_m_s = speed_m_s.unwrap_or(settings.steering.speed_m_s);
        settings.steering.max_turn_rad_s = max_turn_rad_s.unwrap_or(settings.steering.max_turn_rad_s);
        settings.planning.against = match against {
            Against::Forbidden => AgainstTheWay::Forbidden,
            Against::Costly => AgainstTheWay::Costs { factor: AGAINST_THE_WAY_FACTOR },
        };
        settings.check().map_err(ServiceError::invalid)?;
        Ok(settings)
    }
}

impl Navigation {
    fn new(
        (map_id, map, name): (MapId, &str, &str),
        run: String,
        model: Arc<LoadedModel>,
        intrinsics: Intrinsics,
        (settings, max_speed_m_per_s): (NavigationSettings, f64),
    ) -> Result<Self, ServiceError> {
        let navigator = Navigator::new(settings).map_err(ServiceError::invalid)?;
        Ok(Self {
            map_id,
            map: map.to_owned(),
            name: name.to_owned(),
            run,
            model,
            intrinsics,
            settings,
            max_speed_m_per_s,
            since: Instant::now(),
            lookout: tokio::sync::Mutex::new(Lookout::new()),
            state: Mutex::new(State {
                navigator,
                last_report: None,
                guidance: None,
                goal: None,
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

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn go_to(&self, goal: Goal) {
        let mut state = self.state();
        state.navigator.go_to(goal);
        (state.goal, state.route, state.goal_refusal) = (Some(goal), None, None);
        // Of the goal before: whoever waits for the arrival must not take it for that at this one.
        state.guidance = None;
    }

    fn stop(&self) {
        let mut state = self.state();
        state.navigator.cancel();
        (state.goal, state.route, state.goal_refusal) = (None, None, None);
        state.guidance = None;
    }

    /// Has a way planned if the robot waits for one. It stands meanwhile.
    fn plan_if_wanted(self: &Arc<Self>, service: &Arc<Service>) {
        let wanted = {
            let mut state = self.state();
            let Some(wanted) = state.navigator.wanted_route().filter(|_| state.planning == Planning::No)
            else {
                return;
            };
            state.planning = Planning::UnderWay;
            wanted
        };
        let (navigation, service) = (self.clone(), service.clone());
        tokio::spawn(async move {
            let planned = navigation.planned(&service, PlanFrom::Robot(wanted.from), wanted.goal).await;
            let mut state = navigation.state();
            state.planning = Planning::No;
            if state.goal != Some(wanted.goal) {
                return;
            }
            match planned {
                Ok(route) => {
                    state.navigator.follow(&route);
                    state.route = Some(route);
                }
                // The map is opened anew: the next report asks again.
                Err(ServiceError::Unavailable { .. }) => {}
                Err(error) => {
                    state.navigator.cancel();
                    let refusal = GoalRefusal { goal: wanted.goal, message: error.to_string() };
                    (state.goal, state.goal_refusal) = (None, Some(refusal.clone()));
                    navigation.refusals.send_replace(Some(refusal));
                }
            }
        });
    }

    async fn planned(
        &self,
        service: &Arc<Service>,
        from: PlanFrom,
        goal: Goal,
    ) -> Result<Route, ServiceError> {
        let map = service.open_map(&self.map).await?;
        if map.id() != self.map_id {
            return Err(self.replaced());
        }
        map.plan(from, goal, self.settings.planning).await?.map_err(ServiceError::precondition)
    }

    fn replaced(&self) -> ServiceError {
        ServiceError::not_found(format_args!(
            "there is no map {} any more: it was deleted, and another of its name made; open a new navigation",
            self.map
        ))
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
}

impl NavigationStream {
    /// `maps/{map}/navigations/{navigation}`.
    pub(crate) fn name(&self) -> String {
        navigation_name(&self.navigation.map, &self.navigation.name)
    }

    pub(crate) fn model_hash(&self) -> &str {
        &self.navigation.model.hash
    }

    pub(crate) fn words_hash(&self) -> &str {
        &self.navigation.model.words_hash
    }

    /// Whether an earlier stream's navigation goes on, and its last frame.
    pub(crate) fn resumed(&self) -> (bool, Option<u64>) {
        (self.resumed, self.navigation.state().last_sequence)
    }

    /// Hears why goals are refused.
    pub(crate) fn refusals(&self) -> watch::Receiver<Option<GoalRefusal>> {
        self.navigation.refusals.subscribe()
    }

    /// Answers odometry with a command.
    pub(crate) fn wheels(&self, report: WheelReport) -> Result<Guidance, ServiceError> {
        self.navigation.check(&report)?;
        let now_ns = i64::try_from(self.navigation.since.elapsed().as_nanos()).unwrap_or(i64::MAX);
        let guidance = {
            let mut state = self.navigation.state();
            let guidance = state.navigator.drive(&report, now_ns);
            state.guidance = Some((report.stamp_ns, guidance));
            state.last_report = Some((report.stamp_ns, report.odometry));
            guidance
        };
        self.navigation.plan_if_wanted(&self.service);
        Ok(guidance)
    }

    pub(crate) fn go_to(&self, goal: Goal) {
        self.navigation.go_to(goal);
        self.navigation.plan_if_wanted(&self.service);
    }

    pub(crate) fn stop(&self) {
        self.navigation.stop();
    }

    /// Looks at a frame, after those before it.
    pub(crate) async fn look(&self, frame: Frame) -> Result<FrameSeen, ServiceError> {
        let Frame { sequence, stamp_ns, content, odometry } = frame;
        if odometry.is_none() {
            return Err(ServiceError::invalid(
                "the frame has no odometry; while a robot is led, send where its wheels were when the image was taken",
            ));
        }
        let Self { service, navigation, .. } = self;
        let mut lookout = navigation.lookout.lock().await;
        let episode = navigation.state().navigator.episode();
        let observed = service
            .observe(navigation.model.clone(), content, self.words, Keep::Words, Some(self.stream))
            .await?;
        let Observed { observation, features, media: _, extract: _, quantize: _ } = observed;
        let session: SessionId = Localizer::SESSION;
        let request = LookRequest {
            lookout: lookout.clone(),
            episode,
            settings: navigation.settings.localization,
            input: FrameInput { session, sequence, stamp_ns, odometry, observation },
            features,
            intrinsics: navigation.intrinsics,
        };
        let map = service.open_map(&navigation.map).await?;
        if map.id() != navigation.map_id {
            return Err(navigation.replaced());
        }
        let (after, look) = map.look(request).await?;
        *lookout = after;
        let seen = {
            let mut state = navigation.state();
            state.last_sequence = Some(sequence);
            state.frames += 1;
            state.closures += u64::from(matches!(look.sight, Sight::Closure(_)));
            state.navigator.see(&look)
        };
        navigation.plan_if_wanted(service);
        Ok(FrameSeen { sequence, seen: Some((look, seen)) })
    }

    /// Why the stream is over, when it is.
    pub(crate) async fn over(&self) -> ServiceError {
        tokio::select! {
            () = self.service.stopping().cancelled() => ServiceError::stopping(),
            () = self.taken_over.cancelled() => taken_over(),
        }
    }
}
