//! REST beside what gRPC says too: errors, headers, pages for people; health and reflection.

use reqwest::{Method, StatusCode};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

use crate::harness::{Answer, Server, Surveyed, answers, channel, found, frame, get, http, images, in_time};

#[tokio::test(flavor = "multi_thread")]
async fn rest_tells_what_is_wrong() {
    let (server, _client) = Server::with_map().await;
    let (bad, missing) = (StatusCode::BAD_REQUEST, StatusCode::NOT_FOUND);
    let cases = [
        ("/v1/maps/nowhere", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/places", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/loop-closures", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/loop-closures.csv", missing, "there is no map nowhere"),
        ("/v1/maps/nowhere/posteriors.json", missing, "there is no map nowhere"),
        ("/v1/maps/drive/places/0", missing, "list its places"),
        ("/v1/maps/drive/places/-1", bad, "places/NUMBER"),
        ("/v1/maps/drive/places/first", bad, "places/NUMBER"),
        ("/v1/maps/drive/words/0/places", StatusCode::OK, ""),
        ("/v1/maps/drive/words/99999/places", bad, "there is no word 99999"),
        ("/v1/maps/drive/words/-1/places", bad, "-1"),
        ("/v1/maps/drive/words/4294967296/places", bad, "4294967296"),
        ("/v1/maps/drive/sessions/none", missing, "list its sessions"),
        ("/v1/maps/drive/sessions/none/frames", missing, "list its sessions"),
        ("/v1/maps/drive/sessions/none/frames/1", missing, "list its sessions"),
        ("/v1/maps/drive/sessions/none/frames/one", bad, "sequence number"),
        ("/v1/maps/drive/sessions/none/frames/1/image", missing, "list its sessions"),
        ("/v1/maps/drive/sessions/none/frames/1/image?size=huge", bad, "original or thumbnail"),
        ("/v1/maps/drive/sessions/none/frames/1/explanation?place_number=-1", bad, "place_number=NUMBER"),
        ("/v1/maps/drive/sessions/none/frames/1/explanation?max_words=101", bad, "at most 100"),
        ("/v1/maps/No%20Where", bad, "is no map name"),
        ("/v1/maps/a%2Fplaces%2F1/places", bad, "is no name here"),
        ("/v1/maps/%ff", bad, "percent-encoded"),
        ("/v1/maps/drive?view=everything", bad, "view=full"),
        ("/v1/maps/drive?veiw=full", bad, "view=full"),
        ("/v1/maps/drive?view=full&view=full", bad, "view"),
        ("/v1/maps/drive/loop-closures.csv?page_size=1", bad, "no parameters"),
        ("/v1/maps?page_size=1001", bad, "at most 1000"),
        ("/v1/maps?page_size=-1", bad, "page_size=NUMBER"),
        ("/v1/maps?page_size=ten", bad, "page_size=NUMBER"),
        ("/v1/maps/drive/places?page_size=99999", bad, "at most 1000"),
        ("/v1/maps/drive/places?page_token=x", bad, "begin again without one"),
        ("/v1/maps/drive/loop-closures?page_token=x", bad, "begin again without one"),
        ("/v1/maps/drive/loop-closures?page_size=4294967296", bad, "page_size=NUMBER"),
        ("/v1/models/nothing", missing, "list the models"),
        ("/v1/jobs/1", missing, "there is no job"),
        ("/inspector", missing, "/docs"),
        ("/inspector/no-such-file.js", missing, "/docs"),
        ("/v1", missing, "/v1/maps"),
        ("/v1/map", missing, "/docs"),
        ("/docs/no-such-file.js", missing, "/docs"),
        ("/v1/maps/drive/places/0/1", missing, "there is nothing here"),
    ];
    for (path, status, fragment) in cases {
        let answer = get(&server, path).await;
        assert_eq!(answer.status, status, "{path}: {}", answer.text());
        if status != StatusCode::OK {
            let code = if status == bad { "invalid_argument" } else { "not_found" };
            assert_error(path, &answer, code, fragment);
        }
    }
    server.stop().await;
}

/// Whether an answer is an error in our form, of this code, that says this.
#[track_caller]
fn assert_error(case: &str, answer: &Answer, code: &str, fragment: &str) {
    let body = answer.json();
    assert_eq!(body["error"]["code"], code, "{case}: {body}");
    let message = body["error"]["message"].as_str().unwrap();
    assert!(
        !message.is_empty() && message.contains(fragment),
        "{case}: {message:?} does not say {fragment:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn other_methods_are_refused_and_the_right_ones_named() {
    let (server, _client) = Server::with_map().await;
    let cases = [
        (Method::PUT, "/v1/maps", "GET,HEAD,POST"),
        (Method::PUT, "/v1/maps/drive", "GET,HEAD,DELETE"),
        (Method::DELETE, "/v1/maps/drive/places", "GET,HEAD"),
        (Method::GET, "/v1/maps/drive/import", "POST"),
        (Method::PUT, "/v1/maps/drive/loop-closures.csv", "GET,HEAD"),
        (Method::GET, "/v1/maps/drive/query", "POST"),
        (Method::POST, "/v1/maps/drive/navigations/robot/goal", "PUT,DELETE"),
        (Method::PATCH, "/v1/openapi.json", "GET,HEAD"),
        (Method::POST, "/", "GET,HEAD"),
    ];
    for (method, path, allowed) in cases {
        let answer = Answer::to(http().request(method.clone(), server.url(path)).body("{}")).await;
        assert_eq!(answer.status, StatusCode::METHOD_NOT_ALLOWED, "{method} {path}");
        assert_eq!(answer.header("allow"), allowed, "{method} {path}");
        assert_error(path, &answer, "method_not_allowed", "Allow");
    }
    let head = Answer::to(http().head(server.url("/v1/maps/drive"))).await;
    assert_eq!((head.status, head.body.len()), (StatusCode::OK, 0));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn queries_that_make_no_sense_are_refused() {
    let Surveyed { server, words_hash, .. } = Surveyed::start().await;
    let before = found(&server, "/v1/maps/drive?view=full").await;
    let json = |body: &str| ("application/json", body.replace("HASH", &words_hash).into_bytes());
    let image = images()[0].clone();
    let (bad, too_large) = (StatusCode::BAD_REQUEST, StatusCode::PAYLOAD_TOO_LARGE);
    let cases = [
        ("no type", ("", image.clone()), StatusCode::UNSUPPORTED_MEDIA_TYPE, "send image/jpeg"),
        ("text", ("text/plain", image.clone()), StatusCode::UNSUPPORTED_MEDIA_TYPE, "send image/jpeg"),
        ("no image", ("image/jpeg", Vec::new()), bad, "send"),
        ("half an image", ("image/jpeg", image[..image.len() / 3].to_vec()), bad, "send"),
        ("image too large", ("image/jpeg", vec![0; (4 << 20) + 1]), bad, "4"),
        ("body too large", ("image/jpeg", vec![0; (16 << 20) + 1]), too_large, "send a smaller image"),
        ("no JSON", json("{"), bad, "send words_hash"),
        ("no hash", json(r#"{"histogram": {"words": [1]}}"#), bad, "words_hash"),
        ("no words", json(r#"{"words_hash": "HASH"}"#), bad, "send a histogram or words"),
        (
            "both",
            json(
                r#"{"words_hash": "HASH", "histogram": {"words": [1]}, "words": {"words": [], "x_px": [], "y_px": [],
                "image_width_px": 1, "image_height_px": 1}}"#,
            ),
            bad,
            "not both",
        ),
        (
            "unknown",
            json(r#"{"words_hash": "HASH", "histogram": {"words": [1]}, "image": ""}"#),
            bad,
            "image",
        ),
        ("negative", json(r#"{"words_hash": "HASH", "histogram": {"words": [-1]}}"#), bad, "-1"),
        ("no such word", json(r#"{"words_hash": "HASH", "histogram": {"words": [3000]}}"#), bad, "3000"),
        ("repeated", json(r#"{"words_hash": "HASH", "histogram": {"words": [1, 1]}}"#), bad, "1"),
        (
            "counts",
            json(r#"{"words_hash": "HASH", "histogram": {"words": [1], "counts": [1, 2]}}"#),
            bad,
            "counts",
        ),
        (
            "other words",
            json(r#"{"words_hash": "0f", "histogram": {"words": [1]}}"#),
            StatusCode::CONFLICT,
            "0f",
        ),
    ];
    for (case, (kind, body), status, fragment) in cases {
        let request = http().post(server.url("/v1/maps/drive/query")).body(body);
        let answer =
            Answer::to(if kind.is_empty() { request } else { request.header("content-type", kind) }).await;
        assert_eq!(answer.status, status, "{case}: {}", answer.text());
        let code = match status {
            StatusCode::PAYLOAD_TOO_LARGE => "payload_too_large",
            StatusCode::UNSUPPORTED_MEDIA_TYPE => "unsupported_media_type",
            StatusCode::CONFLICT => "failed_precondition",
            _ => "invalid_argument",
        };
        assert_error(case, &answer, code, fragment);
    }
    let request = http().post(server.url("/v1/maps/drive/query?explained_words=101"));
    let answer = Answer::to(request.header("content-type", "image/jpeg").body(image)).await;
    assert_error("explained", &answer, "invalid_argument", "at most 100");
    assert_eq!(found(&server, "/v1/maps/drive?view=full").await, before, "a query changed the map");
    server.stop().await;
}

/// Of every route that takes a body, besides uploads.
#[tokio::test(flavor = "multi_thread")]
async fn a_body_that_is_too_large_is_told_so_whatever_it_says() {
    const MOST_BYTES: usize = 5 << 20;
    let Surveyed { server, .. } = Surveyed::start().await;
    let routes = [
        (Method::POST, "/v1/maps"),
        (Method::PUT, "/v1/maps/drive/places/0/label"),
        (Method::PUT, "/v1/models/shipped/display-name"),
        (Method::POST, "/v1/maps/drive/corrections"),
        (Method::PUT, "/v1/maps/drive/navigations/cart/goal"),
        (Method::POST, "/v1/merges"),
        (Method::PUT, "/v1/merges/1/decision"),
        (Method::POST, "/v1/tokens"),
        (Method::POST, "/v1/tokens/cart/rotate"),
        (Method::PATCH, "/v1/tokens/cart"),
    ];
    for (method, path) in routes {
        let of_bytes = |bytes: usize| {
            let body = [&b"{}"[..], &vec![b' '; bytes - 2]].concat();
            http()
                .request(method.clone(), server.url(path))
                .header("content-type", "application/json")
                .body(body)
        };
        let answer = Answer::to(of_bytes(MOST_BYTES + 1)).await;
        assert_eq!(answer.status, StatusCode::PAYLOAD_TOO_LARGE, "{method} {path}: {}", answer.text());
        assert_error(path, &answer, "payload_too_large", "at most 5242880 bytes");
        // As large as may be, it is read, and then refused for what it says or names.
        let answer = Answer::to(of_bytes(MOST_BYTES)).await;
        let refused = [StatusCode::BAD_REQUEST, StatusCode::NOT_FOUND];
        assert!(refused.contains(&answer.status), "{method} {path}: {}", answer.text());
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_image_is_sent_once_to_those_who_keep_it() {
    let Surveyed { server, .. } = Surveyed::start().await;
    let path = "/v1/maps/drive/sessions/first/frames/1/image";
    let original = get(&server, path).await;
    assert_eq!(original.status, StatusCode::OK);
    assert!(original.body == images()[0], "the image is not the one that was sent");
    assert_eq!(original.header("content-type"), "image/jpeg");
    assert_eq!(original.header("x-content-type-options"), "nosniff");
    let tag = original.header("etag").to_owned();
    let ask = async |path: &str, tag: &str| {
        Answer::to(http().get(server.url(path)).header("if-none-match", tag)).await
    };
    let again = ask(path, &tag).await;
    assert_eq!((again.status, again.body.len()), (StatusCode::NOT_MODIFIED, 0));
    assert_eq!(again.header("etag"), tag);
    let thumbnail = ask(&format!("{path}?size=thumbnail"), &tag).await;
    assert_eq!(thumbnail.status, StatusCode::OK);
    assert!(thumbnail.body.len() < original.body.len() && thumbnail.header("etag") != tag);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn pages_for_people_load_nothing_from_elsewhere() {
    let server = Server::start().await;
    let start = get(&server, "/").await;
    let docs = get(&server, "/docs").await;
    for (path, page) in [("/", &start), ("/docs", &docs)] {
        assert_eq!(page.status, StatusCode::OK, "{path}");
        assert!(page.header("content-type").starts_with("text/html"), "{path}: {:?}", page.headers);
        assert_strict(path, page.header("content-security-policy"));
        assert_eq!(page.header("x-content-type-options"), "nosniff", "{path}");
    }
    assert!(!start.text().contains("http"), "{}", start.text());
    for file in ["swagger-ui.css", "swagger-ui-bundle.js", "swagger-initializer.js"] {
        assert_eq!(get(&server, &format!("/docs/{file}")).await.status, StatusCode::OK, "{file}");
    }
    let initializer = get(&server, "/docs/swagger-initializer.js").await;
    assert!(initializer.text().contains("\"/v1/openapi.json\""), "{}", initializer.text());
    assert!(!initializer.text().contains("http"), "{}", initializer.text());
    server.stop().await;
}

/// Text is compressed for those who ask for that, and for nobody else.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_text_is_compressed_on_request() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=20).map(frame)).await;
    for (path, is_text) in [
        ("/v1/maps/drive/places", true),
        ("/docs/swagger-ui-bundle.js", true),
        ("/", true),
        ("/v1/maps/drive/sessions/robot/frames/1/image", false),
        ("/v1/maps/drive/export", false),
    ] {
        let asked = |encoding: &'static str| {
            let request = http().get(server.url(path)).header("accept-encoding", encoding);
            async { Answer::to(request).await }
        };
        let [plain, packed] = [asked("identity").await, asked("gzip").await];
        assert_eq!((plain.status, packed.status), (StatusCode::OK, StatusCode::OK), "{path}");
        assert!(!plain.headers.contains_key("content-encoding"), "{path}: {:?}", plain.headers);
        assert_eq!(packed.headers.contains_key("content-encoding"), is_text, "{path}: {:?}", packed.headers);
        if is_text {
            assert_eq!((packed.header("content-encoding"), &packed.body[..2]), ("gzip", &[0x1f, 0x8b][..]));
            assert!(packed.body.len() < plain.body.len(), "{path}");
        }
    }
    server.stop().await;
}

/// Whether a page may run, load and ask for what the server itself sends, and nothing else.
#[track_caller]
fn assert_strict(path: &str, policy: &str) {
    let directives: Vec<&str> = policy.split(';').map(str::trim).collect();
    assert_eq!(directives[0], "default-src 'none'", "{path}: {policy}");
    for directive in &directives {
        let (name, sources) = directive.split_once(' ').unwrap();
        let may: &[&str] = match name {
            "script-src" | "style-src" | "connect-src" => &["'self'"],
            "img-src" => &["'self'", "data:", "blob:"],
            "default-src" | "base-uri" | "form-action" | "frame-ancestors" => &["'none'"],
            other => panic!("{path}: nobody thought of {other}"),
        };
        assert!(sources.split(' ').all(|source| may.contains(&source)), "{path}: {directive}");
    }
    for name in ["base-uri", "form-action", "frame-ancestors"] {
        assert!(directives.iter().any(|directive| directive.starts_with(name)), "{path}: no {name}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_inspector_is_whole_and_sent_once() {
    let server = Server::start().await;
    let page = get(&server, "/").await;
    let page = page.text();
    let files = [
        ("/inspector/inspector.js", "text/javascript; charset=utf-8"),
        ("/inspector/inspector.css", "text/css; charset=utf-8"),
        ("/inspector/icon.svg", "image/svg+xml"),
    ];
    for (path, content_type) in files {
        assert!(page.contains(&format!("\"{path}\"")), "the page does not name {path}: {page}");
        let file = get(&server, path).await;
        assert_eq!((file.status, file.header("content-type")), (StatusCode::OK, content_type), "{path}");
        assert!(!file.body.is_empty(), "{path}");
        assert_strict(path, file.header("content-security-policy"));
        let again = http().get(server.url(path)).header("if-none-match", file.header("etag"));
        let again = Answer::to(again).await;
        assert_eq!((again.status, again.body.len()), (StatusCode::NOT_MODIFIED, 0), "{path}");
    }
    let script = get(&server, "/inspector/inspector.js").await;
    assert!(!script.text().contains("sourceMappingURL"), "the page is sent without a map of its sources");
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
    let expected = [
        "AppearanceService",
        "ClusterService",
        "CorrectionService",
        "EventService",
        "JobService",
        "LabelService",
        "MapService",
        "MergeService",
        "ModelService",
        "NavigationService",
        "RecognitionService",
        "SessionService",
        "TokenService",
    ];
    assert_eq!(names, expected.map(|name| format!("waypost.v1.{name}")));
    let answer = in_time(answers.message()).await.unwrap().unwrap().message_response;
    let Some(MessageResponse::FileDescriptorResponse(file)) = answer else { panic!("{answer:?}") };
    assert!(!file.file_descriptor_proto.is_empty());
    server.stop().await;
}
