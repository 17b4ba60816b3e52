//! What people said, as far as what they said it of stays.

use super::super::RetellError;
use super::super::ways::{Run, Stood as Stands};
use super::Teller;
use crate::ids::{FrameId, SessionId};
use crate::log::{
    Confirmation, Correction, CorrectionEvent, Decision, FrameEvent, Link, MapEvent, Reason, Relinked,
    Resumed, Stood, Undoing, Withdrawal,
};

/// What a withdrawal has changed, by which it is undone.
pub(super) struct Withdrawn {
    /// In the old log.
    before: Vec<Relinked>,
    /// In the new.
    now: Vec<Relinked>,
    run: Run,
}

impl Teller<'_> {
    /// The same correction, where the frames stay that it is of, and something follows from it
    /// still.
    pub(super) fn corrected(
        &mut self,
        event: &CorrectionEvent,
    ) -> Result<Option<CorrectionEvent>, RetellError> {
        self.at_its_position(event.position)?;
        let CorrectionEvent { position, session, by, said_ns, correction } = event;
        let run = self.runs.get(session).ok_or(self.unknown())?.clone();
        let correction = match correction {
            Correction::Withdrawn(withdrawal) => {
                self.follow_old_links(&withdrawal.relinked);
                let told = match &run {
                    Some(run) => self.withdrawn(withdrawal, *session, run)?,
                    None => None,
                };
                let now = told.as_ref().map(|told| told.relinked.clone()).unwrap_or_default();
                if let Some(run) = &run {
                    let before = withdrawal.relinked.clone();
                    self.withdrawals.insert(*position, Withdrawn { before, now, run: run.clone() });
                }
                told.map(|told| Correction::Withdrawn(Box::new(told)))
            }
            Correction::Confirmed(Confirmation { frame, earlier, link }) => {
                if let Some(link) = link {
                    self.ways.follow_old(link);
                }
                run.as_ref().and_then(|_| self.confirmed([*frame, *earlier], link.as_ref()))
            }
            Correction::Undone(Undoing { correction, place }) => {
                self.undo(*correction, *session);
                let told = self.frames.get(correction).copied();
                let place = place.and_then(|place| self.places.get(place.index()).copied().flatten());
                let place = place.map(|place| place.place);
                told.map(|correction| Correction::Undone(Undoing { correction, place }))
            }
        };
        let told = run.zip(correction).map(|(run, correction)| CorrectionEvent {
            position: self.now(),
            session: run.number,
            by: by.clone(),
            said_ns: *said_ns,
            correction,
        });
        self.dropped.corrections += u64::from(told.is_none());
        Ok(told)
    }

    /// `None` if the frame is at no place of the new log anyway, or at one that it makes.
    fn withdrawn(
        &mut self,
        withdrawal: &Withdrawal,
        session: SessionId,
        run: &Run,
    ) -> Result<Option<Withdrawal>, RetellError> {
        let Withdrawal { frame, earlier: _, place, frames, relinked, resumed } = withdrawal;
        let place = *self.places.get(place.index()).ok_or(self.unknown())?;
        let Some((frame, place)) = self.frames.get(frame).copied().zip(place) else { return Ok(None) };
        let told = self.told(frame).map(|event| event.decision);
        let Some(Decision { reason: Reason::LoopClosure, place: Some(at), closure: Some(closure), .. }) =
            told
        else {
            return Ok(None);
        };
        if at != place.place {
            return Ok(None);
        }
        let told_frames: Vec<FrameId> =
            frames.iter().filter_map(|was| self.frames.get(was).copied()).collect();
        let of_visit = told_frames.iter().map(|&event| (event, None));
        let others = relinked.iter().filter(|relinked| !withdrawal.has(relinked.event));
        let others = others.filter_map(|relinked| Some((*self.frames.get(&relinked.event)?, relinked.now)));
        let links: Vec<(u64, Option<Link>)> = of_visit.chain(others).collect();
        let mut now = Vec::new();
        for (event, link) in links {
            let relinked = Relinked {
                event,
                was: self.link_now(event),
                now: link.and_then(|link| self.between_now(&link)),
            };
            if relinked.was != relinked.now {
                self.relink(&relinked);
                now.push(relinked);
            }
        }
        let resumed = resumed.as_ref().map(|resumed| {
            let mut run = run.clone();
            let stay = resumed.stay.as_ref().and_then(|stood| self.stood_now(stood));
            let anchor = resumed.anchor.as_ref().and_then(|stood| self.stood_now(stood));
            run.resume(stay.clone().map(|(_, stands)| stands), anchor.clone().map(|(_, stands)| stands));
            self.runs.insert(session, Some(run));
            Resumed { stay: stay.map(|(stood, _)| stood), anchor: anchor.map(|(stood, _)| stood) }
        });
        Ok(Some(Withdrawal {
            frame,
            earlier: closure.frame,
            place: place.place,
            frames: told_frames,
            relinked: now,
            resumed,
        }))
    }

    fn confirmed(&mut self, frames: [FrameId; 2], link: Option<&Link>) -> Option<Correction> {
        let [frame, earlier] = frames.map(|frame| self.frames.get(&frame).copied());
        let frame =
            frame.filter(|&frame| self.told(frame).is_some_and(|told| told.decision.place.is_some()))?;
        let earlier =
            earlier.filter(|&frame| self.told(frame).is_some_and(|told| told.decision.place.is_some()))?;
        let link = link.and_then(|link| self.between_now(link));
        if let Some(link) = &link {
            self.ways.relink(None, Some(link));
        }
        Some(Correction::Confirmed(Confirmation { frame, earlier, link }))
    }

    fn undo(&mut self, correction: u64, session: SessionId) {
        let Some(Withdrawn { before, now, run }) = self.withdrawals.remove(&correction) else { return };
        let undone = |Relinked { event, was, now }: Relinked| Relinked { event, was: now, now: was };
        self.follow_old_links(&before.into_iter().map(undone).collect::<Vec<_>>());
        now.into_iter().map(undone).for_each(|relinked| self.relink(&relinked));
        // Once it has gone on, it goes on from where it has come to.
        if self.last_frames.get(&session).is_none_or(|&last| last < correction) {
            self.runs.insert(session, Some(run));
        }
    }

    /// A link of the old log between what its ends have become.
    fn between_now(&self, link: &Link) -> Option<Link> {
        let [from, to] = [link.from, link.to].map(|place| self.places.get(place.index()).copied().flatten());
        self.ways.between(from?, to?, link)
    }

    fn stood_now(&self, Stood { place, odometry, at }: &Stood) -> Option<(Stood, Stands)> {
        let told = self.places.get(place.index()).copied().flatten()?;
        let at = at.map(|at| told.seen(&at));
        let stands = Stands::new(*place, told.place, odometry.clone(), at);
        Some((Stood { place: told.place, odometry: odometry.clone(), at }, stands))
    }

    pub(super) fn told(&self, frame: FrameId) -> Option<&FrameEvent> {
        match self.events.get(usize::try_from(frame).ok()?)? {
            MapEvent::Frame(event) => Some(event),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
        }
    }

    /// The link that an event of the new log stands for.
    fn link_now(&self, event: u64) -> Option<Link> {
        if let Some(relinked) = self.relinked.get(&event) {
            return *relinked;
        }
        match self.events.get(usize::try_from(event).ok()?)? {
            MapEvent::Frame(event) => event.link,
            MapEvent::Measured(event) => event.link,
            MapEvent::SessionOpened { .. } | MapEvent::Corrected(_) => None,
        }
    }

    fn relink(&mut self, Relinked { event, was, now }: &Relinked) {
        self.relinked.insert(*event, *now);
        self.ways.relink(was.as_ref(), now.as_ref());
    }

    fn follow_old_links(&mut self, relinked: &[Relinked]) {
        for Relinked { was, now, .. } in relinked {
            self.ways.relink_old(was.as_ref(), now.as_ref());
        }
    }
}
