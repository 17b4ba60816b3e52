//! What the server is to be: maps, tokens and merges in memory, changed one call after the other. There is no disk, no
//! process and no stream; decisions are the library's, as `topomap::in_memory` makes them.

mod corrections;
mod frames;
mod map;
mod merges;
mod tokens;
mod told;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use topomap::in_memory::{self, NoViews};
use topomap::mapper::Localizer;
use topomap::rewriting::{over_budget, without_places, without_sessions};
use waypost_client::Code;
use waypost_client::v1::token::Ability;

use super::seen::view;
pub(super) use corrections::NamedFrame;
pub(super) use frames::Outcome;
use frames::code_of;
pub(super) use map::{PlainMap, Sent, Streamed, wanted_settings};
pub(super) use merges::{MIN_SUPPORT, PlainMerge};
use tokens::Access;
pub(super) use tokens::{Asked, OPERATOR, PlainToken, Shown, token_line, token_name};
pub(super) use told::{Told, of_answer, of_event, of_response};

/// A map's own name.
pub(super) type MapName = String;

/// All that a server holds.
#[derive(Clone, Default)]
pub(super) struct World {
    pub(super) maps: BTreeMap<MapName, Arc<PlainMap>>,
    pub(super) tokens: BTreeMap<String, PlainToken>,
    /// By number, from 1.
    pub(super) merges: Vec<PlainMerge>,
    /// Secrets that are no longer good.
    pub(super) gone: Vec<String>,
    /// Maps that came about by frames alone, as they were before they were deleted or changed otherwise.
    pub(super) past: Vec<(MapName, Arc<PlainMap>)>,
    next_map: u64,
}

impl World {
    /// A server that an admin has made a token for.
    pub(super) fn new(secret: String) -> Self {
        let mut world = Self::default();
        let asked = Asked::of(super::operations::Role::Admin, super::operations::Reach::Everywhere, false);
        let role = asked.role;
        let abilities =
            vec![Ability::Read, Ability::Localize, Ability::Stream, Ability::Navigate, Ability::Admin];
        let operator = PlainToken {
            role,
            abilities,
            maps: Vec::new(),
            secret,
            former: None,
            expires_ns: None,
            max_maps: None,
            max_sessions: None,
        };
        world.tokens.insert(OPERATOR.to_owned(), operator);
        world
    }

    fn map(&self, map: &str) -> Result<&Arc<PlainMap>, Code> {
        self.maps.get(map).ok_or(Code::NotFound)
    }

    fn map_mut(&mut self, map: &str) -> Result<&mut PlainMap, Code> {
        self.maps.get_mut(map).map(Arc::make_mut).ok_or(Code::NotFound)
    }

    /// Keeps what a map is by now, if it came about by frames alone.
    fn keep(&mut self, map: &str) {
        let by_frames = |map: &&Arc<PlainMap>| map.streamed.is_some() && map.frames().next().is_some();
        if let Some(known) = self.maps.get(map).filter(by_frames) {
            self.past.push((map.to_owned(), known.clone()));
        }
    }

    fn id(&mut self) -> u64 {
        self.next_map += 1;
        self.next_map - 1
    }

    pub(super) fn create_map(
        &mut self,
        shown: &Shown,
        map: &str,
        careful: bool,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        self.check_map_quota(shown)?;
        if self.maps.contains_key(map) {
            return Err(Code::AlreadyExists);
        }
        let made = PlainMap::new(self.id(), shown.token.clone(), careful);
        self.maps.insert(map.to_owned(), Arc::new(made));
        Ok(())
    }

    pub(super) fn delete_map(&mut self, shown: &Shown, map: &str, now_ns: i64) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        self.keep(map);
        self.maps.remove(map).map(drop).ok_or(Code::NotFound)
    }

    /// Opens a session and takes its frames. Worlds that are there in between are told to `passed`.
    pub(super) fn drive(
        &mut self,
        shown: &Shown,
        (map, session): (&str, &str),
        frames: &[Sent],
        now_ns: i64,
        passed: &mut dyn FnMut(&World),
    ) -> Result<Vec<Outcome>, Code> {
        self.admit(shown, Access::Either(Ability::Localize, Ability::Stream), &[map], now_ns)?;
        self.admit(shown, Access::May(Ability::Stream), &[map], now_ns)?;
        let known = self.map(map)?;
        let number = match known.number(session) {
            Some(number) => {
                let owner = &known.sessions[number as usize].owner;
                if !self.is_admin(shown) && owner.is_some() && *owner != shown.token {
                    return Err(Code::PermissionDenied);
                }
                number
            }
            None => {
                self.check_session_quota(shown)?;
                let known = self.map_mut(map)?;
                known.open_session(session, shown.token.clone());
                known.sessions.len() as u32 - 1
            }
        };
        let mut outcomes = Vec::new();
        for sent in frames {
            passed(self);
            outcomes.push(self.map_mut(map)?.see(map, number, sent));
        }
        Ok(outcomes)
    }

    /// Takes frames of several sessions, in the order in which the server took those that it did.
    pub(super) fn see_in_order(
        &mut self,
        map: &str,
        mut sent: BTreeMap<String, Vec<Sent>>,
        order: &[(String, u64)],
    ) -> BTreeMap<String, Vec<Outcome>> {
        let mut outcomes: BTreeMap<String, Vec<Outcome>> = BTreeMap::new();
        let Ok(known) = self.map_mut(map) else { return outcomes };
        let mut see = |session: &String, frame: &Sent| {
            let number = known.number(session).expect("it was opened");
            outcomes.entry(session.clone()).or_default().push(known.see(map, number, frame));
        };
        for (session, sequence) in order {
            let Some(frames) = sent.get_mut(session) else { continue };
            let until = frames.iter().position(|frame| frame.sequence == *sequence);
            // Those before it were refused.
            let upto = until.map_or(0, |until| until + 1);
            frames.drain(..upto).for_each(|frame| see(session, &frame));
        }
        for (session, frames) in &sent {
            frames.iter().for_each(|frame| see(session, frame));
        }
        outcomes
    }

    pub(super) fn localize(
        &self,
        shown: &Shown,
        map: &str,
        frames: &[Sent],
        now_ns: i64,
    ) -> Result<Vec<Outcome>, Code> {
        self.admit(shown, Access::Either(Ability::Localize, Ability::Stream), &[map], now_ns)?;
        self.admit(shown, Access::May(Ability::Localize), &[map], now_ns)?;
        let known = self.map(map)?;
        let mut localizer = Localizer::new();
        let mut outcomes = Vec::new();
        for sent in frames {
            let input = sent.input(Localizer::SESSION).ok_or(Code::InvalidArgument)?;
            match in_memory::localize(&known.mapper, &localizer, &known.log, input, &NoViews) {
                Ok(decided) => {
                    localizer.follow(&decided.event, &known.mapper);
                    outcomes.push(Outcome::Answered(of_event(map, known, &decided.event)));
                }
                Err(error) => outcomes.push(Outcome::Refused(code_of(&error))),
            }
        }
        Ok(outcomes)
    }

    pub(super) fn query(
        &self,
        shown: &Shown,
        map: &str,
        (place, noise): (u64, u64),
        now_ns: i64,
    ) -> Result<Told, Code> {
        self.admit(shown, Access::May(Ability::Localize), &[map], now_ns)?;
        let known = self.map(map)?;
        let observation = view(place, noise);
        let queried = in_memory::query(&known.mapper, &known.log, &observation, &NoViews);
        let queried = queried.map_err(|error| code_of(&error))?;
        Ok(told::of_query(map, known, &queried, observation.len() as u64))
    }

    pub(super) fn set_label(
        &mut self,
        shown: &Shown,
        (map, place): (&str, u32),
        label: &str,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Navigate), &[map], now_ns)?;
        if self.map(map)?.mapper.map().places().len() <= place as usize {
            return Err(Code::NotFound);
        }
        self.map_mut(map)?.labels.insert(place, label.to_owned());
        Ok(())
    }

    pub(super) fn delete_label(
        &mut self,
        shown: &Shown,
        (map, place): (&str, u32),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Navigate), &[map], now_ns)?;
        self.map_mut(map)?.labels.remove(&place).map(drop).ok_or(Code::NotFound)
    }

    pub(super) fn delete_session(
        &mut self,
        shown: &Shown,
        (map, session): (&str, &str),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        let number = self.map(map)?.number(session).ok_or(Code::NotFound)?;
        self.keep(map);
        let known = self.map_mut(map)?;
        let removed = BTreeSet::from([number]);
        known.retell(without_sessions(known.mapper.settings(), &known.log, &removed).unwrap());
        Ok(())
    }

    /// The places that go, in their order.
    pub(super) fn trim(
        &mut self,
        shown: &Shown,
        map: &str,
        most_places: u32,
        now_ns: i64,
    ) -> Result<Vec<u32>, Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        if most_places == 0 {
            return Err(Code::InvalidArgument);
        }
        let known = self.map(map)?;
        let read = map::replayed(known.careful, &known.log);
        let budgeted = over_budget(&read, &known.log, most_places as usize);
        let dropped: Vec<_> = budgeted.dropped.iter().map(|dropped| dropped.place).collect();
        if !dropped.is_empty() {
            self.keep(map);
            let known = self.map_mut(map)?;
            let places = dropped.iter().copied().collect();
            known.retell(without_places(known.mapper.settings(), &known.log, &places).unwrap());
        }
        Ok(dropped.into_iter().map(fabmap::PlaceId::number).collect())
    }

    pub(super) fn compact(&mut self, shown: &Shown, map: &str, now_ns: i64) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        let known = self.map_mut(map)?;
        known.sessions.iter_mut().for_each(|session| session.merge = None);
        let id = known.id;
        self.end_undoing(id);
        Ok(())
    }

    /// Exports a map.
    pub(super) fn export(&self, shown: &Shown, map: &str, now_ns: i64) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[map], now_ns)?;
        self.map(map).map(drop)
    }

    /// Imports what was exported of a map.
    pub(super) fn import(
        &mut self,
        shown: &Shown,
        (from, to): (&str, &str),
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[to], now_ns)?;
        self.check_map_quota(shown)?;
        if self.maps.contains_key(to) {
            return Err(Code::AlreadyExists);
        }
        let mut copy = PlainMap::clone(self.map(from)?);
        (copy.id, copy.owner) = (self.id(), shown.token.clone());
        for session in &mut copy.sessions {
            (session.owner, session.merge) = (None, None);
        }
        self.maps.insert(to.to_owned(), Arc::new(copy));
        Ok(())
    }

    /// Maps and sessions that count for a token.
    pub(super) fn used_by(&self, token: &str) -> (u64, u64) {
        let is_own = |owner: &Option<String>| owner.as_deref() == Some(token);
        let maps = self.maps.values().filter(|map| is_own(&map.owner)).count();
        let sessions = self.maps.values().flat_map(|map| &map.sessions);
        (maps as u64, sessions.filter(|session| is_own(&session.owner)).count() as u64)
    }

    /// The maps that a caller may see.
    pub(super) fn list_maps(&self, shown: &Shown, now_ns: i64) -> Result<Vec<MapName>, Code> {
        self.admit(shown, Access::May(Ability::Read), &[], now_ns)?;
        let reached = |map: &&MapName| self.admit(shown, Access::Any, &[map], now_ns).is_ok();
        Ok(self.maps.keys().filter(reached).cloned().collect())
    }
}
