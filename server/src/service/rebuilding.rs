//! A map made anew with another model, from what it keeps of its frames.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use futures::stream::{self, StreamExt};
use topomap::event::{FrameEvent, MapEvent, SessionId};
use waypost_vision::feature_record::FeatureRecord;

use super::content::{Content, Described};
use super::jobs::{JobOutcome, JobReporter, JobStatus, Stopped};
use super::map_settings::{self, Keep};
use super::map_writer::SessionMode;
use super::maps::{check_recognizer, map_exists};
use super::names::{check_id, map_in, map_name};
use super::sessions::{Frame, FrameOutcome, PreparedFrame, SessionStream};
use super::{Service, now_ns};
use crate::error::ServiceError;
use crate::extraction::LoadedModel;
use crate::storage::{JobKind, LogEntry, MapRow, MediumKind, StorageError, StoredSession};

/// Log events that are read at a time.
const EVENTS_PAGE: u64 = 256;

/// Frames that are turned into words side by side, and that wait for their answers.
const AHEAD: usize = 4;
const WAITING: usize = 32;

/// A map, and what it is to be made anew with.
struct Rebuild {
    source: MapRow,
    words: usize,
    sessions: Vec<StoredSession>,
    /// Name of the new map.
    into: String,
}

impl Service {
    /// Begins to make a map anew with another model. If that was begun before and cut off, it goes on where it was.
    pub(crate) async fn rebuild_map(
        self: &Arc<Self>,
        name: &str,
        model: &str,
        into: &str,
    ) -> Result<JobStatus, ServiceError> {
        let source = self.map_row(map_in(name)?).await?;
        let into = check_id("map name", into)?.to_owned();
        let model = self.find_model(model).await?;
        let loaded = self.loaded_model(&model.hash).await?;
        let before = self.loaded_model(&source.model).await?;
        let settings = map_settings::from_json(&source.settings)?;
        check_kept(&source, settings.keep, &before, &loaded)?;
        check_recognizer(loaded, settings.mapper).await?;
        match self.storage.map(&into).await? {
            None => {
                self.snapshots.check_unreserved(&into)?;
                let created = self.storage.create_map(&into, &model.hash, &source.settings, now_ns()).await;
                created.map_err(|error| match error {
                    StorageError::Exists => map_exists(&into),
                    error => error.into(),
                })?;
            }
            Some(row)
                if row.model == model.hash && row.settings == source.settings && row.id != source.id => {}
            Some(_) => return Err(map_exists(&into)),
        }
        let sessions = self.storage.stored_sessions(source.id).await?;
        let rebuild = Rebuild { words: before.model.vocabulary().len(), source, sessions, into };
        self.start_job(JobKind::RebuildMap, |service, reporter| async move {
            service.rebuild(rebuild, &reporter).await
        })
        .await
    }

    async fn rebuild(self: Arc<Self>, rebuild: Rebuild, reporter: &JobReporter) -> JobOutcome {
        let Some(_turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        match self.send_all(&rebuild, reporter).await {
            Ok(()) => {
                let end = reporter.succeeded(map_name(&rebuild.into));
                match self.storage.end_job(&end).await {
                    Ok(()) => JobOutcome::Stored { end, model: None },
                    Err(error) => JobOutcome::Failed(error.into()),
                }
            }
            Err(stopped) => stopped.into(),
        }
    }

    /// Sends every frame of the map to the new one, in the order of the log, as its robots would have.
    async fn send_all(self: &Arc<Self>, rebuild: &Rebuild, reporter: &JobReporter) -> Result<(), Stopped> {
        let events = self.storage.log_events(rebuild.source.id).await.map_err(ServiceError::from)?;
        let mut streams: HashMap<SessionId, SessionStream> = HashMap::new();
        for from in (0..events).step_by(EVENTS_PAGE as usize) {
            let fraction = from as f64 / events as f64;
            Stopped::unless(reporter.progress("looking at the frames anew", fraction))?;
            // Positions mean something else once sessions were removed.
            let now = self.storage.map_of_id(rebuild.source.id).await.map_err(ServiceError::from)?;
            if now.map(|row| row.edition()) != Some(rebuild.source.edition()) {
                return Err(Stopped::Failed(ServiceError::Aborted {
                    message: format!(
                        "the map {} was deleted, or sessions were removed from it, meanwhile; ask for the rebuilding again",
                        rebuild.source.name
                    ),
                }));
            }
            let mut page = Vec::new();
            let mut keep = |LogEntry { position: _, event, media: _ }: LogEntry| {
                page.push(event);
                Ok(())
            };
            let positions = from..(from + EVENTS_PAGE).min(events);
            let read = self.storage.replay(rebuild.source.id, positions, rebuild.words, &mut keep).await;
            read.map_err(ServiceError::from)?;
            let mut frames = Vec::new();
            for event in page {
                match event {
                    MapEvent::SessionOpened { session } => {
                        streams.insert(session, self.opened(rebuild, session).await?);
                    }
                    MapEvent::Frame(frame) => frames.push(*frame),
                    // It was said of frames of another map: the robot's to say again.
                    MapEvent::Measured(_) => {}
                }
            }
            self.send(rebuild, &streams, frames).await?;
        }
        Ok(())
    }

    async fn opened(
        self: &Arc<Self>,
        rebuild: &Rebuild,
        session: SessionId,
    ) -> Result<SessionStream, ServiceError> {
        let stored = rebuild.sessions.iter().find(|stored| stored.number == session);
        let stored = stored.ok_or_else(|| ServiceError::internal("a session is not in the table"))?;
        let (map, camera) = (map_name(&rebuild.into), stored.camera.clone());
        self.open_session(&map, &stored.name, SessionMode::Map, camera, "", "").await
    }

    async fn send(
        &self,
        rebuild: &Rebuild,
        streams: &HashMap<SessionId, SessionStream>,
        frames: Vec<FrameEvent>,
    ) -> Result<(), Stopped> {
        let prepare = |frame: FrameEvent| async move {
            let stream = streams.get(&frame.session);
            let stream = stream.ok_or_else(|| ServiceError::internal("a frame of no session"))?;
            if stream.last_committed().is_some_and(|last| frame.sequence <= last) {
                return Ok(None);
            }
            let content = self.kept_content(rebuild, &frame).await?;
            let FrameEvent { sequence, stamp_ns, odometry, .. } = frame;
            let frame = Frame { sequence, stamp_ns, content, odometry };
            Ok::<Option<(&SessionStream, PreparedFrame)>, ServiceError>(Some((
                stream,
                stream.prepare(Ok(frame)).await,
            )))
        };
        let mut prepared = std::pin::pin!(stream::iter(frames).map(prepare).buffered(AHEAD));
        let mut waiting = VecDeque::new();
        while let Some(frame) = prepared.next().await {
            let Some((stream, frame)) = frame? else { continue };
            waiting.push_back((stream, stream.submit(frame).await));
            if waiting.len() >= WAITING
                && let Some((stream, pending)) = waiting.pop_front()
            {
                taken(stream.outcome(pending).await)?;
            }
        }
        for (stream, pending) in waiting {
            taken(stream.outcome(pending).await)?;
        }
        Ok(())
    }

    /// What is kept of a frame that words can be made of.
    async fn kept_content(&self, rebuild: &Rebuild, frame: &FrameEvent) -> Result<Content, ServiceError> {
        let Rebuild { source, .. } = rebuild;
        if let Some(image) = self.storage.medium(source.id, frame.frame, MediumKind::Image).await? {
            return Ok(Content::Image(Bytes::from(image)));
        }
        let stored = self.storage.medium(source.id, frame.frame, MediumKind::Features).await?;
        let features = stored.and_then(|bytes| FeatureRecord::from_bytes(&bytes).ok());
        let features = features.filter(|features| features.descriptors().is_some()).ok_or_else(|| {
            ServiceError::precondition(format_args!(
                "of frame {} of a session of the map {} neither the image nor descriptors are kept: its robot sent words \
                 alone; remove the session from a copy of the map, or drive it again",
                frame.sequence, source.name
            ))
        })?;
        let thumbnail = self.storage.medium(source.id, frame.frame, MediumKind::Thumbnail).await?;
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

fn taken(outcome: FrameOutcome) -> Result<(), ServiceError> {
    match outcome {
        FrameOutcome::Answered(_) => Ok(()),
        FrameOutcome::Refused { error, .. } | FrameOutcome::Ended(error) => Err(error),
    }
}
