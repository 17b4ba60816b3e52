//! Maps of simulated drives, with all that merging and judging them takes.

use std::sync::Arc;

use fabmap::model::Model;
use rayon::prelude::*;
use topomap::event::{FrameId, MapEvent};
use topomap::mapper::{ArchiveError, Mapper, MapperSettings};
use topomap::merging::{KnownMap, Layout, ViewsBetween};
use topomap::relaxation::{PlanarPose, Pose};
use topomap::verification::TwoView;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Extractor;
use waypost_vision::verification::{Verifier, View};

use crate::commands::map::drive::{DrivenFrame, IMAGE_SIZE_PX};
use crate::commands::map::mapping::{self, Mapped};
use crate::error::EvalError;
use crate::event_log::EventLog;

/// A map with its log, and of each event what was true.
#[derive(Clone, Debug)]
pub(super) struct TrueMap {
    /// The map.
    pub mapper: Mapper,
    /// Its log.
    pub log: EventLog,
    /// Of each event that is a frame.
    pub frames: Vec<Option<TrueFrame>>,
}

/// What was true of a frame.
#[derive(Clone, Debug)]
pub(super) struct TrueFrame {
    /// Where the robot was.
    pub pose: PlanarPose,
    /// What it saw.
    pub features: Arc<FeatureRecord>,
    /// Which of the drives it is of.
    pub drive: usize,
}

impl TrueMap {
    /// Maps a drive.
    ///
    /// # Errors
    /// [`EvalError`] if a frame is refused.
    pub(super) fn of(
        drive: usize,
        frames: &[DrivenFrame],
        model: &Model,
        extractor: Extractor,
        settings: MapperSettings,
    ) -> Result<Self, EvalError> {
        let Mapped { mapper, log, features, .. } = mapping::map(frames, model, extractor, settings)?;
        let truths = frames.iter().zip(features);
        let truths = truths.map(|(frame, features)| {
            Some(TrueFrame { pose: frame.truth, features: Arc::new(features), drive })
        });
        // The first event opened the session.
        Ok(Self { mapper, log, frames: std::iter::once(None).chain(truths).collect() })
    }

    /// As merging knows it.
    #[must_use]
    pub(super) fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, archive: &self.log }
    }

    /// Where its places are.
    #[must_use]
    pub(super) fn layout(&self) -> Layout<'_> {
        let settings = self.mapper.settings();
        Layout { poses: self.mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
    }

    /// Takes in what another map's log has become.
    ///
    /// # Errors
    /// [`EvalError::Fold`] if the events are not the next ones.
    pub(super) fn take(&mut self, other: &TrueMap, events: Vec<MapEvent>) -> Result<(), EvalError> {
        for (index, event) in events.iter().enumerate() {
            self.mapper.fold(event).map_err(|reason| EvalError::Fold { index, reason })?;
        }
        self.mapper.relax();
        self.log.0.extend(events);
        self.frames.extend(other.frames.iter().cloned());
        Ok(())
    }

    /// What was true of a frame.
    #[must_use]
    pub(super) fn frame(&self, frame: FrameId) -> Option<&TrueFrame> {
        self.frames.get(usize::try_from(frame).ok()?)?.as_ref()
    }

    /// Where the frames that made places truly were.
    #[must_use]
    pub(super) fn makers(&self) -> Vec<PlanarPose> {
        let places = self.mapper.map().places().iter();
        places.filter_map(|place| Some(self.frame(place.frames.first()?.frame)?.pose)).collect()
    }

    /// Where the map puts the robots at all frames at places of its first part, and where they were.
    #[must_use]
    pub(super) fn trajectory(&self) -> (Vec<PlanarPose>, Vec<PlanarPose>) {
        let poses = self.mapper.poses();
        let frames = self.log.frames().filter_map(|event| {
            let place = event.decision.place.filter(|&place| poses.part(place) == Some(0))?;
            let at = poses.pose(place)?.compose(event.at?.pose());
            Some((at, self.frame(event.frame)?.pose))
        });
        frames.unzip()
    }
}

/// Frames of two maps, side by side.
pub(super) struct Between<'a> {
    /// The map that joins.
    pub source: &'a TrueMap,
    /// The map that it joins.
    pub target: &'a TrueMap,
    /// Compares.
    pub verifier: Verifier,
}

impl ViewsBetween for Between<'_> {
    fn compare(&self, source: FrameId, target: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let missing = |frame| ArchiveError { frame, why: "it is not in the log".to_owned() };
        let current = self.source.frame(source).ok_or_else(|| missing(source))?;
        let earlier = self.target.frame(target).ok_or_else(|| missing(target))?;
        let [earlier, current] = [earlier, current]
            .map(|frame| View { features: &frame.features, camera: Some(mapping::camera()) });
        Ok(Some(self.verifier.compare(earlier, current)))
    }

    fn focal_length_widths(&self, _source: FrameId) -> Option<f64> {
        Some(mapping::camera().focal_length_widths(IMAGE_SIZE_PX.0))
    }
}

/// Maps several drives side by side.
///
/// # Errors
/// [`EvalError`] if a frame is refused.
pub(super) fn map_all(
    sessions: &[Vec<DrivenFrame>],
    model: &Model,
    extractor: Extractor,
    settings: MapperSettings,
) -> Result<Vec<TrueMap>, EvalError> {
    let map =
        |(drive, frames): (usize, &Vec<DrivenFrame>)| TrueMap::of(drive, frames, model, extractor, settings);
    sessions.par_iter().enumerate().map(map).collect()
}
