//! Frames, taken one by one as the server is to take them.

use topomap::in_memory::{self, NoViews};
use topomap::log::MapEvent;
use topomap::mapper::FrameError;
use waypost_client::Code;

use super::map::{PlainMap, Sent, Streamed};
use super::told::{Told, of_event};

/// What comes of a frame.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Outcome {
    Answered(Told),
    /// It was there before.
    Resent(Told),
    Refused(Code),
}

impl PlainMap {
    /// Takes a frame as the server is to take it.
    pub(super) fn see(&mut self, name: &str, session: u32, sent: &Sent) -> Outcome {
        let last = self.frames_of(session).last().map(|last| last.sequence);
        if last.is_some_and(|last| sent.sequence <= last) {
            let stored = self.frames_of(session).find(|frame| frame.sequence == sent.sequence);
            return match stored {
                Some(stored) => Outcome::Resent(of_event(name, self, stored)),
                None => Outcome::Refused(Code::FailedPrecondition),
            };
        }
        if sent.stamp_ns <= 0 {
            return Outcome::Refused(Code::InvalidArgument);
        }
        let Some(input) = sent.input(session) else { return Outcome::Refused(Code::InvalidArgument) };
        let event = match in_memory::decide(&self.mapper, &self.log, input, &NoViews, &mut ()) {
            Ok(decided) => decided.event,
            Err(error) => return Outcome::Refused(code_of(&error)),
        };
        if !sent.note.is_empty() {
            self.notes.insert(event.frame, sent.note.clone());
        }
        self.sessions[session as usize].at = Some(sent.place);
        if let Some(streamed) = &mut self.streamed {
            streamed.push(Streamed::Frame(self.sessions[session as usize].name.clone(), sent.clone()));
        }
        self.take(MapEvent::Frame(Box::new(event.clone())));
        Outcome::Answered(of_event(name, self, &event))
    }
}

pub(super) fn code_of(error: &FrameError) -> Code {
    match error {
        FrameError::UnknownSession { .. } => Code::NotFound,
        FrameError::SequenceNotRising { .. } | FrameError::StampNotRising { .. } => Code::FailedPrecondition,
        FrameError::OdometryJump { .. }
        | FrameError::OdometryStandsStill { .. }
        | FrameError::ForeignWord { .. } => Code::InvalidArgument,
    }
}
