//! Frames compared by where their features are.

use std::sync::Arc;

use rayon::prelude::*;
use tokio::runtime::Handle;
use topomap::epipolar::SearchSettings;
use topomap::event::FrameId;
use topomap::mapper::ArchiveError;
use topomap::standing::TurnedView;
use topomap::verification::{TwoView, VerificationMethod, VerificationSettings, Views};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::verification::{Comparison, Pinhole, Verifier, View};

use super::MapWriter;
use crate::service::camera::{Intrinsics, PanoramicOptics};
use crate::storage::{MapId, Storage, StorageError, StoredFeatures};

/// Two views always give the same answer, on whichever server.
const SEED: u64 = 0;

/// Compares in the image plane, whatever the map does: robots are steered by how far the image has shifted.
pub(super) fn steering_verifier(settings: &topomap::mapper::MapperSettings) -> Verifier {
    let method = VerificationMethod::Similarity;
    Verifier::new(VerificationSettings { method, ..settings.verification }, SEED)
}

/// The verifier of a map's settings.
pub(crate) fn verifier(settings: &topomap::mapper::MapperSettings) -> Verifier {
    Verifier::new(settings.verification, SEED)
}

/// Where a frame's features are, and how its camera saw them as far as the session declared it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SeenFeatures {
    pub(crate) features: Arc<FeatureRecord>,
    pub(crate) camera: Option<Pinhole>,
    /// Of a camera that sees all around.
    around: Option<PanoramicOptics>,
}

impl SeenFeatures {
    pub(super) fn new(features: Arc<FeatureRecord>, intrinsics: Option<&Intrinsics>) -> Self {
        let camera = intrinsics.and_then(|intrinsics| intrinsics.of_image(features.image_size_px()));
        Self { features, camera, around: None }
    }

    /// The same, by a camera that may see all around.
    pub(super) fn all_around(self, around: Option<PanoramicOptics>) -> Self {
        Self { around, ..self }
    }

    /// What both have in common if the camera has at most turned on the spot; `None` if one does not see all around.
    pub(crate) fn turned(&self, earlier: &SeenFeatures) -> Option<TurnedView> {
        let [current, earlier] = [self, earlier].map(|seen| seen.around?.view(&seen.features));
        Some(current?.turned(&earlier?, SearchSettings::default().tolerance_rad))
    }

    /// Focal length along x, in image widths; `None` if the camera is not known.
    pub(crate) fn focal_length_widths(&self) -> Option<f64> {
        let (width_px, _) = self.features.image_size_px();
        self.camera.map(|camera| camera.focal_length_widths(width_px))
    }

    fn view(&self) -> View<'_> {
        View { features: &self.features, camera: self.camera }
    }
}

/// The frame that is being decided, beside those of the map.
pub(super) struct CurrentView<'a> {
    pub(super) writer: &'a MapWriter,
    /// None if nothing is known of where the frame's words are.
    pub(super) current: Option<SeenFeatures>,
    pub(super) verifier: &'a Verifier,
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let Some(current) = &self.current else { return Ok(None) };
        let earlier = self.writer.features(earlier)?;
        Ok(earlier.map(|earlier| compare(self.verifier, &earlier, current).view))
    }

    fn compare_all(&self, earlier: &[FrameId]) -> Result<Vec<Option<TwoView>>, ArchiveError> {
        let Some(current) = &self.current else { return Ok(vec![None; earlier.len()]) };
        let features = earlier.iter().map(|&frame| self.writer.features(frame));
        let features = features.collect::<Result<Vec<Option<SeenFeatures>>, ArchiveError>>()?;
        let verifier = self.verifier;
        let view = |earlier: &Option<SeenFeatures>| Some(compare(verifier, earlier.as_ref()?, current).view);
        Ok(features.par_iter().map(view).collect())
    }

    fn turned(&self, earlier: FrameId) -> Result<Option<TurnedView>, ArchiveError> {
        let Some(current) = &self.current else { return Ok(None) };
        let earlier = self.writer.features(earlier)?;
        Ok(earlier.and_then(|earlier| current.turned(&earlier)))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        self.current.as_ref()?.focal_length_widths()
    }
}

pub(crate) fn compare(verifier: &Verifier, earlier: &SeenFeatures, current: &SeenFeatures) -> Comparison {
    verifier.compare_with_matches(earlier.view(), current.view())
}

impl MapWriter {
    /// What the map keeps of where a frame's words are.
    fn features(&self, frame: FrameId) -> Result<Option<SeenFeatures>, ArchiveError> {
        if let Some(features) = self.recent_features.borrow().get(frame) {
            return Ok(features.clone());
        }
        let features = stored_features(&self.runtime, &self.storage, self.map.id, frame)?;
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
) -> Result<Option<SeenFeatures>, ArchiveError> {
    let unreadable = |error: StorageError| ArchiveError { frame, why: error.to_string() };
    let stored = runtime.block_on(storage.features(map, frame)).map_err(unreadable)?;
    let Some(StoredFeatures { features, camera }) = stored else { return Ok(None) };
    match FeatureRecord::from_bytes(&features) {
        Ok(features) => {
            let intrinsics = camera.as_deref().and_then(Intrinsics::of_camera);
            let around = camera.as_deref().and_then(PanoramicOptics::of_camera);
            Ok(Some(SeenFeatures::new(Arc::new(features), intrinsics.as_ref()).all_around(around)))
        }
        Err(error) => {
            tracing::error!(map, frame, %error, "a frame's features cannot be read; it is no longer compared");
            Ok(None)
        }
    }
}
