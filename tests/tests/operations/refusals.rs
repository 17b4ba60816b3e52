//! What was refused is kept for those who look after the server, and who streams now is shown.

use waypost_client::v1::token::Role;
use waypost_client::{Client, ClientOptions, Code, v1};
use waypost_proto::v1::frame::Content::Image;
use waypost_proto::v1::stream_request::Content as Request;
use waypost_proto::v1::stream_response::Content as Response;

use crate::harness::{CommandLine, RawStream, Server, assert_status, found, frame, get, open, refused, wire};

/// A frame whose image is none.
fn junk(sequence: u64) -> v1::Frame {
    v1::Frame { content: Some(Image(b"junk".to_vec())), ..wire(frame(sequence)) }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_was_refused_what_is_listed_newest_first() {
    let (server, client) = Server::with_map().await;
    assert_eq!(client.refusals().await.unwrap(), []);
    let (_, secret) = client.create_token("operator", Role::Admin).await.unwrap();
    let admin = Client::connect(ClientOptions::new(server.endpoint()).with_token(&secret)).await.unwrap();
    let (_, robots) = admin.create_token("robot", Role::Robot).await.unwrap();
    let robot = Client::connect(ClientOptions::new(server.endpoint()).with_token(&robots)).await.unwrap();

    assert_eq!(refused(robot.map("attic", v1::MapView::Basic).await).0, Code::NotFound);
    assert_eq!(refused(robot.delete_map("drive").await).0, Code::PermissionDenied);
    for _ in 0..3 {
        assert_eq!(refused(client.maps().await).0, Code::Unauthenticated);
    }
    assert_eq!(get(&server, "/v1/maps/attic").await.status, reqwest::StatusCode::UNAUTHORIZED);
    let opening = Request::Open(open("drive", "monday"));
    let mut stream = RawStream::begin_as(&server.endpoint(), &robots, opening).await.unwrap();
    assert!(matches!(stream.next().await.unwrap(), Some(Response::Opened(_))));
    stream.answered(wire(frame(1))).await;
    stream.refused(junk(2)).await;

    let told = admin.refusals().await.unwrap();
    let short: Vec<(&str, &str, u64, &str, &str)> = told
        .iter()
        .map(|refusal| {
            let v1::Refusal { request, code, times, token, stream, .. } = refusal;
            (request.as_str(), code.as_str(), *times, token.as_str(), stream.as_str())
        })
        .collect();
    let monday = "maps/drive/sessions/monday";
    assert_eq!(
        short,
        [
            ("/waypost.v1.SessionService/Stream", "invalid_argument", 1, "tokens/robot", monday),
            ("GET /v1/maps/attic", "unauthenticated", 1, "", ""),
            ("/waypost.v1.MapService/ListMaps", "unauthenticated", 3, "", ""),
            ("/waypost.v1.MapService/DeleteMap", "permission_denied", 1, "tokens/robot", ""),
            ("/waypost.v1.MapService/GetMap", "not_found", 1, "tokens/robot", ""),
        ]
    );
    let newest_last = told.iter().rev().map(|refusal| refusal.last_time_ns);
    assert!(newest_last.is_sorted() && told.iter().all(|one| one.first_time_ns <= one.last_time_ns));
    assert!(told[4].message.contains("there is no map attic"), "{told:?}");
    assert_eq!(
        told.iter().map(|one| one.peer.as_str()).collect::<Vec<_>>(),
        ["", "127.0.0.1", "127.0.0.1", "127.0.0.1", "127.0.0.1"]
    );
    // It names maps and what is in them, of whichever token.
    let (code, message) = refused(robot.refusals().await);
    assert_status("a robot", (code, &message), Code::PermissionDenied, "robot is a robot's; ask");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_are_shown_while_they_are_open() {
    let (server, client) = Server::with_map().await;
    let drive = Some("drive");
    assert_eq!(client.open_streams(drive).await.unwrap(), []);
    let opening = v1::OpenSession { mode: v1::SessionMode::Localize.into(), ..open("drive", "looker") };
    let (mut looking, _) = RawStream::open(&server.endpoint(), opening).await.unwrap();
    let (mut mapping, _) = RawStream::open(&server.endpoint(), open("drive", "monday")).await.unwrap();
    let fresh = client.open_streams(drive).await.unwrap();
    let of = |stream: &v1::OpenStream| (stream.session.clone(), stream.mode());
    assert_eq!(
        fresh.iter().map(of).collect::<Vec<_>>(),
        [
            ("maps/drive/sessions/looker".to_owned(), v1::SessionMode::Localize),
            ("maps/drive/sessions/monday".to_owned(), v1::SessionMode::Map),
        ]
    );
    assert!(fresh.iter().all(|stream| stream.last_delay_ns.is_none() && stream.last_answer.is_none()));

    mapping.answered(wire(frame(1))).await;
    mapping.answered(wire(frame(2))).await;
    // Sent again: answered from what is stored, so it takes no time to decide.
    mapping.answered(wire(frame(2))).await;
    mapping.refused(junk(3)).await;
    let seen = looking.answered(wire(frame(1))).await;
    let told = client.open_streams(None).await.unwrap();
    // Nobody else hears where it is: the map keeps none of its frames.
    assert_eq!(told[0].last_answer, Some(seen));
    assert_eq!(told[1].last_answer.as_ref().map(|answer| answer.sequence), Some(2));
    let counts: Vec<(u64, u64)> =
        told.iter().map(|stream| (stream.answered_frames, stream.refused_frames)).collect();
    assert_eq!(counts, [(1, 0), (3, 1)]);
    for stream in &told {
        assert!(stream.last_delay_ns.unwrap() > 0, "{stream:?}");
        assert!(stream.last_frame_time_ns.unwrap() >= stream.open_time_ns, "{stream:?}");
    }
    assert_eq!(found(&server, "/v1/streams?map=drive").await["streams"].as_array().unwrap().len(), 2);
    assert_eq!(refused(client.open_streams(Some("attic")).await).0, Code::NotFound);

    drop(looking);
    let mut left = client.open_streams(drive).await.unwrap();
    while left.len() > 1 {
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        left = client.open_streams(drive).await.unwrap();
    }
    assert_eq!(left[0].session, "maps/drive/sessions/monday");
    server.stop().await;
}

/// The command line shows both.
#[test]
fn the_command_line_shows_refusals_and_streams() {
    let waypost = CommandLine::new();
    assert!(waypost.text(&["refusals"]).contains("nothing was refused"));
    waypost.prepare();
    waypost.fails(&["map", "show", "attic"]);
    waypost.fails(&["map", "show", "attic"]);
    let text = waypost.text(&["refusals"]);
    let rows: Vec<&str> = text.lines().collect();
    assert!(
        rows.len() == 2 && rows[0].starts_with("LAST") && rows[1].contains("there is no map attic"),
        "{text}"
    );
    assert!(rows[1].contains("  2  ") && rows[1].contains("/waypost.v1.MapService/GetMap"), "{text}");
    assert_eq!(waypost.json(&["refusals"])["refusals"][0]["times"], 2);
    assert!(waypost.text(&["session", "streams"]).starts_with("SESSION"));
    assert_eq!(waypost.json(&["session", "streams"])["streams"], serde_json::json!([]));
}
