//! Frames, and their outcomes.

use prost::Message;
use waypost_proto::v1;

/// One frame of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameInput {
    /// Rises within the session; gaps are allowed. For a number up to the last committed one the
    /// server returns the stored answer.
    pub sequence: u64,
    /// When the image was taken, by the robot's monotonic clock, in nanoseconds.
    pub stamp_ns: i64,
    /// The image, or its words.
    pub content: FrameContent,
    /// Pose of `base_link` in the session's `odom` frame at that time.
    pub odometry: Option<v1::Odometry>,
    /// What the robot calls the frame, as by the name of its file: at most 200 bytes, without control
    /// characters; empty if nothing. Told back wherever the frame is named.
    pub note: String,
}

impl FrameInput {
    /// A frame without odometry and without a note.
    pub fn new(sequence: u64, stamp_ns: i64, content: FrameContent) -> Self {
        FrameInput { sequence, stamp_ns, content, odometry: None, note: String::new() }
    }
}

/// The image of a frame, or its words.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameContent {
    /// A JPEG or PNG of at most [`MAX_IMAGE_BYTES`](crate::MAX_IMAGE_BYTES); a longer one is
    /// refused without being sent.
    Image(Vec<u8>),
    /// How often each word was seen: the fewest bytes.
    Histogram(v1::WordHistogram),
    /// The word and the position of each feature: enough for verification by geometry.
    Words(v1::WordList),
}

impl FrameContent {
    /// Its length on the wire, in bytes.
    pub fn encoded_len(&self) -> usize {
        match self {
            FrameContent::Image(image) => image.len(),
            FrameContent::Histogram(histogram) => histogram.encoded_len(),
            FrameContent::Words(words) => words.encoded_len(),
        }
    }
}

impl From<FrameInput> for v1::Frame {
    fn from(FrameInput { sequence, stamp_ns, content, odometry, note }: FrameInput) -> Self {
        let content = match content {
            FrameContent::Image(image) => v1::frame::Content::Image(image),
            FrameContent::Histogram(histogram) => v1::frame::Content::Histogram(histogram),
            FrameContent::Words(words) => v1::frame::Content::Words(words),
        };
        v1::Frame { sequence, stamp_ns, odometry, content: Some(content), note }
    }
}

/// The outcome of a frame.
#[expect(clippy::large_enum_variant, reason = "one at a time: a box would cost every frame an allocation")]
#[derive(Clone, Debug, PartialEq)]
pub enum FrameOutcome {
    /// It is durable, and this is the decision.
    Answer(v1::FrameAnswer),
    /// It was refused; the status says why, and how to correct it.
    Refusal(v1::FrameRefusal),
}

impl FrameOutcome {
    /// Number of the frame.
    pub fn sequence(&self) -> u64 {
        match self {
            FrameOutcome::Answer(answer) => answer.sequence,
            FrameOutcome::Refusal(refusal) => refusal.sequence,
        }
    }
}
