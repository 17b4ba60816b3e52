//! Cameras, odometry and stamps that are not what was declared show in explanations and in metrics.

use waypost_client::{Client, FrameInput, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{Drive, Server, http, import_model, map_request, stream, words_options};

/// A drive that comes back, by good wheels.
fn drive() -> Drive {
    let wheels = WheelErrors { scale: 0.01, ..WheelErrors::NONE };
    Drive::new(NamedWorld::Gallery, 12, "rooms", wheels)
}

/// The drive with positions that are so many times as long.
fn scaled(drive: &Drive, scale: f64) -> Vec<FrameInput> {
    let scaled = drive.words().map(|mut frame| {
        let pose = frame.odometry.as_mut().and_then(|odometry| odometry.pose.as_mut()).unwrap();
        let position = pose.position_m.as_mut().unwrap();
        (position.x, position.y) = (scale * position.x, scale * position.y);
        frame
    });
    scaled.collect()
}

/// Streams a session of the drive, and asks at every tenth frame how its odometry agrees.
async fn agreements(
    client: &Client,
    session: &str,
    camera: v1::Camera,
    frames: Vec<FrameInput>,
) -> Vec<v1::OdometryAgreement> {
    let options = SessionOptions { camera: Some(camera), ..words_options("gallery", session) };
    let asked: Vec<u64> = frames.iter().skip(9).step_by(10).map(|frame| frame.sequence).collect();
    stream(client.open_session(options).await.unwrap(), frames).await;
    let mut agreements = Vec::new();
    for sequence in asked {
        let name = format!("maps/gallery/sessions/{session}/frames/{sequence}");
        let explained = client.explain_frame(&name, None, Some(0)).await.unwrap();
        agreements.extend(explained.odometry_agreement);
    }
    agreements
}

async fn turned_unlike(server: &Server, how: &str) -> bool {
    let text = http().get(server.url("/metrics")).send().await.unwrap().text().await.unwrap();
    text.contains(&format!("waypost_frames_turned_unlike_odometry_total{{how=\"{how}\"}}"))
}

fn findings(agreements: &[v1::OdometryAgreement]) -> Vec<&str> {
    let findings = agreements.iter().map(|agreement| agreement.finding.as_str());
    findings.filter(|finding| !finding.is_empty()).collect()
}

async fn map_server() -> (Server, Client) {
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("gallery", &model.name)).await.unwrap();
    (server, client)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_declared_well_is_found_well_and_another_scale_later_is_seen() {
    let drive = drive();
    let (server, client) = map_server().await;
    let well = agreements(&client, "first", drive.camera(), drive.words().collect()).await;
    assert_eq!(findings(&well), Vec::<&str>::new());
    let turns: Vec<f64> = well.iter().flat_map(|found| found.turns).map(|turns| turns.ratio).collect();
    assert!(!turns.is_empty() && turns.iter().all(|ratio| (ratio - 1.0).abs() < 0.1), "{turns:?}");
    let ways: Vec<f64> = well.iter().flat_map(|found| found.ways).map(|ways| ways.ratio).collect();
    assert!(!ways.is_empty() && ways.iter().all(|ratio| (ratio - 1.0).abs() < 0.1), "{ways:?}");
    assert!(
        !turned_unlike(&server, "of_another_scale").await && !turned_unlike(&server, "out_of_step").await
    );

    // The same way by wheels that take 1.3 m for one.
    let second = agreements(&client, "second", drive.camera(), scaled(&drive, 1.3)).await;
    let found = findings(&second);
    assert!(found.iter().any(|finding| finding.contains("check the odometry's scale")), "{second:?}");
    let ways: Vec<f64> = second.iter().flat_map(|found| found.ways).map(|ways| ways.ratio).collect();
    assert!(ways.iter().all(|ratio| (ratio * 1.3 - 1.0).abs() < 0.1), "{ways:?}");
    server.stop().await;
}

/// A robot so slow that its centimetres would be no doubtful speed: images say that they are no metres.
#[tokio::test(flavor = "multi_thread")]
async fn centimetres_are_named() {
    let drive = drive();
    let (server, client) = map_server().await;
    for (session, scale, named) in [("metres", 1.0, false), ("centimetres", 100.0, true)] {
        let frames = scaled(&drive, scale).into_iter().take(40).collect();
        let found = agreements(&client, session, drive.camera(), frames).await;
        let is_named = findings(&found).iter().any(|finding| finding.contains("in centimetres"));
        assert_eq!(is_named, named, "{session}: {found:?}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn another_field_of_view_than_the_declared_one_is_named() {
    let drive = drive();
    let (server, client) = map_server().await;
    let narrow = v1::FieldOfView { horizontal_rad: 60_f64.to_radians() };
    let camera = v1::Camera { model: Some(v1::camera::Model::FieldOfView(narrow)), ..drive.camera() };
    let found = agreements(&client, "robot", camera, drive.words().take(60).collect()).await;
    let said = findings(&found);
    let named =
        |finding: &&&str| finding.contains("declared as 60 degrees (8") && finding.contains("field of view");
    assert!(said.iter().filter(named).count() > 0, "{found:?}");
    assert!(turned_unlike(&server, "of_another_scale").await);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn odometry_of_other_moments_than_the_images_is_named() {
    let drive = drive();
    let (server, client) = map_server().await;
    let frames: Vec<FrameInput> = drive.words().take(60).collect();
    let late = frames.iter().enumerate().map(|(index, frame)| FrameInput {
        odometry: frames[index.saturating_sub(3)].odometry.clone(),
        ..frame.clone()
    });
    let found = agreements(&client, "robot", drive.camera(), late.collect()).await;
    let said = findings(&found);
    assert!(said.iter().any(|finding| finding.contains("at which it was taken")), "{found:?}");
    assert!(turned_unlike(&server, "out_of_step").await);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn odometry_that_turns_the_other_way_is_named() {
    let drive = drive();
    let (server, client) = map_server().await;
    let mirrored = drive.words().take(40).map(|mut frame| {
        let pose = frame.odometry.as_mut().and_then(|odometry| odometry.pose.as_mut()).unwrap();
        pose.orientation.as_mut().unwrap().z *= -1.0;
        pose.position_m.as_mut().unwrap().y *= -1.0;
        frame
    });
    let found = agreements(&client, "robot", drive.camera(), mirrored.collect()).await;
    assert!(findings(&found).iter().any(|finding| finding.contains("the other way")), "{found:?}");
    server.stop().await;
}
