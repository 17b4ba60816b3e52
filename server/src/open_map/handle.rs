//! A way to an open map's writer.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use fabmap::appearance::PlaceId;
use fabmap::observation::{Observation, WordId};
use tokio::sync::{mpsc, oneshot};
use topomap::log::CorrectionEvent;
use topomap::map::PlacePoses;
use topomap::mapper::MapPose;
use waypost_navigation::metric::planning::{Goal, PlanError, Route};
use waypost_navigation::metric::settings::PlanningSettings;

use super::answers::{PlaceGraph, PlacePose, PlaceSummary, QueryAnswer, WordPlace};
use super::appearance::GrowingGraph;
use super::requests::{
    CorrectionRequest, FirstFrames, FrameRequest, FrameSource, LookRequest, Looked, MapRequest,
    MeasuredFrames, OpenedSession, PlacesWanted, PlanFrom, Read, SessionOpening,
};
use crate::error::ServiceError;
use crate::ingest::FeatureRecord;
use crate::storage::{MapEdition, MapId};

/// A way to an open map's writer. Cheap to clone; the writer ends when all are gone.
#[derive(Clone, Debug)]
pub(crate) struct MapHandle {
    edition: MapEdition,
    requests: mpsc::Sender<MapRequest>,
    usage: Arc<Usage>,
    /// Beside the writer, which knows nothing of it.
    appearance: Arc<GrowingGraph>,
}

/// How an open map is used.
#[derive(Debug)]
pub(crate) struct Usage {
    last_asked: Mutex<Instant>,
    memory_bytes: AtomicU64,
}

impl Usage {
    fn new() -> Self {
        Self { last_asked: Mutex::new(Instant::now()), memory_bytes: AtomicU64::new(0) }
    }

    pub(super) fn set_memory_bytes(&self, memory_bytes: u64) {
        self.memory_bytes.store(memory_bytes, Ordering::Relaxed);
    }

    pub(super) fn memory_bytes(&self) -> u64 {
        self.memory_bytes.load(Ordering::Relaxed)
    }

    /// When the map was last asked for anything.
    pub(super) fn last_asked(&self) -> Instant {
        *self.last_asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn asked(&self) {
        *self.last_asked.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
    }
}

/// The writer is gone: a commit failed, the map was deleted, or the server is stopping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WriterGone;

impl From<WriterGone> for ServiceError {
    fn from(WriterGone: WriterGone) -> Self {
        ServiceError::unavailable("the map is being opened anew; send the request again")
    }
}

impl MapHandle {
    pub(crate) fn new(edition: MapEdition, requests: mpsc::Sender<MapRequest>) -> Self {
        Self { edition, requests, usage: Arc::new(Usage::new()), appearance: Arc::default() }
    }

    /// What the map's panoramas have in common.
    pub(crate) fn appearance(&self) -> &Arc<GrowingGraph> {
        &self.appearance
    }

    /// What the open map takes, its graph of panoramas included.
    pub(super) fn memory_bytes(&self) -> u64 {
        self.usage.memory_bytes() + self.appearance.memory_bytes()
    }

    pub(super) fn usage(&self) -> &Arc<Usage> {
        &self.usage
    }

    pub(crate) fn id(&self) -> MapId {
        self.edition.map
    }

    /// The map, in the edition that was opened.
    pub(crate) fn edition(&self) -> MapEdition {
        self.edition
    }

    /// Requests that wait for the writer.
    pub(super) fn waiting_requests(&self) -> usize {
        self.requests.max_capacity() - self.requests.capacity()
    }

    /// Completes when the writer has ended.
    pub(crate) async fn gone(&self) {
        self.requests.closed().await;
    }

    pub(crate) fn is_gone(&self) -> bool {
        self.requests.is_closed()
    }

    /// Asks the writer to end after what is queued; sessions may still hold handles.
    pub(super) async fn close(&self) {
        // An error means that it has ended already.
        let _ = self.requests.send(MapRequest::Close).await;
    }

    /// Asks the writer to end unless robots localize by it; whether it does.
    pub(super) async fn close_unused(&self) -> bool {
        let (reply, ends) = oneshot::channel();
        let asked = self.requests.send(MapRequest::CloseUnused(reply)).await;
        asked.is_err() || ends.await.unwrap_or(true)
    }

    /// Hands a frame over; the answer comes by the request's reply.
    pub(crate) async fn frame(&self, source: FrameSource, request: FrameRequest) -> Result<(), WriterGone> {
        self.usage.asked();
        let request = match source {
            FrameSource::Session(session) => MapRequest::Frame(session, request),
            FrameSource::Localizer(localizer) => MapRequest::Read(Read::Localize(localizer, request)),
        };
        self.requests.send(request).await.map_err(|_| WriterGone)
    }

    pub(crate) async fn open_session(&self, opening: SessionOpening) -> Result<OpenedSession, ServiceError> {
        self.ask(|reply| MapRequest::OpenSession { opening, reply }).await?
    }

    /// Where the robot of the later frame's session is, with what was measured; durable by then.
    pub(crate) async fn measure(&self, frames: MeasuredFrames) -> Result<Option<MapPose>, ServiceError> {
        self.ask(|reply| MapRequest::Measure { frames: Box::new(frames), reply }).await?
    }

    /// What follows from what a person says of a loop closure; durable by then.
    pub(crate) async fn correct(&self, request: CorrectionRequest) -> Result<CorrectionEvent, ServiceError> {
        self.ask(|reply| MapRequest::Correct { request, reply }).await?
    }

    /// Where an observation was made; explained by up to `explained_words` for and against.
    pub(crate) async fn query(
        &self,
        observation: Observation,
        features: Option<Arc<FeatureRecord>>,
        explained_words: usize,
    ) -> Result<QueryAnswer, ServiceError> {
        self.read(|reply| Read::Query { observation, features, explained_words, reply }).await?
    }

    /// What a frame shows to a robot that is led, and what is to be remembered of it.
    pub(crate) async fn look(&self, request: LookRequest) -> Result<Looked, ServiceError> {
        self.read(|reply| Read::Look { request: Box::new(request), reply }).await?
    }

    /// Which way leads to a goal.
    pub(crate) async fn plan(
        &self,
        from: PlanFrom,
        goal: Goal,
        settings: PlanningSettings,
    ) -> Result<Result<Route, PlanError>, WriterGone> {
        self.read(|reply| Read::Plan { from, goal, settings, reply }).await
    }

    /// Whether there is such a goal on the map, wherever the robot is.
    pub(crate) async fn check_goal(
        &self,
        goal: Goal,
        settings: PlanningSettings,
    ) -> Result<Result<(), PlanError>, WriterGone> {
        self.read(|reply| Read::CheckGoal { goal, settings, reply }).await
    }

    /// Hash of all that the map's log decided.
    pub(crate) async fn state_hash(&self) -> Result<String, ServiceError> {
        Ok(self.read(|reply| Read::StateHash { reply }).await?)
    }

    /// Where places are.
    pub(crate) async fn poses(&self) -> Result<Box<PlacePoses>, ServiceError> {
        Ok(self.read(|reply| Read::Poses { reply }).await?)
    }

    /// Where some places are, in their order; none where that is not known.
    pub(crate) async fn place_poses(
        &self,
        places: Vec<PlaceId>,
    ) -> Result<Vec<Option<PlacePose>>, ServiceError> {
        Ok(self.read(|reply| Read::PosesOf { places, reply }).await?)
    }

    /// Up to `count` places that are wanted, and where the next one is.
    pub(crate) async fn places(
        &self,
        wanted: PlacesWanted,
        count: u32,
    ) -> Result<(Vec<PlaceSummary>, Option<PlaceId>), ServiceError> {
        Ok(self.read(|reply| Read::Places { wanted, count, reply }).await?)
    }

    /// The first frame that each place learnt from, by number, and how places make observations.
    pub(crate) async fn place_order(&self) -> Result<FirstFrames, ServiceError> {
        Ok(self.read(|reply| Read::PlaceOrder { reply }).await?)
    }

    /// What places learnt from, and how they are linked.
    pub(crate) async fn place_graph(&self) -> Result<Box<PlaceGraph>, ServiceError> {
        Ok(self.read(|reply| Read::PlaceGraph { reply }).await?)
    }

    /// What some places usually show, in their order.
    pub(crate) async fn usual_looks(&self, places: Vec<PlaceId>) -> Result<Vec<Observation>, ServiceError> {
        Ok(self.read(|reply| Read::UsualLooks { places, reply }).await?)
    }

    pub(crate) async fn place(&self, place: PlaceId) -> Result<Option<PlaceSummary>, ServiceError> {
        Ok(self.read(|reply| Read::Place { place, reply }).await?)
    }

    /// Up to `count` places from `from` on that have shown a word.
    pub(crate) async fn word_places(
        &self,
        word: WordId,
        from: PlaceId,
        count: u32,
    ) -> Result<Vec<WordPlace>, ServiceError> {
        Ok(self.read(|reply| Read::WordPlaces { word, from, count, reply }).await?)
    }

    async fn read<T>(&self, read: impl FnOnce(oneshot::Sender<T>) -> Read) -> Result<T, WriterGone> {
        self.ask(|reply| MapRequest::Read(read(reply))).await
    }

    async fn ask<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> MapRequest) -> Result<T, WriterGone> {
        self.usage.asked();
        let (reply, answer) = oneshot::channel();
        self.requests.send(request(reply)).await.map_err(|_| WriterGone)?;
        answer.await.map_err(|_| WriterGone)
    }
}
