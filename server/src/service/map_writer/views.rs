//! Frames compared by where their features are.

use std::sync::Arc;

use tokio::runtime::Handle;
use topomap::event::FrameId;
use topomap::mapper::ArchiveError;
use topomap::verification::{TwoView, Views};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::verification::{Comparison, Verifier, View};

use super::MapWriter;
use crate::storage::{MapId, MediumKind, Storage, StorageError};

/// Two views always give the same answer, on whichever server.
const SEED: u64 = 0;

/// The verifier of a map's settings.
pub(crate) fn verifier(settings: &topomap::mapper::MapperSettings) -> Verifier {
    Verifier::new(settings.verification, SEED)
}

/// The frame that is being decided, beside those of the map.
pub(super) struct CurrentView<'a> {
    pub(super) writer: &'a MapWriter,
    /// None if nothing is known of where the frame's words are.
    pub(super) current: Option<&'a FeatureRecord>,
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let Some(current) = self.current else { return Ok(None) };
        let earlier = self.writer.features(earlier)?;
        Ok(earlier.map(|earlier| compare(&self.writer.verifier, &earlier, current)))
    }
}

pub(crate) fn compare(verifier: &Verifier, earlier: &FeatureRecord, current: &FeatureRecord) -> TwoView {
    compare_with_matches(verifier, earlier, current).view
}

pub(crate) fn compare_with_matches(
    verifier: &Verifier,
    earlier: &FeatureRecord,
    current: &FeatureRecord,
) -> Comparison {
    let view = |features| View { features, camera: None };
    verifier.compare_with_matches(view(earlier), view(current))
}

impl MapWriter {
    /// What the map keeps of where a frame's words are.
    fn features(&self, frame: FrameId) -> Result<Option<Arc<FeatureRecord>>, ArchiveError> {
        if let Some(features) = self.recent_features.borrow().get(frame) {
            return Ok(features.clone());
        }
        let features = stored_features(&self.runtime, &self.storage, self.map.id, frame)?.map(Arc::new);
        self.recent_features.borrow_mut().keep(frame, features.clone());
        Ok(features)
    }
}

/// The features of a frame from the disk; `None` if none are kept, or they are damaged. Blocks.
pub(crate) fn stored_features(
    runtime: &Handle,
    storage: &Storage,
    map: MapId,
    frame: FrameId,
) -> Result<Option<FeatureRecord>, ArchiveError> {
    let unreadable = |error: StorageError| ArchiveError { frame, why: error.to_string() };
    let bytes = runtime.block_on(storage.medium(map, frame, MediumKind::Features)).map_err(unreadable)?;
    let Some(bytes) = bytes else { return Ok(None) };
    match FeatureRecord::from_bytes(&bytes) {
        Ok(features) => Ok(Some(features)),
        Err(error) => {
            tracing::error!(map, frame, %error, "a frame's features cannot be read; it is no longer compared");
            Ok(None)
        }
    }
}
