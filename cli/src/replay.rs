//! Streams recorded images as a robot would.

use std::time::Duration;

use tokio::time::{MissedTickBehavior, interval};
use waypost_client::{FrameContent, FrameInput, FrameOutcome, FrameSender, Outcomes, Session};

use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::images::ImageFile;
use crate::odometry::StampedPose;
use crate::robot_words::ContentMaker;

/// What to stream. Frame numbers are positions in the folder, from 1.
pub(crate) struct Replay {
    pub(crate) images: Vec<ImageFile>,
    pub(crate) stamps: Stamps,
    /// Images per second; if none, as fast as the server answers.
    pub(crate) pace_hz: Option<f64>,
    /// Sends images or words.
    pub(crate) contents: ContentMaker,
}

/// When the images were taken.
pub(crate) enum Stamps {
    /// Recorded, one for each image.
    Odometry(Vec<StampedPose>),
    /// Generated.
    Even { rate_hz: f64 },
}

/// What was sent.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sent {
    pub(crate) frames: usize,
    /// Of images or words, without the rest of the messages.
    pub(crate) bytes: usize,
}

impl Sent {
    pub(crate) fn bytes_per_frame(self) -> Option<f64> {
        (self.frames > 0).then(|| self.bytes as f64 / self.frames as f64)
    }
}

impl Replay {
    /// Streams the frames above number `last_done`, and passes a row to `on_row` for each outcome.
    pub(crate) async fn stream(
        &self,
        session: Session,
        after_sequence: u64,
        on_row: impl FnMut(FrameRow) -> Result<(), Failure>,
    ) -> Result<Sent, Failure> {
        let (frames, outcomes) = session.split();
        let receiving = self.receive(outcomes, on_row);
        let (sent, received) = tokio::join!(self.send(frames, after_sequence), receiving);
        // If the session ended, the outcomes have the reason; sending only fails.
        received.and(sent)
    }

    async fn send(&self, mut frames: FrameSender, after_sequence: u64) -> Result<Sent, Failure> {
        let mut sent = Sent::default();
        let mut pace = self.pace_hz.map(|rate_hz| interval(Duration::from_secs_f64(1.0 / rate_hz)));
        if let Some(pace) = &mut pace {
            pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        for (sequence, image) in (1..).zip(&self.images).filter(|(sequence, _)| *sequence > after_sequence) {
            let bytes = tokio::fs::read(&image.path).await.map_err(Failure::file("read", &image.path))?;
            let content = self.contents.content(bytes).await;
            sent.frames += 1;
            sent.bytes += content.encoded_len();
            if let Some(pace) = &mut pace {
                pace.tick().await;
            }
            frames.send(self.frame(sequence, content)).await?;
        }
        Ok(sent)
    }

    async fn receive(
        &self,
        mut outcomes: Outcomes,
        mut on_row: impl FnMut(FrameRow) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        while let Some(outcome) = outcomes.next().await? {
            let sequence = outcome.sequence();
            let image = self.image_name(sequence).unwrap_or_default();
            let stamp_ns = self.stamp_ns(sequence);
            on_row(match outcome {
                FrameOutcome::Answer(answer) => FrameRow::answered(image, stamp_ns, answer),
                FrameOutcome::Refusal(refusal) => FrameRow::refused(image, stamp_ns, refusal),
            })?;
        }
        Ok(())
    }

    fn frame(&self, sequence: u64, content: FrameContent) -> FrameInput {
        let odometry = self.pose(sequence).map(|pose| pose.odometry.clone());
        FrameInput { sequence, stamp_ns: self.stamp_ns(sequence), content, odometry }
    }

    /// Name of the image that was frame `sequence`.
    pub(crate) fn image_name(&self, sequence: u64) -> Option<&str> {
        at(&self.images, sequence).map(|image| image.name.as_str())
    }

    fn pose(&self, sequence: u64) -> Option<&StampedPose> {
        match &self.stamps {
            Stamps::Odometry(poses) => at(poses, sequence),
            Stamps::Even { .. } => None,
        }
    }

    fn stamp_ns(&self, sequence: u64) -> i64 {
        match &self.stamps {
            Stamps::Odometry(_) => self.pose(sequence).map_or(0, |pose| pose.stamp_ns),
            // From above 0, which means no stamp.
            Stamps::Even { rate_hz } => (sequence as f64 * 1e9 / rate_hz).round() as i64,
        }
    }
}

/// The element that belongs to frame `sequence`.
fn at<T>(things: &[T], sequence: u64) -> Option<&T> {
    things.get(usize::try_from(sequence.checked_sub(1)?).ok()?)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::odometry;

    fn replay(stamps: Stamps) -> Replay {
        let image = |name: &str| ImageFile { name: name.to_owned(), path: PathBuf::from(name) };
        Replay {
            images: vec![image("a.jpg"), image("b.jpg")],
            stamps,
            pace_hz: None,
            contents: ContentMaker::Images,
        }
    }

    #[test]
    fn made_up_stamps_rise_by_the_rate() {
        let replay = replay(Stamps::Even { rate_hz: 4.0 });
        assert_eq!(
            [1, 2, 3].map(|sequence| replay.stamp_ns(sequence)),
            [250_000_000, 500_000_000, 750_000_000]
        );
        assert_eq!(replay.frame(2, FrameContent::Image(vec![7])).odometry, None);
    }

    #[test]
    fn frames_take_stamp_and_pose_of_their_row() {
        let poses = odometry::parse("stamp_ns,x_m,y_m,yaw_rad\n100,1,0,0\n230,2,0,0\n").unwrap();
        let replay = replay(Stamps::Odometry(poses));
        let frame = replay.frame(2, FrameContent::Image(vec![7]));
        assert_eq!((frame.sequence, frame.stamp_ns), (2, 230));
        let position_m = frame.odometry.unwrap().pose.unwrap().position_m.unwrap();
        assert_eq!(position_m.x.to_bits(), 2.0_f64.to_bits());
        assert_eq!((replay.image_name(1), replay.image_name(3)), (Some("a.jpg"), None));
    }
}
