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
use crate::moments::Moment;
use crate::robot_words::ContentMaker;
use crate::rtab_drive::{RtabDrive, node_name};

/// What to stream, and how.
pub(crate) struct Replay {
    pub(crate) recording: Recording,
    /// Images per second; if none, as fast as the server answers.
    pub(crate) pace_hz: Option<f64>,
    /// Sends images or words.
    pub(crate) contents: ContentMaker,
}

/// Where images are. Frame numbers are positions in the folder, on the topic or among the nodes, from 1.
pub(crate) enum Recording {
    /// With a moment for each image.
    Folder {
        images: Vec<ImageFile>,
        moments: Vec<Moment>,
    },
    Bag(Arc<Drive>),
    /// A session of RTAB-Map's.
    Database(Arc<RtabDrive>),
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
            Recording::Folder { images, moments } => {
                let numbered = (1..).zip(images.iter().zip(moments));
                for (sequence, (file, moment)) in numbered.filter(|(sequence, _)| *sequence > after_sequence)
                {
                    let bytes = tokio::fs::read(&file.path).await;
                    let image = bytes.map_err(Failure::file("read", &file.path))?;
                    let Moment { stamp_ns, odometry } = moment.clone();
                    let note = note(&file.name);
                    sending.send(Shot { sequence, stamp_ns, image, odometry, note }).await?;
                }
            }
            Recording::Bag(drive) => {
                let mut reading = Arc::clone(drive).read(after_sequence);
                while let Some(shot) = reading.next().await {
                    sending.send(shot).await?;
                }
                reading.end().await?;
            }
            Recording::Database(drive) => {
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
            Recording::Folder { images, moments: _ } => {
                at(images, sequence).map(|image| Cow::Borrowed(image.name.as_str()))
            }
            Recording::Bag(drive) => {
                drive.stamp_ns(sequence).map(|_| Cow::Owned(format!("image {sequence}")))
            }
            Recording::Database(drive) => drive.node(sequence).map(|node| Cow::Owned(node_name(node.id))),
        }
    }
}

impl Recording {
    /// Number of the last image.
    pub(crate) fn last_sequence(&self) -> u64 {
        match self {
            Recording::Folder { images, moments: _ } => images.len() as u64,
            Recording::Bag(drive) => drive.last_sequence(),
            Recording::Database(drive) => drive.last_sequence(),
        }
    }

    /// How many images are above number `after_sequence`.
    pub(crate) fn count_after(&self, after_sequence: u64) -> usize {
        match self {
            Recording::Folder { images, moments: _ } => {
                images.len().saturating_sub(usize::try_from(after_sequence).unwrap_or(images.len()))
            }
            Recording::Bag(drive) => drive.count_after(after_sequence),
            Recording::Database(drive) => drive.count_after(after_sequence),
        }
    }

    /// Stamp and note of a frame of a bag or a database, if there is one of that number.
    pub(crate) fn named(&self, sequence: u64) -> Option<(i64, String)> {
        match self {
            Recording::Folder { images: _, moments: _ } => None,
            Recording::Bag(drive) => Some((drive.stamp_ns(sequence)?, String::new())),
            Recording::Database(drive) => {
                drive.node(sequence).map(|node| (node.stamp_ns, node_name(node.id)))
            }
        }
    }

    /// Width and height of the first image of a bag or a database.
    pub(crate) fn size_px(&self) -> Option<(u32, u32)> {
        match self {
            Recording::Folder { images: _, moments: _ } => None,
            Recording::Bag(drive) => drive.size_px(),
            Recording::Database(drive) => drive.size_px(),
        }
    }

    /// Some frames of a bag or a database, by their numbers, which rise. What cannot be read is left out here, and told where all
    /// is streamed.
    pub(crate) async fn shots(&self, wanted: &[u64]) -> Vec<Shot> {
        let mut shots = Vec::new();
        let (Some(first), Some(last)) = (wanted.first(), wanted.last()) else { return shots };
        let after = first.saturating_sub(1);
        let mut take = |shot: Shot| {
            let is_last = shot.sequence >= *last;
            if wanted.contains(&shot.sequence) {
                shots.push(shot);
            }
            is_last
        };
        match self {
            Recording::Folder { images: _, moments: _ } => {}
            Recording::Bag(drive) => {
                let mut reading = Arc::clone(drive).read(after);
                while let Some(shot) = reading.next().await {
                    if take(shot) {
                        break;
                    }
                }
            }
            Recording::Database(drive) => {
                let mut reading = Arc::clone(drive).read(after);
                while let Some(shot) = reading.next().await {
                    if take(shot) {
                        break;
                    }
                }
            }
        }
        shots
    }

    fn stamp_ns(&self, sequence: u64) -> i64 {
        match self {
            Recording::Folder { images: _, moments } => {
                at(moments, sequence).map_or(0, |moment| moment.stamp_ns)
            }
            Recording::Bag(drive) => drive.stamp_ns(sequence).unwrap_or_default(),
            Recording::Database(drive) => drive.node(sequence).map_or(0, |node| node.stamp_ns),
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
        let Shot { sequence, stamp_ns, image, odometry, note } = shot;
        let content: FrameContent = self.contents.content(image).await;
        self.sent.frames += 1;
        self.sent.bytes += content.encoded_len();
        if let Some(pace) = &mut self.pace {
            pace.tick().await;
        }
        Ok(self.frames.send(FrameInput { sequence, stamp_ns, content, odometry, note }).await?)
    }
}

/// The longest note that a frame can have, in bytes.
const MOST_NOTE_BYTES: usize = 200;

/// A file's name as a frame's note; none if it does not fit into a line.
pub(crate) fn note(name: &str) -> String {
    let fits = name.len() <= MOST_NOTE_BYTES && !name.chars().any(char::is_control);
    if fits { name.to_owned() } else { String::new() }
}

/// That frames have no note, since the names of their images cannot be one.
pub(crate) fn told_of_no_notes(images: &[ImageFile]) -> Option<String> {
    let unfit = images.iter().filter(|image| note(&image.name).is_empty()).count();
    (unfit > 0).then(|| {
        format!(
            "{unfit} images have names of more than {MOST_NOTE_BYTES} bytes, or with line breaks: their frames have no note \
             and are found by their numbers alone"
        )
    })
}

/// The element that belongs to frame `sequence`.
fn at<T>(things: &[T], sequence: u64) -> Option<&T> {
    things.get(usize::try_from(sequence.checked_sub(1)?).ok()?)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::moments::even;

    #[test]
    fn images_are_named_by_their_files() {
        let image =
            |name: &str| ImageFile { name: name.to_owned(), path: PathBuf::from(name), stamp_ns: None };
        let images = vec![image("a.jpg"), image("b.jpg")];
        let recording = Recording::Folder { moments: even(images.len(), 1.0), images };
        assert_eq!(
            (recording.last_sequence(), recording.count_after(1), recording.count_after(9)),
            (2, 1, 0)
        );
        let replay = Replay { recording, pace_hz: None, contents: ContentMaker::Images };
        assert_eq!((replay.image_name(1).as_deref(), replay.image_name(3)), (Some("a.jpg"), None));
    }

    #[test]
    fn a_name_that_is_no_line_is_no_note() {
        assert_eq!(note("000147.jpg"), "000147.jpg");
        assert_eq!(note("two\nlines.jpg"), "");
        assert_eq!(note(&"x".repeat(MOST_NOTE_BYTES + 1)), "");
        let image = |name: String| ImageFile { path: PathBuf::from(&name), name, stamp_ns: None };
        let [short, long] = [1, MOST_NOTE_BYTES + 1].map(|length| image("x".repeat(length)));
        assert_eq!(told_of_no_notes(std::slice::from_ref(&short)), None);
        assert!(told_of_no_notes(&[short, long]).unwrap().starts_with("1 images have names"));
    }
}
