//! A robot's frames come in and the map grows, in process, through what the server calls.

use std::time::Instant;

use fabmap::model::Model;
use fabmap::observation::Observation;
use topomap::event::{FrameEvent, FrameId, LinkKind, MapEvent, SessionId};
use topomap::mapper::{ArchiveError, Decided, FrameInput, Mapper, MapperSettings};
use topomap::relaxation::PlanarPose;
use topomap::verification::{TwoView, Views};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};
use waypost_vision::image::GreyImage;
use waypost_vision::verification::{Pinhole, Verifier, View};

use super::MapError;
use super::drive::{DrivenFrame, FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX};
use crate::error::EvalError;
use crate::event_log::EventLog;
use crate::timing::{FrameTimes, FrameWatch};

/// A map with all that was decided on the way to it.
#[derive(Debug)]
pub struct Mapped {
    /// As it was after the last frame.
    pub mapper: Mapper,
    /// What was decided.
    pub log: EventLog,
    /// Where the map put the robot, after each frame.
    pub robot: Vec<Option<PlanarPose>>,
    /// What each frame took, from pixels to the map that has it.
    pub times: Vec<FrameTimes>,
    /// Of each frame.
    pub features: Vec<FeatureRecord>,
    /// What relaxation took at each frame that closed a loop, in milliseconds.
    pub relax_ms: Vec<f64>,
}

/// The frame that is being decided, beside all before it.
pub(crate) struct CurrentView<'a> {
    pub(crate) current: &'a FeatureRecord,
    pub(crate) log: &'a EventLog,
    pub(crate) earlier: &'a [FeatureRecord],
    pub(crate) verifier: Verifier,
    pub(crate) camera: Pinhole,
}

const SESSION: SessionId = 0;

/// Maps what a robot saw, frame by frame, on the calling thread's pool.
///
/// # Errors
/// [`EvalError`] if a frame is refused.
pub fn map(
    frames: &[DrivenFrame],
    model: &Model,
    extractor: Extractor,
    settings: MapperSettings,
) -> Result<Mapped, EvalError> {
    let verifier = Verifier::new(settings.verification, 0);
    let camera = camera();
    let mut mapper = Mapper::new(model, settings)?;
    let opened = MapEvent::SessionOpened { session: SESSION };
    mapper.apply(&opened).map_err(|reason| EvalError::Fold { index: 0, reason })?;
    let (mut log, mut features) = (EventLog(vec![opened]), Vec::with_capacity(frames.len()));
    let (mut robot, mut times, mut relax_ms) = (Vec::new(), Vec::new(), Vec::new());
    for (index, frame) in frames.iter().enumerate() {
        let mut watch = FrameWatch::start();
        let (observation, current) = observe(&frame.image, model, extractor, &mut watch)?;
        let views = CurrentView { current: &current, log: &log, earlier: &features, verifier, camera };
        let input = FrameInput {
            session: SESSION,
            sequence: index as u64,
            stamp_ns: frame.stamp_ns,
            odometry: Some(frame.sent_odometry().map_err(MapError::Odometry)?),
            observation,
        };
        let decided = mapper.decide(input, &log, &views, &mut watch);
        let Decided { event, .. } = decided.map_err(|reason| EvalError::Frame { index, reason })?;
        let closes = closes_a_loop(&event);
        let event = MapEvent::Frame(Box::new(event));
        // The two halves of `Mapper::apply`.
        mapper.fold(&event).map_err(|reason| EvalError::Fold { index, reason })?;
        let folded = Instant::now();
        mapper.relax();
        if closes {
            relax_ms.push(folded.elapsed().as_secs_f64() * 1e3);
        }
        times.push(watch.stop());
        log.0.push(event);
        features.push(current);
        let session = mapper.map().session(SESSION);
        robot.push(session.and_then(|session| mapper.map_pose(session)).map(|pose| pose.robot));
    }
    Ok(Mapped { mapper, log, robot, times, features, relax_ms })
}

/// The camera that all simulated robots have.
#[must_use]
pub fn camera() -> Pinhole {
    Pinhole::of_field_of_view(FIELD_OF_VIEW_RAD, IMAGE_SIZE_PX)
}

fn closes_a_loop(event: &FrameEvent) -> bool {
    event.link.is_some_and(|link| matches!(link.kind, LinkKind::Closed(_)))
}

/// From pixels to words, and what geometry needs of them.
pub(crate) fn observe(
    image: &GreyImage,
    model: &Model,
    extractor: Extractor,
    watch: &mut FrameWatch,
) -> Result<(Observation, FeatureRecord), MapError> {
    let Features { keypoints, descriptors } = extractor.extract(image).map_err(MapError::Features)?;
    watch.extracted();
    let words = model.vocabulary().words(&descriptors).map_err(MapError::Vocabulary)?;
    let observation = Observation::from_words(words.iter().copied(), model.vocabulary().len())
        .unwrap_or_else(|_| unreachable!("a vocabulary's own words"));
    watch.quantized();
    let features = FeatureRecord::new(IMAGE_SIZE_PX, keypoints, words, Some(descriptors))
        .unwrap_or_else(|_| unreachable!("a keypoint, a word and a descriptor for each feature"));
    Ok((observation, features))
}

impl Views for CurrentView<'_> {
    fn compare(&self, earlier: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let index = self.log.frame(earlier).and_then(|event| usize::try_from(event.sequence).ok());
        let Some(earlier) = index.and_then(|index| self.earlier.get(index)) else {
            return Err(ArchiveError { frame: earlier, why: "it is not in the log".to_owned() });
        };
        let view = |features| View { features, camera: Some(self.camera) };
        Ok(Some(self.verifier.compare(view(earlier), view(self.current))))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(self.camera.focal_length_widths(IMAGE_SIZE_PX.0))
    }
}
