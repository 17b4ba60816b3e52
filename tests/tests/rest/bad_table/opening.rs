//! First messages of streams.

use tonic::{Code, Status};
use waypost_client::v1;
use waypost_proto::v1::camera::Model;
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_proto::v1::stream_request::Content;

use super::maps::bad_map_names;
use super::{Cases, Ground};
use crate::harness::{RawStream, as_histogram, in_time, open, wire, word_maker};

/// What the server says to a first message.
async fn to_first(ground: &Ground, first: Content) -> Result<(), Status> {
    let mut stream = RawStream::begin(&ground.server.endpoint(), first).await?;
    stream.next().await.map(drop)
}

pub(super) async fn openings(ground: &Ground) -> Cases {
    let mut cases = Cases::new("open");
    for (case, map, code, fragment) in bad_map_names() {
        let opening = v1::OpenSession { map, ..open("drive", "new") };
        let result = to_first(ground, Content::Open(opening)).await;
        cases.refused(&format!("map, {case}"), result, code, fragment);
    }
    let (invalid, precondition) = (Code::InvalidArgument, Code::FailedPrecondition);
    let session = |id: &str| open("drive", id);
    let mode = |mode| v1::OpenSession { mode, ..open("drive", "new") };
    let hash =
        |words_hash: &str| v1::OpenSession { words_hash: words_hash.to_owned(), ..open("drive", "new") };
    let localizing = v1::SessionMode::Localize.into();
    let own = word_maker().words_hash();
    for (case, opening, code, fragment) in [
        ("capitals", session("Robot"), invalid, "use 1 to 63 of a-z"),
        ("unicode", session("röbot"), invalid, "use 1 to 63 of a-z"),
        ("a path", session("../robot"), invalid, "use 1 to 63 of a-z"),
        ("its full name", session("maps/drive/sessions/robot"), invalid, "use 1 to 63 of a-z"),
        ("endless", session(&"x".repeat(100_000)), invalid, "use 1 to 63 of a-z"),
        ("no mode", mode(0), invalid, "SESSION_MODE_MAP lets the map grow"),
        ("a mode of the future", mode(99), invalid, "which this server does not know"),
        ("a mode below 0", mode(-1), invalid, "which this server does not know"),
        ("words of another hash", hash(&"0".repeat(64)), precondition, "download that model"),
        ("a hash that is none", hash("words"), precondition, own),
        (
            "words of another map",
            v1::OpenSession { words_hash: own.to_owned(), ..open("other", "new") },
            precondition,
            "make the words with it",
        ),
        (
            "localizing as one that maps",
            v1::OpenSession { mode: localizing, ..open("drive", "robot") },
            precondition,
            "choose another name for localizing",
        ),
    ] {
        cases.refused(case, to_first(ground, Content::Open(opening)).await, code, fragment);
    }
    let frame_first = to_first(ground, Content::Frame(wire(as_histogram(11)))).await;
    cases.refused("a frame first", frame_first, invalid, "must open a session");
    let mut service = SessionServiceClient::new(ground.channel().await);
    for (case, requests) in
        [("an empty message", vec![v1::StreamRequest { content: None }]), ("no message", Vec::new())]
    {
        let result = in_time(service.stream(futures::stream::iter(requests))).await;
        cases.refused(case, result.map(drop), invalid, "must open a session");
    }
    // After the first, too, an empty message is none.
    let (raw, _) = RawStream::open(&ground.server.endpoint(), open("drive", "robot")).await.unwrap();
    let result = raw.empty_message().await;
    cases.refused("an empty message later", result, invalid, "each must be a frame");
    cases
}

/// Fields that the tables beside this one do not have.
pub(super) async fn cameras(ground: &Ground) -> Cases {
    let mut cases = Cases::new("camera");
    let pinhole = v1::Pinhole { fx_px: 500.0, fy_px: 500.0, cx_px: 320.0, cy_px: 180.0, distortion: vec![] };
    let fisheye = v1::Fisheye { fx_px: 300.0, fy_px: 300.0, cx_px: 320.0, cy_px: 180.0, distortion: vec![] };
    let mirror = v1::HyperbolicMirror {
        center_x_px: 320.0,
        center_y_px: 180.0,
        inner_radius_px: 20.0,
        outer_radius_px: 90.0,
        eccentricity: 1.2,
        horizon_radius_px: Some(60.0),
        ahead_rad: 0.0,
    };
    let panorama = |projection, vertical_rad| Model::Panorama(v1::Panorama { projection, vertical_rad });
    let view = |horizontal_rad| Model::FieldOfView(v1::FieldOfView { horizontal_rad });
    let (nan, infinite) = (f64::NAN, f64::INFINITY);
    let cylinder = v1::panorama::Projection::Cylindrical.into();
    let sphere = v1::panorama::Projection::Equirectangular.into();
    for (case, model, fragment) in [
        (
            "pinhole, fx negative",
            Model::Pinhole(v1::Pinhole { fx_px: -1.0, ..pinhole.clone() }),
            "must be above 0 px",
        ),
        (
            "pinhole, fy infinite",
            Model::Pinhole(v1::Pinhole { fy_px: infinite, ..pinhole.clone() }),
            "must be above 0 px",
        ),
        ("pinhole, cy NaN", Model::Pinhole(v1::Pinhole { cy_px: nan, ..pinhole.clone() }), "send pixels"),
        (
            "pinhole, distortion NaN",
            Model::Pinhole(v1::Pinhole { distortion: vec![nan; 4], ..pinhole.clone() }),
            "distortion is not finite",
        ),
        (
            "pinhole, 70 distortions",
            Model::Pinhole(v1::Pinhole { distortion: vec![0.0; 70], ..pinhole }),
            "[0, 4, 5] distortion values, not 70",
        ),
        (
            "fisheye, no fx",
            Model::Fisheye(v1::Fisheye { fx_px: 0.0, ..fisheye.clone() }),
            "must be above 0 px",
        ),
        ("fisheye, cx infinite", Model::Fisheye(v1::Fisheye { cx_px: infinite, ..fisheye }), "send pixels"),
        ("field of view, none", view(0.0), "between 0 and pi"),
        ("field of view, negative", view(-1.0), "send radians"),
        ("field of view, NaN", view(nan), "send radians"),
        ("panorama of the future", panorama(99, Some(1.0)), "which this server does not know"),
        ("panorama, of none", panorama(0, Some(1.0)), "cylindrical or equirectangular"),
        ("panorama, NaN", panorama(cylinder, Some(nan)), "send radians"),
        ("panorama, infinite", panorama(sphere, Some(infinite)), "at most pi"),
        ("panorama, negative", panorama(sphere, Some(-1.0)), "must be above 0"),
        (
            "mirror, centre NaN",
            Model::HyperbolicMirror(v1::HyperbolicMirror { center_x_px: nan, ..mirror }),
            "centre is not finite",
        ),
        (
            "mirror, inner NaN",
            Model::HyperbolicMirror(v1::HyperbolicMirror { inner_radius_px: nan, ..mirror }),
            "0 <= inner < outer",
        ),
        (
            "mirror, inner negative",
            Model::HyperbolicMirror(v1::HyperbolicMirror { inner_radius_px: -1.0, ..mirror }),
            "0 <= inner < outer",
        ),
        (
            "mirror, outer infinite",
            Model::HyperbolicMirror(v1::HyperbolicMirror { outer_radius_px: infinite, ..mirror }),
            "0 <= inner < outer",
        ),
        (
            "mirror, eccentricity NaN",
            Model::HyperbolicMirror(v1::HyperbolicMirror { eccentricity: nan, ..mirror }),
            "must be above 1",
        ),
        (
            "mirror, eccentricity infinite",
            Model::HyperbolicMirror(v1::HyperbolicMirror { eccentricity: infinite, ..mirror }),
            "must be above 1",
        ),
        (
            "mirror, horizon negative",
            Model::HyperbolicMirror(v1::HyperbolicMirror { horizon_radius_px: Some(-1.0), ..mirror }),
            "at a radius above 0",
        ),
        (
            "mirror, ahead NaN",
            Model::HyperbolicMirror(v1::HyperbolicMirror { ahead_rad: nan, ..mirror }),
            "send radians",
        ),
    ] {
        let camera = v1::Camera { model: Some(model), ..v1::Camera::default() };
        let opening = v1::OpenSession { camera: Some(camera), ..open("drive", "new") };
        let result = to_first(ground, Content::Open(opening)).await;
        cases.refused(case, result, Code::InvalidArgument, fragment);
    }
    let pose = |x, w| v1::Pose {
        position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w }),
    };
    let height_alone = v1::Camera { image_height_px: Some(9), ..v1::Camera::default() };
    for (case, camera, fragment) in [
        ("a height alone", height_alone, "needs width and height above 0, or neither"),
        (
            "pose NaN",
            v1::Camera { base_to_camera: Some(pose(nan, 1.0)), ..Default::default() },
            "send metres",
        ),
        (
            "pose turned NaN",
            v1::Camera { base_to_camera: Some(pose(0.0, nan)), ..Default::default() },
            "is not finite",
        ),
        (
            "pose turned twice",
            v1::Camera { base_to_camera: Some(pose(0.0, 2.0)), ..Default::default() },
            "send a unit quaternion",
        ),
    ] {
        let opening = v1::OpenSession { camera: Some(camera), ..open("drive", "new") };
        let result = to_first(ground, Content::Open(opening)).await;
        cases.refused(case, result, Code::InvalidArgument, fragment);
    }
    cases
}
