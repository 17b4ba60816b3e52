//! A robot that is led by looks alone: each panorama is answered with where to drive. Neither odometry nor the map's writer
//! is asked.

mod goals;
mod journey;
mod state;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::ingest::PanoramicView;
use fabmap::appearance::PlaceId;
use tokio::sync::watch;
use topomap::metric::Odometry;
use waypost_navigation::appearance::graph::{ImageId, LINK_SIMILARITY};
use waypost_navigation::appearance::navigator::{Body, HeadingSteering};
use waypost_navigation::metric::Seen;

pub(crate) use self::goals::Unjoined;
use self::journey::{Journey, Step, most_similar};
pub(crate) use self::state::Waiting;
use self::state::{Heading, Report, State};
use super::{
    AppearanceView, BodyReport, Driving, FrameSeen, Goal, GoalRefusal, GoalRequest, Identity, Looked,
    Navigation, NavigationView, Told, WayByLooks,
};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::ingest::content::{Content, Words};
use crate::ingest::observed::Observed;
use crate::ingest::panoramic::PanoramicOptics;
use crate::map_settings::Keep;
use crate::names::navigation_name;
use crate::open_map::appearance::{Graph, Shown};
use crate::service::sessions::Frame;
use crate::storage::MapRow;

/// Leads one robot.
#[derive(Debug)]
pub(super) struct AppearanceGuide {
    identity: Identity,
    optics: PanoramicOptics,
    steering: HeadingSteering,
    /// What was seen last: one panorama is looked at after the other.
    before: tokio::sync::Mutex<Option<Arc<PanoramicView>>>,
    state: Mutex<State>,
    refusals: watch::Sender<Option<GoalRefusal>>,
}

/// Refuses a camera that does not see all around.
pub(super) fn check(map: &str, camera: Option<&Camera>) -> Result<(), ServiceError> {
    optics(camera).map(drop).ok_or_else(|| {
        ServiceError::invalid(format_args!(
            "the map {map} is navigated by appearance, which takes panoramas: declare a camera that is a panorama, or a \
             hyperbolic mirror with the radius of its horizon"
        ))
    })
}

impl Navigation {
    /// The way by looks from a place to a goal.
    pub(super) async fn plan_by_looks(
        &self,
        row: &MapRow,
        from: PlaceId,
        goal: &Goal,
    ) -> Result<WayByLooks, ServiceError> {
        let graph = self.graphs.of(row).await?;
        let goals = self.images_of(row, &graph, goal).await?;
        let Some(here) = graph.image_of(from) else {
            return Err(ServiceError::not_found(format_args!(
                "the place {from} is no node of the map {}'s appearance graph; get the graph to see which there are",
                row.name
            )));
        };
        let planning = tokio::task::spawn_blocking(move || WayByLooks::plan(&graph, here, &goals));
        planning.await.map_err(ServiceError::internal)?
    }

    /// The images that a goal names.
    async fn images_of(
        &self,
        row: &MapRow,
        graph: &Graph,
        goal: &Goal,
    ) -> Result<Vec<ImageId>, ServiceError> {
        let places = match goal {
            Goal::Place(place) => vec![*place],
            Goal::Label(label) => self.labels.labelled(row, label).await?,
            Goal::Position { .. } => {
                return Err(ServiceError::precondition(format_args!(
                    "the map {} is navigated by appearance and has no metres; name a place, a label, or send an image",
                    row.name
                )));
            }
        };
        goals::images(&row.name, graph, &places)
    }
}

fn optics(camera: Option<&Camera>) -> Option<PanoramicOptics> {
    camera.and_then(PanoramicOptics::of_camera)
}

impl AppearanceGuide {
    pub(super) fn new(
        identity: Identity,
        camera: Option<&Camera>,
        driving: Driving,
    ) -> Result<Self, ServiceError> {
        check(&identity.map, camera)?;
        let optics =
            optics(camera).ok_or_else(|| ServiceError::internal("a camera that was checked is gone"))?;
        let defaults = HeadingSteering::default();
        let Driving { speed_m_s, max_turn_rad_s, reverse_travel: _ } = driving;
        let steering = HeadingSteering {
            speed_m_s: speed_m_s.unwrap_or(defaults.speed_m_s),
            max_turn_rad_s: max_turn_rad_s.unwrap_or(defaults.max_turn_rad_s),
            ..defaults
        };
        Ok(Self {
            identity,
            optics,
            steering,
            before: tokio::sync::Mutex::new(None),
            state: Mutex::default(),
            refusals: watch::Sender::new(None),
        })
    }

    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    pub(super) fn view(&self, connected: bool) -> NavigationView {
        let state = self.state();
        let State { told, journey, goal_refusal, frames, closures, .. } = &*state;
        NavigationView {
            name: navigation_name(&self.identity.map, &self.identity.name),
            connected,
            guidance: *told,
            goal: journey.as_ref().map(|journey| journey.asked.clone()),
            route: None,
            goal_refusal: goal_refusal.clone(),
            frames: *frames,
            closures: *closures,
        }
    }

    pub(super) fn last_sequence(&self) -> Option<u64> {
        self.state().last_frame.map(|(sequence, _)| sequence)
    }

    pub(super) fn refusals(&self) -> watch::Receiver<Option<GoalRefusal>> {
        self.refusals.subscribe()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of a goal that is about to be asked for.
    pub(super) fn ask(&self) -> u64 {
        self.state().goals.ask()
    }

    /// The same where the robot hears of it in time.
    pub(super) fn ask_in_time(&self) -> u64 {
        self.state().goals.ask_in_time()
    }

    /// The robot stands from now on.
    pub(super) fn stop(&self) {
        let mut state = self.state();
        state.goals.stop();
        (state.journey, state.goal_refusal, state.heading, state.told) = (None, None, None, None);
    }

    /// A caller that waits for the arrival at the next goal must not take that at the last one for it.
    pub(super) fn leave_reached_goal(&self) {
        let mut state = self.state();
        if state.journey.as_ref().is_some_and(|journey| journey.has_arrived) {
            (state.journey, state.heading, state.told) = (None, None, None);
        }
    }

    pub(super) fn refuse(&self, asked: u64, refusal: GoalRefusal) {
        let mut state = self.state();
        if state.goals.refuse(asked) {
            state.goal_refusal = Some(refusal.clone());
            drop(state);
            self.refusals.send_replace(Some(refusal));
        }
    }

    /// Sets out for a goal, unless a later one than this that was `asked` for was taken meanwhile. Where it is refused, the
    /// robot goes on to the one that it had.
    pub(super) async fn go_to(
        &self,
        navigation: &Navigation,
        goal: GoalRequest,
        (asked, token): (u64, Option<&str>),
    ) -> Result<(), ServiceError> {
        let row = navigation.open_maps.row(&self.identity.map).await?;
        if row.id != self.identity.map_id {
            return Err(self.identity.replaced());
        }
        let graph = navigation.graphs.of(&row).await?;
        let goal = match goal {
            GoalRequest::Goal(goal) => goal,
            GoalRequest::Image(image) => {
                // As a frame, of none of its streams.
                let turn = navigation.quotas.frame(token, None, Instant::now())?;
                let place = self.place_of(navigation, graph.clone(), image).await;
                if !place.as_ref().is_err_and(ServiceError::is_for_now) {
                    turn.spend();
                }
                Goal::Place(place?)
            }
        };
        let images = navigation.images_of(&row, &graph, &goal).await?;
        let mut state = self.state();
        if state.goals.take(asked) {
            state.journey = Some(Journey::new(asked, goal, graph, images));
            // Of the goal before: a caller that waits for the arrival must not take it for that at this one.
            (state.goal_refusal, state.heading, state.told) = (None, None, None);
        }
        Ok(())
    }

    /// The place that looks most like an image.
    async fn place_of(
        &self,
        navigation: &Navigation,
        graph: Arc<Graph>,
        image: bytes::Bytes,
    ) -> Result<PlaceId, ServiceError> {
        let seen = self.panorama(navigation, Content::Image(image), Words::Undeclared, None).await?;
        let searching = {
            let graph = graph.clone();
            move || most_similar(&graph, &seen)
        };
        let found = tokio::task::spawn_blocking(searching).await.map_err(ServiceError::internal)?;
        found.and_then(|image| graph.place_of(image)).ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "the image looks like no place of the map {}; send a panorama that was taken there",
                self.identity.map
            ))
        })
    }

    async fn panorama(
        &self,
        navigation: &Navigation,
        content: Content,
        words: Words,
        stream: Option<u64>,
    ) -> Result<Shown, ServiceError> {
        let model = self.identity.model.clone();
        let optics = self.optics.clone();
        let observed = navigation
            .extraction
            .observe(model.clone(), content, words, Keep::Words, Some(optics.clone()), stream)
            .await?;
        let Observed { observation: _, features, media: _, extract: _, quantize: _ } = observed;
        let shown = match features {
            Some(features) => {
                let shown = move || Shown::new(&model, &optics, &features);
                tokio::task::spawn_blocking(shown).await.map_err(ServiceError::internal)??
            }
            None => None,
        };
        shown.ok_or_else(|| {
            ServiceError::invalid(
                "by appearance a robot is led by how features look, which words do not tell: send the panorama itself",
            )
        })
    }

    /// Looks at a panorama, after those before it, and says where to drive.
    pub(super) async fn look(
        &self,
        navigation: &Navigation,
        frame: Frame,
        words: Words,
        stream: u64,
    ) -> Result<Looked, ServiceError> {
        let Frame { sequence, stamp_ns, content, odometry, note: _ } = frame;
        let mut before = self.before.lock().await;
        self.check_order(sequence, stamp_ns)?;
        let seen = Arc::new(self.panorama(navigation, content, words, Some(stream)).await?);
        let (journey, body) = {
            let mut state = self.state();
            state.last_frame = Some((sequence, stamp_ns));
            state.frames += 1;
            (state.journey.clone(), state.body())
        };
        let last = before.replace(seen.view.clone());
        let step = match journey {
            Some(journey) if !journey.has_arrived => Some(stepped(journey, seen, last, body).await?),
            Some(_) | None => None,
        };
        let mut state = self.state();
        let mut subgoal = None;
        if let Some((journey, step)) = step
            && state.journey.as_ref().is_some_and(|now| now.number == journey.number)
        {
            let since_ns = state.last_report.map_or(stamp_ns, |report| report.stamp_ns.max(stamp_ns));
            let heading = self.heading(&journey, &step, odometry.as_ref(), since_ns);
            subgoal = heading.view.subgoal.filter(|_| step.similarity.is_some_and(|s| s > LINK_SIMILARITY));
            state.closures += u64::from(subgoal.is_some());
            (state.journey, state.heading) = (Some(journey), Some(heading));
        }
        let told = state.tell(stamp_ns, odometry.as_ref().map(yaw_rad), &self.steering);
        let outcome = if subgoal.is_some() { Seen::Corrected } else { Seen::Nothing };
        let seen = FrameSeen { sequence, seen: Some(outcome), place: subgoal, probability: None };
        Ok(Looked { seen, told: Some(told) })
    }

    /// `since_ns` is the robot's latest stamp of when it was found.
    fn heading(&self, journey: &Journey, step: &Step, odometry: Option<&Odometry>, since_ns: i64) -> Heading {
        let place = |image: Option<ImageId>| journey.graph.place_of(image?);
        Heading {
            status: step.status,
            view: AppearanceView {
                heading_rad: step.heading_rad.map(|heading| self.optics.of_the_robot(heading)),
                subgoal: place(step.subgoal),
                goal: place(journey.goal()),
                similarity: step.similarity,
                left: step.left,
                unjoined: step.unjoined,
            },
            yaw_rad: odometry.map(yaw_rad),
            since_ns,
        }
    }

    /// Answers what the robot says of itself with where to drive, as far as it has turned since the last panorama.
    pub(super) fn report(&self, report: &BodyReport) -> Result<Told, ServiceError> {
        let BodyReport { stamp_ns, odometry, obeyed: _, driver } = report;
        let mut state = self.state();
        if let Some(last) = state.last_report.filter(|last| *stamp_ns <= last.stamp_ns) {
            return Err(ServiceError::precondition(format_args!(
                "the stamp {stamp_ns} ns is not after {} ns, the last report's; send reports in order, with the robot's \
                 own steady clock",
                last.stamp_ns
            )));
        }
        let yaw_rad = odometry.as_ref().map(yaw_rad);
        state.last_report = Some(Report { stamp_ns: *stamp_ns, driver: *driver });
        Ok(state.tell(*stamp_ns, yaw_rad, &self.steering))
    }

    fn check_order(&self, sequence: u64, stamp_ns: i64) -> Result<(), ServiceError> {
        match self.state().last_frame {
            Some((last, last_ns)) if sequence <= last || stamp_ns <= last_ns => {
                Err(ServiceError::precondition(format_args!(
                    "the frame {sequence} of {stamp_ns} ns comes after the frame {last} of {last_ns} ns; number frames \
                     upwards, and stamp them with the robot's own steady clock"
                )))
            }
            Some(_) | None => Ok(()),
        }
    }
}

/// The navigator's work, off the async threads.
async fn stepped(
    mut journey: Journey,
    seen: Arc<Shown>,
    before: Option<Arc<PanoramicView>>,
    body: Body,
) -> Result<(Journey, Step), ServiceError> {
    let stepping = tokio::task::spawn_blocking(move || {
        let step = journey.step(&seen, before.as_deref(), body)?;
        Ok((journey, step))
    });
    stepping.await.map_err(ServiceError::internal)?
}

/// To the left, seen from above.
fn yaw_rad(odometry: &Odometry) -> f64 {
    odometry.pose().rotation.euler_angles().2
}
