//! Quotas: what a token, and a server as a whole, may have and send.

use std::time::Duration;

use reqwest::StatusCode;
use serde_json::json;
use waypost_client::v1::quotas::Kind;
use waypost_client::v1::token::Role;
use waypost_client::{Client, ClientOptions, Code, SessionOptions, v1};
use waypost_proto::v1::stream_response::Content as Response;

use super::{Guarded, run};
use crate::harness::{
    Answer, RawStream, ServerProcess, answers, as_words, assert_status, followed, frame, http, import_model,
    in_time, map_request, open, refused, session_options, wire,
};

/// A robot's token with quotas.
pub(super) fn limited(name: &str, quotas: v1::Quotas) -> v1::CreateTokenRequest {
    let quotas = Some(quotas);
    v1::CreateTokenRequest {
        token_id: name.to_owned(),
        role: Role::Robot.into(),
        quotas,
        ..Default::default()
    }
}

pub(super) async fn robot(guarded: &Guarded, quotas: v1::Quotas) -> Client {
    let admin = guarded.client(&guarded.admin).await;
    let (_, secret) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    guarded.client(&secret).await
}

pub(super) async fn used(admin: &Client, token: &str) -> v1::QuotaUse {
    let tokens = admin.tokens().await.unwrap();
    tokens.into_iter().find(|known| known.name == token).unwrap().used.unwrap()
}

/// Why a frame was refused, and the time after which to send it again.
pub(super) fn told(refusal: &v1::FrameRefusal) -> (Code, String, Option<Duration>) {
    let status = refusal.status.clone().unwrap();
    let details = status.details.iter().find(|detail| detail.type_url.ends_with("google.rpc.RetryInfo"));
    let retry = details.map(|detail| {
        let info: tonic_types::pb::RetryInfo = prost::Message::decode(detail.value.as_slice()).unwrap();
        Duration::try_from(info.retry_delay.unwrap()).unwrap()
    });
    (Code::from(status.code), status.message, retry)
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_count_for_the_token_that_opened_them() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let robot = robot(&guarded, v1::Quotas { max_sessions: Some(2), ..Default::default() }).await;
    answers(&robot, "drive", "one", (1..=2).map(as_words)).await;
    answers(&robot, "drive", "two", (1..=2).map(as_words)).await;
    let third =
        async || refused(in_time(robot.open_session(session_options("drive", "three"))).await.map(drop));
    let says = "the token robot-7 has 2 of the 2 sessions that it may (max_sessions); go on with one of them by its name";
    let (code, message) = third().await;
    assert_status("third", (code, &message), Code::FailedPrecondition, says);
    assert!(message.contains("waypost token limit robot-7 --max-sessions 3"), "{message}");
    // It goes on with what it has, looks as it likes, and others are not concerned.
    answers(&robot, "drive", "two", (3..=4).map(as_words)).await;
    let looking = SessionOptions { mode: v1::SessionMode::Localize, ..session_options("drive", "three") };
    drop(in_time(robot.open_session(looking)).await.unwrap());
    answers(&guarded.client(&guarded.robot).await, "drive", "others", (1..=2).map(as_words)).await;
    let session = admin.session("maps/drive/sessions/one").await.unwrap();
    assert_eq!(session.owner, "tokens/robot-7");
    assert_eq!(used(&admin, "tokens/robot-7").await.sessions, 2);

    let deletion = admin.delete_session("maps/drive/sessions/one").await.unwrap();
    followed(&admin, &deletion).await;
    assert_eq!(used(&admin, "tokens/robot-7").await.sessions, 1);
    answers(&robot, "drive", "three", (1..=2).map(as_words)).await;
    assert_eq!(third_again(&robot).await, Code::FailedPrecondition);
    admin.delete_map("drive").await.unwrap();
    assert_eq!(used(&admin, "tokens/robot-7").await, v1::QuotaUse::default());
    guarded.server.stop().await;
}

async fn third_again(robot: &Client) -> Code {
    refused(in_time(robot.open_session(session_options("drive", "four"))).await.map(drop)).0
}

#[tokio::test(flavor = "multi_thread")]
async fn maps_count_for_the_token_that_made_them_however_it_did() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let model = admin.models().await.unwrap().remove(0);
    let request = v1::CreateTokenRequest {
        token_id: "floor2".to_owned(),
        role: Role::Admin.into(),
        maps: vec!["floor2-*".to_owned(), "drive".to_owned()],
        quotas: Some(v1::Quotas { max_maps: Some(1), ..Default::default() }),
        ..Default::default()
    };
    let (_, secret) = admin.create_limited_token(request).await.unwrap();
    let limited = guarded.client(&secret).await;
    limited.create_map(map_request("floor2-a", &model.name)).await.unwrap();
    let mut snapshot = Vec::new();
    limited.export_map("floor2-a", &mut snapshot).await.unwrap();
    let merge = v1::MergeMapsRequest {
        sources: vec!["maps/floor2-a".to_owned(), "maps/drive".to_owned()],
        target: "maps/floor2-b".to_owned(),
        ..Default::default()
    };
    let says = "the token floor2 has 1 of the 1 maps that it may (max_maps); delete one (waypost map rm)";
    for (what, answer) in [
        ("create", refused(limited.create_map(map_request("floor2-b", &model.name)).await)),
        ("import", refused(limited.import_map("floor2-b", std::io::Cursor::new(snapshot.clone())).await)),
        ("merge", refused(limited.merge_maps(merge).await)),
        ("rebuild", refused(limited.rebuild_map("floor2-a", &model.name, "floor2-b").await)),
    ] {
        assert_status(what, (answer.0, &answer.1), Code::FailedPrecondition, says);
    }
    let body = json!({ "map_id": "floor2-b" });
    let post = || http().post(guarded.server.url("/v1/maps")).bearer_auth(&secret).json(&body);
    let conflict = Answer::to(post()).await;
    assert_eq!(conflict.status, StatusCode::CONFLICT, "{}", conflict.text());
    assert!(conflict.json()["error"]["message"].as_str().unwrap().contains(says));
    limited.delete_map("floor2-a").await.unwrap();
    assert_eq!(Answer::to(post()).await.status, StatusCode::OK);
    limited.delete_map("floor2-b").await.unwrap();
    let import = limited.import_map("floor2-c", std::io::Cursor::new(snapshot)).await.unwrap();
    followed(&admin, &import).await;
    assert_eq!(used(&admin, "tokens/floor2").await.maps, 1);
    assert_eq!(Answer::to(post()).await.status, StatusCode::CONFLICT);
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn quotas_that_would_limit_nothing_or_everything_are_refused() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let quotas = v1::Quotas { max_sessions: Some(3), ..Default::default() };
    let (token, _) = admin.create_limited_token(limited("robot-7", quotas)).await.unwrap();
    assert_eq!((token.quotas, token.used), (Some(quotas), Some(v1::QuotaUse::default())));
    let bad = |quotas: v1::Quotas, role: Role| v1::CreateTokenRequest {
        role: role.into(),
        ..limited("wrong", quotas)
    };
    let none = v1::Quotas::default();
    for (quotas, role, says) in [
        (v1::Quotas { max_sessions: Some(0), ..none }, Role::Robot, "a quota of 0 would let nothing through"),
        (v1::Quotas { max_frames_per_second: Some(0.0), ..none }, Role::Robot, "say from 0.1 to 1000"),
        (v1::Quotas { max_frames_per_second: Some(f64::NAN), ..none }, Role::Robot, "NaN frames a second"),
        (v1::Quotas { max_maps: Some(1), ..none }, Role::Robot, "a robot makes no maps"),
        (v1::Quotas { max_kept_mib: Some(1), ..none }, Role::Reader, "a reader changes nothing"),
    ] {
        let (code, message) = refused(admin.create_limited_token(bad(quotas, role)).await);
        assert_status("create", (code, &message), Code::InvalidArgument, says);
    }
    let change = |quotas: v1::Quotas, lifted: &[Kind]| v1::UpdateTokenRequest {
        name: "robot-7".to_owned(),
        quotas: Some(quotas),
        lifted: lifted.iter().map(|&kind| kind.into()).collect(),
    };
    for (request, code, says) in [
        (change(none, &[]), Code::InvalidArgument, "no quota is to change"),
        (
            change(quotas, &[Kind::Sessions]),
            Code::InvalidArgument,
            "max_sessions is to be both set and lifted",
        ),
        (change(none, &[Kind::Unspecified]), Code::InvalidArgument, "is left open; name it"),
        (
            v1::UpdateTokenRequest { name: "nobody".to_owned(), ..change(quotas, &[]) },
            Code::NotFound,
            "no token nobody",
        ),
    ] {
        let (found, message) = refused(admin.update_token(request).await);
        assert_status("update", (found, &message), code, says);
    }
    // Over REST: what is left out stays, what is lifted goes.
    let patch = async |body: serde_json::Value| {
        let url = guarded.server.url("/v1/tokens/robot-7");
        Answer::to(http().patch(url).bearer_auth(&guarded.admin).json(&body)).await
    };
    let changed = patch(json!({ "quotas": { "max_kept_mib": 7, "max_maps": null } })).await.json();
    let expected =
        json!({ "max_maps": null, "max_sessions": 3, "max_frames_per_second": null, "max_kept_mib": 7 });
    assert_eq!(changed["quotas"], expected);
    let changed = patch(json!({ "lifted": ["sessions"], "quotas": { "max_frames_per_second": 0.5 } })).await;
    assert_eq!(changed.json()["quotas"]["max_sessions"], json!(null));
    for (body, says) in [
        (json!({}), "no quota is to change"),
        (json!({ "quotas": { "max_frames": 1 } }), "unknown field"),
        (json!({ "lifted": ["all"] }), "unknown variant"),
        (json!({ "max_sessions": 1 }), "send {\\\"quotas\\\""),
    ] {
        let refused = patch(body).await;
        assert!(refused.status.is_client_error() && refused.text().contains(says), "{}", refused.text());
    }
    let robots = http().patch(guarded.server.url("/v1/tokens/robot-7")).bearer_auth(&guarded.robot);
    assert_eq!(Answer::to(robots.json(&json!({ "lifted": ["kept"] }))).await.status, StatusCode::FORBIDDEN);
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn quotas_and_what_there_is_outlive_the_server_and_are_on_both_command_lines() {
    let directory = tempfile::tempdir().unwrap();
    let data = directory.path().to_str().unwrap();
    let offline =
        |arguments: &[&str]| run("waypost-server", &[arguments, &["--data-dir", data]].concat(), &[]);
    let (_, admin, _) = offline(&["token", "create", "operator", "--role", "admin"]);
    let admin = admin.trim();
    let create = [
        "token",
        "create",
        "robot-7",
        "--role",
        "robot",
        "--max-sessions",
        "3",
        "--max-frames-per-second",
        "50",
    ];
    let (code, robot, stderr) = offline(&[&create[..], &["--max-kept-mib", "100"]].concat());
    assert_eq!(code, 0, "{stderr}");
    let (_, listed, _) = offline(&["token", "ls"]);
    assert!(
        listed.contains("robot-7  robot  at most 3 sessions, 50 frames a second, 100 MiB kept\n"),
        "{listed}"
    );
    let server = ServerProcess::start(directory.path());
    let client = async |server: &ServerProcess, secret: &str| {
        Client::connect(ClientOptions::new(server.endpoint()).with_token(secret)).await.unwrap()
    };
    let operator = client(&server, admin).await;
    let model = import_model(&operator).await;
    for map in ["drive", "hall"] {
        operator.create_map(map_request(map, &model.name)).await.unwrap();
        answers(&client(&server, robot.trim()).await, map, "tour", (1..=24).map(as_words)).await;
        answers(&operator, map, "own", (1..=3).map(as_words)).await;
    }
    // Copies, deletions, and a map that is brought back.
    let mut snapshot = Vec::new();
    operator.export_map("drive", &mut snapshot).await.unwrap();
    let import = operator.import_map("copy", std::io::Cursor::new(snapshot)).await.unwrap();
    followed(&operator, &import).await;
    let merge = v1::MergeMapsRequest {
        sources: vec!["maps/drive".to_owned(), "maps/hall".to_owned()],
        target: "maps/both".to_owned(),
        auto_commit: true,
        min_support: Some(3),
    };
    let merge = operator.merge_maps(merge).await.unwrap();
    followed(&operator, &operator.job(&merge.job).await.unwrap()).await;
    let merge = operator.merge(&merge.name).await.unwrap();
    assert_eq!(merge.state(), v1::merge::State::Committed, "{merge:?}");
    let deletion = operator.delete_session("maps/hall/sessions/own").await.unwrap();
    followed(&operator, &deletion).await;
    let before = used(&operator, "tokens/robot-7").await;
    assert_eq!(before.sessions, 4, "copies of a merge are of the token that opened the session");
    server.kill();

    let server = ServerProcess::start(directory.path());
    let operator = client(&server, admin).await;
    assert_eq!(used(&operator, "tokens/robot-7").await, before);
    let endpoint = server.endpoint();
    let online = |arguments: &[&str]| {
        run("waypost", arguments, &[("WAYPOST_SERVER", endpoint.as_str()), ("WAYPOST_TOKEN", admin)])
    };
    let robots = client(&server, robot.trim()).await;
    let (code, message) =
        refused(in_time(robots.open_session(session_options("hall", "more"))).await.map(drop));
    assert_status(
        "restarted",
        (code, &message),
        Code::FailedPrecondition,
        "has 4 of the 3 sessions that it may",
    );
    let limit = ["token", "limit", "robot-7", "--max-sessions", "5", "--lift", "kept,frames_per_second"];
    let (code, told, stderr) = online(&limit);
    assert!(code == 0 && told.contains("quotas  sessions 4/5\n"), "{told}{stderr}");
    answers(&robots, "hall", "more", (1..=2).map(as_words)).await;
    let (_, listed, _) = online(&["token", "ls"]);
    assert!(
        listed.lines().any(|line| line.starts_with("robot-7") && line.ends_with("sessions 5/5")),
        "{listed}"
    );
    let (code, _, stderr) = online(&["token", "limit", "robot-7"]);
    assert!(code == 4 && stderr.contains("no quota is to change"), "{stderr}");
    server.stop();
    let (code, told, _) = offline(&["check", "--deep"]);
    assert!(code == 0 && told.contains("are as they were written"), "{told}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_has_quotas_of_its_own_and_names_their_settings() {
    let directory = tempfile::tempdir().unwrap();
    let options = ["--max-maps", "2", "--max-sessions", "2", "--max-kept-mib", "1"];
    let server = ServerProcess::start_with(directory.path(), &options);
    let client = server.client().await;
    let model = import_model(&client).await;
    for map in ["drive", "hall"] {
        client.create_map(map_request(map, &model.name)).await.unwrap();
    }
    let (code, message) = refused(client.create_map(map_request("attic", &model.name)).await);
    let says = "the server has 2 of the 2 maps that it may, whosever they are (max_maps); delete one";
    assert_status("maps", (code, &message), Code::FailedPrecondition, says);
    assert!(message.contains("waypost-server --max-maps 3"), "{message}");
    answers(&client, "drive", "one", (1..=5).map(as_words)).await;
    answers(&client, "hall", "two", (1..=2).map(as_words)).await;
    let (code, message) =
        refused(in_time(client.open_session(session_options("hall", "three"))).await.map(drop));
    assert_status("sessions", (code, &message), Code::FailedPrecondition, "2 of the 2 sessions that it may");
    let (mut stream, _) = RawStream::open(&server.endpoint(), open("drive", "one")).await.unwrap();
    let refusal = in_time(async {
        for sequence in 6.. {
            match stream.frame(wire(frame(sequence))).await.unwrap() {
                Response::Answer(_) => {}
                Response::Refusal(refusal) => return refusal,
                Response::Opened(_) => panic!("opened twice"),
            }
        }
        unreachable!()
    });
    let refusal = refusal.await;
    let (code, message, retry) = told(&refusal);
    let says = "of the 1 MiB in its sessions that it may, whosever they are (max_kept_mib); delete sessions";
    assert_status("kept", (code, &message), Code::ResourceExhausted, says);
    assert_eq!(retry, Some(Duration::from_secs(5)));
    // A copy of all that needs as much again.
    client.delete_map("hall").await.unwrap();
    let mut snapshot = Vec::new();
    client.export_map("drive", &mut snapshot).await.unwrap();
    let import = client.import_map("copy", std::io::Cursor::new(snapshot)).await.unwrap();
    let jobs = followed(&client, &import).await;
    let error = jobs.last().unwrap().error.as_ref().unwrap();
    assert!(error.message.contains("(max_kept_mib)"), "{error:?}");
    // What is deleted makes room.
    let deletion = client.delete_session("maps/drive/sessions/one").await.unwrap();
    followed(&client, &deletion).await;
    answers(&client, "drive", "again", (1..=3).map(as_words)).await;
    server.stop();
}
