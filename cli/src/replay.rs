//! Streams recorded images as a robot would.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Duration;

use tokio::time::{Interval, MissedTickBehavior, interval};
use waypost_client::{FrameContent, FrameInput, FrameOutcome, FrameSender, Outcomes, Session};

use crate::drive::{Drive, Shot};
use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::images::ImageFile;
use crate::odometry::StampedPose;
use crate::robot_words::ContentMaker;

/// What to stream, and how.
pub(crate) struct Replay {
    pub(crate) recording: Recording,
    /// Images per second; if none, as fast as the server answers.
    pub(crate) pace_hz: Option<f64>,
    /// Sends images or words.
    pub(crate) contents: ContentMaker,
}

/// Where images are. Frame numbers are positions in the folder or on the topic, from 1.
pub(crate) enum Recording {
    Folder { images: Vec<ImageFile>, stamps: Stamps },
    Bag(Arc<Drive>),
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

    async fn send(&self, frames: FrameSender, after_sequence: u64) -> Result<Sent, Failure> {
        let mut pace = self.pace_hz.map(|rate_hz| interval(Duration::from_secs_f64(1.0 / rate_hz)));
        if let Some(pace) = &mut pace {
            pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut sending = Sending { frames, pace, contents: &self.contents, sent: Sent::default() };
        match &self.recording {
            Recording::Folder { images, stamps } => {
                let numbered = (1..).zip(images).filter(|(sequence, _)| *sequence > after_sequence);
                for (sequence, image) in numbered {
                    let bytes = tokio::fs::read(&image.path).await;
                    let image = bytes.map_err(Failure::file("read", &image.path))?;
                    sending.send(stamps.shot(sequence, image)).await?;
                }
            }
            Recording::Bag(drive) => {
                let mut reading = Arc::clone(drive).read(after_sequence);
                while let Some(shot) = reading.next().await {
                    sending.send(shot).await?;
                }
                reading.end().await?;
            }
        }
        Ok(sending.sent)
    }

    async fn receive(
        &self,
        mut outcomes: Outcomes,
        mut on_row: impl FnMut(FrameRow) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        while let Some(outcome) = outcomes.next().await? {
            let sequence = outcome.sequence();
            let image = self.image_name(sequence).unwrap_or_default();
            let stamp_ns = self.recording.stamp_ns(sequence);
            on_row(match outcome {
                FrameOutcome::Answer(answer) => FrameRow::answered(&image, stamp_ns, answer),
                FrameOutcome::Refusal(refusal) => FrameRow::refused(&image, stamp_ns, refusal),
            })?;
        }
        Ok(())
    }

    /// Name of the image that was frame `sequence`.
    pub(crate) fn image_name(&self, sequence: u64) -> Option<Cow<'_, str>> {
        match &self.recording {
            Recording::Folder { images, stamps: _ } => {
                at(images, sequence).map(|image| Cow::Borrowed(image.name.as_str()))
            }
            Recording::Bag(drive) => {
                drive.stamp_ns(sequence).map(|_| Cow::Owned(format!("image {sequence}")))
            }
        }
    }
}

impl Recording {
    /// Number of the last image.
    pub(crate) fn last_sequence(&self) -> u64 {
        match self {
            Recording::Folder { images, stamps: _ } => images.len() as u64,
            Recording::Bag(drive) => drive.last_sequence(),
        }
    }

    /// How many images are above number `after_sequence`.
    pub(crate) fn count_after(&self, after_sequence: u64) -> usize {
        match self {
            Recording::Folder { images, stamps: _ } => {
                images.len().saturating_sub(usize::try_from(after_sequence).unwrap_or(images.len()))
            }
            Recording::Bag(drive) => drive.count_after(after_sequence),
        }
    }

    fn stamp_ns(&self, sequence: u64) -> i64 {
        match self {
            Recording::Folder { images: _, stamps } => stamps.stamp_ns(sequence),
            Recording::Bag(drive) => drive.stamp_ns(sequence).unwrap_or_default(),
        }
    }
}

impl Stamps {
    fn shot(&self, sequence: u64, image: Vec<u8>) -> Shot {
        let odometry = self.pose(sequence).map(|pose| pose.odometry.clone());
        Shot { sequence, stamp_ns: self.stamp_ns(sequence), image, odometry }
    }

    fn pose(&self, sequence: u64) -> Option<&StampedPose> {
        match self {
            Stamps::Odometry(poses) => at(poses, sequence),
            Stamps::Even { .. } => None,
        }
    }

    fn stamp_ns(&self, sequence: u64) -> i64 {
        match self {
            Stamps::Odometry(_) => self.pose(sequence).map_or(0, |pose| pose.stamp_ns),
            // From above 0, which means no stamp.
            Stamps::Even { rate_hz } => (sequence as f64 * 1e9 / rate_hz).round() as i64,
        }
    }
}

/// Frames on their way to the server.
struct Sending<'a> {
    frames: FrameSender,
    pace: Option<Interval>,
    contents: &'a ContentMaker,
    sent: Sent,
}

impl Sending<'_> {
    async fn send(&mut self, shot: Shot) -> Result<(), Failure> {
        let Shot { sequence, stamp_ns, image, odometry } = shot;
        let content: FrameContent = self.contents.content(image).await;
        self.sent.frames += 1;
        self.sent.bytes += content.encoded_len();
        if let Some(pace) = &mut self.pace {
            pace.tick().await;
        }
        Ok(self.frames.send(FrameInput { sequence, stamp_ns, content, odometry }).await?)
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

    #[test]
    fn made_up_stamps_rise_by_the_rate() {
        let stamps = Stamps::Even { rate_hz: 4.0 };
        assert_eq!(
            [1, 2, 3].map(|sequence| stamps.stamp_ns(sequence)),
            [250_000_000, 500_000_000, 750_000_000]
        );
        assert_eq!(stamps.shot(2, vec![7]).odometry, None);
    }

    #[test]
    fn frames_take_stamp_and_pose_of_their_row() {
        let poses = odometry::parse("stamp_ns,x_m,y_m,yaw_rad\n100,1,0,0\n230,2,0,0\n").unwrap();
        let shot = Stamps::Odometry(poses).shot(2, vec![7]);
        assert_eq!((shot.sequence, shot.stamp_ns), (2, 230));
        let position_m = shot.odometry.unwrap().pose.unwrap().position_m.unwrap();
        assert_eq!(position_m.x.to_bits(), 2.0_f64.to_bits());
    }

    #[test]
    fn images_are_named_by_their_files() {
        let image = |name: &str| ImageFile { name: name.to_owned(), path: PathBuf::from(name) };
        let images = vec![image("a.jpg"), image("b.jpg")];
        let recording = Recording::Folder { images, stamps: Stamps::Even { rate_hz: 1.0 } };
        assert_eq!(
            (recording.last_sequence(), recording.count_after(1), recording.count_after(9)),
            (2, 1, 0)
        );
        let replay = Replay { recording, pace_hz: None, contents: ContentMaker::Images };
        assert_eq!((replay.image_name(1).as_deref(), replay.image_name(3)), (Some("a.jpg"), None));
    }
}
