//! The source's log, rewritten as what happened on the target.

mod corrected;

use std::collections::{BTreeMap, BTreeSet, HashMap};

use fabmap::appearance::PlaceId;
use fabmap::place_filter::Belief;

use super::{FusedPlace, MergePlan, PlaceMatch};
use crate::evidence::{Candidate, Match, ProbabilityWeights, VerificationSettings, unknown_over_frames};
use crate::ids::{FrameId, SessionId};
use crate::log::{
    Decision, FrameEvent, Link, LinkKind, MapEvent, MeasuredEvent, MovedPlace, Reason, Relinked,
};
use crate::map::PlacePoses;
use crate::mapper::Mapper;
use crate::metric::wheel_drift::without_drift;
use crate::metric::{OdometryNoise, RelativePose};

/// A log that is not that of the map the plan was made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JoinError {
    /// It names what it has not made before.
    #[error(
        "event {position} of the source's log names a place, frame or session that no event before has made"
    )]
    Unknown {
        /// Its position.
        position: u64,
    },
}

/// The events that make of the target what both maps are together.
///
/// Sessions and frames of the source get the next numbers of the target. A place of the source that
/// the plan has a match for becomes the place that it matches: what the source learnt there is
/// learnt by that, look by look; all other places are created as they were. Links go between the
/// same places as before, and measure what they measured, less the drift that the source's loops
/// have shown of its wheels: where places are fused, those loops are the target's.
///
/// # Errors
/// [`JoinError`] if `log` is not the source's.
pub fn join<'a>(
    (source, target): (&Mapper, &Mapper),
    plan: &MergePlan,
    log: impl IntoIterator<Item = &'a MapEvent>,
) -> Result<Vec<MapEvent>, JoinError> {
    let mut joining = Joining::new(source, target, plan);
    let told = |(position, event): (u64, &MapEvent)| {
        joining.retold(position, event).ok_or(JoinError::Unknown { position })
    };
    (0..).zip(log).map(told).collect()
}

struct Joining<'a> {
    of_source: &'a PlacePoses,
    /// By places of the source: the match that each is fused by.
    fused: HashMap<PlaceId, &'a FusedPlace>,
    noise: OdometryNoise,
    /// What places of the source are on the target.
    places: Vec<MovedPlace>,
    frames: BTreeMap<FrameId, FrameId>,
    sessions: BTreeMap<SessionId, SessionId>,
    next_event: u64,
    next_session: SessionId,
    next_place: PlaceId,
    /// Both ways.
    linked: BTreeSet<(PlaceId, PlaceId)>,
    /// The links that events stand for, by their positions on the target.
    links: BTreeMap<u64, Link>,
    /// What withdrawals have relinked, by their positions on the target.
    relinked: BTreeMap<u64, Vec<Relinked>>,
}

impl<'a> Joining<'a> {
    fn new(source: &'a Mapper, target: &Mapper, plan: &'a MergePlan) -> Self {
        let fused = plan.fused.iter().map(|fused| (fused.matched.source, fused)).collect();
        let linked =
            target.map().standing_links().flat_map(|(_, link)| [(link.from, link.to), (link.to, link.from)]);
        Self {
            of_source: source.poses(),
            fused,
            noise: target.settings().odometry_noise,
            places: Vec::new(),
            frames: BTreeMap::new(),
            sessions: BTreeMap::new(),
            next_event: target.map().events(),
            next_session: target.map().next_session(),
            next_place: PlaceId::from_index(target.map().places().len()),
            linked: linked.collect(),
            links: BTreeMap::new(),
            relinked: BTreeMap::new(),
        }
    }

    fn retold(&mut self, position: u64, event: &MapEvent) -> Option<MapEvent> {
        let now = self.next_event;
        self.next_event += 1;
        self.frames.insert(position, now);
        match event {
            MapEvent::SessionOpened { session } => {
                let here = self.next_session;
                self.next_session += 1;
                self.sessions.insert(*session, here);
                Some(MapEvent::SessionOpened { session: here })
            }
            MapEvent::Frame(event) => {
                let event = self.frame(now, event)?;
                self.links.extend(event.link.map(|link| (now, link)));
                Some(MapEvent::Frame(Box::new(event)))
            }
            MapEvent::Measured(event) => {
                let event = self.measured(now, event)?;
                self.links.extend(event.link.map(|link| (now, link)));
                Some(MapEvent::Measured(Box::new(event)))
            }
            MapEvent::Corrected(event) => Some(MapEvent::Corrected(Box::new(self.corrected(now, event)?))),
        }
    }

    /// The same measurement, between the same frames.
    fn measured(&self, position: u64, event: &MeasuredEvent) -> Option<MeasuredEvent> {
        let joined = self.places.get(event.place.index())?;
        let link = event.link.and_then(|link| {
            let from = self.places.get(link.from.index())?;
            let to = self.places.get(link.to.index())?;
            let LinkKind::Closed(measured) = link.kind else { return None };
            let kind = LinkKind::Closed(from.way_to(to, &measured));
            (from.place != to.place).then_some(Link { from: from.place, to: to.place, kind })
        });
        Some(MeasuredEvent {
            position,
            session: *self.sessions.get(&event.session)?,
            frame: *self.frames.get(&event.frame)?,
            earlier: *self.frames.get(&event.earlier)?,
            place: joined.place,
            at: joined.seen(&event.at),
            link,
            goes_on_from: event.goes_on_from.clone(),
        })
    }

    fn frame(&mut self, frame: FrameId, event: &FrameEvent) -> Option<FrameEvent> {
        let mut candidates: Vec<Candidate> =
            event.candidates.iter().map(|candidate| self.candidate(candidate)).collect::<Option<_>>()?;
        let decision = self.decision(&event.decision, &mut candidates)?;
        let joined = event.decision.place.map(|place| self.places[place.index()]);
        let at = event.at.map(|at| joined.map_or(at, |joined| joined.seen(&at)));
        Some(FrameEvent {
            frame,
            session: *self.sessions.get(&event.session)?,
            sequence: event.sequence,
            stamp_ns: event.stamp_ns,
            odometry: event.odometry.clone(),
            observation: event.observation.clone(),
            decision,
            new_place_posterior: event.new_place_posterior,
            proposal: match &event.proposal {
                Some(proposal) => Some(self.matched(proposal)?),
                None => None,
            },
            candidates,
            learnt: event.learnt,
            link: match &event.link {
                Some(link) => self.link(link, event.session)?,
                None => None,
            },
            at,
            look_alike_inliers: event.look_alike_inliers,
            belief: self.belief(&event.belief)?,
        })
    }

    /// The same decision; a place that is created and fused is a loop that closes.
    fn decision(&mut self, decision: &Decision, candidates: &mut Vec<Candidate>) -> Option<Decision> {
        let closure = match &decision.closure {
            Some(closure) => Some(self.matched(closure)?),
            None => None,
        };
        let Some(place) = decision.place else { return Some(Decision { closure, ..*decision }) };
        if place.index() < self.places.len() {
            return Some(Decision { place: Some(self.places[place.index()].place), closure, ..*decision });
        }
        if place.index() != self.places.len() {
            return None;
        }
        let Some(&FusedPlace { matched, at }) = self.fused.get(&place).copied() else {
            let created = self.next_place;
            self.places.push(MovedPlace { place: created, at: None });
            self.next_place = created.next();
            return Some(Decision { place: Some(created), closure, ..*decision });
        };
        self.places.push(MovedPlace { place: matched.target, at: Some(at) });
        let log_odds = (matched.posterior / (1.0 - matched.posterior).max(f64::MIN_POSITIVE)).ln();
        let PlaceMatch { target: place, target_frame: frame, posterior, view, .. } = matched;
        let closure = Match { place, posterior, log_odds: log_odds.max(f64::MIN), frame };
        candidates.truncate(VerificationSettings::MAX_CANDIDATES - 1);
        let candidate = Candidate::new(closure, view, None, unknown_over_frames());
        candidates.push(candidate.judged(0.0, &ProbabilityWeights::default()));
        Some(Decision { reason: Reason::LoopClosure, place: Some(place), posterior, closure: Some(closure) })
    }

    fn candidate(&self, candidate: &Candidate) -> Option<Candidate> {
        let place = self.places.get(candidate.matched.place.index())?;
        let seen_from = candidate.seen_from.map(|at| place.seen(&at));
        Some(Candidate { matched: self.matched(&candidate.matched)?, seen_from, ..*candidate })
    }

    fn matched(&self, matched: &Match) -> Option<Match> {
        let place = self.places.get(matched.place.index())?.place;
        Some(Match { place, frame: *self.frames.get(&matched.frame)?, ..*matched })
    }

    /// The link between the same places; none where they are one, or linked already.
    fn link(&mut self, link: &Link, session: SessionId) -> Option<Option<Link>> {
        let from = *self.places.get(link.from.index())?;
        let to = *self.places.get(link.to.index())?;
        let from = &from;
        let to = &to;
        if from.place == to.place || !self.linked.insert((from.place, to.place)) {
            return Some(None);
        }
        self.linked.insert((to.place, from.place));
        let kind = self.kind(&link.kind, (from, to), session);
        Some(Some(Link { from: from.place, to: to.place, kind }))
    }

    /// What a link measures between what its places have become.
    fn kind(&self, kind: &LinkKind, (from, to): (&MovedPlace, &MovedPlace), session: SessionId) -> LinkKind {
        let drift_rad_per_m = self.of_source.drift_rad_per_m(session);
        let driven = |measured: &RelativePose| {
            let pose = without_drift(measured.pose(), drift_rad_per_m);
            let measured = RelativePose::new(pose, *measured.covariance()).unwrap_or(*measured);
            match to.at {
                None => LinkKind::Driven(from.way_to(to, &measured)),
                Some(_) => LinkKind::Closed(from.way_to(to, &measured)),
            }
        };
        match kind {
            LinkKind::Session => LinkKind::Session,
            LinkKind::Odometry(relative) => driven(&self.noise.from_above(relative)),
            LinkKind::Driven(measured) => driven(measured),
            LinkKind::Closed(measured) => LinkKind::Closed(from.way_to(to, measured)),
        }
    }

    /// The same belief; what was believed of places that are one now adds up.
    fn belief(&self, belief: &Belief) -> Option<Belief> {
        let mut places: BTreeMap<PlaceId, f64> = BTreeMap::new();
        for &(place, probability) in &belief.places {
            *places.entry(self.places.get(place.index())?.place).or_insert(0.0) += probability;
        }
        Some(Belief { places: places.into_iter().collect(), ..*belief })
    }
}
