//! REST and gRPC give the same answer to the same question; health and reflection are there.

use reqwest::StatusCode;
use serde_json::{Value, json};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
use waypost_client::v1;

use crate::harness::{Server, answers, channel, first_return, frame, in_time, map_request};

/// A client that takes the direct way, whatever the environment says.
fn http() -> reqwest::Client {
    reqwest::Client::builder().no_proxy().build().unwrap()
}

async fn get(server: &Server, path: &str) -> (StatusCode, Value) {
    let response = in_time(http().get(server.url(path)).send()).await.unwrap();
    let (status, kind) = (response.status(), response.headers()["content-type"].to_str().unwrap().to_owned());
    let body = response.text().await.unwrap();
    assert!(kind.starts_with("application/json"), "{path}: {kind}: {body}");
    (status, serde_json::from_str(&body).unwrap_or_else(|error| panic!("{path}: {error}: {body}")))
}

async fn found(server: &Server, path: &str) -> Value {
    let (status, body) = get(server, path).await;
    assert_eq!(status, StatusCode::OK, "{path}: {body}");
    body
}

/// A value as it is once written and read: this reader of JSON may be a bit off in the last digit.
fn read(value: &Value) -> Value {
    serde_json::from_str(&value.to_string()).unwrap()
}

fn map_json(map: &v1::Map) -> Value {
    let settings = map.settings.as_ref().unwrap();
    let mut object = json!({
        "name": map.name,
        "model": map.model,
        "create_time_ns": map.create_time_ns,
        "places": map.places,
        "links": map.links,
        "sessions": map.sessions,
        "frames": map.frames,
        "loop_closures": map.loop_closures,
        "closure_threshold": settings.closure_threshold,
        "guard_frames": settings.guard_frames,
    });
    if !map.state_hash.is_empty() {
        object["state_hash"] = json!(map.state_hash);
    }
    object
}

fn frame_json(frame: &v1::FrameReference) -> Value {
    json!({ "session": frame.session, "sequence": frame.sequence, "stamp_ns": frame.stamp_ns })
}

fn place_json(place: &v1::Place) -> Value {
    json!({
        "name": place.name,
        "looks": place.looks,
        "words": place.words,
        "frames": place.frames.iter().map(frame_json).collect::<Vec<_>>(),
        "linked": place.linked,
    })
}

fn match_json(closure: &v1::LoopClosure) -> Value {
    json!({
        "frame": frame_json(closure.frame.as_ref().unwrap()),
        "matched_frame": frame_json(closure.matched_frame.as_ref().unwrap()),
        "place": closure.place,
        "posterior": closure.posterior,
    })
}

#[tokio::test(flavor = "multi_thread")]
async fn rest_agrees_with_grpc() {
    let (server, client) = Server::with_map().await;
    client.create_map(map_request("empty", "shipped")).await.unwrap();
    answers(&client, "drive", "first", (1..=15).map(frame)).await;
    let again = first_return();
    answers(&client, "drive", "second", (again..again + 10).map(frame)).await;

    let maps = client.maps().await.unwrap();
    let page = |items: &str, values: Vec<Value>| read(&json!({ items: values, "next_page_token": "" }));
    let all: Vec<Value> = maps.iter().map(map_json).collect();
    assert_eq!(found(&server, "/v1/maps").await, page("maps", all.clone()));
    for (name, view) in
        [("drive", v1::MapView::Full), ("empty", v1::MapView::Full), ("drive", v1::MapView::Unspecified)]
    {
        let query = if view == v1::MapView::Full { "?view=full" } else { "" };
        let over_grpc = client.map(name, view).await.unwrap();
        assert_eq!(found(&server, &format!("/v1/maps/{name}{query}")).await, read(&map_json(&over_grpc)));
    }
    assert_eq!(found(&server, "/v1/maps/drive?view=basic").await, found(&server, "/v1/maps/drive").await);

    let places: Vec<Value> = client.places("drive").await.unwrap().iter().map(place_json).collect();
    assert_eq!(found(&server, "/v1/maps/drive/places").await, page("places", places.clone()));
    let matches: Vec<Value> = client.matches("drive").await.unwrap().iter().map(match_json).collect();
    assert!(!matches.is_empty(), "no loop was closed");
    assert_eq!(found(&server, "/v1/maps/drive/matches").await, page("matches", matches));
    assert_eq!(found(&server, "/v1/maps/empty/places").await, page("places", vec![]));
    assert_eq!(found(&server, "/v1/maps/empty/matches").await, page("matches", vec![]));

    let mut paged = Vec::new();
    let mut token = String::new();
    while paged.len() < places.len() {
        let part = found(&server, &format!("/v1/maps/drive/places?page_size=4&page_token={token}")).await;
        paged.extend(part["places"].as_array().unwrap().iter().cloned());
        token = part["next_page_token"].as_str().unwrap().to_owned();
        assert_eq!(token.is_empty(), paged.len() == places.len());
    }
    assert_eq!(paged, places);
    let first = found(&server, "/v1/maps?page_size=1").await;
    let second = found(&server, "/v1/maps?page_size=1&page_token=drive").await;
    assert_eq!((&first["maps"][0], &second["maps"][0]), (&all[0], &all[1]));
    assert_eq!(
        (first["next_page_token"].as_str(), second["next_page_token"].as_str()),
        (Some("drive"), Some(""))
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rest_tells_what_is_wrong() {
    let (server, _client) = Server::with_map().await;
    let (bad, missing) = (StatusCode::BAD_REQUEST, StatusCode::NOT_FOUND);
    let cases = [
        ("/v1/maps/nowhere", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/places", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/matches", missing, "there is no map nowhere"),
        ("/v1/maps/No%20Where", bad, "is no map name"),
        ("/v1/maps/%ff", bad, ""),
        ("/v1/maps/drive?view=everything", bad, "view"),
        ("/v1/maps/drive?veiw=full", bad, "veiw"),
        ("/v1/maps?page_size=1001", bad, "at most 1000"),
        ("/v1/maps?page_size=-1", bad, "page_size"),
        ("/v1/maps?page_size=ten", bad, "page_size"),
        ("/v1/maps/drive/places?page_size=99999", bad, "at most 1000"),
        ("/v1/maps/drive/places?page_token=x", bad, "begin again without one"),
        ("/v1/maps/drive/matches?page_token=x", bad, "begin again without one"),
        ("/v1/maps/drive/matches?page_size=4294967296", bad, "page_size"),
        ("/", missing, "/v1/maps"),
        ("/v1/map", missing, "/v1/maps/{map}/places"),
        ("/v1/maps/drive/places/0/1", missing, "there is nothing here"),
    ];
    for (path, status, fragment) in cases {
        let (found, body) = get(&server, path).await;
        assert_eq!(found, status, "{path}: {body}");
        let code = if status == bad { "invalid_argument" } else { "not_found" };
        assert_eq!(body["error"]["code"], code, "{path}");
        let message = body["error"]["message"].as_str().unwrap();
        assert!(!message.is_empty() && message.contains(fragment), "{path}: {message}");
    }
    let posted = http().post(server.url("/v1/maps")).body("{}").send().await.unwrap();
    assert_eq!(posted.status(), StatusCode::METHOD_NOT_ALLOWED);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_reflection_answer() {
    let server = Server::start().await;
    let healthy = http().get(server.url("/healthz")).send().await.unwrap();
    assert_eq!(healthy.status(), StatusCode::OK);
    assert_eq!(healthy.text().await.unwrap(), "ok\n");

    let mut health = HealthClient::new(channel(&server.endpoint()).await);
    for service in ["", "waypost.v1.SessionService"] {
        let request = HealthCheckRequest { service: service.to_owned() };
        let answer = health.check(request).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service:?}");
    }

    let mut reflection = ServerReflectionClient::new(channel(&server.endpoint()).await);
    let ask = |asked| ServerReflectionRequest { host: String::new(), message_request: Some(asked) };
    let requests = [
        ask(MessageRequest::ListServices(String::new())),
        ask(MessageRequest::FileContainingSymbol("waypost.v1.SessionService".to_owned())),
    ];
    let mut answers =
        reflection.server_reflection_info(futures::stream::iter(requests)).await.unwrap().into_inner();
    let answer = in_time(answers.message()).await.unwrap().unwrap().message_response;
    let Some(MessageResponse::ListServicesResponse(services)) = answer else { panic!("{answer:?}") };
    let mut names: Vec<String> = services.service.into_iter().map(|service| service.name).collect();
    names.retain(|name| name.starts_with("waypost."));
    names.sort();
    let expected = ["JobService", "MapService", "ModelService", "SessionService"];
    assert_eq!(names, expected.map(|name| format!("waypost.v1.{name}")));
    let answer = in_time(answers.message()).await.unwrap().unwrap().message_response;
    let Some(MessageResponse::FileDescriptorResponse(file)) = answer else { panic!("{answer:?}") };
    assert!(!file.file_descriptor_proto.is_empty());
    server.stop().await;
}
