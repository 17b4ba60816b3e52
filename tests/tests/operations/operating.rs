//! What an operator sees and relies on: health, metrics, log, limits, the end.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use reqwest::StatusCode;
use serde_json::Value;
use tonic::Request;
use waypost_client::Code;
use waypost_proto::v1;
use waypost_proto::v1::map_service_client::MapServiceClient;

use crate::harness::{
    RawStream, Server, ServerProcess, answers, channel, frame, http, import_model, map_request, open, wire,
};

/// Metrics as Prometheus reads them: name with labels, and value. Every line must be one, or a comment.
async fn metrics(server: &Server) -> BTreeMap<String, f64> {
    let response = http().get(server.url("/metrics")).send().await.unwrap();
    assert_eq!(response.status(), StatusCode::OK);
    assert!(response.headers()["content-type"].to_str().unwrap().starts_with("text/plain; version=0.0.4"));
    let text = response.text().await.unwrap();
    let (mut values, mut described) = (BTreeMap::new(), Vec::new());
    for line in text.lines().filter(|line| !line.is_empty()) {
        if let Some(comment) = line.strip_prefix("# ") {
            if let Some(help) = comment.strip_prefix("HELP ") {
                described.push(help.split(' ').next().unwrap().to_owned());
            }
            continue;
        }
        let (name, value) = line.rsplit_once(' ').unwrap_or_else(|| panic!("no metric: {line}"));
        let value = value.parse().unwrap_or_else(|error| panic!("{line}: {error}"));
        assert!(values.insert(name.to_owned(), value).is_none(), "twice: {line}");
        let bare = name.split('{').next().unwrap();
        let of = |suffix: &str| bare.strip_suffix(suffix).unwrap_or(bare).to_owned();
        let is_described =
            [of(""), of("_bucket"), of("_sum"), of("_count")].iter().any(|name| described.contains(name));
        assert!(name.starts_with("waypost_") && is_described, "{name} is not described");
    }
    values
}

fn sum(metrics: &BTreeMap<String, f64>, name: &str) -> f64 {
    let of = |key: &str| key == name || key.strip_prefix(name).is_some_and(|rest| rest.starts_with('{'));
    metrics.iter().filter(|(key, _)| of(key)).map(|(_, value)| value).sum()
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_count_what_was_streamed() {
    let (server, client) = Server::with_map().await;
    let before = metrics(&server).await;
    assert_eq!((sum(&before, "waypost_frames_total"), before["waypost_open_streams"]), (0.0, 0.0));

    let answered = answers(&client, "drive", "first", (1..=6).map(frame)).await;
    let mut by_reason: BTreeMap<String, f64> = BTreeMap::new();
    for answer in &answered {
        let reason = answer.reason().as_str_name().trim_start_matches("REASON_").to_lowercase();
        *by_reason.entry(reason).or_default() += 1.0;
    }
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "second")).await.unwrap();
    let taken = raw.answered(wire(frame(1))).await;
    *by_reason
        .entry(taken.reason().as_str_name().trim_start_matches("REASON_").to_lowercase())
        .or_default() += 1.0;
    raw.answered(wire(frame(1))).await;
    let unreadable = v1::frame::Content::Image(b"no image".to_vec());
    raw.refused(v1::Frame { content: Some(unreadable), ..wire(frame(2)) }).await;

    let during = metrics(&server).await;
    by_reason.insert("resent".to_owned(), 1.0);
    by_reason.insert("invalid_argument".to_owned(), 1.0);
    for (outcome, count) in &by_reason {
        assert_eq!(during[&format!("waypost_frames_total{{outcome=\"{outcome}\"}}")], *count, "{outcome}");
    }
    assert_eq!(sum(&during, "waypost_frames_total"), by_reason.values().sum::<f64>());
    for stage in
        ["extract", "quantize", "likelihood", "new_place", "filter", "verification", "commit", "total"]
    {
        let timed = format!("waypost_frame_duration_seconds_count{{stage=\"{stage}\"}}");
        assert_eq!(during[&timed], 7.0, "{stage}: answers from the store took no stage");
        let seconds = during[&format!("waypost_frame_duration_seconds_sum{{stage=\"{stage}\"}}")];
        assert!((0.0..60.0 * 7.0).contains(&seconds), "{stage}: {seconds} s");
    }
    assert_eq!(during["waypost_commit_frames_sum"], 7.0);
    assert_eq!((during["waypost_open_streams"], during["waypost_open_maps"]), (1.0, 1.0));
    assert_eq!(during["waypost_jobs_running"], 0.0);
    assert!(during["waypost_database_bytes"] >= 4096.0);
    let streams = "waypost_grpc_requests_total{method=\"/waypost.v1.SessionService/Stream\",code=\"ok\"}";
    assert_eq!(during[streams], 1.0);
    let created = "waypost_grpc_requests_total{method=\"/waypost.v1.MapService/CreateMap\",code=\"ok\"}";
    assert_eq!(during[created], 1.0);
    assert_eq!(during["waypost_http_requests_total{method=\"GET\",route=\"/metrics\",code=\"200\"}"], 1.0);

    drop(raw);
    let closed = async || metrics(&server).await["waypost_open_streams"] == 0.0;
    let deadline = Instant::now() + Duration::from_secs(30);
    while !closed().await {
        assert!(Instant::now() < deadline, "the stream that was dropped is still open");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    for path in ["/v1/maps/drive", "/v1/maps/nowhere", "/no/such/path"] {
        http().get(server.url(path)).send().await.unwrap();
    }
    let after = metrics(&server).await;
    let by_route = |route: &str, code: u16| {
        let name = "waypost_http_requests_total";
        after[&format!("{name}{{method=\"GET\",route=\"{route}\",code=\"{code}\"}}")]
    };
    // By route, not by path: names of maps must not make metrics.
    assert_eq!((by_route("/v1/maps/{map}", 200), by_route("/v1/maps/{map}", 404)), (1.0, 1.0));
    assert_eq!(by_route("unknown", 404), 1.0);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn health_and_readiness_are_open_and_short() {
    let server = Server::start().await;
    for (path, expected) in [("/healthz", "ok\n"), ("/readyz", "ready\n")] {
        let response = http().get(server.url(path)).send().await.unwrap();
        assert_eq!(response.status(), StatusCode::OK, "{path}");
        assert_eq!(response.text().await.unwrap(), expected, "{path}");
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_is_known_by_its_id_from_answer_to_log() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start_with(directory.path(), &["--log-format", "json"]);
    let url = |path: &str| format!("http://{}{path}", server.http());
    let get = async |path: &str, id: &str| {
        let response = http().get(url(path)).header("x-request-id", id).send().await.unwrap();
        response.headers()["x-request-id"].to_str().unwrap().to_owned()
    };
    assert_eq!(get("/v1/maps/nowhere", "mine-over-http:1").await, "mine-over-http:1");
    for bad in ["with space", &"x".repeat(65)] {
        let made = get("/v1/maps", bad).await;
        assert!(made != bad && made.len() == 16, "{bad:?} gave {made:?}");
    }
    let mut maps = MapServiceClient::new(channel(&server.endpoint()).await);
    let with_id = |name: &str, id: &str| {
        let mut request = Request::new(v1::GetMapRequest { name: name.to_owned(), view: 0 });
        request.metadata_mut().insert("x-request-id", id.parse().unwrap());
        request
    };
    let status = maps.get_map(with_id("maps/nowhere", "mine-over-grpc:1")).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert_eq!(status.metadata().get("x-request-id").unwrap(), "mine-over-grpc:1");
    let listed = maps.list_maps(v1::ListMapsRequest::default()).await.unwrap();
    assert_eq!(listed.metadata().get("x-request-id").unwrap().len(), 16);

    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let log = server.log();
    server.stop();
    let lines: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let of = |id: &str| {
        let of_request = |line: &&Value| line["span"]["request_id"] == id;
        lines.iter().filter(of_request).map(|line| line["fields"].clone()).collect::<Vec<_>>()
    };
    let over_http = &of("mine-over-http:1")[..];
    assert_eq!(over_http.len(), 1, "{log}");
    assert_eq!(over_http[0]["message"], "answered");
    let request = (&over_http[0]["method"], &over_http[0]["path"], &over_http[0]["status"]);
    assert_eq!(request, (&"GET".into(), &"/v1/maps/nowhere".into(), &404.into()));
    assert!(over_http[0]["duration_ms"].as_f64().is_some_and(|ms| ms > 0.0));
    let over_grpc = &of("mine-over-grpc:1")[..];
    let request = (&over_grpc[0]["method"], &over_grpc[0]["path"], &over_grpc[0]["status"]);
    let expected = (&"gRPC".into(), &"/waypost.v1.MapService/GetMap".into(), &"not_found".into());
    assert_eq!((over_grpc.len(), request), (1, expected));
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_are_told_nothing() {
    let (server, _client) = Server::with_map().await;
    let origin = ("origin", "https://elsewhere.example");
    for path in ["/healthz", "/metrics", "/v1/maps", "/v1/maps/drive", "/v1/nowhere"] {
        let asked = [
            http().get(server.url(path)).header(origin.0, origin.1),
            http()
                .request(reqwest::Method::OPTIONS, server.url(path))
                .header(origin.0, origin.1)
                .header("access-control-request-method", "GET"),
        ];
        for request in asked {
            let response = request.send().await.unwrap();
            let names = response.headers().keys().map(|name| name.as_str().to_owned());
            let told: Vec<String> = names.filter(|name| name.starts_with("access-control-")).collect();
            assert!(told.is_empty(), "{path}: {told:?}");
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn headers_have_a_limit() {
    let server = Server::start().await;
    let large = "x".repeat(40 << 10);
    let response = http().get(server.url("/healthz")).header("x-large", &large).send().await.unwrap();
    assert_eq!(response.status(), StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE);
    let mut maps = MapServiceClient::new(channel(&server.endpoint()).await);
    let mut request = Request::new(v1::ListMapsRequest::default());
    request.metadata_mut().insert("x-large", large.parse().unwrap());
    assert!(maps.list_maps(request).await.is_err());
    // The connection is not lost for that.
    assert!(maps.list_maps(v1::ListMapsRequest::default()).await.is_ok());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn asked_twice_to_stop_it_stops_at_once() {
    let directory = tempfile::tempdir().unwrap();
    let mut server = ServerProcess::start(directory.path());
    // Half a request holds up a stop until it is cut.
    let mut connection = TcpStream::connect(server.http()).unwrap();
    connection.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\n").unwrap();
    // Once this is answered, the server has begun with the other; on a machine that is busy, a little later.
    assert_eq!(http().get(format!("http://{}/healthz", server.http())).send().await.unwrap().status(), 200);
    tokio::time::sleep(Duration::from_millis(500)).await;
    server.ask_to_stop();
    let asked = Instant::now();
    while !server.log().contains("stopping") {
        assert!(asked.elapsed() < Duration::from_secs(30), "{}", server.log());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let status = server.terminate(Duration::from_secs(30)).unwrap();
    assert_eq!(status.code(), Some(1), "{}", server.log());
    assert!(server.log().contains("ending at once"), "{}", server.log());
    let mut rest = Vec::new();
    let _ = connection.read_to_end(&mut rest);
    assert!(rest.is_empty(), "half a request was answered");
}
