//! What is said where a quota is reached, at every door.

use std::time::Duration;

use reqwest::StatusCode;
use serde_json::json;
use waypost_client::{Code, FrameContent, FrameInput, NavigationEvent, NavigationOptions, Reading, v1};
use waypost_proto::v1::stream_request::Content as Request;

use super::quotas::{limited, robot, told, used};
use super::{Guarded, run};
use crate::harness::{
    Answer, RawStream, answers, as_words, assert_status, camera_ahead, folder, frame, http, images, in_time,
    open, path, refused, wire,
};

#[tokio::test(flavor = "multi_thread")]
async fn the_command_line_says_what_is_used_up_and_what_to_do() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let quotas = v1::Quotas { max_sessions: Some(1), ..v1::Quotas::default() };
    let (_, secret) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    let request = v1::CreateTokenRequest {
        token_id: "floor2".to_owned(),
        role: v1::token::Role::Admin.into(),
        maps: vec!["floor2-*".to_owned()],
        quotas: Some(v1::Quotas { max_maps: Some(1), ..v1::Quotas::default() }),
        ..v1::CreateTokenRequest::default()
    };
    let (_, floor2) = admin.create_limited_token(request).await.unwrap();
    let endpoint = guarded.server.endpoint();
    let waypost = |token: &str, arguments: &[&str]| {
        run("waypost", arguments, &[("WAYPOST_SERVER", endpoint.as_str()), ("WAYPOST_TOKEN", token)])
    };
    let images = folder(2);
    let stream = |session: &str| {
        waypost(&secret, &["stream", path(images.path()), "--map", "drive", "--session", session])
    };
    assert_eq!(stream("one").0, 0);
    let (code, _, stderr) = stream("two");
    let says = "the token robot-7 has 1 of the 1 sessions that it may (max_sessions); go on with one of them by its name";
    assert!(code == 4 && stderr.contains(says), "{code}: {stderr}");
    assert!(stderr.contains("waypost token limit robot-7 --max-sessions 2"), "{stderr}");
    assert_eq!(waypost(&floor2, &["map", "create", "floor2-a"]).0, 0);
    let (code, _, stderr) = waypost(&floor2, &["map", "create", "floor2-b"]);
    let says = "the token floor2 has 1 of the 1 maps that it may (max_maps); delete one (waypost map rm)";
    assert!(code == 4 && stderr.contains(says), "{code}: {stderr}");
    // What it says to do, by the other name of the command, helps.
    let (code, _, stderr) = waypost(&guarded.admin, &["token", "update", "robot-7", "--max-sessions", "2"]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(stream("two").0, 0);
    let wrong = ["token", "create", "wrong", "--role", "robot"];
    for (flag, value, says) in [
        ("--max-sessions", "0", "a quota of 0 would let nothing through (max_sessions)"),
        ("--max-frames-per-second", "2000", "2000 frames a second cannot be a quota; say from 0.1 to 1000"),
        ("--max-maps", "1", "a robot makes no maps"),
        ("--max-sessions", "-1", "--max-sessions"),
        ("--max-kept-mib", "many", "--max-kept-mib"),
    ] {
        let (code, _, stderr) =
            waypost(&guarded.admin, &[&wrong[..], &[&format!("{flag}={value}")]].concat());
        assert!(code != 0 && stderr.contains(says), "{flag} {value}: {stderr}");
    }
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_and_robots_that_are_led_hear_when_to_send_again() {
    let guarded = Guarded::start().await;
    let quotas = v1::Quotas { max_frames_per_second: Some(0.2), ..v1::Quotas::default() };
    let robot = robot(&guarded, quotas).await;
    let camera = v1::Camera { image_width_px: None, image_height_px: None, ..camera_ahead() };
    let mut navigation = robot.navigate(NavigationOptions::new("drive", camera)).await.unwrap();
    let at = |x: f64| v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        }),
        covariance: Vec::new(),
    };
    let seeing = |sequence: u64| FrameInput { odometry: Some(at(0.0)), ..frame(sequence) };
    navigation.report(Reading { stamp_ns: 1_000_000_000, odometry: at(0.0), reflex: false });
    navigation.see(seeing(1));
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    assert!(matches!(&event, NavigationEvent::Seen(seen) if seen.sequence == 1), "{event:?}");
    navigation.see(seeing(2));
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    let NavigationEvent::FrameRefused(refusal) = event else { panic!("{event:?}") };
    let (code, message, retry) = told(&refusal);
    let says = "the token robot-7 has sent the 0.2 frames a second that it may (max_frames_per_second), over all its streams";
    assert_status("led", (code, &message), Code::ResourceExhausted, says);
    let image = FrameContent::Image(images()[0].clone());
    let (code, message) = refused(robot.query("drive", image, "", None).await);
    assert_status("query", (code, &message), Code::ResourceExhausted, says);
    assert!(message.contains("waypost token limit robot-7 --max-frames-per-second 0.4"), "{message}");
    tokio::time::sleep(retry.unwrap() + Duration::from_millis(50)).await;
    navigation.see(seeing(2));
    let event = in_time(navigation.next()).await.unwrap().unwrap();
    assert!(matches!(&event, NavigationEvent::Seen(seen) if seen.sequence == 2), "{event:?}");
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_is_sent_again_is_kept_and_counted_once() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let quotas =
        v1::Quotas { max_kept_mib: Some(1), max_frames_per_second: Some(4.0), ..v1::Quotas::default() };
    let (_, secret) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    let first = || Request::Open(open("drive", "tour"));
    let endpoint = guarded.server.endpoint();
    let mut stream = RawStream::begin_as(&endpoint, &secret, first()).await.unwrap();
    stream.next().await.unwrap();
    for sequence in 1..=3 {
        stream.answered(wire(frame(sequence))).await;
    }
    let once = used(&admin, "tokens/robot-7").await;
    // More of them than a second has room for, over this stream and the next.
    for _ in 0..6 {
        assert!(stream.answered(wire(frame(3))).await.resent);
    }
    drop(stream);
    let mut stream = RawStream::begin_as(&endpoint, &secret, first()).await.unwrap();
    stream.next().await.unwrap();
    for sequence in [1, 2, 3, 1, 2, 3] {
        assert!(stream.answered(wire(frame(sequence))).await.resent);
    }
    assert_eq!(used(&admin, "tokens/robot-7").await, once);
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_get_quotas_over_rest_and_refusals_are_counted() {
    let guarded = Guarded::start().await;
    let post = async |body: serde_json::Value| {
        let url = guarded.server.url("/v1/tokens");
        Answer::to(http().post(url).bearer_auth(&guarded.admin).json(&body)).await
    };
    let made = post(json!({ "token_id": "robot-7", "role": "robot", "quotas": { "max_sessions": 1 } })).await;
    assert_eq!(made.status, StatusCode::OK, "{}", made.text());
    let made = made.json();
    assert_eq!(made["token"]["quotas"]["max_sessions"], json!(1));
    assert_eq!(made["token"]["used"], json!({ "maps": 0, "sessions": 0, "kept_bytes": 0 }));
    for (quotas, says) in [
        (json!({ "max_sessions": 0 }), "a quota of 0 would let nothing through"),
        (json!({ "max_kept_mib": 1.5 }), "1.5"),
        (json!({ "max_kept_mib": "many" }), "many"),
        (json!({ "max_frames_per_second": 0 }), "say from 0.1 to 1000"),
        (json!({ "max_bytes": 1 }), "max_bytes"),
    ] {
        let refused = post(json!({ "token_id": "wrong", "role": "robot", "quotas": quotas })).await;
        let text = refused.text();
        assert!(refused.status == StatusCode::BAD_REQUEST && text.contains(says), "{quotas}: {text}");
    }
    let robot = guarded.client(made["secret"].as_str().unwrap()).await;
    answers(&robot, "drive", "one", (1..=2).map(as_words)).await;
    let second = robot.open_session(crate::harness::session_options("drive", "two"));
    assert_eq!(refused(in_time(second).await.map(drop)).0, Code::FailedPrecondition);
    let metrics = http().get(guarded.server.url("/metrics")).bearer_auth(&guarded.admin);
    let metrics = Answer::to(metrics).await;
    let metrics = metrics.text();
    for line in [
        "waypost_quota_refusals_total{quota=\"max_sessions\",of=\"token\"} 1",
        "waypost_maps 1",
        "waypost_sessions 1",
    ] {
        assert!(metrics.lines().any(|there| there == line), "no {line} in {metrics}");
    }
    guarded.server.stop().await;
}
