//! Maps of simulated drives, with all that merging and judging them takes.

use std::sync::Arc;

use anyhow::Result;
use fabmap::model::Model;
use posegraph::{PlanarPose, Pose};
use rayon::prelude::*;
use topomap::ids::FrameId;
use topomap::log::MapEvent;
use topomap::mapper::Mapper;
use topomap::merging::{KnownMap, PairComparison, PlacePair};
use topomap::settings::MapperSettings;
use waypost_sim::drive::IMAGE_SIZE_PX;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Extractor;
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::{Verifier, View};

use crate::commands::map::drive::DrivenFrame;
use crate::commands::map::mapping::{self, Mapped};
use crate::event_log::{EventLog, fold_all};

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
    /// By which camera.
    pub camera: RobotCamera,
    /// Which of the drives it is of.
    pub drive: usize,
}

impl TrueMap {
    /// Maps a drive.
    pub(super) fn of(
        drive: usize,
        frames: &[DrivenFrame],
        model: &Model,
        extractor: Extractor,
        settings: MapperSettings,
    ) -> Result<Self> {
        let Mapped { mapper, log, features, .. } = mapping::map(frames, model, extractor, settings)?;
        let truths = frames.iter().zip(features);
        let truths = truths.map(|(frame, features)| {
            Some(TrueFrame { pose: frame.truth, features, camera: frame.camera, drive })
        });
        // The first event opened the session.
        Ok(Self { mapper, log, frames: std::iter::once(None).chain(truths).collect() })
    }

    /// As merging knows it.
    pub(super) fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, log: &self.log.0 }
    }

    /// Takes in what another map's log has become.
    pub(super) fn take(&mut self, other: &TrueMap, events: Vec<MapEvent>) -> Result<()> {
        fold_all(&mut self.mapper, &events)?;
        self.mapper.relax();
        self.log.0.extend(events);
        self.frames.extend(other.frames.iter().cloned());
        Ok(())
    }

    /// What was true of a frame.
    pub(super) fn frame(&self, frame: FrameId) -> Option<&TrueFrame> {
        self.frames.get(usize::try_from(frame).ok()?)?.as_ref()
    }

    /// Where the frames that made places truly were.
    pub(super) fn makers(&self) -> Vec<PlanarPose> {
        let places = self.mapper.map().places().iter();
        places.filter_map(|place| Some(self.frame(place.frames.first()?.frame)?.pose)).collect()
    }

    /// Where the map puts the robots at all frames at places of its first part, and where they were.
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

/// Compares the frames of a pair; none if one is not in its log.
pub(super) fn compared(
    source: &TrueMap,
    target: &TrueMap,
    pair: &PlacePair,
    verifier: &Verifier,
) -> PairComparison {
    fn view(frame: &TrueFrame) -> View<'_> {
        View { features: &frame.features, camera: Some(frame.camera) }
    }
    let current = source.frame(pair.source_frame);
    let views = target.frame(pair.target_frame).zip(current);
    PairComparison {
        view: views.map(|(earlier, current)| verifier.compare(view(earlier), view(current))),
        focal_length_widths: current.map(|frame| frame.camera.pinhole.focal_length_widths(IMAGE_SIZE_PX.0)),
    }
}

/// Maps several drives side by side.
pub(super) fn map_all(
    sessions: &[Vec<DrivenFrame>],
    model: &Model,
    extractor: Extractor,
    settings: MapperSettings,
) -> Result<Vec<TrueMap>> {
    let map =
        |(drive, frames): (usize, &Vec<DrivenFrame>)| TrueMap::of(drive, frames, model, extractor, settings);
    sessions.par_iter().enumerate().map(map).collect()
}
