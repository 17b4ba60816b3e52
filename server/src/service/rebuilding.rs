//! A map rebuilt with another model, from what it keeps of its frames.

use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;

use crate::ingest::FeatureRecord;
use bytes::Bytes;
use futures::stream::{self, StreamExt};
use topomap::ids::{FrameId, SessionId};
use topomap::log::{FrameEvent, MapEvent};

use super::jobs::{JobOutcome, JobReporter, JobStatus, Jobs, Stopped};
use super::map_names::map_exists;
use super::maps::{Maps, check_recognizer};
use super::sessions::{self, Frame, FrameOutcome, Robot, SessionStream, Sessions, Windows};
use super::tokens::Caller;
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::ingest::content::{Content, Described};
use crate::ingest::model::LoadedModel;
use crate::map_settings::{self, Keep};
use crate::names::{check_id, map_in, map_name};
use crate::open_map::{Opener, SessionMode};
use crate::storage::{JobKind, MapRow, MediumKind, NoteRow, StorageError, StoredSession};

/// Log events that are read at a time.
const EVENTS_PAGE: u64 = 256;

/// Nobody waits for an answer, so as many frames as share a commit well.
const WINDOWS: Windows = Windows { prepared: 4, submitted: 32 };

/// A map, and what it is to be rebuilt with.
struct Rebuild {
    source: MapRow,
    words: usize,
    sessions: Vec<StoredSession>,
    /// Name of the new map.
    into: String,
}

/// Rebuilds maps with other models. Cheap to clone.
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
        match self.maps.storage.map(&into).await? {
            None => {
                self.maps.names.check_unreserved(&into)?;
                let owner = caller.token.as_deref();
                let storage = &self.maps.storage;
                let created = storage.create_map(&into, &model.hash, &source.settings, now_ns(), owner).await;
                created.map_err(|error| match error {
                    StorageError::Exists => map_exists(&into),
                    error => error.into(),
                })?;
            }
            Some(row)
                if row.model == model.hash && row.settings == source.settings && row.id != source.id => {}
            Some(_) => return Err(map_exists(&into)),
        }
        let sessions = self.maps.storage.stored_sessions(source.id).await?;
        let made = into.clone();
        let rebuild = Rebuild { words: before.model.vocabulary().len(), source, sessions, into };
        let rebuilding = self.clone();
        let work = |reporter: JobReporter| async move { rebuilding.rebuild(rebuild, &reporter).await };
        self.jobs.start(JobKind::RebuildMap, &[from, &made], work).await
    }

    async fn rebuild(&self, rebuild: Rebuild, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        match self.send_all(&rebuild, reporter).await {
            Ok(()) => {
                let end = reporter.succeeded(map_name(&rebuild.into));
                match self.maps.storage.end_job(&end).await {
                    Ok(()) => JobOutcome::Stored(end),
                    Err(error) => JobOutcome::Failed(error.into()),
                }
            }
            Err(stopped) => stopped.into(),
        }
    }

    /// Sends every frame of the map to the new one, in the order of the log, as its robots would have.
    async fn send_all(&self, rebuild: &Rebuild, reporter: &JobReporter) -> Result<(), Stopped> {
        let events = self.maps.storage.log_events(rebuild.source.id).await.map_err(ServiceError::from)?;
        let mut streams: HashMap<SessionId, Arc<SessionStream>> = HashMap::new();
        for from in (0..events).step_by(EVENTS_PAGE as usize) {
            let fraction = from as f64 / events as f64;
            Stopped::unless(reporter.progress("looking at the frames again", fraction))?;
            // Positions mean something else once sessions were removed.
            let now = self.maps.storage.map_of_id(rebuild.source.id).await.map_err(ServiceError::from)?;
            if now.map(|row| row.edition()) != Some(rebuild.source.edition()) {
                return Err(Stopped::Failed(ServiceError::Aborted {
                    message: format!(
                        "the map {} was deleted, or sessions were removed from it, meanwhile; ask for the rebuilding again",
                        rebuild.source.name
                    ),
                }));
            }
            let mut page = Vec::new();
            let mut keep = |_: u64, event: MapEvent| {
                page.push(event);
                Ok(())
            };
            let positions = from..(from + EVENTS_PAGE).min(events);
            let notes = self.maps.storage.notes(rebuild.source.id, positions.clone()).await;
            let notes: HashMap<FrameId, String> = notes
                .map_err(ServiceError::from)?
                .into_iter()
                .map(|NoteRow { position, note }| (position, note))
                .collect();
            let read = self.maps.storage.replay(rebuild.source.id, positions, rebuild.words, &mut keep).await;
            read.map_err(ServiceError::from)?;
            let mut frames = Vec::new();
            for event in page {
                match event {
                    MapEvent::SessionOpened { session } => {
                        streams.insert(session, Arc::new(self.opened(rebuild, session).await?));
                    }
                    MapEvent::Frame(frame) => frames.push(*frame),
                    // It was said of frames of another map: the robot's to say again, or the person's.
                    MapEvent::Measured(_) | MapEvent::Corrected(_) => {}
                }
            }
            self.send(rebuild, &streams, frames, &notes).await?;
        }
        Ok(())
    }

    async fn opened(&self, rebuild: &Rebuild, session: SessionId) -> Result<SessionStream, ServiceError> {
        let stored = rebuild.sessions.iter().find(|stored| stored.number == session);
        let stored = stored.ok_or_else(|| ServiceError::internal("a session is not in the table"))?;
        let map = map_name(&rebuild.into);
        let camera = stored.camera.clone();
        let robot = Robot { words_hash: "", run: "", opener: Opener::SERVER };
        self.sessions.open(&map, &stored.name, SessionMode::Map, camera, robot).await
    }

    async fn send(
        &self,
        rebuild: &Rebuild,
        streams: &HashMap<SessionId, Arc<SessionStream>>,
        frames: Vec<FrameEvent>,
        notes: &HashMap<FrameId, String>,
    ) -> Result<(), ServiceError> {
        let committed = |frame: &FrameEvent| {
            let last = streams.get(&frame.session).and_then(|stream| stream.last_committed());
            last.is_some_and(|last| frame.sequence <= last)
        };
        let read = |frame: FrameEvent| async move {
            let stream = streams.get(&frame.session);
            let stream = stream.ok_or_else(|| ServiceError::internal("a frame of no session"))?;
            let content = self.kept_content(rebuild, &frame).await?;
            let note = notes.get(&frame.frame).cloned().unwrap_or_default();
            let FrameEvent { sequence, stamp_ns, odometry, .. } = frame;
            Ok::<_, ServiceError>((stream.clone(), Ok(Frame { sequence, stamp_ns, content, odometry, note })))
        };
        let left = frames.into_iter().filter(|frame| !committed(frame));
        let frames = stream::iter(left).map(read).buffered(WINDOWS.prepared);
        let mut outcomes = pin!(sessions::run(frames, WINDOWS));
        while let Some(outcome) = outcomes.next().await {
            match outcome? {
                FrameOutcome::Answered(_) => {}
                FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// What is kept of a frame that words can be made of.
    async fn kept_content(&self, rebuild: &Rebuild, frame: &FrameEvent) -> Result<Content, ServiceError> {
        let Rebuild { source, .. } = rebuild;
        if let Some(image) = self.maps.storage.medium(source.id, frame.frame, MediumKind::Image).await? {
            return Ok(Content::Image(Bytes::from(image)));
        }
        let stored = self.maps.storage.medium(source.id, frame.frame, MediumKind::Features).await?;
        let features = stored.and_then(|bytes| FeatureRecord::from_bytes(&bytes).ok());
        let features = features.filter(|features| features.descriptors().is_some()).ok_or_else(|| {
            ServiceError::precondition(format_args!(
                "of frame {} of a session of the map {} neither the image nor descriptors are kept: its robot sent words \
                 alone; remove the session from a copy of the map, or drive it again",
                frame.sequence, source.name
            ))
        })?;
        let thumbnail = self.maps.storage.medium(source.id, frame.frame, MediumKind::Thumbnail).await?;
        Ok(Content::Described(Described { features: Arc::new(features), thumbnail }))
    }
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
