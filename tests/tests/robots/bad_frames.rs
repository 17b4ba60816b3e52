//! Bad frames: each is refused by an answer that says how to mend it, nothing changes, and the stream
//! goes on.

use std::io::Cursor;
use std::time::Duration;

use waypost_client::{Client, Code, FrameContent, FrameOutcome};
use waypost_proto::v1;
use waypost_proto::v1::frame::Content::Image;

use crate::harness::{
    RawStream, SECOND_NS, Server, ServerProcess, assert_status, frame, images, import_model, in_time,
    map_request, open, session_options, state_hash, stream, wire,
};

/// A frame that is bad in one way, and what is said to it.
struct BadFrame {
    case: &'static str,
    spoil: Box<dyn Fn(&mut v1::Frame) + Send>,
    code: Code,
    fragment: &'static str,
}

fn bad(
    case: &'static str,
    spoil: impl Fn(&mut v1::Frame) + Send + 'static,
    code: Code,
    fragment: &'static str,
) -> BadFrame {
    BadFrame { case, spoil: Box::new(spoil), code, fragment }
}

fn bad_image(case: &'static str, bytes: Vec<u8>, fragment: &'static str) -> BadFrame {
    bad(case, move |frame| frame.content = Some(Image(bytes.clone())), Code::InvalidArgument, fragment)
}

fn bad_odometry(case: &'static str, spoil: fn(&mut v1::Odometry), fragment: &'static str) -> BadFrame {
    let spoil = move |frame: &mut v1::Frame| {
        let mut moved = at(0.0);
        spoil(&mut moved);
        frame.odometry = Some(moved);
    };
    bad(case, spoil, Code::InvalidArgument, fragment)
}

/// Sends a good frame, then bad ones, each followed by its mended self.
async fn all_refused(cases: Vec<BadFrame>) {
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(good(2)).await;
    for (sequence, BadFrame { case, spoil, code, fragment }) in (3..).zip(cases) {
        let before = state_hash(&client, "drive").await;
        let mut frame = good(sequence);
        spoil(&mut frame);
        let refusal = raw.refused(frame.clone()).await;
        assert_eq!(refusal.sequence, frame.sequence, "{case}");
        let status = refusal.status.expect("a refusal has a status");
        assert_status(case, (Code::from(status.code), &status.message), code, fragment);
        assert_eq!(state_hash(&client, "drive").await, before, "{case}");
        // Mended, it is taken under the same number.
        let answer = raw.answered(good(sequence)).await;
        assert_eq!((answer.last_committed_sequence, answer.resent), (sequence, false), "{case}");
    }
    server.stop().await;
}

/// A frame with odometry at the origin.
fn good(sequence: u64) -> v1::Frame {
    v1::Frame { odometry: Some(at(0.0)), ..wire(frame(sequence)) }
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

fn pose(odometry: &mut v1::Odometry) -> &mut v1::Pose {
    odometry.pose.as_mut().unwrap()
}

fn position(odometry: &mut v1::Odometry) -> &mut v1::Vector3 {
    pose(odometry).position_m.as_mut().unwrap()
}

fn orientation(odometry: &mut v1::Odometry) -> &mut v1::Quaternion {
    pose(odometry).orientation.as_mut().unwrap()
}

fn diagonal(value: f64) -> Vec<f64> {
    (0..36).map(|index| if index % 7 == 0 { value } else { 0.0 }).collect()
}

fn png() -> Vec<u8> {
    let mut png = Cursor::new(Vec::new());
    image::load_from_memory(&images()[0])
        .unwrap()
        .to_luma8()
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    png.into_inner()
}

/// A PNG header that claims a size; nothing follows it but a few bytes that a decoder might trust.
fn png_claiming(width: u32, height: u32) -> Vec<u8> {
    let mut header = b"IHDR".to_vec();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([8, 0, 0, 0, 0]);
    let crc = header.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(
            crc ^ u32::from(byte),
            |crc, _| if crc & 1 == 1 { 0xedb8_8320 ^ (crc >> 1) } else { crc >> 1 },
        )
    });
    let mut png = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
    png.extend(header);
    png.extend((!crc).to_be_bytes());
    png.extend(b"\0\0\0\x04IDAT\x78\x9c\x63\x60\0\0\0\0");
    png
}

fn padded(length: usize) -> Vec<u8> {
    let mut image = images()[0].clone();
    image.resize(length, 0);
    image
}

fn half(bytes: &[u8]) -> Vec<u8> {
    bytes[..bytes.len() / 2].to_vec()
}

fn thumbnail() -> Vec<u8> {
    let mut jpeg = Cursor::new(Vec::new());
    image::GrayImage::new(8, 8).write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    jpeg.into_inner()
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_images_are_refused() {
    let mut damaged = png();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0xff;
    all_refused(vec![
        bad_image("empty", Vec::new(), "the image is empty; send"),
        bad_image("text", b"this is no picture at all".to_vec(), "neither JPEG nor PNG"),
        bad_image("GIF", b"GIF89a\x01\0\x01\0\0\0\0;".to_vec(), "convert it to JPEG or PNG"),
        bad_image("JPEG cut in half", half(&images()[3]), "send the whole file again"),
        bad_image(
            "JPEG without its end",
            images()[3][..images()[3].len() - 2].to_vec(),
            "send the whole file again",
        ),
        bad_image("JPEG magic alone", images()[3][..3].to_vec(), "send the whole file again"),
        bad_image("PNG cut in half", half(&png()), "send the whole file again"),
        bad_image("PNG damaged", damaged, "damaged"),
        bad_image("PNG bomb", png_claiming(30_000, 30_000), "900.0 megapixels"),
        bad_image("thumbnail", thumbnail(), "at least 16 pixels"),
        bad_image("one byte too long", padded((4 << 20) + 1), "4194305 bytes, more than the 4194304"),
        bad_image("far too long", padded(12 << 20), "shrink it or lower its JPEG quality"),
        bad("missing", |frame| frame.content = None, Code::InvalidArgument, "has no image and no words"),
    ])
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_stamps_and_numbers_are_refused() {
    let stamp = |case, stamp: fn(i64) -> i64, code, fragment| {
        bad(case, move |frame| frame.stamp_ns = stamp(frame.stamp_ns), code, fragment)
    };
    let sequence =
        |case, sequence, code, fragment| bad(case, move |frame| frame.sequence = sequence, code, fragment);
    all_refused(vec![
        stamp("no stamp", |_| 0, Code::InvalidArgument, "has no stamp; send when the image was taken"),
        stamp("negative stamp", |stamp| -stamp, Code::InvalidArgument, "has no stamp"),
        stamp("the most negative stamp", |_| i64::MIN, Code::InvalidArgument, "has no stamp"),
        stamp("falling stamp", |now| now - 2 * SECOND_NS, Code::FailedPrecondition, "steady clock"),
        stamp("equal stamp", |now| now - SECOND_NS, Code::FailedPrecondition, "is not after"),
        sequence("above 2^63", 1 << 63, Code::InvalidArgument, "below 2^63"),
        sequence("largest", u64::MAX, Code::InvalidArgument, "below 2^63"),
        sequence("skipped", 1, Code::FailedPrecondition, "was skipped"),
        sequence("skipped, 0", 0, Code::FailedPrecondition, "was skipped"),
    ])
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_odometry_is_refused() {
    all_refused(vec![
        bad_odometry(
            "NaN position",
            |odometry| position(odometry).y = f64::NAN,
            "position is not a finite number",
        ),
        bad_odometry(
            "infinite position",
            |o| position(o).x = f64::INFINITY,
            "position is not a finite number",
        ),
        bad_odometry(
            "NaN orientation",
            |o| orientation(o).z = f64::NAN,
            "orientation is not a finite number",
        ),
        bad_odometry("zero quaternion", |o| orientation(o).w = 0.0, "unit quaternion"),
        bad_odometry("long quaternion", |o| orientation(o).w = 2.0, "has length 2"),
        bad_odometry("no pose", |odometry| odometry.pose = None, "has no pose"),
        bad_odometry(
            "no position",
            |odometry| pose(odometry).position_m = None,
            "both position and orientation",
        ),
        bad_odometry(
            "no orientation",
            |odometry| pose(odometry).orientation = None,
            "both position and orientation",
        ),
        bad_odometry("35 values", |odometry| odometry.covariance = vec![0.0; 35], "has 35 values; send 36"),
        bad_odometry("37 values", |odometry| odometry.covariance = vec![0.0; 37], "has 37 values; send 36"),
        bad_odometry(
            "negative variance",
            |odometry| odometry.covariance = diagonal(-0.1),
            "negative eigenvalue",
        ),
        bad_odometry(
            "NaN variance",
            |o| o.covariance = diagonal(f64::NAN),
            "covariance is not a finite number",
        ),
        bad_odometry(
            "not symmetric",
            |o| {
                o.covariance = diagonal(1.0);
                o.covariance[1] = 0.5;
            },
            "not symmetric",
        ),
        bad(
            "10 km in 0.1 s",
            |frame| {
                frame.stamp_ns += SECOND_NS / 10 - SECOND_NS;
                frame.odometry = Some(at(10_000.0));
            },
            Code::InvalidArgument,
            "jumped 10000.0 m in 0.100 s",
        ),
        bad(
            "400 m/s",
            |frame| frame.odometry = Some(at(400.0)),
            Code::InvalidArgument,
            "jumped 400.0 m in 1.000 s, faster than 100 m/s; if the odom frame was reset, open a new session",
        ),
        bad(
            "millimetres from the Earth's centre",
            |frame| frame.odometry = Some(at(6.4e9)),
            Code::InvalidArgument,
            "6.4e9 m from the origin of its frame; send metres",
        ),
        bad(
            "beyond all numbers",
            |frame| frame.odometry = Some(at(f64::MAX)),
            Code::InvalidArgument,
            "send metres",
        ),
        bad_odometry(
            "unsure beyond all use",
            |o| o.covariance = diagonal(1e13),
            "leave it out if it is not known",
        ),
    ])
    .await;
}

/// Numbers that are finite but whose squares are not must not hold up the server.
#[tokio::test(flavor = "multi_thread")]
async fn covariances_beyond_all_measure_are_answered() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    for (case, value) in [("f64::MAX", f64::MAX), ("1e200", 1e200), ("1e-310", 1e-310)] {
        let (mut raw, _) =
            RawStream::open(&server.endpoint(), open("drive", case_id(case).as_str())).await.unwrap();
        let mut frame = good(1);
        frame.odometry.as_mut().unwrap().covariance = vec![value; 36];
        let outcome = tokio::time::timeout(Duration::from_secs(20), raw.frame(frame)).await;
        assert!(outcome.is_ok(), "a covariance of {case} hangs the stream");
    }
    server.stop();
}

fn case_id(case: &str) -> String {
    case.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' }).collect()
}

/// The contract: `last_committed_sequence` of a refusal is absent only before the first durable frame.
#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_tells_the_last_durable_frame() {
    let (server, _client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    let spoilt = |sequence| v1::Frame { content: None, ..good(sequence) };
    assert_eq!(raw.refused(spoilt(1)).await.last_committed_sequence, None);
    raw.answered(good(2)).await;
    assert_eq!(raw.refused(spoilt(3)).await.last_committed_sequence, Some(2));
    let falling = v1::Frame { stamp_ns: 1, ..good(4) };
    assert_eq!(raw.refused(falling).await.last_committed_sequence, Some(2));
    server.stop().await;
}

/// The client library hands refusals on and goes on; what is too long it does not even send.
#[tokio::test(flavor = "multi_thread")]
async fn the_client_tells_which_frames_were_refused() {
    let (server, client) = Server::with_map().await;
    let mut frames: Vec<_> = (1..=6).map(frame).collect();
    frames[1].content = FrameContent::Image(b"no picture".to_vec());
    frames[2].content = FrameContent::Image(padded((4 << 20) + 1));
    frames[4].stamp_ns = 1;
    let session = in_time(client.open_session(session_options("drive", "robot"))).await.unwrap();
    let outcomes = stream(session, frames).await;
    let codes: Vec<Option<Code>> = outcomes.iter().map(refusal_code).collect();
    let invalid = Some(Code::InvalidArgument);
    assert_eq!(codes, [None, invalid, invalid, None, Some(Code::FailedPrecondition), None]);
    assert_frames(&client, 3).await;
    server.stop().await;
}

fn refusal_code(outcome: &FrameOutcome) -> Option<Code> {
    match outcome {
        FrameOutcome::Answer(_) => None,
        FrameOutcome::Refusal(refusal) => Some(Code::from(refusal.status.as_ref().unwrap().code)),
    }
}

async fn assert_frames(client: &Client, frames: u64) {
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().frames, frames);
}

/// Images of another shape were not taken by the camera that the session declared.
#[tokio::test(flavor = "multi_thread")]
async fn images_of_another_camera_are_refused() {
    let (server, client) = Server::with_map().await;
    let camera = |width_px, height_px| v1::Camera {
        model: Some(v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.1 })),
        image_width_px: Some(width_px),
        image_height_px: Some(height_px),
        base_to_camera: None,
    };
    let declared = v1::OpenSession { camera: Some(camera(640, 480)), ..open("drive", "robot") };
    let (mut raw, _) = RawStream::open(&server.endpoint(), declared).await.unwrap();
    let opened = state_hash(&client, "drive").await;
    let refusal = raw.refused(wire(frame(1))).await;
    let status = refusal.status.expect("a refusal has a status");
    for named in ["640 x 480", "640 x 360", "open a session with the camera that takes these"] {
        assert_status(named, (Code::from(status.code), &status.message), Code::InvalidArgument, named);
    }
    assert_eq!(state_hash(&client, "drive").await, opened);
    drop(raw);
    let declared = v1::OpenSession { camera: Some(camera(1280, 720)), ..open("drive", "other") };
    let (mut raw, _) = RawStream::open(&server.endpoint(), declared).await.unwrap();
    raw.answered(wire(frame(1))).await;
    server.stop().await;
}
