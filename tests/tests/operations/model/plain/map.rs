//! A map as the model has it: the log of what was decided, folded in memory, and what people said beside it.

use std::collections::BTreeMap;

use topomap::log::{CorrectionEvent, FrameEvent, MapEvent};
use topomap::mapper::{FrameInput, Mapper};
use topomap::rewriting::Retold;
use topomap::settings::MapperSettings;
use waypost_client::v1;

use super::super::operations::{From, SESSIONS};
use super::super::seen::{PLACES, WORDS, histogram, model, odometry, odometry_message, view};
use crate::harness::SECOND_NS;

#[derive(Clone)]
pub(in super::super) struct PlainMap {
    /// No other map of a run had it before.
    pub(in super::super) id: u64,
    /// The token that made it.
    pub(in super::super) owner: Option<String>,
    pub(in super::super) careful: bool,
    pub(in super::super) mapper: Mapper,
    pub(in super::super) log: Vec<MapEvent>,
    /// By number.
    pub(in super::super) sessions: Vec<PlainSession>,
    pub(in super::super) labels: BTreeMap<u32, String>,
    /// By position in the log.
    pub(in super::super) notes: BTreeMap<u64, String>,
    /// What somebody said, until it is known when.
    pub(super) waiting: Option<CorrectionEvent>,
    /// What robots have sent, in its order; `None` once the map came about otherwise.
    pub(in super::super) streamed: Option<Vec<Streamed>>,
}

#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct PlainSession {
    pub(in super::super) name: String,
    /// The token that opened it.
    pub(in super::super) owner: Option<String>,
    /// The merge that brought it.
    pub(in super::super) merge: Option<u64>,
    /// Where on the ring its robot is.
    pub(in super::super) at: Option<u64>,
}

#[derive(Clone, Debug)]
pub(in super::super) enum Streamed {
    Opened(String),
    /// By a session.
    Frame(String, Sent),
}

/// A frame that a robot sends.
#[derive(Clone, Debug)]
pub(in super::super) struct Sent {
    pub(in super::super) sequence: u64,
    pub(super) stamp_ns: i64,
    pub(super) place: u64,
    /// What it sees; `None` for a word that the model has not.
    noise: Option<u64>,
    wheels: bool,
    pub(super) note: String,
}

impl Sent {
    pub(in super::super) fn message(&self) -> v1::Frame {
        let words = match self.noise {
            Some(noise) => histogram(&view(self.place, noise)),
            None => v1::WordHistogram { words: vec![1, WORDS], counts: Vec::new() },
        };
        v1::Frame {
            sequence: self.sequence,
            stamp_ns: self.stamp_ns,
            odometry: self.wheels.then(|| odometry_message(self.place)),
            content: Some(v1::frame::Content::Histogram(words)),
            note: self.note.clone(),
        }
    }

    /// What is to be decided; `None` if it says nothing that the model knows.
    pub(in super::super) fn input(&self, session: u32) -> Option<FrameInput> {
        let observation = view(self.place, self.noise?);
        let odometry = self.wheels.then(|| odometry(self.place));
        Some(FrameInput { session, sequence: self.sequence, stamp_ns: self.stamp_ns, odometry, observation })
    }

    /// Frames of a robot that leaves nothing behind.
    pub(in super::super) fn looking(start: u64, frames: u8, noise: u64) -> Vec<Self> {
        (0..u64::from(frames))
            .map(|index| Self {
                sequence: index + 1,
                stamp_ns: SECOND_NS * (index as i64 + 1),
                place: (start + index) % PLACES,
                noise: Some(noise + index),
                wheels: false,
                note: String::new(),
            })
            .collect()
    }
}

/// How a map decides, as it is asked for.
pub(in super::super) fn wanted_settings(careful: bool) -> v1::MapSettings {
    let settings = settings(careful);
    v1::MapSettings {
        keep: v1::map_settings::Keep::Words.into(),
        verification: v1::map_settings::Verification::None.into(),
        closure_threshold: Some(settings.closure_threshold),
        guard_frames: Some(settings.guard_frames as u32),
        ..v1::MapSettings::default()
    }
}

fn settings(careful: bool) -> MapperSettings {
    let (closure_threshold, guard_frames) = if careful { (0.99, 20) } else { (0.5, 4) };
    let verification = topomap::evidence::VerificationSettings::none();
    MapperSettings { verification, closure_threshold, guard_frames, ..MapperSettings::default() }
}

/// Folds a log from nothing.
pub(super) fn replayed(careful: bool, log: &[MapEvent]) -> Mapper {
    let mut mapper = Mapper::new(model(), settings(careful)).unwrap();
    log.iter().for_each(|event| mapper.fold(event).unwrap());
    mapper.relax();
    mapper
}

impl PlainMap {
    pub(super) fn new(id: u64, owner: Option<String>, careful: bool) -> Self {
        Self {
            id,
            owner,
            careful,
            mapper: replayed(careful, &[]),
            log: Vec::new(),
            sessions: Vec::new(),
            labels: BTreeMap::new(),
            notes: BTreeMap::new(),
            waiting: None,
            streamed: Some(Vec::new()),
        }
    }

    /// The session that a number of an operation stands for: one that robots open by themselves, or any that is there.
    pub(in super::super) fn session_name(&self, session: u8) -> String {
        let any = usize::from(session.saturating_sub(SESSIONS)).checked_rem(self.sessions.len());
        match any.filter(|_| session >= SESSIONS) {
            Some(any) => self.sessions[any].name.clone(),
            None => format!("s{}", session % SESSIONS),
        }
    }

    pub(in super::super) fn number(&self, session: &str) -> Option<u32> {
        self.sessions.iter().position(|known| known.name == session).map(|number| number as u32)
    }

    pub(super) fn open_session(&mut self, name: &str, owner: Option<String>) {
        self.take(MapEvent::SessionOpened { session: self.mapper.map().next_session() });
        self.sessions.push(PlainSession { name: name.to_owned(), owner, merge: None, at: None });
        if let Some(streamed) = &mut self.streamed {
            streamed.push(Streamed::Opened(name.to_owned()));
        }
    }

    pub(in super::super) fn frames(&self) -> impl Iterator<Item = &FrameEvent> {
        self.log.iter().filter_map(|event| match event {
            MapEvent::Frame(frame) => Some(&**frame),
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => None,
        })
    }

    pub(in super::super) fn frames_of(&self, session: u32) -> impl Iterator<Item = &FrameEvent> {
        self.frames().filter(move |frame| frame.session == session)
    }

    /// What a robot is about to send in a session, which may not be open yet.
    pub(in super::super) fn drive(
        &self,
        session: &str,
        from: From,
        start: Option<u64>,
        (frames, noise): (u8, u64),
    ) -> Vec<Sent> {
        let number = self.number(session);
        let last = number.and_then(|number| self.frames_of(number).last());
        let (last_sequence, last_stamp) = last.map_or((0, 0), |last| (last.sequence, last.stamp_ns));
        let at = number.and_then(|number| self.sessions[number as usize].at);
        let start = start.unwrap_or_else(|| at.map_or(0, |at| at + 1));
        let wheels = session.ends_with(['1', '3']);
        let again = if let From::Again(again) = from { last_sequence.min(again.into()) } else { 0 };
        let gap = if from == From::Gap { 2 } else { 0 };
        let repeated = (last_sequence - again + 1..=last_sequence).map(|sequence| Sent {
            sequence,
            stamp_ns: SECOND_NS,
            place: start % PLACES,
            noise: Some(noise),
            wheels,
            note: String::new(),
        });
        let fresh = (0..u64::from(frames)).map(|index| {
            let sequence = last_sequence + 1 + gap + index;
            let stale = from == From::StaleStamp && index == 0;
            let foreign = from == From::ForeignWord && index == 0;
            Sent {
                sequence,
                stamp_ns: last_stamp + SECOND_NS * if stale { 0 } else { index as i64 + 1 },
                place: (start + index) % PLACES,
                noise: (!foreign).then_some(noise + index),
                wheels,
                note: if sequence % 3 == 0 { format!("{session}-{sequence}") } else { String::new() },
            }
        });
        repeated.chain(fresh).collect()
    }

    pub(super) fn take(&mut self, event: MapEvent) {
        self.mapper.apply(&event).unwrap();
        self.log.push(event);
    }

    /// Takes the log as it was rewritten, with what is known beside it.
    pub(super) fn retell(&mut self, retold: Retold) {
        let Retold { events, frames, sessions, places, dropped: _ } = retold;
        let mut left: Vec<(u32, PlainSession)> = (0..)
            .zip(std::mem::take(&mut self.sessions))
            .filter_map(|(number, session)| Some((*sessions.get(&number)?, session)))
            .collect();
        left.sort_by_key(|(number, _)| *number);
        self.sessions = left.into_iter().map(|(_, session)| session).collect();
        self.labels = std::mem::take(&mut self.labels)
            .into_iter()
            .filter_map(|(place, label)| Some((places.get(place as usize)?.as_ref()?.number(), label)))
            .collect();
        self.notes = std::mem::take(&mut self.notes)
            .into_iter()
            .filter_map(|(frame, note)| Some((*frames.get(&frame)?, note)))
            .collect();
        self.mapper = replayed(self.careful, &events);
        self.log = events;
        self.streamed = None;
    }
}
