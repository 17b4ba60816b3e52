//! Frames compared by where their features are.

use std::sync::Arc;

use crate::ingest::{Comparison, FeatureRecord, RobotCamera, Tracker, Verifier, View};
use rayon::prelude::*;
use tokio::runtime::Handle;
use topomap::evidence::{TurnedView, VerificationMethod, VerificationSettings};
use topomap::ids::FrameId;
use topomap::mapper::{Comparisons, EarlierFrame, EarlierFrames, Proposed, Recognized, WantedViews};
use topomap::metric::Odometry;
use waypost_navigation::appearance::epipolar::SearchSettings;

use super::MapWriter;
use crate::error::ArchiveError;
use crate::ingest::intrinsics::Intrinsics;
use crate::ingest::panoramic::PanoramicOptics;
use crate::storage::{MapId, Storage, StoredFeatures};

/// Two views always give the same answer, on whichever server.
const SEED: u64 = 0;

/// Compares in the image plane, whatever the map does: robots are steered by how far the image has shifted.
pub(super) fn steering_verifier(settings: &topomap::settings::MapperSettings) -> Verifier {
    let method = VerificationMethod::Similarity;
    Verifier::new(VerificationSettings { method, ..settings.verification }, SEED)
}

/// The verifier of a map's settings.
pub(crate) fn verifier(settings: &topomap::settings::MapperSettings) -> Verifier {
    Verifier::new(settings.verification, SEED)
}

/// Where a frame's features are, and how its camera saw them as far as the session declared it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SeenFeatures {
    pub(crate) features: Arc<FeatureRecord>,
    pub(crate) camera: Option<RobotCamera>,
    /// Of a camera that sees all around.
    around: Option<PanoramicOptics>,
}

impl SeenFeatures {
    pub(super) fn new(features: Arc<FeatureRecord>, intrinsics: Option<&Intrinsics>) -> Self {
        let camera = intrinsics.and_then(|intrinsics| intrinsics.of_image(features.image_size_px()));
        Self { features, camera, around: None }
    }

    /// The same with depths, of the next frame of a robot that leaves nothing behind.
    pub(super) fn tracked(
        features: Arc<FeatureRecord>,
        intrinsics: Option<&Intrinsics>,
        odometry: Option<&Odometry>,
        tracker: &mut Tracker,
    ) -> Self {
        let seen = Self::new(features, intrinsics);
        let features = tracker.track(seen.features, seen.camera.as_ref(), odometry);
        Self { features, ..seen }
    }

    /// The same, by a camera that may see all around.
    pub(super) fn all_around(self, around: Option<PanoramicOptics>) -> Self {
        Self { around, ..self }
    }

    /// What both have in common if the camera has at most turned on the spot; `None` if one does not see all around.
    pub(crate) fn turned(&self, earlier: &SeenFeatures) -> Option<TurnedView> {
        let [current, earlier] = [self, earlier].map(|seen| seen.around.as_ref()?.view(&seen.features));
        Some(current?.turned(&earlier?, SearchSettings::default().tolerance_rad))
    }

    /// Focal length along x, in image widths; `None` if the camera is not known.
    pub(crate) fn focal_length_widths(&self) -> Option<f64> {
        let (width_px, _) = self.features.image_size_px();
        self.camera.map(|camera| camera.pinhole.focal_length_widths(width_px))
    }

    /// Horizontally, if the camera is known and does not see all around.
    pub(crate) fn field_of_view_rad(&self) -> Option<f64> {
        self.focal_length_widths().map(|focal_length_widths| 2.0 * (0.5 / focal_length_widths).atan())
    }

    fn view(&self) -> View<'_> {
        View { features: &self.features, camera: self.camera }
    }
}

/// Who holds earlier frames; reading them may wait for the disk.
pub(crate) trait FrameStore {
    /// What a frame showed, and where; `None` if it is lost for good.
    fn earlier_frame(&self, frame: FrameId) -> Result<Option<EarlierFrame>, ArchiveError>;

    /// Where a frame's features are; `None` if none are kept.
    fn features(&self, frame: FrameId) -> Result<Option<SeenFeatures>, ArchiveError>;

    /// Says which frames' features are about to be asked for: they may be read side by side.
    fn expect_features(&self, _frames: &[FrameId]) {}
}

/// Reads the earlier frames that a recognised one wants, and compares it with them, side by side. Nothing is compared if
/// nothing is known of where the frame's words are.
pub(crate) fn compared<'a>(
    recognized: Recognized<'a>,
    source: &impl FrameStore,
    current: Option<&SeenFeatures>,
    verifier: &Verifier,
) -> Result<(Proposed<'a>, Comparisons), ArchiveError> {
    let mut earlier = EarlierFrames::new();
    for frame in recognized.wanted_frames() {
        earlier.extend(source.earlier_frame(frame)?.map(|seen| (frame, seen)));
    }
    let proposed = recognized.propose(&earlier);
    let Some(current) = current else { return Ok((proposed, Comparisons::default())) };
    let WantedViews { compared, turned, .. } = proposed.wanted_views();
    source.expect_features(compared);
    let mut features = Vec::new();
    for &frame in compared {
        features.extend(source.features(frame)?.map(|seen| (frame, seen)));
    }
    let view =
        |(frame, earlier): &(FrameId, SeenFeatures)| (*frame, compare(verifier, earlier, current).view);
    let turned_at = turned.map(|frame| source.features(frame)).transpose()?.flatten();
    let comparisons = Comparisons {
        views: features.par_iter().map(view).collect(),
        turned: turned_at.and_then(|earlier| current.turned(&earlier)),
        focal_length_widths: current.focal_length_widths(),
    };
    Ok((proposed, comparisons))
}

pub(crate) fn compare(verifier: &Verifier, earlier: &SeenFeatures, current: &SeenFeatures) -> Comparison {
    verifier.compare_with_matches(earlier.view(), current.view())
}

impl FrameStore for MapWriter {
    fn earlier_frame(&self, frame: FrameId) -> Result<Option<EarlierFrame>, ArchiveError> {
        self.read_frame(frame)
    }

    fn features(&self, frame: FrameId) -> Result<Option<SeenFeatures>, ArchiveError> {
        if let Some(features) = self.recent_features.borrow().get(frame) {
            return Ok(features.clone());
        }
        let features = stored_features(&self.runtime, &self.storage, self.map.id, frame)?;
        self.recent_features.borrow_mut().keep(frame, features.clone());
        Ok(features)
    }

    /// Each of them may be an object of a store that takes its time.
    fn expect_features(&self, frames: &[FrameId]) {
        let known = |frame: &FrameId| self.recent_features.borrow().get(*frame).is_some();
        let unknown: Vec<FrameId> = frames.iter().copied().filter(|frame| !known(frame)).collect();
        let reading = unknown.iter().map(|&frame| self.storage.features(self.map.id, frame));
        let read = self.runtime.block_on(futures::future::join_all(reading));
        // What could not be read is asked for once more, by who needs it.
        for (frame, stored) in unknown.into_iter().zip(read.into_iter().map(Result::ok)) {
            if let Some(stored) = stored {
                let features = seen_features((self.map.id, frame), stored);
                self.recent_features.borrow_mut().keep(frame, features);
            }
        }
    }
}

/// The features of a frame from the disk; `None` if none are kept, or they are damaged. Blocks.
pub(crate) fn stored_features(
    runtime: &Handle,
    storage: &Storage,
    map: MapId,
    frame: FrameId,
) -> Result<Option<SeenFeatures>, ArchiveError> {
    let stored =
        runtime.block_on(storage.features(map, frame)).map_err(|error| ArchiveError::of(frame, error))?;
    Ok(seen_features((map, frame), stored))
}

/// `None` if none are kept, or they are damaged.
fn seen_features((map, frame): (MapId, FrameId), stored: Option<StoredFeatures>) -> Option<SeenFeatures> {
    let StoredFeatures { features, camera } = stored?;
    match FeatureRecord::from_bytes(&features) {
        Ok(features) => {
            let intrinsics = camera.as_ref().and_then(Intrinsics::of_camera);
            let around = camera.as_ref().and_then(PanoramicOptics::of_camera);
            Some(SeenFeatures::new(Arc::new(features), intrinsics.as_ref()).all_around(around))
        }
        Err(error) => {
            tracing::error!(map, frame, %error, "a frame's features cannot be read; it is no longer compared");
            None
        }
    }
}
