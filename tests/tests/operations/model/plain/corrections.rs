//! What people say of loop closures, as the model has it. When it was said is in the log, and only the server knows it: until
//! that is heard, the event waits.

use topomap::log::{Correction, CorrectionEvent, FrameEvent, MapEvent};
use topomap::mapper::{CorrectError, Heard, Said, SamePlace};
use waypost_client::Code;
use waypost_client::v1::token::Ability;

use super::map::PlainMap;
use super::tokens::{Access, Shown};
use super::{MapName, World};

/// A frame of a map, by session and number.
pub(in super::super) type NamedFrame = (String, u64);

impl PlainMap {
    /// The frame that a number of an operation stands for; one that is not there, if there is none.
    pub(in super::super) fn named_frame(&self, which: u32) -> NamedFrame {
        self.named(self.log.iter().filter_map(frame), which)
    }

    /// The same of those that closed a loop.
    pub(in super::super) fn named_closure(&self, which: u32) -> NamedFrame {
        let closed = |frame: &&FrameEvent| frame.decision.closure.is_some();
        self.named(self.log.iter().filter_map(frame).filter(closed), which)
    }

    fn named<'a>(&self, frames: impl Iterator<Item = &'a FrameEvent>, which: u32) -> NamedFrame {
        let frames: Vec<&FrameEvent> = frames.collect();
        let Some(any) = (which as usize).checked_rem(frames.len()) else { return ("s0".to_owned(), 1) };
        let FrameEvent { session, sequence, .. } = frames[any];
        (self.sessions[*session as usize].name.clone(), *sequence)
    }

    fn found(&self, (session, sequence): &NamedFrame) -> Result<FrameEvent, Code> {
        let number = self.number(session).ok_or(Code::NotFound)?;
        self.frames_of(number).find(|frame| frame.sequence == *sequence).cloned().ok_or(Code::NotFound)
    }

    /// Positions of all corrections that were made, undone ones, too; what was said, and whether it was undone.
    pub(in super::super) fn said(&self) -> Vec<(u64, &'static str, bool)> {
        let corrections = || {
            self.log.iter().filter_map(|event| match event {
                MapEvent::Corrected(event) => Some(event),
                MapEvent::SessionOpened { .. } | MapEvent::Frame(_) | MapEvent::Measured(_) => None,
            })
        };
        let undone = |position: u64| {
            corrections().any(|event| match &event.correction {
                Correction::Undone(undoing) => undoing.correction == position,
                Correction::Withdrawn(_) | Correction::Confirmed(_) => false,
            })
        };
        let said = |event: &CorrectionEvent| match event.correction {
            Correction::Withdrawn(_) => Some("Withdrawn"),
            Correction::Confirmed(_) => Some("Confirmed"),
            Correction::Undone(_) => None,
        };
        corrections()
            .filter_map(|event| Some((event.position, said(event)?, undone(event.position))))
            .collect()
    }

    /// Takes what was said in, now that it is known when.
    fn said_at(&mut self, said_ns: i64) {
        if let Some(waiting) = self.waiting.take() {
            self.take(MapEvent::Corrected(Box::new(CorrectionEvent { said_ns, ..waiting })));
            self.streamed = None;
        }
    }
}

fn frame(event: &MapEvent) -> Option<&FrameEvent> {
    match event {
        MapEvent::Frame(frame) => Some(frame),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
    }
}

impl World {
    pub(in super::super) fn withdraw(
        &mut self,
        shown: &Shown,
        (map, closure): (&str, &NamedFrame),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        let known = self.map(map)?;
        let closure = known.found(closure)?;
        let session = |frame: &&FrameEvent| frame.session == closure.session;
        let mut visit = known.mapper.visit(&closure, &[]).map_err(|error| code_of(&error))?;
        let before: Vec<&FrameEvent> =
            known.frames().filter(session).filter(|frame| frame.frame < closure.frame).collect();
        let enough = |heard: Heard| heard == Heard::Enough;
        let _ = before.into_iter().rev().any(|frame| enough(visit.came_from(frame)));
        let after: Vec<&FrameEvent> =
            known.frames().filter(session).filter(|frame| frame.frame > closure.frame).collect();
        let _ = after.into_iter().any(|frame| enough(visit.went_on(frame)));
        let event = visit.withdraw(said_by(shown)).map_err(|error| code_of(&error))?;
        self.wait(map, event)
    }

    pub(in super::super) fn confirm(
        &mut self,
        shown: &Shown,
        map: &str,
        (later, earlier): (&NamedFrame, &NamedFrame),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        let known = self.map(map)?;
        let (later, earlier) = (known.found(later)?, known.found(earlier)?);
        let pair = SamePlace { later: &later, earlier: &earlier, view: None, focal_length_widths: None };
        let event = known.mapper.confirm(&pair, said_by(shown)).map_err(|error| code_of(&error))?;
        self.wait(map, event)
    }

    pub(in super::super) fn undo_correction(
        &mut self,
        shown: &Shown,
        (map, correction): (&str, u64),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        let undone = self.map(map)?.mapper.undo(correction, said_by(shown));
        self.wait(map, undone.map_err(|error| code_of(&error))?)
    }

    fn wait(&mut self, map: &str, event: CorrectionEvent) -> Result<(), Code> {
        self.map_mut(map)?.waiting = Some(event);
        Ok(())
    }

    /// The map where something was said, and it is not known when.
    pub(in super::super) fn waits(&self) -> Option<MapName> {
        self.maps.iter().find(|(_, map)| map.waiting.is_some()).map(|(name, _)| name.clone())
    }

    pub(in super::super) fn said_at(&mut self, map: &str, said_ns: i64) {
        self.keep(map);
        if let Ok(map) = self.map_mut(map) {
            map.said_at(said_ns);
        }
    }
}

/// By whom; when is said later.
fn said_by(shown: &Shown) -> Said {
    Said { by: shown.token.clone().unwrap_or_default(), said_ns: 0 }
}

fn code_of(error: &CorrectError) -> Code {
    match error {
        CorrectError::Unknown { .. } => Code::NotFound,
        CorrectError::NotEarlier => Code::InvalidArgument,
        CorrectError::NoClosure { .. }
        | CorrectError::Withdrawn { .. }
        | CorrectError::RestsOnIt { .. }
        | CorrectError::NoPlace { .. }
        | CorrectError::SamePlace { .. }
        | CorrectError::Confirmed { .. }
        | CorrectError::NoFeatures
        | CorrectError::Refused { .. }
        | CorrectError::Unmeasured
        | CorrectError::Later { .. } => Code::FailedPrecondition,
    }
}
