//! What people's corrections have made of a map.
//!
//! A correction that is undone has decided nothing: the state hash is that of a log without both.

use std::collections::{BTreeMap, BTreeSet};

use fabmap::appearance::PlaceId;
use fabmap::codec::{DecodeError, Reader, Writer};

use super::encoding::SESSION_VERSION;
use super::{Map, PlaceFrame, Session, looks_of};
use crate::bytes::{decode_option, encode_option};
use crate::ids::{FrameId, SessionId};
use crate::log::{Confirmation, Correction, CorrectionEvent, Link, Relinked, Undoing, Withdrawal};
use crate::settings::MapperSettings;

/// The corrections of a map, as far as they stand.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Corrections {
    /// By their positions in the log.
    standing: BTreeMap<u64, Standing>,
    /// Numbers of links that are there no more.
    left_out: BTreeSet<usize>,
    /// How many were undone.
    undone: u64,
}

/// A correction, and what it takes to undo it.
#[derive(Clone, Debug, PartialEq)]
struct Standing {
    event: CorrectionEvent,
    /// Frames that the place had learnt from.
    forgotten: Vec<PlaceFrame>,
    /// The session before, if it was at the place still.
    session: Option<Box<Session>>,
    /// Numbers of links that it took out.
    taken_out: Vec<usize>,
    /// Numbers of links that it added.
    added: Vec<usize>,
}

impl Map {
    /// Corrections that were not undone, in the order of the log.
    pub fn corrections(&self) -> impl Iterator<Item = &CorrectionEvent> {
        self.corrections.standing.values().map(|standing| &standing.event)
    }

    /// The correction at a position of the log, if it was not undone.
    #[must_use]
    pub fn correction(&self, position: u64) -> Option<&CorrectionEvent> {
        self.corrections.standing.get(&position).map(|standing| &standing.event)
    }

    /// The withdrawal by which a frame is at no place; `None` if there is none.
    #[must_use]
    pub fn withdrawal_of(&self, frame: FrameId) -> Option<&Withdrawal> {
        self.corrections().filter_map(withdrawal).find(|withdrawal| withdrawal.has(frame))
    }

    /// Links with their numbers among all, without those that corrections took out.
    pub fn standing_links(&self) -> impl Iterator<Item = (usize, &Link)> {
        self.links.iter().enumerate().filter(|(number, _)| !self.corrections.left_out.contains(number))
    }

    /// The link that an event of the log stands for now, by the one that it added.
    #[must_use]
    pub fn link_of(&self, event: u64, added: Option<Link>) -> Option<Link> {
        let of_event = |relinked: &&Relinked| relinked.event == event;
        let relinked = |withdrawal: &Withdrawal| withdrawal.relinked.iter().find(of_event).copied();
        let last = self.corrections().filter_map(withdrawal).filter_map(relinked).last();
        last.map_or(added, |relinked| relinked.now)
    }

    /// The last correction of a session that stands after `position`.
    pub(crate) fn corrected_since(&self, session: SessionId, position: u64) -> Option<u64> {
        let later = self.corrections.standing.range(position + 1..);
        later.filter(|(_, standing)| standing.event.session == session).map(|(&later, _)| later).next_back()
    }

    /// How many corrections were undone.
    pub(crate) fn undone_corrections(&self) -> u64 {
        self.corrections.undone
    }

    pub(crate) fn corrections_state(&self) -> &Corrections {
        &self.corrections
    }

    /// Whether a link is there.
    pub(crate) fn has_link(&self, link: &Link) -> bool {
        self.number_of(link).is_some()
    }

    /// Folds in what a person said.
    pub(crate) fn fold_corrected(&mut self, event: &CorrectionEvent, settings: &MapperSettings) {
        match &event.correction {
            Correction::Withdrawn(withdrawal) => self.withdraw(event, withdrawal, settings),
            Correction::Confirmed(Confirmation { link, .. }) => {
                let mut standing = Standing::new(event);
                self.relink(&mut standing, None, link.as_ref());
                self.corrections.standing.insert(event.position, standing);
            }
            Correction::Undone(Undoing { correction, place: _ }) => self.undo(*correction),
        }
        self.link_places();
        self.learnt = looks_of(&self.places);
        self.events = event.position + 1;
    }

    fn withdraw(&mut self, event: &CorrectionEvent, withdrawal: &Withdrawal, settings: &MapperSettings) {
        let Withdrawal { place, relinked, resumed, .. } = withdrawal;
        let mut standing = Standing::new(event);
        for Relinked { was, now, .. } in relinked {
            self.relink(&mut standing, was.as_ref(), now.as_ref());
        }
        if let Some(place) = self.places.get_mut(place.index()) {
            let frames = std::mem::take(&mut place.frames);
            (standing.forgotten, place.frames) =
                frames.into_iter().partition(|frame| withdrawal.has(frame.frame));
        }
        if let (Some(resumed), Some(session)) = (resumed, self.sessions.get_mut(&event.session)) {
            standing.session = Some(Box::new(session.clone()));
            session.resume(*place, resumed, settings);
        }
        self.corrections.standing.insert(event.position, standing);
    }

    fn undo(&mut self, correction: u64) {
        let Some(standing) = self.corrections.standing.remove(&correction) else { return };
        let Standing { event, forgotten, session, taken_out, added } = standing;
        self.corrections.undone += 1;
        taken_out.iter().for_each(|number| {
            self.corrections.left_out.remove(number);
        });
        self.corrections.left_out.extend(added);
        if let Correction::Withdrawn(withdrawal) = &event.correction
            && let Some(place) = self.places.get_mut(withdrawal.place.index())
        {
            place.frames.extend(forgotten);
            place.frames.sort_unstable_by_key(|frame| frame.frame);
        }
        // Once it has gone on, it goes on from where it has come to.
        if let (Some(before), Some(now)) = (session, self.sessions.get_mut(&event.session))
            && now.frames == before.frames
        {
            *now = *before;
        }
    }

    fn relink(&mut self, standing: &mut Standing, was: Option<&Link>, now: Option<&Link>) {
        if let Some(number) = was.and_then(|was| self.number_of(was)) {
            self.corrections.left_out.insert(number);
            standing.taken_out.push(number);
        }
        if let Some(now) = now {
            standing.added.push(self.links.len());
            self.links.push(*now);
        }
    }

    /// Of links that say the same, the first.
    fn number_of(&self, link: &Link) -> Option<usize> {
        self.standing_links().find(|(_, known)| *known == link).map(|(number, _)| number)
    }

    /// Which places are linked, by the links that are there.
    pub(super) fn link_places(&mut self) {
        let mut linked = vec![BTreeSet::new(); self.places.len()];
        for (_, link) in self.standing_links() {
            linked[link.from.index()].insert(link.to);
            linked[link.to.index()].insert(link.from);
        }
        self.linked = linked.into_iter().map(|places| places.into_iter().collect()).collect();
    }
}

fn withdrawal(event: &CorrectionEvent) -> Option<&Withdrawal> {
    match &event.correction {
        Correction::Withdrawn(withdrawal) => Some(withdrawal),
        Correction::Confirmed(_) | Correction::Undone(_) => None,
    }
}

impl Standing {
    fn new(event: &CorrectionEvent) -> Self {
        let event = event.clone();
        Self { event, forgotten: Vec::new(), session: None, taken_out: Vec::new(), added: Vec::new() }
    }

    fn encode(&self, writer: &mut Writer) {
        let Self { event, forgotten, session, taken_out, added } = self;
        event.encode(writer);
        super::Place { frames: forgotten.clone() }.encode(writer);
        encode_option(session.as_ref(), writer, |session, writer| session.encode(SESSION_VERSION, writer));
        [taken_out, added].into_iter().for_each(|numbers| encode_numbers(numbers.iter(), writer));
    }

    fn decode(session_version: u32, reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self {
            event: CorrectionEvent::decode(reader)?,
            forgotten: super::Place::decode(reader)?.frames,
            session: decode_option(reader, |reader| Session::decode(session_version, reader))?.map(Box::new),
            taken_out: decode_numbers(reader)?,
            added: decode_numbers(reader)?,
        })
    }
}

impl Corrections {
    /// Whether nothing was ever corrected.
    pub(crate) fn is_empty(&self) -> bool {
        let Self { standing, left_out, undone } = self;
        standing.is_empty() && left_out.is_empty() && *undone == 0
    }

    pub(crate) fn encode(&self, writer: &mut Writer) {
        let Self { standing, left_out, undone } = self;
        writer.u32(SESSION_VERSION);
        writer.varint(standing.len() as u64);
        standing.values().for_each(|standing| standing.encode(writer));
        encode_numbers(left_out.iter(), writer);
        writer.u64(*undone);
    }

    pub(crate) fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let session_version = reader.u32()?;
        if session_version > SESSION_VERSION {
            return Err(DecodeError::Version { found: session_version, newest: SESSION_VERSION });
        }
        let standing = (0..reader.count(STANDING_BYTES)?)
            .map(|_| {
                Standing::decode(session_version, reader).map(|standing| (standing.event.position, standing))
            })
            .collect::<Result<_, _>>()?;
        let left_out = decode_numbers(reader)?.into_iter().collect();
        Ok(Self { standing, left_out, undone: reader.u64()? })
    }

    /// The part of this that the state hash covers: what stands.
    pub(super) fn encode_standing(&self, writer: &mut Writer) {
        self.standing.values().for_each(|standing| standing.event.encode(writer));
    }

    /// Whether all that is named is there, in a map of so many places and links.
    pub(super) fn fit(&self, places: usize, links: usize) -> bool {
        let known = |place: PlaceId| place.index() < places;
        let numbers =
            self.standing.values().flat_map(|standing| standing.taken_out.iter().chain(&standing.added));
        numbers.chain(&self.left_out).all(|&number| number < links)
            && self.standing.values().all(|standing| match &standing.event.correction {
                Correction::Withdrawn(withdrawal) => known(withdrawal.place),
                Correction::Confirmed(_) => true,
                // It stands for nothing.
                Correction::Undone(_) => false,
            })
    }
}

/// Least bytes of a [`Standing`].
const STANDING_BYTES: usize = 26;

fn encode_numbers<'a>(numbers: impl ExactSizeIterator<Item = &'a usize>, writer: &mut Writer) {
    writer.varint(numbers.len() as u64);
    numbers.for_each(|&number| writer.varint(number as u64));
}

fn decode_numbers(reader: &mut Reader<'_>) -> Result<Vec<usize>, DecodeError> {
    let count = reader.count(1)?;
    let number =
        |_| usize::try_from(reader.varint()?).map_err(|_| DecodeError::invalid("the number of a link"));
    (0..count).map(number).collect()
}
