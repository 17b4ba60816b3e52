//! A robot's frames come in and the map grows, in process, through what the server calls.

use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use fabmap::model::Model;
use posegraph::PlanarPose;
use topomap::ids::SessionId;
use topomap::in_memory;
use topomap::log::{LinkKind, MapEvent};
use topomap::mapper::{Decided, FrameInput, Mapper};
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Extractor;
use waypost_vision::structure::Tracker;
use waypost_vision::verification::Verifier;

use super::drive::{DrivenFrame, sent_odometry};
use crate::error::{fault, refused};
use crate::event_log::EventLog;
use crate::observing::{CurrentView, Observed};
use crate::timing::{FrameWatch, StageTimes};

/// A map with all that was decided on the way to it.
#[derive(Debug)]
pub(crate) struct Mapped {
    /// As it was after the last frame.
    pub mapper: Mapper,
    /// What was decided.
    pub log: EventLog,
    /// Where the map put the robot, after each frame.
    pub robot: Vec<Option<PlanarPose>>,
    /// What each frame took, from pixels to the map that has it.
    pub times: Vec<StageTimes>,
    /// Of each frame.
    pub features: Vec<Arc<FeatureRecord>>,
    /// What relaxation took at each frame that closed a loop, in milliseconds.
    pub relax_ms: Vec<f64>,
}

const SESSION: SessionId = 0;

/// Maps what a robot saw, frame by frame, on the calling thread's pool.
pub(crate) fn map(
    frames: &[DrivenFrame],
    model: &Model,
    extractor: Extractor,
    settings: MapperSettings,
) -> Result<Mapped> {
    let mut mapper = Mapper::new(model, settings).map_err(refused)?;
    let opened = MapEvent::SessionOpened { session: SESSION };
    mapper.apply(&opened).map_err(fault)?;
    let mut mapped = Mapped {
        mapper,
        log: EventLog(vec![opened]),
        robot: Vec::new(),
        times: Vec::new(),
        features: Vec::with_capacity(frames.len()),
        relax_ms: Vec::new(),
    };
    let mut tracker = Tracker::new(settings.odometry_noise);
    for (index, frame) in frames.iter().enumerate() {
        mapped
            .add(index, frame, (model, extractor), &mut tracker)
            .with_context(|| format!("frame {index}"))?;
    }
    Ok(mapped)
}

impl Mapped {
    fn add(
        &mut self,
        index: usize,
        frame: &DrivenFrame,
        (model, extractor): (&Model, Extractor),
        tracker: &mut Tracker,
    ) -> Result<()> {
        let mut watch = FrameWatch::start();
        let Observed { observation, features } =
            Observed::in_image(&frame.image, model, extractor, &mut watch)?;
        let odometry = sent_odometry(&frame.odometry)?;
        let features = tracker.track(Arc::new(features), Some(&frame.camera), Some(&odometry));
        watch.tracked();
        let views = CurrentView {
            current: &features,
            log: &self.log,
            earlier: &self.features,
            verifier: Verifier::new(self.mapper.settings().verification, 0),
            camera: Some(frame.camera),
        };
        let input = FrameInput {
            session: SESSION,
            sequence: index as u64,
            stamp_ns: frame.stamp_ns,
            odometry: Some(odometry),
            observation,
        };
        let Decided { event, .. } = in_memory::decide(&self.mapper, &self.log.0, input, &views, &mut watch)?;
        let closes_a_loop = event.link.is_some_and(|link| matches!(link.kind, LinkKind::Closed(_)));
        let event = MapEvent::Frame(Box::new(event));
        // The two halves of `Mapper::apply`.
        self.mapper.fold(&event).map_err(fault)?;
        let folded = Instant::now();
        self.mapper.relax();
        if closes_a_loop {
            self.relax_ms.push(folded.elapsed().as_secs_f64() * 1e3);
        }
        self.times.push(watch.stop());
        self.log.0.push(event);
        self.features.push(features);
        let session = self.mapper.map().session(SESSION);
        self.robot.push(session.and_then(|session| self.mapper.map_pose(session)).map(|pose| pose.robot));
        Ok(())
    }
}
