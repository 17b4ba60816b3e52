//! One event after the other.

mod corrected;

use std::collections::{BTreeMap, BTreeSet};

use fabmap::appearance::PlaceId;
use fabmap::place_filter::Belief;

use super::ways::{Run, Stood, Ways};
use super::{Dropped, RetellError, Retold};
use crate::evidence::{Candidate, Match};
use crate::ids::{FrameId, SessionId};
use crate::log::{Decision, FrameEvent, Link, MapEvent, MeasuredEvent, MovedPlace, Reason};
use crate::metric::RelativePose;
use crate::settings::MapperSettings;
use corrected::Withdrawn;

/// What is left out.
pub(super) struct Left<'a> {
    pub(super) sessions: &'a BTreeSet<SessionId>,
    pub(super) places: &'a BTreeSet<PlaceId>,
    /// Frames that people say are not at the places where the log has them, and the closure by which each came there:
    /// none makes a place, nor stays where its closure is gone.
    pub(super) withdrawn: &'a BTreeMap<FrameId, FrameId>,
}

pub(super) struct Teller<'a> {
    left: &'a Left<'a>,
    /// Position, in the old log, of the event that is being rewritten.
    position: u64,
    events: Vec<MapEvent>,
    frames: BTreeMap<FrameId, FrameId>,
    /// By sessions so far; `None` for those that are left out.
    runs: BTreeMap<SessionId, Option<Run>>,
    next_session: SessionId,
    /// What places so far have become; `None` for those that nothing told has made yet, or ever
    /// will.
    places: Vec<Option<MovedPlace>>,
    /// The frame that made each of the new places.
    makers: Vec<FrameId>,
    ways: Ways<'a>,
    /// The last frame of each session, by positions in the old log.
    last_frames: BTreeMap<SessionId, FrameId>,
    /// By positions in the new log: the link that an event stands for, where that is another.
    relinked: BTreeMap<u64, Option<Link>>,
    /// By positions in the old log.
    withdrawals: BTreeMap<u64, Withdrawn>,
    dropped: Dropped,
}

/// Where a frame is in the new log.
#[derive(Clone, Copy, Debug)]
enum Here {
    /// At no place, as before.
    Nowhere,
    /// At a place that is left out.
    Dropped,
    /// At a place that is known by then.
    Known(MovedPlace),
    /// It makes the place, as before.
    Makes(MovedPlace),
    /// It makes the place, which something made before that is left out.
    MakesInstead(MovedPlace),
}

impl Here {
    fn rebased(&self) -> Option<MovedPlace> {
        match *self {
            Here::Nowhere | Here::Dropped => None,
            Here::Known(rebased) | Here::Makes(rebased) | Here::MakesInstead(rebased) => Some(rebased),
        }
    }
}

impl<'a> Teller<'a> {
    pub(super) fn new(settings: &'a MapperSettings, left: &'a Left<'a>) -> Self {
        Self {
            left,
            position: 0,
            events: Vec::new(),
            frames: BTreeMap::new(),
            runs: BTreeMap::new(),
            next_session: 0,
            places: Vec::new(),
            makers: Vec::new(),
            ways: Ways::new(settings),
            last_frames: BTreeMap::new(),
            relinked: BTreeMap::new(),
            withdrawals: BTreeMap::new(),
            dropped: Dropped::default(),
        }
    }

    pub(super) fn tell(&mut self, event: &MapEvent) -> Result<(), RetellError> {
        let told = match event {
            MapEvent::SessionOpened { session } => self.opened(*session)?,
            MapEvent::Frame(event) => self.frame(event)?.map(|told| MapEvent::Frame(Box::new(told))),
            MapEvent::Measured(event) => self.measured(event)?.map(|told| MapEvent::Measured(Box::new(told))),
            MapEvent::Corrected(event) => {
                self.corrected(event)?.map(|told| MapEvent::Corrected(Box::new(told)))
            }
        };
        match told {
            Some(event) => {
                self.frames.insert(self.position, self.now());
                self.events.push(event);
            }
            None => self.dropped.events += 1,
        }
        self.position += 1;
        Ok(())
    }

    /// What has been told, and how many sessions there were.
    pub(super) fn end(mut self) -> (Retold, u64) {
        self.dropped.places = self.places.iter().filter(|place| place.is_none()).count() as u64;
        let numbers = self.runs.iter().filter_map(|(&was, run)| Some((was, run.as_ref()?.number)));
        let retold = Retold {
            sessions: numbers.collect(),
            events: self.events,
            frames: self.frames,
            places: self.places.iter().map(|place| place.map(|rebased| rebased.place)).collect(),
            dropped: self.dropped,
        };
        (retold, self.runs.len() as u64)
    }

    /// Position, in the new log, of the event that is being rewritten.
    fn now(&self) -> u64 {
        self.events.len() as u64
    }

    fn unknown(&self) -> RetellError {
        RetellError::Unknown { position: self.position }
    }

    fn at_its_position(&self, found: u64) -> Result<(), RetellError> {
        let expected = self.position;
        if found == expected { Ok(()) } else { Err(RetellError::Position { expected, found }) }
    }

    fn opened(&mut self, session: SessionId) -> Result<Option<MapEvent>, RetellError> {
        if session as usize != self.runs.len() {
            return Err(self.unknown());
        }
        if self.left.sessions.contains(&session) {
            self.runs.insert(session, None);
            return Ok(None);
        }
        let number = self.next_session;
        self.next_session += 1;
        self.runs.insert(session, Some(Run::new(number)));
        Ok(Some(MapEvent::SessionOpened { session: number }))
    }

    fn frame(&mut self, event: &FrameEvent) -> Result<Option<FrameEvent>, RetellError> {
        self.at_its_position(event.frame)?;
        self.last_frames.insert(event.session, event.frame);
        let creates = event.decision.place.is_some_and(|place| place.index() == self.places.len());
        if creates {
            self.places.push(None);
        }
        self.follow_old_link(event.link.as_ref())?;
        let Some(mut run) = self.runs.get(&event.session).ok_or(self.unknown())?.clone() else {
            return Ok(None);
        };
        let here = self.here(event, creates)?;
        let (belief, gone) = self.belief(&event.belief, here);
        let candidates = self.candidates(&event.candidates)?;
        let decision = self.decision(event, here, gone)?;
        let at = match here {
            Here::Nowhere | Here::Dropped => None,
            Here::Known(rebased) => event.at.map(|at| rebased.seen(&at)),
            Here::Makes(_) => event.at,
            Here::MakesInstead(_) => event.at.map(|_| RelativePose::none()),
        };
        let told = FrameEvent {
            frame: self.now(),
            session: run.number,
            sequence: event.sequence,
            stamp_ns: event.stamp_ns,
            odometry: event.odometry.clone(),
            observation: event.observation.clone(),
            decision,
            new_place_posterior: self.new_place_posterior(event, here, gone),
            proposal: match &event.proposal {
                Some(proposal) => self.moved(proposal)?,
                None => None,
            },
            candidates,
            learnt: match here {
                Here::Nowhere | Here::Dropped => false,
                Here::Known(_) | Here::Makes(_) => event.learnt,
                Here::MakesInstead(_) => true,
            },
            link: None,
            at,
            belief,
            look_alike_inliers: event.look_alike_inliers,
        };
        let link = self.link(&run, event, &told, here);
        let told = FrameEvent { link, ..told };
        run.follow(event.decision.place, &told, &self.ways);
        self.runs.insert(event.session, Some(run));
        Ok(Some(told))
    }

    /// Where a frame of a session that stays is; makes the place if nothing has.
    fn here(&mut self, event: &FrameEvent, creates: bool) -> Result<Here, RetellError> {
        let Some(place) = event.decision.place else { return Ok(Here::Nowhere) };
        let known = *self.places.get(place.index()).ok_or(self.unknown())?;
        if self.left.places.contains(&place) {
            return Ok(Here::Dropped);
        }
        // One that stayed goes with its closure: another session may have made the place between the two.
        let is_gone = |&closure: &FrameId| {
            if closure == event.frame { known.is_none() } else { !self.closes(closure) }
        };
        if self.left.withdrawn.get(&event.frame).is_some_and(is_gone) {
            return Ok(Here::Dropped);
        }
        if let Some(rebased) = known {
            return Ok(Here::Known(rebased));
        }
        // The new place's frame is that of the robot here.
        let at = event.at.filter(|_| !creates).map(|at| at.back());
        let rebased = MovedPlace { place: PlaceId::from_index(self.makers.len()), at };
        self.places[place.index()] = Some(rebased);
        self.makers.push(self.now());
        Ok(if creates { Here::Makes(rebased) } else { Here::MakesInstead(rebased) })
    }

    /// Whether a closure of the old log is one in the new.
    fn closes(&self, closure: FrameId) -> bool {
        let told = self.frames.get(&closure).and_then(|&frame| self.told(frame));
        told.is_some_and(|told| told.decision.reason == Reason::LoopClosure)
    }

    /// The same decision; a closure onto a place that nothing told has seen before is a new place.
    fn decision(&mut self, event: &FrameEvent, here: Here, gone: f64) -> Result<Decision, RetellError> {
        let Decision { reason, posterior, closure, .. } = event.decision;
        let place = here.rebased().map(|rebased| rebased.place);
        let closure = match &closure {
            Some(closure) => self.moved(closure)?,
            None => None,
        };
        let somewhere_new = self.new_place_posterior(event, here, gone);
        Ok(match (here, reason) {
            (Here::MakesInstead(_) | Here::Dropped, _) => {
                self.dropped.closures += u64::from(reason == Reason::LoopClosure);
                Decision { reason: Reason::NewPlace, place, posterior: somewhere_new, closure: None }
            }
            // What it was refused as is gone.
            (Here::Makes(_), Reason::BelowThreshold | Reason::GeometryRefused) if closure.is_none() => {
                let reason = if event.decision.closure.is_some() { Reason::NewPlace } else { reason };
                Decision { reason, place, posterior: somewhere_new, closure }
            }
            (Here::Makes(_) | Here::Nowhere, _) => {
                Decision { reason, place, posterior: (posterior + gone).min(1.0), closure }
            }
            (Here::Known(_), _) => Decision { reason, place, posterior, closure },
        })
    }

    /// Places that nothing told has made are somewhere new.
    fn new_place_posterior(&self, event: &FrameEvent, here: Here, gone: f64) -> f64 {
        let here = match here {
            Here::MakesInstead(_) => event.decision.posterior,
            Here::Nowhere | Here::Dropped | Here::Known(_) | Here::Makes(_) => 0.0,
        };
        (event.new_place_posterior + gone + here).min(1.0)
    }

    /// A match with a frame that stays.
    fn matched(&self, matched: &Match) -> Result<Option<Match>, RetellError> {
        let place = self.places.get(matched.place.index()).ok_or(self.unknown())?;
        let ends = place.zip(self.frames.get(&matched.frame).copied());
        Ok(ends.map(|(place, frame)| Match { place: place.place, frame, ..*matched }))
    }

    /// The same place, by the frame that made it where the one that matched is gone.
    fn moved(&self, matched: &Match) -> Result<Option<Match>, RetellError> {
        let same = self.matched(matched)?;
        let place = self.places[matched.place.index()].map(|rebased| rebased.place);
        let by_maker = place.map(|place| (place, self.makers[place.index()]));
        // Not the frame itself that is being rewritten.
        let by_maker = by_maker.filter(|&(_, frame)| frame < self.now());
        Ok(same.or(by_maker.map(|(place, frame)| Match { place, frame, ..*matched })))
    }

    fn candidates(&self, candidates: &[Candidate]) -> Result<Vec<Candidate>, RetellError> {
        let told = candidates.iter().map(|candidate| {
            let matched = self.matched(&candidate.matched)?;
            let place = self.places[candidate.matched.place.index()];
            let seen_from = place.zip(candidate.seen_from).map(|(place, at)| place.seen(&at));
            Ok(matched.map(|matched| Candidate { matched, seen_from, ..*candidate }))
        });
        Ok(told.collect::<Result<Vec<_>, RetellError>>()?.into_iter().flatten().collect())
    }

    /// The same belief, and how much of it was of places that nothing told has made: that is
    /// somewhere new.
    fn belief(&self, belief: &Belief, here: Here) -> (Belief, f64) {
        let of = |place: PlaceId| self.places.get(place.index()).copied().flatten();
        let known = belief.places.iter().filter_map(|&(place, mass)| Some((of(place)?.place, mass)));
        let mut places: Vec<(PlaceId, f64)> = known.collect();
        places.sort_unstable_by_key(|&(place, _)| place);
        let gone = belief.places.iter().filter(|(place, _)| of(*place).is_none()).map(|(_, mass)| mass).sum();
        let mut new_place = belief.new_place + gone;
        if let Here::MakesInstead(rebased) = here
            && let Some((_, mass)) = places.iter_mut().find(|(place, _)| *place == rebased.place)
        {
            // As of a place that is created.
            *mass += std::mem::take(&mut new_place);
        }
        (Belief { places, new_place, remainder: belief.remainder }, gone)
    }

    /// What a link of the old log says of the old places, whatever event made it.
    fn follow_old_link(&mut self, link: Option<&Link>) -> Result<(), RetellError> {
        let Some(link) = link else { return Ok(()) };
        if [link.from, link.to].iter().any(|&place| place.index() >= self.places.len()) {
            return Err(self.unknown());
        }
        self.ways.follow_old(link);
        Ok(())
    }

    fn link(&mut self, run: &Run, event: &FrameEvent, told: &FrameEvent, here: Here) -> Option<Link> {
        let rebased = here.rebased();
        let kept = event.link.and_then(|link| {
            let [from, to] = [link.from, link.to].map(|place| self.places[place.index()]);
            Some((from?, to?, link))
        });
        let link = rebased.and_then(|rebased| match here {
            Here::MakesInstead(_) | Here::Makes(_) => self.ways.link_to_new_place(run, rebased, kept, told),
            Here::Known(_) | Here::Nowhere | Here::Dropped => {
                self.ways.link_to_known_place(run, rebased, kept, (event, told))
            }
        });
        self.dropped.links += u64::from(event.link.is_some() && link.is_none());
        link
    }

    /// The same measurement, where both its frames stay and something follows from it still.
    fn measured(&mut self, event: &MeasuredEvent) -> Result<Option<MeasuredEvent>, RetellError> {
        self.at_its_position(event.position)?;
        self.follow_old_link(event.link.as_ref())?;
        let place = *self.places.get(event.place.index()).ok_or(self.unknown())?;
        let run = self.runs.get(&event.session).ok_or(self.unknown())?.clone();
        let frames = [event.frame, event.earlier].map(|frame| self.frames.get(&frame).copied());
        let (Some(mut run), Some(place), [Some(frame), Some(earlier)]) = (run, place, frames) else {
            return Ok(None);
        };
        let link = event.link.and_then(|link| {
            let [from, to] = [link.from, link.to].map(|place| self.places[place.index()]);
            self.ways.measured(from?, to?, &link)
        });
        if link.is_none() && event.goes_on_from.is_none() {
            self.dropped.links += 1;
            return Ok(None);
        }
        let at = place.seen(&event.at);
        if let Some(odometry) = &event.goes_on_from {
            let is_there = run.stay.as_ref().is_some_and(|stay| stay.place == place.place);
            if !is_there {
                return Err(self.unknown());
            }
            run.go_on_from(Stood::new(event.place, place.place, Some(odometry.clone()), Some(at)));
        }
        let session = run.number;
        self.runs.insert(event.session, Some(run));
        let position = self.now();
        let goes_on_from = event.goes_on_from.clone();
        Ok(Some(MeasuredEvent {
            position,
            session,
            frame,
            earlier,
            place: place.place,
            at,
            link,
            goes_on_from,
        }))
    }
}
