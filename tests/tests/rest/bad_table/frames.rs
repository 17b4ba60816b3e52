//! Frames in a stream: each bad one is refused, and its mended self is taken under the same number.

use tonic::Code;
use waypost_client::v1;
use waypost_proto::v1::frame::Content;

use super::words::{BadWords, bad_words};
use super::{Cases, Ground};
use crate::harness::{RawStream, SECOND_NS, as_histogram, open, state_hash, wire, word_maker};

/// A stream of words, and the number of its next frame.
struct Robot<'a> {
    ground: &'a Ground,
    stream: RawStream,
    next: u64,
    cases: Cases,
}

impl<'a> Robot<'a> {
    async fn new(ground: &'a Ground, session: &'static str) -> Self {
        let words_hash = word_maker().words_hash().to_owned();
        let opening = v1::OpenSession { words_hash, ..open("drive", session) };
        let (mut stream, _) = RawStream::open(&ground.server.endpoint(), opening).await.unwrap();
        stream.answered(good(2)).await;
        Self { ground, stream, next: 3, cases: Cases::new(session) }
    }

    async fn refused(&mut self, case: &str, bad: v1::Frame, code: Code, fragment: &str) {
        let before = state_hash(&self.ground.client, "drive").await;
        let sequence = bad.sequence;
        let refusal = self.stream.refused(bad).await;
        assert_eq!(
            (refusal.sequence, refusal.last_committed_sequence),
            (sequence, Some(self.next - 1)),
            "{case}"
        );
        let status = refusal.status.expect("a refusal has a status");
        self.cases.says(case, (Code::from(status.code), &status.message), (code, fragment));
        assert_eq!(state_hash(&self.ground.client, "drive").await, before, "{case}");
        let answer = self.stream.answered(good(self.next)).await;
        assert_eq!((answer.last_committed_sequence, answer.resent), (self.next, false), "{case}");
        self.next += 1;
    }
}

/// A frame with odometry near the origin, of wheels that turn; the images of the drive come round again.
fn good(sequence: u64) -> v1::Frame {
    let shown = as_histogram(1 + sequence % 30);
    let odometry = Some(at(1e-3 * sequence as f64));
    v1::Frame { sequence, stamp_ns: SECOND_NS * sequence as i64, odometry, ..wire(shown) }
}

fn at(x: f64) -> v1::Odometry {
    v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        }),
        covariance: Vec::new(),
    }
}

pub(super) async fn bad_words_in_frames(ground: &Ground) -> Cases {
    let mut robot = Robot::new(ground, "framed-words").await;
    for BadWords { case, content, fragment } in bad_words() {
        let bad = v1::Frame { content: Some(content), ..good(robot.next) };
        robot.refused(case, bad, Code::InvalidArgument, fragment).await;
    }
    robot.cases
}

/// A matrix with one entry.
fn covariance(index: usize, value: f64) -> Vec<f64> {
    let mut covariance: Vec<f64> = (0..36).map(|index| if index % 7 == 0 { 1.0 } else { 0.0 }).collect();
    covariance[index] = value;
    covariance
}

pub(super) async fn bad_frames(ground: &Ground) -> Cases {
    let mut robot = Robot::new(ground, "frames").await;
    let (invalid, precondition) = (Code::InvalidArgument, Code::FailedPrecondition);
    let odometry =
        |spoil: fn(&mut v1::Odometry)| move |frame: &mut v1::Frame| spoil(frame.odometry.as_mut().unwrap());
    type Spoil = Box<dyn Fn(&mut v1::Frame) + Send + Sync>;
    let cases: Vec<(&str, Spoil, Code, &str)> = vec![
        ("nothing seen", Box::new(|f| f.content = None), invalid, "send a JPEG, a PNG, or words"),
        (
            "an empty image",
            Box::new(|f| f.content = Some(Content::Image(vec![]))),
            invalid,
            "the bytes of a JPEG or PNG",
        ),
        (
            "noise as image",
            Box::new(|f| f.content = Some(Content::Image(vec![0xff; 999]))),
            invalid,
            "convert it to JPEG or PNG",
        ),
        ("stamp 0", Box::new(|f| f.stamp_ns = 0), invalid, "send when the image was taken, in nanoseconds"),
        ("stamp negative", Box::new(|f| f.stamp_ns = -1), invalid, "in nanoseconds above 0"),
        ("stamp backwards", Box::new(|f| f.stamp_ns = 1), precondition, "steady clock"),
        ("stamp of the frame before", Box::new(|f| f.stamp_ns -= SECOND_NS), precondition, "steady clock"),
        ("sequence 2^63", Box::new(|f| f.sequence = 1 << 63), invalid, "below 2^63"),
        ("sequence of all", Box::new(|f| f.sequence = u64::MAX), invalid, "below 2^63"),
        ("a number that was skipped", Box::new(|f| f.sequence = 1), precondition, "number frames upwards"),
        (
            "odometry empty",
            Box::new(|f| f.odometry = Some(v1::Odometry::default())),
            invalid,
            "or leave the odometry out",
        ),
        (
            "position z NaN",
            Box::new(odometry(|o| position(o).z = f64::NAN)),
            invalid,
            "position is not a finite number",
        ),
        (
            "position y infinite",
            Box::new(odometry(|o| position(o).y = f64::NEG_INFINITY)),
            invalid,
            "position is not a finite number",
        ),
        (
            "orientation w NaN",
            Box::new(odometry(|o| orientation(o).w = f64::NAN)),
            invalid,
            "orientation is not a finite number",
        ),
        (
            "orientation x infinite",
            Box::new(odometry(|o| orientation(o).x = f64::INFINITY)),
            invalid,
            "orientation is not a finite number",
        ),
        (
            "orientation of nothing",
            Box::new(odometry(|o| orientation(o).w = 0.0)),
            invalid,
            "unit quaternion",
        ),
        (
            "one covariance",
            Box::new(odometry(|o| o.covariance = vec![1.0])),
            invalid,
            "send 36, row by row, or none",
        ),
        (
            "40,000 covariances",
            Box::new(odometry(|o| o.covariance = vec![0.0; 40_000])),
            invalid,
            "send 36, row by row, or none",
        ),
        (
            "covariance infinite",
            Box::new(odometry(|o| o.covariance = covariance(0, f64::INFINITY))),
            invalid,
            "covariance is not a finite number",
        ),
        (
            "covariance NaN aside",
            Box::new(odometry(|o| o.covariance = covariance(3, f64::NAN))),
            invalid,
            "covariance is not a finite number",
        ),
        (
            "covariance on one side",
            Box::new(odometry(|o| o.covariance = covariance(6, 0.5))),
            invalid,
            "not symmetric",
        ),
        (
            "covariance negative",
            Box::new(odometry(|o| o.covariance = covariance(35, -1.0))),
            invalid,
            "negative eigenvalue",
        ),
        ("a jump", Box::new(|f| f.odometry = Some(at(1e6))), invalid, "jumped 1000000.0 m"),
        ("a jump beyond all numbers", Box::new(|f| f.odometry = Some(at(-f64::MAX))), invalid, "send metres"),
    ];
    for (case, spoil, code, fragment) in cases {
        let mut bad = good(robot.next);
        spoil(&mut bad);
        robot.refused(case, bad, code, fragment).await;
    }
    robot.cases
}

fn position(odometry: &mut v1::Odometry) -> &mut v1::Vector3 {
    odometry.pose.as_mut().unwrap().position_m.as_mut().unwrap()
}

fn orientation(odometry: &mut v1::Odometry) -> &mut v1::Quaternion {
    odometry.pose.as_mut().unwrap().orientation.as_mut().unwrap()
}
