//! What was proposed comes about: whole, or not at all.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use fabmap::PlaceId;
use tokio::runtime::Handle;
use tokio::sync::OwnedSemaphorePermit;
use topomap::ids::SessionId;
use topomap::log::MapEvent;
use topomap::mapper::Mapper;
use topomap::merging::join;

use super::{Joining, MergeReport, Merges, Proposal, Target};
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::map_name;
use crate::service::jobs::{JobOutcome, JobReporter, Stopped};
use crate::service::map_names::map_exists;
use crate::service::read_map::{Disk, Models, ReadMap, joined_places, joined_sessions, read_on};
use crate::service::rewriting::changed;
use crate::storage::{
    JobEnd, JoinedLog, JoinedSession, MapEdition, MapId, MergeOutcome, MergeState, SessionRow, Storage,
    StorageError,
};

/// Events, and frames' media, that a new map is made of at a time: other maps' commits get their turn in between.
const EVENTS_PIECE: u64 = 500;
const MEDIA_PIECE: u64 = 32;

/// Longest name of a session.
const MAX_NAME_LEN: usize = 63;

/// The maps of a proposal, read once more: beside the robots, who go on meanwhile.
struct Reading {
    storage: Storage,
    runtime: Handle,
    /// The base's, then those of the sources.
    models: Models,
    /// The base as far as it was read.
    base: Base,
    sources: Vec<ReadMap>,
}

struct Base {
    id: MapId,
    mapper: Mapper,
    log: Vec<MapEvent>,
    sessions: Vec<SessionRow>,
}

impl Base {
    /// Names of the sessions that the log has, as far as it was read.
    fn opened_sessions(&self) -> Vec<String> {
        let opened: BTreeSet<SessionId> = self.log.iter().map(MapEvent::session).collect();
        let opened = self.sessions.iter().filter(|session| opened.contains(&session.number));
        opened.map(|session| session.name.clone()).collect()
    }
}

impl Merges {
    /// Makes the maps one.
    pub(super) async fn join(&self, number: u64, proposal: Proposal, reporter: &JobReporter) -> JobOutcome {
        let Some(turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        self.join_in_turn(number, proposal, reporter, turn).await
    }

    /// The same for a job that has its turn already.
    pub(super) async fn join_in_turn(
        &self,
        number: u64,
        proposal: Proposal,
        reporter: &JobReporter,
        _turn: OwnedSemaphorePermit,
    ) -> JobOutcome {
        let committed = match proposal.target.existing() {
            Some(map) => self.append(number, map, proposal, reporter).await,
            None => self.make(number, proposal, reporter).await,
        };
        match committed {
            Ok(end) => JobOutcome::Stored(end),
            Err(stopped) => stopped.into(),
        }
    }

    /// Into a map that is there. Its robots wait for as long as it takes to append and open it again.
    async fn append(
        &self,
        number: u64,
        map: MapId,
        proposal: Proposal,
        reporter: &JobReporter,
    ) -> Result<JobEnd, Stopped> {
        let mut reading = self.read_again(&proposal, reporter, None).await?;
        let name = proposal.target.base.name.clone();
        // The last moment to stop.
        Stopped::unless(reporter.progress("storing the map", 0.0))?;
        let storage = self.storage.clone();
        let end = reporter.succeeded(map_name(&name));
        let stored_end = end.clone();
        let appending = move |runtime: &Handle| {
            let row = runtime.block_on(storage.map_of_id(map))?;
            if row.map(|row| row.edition()) != Some(proposal.target.base.edition()) {
                return Err(changed(StorageError::Retold));
            }
            reading.read_on()?;
            reading.base.sessions = runtime.block_on(storage.sessions(map))?;
            let (joined, report) = reading.join(&proposal)?;
            let outcome = MergeOutcome { number, state: MergeState::Committed, report: report.to_json()? };
            runtime.block_on(storage.append_merged(map, &joined, &outcome, &stored_end)).map_err(changed)
        };
        self.open_maps.with_closed(&name, appending).await?;
        Ok(end)
    }

    /// As a map of its own, which nobody sees before it is whole.
    async fn make(&self, number: u64, proposal: Proposal, reporter: &JobReporter) -> Result<JobEnd, Stopped> {
        let reading = self.read_again(&proposal, reporter, Some(proposal.target.events)).await?;
        let Target { base, events: base_events, places: _, new } = &proposal.target;
        let name = new.as_ref().map_or_else(String::new, |new| new.name().to_owned());
        let (joined, mut report) = reading.join(&proposal)?;
        let of_sources: u64 = joined.iter().map(|log| log.events.len() as u64).sum();
        report.made_events = Some(base_events + of_sources);
        let report = report.to_json()?;
        let made_of: Vec<MapId> =
            std::iter::once(base.id).chain(joined.iter().map(|log| log.source.map)).collect();
        let owner = new.as_ref().and_then(|new| new.owner());
        let begun = self.storage.begin_merged_map(&name, base, &made_of, owner, now_ns()).await;
        let map = begun.map_err(|error| match error {
            StorageError::Exists => map_exists(&name),
            error => error.into(),
        })?;
        let end = reporter.succeeded(map_name(&name));
        let stored = async {
            self.store(base.id, map, *base_events, &joined, number, reporter).await?;
            let made_of: Vec<MapEdition> =
                std::iter::once(base.edition()).chain(joined.iter().map(|log| log.source)).collect();
            let outcome = MergeOutcome { number, state: MergeState::Committed, report };
            let finished = self.storage.finish_merged_map(map, &made_of, &outcome, &end).await;
            finished.map_err(|error| Stopped::Failed(changed(error)))
        };
        match stored.await {
            Ok(()) => Ok(end),
            Err(stopped) => {
                self.deleted_maps.give_up_import(map).await;
                Err(stopped)
            }
        }
    }

    /// Copies the base, and adds what the sources' logs have become, piece by piece.
    async fn store(
        &self,
        base: MapId,
        map: MapId,
        base_events: u64,
        joined: &[JoinedLog],
        merge: u64,
        reporter: &JobReporter,
    ) -> Result<(), Stopped> {
        let all = base_events + joined.iter().map(|log| log.events.len() as u64).sum::<u64>();
        let go_on = |stored: u64| -> ControlFlow<()> {
            reporter.progress("storing the map", stored as f64 / all.max(1) as f64)
        };
        for from in (0..base_events).step_by(EVENTS_PIECE as usize) {
            Stopped::unless(go_on(from))?;
            let piece = from..(from + EVENTS_PIECE).min(base_events);
            self.storage.copy_log(base, map, piece).await.map_err(ServiceError::from)?;
        }
        self.store_media(base, map, base_events, 0, &go_on).await?;
        for log in joined {
            self.storage.add_joined_sessions(map, log, merge).await.map_err(ServiceError::from)?;
            let positions = log.from..;
            let entries: Vec<(u64, MapEvent)> = positions.zip(log.events.iter().cloned()).collect();
            for piece in entries.chunks(EVENTS_PIECE as usize) {
                Stopped::unless(go_on(piece[0].0))?;
                self.storage.import_piece(map, piece, &[], &[], &[]).await.map_err(ServiceError::from)?;
            }
            self.store_media(log.source.map, map, log.events.len() as u64, log.from, &go_on).await?;
        }
        Ok(())
    }

    async fn store_media(
        &self,
        source: MapId,
        map: MapId,
        events: u64,
        from: u64,
        go_on: &impl Fn(u64) -> ControlFlow<()>,
    ) -> Result<(), Stopped> {
        for first in (0..events).step_by(MEDIA_PIECE as usize) {
            Stopped::unless(go_on(from + first))?;
            let piece = first..(first + MEDIA_PIECE).min(events);
            self.storage.copy_media(source, map, piece, from).await.map_err(ServiceError::from)?;
        }
        Ok(())
    }

    async fn read_again(
        &self,
        proposal: &Proposal,
        reporter: &JobReporter,
        base_events: Option<u64>,
    ) -> Result<Reading, Stopped> {
        let mut models = vec![self.models.get(&proposal.target.base.model).await?];
        for joining in &proposal.joining {
            models.push(self.models.get(&joining.row.model).await?);
        }
        let storage = self.storage.clone();
        let runtime = Handle::current();
        let reporter = reporter.clone();
        let base = proposal.target.base.clone();
        let joining = proposal.joining.clone();
        let work = move || {
            let disk = Disk { runtime: &runtime, storage: &storage };
            let sessions = runtime.block_on(storage.sessions(base.id)).map_err(ServiceError::from)?;
            let read = ReadMap::read(disk, base, &models[0], base_events)?;
            let base = Base { id: read.row.id, mapper: read.mapper, log: read.log.events, sessions };
            let mut sources = Vec::new();
            for (index, Joining { source: _, row, events, plan: _ }) in joining.iter().enumerate() {
                let fraction = (index + 1) as f64 / models.len() as f64;
                Stopped::unless(reporter.progress("reading the maps", fraction))?;
                let source = ReadMap::read(disk, row.clone(), &models[index + 1], Some(*events))?;
                if source.row.edition() != row.edition() {
                    return Err(Stopped::Failed(changed(StorageError::Retold)));
                }
                sources.push(source);
            }
            Ok(Reading { storage, runtime, models, base, sources })
        };
        tokio::task::spawn_blocking(work).await.map_err(ServiceError::internal)?
    }
}

impl Reading {
    /// What robots have added to the base since. Blocks.
    fn read_on(&mut self) -> Result<(), ServiceError> {
        let Self { storage, runtime, models, base, .. } = self;
        let disk = Disk { runtime, storage };
        read_on(disk, base.id, &models[0], None, &mut base.mapper, &mut base.log)
    }

    /// The sources' logs as the target's, each on top of those before.
    fn join(mut self, proposal: &Proposal) -> Result<(Vec<JoinedLog>, MergeReport), ServiceError> {
        let Proposal { target, joining, report } = proposal;
        let mut report = report.clone();
        if let Some(base) = &mut report.base {
            base.sessions = self.base.opened_sessions();
        }
        let mapper = &mut self.base.mapper;
        let later_events = mapper.map().events() - target.events;
        let later_places = mapper.map().places().len() as u32 - target.places;
        let mut names: BTreeSet<String> =
            self.base.sessions.into_iter().map(|session| session.name).collect();
        let mut joined = Vec::new();
        for (Joining { source, row, events: _, plan }, read) in joining.iter().zip(&self.sources) {
            let from = mapper.map().events();
            // What was planned for the target is said of it as it was then.
            let plan = plan.clone().on_a_grown_target(
                (PlaceId::new(target.places), later_places),
                (target.events, later_events),
            );
            let events =
                join((&read.mapper, mapper), &plan, &read.log.events).map_err(ServiceError::internal)?;
            for event in &events {
                mapper.fold(event).map_err(ServiceError::internal)?;
            }
            let sessions: Vec<JoinedSession> = joined_sessions(&read.log.events, &events)
                .map(|(of_source, number)| {
                    let name = unused_name(&row.name, read.session(of_source), &names);
                    names.insert(name.clone());
                    JoinedSession { of_source, number, name }
                })
                .collect();
            report.sources[*source].sessions = sessions.iter().map(|session| session.name.clone()).collect();
            let places = joined_places(&read.log.events, &events).collect();
            joined.push(JoinedLog { source: row.edition(), from, events, sessions, places });
        }
        Ok((joined, report))
    }
}

/// A session keeps its name, unless the target has one of that name.
fn unused_name(map: &str, session: &str, taken: &BTreeSet<String>) -> String {
    let cut = |name: String, room: usize| name[..name.len().min(room)].to_owned();
    let names = std::iter::once(session.to_owned())
        .chain(std::iter::once(cut(format!("{map}-{session}"), MAX_NAME_LEN)))
        .chain((2_u64..).map(|number| {
            let end = format!("-{number}");
            cut(format!("{map}-{session}"), MAX_NAME_LEN - end.len()) + &end
        }));
    let mut unused = names.filter(|name| !taken.contains(name));
    unused.next().unwrap_or_default()
}
