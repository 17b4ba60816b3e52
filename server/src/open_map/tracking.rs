//! How far the features of a robot's frames are, frame after frame.

use std::sync::Arc;

use topomap::ids::SessionId;
use topomap::metric::Odometry;

use super::views::{FrameStore, SeenFeatures};
use super::{CommitFailed, MapWriter};
use crate::error::ServiceError;
use crate::ingest::{FeatureRecord, TrackedFrame, Tracker};
use crate::storage::{Medium, MediumKind};

/// Sessions whose trackers are kept in memory, of 2.5 MB each; others are read from the disk when they go on.
pub(super) const MOST_TRACKERS: usize = 64;

impl MapWriter {
    /// Sees to it that a session's tracker is in memory, as the disk has it.
    pub(super) fn load_tracker(&mut self, session: SessionId) -> Result<(), CommitFailed> {
        if self.trackers.get(session).is_some() {
            return Ok(());
        }
        self.commit()?;
        match self.tracker_of(session) {
            Ok(tracker) => {
                self.trackers.keep(session, tracker);
                Ok(())
            }
            Err(error) => {
                tracing::error!(map = self.map.name, session, %error, "a session's last frames cannot be read");
                Err(CommitFailed::default())
            }
        }
    }

    fn tracker_of(&self, session: SessionId) -> Result<Tracker, ServiceError> {
        let words = self.model.model.vocabulary().len();
        let last = self.storage.last_frames(self.map.id, session, Tracker::MAX_FRAMES, words);
        let mut frames = Vec::new();
        for event in self.runtime.block_on(last)? {
            let Some(odometry) = event.odometry else { break };
            let Some(SeenFeatures { features, camera: Some(_), .. }) = self.features(event.frame)? else {
                break;
            };
            frames.push(TrackedFrame { features, odometry });
        }
        frames.reverse();
        Ok(Tracker::resumed(self.mapper.settings().odometry_noise, frames))
    }

    /// A frame's features with their depths, in what is kept of it too; and the tracker as it is once the frame is
    /// taken. Where no features are kept nothing will be compared with them, and nothing is tracked.
    pub(super) fn tracked(
        &self,
        session: SessionId,
        features: Arc<FeatureRecord>,
        odometry: Option<&Odometry>,
        media: &mut [Medium],
    ) -> (Arc<FeatureRecord>, Option<Tracker>) {
        let kept = media.iter_mut().find(|medium| medium.kind == MediumKind::Features);
        let (Some(kept), Some(tracker)) = (kept, self.trackers.get(session)) else { return (features, None) };
        let mut tracker = tracker.clone();
        let camera = self.intrinsics.get(&session).and_then(|known| known.of_image(features.image_size_px()));
        let features = tracker.track(features, camera.as_ref(), odometry);
        if let Some(turning) = tracker.turning() {
            self.metrics.turned(turning.verdict());
        }
        if !features.structure().depths().is_empty() {
            kept.content = features.to_bytes();
        }
        (features, Some(tracker))
    }
}
