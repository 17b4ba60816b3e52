//! Frames are turned into words, as far as quotas let them.

use std::time::Instant;

use fabmap::observation::Observation;
use topomap::mapper::{FrameInput, Localizer};

use super::{Frame, ReceivedFrame, RefusedFrame, SessionStream};
use crate::error::ServiceError;
use crate::ingest::content::Content;
use crate::ingest::observed::Observed;
use crate::metrics::FrameTimings;
use crate::open_map::{FrameSource, FrameWork};
use crate::quotas::Quotas;
use crate::storage::kept_bytes;

/// What a frame's event takes in the log beside its words, at most: a decision, the belief, candidates.
const EVENT_BYTES: u64 = 8 << 10;

/// The same for each of its words: which, and how often.
const WORD_BYTES: u64 = 8;

/// A frame in words, on its way to the map's writer.
pub(super) struct PreparedFrame {
    pub(super) sequence: u64,
    pub(super) work: Result<FrameWork, ServiceError>,
    pub(super) since: Instant,
}

impl SessionStream {
    /// Turns a frame into words. Frames may be prepared side by side.
    pub(super) async fn prepare(&self, frame: ReceivedFrame) -> PreparedFrame {
        let since = Instant::now();
        match frame {
            Ok(frame) => {
                let sequence = frame.sequence;
                PreparedFrame { sequence, work: self.work(frame).await, since }
            }
            Err(RefusedFrame { sequence, error }) => PreparedFrame { sequence, work: Err(error), since },
        }
    }

    async fn work(&self, frame: Frame) -> Result<FrameWork, ServiceError> {
        frame.check()?;
        let Frame { sequence, stamp_ns, content, odometry, note } = frame;
        {
            let mut order = self.order();
            if order.last_committed.is_some_and(|last| sequence <= last) {
                return Ok(FrameWork::Resend { sequence });
            }
            // Not worth looking at: it would be refused after the work.
            if let Some(resend_from) = order.comes_before_its_turn(sequence) {
                return Err(order.send_first(resend_from));
            }
        }
        // What was described before was taken by whatever camera there was.
        let checked_by = self.intrinsics.filter(|_| !matches!(content, Content::Described(_)));
        let observed = self.observe(content).await?;
        let Observed { observation, features, media, extract, quantize } = observed;
        if let (Some(camera), Some(features)) = (checked_by, &features) {
            camera.check(features.image_size_px())?;
        }
        let session = match self.source {
            FrameSource::Session(session) => session,
            FrameSource::Localizer(_) => Localizer::SESSION,
        };
        let input = FrameInput { session, sequence, stamp_ns, odometry, observation };
        let timings = FrameTimings { extract, quantize, ..FrameTimings::default() };
        let room = match self.source {
            FrameSource::Session(_) => {
                let bytes = kept_bytes(&media) + most_event_bytes(&input.observation);
                Some(Box::new(self.quotas().reserve(self.owner.as_deref(), bytes)?))
            }
            FrameSource::Localizer(_) => None,
        };
        Ok(FrameWork::Fresh { input: Box::new(input), features, media, note, timings, room })
    }

    /// Looks at what a frame shows, if quotas let it.
    async fn observe(&self, content: Content) -> Result<Observed, ServiceError> {
        if matches!(self.source, FrameSource::Session(_)) {
            self.quotas().check_room(self.owner.as_deref())?;
        }
        let stream = self.in_line;
        let turn = self.quotas().frame(self.token.as_deref(), stream, Instant::now())?;
        let model = self.model.clone();
        let observing = self.sessions.extraction.observe(
            model,
            content,
            self.words,
            self.keep,
            self.optics.clone(),
            stream,
        );
        let observed = observing.await;
        // One that comes again because there were too many was not looked at.
        if !matches!(observed, Err(ServiceError::Unavailable { .. })) {
            turn.spend();
        }
        observed
    }

    fn quotas(&self) -> &Quotas {
        self.sessions.storage.quotas()
    }
}

/// What a frame's event will take in the log, at most: it is not decided yet.
fn most_event_bytes(observation: &Observation) -> u64 {
    EVENT_BYTES + WORD_BYTES * observation.len() as u64
}
