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
use topomap::metric::Odometry;
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Extractor;
use waypost_vision::image::GreyImage;
use waypost_vision::structure::{RobotCamera, Tracker};
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

/// A frame as it comes to the map.
#[derive(Clone, Debug)]
pub(crate) struct SeenFrame<'a> {
    /// Nanoseconds since the start.
    pub stamp_ns: i64,
    /// What the wheels said, if they did.
    pub odometry: Option<Odometry>,
    /// What the robot saw.
    pub image: &'a GreyImage,
    /// By which camera; `None` if nothing is known of it.
    pub camera: Option<RobotCamera>,
}

/// Maps what a robot saw in one session, frame by frame, on the calling thread's pool.
pub(crate) fn map(
    frames: &[DrivenFrame],
    model: &Model,
    extractor: Extractor,
    settings: MapperSettings,
) -> Result<Mapped> {
    let mut mapping = Mapping::new(model, extractor, settings)?;
    mapping.open_session()?;
    for frame in frames {
        let DrivenFrame { stamp_ns, truth: _, odometry, image, camera } = frame;
        let odometry = Some(sent_odometry(odometry)?);
        mapping.add(&SeenFrame { stamp_ns: *stamp_ns, odometry, image, camera: Some(*camera) })?;
    }
    Ok(mapping.mapped)
}

/// A map that grows, session after session.
pub(crate) struct Mapping<'a> {
    /// So far.
    pub mapped: Mapped,
    model: &'a Model,
    extractor: Extractor,
    /// Of the session that is open.
    tracker: Tracker,
    sessions: SessionId,
}

impl<'a> Mapping<'a> {
    /// An empty map without a session.
    pub(crate) fn new(model: &'a Model, extractor: Extractor, settings: MapperSettings) -> Result<Self> {
        let mapped = Mapped {
            mapper: Mapper::new(model, settings).map_err(refused)?,
            log: EventLog::default(),
            robot: Vec::new(),
            times: Vec::new(),
            features: Vec::new(),
            relax_ms: Vec::new(),
        };
        Ok(Self { mapped, model, extractor, tracker: Tracker::new(settings.odometry_noise), sessions: 0 })
    }

    /// Opens the next session; frames belong to it from now on.
    pub(crate) fn open_session(&mut self) -> Result<()> {
        let opened = MapEvent::SessionOpened { session: self.sessions };
        self.mapped.mapper.apply(&opened).map_err(fault)?;
        self.mapped.log.0.push(opened);
        self.tracker = Tracker::new(self.mapped.mapper.settings().odometry_noise);
        self.sessions += 1;
        Ok(())
    }

    /// Decides a frame of the open session, and maps it.
    pub(crate) fn add(&mut self, frame: &SeenFrame<'_>) -> Result<()> {
        let index = self.mapped.features.len();
        self.added(index, frame).with_context(|| format!("frame {index}"))
    }

    fn added(&mut self, index: usize, frame: &SeenFrame<'_>) -> Result<()> {
        let session = self.sessions.saturating_sub(1);
        let mut watch = FrameWatch::start();
        let Observed { observation, features } =
            Observed::in_image(frame.image, self.model, self.extractor, &mut watch)?;
        let features = self.tracker.track(Arc::new(features), frame.camera.as_ref(), frame.odometry.as_ref());
        watch.tracked();
        let Mapped { mapper, log, robot, times, features: earlier, relax_ms } = &mut self.mapped;
        let views = CurrentView {
            current: &features,
            log,
            earlier,
            verifier: Verifier::new(mapper.settings().verification, 0),
            camera: frame.camera,
        };
        let input = FrameInput {
            session,
            sequence: index as u64,
            stamp_ns: frame.stamp_ns,
            odometry: frame.odometry.clone(),
            observation,
        };
        let Decided { event, .. } = in_memory::decide(mapper, &log.0, input, &views, &mut watch)?;
        let closes_a_loop = event.link.is_some_and(|link| matches!(link.kind, LinkKind::Closed(_)));
        let event = MapEvent::Frame(Box::new(event));
        // The two halves of `Mapper::apply`.
        mapper.fold(&event).map_err(fault)?;
        let folded = Instant::now();
        mapper.relax();
        if closes_a_loop {
            relax_ms.push(folded.elapsed().as_secs_f64() * 1e3);
        }
        times.push(watch.stop());
        log.0.push(event);
        earlier.push(features);
        let open = mapper.map().session(session);
        robot.push(open.and_then(|session| mapper.map_pose(session)).map(|pose| pose.robot));
        Ok(())
    }
}
