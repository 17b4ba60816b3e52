//! Errors of a session end its stream, with a status of their own.

use std::time::Duration;

use tonic::Status;
use waypost_client::Code;
use waypost_proto::v1;
use waypost_proto::v1::camera::Model;
use waypost_proto::v1::stream_request::Content;
use waypost_proto::v1::stream_response::Content as Response;

use crate::harness::{
    RawStream, Server, assert_status, frame, in_time, map_request, open, refused, session_options,
    state_hash, wire,
};

/// Long enough for a server that ends a stream by itself.
const ENDING: Duration = Duration::from_secs(10);

#[track_caller]
fn assert_ended<T: std::fmt::Debug>(case: &str, result: Result<T, Status>, code: Code, fragment: &str) {
    match result {
        Err(status) => assert_status(case, (status.code(), status.message()), code, fragment),
        Ok(other) => panic!("{case}: the stream goes on: {other:?}"),
    }
}

/// What the server says to a first message that opens nothing.
async fn to_first(server: &Server, first: Content) -> Result<(), Status> {
    let mut stream = RawStream::begin(&server.endpoint(), first).await?;
    stream.next().await.map(drop)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_cannot_be_opened_says_why() {
    let (server, client) = Server::with_map().await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let mode = |mode| v1::OpenSession { mode, ..open("drive", "robot") };
    let map = |map: &str| v1::OpenSession { map: map.to_owned(), ..open("drive", "robot") };
    let session = |id: &str| open("drive", id);
    let invalid = Code::InvalidArgument;
    let cases = [
        ("unknown map", map("maps/nowhere"), Code::NotFound, "there is no map nowhere; list the maps"),
        ("map without collection", map("drive"), invalid, "write maps/"),
        ("no map", map(""), invalid, "write maps/"),
        ("bad map name", map("maps/My Drive"), invalid, "is no map name; use 1 to 63 of a-z"),
        ("a name below the map", map("maps/drive/sessions/robot"), invalid, "write maps/"),
        ("no mode", mode(0), invalid, "SESSION_MODE_MAP"),
        ("a mode of the future", mode(99), invalid, "does not know"),
        ("capitals", session("Robot"), invalid, "is no session name"),
        ("a path", session("../robot"), invalid, "is no session name"),
        ("too long", session(&"x".repeat(64)), invalid, "1 to 63"),
        ("begins with a dash", session("-robot"), invalid, "beginning with a letter or digit"),
    ];
    for (case, open, code, fragment) in cases {
        assert_ended(case, to_first(&server, Content::Open(open)).await, code, fragment);
    }
    let frame_first = to_first(&server, Content::Frame(wire(frame(1)))).await;
    assert_ended("frame first", frame_first, invalid, "must open a session");
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);

    let options = session_options("nowhere", "robot");
    let (code, message) = refused(in_time(client.open_session(options)).await.map(drop));
    assert_status("by the client", (code, &message), Code::NotFound, "there is no map nowhere");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_cannot_be_is_refused() {
    let (server, client) = Server::with_map().await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let pinhole = v1::Pinhole { fx_px: 500.0, fy_px: 500.0, cx_px: 320.0, cy_px: 180.0, distortion: vec![] };
    let fisheye =
        v1::Fisheye { fx_px: 300.0, fy_px: 300.0, cx_px: 320.0, cy_px: 180.0, distortion: vec![0.0; 5] };
    let panorama = |projection, vertical_rad| Model::Panorama(v1::Panorama { projection, vertical_rad });
    let mirror = |inner_radius_px, outer_radius_px, eccentricity| {
        let (center_x_px, center_y_px) = (320.0, 180.0);
        let mirror = v1::HyperbolicMirror {
            center_x_px,
            center_y_px,
            inner_radius_px,
            outer_radius_px,
            eccentricity,
            ..v1::HyperbolicMirror::default()
        };
        Model::HyperbolicMirror(mirror)
    };
    let models = [
        (Model::Pinhole(v1::Pinhole { fx_px: 0.0, ..pinhole.clone() }), "focal lengths must be above 0"),
        (Model::Pinhole(v1::Pinhole { fy_px: f64::NAN, ..pinhole.clone() }), "focal lengths"),
        (Model::Pinhole(v1::Pinhole { cx_px: f64::INFINITY, ..pinhole.clone() }), "centre is not finite"),
        (
            Model::Pinhole(v1::Pinhole { distortion: vec![0.1; 3], ..pinhole.clone() }),
            "distortion values, not 3",
        ),
        (Model::Fisheye(fisheye), "distortion values, not 5"),
        (Model::FieldOfView(v1::FieldOfView { horizontal_rad: 90.0 }), "send radians"),
        (panorama(0, Some(1.0)), "cylindrical or equirectangular"),
        (panorama(v1::panorama::Projection::Cylindrical.into(), Some(0.0)), "between 0 and pi"),
        (panorama(v1::panorama::Projection::Equirectangular.into(), Some(4.0)), "at most pi"),
        (mirror(50.0, 20.0, 1.2), "inner < outer"),
        (mirror(20.0, 50.0, 0.9), "eccentricity must be above 1"),
    ];
    let mut cameras: Vec<(v1::Camera, &str)> = models
        .into_iter()
        .map(|(model, fragment)| (v1::Camera { model: Some(model), ..v1::Camera::default() }, fragment))
        .collect();
    cameras.push((v1::Camera { image_width_px: Some(640), ..v1::Camera::default() }, "image size"));
    let zero =
        v1::Pose { position_m: Some(v1::Vector3::default()), orientation: Some(v1::Quaternion::default()) };
    cameras.push((v1::Camera { base_to_camera: Some(zero), ..v1::Camera::default() }, "unit quaternion"));
    let no_position = v1::Pose { position_m: None, orientation: None };
    cameras.push((
        v1::Camera { base_to_camera: Some(no_position), ..v1::Camera::default() },
        "both position and",
    ));

    for (camera, fragment) in cameras {
        let case = format!("{camera:?}");
        let opening = v1::OpenSession { camera: Some(camera), ..open("drive", "robot") };
        let ended = to_first(&server, Content::Open(opening)).await;
        assert_ended(&case, ended, Code::InvalidArgument, fragment);
    }
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);

    let model = Some(Model::Pinhole(pinhole));
    let camera = Some(v1::Camera {
        model,
        image_width_px: Some(640),
        image_height_px: Some(360),
        base_to_camera: None,
    });
    let opening = v1::OpenSession { camera, ..open("drive", "robot") };
    let (mut raw, _) = RawStream::open(&server.endpoint(), opening).await.unwrap();
    raw.answered(wire(frame(1))).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_open_ends_the_stream() {
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(wire(frame(1))).await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    raw.send(Content::Open(open("drive", "another"))).await;
    assert_ended("second open", raw.next().await, Code::InvalidArgument, "each must be a frame");
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(1));
    raw.answered(wire(frame(2))).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_without_a_name_gets_one_of_its_own() {
    let (server, client) = Server::with_map().await;
    let mut names = Vec::new();
    for _ in 0..3 {
        let (_, opened) = RawStream::open(&server.endpoint(), open("drive", "")).await.unwrap();
        assert_eq!(opened.last_committed_sequence, None);
        names.push(opened.session);
    }
    names.sort();
    names.dedup();
    assert_eq!(names.len(), 3, "{names:?}");
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().sessions, 3);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_later_stream_takes_a_session_over() {
    let (server, client) = Server::with_map().await;
    let (mut first, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    first.answered(wire(frame(1))).await;
    let (mut second, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, Some(1));
    let before = state_hash(&client, "drive").await;
    assert_ended("first stream", first.frame(wire(frame(2))).await, Code::Aborted, "took this session over");
    assert_eq!(state_hash(&client, "drive").await, before);
    let answer = second.answered(wire(frame(2))).await;
    assert!(!answer.resent);
    assert_eq!(answer.last_committed_sequence, 2);
    server.stop().await;
}

/// The contract: the older stream ends, whether it sends anything or not.
#[tokio::test(flavor = "multi_thread")]
async fn a_silent_stream_hears_that_it_was_taken_over() {
    let (server, _client) = Server::with_map().await;
    let (mut first, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    first.answered(wire(frame(1))).await;
    let (_second, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    let ended = tokio::time::timeout(ENDING, first.next()).await.expect("the silent stream was not ended");
    assert_ended("first stream", ended, Code::Aborted, "took this session over");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_deleted_while_streamed_into_ends_the_stream() {
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(wire(frame(1))).await;
    client.delete_map("drive").await.unwrap();
    assert_ended("deleted", raw.frame(wire(frame(2))).await, Code::NotFound, "there is no map drive");
    assert!(client.maps().await.unwrap().is_empty());

    // The server goes on, also with a map of that name.
    client.create_map(map_request("drive", "shipped")).await.unwrap();
    let (mut raw, opened) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    assert_eq!(opened.last_committed_sequence, None);
    raw.answered(wire(frame(1))).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_stream_hears_that_its_map_was_deleted() {
    let (server, client) = Server::with_map().await;
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    raw.answered(wire(frame(1))).await;
    client.delete_map("drive").await.unwrap();
    let ended = tokio::time::timeout(ENDING, raw.next()).await.expect("the silent stream was not ended");
    assert_ended("deleted", ended, Code::NotFound, "there is no map drive");
    server.stop().await;
}

/// A new map of the same name is another map: old streams must not reach into it.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_deleted_and_made_again_ends_the_old_stream() {
    for new_session in [Some("another"), None] {
        let (server, client) = Server::with_map().await;
        let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
        raw.answered(wire(frame(1))).await;
        client.delete_map("drive").await.unwrap();
        client.create_map(map_request("drive", "shipped")).await.unwrap();
        if let Some(session) = new_session {
            RawStream::open(&server.endpoint(), open("drive", session)).await.unwrap();
        }
        let before = state_hash(&client, "drive").await;
        let case = format!("new session {new_session:?}");
        let mut ended = raw.frame(wire(frame(2))).await;
        if let Ok(Response::Refusal(refusal)) = &ended
            && Code::from(refusal.status.as_ref().unwrap().code) == Code::Unavailable
        {
            ended = raw.frame(wire(frame(2))).await;
        }
        assert_eq!(state_hash(&client, "drive").await, before, "{case}");
        assert_ended(&case, ended, Code::NotFound, "there is no map drive");
        server.stop().await;
    }
}
