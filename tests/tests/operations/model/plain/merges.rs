//! Merges as the model has them: searched and joined by the library, in memory, and undone.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use topomap::ids::SessionId;
use topomap::log::MapEvent;
use topomap::mapper::Mapper;
use topomap::merging::{
    KnownMap, Layout, MergePlan, MergeSettings, PairComparison, Verdict, find_matches, join, judge,
    pairs_to_compare,
};
use topomap::rewriting::without_sessions;
use waypost_client::Code;
use waypost_client::v1::merge::State;
use waypost_client::v1::token::Ability;

use super::map::{PlainMap, PlainSession, replayed};
use super::tokens::{Access, Shown};
use super::{MapName, World};

#[derive(Clone, Debug)]
pub(in super::super) struct PlainMerge {
    pub(in super::super) target: MapName,
    /// All that it is about.
    maps: Vec<MapName>,
    pub(in super::super) state: State,
    /// The map that it went into, for as long as it can be undone.
    map: Option<u64>,
    /// Events of a map that it made.
    made_events: Option<usize>,
}

/// Matches that are to agree at least.
pub(in super::super) const MIN_SUPPORT: u32 = 3;

/// A map that is looked at, as it is read from the disk.
struct Read {
    mapper: Mapper,
    log: Vec<MapEvent>,
}

impl Read {
    fn of(map: &PlainMap) -> Self {
        Self { mapper: replayed(map.careful, &map.log), log: map.log.clone() }
    }

    fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, log: &self.log }
    }

    fn layout(&self) -> Layout<'_> {
        let settings = self.mapper.settings();
        Layout { poses: self.mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
    }

    fn take(&mut self, events: Vec<MapEvent>) {
        events.iter().for_each(|event| self.mapper.fold(event).unwrap());
        self.log.extend(events);
    }
}

impl World {
    /// Merges at once what overlaps. Worlds that are there in between are told to `passed`.
    pub(in super::super) fn merge(
        &mut self,
        shown: &Shown,
        sources: &[MapName],
        target: &MapName,
        now_ns: i64,
        passed: &mut dyn FnMut(&World),
    ) -> Result<(), Code> {
        let named: Vec<&str> = sources.iter().chain([target]).map(String::as_str).collect();
        self.admit(shown, Access::May(Ability::Admin), &named, now_ns)?;
        let mut rows = Vec::new();
        for (index, source) in sources.iter().enumerate() {
            if sources[..index].contains(source) {
                return Err(Code::InvalidArgument);
            }
            let map = self.maps.get(source).ok_or(Code::NotFound)?.clone();
            if source != target {
                rows.push((source.clone(), map));
            }
        }
        let existing = self.maps.get(target).cloned();
        let base = match &existing {
            Some(map) => map.clone(),
            None if rows.len() < 2 => return Err(Code::InvalidArgument),
            None => {
                self.check_map_quota(shown)?;
                rows.remove(0).1
            }
        };
        if rows.is_empty() {
            return Err(Code::InvalidArgument);
        }
        let mut maps: Vec<MapName> = sources.to_vec();
        maps.push(target.clone());
        let asked =
            PlainMerge { target: target.clone(), maps, state: State::Failed, map: None, made_events: None };
        self.merges.push(asked);
        let number = self.merges.len() as u64;
        // One of which no job is noted yet has failed, if it is cut off.
        passed(self);
        let joined = joining(&base, &rows);
        let Some(joined) = joined else {
            self.merges[number as usize - 1].state = State::NoOverlap;
            return Ok(());
        };
        self.keep(target);
        let mut map = PlainMap::clone(&base);
        if existing.is_none() {
            (map.id, map.owner) = (self.next_map, shown.token.clone());
            self.next_map += 1;
        }
        for (index, plan) in joined {
            bring(&mut map, &rows[index], &plan, number);
        }
        map.mapper = replayed(map.careful, &map.log);
        let merge = &mut self.merges[number as usize - 1];
        merge.state = State::Committed;
        merge.map = Some(map.id);
        merge.made_events = existing.is_none().then_some(map.log.len());
        self.maps.insert(target.clone(), Arc::new(map));
        Ok(())
    }

    /// The number of the merge that came so many committed ones ago; of any, if there are not as many.
    pub(in super::super) fn merge_before(&self, back: u8) -> u64 {
        let committed = (1..).zip(&self.merges).filter(|(_, merge)| merge.state == State::Committed);
        let numbers: Vec<u64> = committed.map(|(number, _)| number).collect();
        let last = numbers.len().checked_sub(1 + usize::from(back)).map(|index| numbers[index]);
        last.unwrap_or_else(|| (self.merges.len() as u64).saturating_sub(back.into()))
    }

    pub(in super::super) fn undo_merge(
        &mut self,
        shown: &Shown,
        number: u64,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::May(Ability::Admin), &[], now_ns)?;
        let index = number.checked_sub(1).ok_or(Code::NotFound)? as usize;
        let merge = self.merges.get(index).ok_or(Code::NotFound)?.clone();
        let about: Vec<&str> = merge.maps.iter().map(String::as_str).collect();
        self.admit(shown, Access::May(Ability::Admin), &about, now_ns)?;
        let there = self.maps.iter().find(|(_, map)| merge.map == Some(map.id));
        let (State::Committed, Some((name, map))) = (merge.state, there) else {
            return Err(Code::FailedPrecondition);
        };
        let (name, mut map) = (name.clone(), PlainMap::clone(map));
        match merge.made_events {
            Some(events) if events != map.log.len() => return Err(Code::FailedPrecondition),
            Some(_) => {
                self.maps.remove(&name);
            }
            None => {
                let brought = |(number, session): (u32, &PlainSession)| {
                    (session.merge == Some(index as u64 + 1)).then_some(number)
                };
                let removed: BTreeSet<SessionId> = (0..)
                    .zip(&map.sessions)
                    .filter_map(|(number, session)| brought((number, session)))
                    .collect();
                map.retell(without_sessions(map.mapper.settings(), &map.log, &removed).unwrap());
                self.maps.insert(name, Arc::new(map));
            }
        }
        self.merges[index].state = State::Undone;
        Ok(())
    }

    /// What merges brought to a map is its own from now on.
    pub(super) fn end_undoing(&mut self, id: u64) {
        self.merges.iter_mut().filter(|merge| merge.map == Some(id)).for_each(|merge| merge.map = None);
    }
}

/// How sources join a base, each on top of those before; `None` if one of them overlaps with nothing.
fn joining(base: &PlainMap, rows: &[(MapName, Arc<PlainMap>)]) -> Option<Vec<(usize, MergePlan)>> {
    let settings = MergeSettings { min_support: MIN_SUPPORT as usize, ..MergeSettings::default() };
    let mut merged = Read::of(base);
    let mut left: Vec<(usize, Read)> = (0..).zip(rows.iter().map(|(_, map)| Read::of(map))).collect();
    let mut joined = Vec::new();
    while !left.is_empty() {
        let before = left.len();
        let mut apart = Vec::new();
        for (index, source) in left {
            let pairs = pairs_to_compare(source.known(), merged.known(), &settings, &()).unwrap();
            let nothing = vec![PairComparison::default(); pairs.len()];
            let matches = find_matches(source.known(), merged.known(), &pairs, &nothing, &settings);
            match judge(source.layout(), merged.layout(), &matches, &settings) {
                Verdict::Overlap(plan) => {
                    let events = join((&source.mapper, &merged.mapper), &plan, &source.log).unwrap();
                    merged.take(events);
                    merged.mapper.relax();
                    joined.push((index, plan));
                }
                Verdict::Apart(_) => apart.push((index, source)),
            }
        }
        if apart.len() == before {
            return None;
        }
        left = apart;
    }
    Some(joined)
}

/// Adds a source's log to a map, as the plan has it.
fn bring(map: &mut PlainMap, (name, source): &(MapName, Arc<PlainMap>), plan: &MergePlan, merge: u64) {
    let from = map.log.len() as u64;
    let (of_source, mut target) =
        (Read::of(source), Read { mapper: replayed(map.careful, &map.log), log: map.log.clone() });
    let events = join((&of_source.mapper, &target.mapper), plan, &source.log).unwrap();
    let mut places = BTreeMap::new();
    for (before, after) in source.log.iter().zip(&events) {
        if let (MapEvent::Frame(before), MapEvent::Frame(after)) = (before, after)
            && let Some((before, after)) = before.decision.place.zip(after.decision.place)
        {
            places.insert(before.number(), after.number());
        }
    }
    target.take(events);
    for session in &source.sessions {
        let taken = |name: &String| map.sessions.iter().any(|known| known.name == *name);
        let second = format!("{name}-{}", session.name);
        let later = (2..).map(|number| format!("{second}-{number}"));
        let mut names = [session.name.clone(), second.clone()].into_iter().chain(later);
        let unused = names.find(|name| !taken(name)).expect("numbers do not end");
        map.sessions.push(PlainSession { name: unused, merge: Some(merge), ..session.clone() });
    }
    for (place, label) in &source.labels {
        if let Some(joined) = places.get(place) {
            // What the target calls a place counts.
            map.labels.entry(*joined).or_insert_with(|| label.clone());
        }
    }
    map.notes.extend(source.notes.iter().map(|(position, note)| (position + from, note.clone())));
    map.log = target.log;
    map.streamed = None;
}
