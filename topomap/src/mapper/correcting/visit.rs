//! What rests on a loop closure: the frames that a session was at a place by it, and links.

use fabmap::appearance::PlaceId;

use super::Said;
use crate::ids::FrameId;
use crate::log::{
    Confirmation, Correction, CorrectionEvent, FrameEvent, Link, LinkKind, MeasuredEvent, Reason, Relinked,
    Resumed, Stood, Withdrawal,
};
use crate::mapper::errors::CorrectError;
use crate::mapper::state::Mapper;
use crate::metric::Odometry;
use crate::settings::GuardMeasure;

/// A session's visit to a place that it only seemed to be at.
///
/// What the visit left in the map is in the session's frames: [`Visit::came_from`] hears those
/// before the closure, latest first, until it has heard enough; then [`Visit::went_on`] those after
/// it, in their order. [`Visit::withdraw`] decides.
#[derive(Clone, Debug)]
pub struct Visit<'a> {
    mapper: &'a Mapper,
    closure: &'a FrameEvent,
    /// What robots measured at frames of the session.
    measured: &'a [MeasuredEvent],
    matched: FrameId,
    place: PlaceId,
    /// Where the session is without the visit.
    came: Resumed,
    /// Whether it is at the place by the visit, and whether its wheels go on from there.
    stays: bool,
    anchored: bool,
    /// It closed a loop with the same place again, which stands by itself.
    closed_again: bool,
    frames: Vec<FrameId>,
    relinked: Vec<Relinked>,
    /// How far the session has gone since it left the place, as the guard measures it.
    gone: f64,
    last_odometry: Option<Odometry>,
}

/// Whether a visit has heard enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing further away matters.
    Enough,
    /// The next frame may.
    More,
}

impl<'a> Visit<'a> {
    pub(super) fn begin(
        mapper: &'a Mapper,
        closure: &'a FrameEvent,
        measured: &'a [MeasuredEvent],
        (place, matched): (PlaceId, FrameId),
    ) -> Self {
        let anchored = mapper.stood(closure, measured).is_some_and(|stood| mapper.is_surely(&stood));
        let mut visit = Self {
            mapper,
            closure,
            measured,
            matched,
            place,
            came: Resumed::default(),
            stays: true,
            anchored,
            closed_again: false,
            frames: vec![closure.frame],
            relinked: Vec::new(),
            gone: 0.0,
            last_odometry: closure.odometry.clone(),
        };
        visit.relink(closure, None);
        visit
    }

    /// Hears of the frame before those that it has heard of.
    pub fn came_from(&mut self, frame: &FrameEvent) -> Heard {
        if let Some(stood) = self.mapper.stood(frame, self.measured) {
            if self.came.anchor.is_none() && self.mapper.is_surely(&stood) {
                self.came.anchor = Some(stood.clone());
            }
            self.came.stay.get_or_insert(stood);
        }
        let Resumed { stay, anchor } = &self.came;
        // Without odometry no way is measured, from however sure a place.
        let measures = self.closure.odometry.is_some();
        if stay.is_some() && (anchor.is_some() || !measures) { Heard::Enough } else { Heard::More }
    }

    /// Hears of the frame after those that it has heard of.
    pub fn went_on(&mut self, frame: &FrameEvent) -> Heard {
        self.gone += self.step(frame);
        // As the session, which keeps the last that there was.
        if frame.odometry.is_some() {
            self.last_odometry.clone_from(&frame.odometry);
        }
        if let Some(stood) = self.mapper.stood(frame, self.measured) {
            let rests =
                stood.place == self.place && frame.decision.reason == Reason::SamePlace && !self.closed_again;
            if rests {
                self.frames.push(frame.frame);
                self.relink(frame, None);
                self.gone = 0.0;
                self.stays = true;
                self.anchored |= self.mapper.is_surely(&stood);
            } else {
                self.closed_again |= stood.place == self.place;
                self.arrive(frame, stood);
            }
        }
        let guard = self.mapper.settings().guard_frames as f64;
        let is_over = self.closed_again || self.gone >= guard;
        if is_over && !self.stays && !self.anchored { Heard::Enough } else { Heard::More }
    }

    /// What follows from the closure being none.
    ///
    /// # Errors
    /// [`CorrectError::RestsOnIt`] if somebody says that one of its frames is at another place as
    /// well.
    pub fn withdraw(mut self, said: Said) -> Result<CorrectionEvent, CorrectError> {
        let has = |frame: FrameId| self.frames.binary_search(&frame).is_ok();
        let rests = |event: &&CorrectionEvent| match event.correction {
            Correction::Confirmed(Confirmation { frame, earlier, .. }) => has(frame) || has(earlier),
            Correction::Withdrawn(_) | Correction::Undone(_) => false,
        };
        if let Some(confirmed) = self.mapper.map().corrections().find(rests) {
            return Err(CorrectError::RestsOnIt { correction: confirmed.position });
        }
        let of_visit = self.measured.iter().filter(|event| has(event.frame));
        let relinked: Vec<Relinked> =
            of_visit.filter_map(|event| self.relinked(event.position, event.link, None)).collect();
        self.relinked.extend(relinked);
        let resumed = (self.stays || self.anchored).then_some(self.came);
        let withdrawal = Withdrawal {
            frame: self.closure.frame,
            earlier: self.matched,
            place: self.place,
            frames: self.frames,
            relinked: self.relinked,
            resumed,
        };
        Ok(self.mapper.said(self.closure.session, said, Correction::Withdrawn(Box::new(withdrawal))))
    }

    /// The session comes to a place by itself: its link to there may have begun at the visit.
    fn arrive(&mut self, frame: &FrameEvent, stood: Stood) {
        let link = self.mapper.map().link_of(frame.frame, frame.link);
        let rests = match link.map(|link| link.kind) {
            Some(LinkKind::Driven(_) | LinkKind::Closed(_) | LinkKind::Odometry(_)) => self.anchored,
            Some(LinkKind::Session) | None => self.stays,
        };
        if rests {
            let now = self.way_to(frame, &stood);
            self.relink(frame, now);
        }
        self.stays = false;
        if self.mapper.is_surely(&stood) {
            self.anchored = false;
            self.came.anchor = Some(stood.clone());
        }
        self.came.stay = Some(stood);
    }

    /// The way to where a frame is from where the session was without the visit, as the mapper
    /// would link it; `None` if that is the same place, or nowhere.
    fn way_to(&self, frame: &FrameEvent, to: &Stood) -> Option<Link> {
        let Resumed { stay, anchor } = &self.came;
        let noise = &self.mapper.settings().odometry_noise;
        let driven = anchor.as_ref().and_then(|anchor| {
            let way = noise.between(anchor.odometry.as_ref()?, to.odometry.as_ref()?);
            Some((anchor.place, anchor.at?.then(&way)))
        });
        let session = || Some((stay.as_ref()?.place, LinkKind::Session));
        let (from, kind) = match (frame.decision.reason, driven, to.at) {
            (
                Reason::NewPlace | Reason::BelowThreshold | Reason::GeometryRefused,
                Some((from, driven)),
                Some(_),
            ) => (from, LinkKind::Driven(driven)),
            (Reason::LoopClosure, Some((from, driven)), Some(at)) if self.mapper.is_surely(to) => {
                (from, LinkKind::Closed(driven.then(&at.back())))
            }
            (_, Some(_) | None, _) => session()?,
        };
        (from != to.place).then_some(Link { from, to: to.place, kind })
    }

    fn relink(&mut self, frame: &FrameEvent, now: Option<Link>) {
        self.relinked.extend(self.relinked(frame.frame, frame.link, now));
    }

    /// `None` if the event has stood for that link before.
    fn relinked(&self, event: u64, added: Option<Link>, now: Option<Link>) -> Option<Relinked> {
        let was = self.mapper.map().link_of(event, added);
        (was != now).then_some(Relinked { event, was, now })
    }

    /// How far a frame is from the last one, as the guard measures it.
    fn step(&self, frame: &FrameEvent) -> f64 {
        let settings = self.mapper.settings();
        match (settings.guard_measure, &self.last_odometry, &frame.odometry) {
            (GuardMeasure::Way, Some(before), Some(now)) => {
                let motion = settings.odometry_noise.between(before, now);
                settings.place_spacing.way(motion.pose()).min(1.0)
            }
            (GuardMeasure::Way, None, _) | (GuardMeasure::Way, _, None) | (GuardMeasure::Frames, _, _) => 1.0,
        }
    }
}

impl Mapper {
    /// Where a frame was taken, as corrections have it; `None` if at no place.
    fn stood(&self, frame: &FrameEvent, measured: &[MeasuredEvent]) -> Option<Stood> {
        let place = frame.decision.place.filter(|_| self.map().withdrawal_of(frame.frame).is_none())?;
        let better =
            measured.iter().rev().find(|event| event.frame == frame.frame && event.goes_on_from.is_some());
        let at = better.map_or(frame.at, |event| Some(event.at));
        Some(Stood { place, odometry: frame.odometry.clone(), at })
    }

    /// Whether wheels go on from there, as the fold says.
    fn is_surely(&self, stood: &Stood) -> bool {
        let spacing_m = self.settings().place_spacing.distance_m;
        stood.odometry.is_some() && stood.at.is_some_and(|at| at.position_sigma_m() <= spacing_m)
    }
}
