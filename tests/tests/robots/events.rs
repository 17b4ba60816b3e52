//! What happens in a map is told to those who watch it.

use std::time::Duration;

use waypost_client::v1::map_event::Event;
use waypost_client::{
    Client, ClientOptions, Code, Error, FrameInput, MapEvents, NavigationOptions, Reconnection, Watched, v1,
};

use crate::harness::{
    Answer, Proxy, Server, answers, as_words, assert_status, by_words_request, followed, frame, get, http,
    import_model, in_time, refused,
};

/// A frame of a robot that drives half a metre between two.
fn driven(sequence: u64) -> FrameInput {
    let pose = v1::Pose {
        position_m: Some(v1::Vector3 { x: 0.5 * sequence as f64, y: 0.0, z: 0.0 }),
        orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
    };
    let odometry = Some(v1::Odometry { pose: Some(pose), covariance: Vec::new() });
    FrameInput { odometry, note: format!("{sequence}.jpg"), ..frame(sequence) }
}

async fn next(events: &mut MapEvents) -> Event {
    in_time(events.next()).await.unwrap().event.unwrap()
}

async fn next_frame(events: &mut MapEvents) -> v1::DecidedFrame {
    match next(events).await {
        Event::Frame(frame) => frame,
        other => panic!("{other:?}"),
    }
}

fn numbers(frames: &[v1::DecidedFrame]) -> Vec<u64> {
    frames.iter().map(|frame| frame.frame.as_ref().unwrap().answer.as_ref().unwrap().sequence).collect()
}

async fn frames(events: &mut MapEvents, count: usize) -> Vec<v1::DecidedFrame> {
    let mut frames = Vec::new();
    for _ in 0..count {
        frames.push(next_frame(events).await);
    }
    frames
}

/// How a watch ends.
async fn end(events: &mut MapEvents) -> (Code, String) {
    refused(in_time(events.next()).await)
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_told_from_a_position_on_and_as_they_come() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=5).map(driven)).await;
    let mut all = client.watch_map("drive", Some(0)).await.unwrap();
    let mut new = client.watch_map("drive", None).await.unwrap();
    let told = frames(&mut all, 5).await;
    assert_eq!(numbers(&told), [1, 2, 3, 4, 5]);
    assert!(told.windows(2).all(|pair| pair[0].position < pair[1].position), "{told:?}");
    // As the list has it, and where the map has the robot now.
    let listed = client.frames("maps/drive/sessions/robot").await.unwrap();
    for (told, listed) in told.iter().zip(&listed) {
        let mut frame = told.frame.clone().unwrap();
        let pose = frame.answer.as_mut().unwrap().map_pose.take().unwrap();
        let x_m = pose.robot.unwrap().position_m.unwrap().x;
        let driven_m = 0.5 * (listed.answer.as_ref().unwrap().sequence - 1) as f64;
        assert!((x_m - driven_m).abs() < 0.3, "{x_m} for {driven_m}");
        assert_eq!(&frame, listed);
    }

    let mut later = client.watch_map("maps/drive", Some(told[2].position + 1)).await.unwrap();
    assert_eq!(numbers(&frames(&mut later, 2).await), [4, 5]);
    answers(&client, "drive", "other", (6..=7).map(driven)).await;
    for watch in [&mut all, &mut new, &mut later] {
        let told = frames(watch, 2).await;
        assert_eq!(numbers(&told), [6, 7]);
        assert_eq!(told[0].frame.as_ref().unwrap().name, "maps/drive/sessions/other/frames/6");
    }

    let beyond = refused(client.watch_map("drive", Some(1000)).await);
    assert_status("beyond", (beyond.0, &beyond.1), Code::FailedPrecondition, "no position 1000");
    assert_eq!(refused(client.watch_map("nowhere", None).await).0, Code::NotFound);
    // Positions mean something else then.
    let job = client.delete_session("maps/drive/sessions/other").await.unwrap();
    followed(&client, &job).await;
    let (code, message) = end(&mut new).await;
    assert_status("removed", (code, &message), Code::Aborted, "watch it again");
    let mut again = client.watch_map("drive", None).await.unwrap();
    client.delete_map("drive").await.unwrap();
    assert_eq!(end(&mut again).await.0, Code::NotFound);
    server.stop().await;
}

/// Whoever is slow is served from the log.
#[tokio::test(flavor = "multi_thread")]
async fn who_does_not_read_misses_nothing_and_holds_up_nobody() {
    const FRAMES: u64 = 90;
    let (server, client) = Server::with_map_of_words().await;
    let mut slow = client.watch_map("drive", Some(0)).await.unwrap();
    answers(&client, "drive", "robot", (1..=FRAMES).map(as_words)).await;
    let told = frames(&mut slow, FRAMES as usize).await;
    assert_eq!(numbers(&told), (1..=FRAMES).collect::<Vec<_>>());
    // Without odometry nobody knows where.
    assert!(told.iter().all(|told| told.frame.as_ref().unwrap().answer.as_ref().unwrap().map_pose.is_none()));
    server.stop().await;
}

/// Neither a broken connection nor a server that starts again loses a frame for whoever watches, or tells one twice.
#[tokio::test(flavor = "multi_thread")]
async fn a_watch_goes_on_over_another_connection() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    let proxy = Proxy::start().await;
    proxy.forward_to(Some(server.grpc()));
    let watching = Client::connect(&ClientOptions::new(proxy.endpoint())).await.unwrap();
    // Nothing was decided yet: where the log ended is all that it has to go on from.
    let mut new = watching.watch_map("drive", None).await.unwrap();
    let mut all = watching.watch_map("drive", Some(0)).await.unwrap();
    let started = tokio::time::timeout(Duration::from_millis(500), new.next()).await;
    assert!(started.is_err(), "{started:?}");
    proxy.cut();
    answers(&client, "drive", "robot", (1..=3).map(as_words)).await;
    for watch in [&mut new, &mut all] {
        assert_eq!(numbers(&frames(watch, 3).await), [1, 2, 3]);
    }
    proxy.forward_to(None);
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    answers(&server.client().await, "drive", "robot", (4..=5).map(as_words)).await;
    proxy.forward_to(Some(server.grpc()));
    for watch in [&mut new, &mut all] {
        assert_eq!(numbers(&frames(watch, 2).await), [4, 5]);
    }
    // Not for ever.
    let short = Reconnection { give_up_after: Duration::from_millis(300), ..Reconnection::default() };
    let mut new = new.with_reconnection(short);
    proxy.forward_to(None);
    server.stop().await;
    assert!(matches!(in_time(new.next()).await, Err(Error::Connection { .. })));
}

/// Whoever is away while sessions are removed hears of it, and is not told the wrong frames.
#[tokio::test(flavor = "multi_thread")]
async fn a_watch_does_not_go_on_in_another_log() {
    let (server, client) = Server::with_map_of_words().await;
    answers(&client, "drive", "first", (1..=4).map(as_words)).await;
    let proxy = Proxy::start().await;
    proxy.forward_to(Some(server.grpc()));
    let watching = Client::connect(&ClientOptions::new(proxy.endpoint())).await.unwrap();
    let mut events = watching.watch_map("drive", Some(0)).await.unwrap();
    assert_eq!(numbers(&frames(&mut events, 4).await), [1, 2, 3, 4]);
    proxy.forward_to(None);
    proxy.cut();
    let broken = in_time(events.next_or_break()).await.unwrap();
    assert!(matches!(broken, Watched::Disconnected { .. }), "{broken:?}");
    answers(&client, "drive", "second", (5..=9).map(as_words)).await;
    let job = client.delete_session("maps/drive/sessions/first").await.unwrap();
    followed(&client, &job).await;
    proxy.forward_to(Some(server.grpc()));
    let (code, message) = end(&mut events).await;
    assert_status("another log", (code, &message), Code::Aborted, "watch it again");

    // One that is the same goes on, and says that it does.
    let mut events = watching.watch_map("drive", Some(0)).await.unwrap();
    assert_eq!(numbers(&frames(&mut events, 5).await), [5, 6, 7, 8, 9]);
    proxy.cut();
    assert!(matches!(in_time(events.next_or_break()).await, Ok(Watched::Disconnected { .. })));
    assert_eq!(in_time(events.next_or_break()).await.unwrap(), Watched::Reconnected);
    server.stop().await;
}

async fn next_navigation(events: &mut MapEvents) -> v1::Navigation {
    match next(events).await {
        Event::Navigation(navigation) => navigation,
        other => panic!("{other:?}"),
    }
}

async fn led(client: &Client) -> waypost_client::Navigation {
    let field = v1::FieldOfView { horizontal_rad: 1.0 };
    let camera = v1::Camera { model: Some(v1::camera::Model::FieldOfView(field)), ..v1::Camera::default() };
    let goal = v1::Goal { target: Some(v1::goal::Target::PlaceNumber(1)) };
    let options = NavigationOptions::new("drive", camera);
    let options = NavigationOptions { navigation_id: "robot".to_owned(), goal: Some(goal), ..options };
    client.navigate(options).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_are_told_when_their_state_changes() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "teacher", (1..=5).map(driven)).await;
    let mut events = client.watch_map("drive", None).await.unwrap();
    let navigation = led(&client).await;
    let told = next_navigation(&mut events).await;
    assert_eq!((told.name.as_str(), told.connected), ("maps/drive/navigations/robot", true));
    assert_eq!(told.goal, Some(v1::Goal { target: Some(v1::goal::Target::PlaceNumber(1)) }));
    assert_eq!(told.route, None);
    client.cancel_goal(&told.name).await.unwrap();
    assert_eq!(next_navigation(&mut events).await.goal, None);
    drop(navigation);
    let gone = next_navigation(&mut events).await;
    assert!(!gone.connected, "{gone:?}");
    server.stop().await;
}

/// What comes of a request for events, until it holds `expected`.
async fn sent(request: reqwest::RequestBuilder, expected: &str) -> String {
    let mut response = in_time(request.send()).await.unwrap();
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "text/event-stream");
    let mut text = String::new();
    while !text.contains(expected) {
        let chunk = in_time(response.chunk()).await.unwrap();
        let chunk = chunk.unwrap_or_else(|| panic!("the events ended without {expected:?}: {text}"));
        text.push_str(std::str::from_utf8(&chunk).unwrap());
    }
    text
}

#[tokio::test(flavor = "multi_thread")]
async fn browsers_get_server_sent_events_and_go_on_where_they_were() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=3).map(driven)).await;
    let url = server.url("/v1/maps/drive/events");
    let text = sent(http().get(format!("{url}?from_position=0")), "\"note\":\"3.jpg\"").await;
    assert!(text.starts_with("event: started\n"), "{text}");
    let ids: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("id: ")).collect();
    // Of the start, and of each frame.
    assert_eq!(ids.len(), 4, "{text}");
    assert_eq!(text.matches("event: frame").count(), 3, "{text}");
    let data = text.lines().filter_map(|line| line.strip_prefix("data: ")).nth(1).unwrap();
    let data: serde_json::Value = serde_json::from_str(data).unwrap();
    assert_eq!(data["frame"]["frame"]["name"], "maps/drive/sessions/robot/frames/1");
    assert_eq!(data["navigation"], serde_json::Value::Null);
    let next_position = data["frame"]["position"].as_u64().unwrap() + 1;
    assert!(ids[1].ends_with(&format!("-{next_position}")), "{text}");

    let behind = |id: &str| http().get(&url).header("last-event-id", id);
    let text = sent(behind(ids[2]), "event: frame").await;
    assert!(text.contains("\"note\":\"3.jpg\"") && !text.contains("2.jpg"), "{text}");
    // Once a session is removed, positions mean something else.
    answers(&client, "drive", "other", (1..=2).map(driven)).await;
    let job = client.delete_session("maps/drive/sessions/other").await.unwrap();
    followed(&client, &job).await;
    let stale = Answer::to(behind(ids[2])).await;
    assert_eq!(stale.status, 409, "{}", stale.text());
    assert!(stale.text().contains("watch it again"), "{}", stale.text());
    let deleted = sent(http().get(&url), "event: error");
    let (text, ()) = tokio::join!(deleted, async {
        tokio::time::sleep(std::time::Duration::from_millis(300)).await;
        client.delete_map("drive").await.unwrap();
    });
    assert!(text.contains("event: error"), "{text}");
    for (path, status, fragment) in [
        ("/v1/maps/nowhere/events", 404, "there is no map nowhere"),
        ("/v1/maps/drive/events?from=1", 400, "from_position=NUMBER"),
    ] {
        let answer = get(&server, path).await;
        assert_eq!(answer.status.as_u16(), status, "{path}");
        assert!(answer.text().contains(fragment), "{}", answer.text());
    }
    for wrong in ["x", "7", "-7", "x-y"] {
        assert_eq!(Answer::to(behind(wrong)).await.status, 400, "{wrong}");
    }
    server.stop().await;
}
