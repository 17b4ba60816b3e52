//! A map made anew from what another keeps of its frames: with another model, or because that one is damaged.

mod left;
mod losses;
mod repairing;
mod resending;

use std::collections::HashMap;
use std::sync::Arc;

use topomap::ids::FrameId;
use topomap::log::MapEvent;

use self::resending::{KeptFrame, Resending, Streams, WithoutContent};
use super::jobs::{Begun, JobOutcome, JobReporter, JobRequest, JobStatus, Jobs, Stopped, Task};
use super::map_names::map_exists;
use super::maps::{Maps, check_recognizer};
use super::sessions::Sessions;
use super::tokens::Caller;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::ingest::model::LoadedModel;
use crate::map_settings::{self, Keep};
use crate::names::{check_id, map_in, map_name, model_name};
use crate::storage::{JobKind, MapRow, NoteRow, StorageError};

/// Log events that are read at a time.
const EVENTS_PAGE: u64 = 256;

/// A map, and what it is to be rebuilt with.
struct Rebuild {
    resending: Arc<Resending>,
    words: usize,
}

/// Makes maps anew. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Rebuilding {
    pub(super) maps: Maps,
    pub(super) sessions: Sessions,
    pub(super) jobs: Jobs,
}

impl Rebuilding {
    /// Begins to rebuild a map with another model. If that was begun before and cut off, it goes on where it was.
    pub(crate) async fn start(
        &self,
        caller: &Caller,
        name: &str,
        model: &str,
        into: &str,
    ) -> Result<JobStatus, ServiceError> {
        self.start_rebuilding(caller, name, model, into, Begun::Now).await
    }

    pub(super) async fn start_rebuilding(
        &self,
        caller: &Caller,
        name: &str,
        model: &str,
        into: &str,
        begun: Begun,
    ) -> Result<JobStatus, ServiceError> {
        let (from, into) = (map_in(name)?, check_id("map name", into)?.to_owned());
        caller.check_map(from)?;
        caller.check_map(&into)?;
        let source = self.maps.open_maps.row(from).await?;
        let model = self.maps.models.find(model).await?;
        let loaded = self.maps.loaded.get(&model.hash).await?;
        let before = self.maps.loaded.get(&source.model).await?;
        let settings = map_settings::from_json(&source.settings)?;
        check_kept(&source, settings.keep, &before, &loaded)?;
        check_recognizer(loaded, settings.mapper).await?;
        // It was made before the job was noted.
        if matches!(begun, Begun::Before(_)) && self.maps.storage.map(&into).await?.is_none() {
            return Err(ServiceError::aborted(format_args!(
                "the map {into}, which was being made, was deleted; start it again if you want it all the same"
            )));
        }
        self.make(JobKind::RebuildMap, caller, &source, &model.hash, &into).await?;
        let sessions = self.maps.storage.stored_sessions(source.id).await?;
        let task = Task::RebuildMap {
            map: name.to_owned(),
            model: model_name(&model.hash),
            into: into.clone(),
            asked_by: caller.token.clone(),
        };
        let maps = vec![from.to_owned(), into.clone()];
        let request = JobRequest { kind: JobKind::RebuildMap, maps, task: Some(task), begun };
        let resending = Arc::new(Resending::new(source, sessions, into, WithoutContent::Refuse));
        let rebuild = Rebuild { resending, words: before.model.vocabulary().len() };
        let rebuilding = self.clone();
        let work = move |reporter: JobReporter| async move { rebuilding.rebuild(rebuild, &reporter).await };
        self.jobs.start(request, work).await
    }

    /// Makes the new map, with the settings of the other; one that was begun before is gone on with.
    async fn make(
        &self,
        kind: JobKind,
        caller: &Caller,
        source: &MapRow,
        model_hash: &str,
        into: &str,
    ) -> Result<(), ServiceError> {
        if self.was_begun(kind, source, model_hash, into).await? {
            return Ok(());
        }
        self.maps.names.check_unreserved(into)?;
        let owner = caller.token.as_deref();
        let storage = &self.maps.storage;
        let created = storage.create_map(into, model_hash, &source.settings, now_ns(), owner).await;
        created.map_err(|error| match error {
            StorageError::Exists => map_exists(into),
            error => error.into(),
        })?;
        Ok(())
    }

    /// Whether the new map is there already, as one that was begun before; refused if it is any other, so that nobody's
    /// map gets the frames of another.
    async fn was_begun(
        &self,
        kind: JobKind,
        source: &MapRow,
        model_hash: &str,
        into: &str,
    ) -> Result<bool, ServiceError> {
        let storage = &self.maps.storage;
        let Some(row) = storage.map(into).await? else { return Ok(false) };
        let is_like = row.model == model_hash && row.settings == source.settings && row.id != source.id;
        // A server that was killed may have made the map, and not told of the job yet.
        if is_like
            && (storage.was_begun(kind, &[&source.name, into]).await?
                || storage.stored_sessions(row.id).await?.is_empty())
        {
            return Ok(true);
        }
        Err(map_exists(into))
    }

    async fn rebuild(&self, rebuild: Rebuild, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        match self.send_all(&rebuild, reporter).await {
            Ok(()) => self.done(&rebuild.resending.into, reporter).await,
            Err(stopped) => stopped.into(),
        }
    }

    async fn done(&self, into: &str, reporter: &JobReporter) -> JobOutcome {
        let end = reporter.succeeded(map_name(into));
        match self.maps.storage.end_job(&end).await {
            Ok(()) => JobOutcome::Stored(end),
            Err(error) => JobOutcome::Failed(error.into()),
        }
    }

    /// Sends every frame of the map to the new one, in the order of the log, as its robots would have.
    async fn send_all(&self, rebuild: &Rebuild, reporter: &JobReporter) -> Result<(), Stopped> {
        let Rebuild { resending, words } = rebuild;
        let source = resending.source.id;
        let events = self.maps.storage.log_events(source).await.map_err(ServiceError::from)?;
        let mut streams = Streams::new();
        for from in (0..events).step_by(EVENTS_PAGE as usize) {
            let fraction = from as f64 / events as f64;
            Stopped::unless(reporter.progress("looking at the frames again", fraction))?;
            self.check_unchanged(&resending.source).await?;
            let mut page = Vec::new();
            let mut keep = |_: u64, event: MapEvent| {
                page.push(event);
                Ok(())
            };
            let positions = from..(from + EVENTS_PAGE).min(events);
            let notes = self.maps.storage.notes(source, positions.clone()).await;
            let mut notes = by_position(notes.map_err(ServiceError::from)?);
            let read = self.maps.storage.replay(source, positions, *words, &mut keep).await;
            read.map_err(ServiceError::from)?;
            let mut frames = Vec::new();
            for event in page {
                match event {
                    MapEvent::SessionOpened { session } => {
                        // In the order of the log, so that the new one is alike.
                        self.send(resending, &streams, std::mem::take(&mut frames)).await?;
                        self.open(resending, &mut streams, session).await?;
                    }
                    MapEvent::Frame(event) => {
                        let note = notes.remove(&event.frame).unwrap_or_default();
                        frames.push(KeptFrame { map: source, event: *event, note });
                    }
                    // It was said of frames of another map: the robot's to say again, or the person's.
                    MapEvent::Measured(_) | MapEvent::Corrected(_) => {}
                }
            }
            self.send(resending, &streams, frames).await?;
        }
        Ok(())
    }

    /// Positions mean something else once sessions were removed.
    async fn check_unchanged(&self, source: &MapRow) -> Result<(), ServiceError> {
        let now = self.maps.storage.map_of_id(source.id).await?;
        if now.map(|row| row.edition()) == Some(source.edition()) {
            return Ok(());
        }
        Err(ServiceError::Aborted {
            message: format!(
                "the map {} was deleted, or sessions were removed from it, meanwhile; ask for it again",
                source.name
            ),
        })
    }
}

fn by_position(notes: Vec<NoteRow>) -> HashMap<FrameId, String> {
    notes.into_iter().map(|NoteRow { position, note }| (position, note)).collect()
}

/// Whether words of the new model can be made of what the map keeps.
fn check_kept(
    source: &MapRow,
    keep: Keep,
    before: &LoadedModel,
    model: &LoadedModel,
) -> Result<(), ServiceError> {
    let same_features = before.model.extractor() == model.model.extractor();
    match keep {
        Keep::Images => Ok(()),
        Keep::Features if same_features => Ok(()),
        Keep::Features => Err(ServiceError::precondition(format_args!(
            "the map {} keeps descriptors of `{}`, but words of the model models/{} are made of `{}`, which takes images: \
             give a model of the same features, or drive again into a map of that model",
            source.name,
            before.model.extractor(),
            model.hash,
            model.model.extractor()
        ))),
        Keep::Words => Err(ServiceError::precondition(format_args!(
            "the map {} keeps words alone, of which no others can be made; drive again into a map of that model",
            source.name
        ))),
    }
}
