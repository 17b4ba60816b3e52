// long: the values and calls that both ways of navigating share.
//! Robots that are led along a map, by its strategy: along places that wheels measured, or by looks alone.

mod appearance;
mod asked;
mod registry;
mod topo_metric;

use std::sync::Arc;
use std::time::Instant;

use bytes::Bytes;
use fabmap::appearance::PlaceId;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio_util::sync::CancellationToken;
use topomap::metric::Odometry;
use waypost_navigation::metric::planning::Route;
use waypost_navigation::metric::settings::{AgainstTheWay, NavigationSettings};
use waypost_navigation::metric::{Driver, Guidance, Seen, Status};

use self::appearance::AppearanceGuide;
pub(crate) use self::appearance::{Unjoined, Waiting};
pub(super) use self::registry::Registry;
use self::topo_metric::TopoMetricGuide;
use super::appearance::AppearanceGraphs;
use super::labels::Labels;
use super::refusals::{Refusal, RefusalLog};
use super::sessions::Frame;
use super::streams::Streams;
use super::tokens::Caller;
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::content::Words;
use crate::ingest::extraction::Extraction;
use crate::ingest::model::{LoadedModel, LoadedModels};
use crate::map_settings::{self, NavigationStrategy};
use crate::names::{check_id, map_in, navigation_in, navigation_name};
use crate::open_map::{OpenMaps, PlanFrom};
use crate::pages::{Page, named_page, page_after, page_size};
use crate::quotas::Quotas;
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
    pub(crate) camera: Option<Camera>,
    pub(crate) words_hash: String,
    pub(crate) goal: Option<GoalRequest>,
    pub(crate) driving: Driving,
}

/// Where a robot is to go.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Goal {
    Place(PlaceId),
    /// The place nearest to it.
    Position {
        part: PlaceId,
        position_m: [f64; 2],
        /// Where to look there, in the part's frame.
        heading_rad: Option<f64>,
    },
    /// A place that people call so.
    Label(String),
}

/// The same as it is asked for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum GoalRequest {
    Goal(Goal),
    /// Where this panorama was taken: a JPEG or PNG.
    Image(Bytes),
}

/// What may be chosen of how a robot drives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Driving {
    pub(crate) speed_m_s: Option<f64>,
    pub(crate) max_turn_rad_s: Option<f64>,
    pub(crate) reverse_travel: ReverseTravel,
}

/// Whether a way may be driven the other way round.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum ReverseTravel {
    #[default]
    Forbidden,
    Costly,
}

/// What a robot says of itself.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct BodyReport {
    pub(crate) stamp_ns: i64,
    pub(crate) odometry: Option<Odometry>,
    /// Number of the latest command that it obeyed.
    pub(crate) obeyed: Option<u64>,
    pub(crate) driver: Driver,
}

/// A navigation as it is now.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NavigationView {
    pub(crate) name: String,
    pub(crate) connected: bool,
    pub(crate) guidance: Option<Told>,
    pub(crate) goal: Option<Goal>,
    pub(crate) route: Option<Route>,
    pub(crate) goal_refusal: Option<GoalRefusal>,
    pub(crate) frames: u64,
    pub(crate) closures: u64,
}

/// What a robot was told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Told {
    /// Of the report or the panorama that it answers.
    pub(crate) stamp_ns: i64,
    pub(crate) guidance: Guidance,
    /// Where to drive by looks.
    pub(crate) appearance: Option<AppearanceView>,
    /// Why one that drives by looks does not, if so.
    pub(crate) waiting: Option<Waiting>,
}

/// Where to drive by looks.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AppearanceView {
    /// From straight ahead to the left.
    pub(crate) heading_rad: Option<f64>,
    pub(crate) subgoal: Option<PlaceId>,
    pub(crate) goal: Option<PlaceId>,
    /// Of what is seen with the subgoal.
    pub(crate) similarity: Option<f64>,
    /// Sum of 1 / similarity to the goal.
    pub(crate) left: Option<f64>,
    /// Why the robot is not led, if that is because nothing joins the goal with where it is.
    pub(crate) unjoined: Option<Unjoined>,
}

/// A way that was planned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum PlannedWay {
    Measured(Route),
    ByLooks(WayByLooks),
}

/// A way over places that can be matched from each other.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WayByLooks {
    /// From the start to the goal, both among them.
    pub(crate) places: Vec<PlaceId>,
    /// Sum of 1 / similarity.
    pub(crate) length: f64,
}

/// Why a robot is not led to its goal.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GoalRefusal {
    /// None if it was an image.
    pub(crate) goal: Option<Goal>,
    pub(crate) error: ServiceError,
}

/// What a frame showed, and what came of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FrameSeen {
    pub(crate) sequence: u64,
    /// None if it was not looked at.
    pub(crate) seen: Option<Seen>,
    pub(crate) place: Option<PlaceId>,
    pub(crate) probability: Option<f64>,
}

/// A frame that was looked at, and what the robot is told to it at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Looked {
    pub(crate) seen: FrameSeen,
    pub(crate) told: Option<Told>,
}

/// Which robot is led, and in which map.
#[derive(Clone, Debug)]
struct Identity {
    map_id: MapId,
    map: String,
    name: String,
    run: String,
    model: Arc<LoadedModel>,
}

/// Leads one robot; it outlives its stream for a while.
#[derive(Clone, Debug)]
enum Guide {
    TopoMetric(Arc<TopoMetricGuide>),
    Appearance(Arc<AppearanceGuide>),
}

/// A stream by which a robot is led.
#[derive(Clone, Debug)]
pub(crate) struct NavigationStream {
    navigation: Navigation,
    guide: Guide,
    words: Words,
    stream: u64,
    /// Name of the token that it came with, if there was one: its frames count for that.
    token: Option<String>,
    resumed: bool,
    taken_over: CancellationToken,
    _room: Arc<OwnedSemaphorePermit>,
}

/// Leads robots along maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Navigation {
    pub(super) models: LoadedModels,
    pub(super) open_maps: OpenMaps,
    pub(super) extraction: Extraction,
    pub(super) graphs: AppearanceGraphs,
    pub(super) labels: Labels,
    pub(super) streams: Streams,
    pub(super) led: Arc<Registry>,
    pub(super) refusals: RefusalLog,
    pub(super) quotas: Quotas,
    pub(super) stopping: CancellationToken,
}

impl Navigation {
    /// Begins to lead a robot, or goes on where its last stream broke off.
    pub(crate) async fn open(
        &self,
        caller: &Caller,
        opening: NavigationOpening,
    ) -> Result<NavigationStream, ServiceError> {
        let NavigationOpening { map, navigation, run, camera, words_hash, goal, driving } = opening;
        // Ranges are checked whatever the strategy is.
        driving.settings()?;
        let map = map_in(&map)?.to_owned();
        if !run.is_empty() {
            check_id("run id", &run)?;
        }
        let room = self.streams.room()?;
        let row = self.open_maps.row(&map).await?;
        let model = self.models.get(&row.model).await?;
        let words = Words::declared(&words_hash, &model)?;
        let settings = map_settings::from_json(&row.settings)?;
        match settings.strategy {
            NavigationStrategy::TopoMetric => topo_metric::check(&map, camera.as_ref(), &settings)?,
            NavigationStrategy::Appearance => appearance::check(&map, camera.as_ref())?,
        }
        self.open_maps.open_of(&row).await?;
        let name = match navigation.as_str() {
            "" => self.led.unused_name(row.id),
            name => check_id("navigation name", name)?.to_owned(),
        };
        let stream = self.streams.number();
        let taken_over = CancellationToken::new();
        let key = (row.id, name.as_str());
        let named = run.as_str();
        let fresh = || {
            let map = map.clone();
            let name = name.clone();
            let run = run.clone();
            let identity = Identity { map_id: row.id, map, name, run, model: model.clone() };
            Ok(match settings.strategy {
                NavigationStrategy::TopoMetric => Guide::TopoMetric(Arc::new(TopoMetricGuide::new(
                    identity,
                    camera.as_ref(),
                    driving,
                    settings.mapper.max_speed_m_per_s,
                )?)),
                NavigationStrategy::Appearance => {
                    Guide::Appearance(Arc::new(AppearanceGuide::new(identity, camera.as_ref(), driving)?))
                }
            })
        };
        let opened = self.led.open(key, named, (&room, &taken_over), fresh)?;
        let stream = NavigationStream {
            navigation: self.clone(),
            guide: opened.guide,
            words,
            stream,
            token: caller.token.clone(),
            resumed: opened.resumed,
            taken_over,
            _room: room,
        };
        if let Some(goal) = goal.filter(|_| !stream.resumed)
            && let Err(refused) = stream.guide.go_to(self, goal, caller.token.as_deref()).await
        {
            self.led.forget(key, &stream.guide);
            return Err(refused);
        }
        Ok(stream)
    }

    pub(crate) async fn get(&self, name: &str) -> Result<NavigationView, ServiceError> {
        Ok(self.led.view(&self.guide_of(name).await?))
    }

    /// The navigations in a map, by name.
    pub(crate) async fn list(
        &self,
        map: &str,
        size: u32,
        token: &str,
    ) -> Result<Page<NavigationView>, ServiceError> {
        let map = map_in(map)?;
        let size = page_size(size)? as usize;
        let after = named_page(token)?;
        let row = self.open_maps.row(map).await?;
        let mut items: Vec<NavigationView> = self
            .led
            .of_map(row.id)
            .iter()
            .map(|guide| self.led.view(guide))
            .filter(|view| view.name > after)
            .collect();
        let more = items.len() > size;
        items.truncate(size);
        let next = items.last().filter(|_| more).map_or_else(String::new, |last| page_after(&last.name));
        Ok(Page { items, next })
    }

    /// The robots that are led along a map, or were a moment ago, by name.
    pub(in crate::service) fn led_on(&self, map: MapId) -> Vec<NavigationView> {
        self.led.of_map(map).iter().map(|guide| self.led.view(guide)).collect()
    }

    /// How many robots are led, by their status.
    pub(in crate::service) fn counts(&self) -> Vec<(&'static str, usize)> {
        let guides = self.led.all();
        let of =
            |guide: &Guide| self.led.view(guide).guidance.map_or(Status::Idle, |told| told.guidance.status);
        let found: Vec<Status> = guides.iter().map(of).collect();
        let named = [
            ("idle", Status::Idle),
            ("following", Status::Following),
            ("searching", Status::Searching),
            ("lost", Status::Lost),
            ("arrived", Status::Arrived),
            ("blocked", Status::Blocked),
        ];
        named.map(|(name, status)| (name, found.iter().filter(|found| **found == status).count())).to_vec()
    }

    /// Sends a robot that is led to a goal.
    pub(crate) async fn set_goal(
        &self,
        caller: &Caller,
        name: &str,
        goal: GoalRequest,
    ) -> Result<NavigationView, ServiceError> {
        let guide = self.guide_of(name).await?;
        guide.go_to(self, goal, caller.token.as_deref()).await?;
        Ok(self.led.view(&guide))
    }

    pub(crate) async fn cancel_goal(&self, name: &str) -> Result<NavigationView, ServiceError> {
        let guide = self.guide_of(name).await?;
        guide.stop();
        Ok(self.led.view(&guide))
    }

    /// Which way would be taken.
    pub(crate) async fn plan_route(
        &self,
        map: &str,
        from: u32,
        goal: Goal,
        reverse_travel: ReverseTravel,
    ) -> Result<PlannedWay, ServiceError> {
        let row = self.open_maps.row(map_in(map)?).await?;
        match map_settings::from_json(&row.settings)?.strategy {
            NavigationStrategy::TopoMetric => {}
            NavigationStrategy::Appearance => {
                return Ok(PlannedWay::ByLooks(self.plan_by_looks(&row, PlaceId::new(from), &goal).await?));
            }
        }
        // Planning says what is not there: the start first.
        let goal = self.meant_goal(&row, GoalRequest::Goal(goal)).await?.goal;
        let map = self.open_maps.open_of(&row).await?;
        let settings = Driving { reverse_travel, ..Driving::default() }.settings()?.planning;
        let route = map.plan(PlanFrom::Place(PlaceId::new(from)), goal, settings).await?;
        route.map(PlannedWay::Measured).map_err(topo_metric::not_planned)
    }

    async fn guide_of(&self, name: &str) -> Result<Guide, ServiceError> {
        let (map, navigation) = navigation_in(name)?;
        let row = self.open_maps.row(map).await?;
        self.led.find((row.id, navigation)).ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "no robot {navigation} is being led in the map {map}; list its navigations to see who is"
            ))
        })
    }
}

impl Driving {
    fn settings(self) -> Result<NavigationSettings, ServiceError> {
        let Self { speed_m_s, max_turn_rad_s, reverse_travel } = self;
        let mut settings = NavigationSettings::default();
        settings.steering.speed_m_s = speed_m_s.unwrap_or(settings.steering.speed_m_s);
        settings.steering.max_turn_rad_s = max_turn_rad_s.unwrap_or(settings.steering.max_turn_rad_s);
        settings.planning.against = match reverse_travel {
            ReverseTravel::Forbidden => AgainstTheWay::Forbidden,
            ReverseTravel::Costly => AgainstTheWay::Costs { factor: AGAINST_THE_WAY_FACTOR },
        };
        settings.check().map_err(ServiceError::invalid)?;
        Ok(settings)
    }
}

impl Told {
    /// Why it stands, waits, searches or looks around, and what it waits for; none where it is on its way or there.
    pub(crate) fn detail(&self) -> Option<String> {
        let unjoined = self.appearance.and_then(|by_looks| by_looks.unjoined);
        let reflex = self.waiting.filter(|waiting| *waiting == Waiting::Reflex);
        reflex
            .map(|reflex| reflex.to_string())
            .or(unjoined.map(|unjoined| unjoined.of_the_robot()))
            .or(self.waiting.map(|waiting| waiting.to_string()))
            .or(self.guidance.reason.map(|reason| reason.to_string()))
    }
}

impl GoalRequest {
    /// As a refusal names it.
    fn goal(&self) -> Option<Goal> {
        match self {
            GoalRequest::Goal(goal) => Some(goal.clone()),
            GoalRequest::Image(_) => None,
        }
    }
}

impl Identity {
    fn replaced(&self) -> ServiceError {
        ServiceError::not_found(format_args!(
            "there is no map {} any more: it was deleted, and another of its name made; open a new navigation",
            self.map
        ))
    }
}

impl Guide {
    fn identity(&self) -> &Identity {
        match self {
            Guide::TopoMetric(guide) => guide.identity(),
            Guide::Appearance(guide) => guide.identity(),
        }
    }

    fn is(&self, other: &Guide) -> bool {
        match (self, other) {
            (Guide::TopoMetric(guide), Guide::TopoMetric(other)) => Arc::ptr_eq(guide, other),
            (Guide::Appearance(guide), Guide::Appearance(other)) => Arc::ptr_eq(guide, other),
            (Guide::TopoMetric(_), Guide::Appearance(_)) | (Guide::Appearance(_), Guide::TopoMetric(_)) => {
                false
            }
        }
    }

    fn view(&self, connected: bool) -> NavigationView {
        match self {
            Guide::TopoMetric(guide) => guide.view(connected),
            Guide::Appearance(guide) => guide.view(connected),
        }
    }

    /// `token` is whose frames an image counts among.
    async fn go_to(
        &self,
        navigation: &Navigation,
        goal: GoalRequest,
        token: Option<&str>,
    ) -> Result<(), ServiceError> {
        match self {
            Guide::TopoMetric(guide) => guide.go_to(navigation, goal).await,
            Guide::Appearance(guide) => {
                let asked = guide.ask();
                guide.go_to(navigation, goal, (asked, token)).await
            }
        }
    }

    fn stop(&self) {
        match self {
            Guide::TopoMetric(guide) => guide.stop(),
            Guide::Appearance(guide) => guide.stop(),
        }
    }
}

/// The call that robots are led by.
const NAVIGATE: &str = "/waypost.v1.NavigationService/Navigate";

impl NavigationStream {
    /// `maps/{map}/navigations/{navigation}`.
    pub(crate) fn name(&self) -> String {
        let Identity { map, name, .. } = self.guide.identity();
        navigation_name(map, name)
    }

    pub(crate) fn model_hash(&self) -> &str {
        &self.guide.identity().model.hash
    }

    pub(crate) fn words_hash(&self) -> &str {
        &self.guide.identity().model.words_hash
    }

    /// Whether an earlier stream's navigation goes on, and its last frame.
    pub(crate) fn resumed(&self) -> (bool, Option<u64>) {
        let last = match &self.guide {
            Guide::TopoMetric(guide) => guide.last_sequence(),
            Guide::Appearance(guide) => guide.last_sequence(),
        };
        (self.resumed, last)
    }

    /// Hears why goals are refused.
    pub(crate) fn refusals(&self) -> watch::Receiver<Option<GoalRefusal>> {
        match &self.guide {
            Guide::TopoMetric(guide) => guide.refusals(),
            Guide::Appearance(guide) => guide.refusals(),
        }
    }

    /// Notes that something that the robot sent was refused.
    pub(crate) fn note_refused(&self, error: &ServiceError) {
        let refusal = Refusal::on_stream(NAVIGATE, &self.name(), self.token.as_ref(), error);
        self.navigation.refusals.note(refusal);
    }

    /// Answers what the robot says of itself with a command.
    pub(crate) fn report(&self, report: BodyReport) -> Result<Told, ServiceError> {
        match &self.guide {
            Guide::TopoMetric(guide) => guide.report(&self.navigation, report),
            Guide::Appearance(guide) => guide.report(&report),
        }
    }

    /// Goes to a goal; where it cannot be gone to, refusals say so.
    pub(crate) fn go_to(&self, goal: GoalRequest) {
        let navigation = self.navigation.clone();
        match &self.guide {
            Guide::TopoMetric(guide) => guide.clone().go_to_in_time(&navigation, goal),
            Guide::Appearance(guide) => {
                let guide = guide.clone();
                let token = self.token.clone();
                let asked = guide.ask_in_time();
                guide.leave_reached_goal();
                tokio::spawn(async move {
                    let named = goal.goal();
                    if let Err(error) = guide.go_to(&navigation, goal, (asked, token.as_deref())).await {
                        guide.refuse(asked, GoalRefusal { goal: named, error });
                    }
                });
            }
        }
    }

    pub(crate) fn stop(&self) {
        self.guide.stop();
    }

    /// Looks at a frame, after those before it.
    pub(crate) async fn look(&self, frame: Frame) -> Result<Looked, ServiceError> {
        frame.check()?;
        let words = self.words;
        let stream = self.stream;
        let quotas = &self.navigation.quotas;
        let turn = quotas.frame(self.token.as_deref(), Some(stream), Instant::now())?;
        let looked = match &self.guide {
            Guide::TopoMetric(guide) => {
                let seen = guide.look(&self.navigation, frame, words, stream).await;
                seen.map(|seen| Looked { seen, told: None })
            }
            Guide::Appearance(guide) => guide.look(&self.navigation, frame, words, stream).await,
        };
        if !matches!(looked, Err(ServiceError::Unavailable { .. })) {
            turn.spend();
        }
        looked
    }

    /// Why the stream is over, when it is.
    pub(crate) async fn over(&self) -> ServiceError {
        tokio::select! {
            () = self.navigation.stopping.cancelled() => ServiceError::stopping(),
            () = self.taken_over.cancelled() => ServiceError::taken_over(),
        }
    }
}
