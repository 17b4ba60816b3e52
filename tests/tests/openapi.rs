//! What the REST API says of itself is what it does.

use jsonschema::Validator;
use reqwest::StatusCode;
use serde_json::{Value, json};
use waypost_client::v1;

use crate::harness::{Answer, Server, Surveyed, found, get, http, images, led, taught_hall, workspace};

/// Writes the description anew when it is set.
const RENEW: &str = "RENEW_OPENAPI";

#[tokio::test(flavor = "multi_thread")]
async fn the_description_is_the_one_that_is_checked_in() {
    let server = Server::start().await;
    let served = get(&server, "/v1/openapi.json").await;
    let file = workspace().join("server/openapi.json");
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(&file, served.text()).unwrap();
    }
    let kept = std::fs::read_to_string(&file).unwrap_or_default();
    assert!(
        kept == served.text(),
        "server/openapi.json is out of date; run {RENEW}=1 cargo test --release -p waypost-e2e openapi:: and read \
         what has changed: clients depend on it"
    );
    server.stop().await;
}

/// A question that is answered with what the description promises.
struct Call {
    method: &'static str,
    /// The path as the description has it.
    path: String,
    /// The path that is asked for.
    asked: String,
    /// Content type and body of what is sent.
    body: Option<(&'static str, Vec<u8>)>,
}

impl Call {
    fn get(path: &str, asked: impl Into<String>) -> Self {
        Self { method: "get", path: path.to_owned(), asked: asked.into(), body: None }
    }

    fn query(asked: &str, kind: &'static str, body: Vec<u8>) -> Self {
        let path = "/v1/maps/{map}/query".to_owned();
        Self { method: "post", path, asked: asked.to_owned(), body: Some((kind, body)) }
    }

    fn goal(method: &'static str, asked: &str, body: &str) -> Self {
        let path = "/v1/maps/{map}/navigations/{navigation}/goal".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method, path, asked: asked.to_owned(), body }
    }

    fn merge(body: &str) -> Self {
        let (path, body) = ("/v1/merges".to_owned(), Some(("application/json", body.as_bytes().to_vec())));
        Self { method: "post", asked: path.clone(), path, body }
    }

    fn decision(asked: &str, body: &str) -> Self {
        let path = "/v1/merges/{merge}/decision".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method: "put", path, asked: asked.to_owned(), body }
    }

    fn label(method: &'static str, asked: &str, body: &str) -> Self {
        let path = "/v1/maps/{map}/places/{place}/label".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method, path, asked: asked.to_owned(), body }
    }

    async fn answer(&self, server: &Server) -> Answer {
        let url = server.url(&self.asked);
        let method = self.method.to_uppercase().parse().unwrap();
        let request = http().request(method, url);
        Answer::to(match &self.body {
            Some((kind, body)) => request.header("content-type", *kind).body(body.clone()),
            None => request,
        })
        .await
    }
}

/// Questions to every route.
fn good_calls(surveyed: &Surveyed) -> Vec<Call> {
    let Surveyed { job, words_hash, merges: [proposed, apart], .. } = surveyed;
    let histogram =
        json!({ "words_hash": words_hash, "histogram": { "words": [0, 1, 2], "counts": [1, 1, 3] } });
    let list = json!({ "words_hash": words_hash, "words": {
        "words": [5, 5], "x_px": [1.5, 2.0], "y_px": [1, 2], "image_width_px": 640, "image_height_px": 480 } });
    vec![
        Call::get("/v1/maps", "/v1/maps"),
        Call::get("/v1/maps", "/v1/maps?page_size=1"),
        Call::get("/v1/maps/{map}", "/v1/maps/drive"),
        Call::get("/v1/maps/{map}", "/v1/maps/drive?view=full"),
        Call::get("/v1/maps/{map}", "/v1/maps/empty?view=full"),
        Call::get("/v1/maps/{map}/places", "/v1/maps/drive/places"),
        Call::get("/v1/maps/{map}/places", "/v1/maps/empty/places"),
        Call::get("/v1/maps/{map}/places/{place}", "/v1/maps/drive/places/0"),
        Call::get("/v1/maps/{map}/words/{word}/places", "/v1/maps/drive/words/0/places"),
        Call::get("/v1/maps/{map}/matches", "/v1/maps/drive/matches"),
        Call::get("/v1/maps/{map}/matches.csv", "/v1/maps/drive/matches.csv"),
        Call::get("/v1/maps/{map}/matches.json", "/v1/maps/drive/matches.json"),
        Call::get("/v1/maps/{map}/matches.json", "/v1/maps/empty/matches.json"),
        Call::get("/v1/maps/{map}/posteriors.csv", "/v1/maps/drive/posteriors.csv"),
        Call::get("/v1/maps/{map}/posteriors.json", "/v1/maps/drive/posteriors.json"),
        Call::get("/v1/maps/{map}/graph.g2o", "/v1/maps/drive/graph.g2o"),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/trajectory",
            "/v1/maps/drive/sessions/first/trajectory?format=kitti&frame=odom&body=camera",
        ),
        Call::get("/v1/maps/{map}/sessions", "/v1/maps/drive/sessions"),
        Call::get("/v1/maps/{map}/sessions/{session}", "/v1/maps/drive/sessions/first"),
        Call::get("/v1/maps/{map}/sessions/{session}", "/v1/maps/drive/sessions/second"),
        Call::get("/v1/maps/{map}/sessions/{session}/frames", "/v1/maps/drive/sessions/first/frames"),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}",
            "/v1/maps/drive/sessions/first/frames/1",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/image",
            "/v1/maps/drive/sessions/first/frames/1/image",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/explanation",
            "/v1/maps/drive/sessions/first/frames/1/explanation",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/explanation",
            "/v1/maps/drive/sessions/first/frames/15/explanation?place=0&words=3",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture",
            "/v1/maps/drive/sessions/second/frames/100/picture",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture",
            "/v1/maps/drive/sessions/second/frames/100/picture?place=0",
        ),
        Call::query("/v1/maps/drive/query?explained_words=4", "image/jpeg", images()[3].clone()),
        Call::query("/v1/maps/empty/query", "image/jpeg", images()[3].clone()),
        Call::query("/v1/maps/drive/query", "application/json", histogram.to_string().into_bytes()),
        Call::query("/v1/maps/drive/query", "application/json", list.to_string().into_bytes()),
        Call::get("/v1/maps/{map}/route", "/v1/maps/drive/route?from=0&to=3"),
        Call::get("/v1/maps/{map}/route", "/v1/maps/drive/route?from=3&to=0&against_the_way=costly"),
        Call::get("/v1/maps/{map}/navigations", "/v1/maps/drive/navigations"),
        Call::get("/v1/maps/{map}/navigations", "/v1/maps/empty/navigations"),
        Call::get("/v1/maps/{map}/navigations/{navigation}", "/v1/maps/drive/navigations/robot"),
        Call::get("/v1/maps/{map}/navigations/{navigation}", "/v1/maps/drive/navigations/scout"),
        Call::goal("put", "/v1/maps/drive/navigations/scout/goal", r#"{"place": 2}"#),
        Call::goal(
            "put",
            "/v1/maps/drive/navigations/scout/goal",
            r#"{"position": {"part": 0, "x_m": 1, "y_m": -0.5, "heading_rad": 1.5}}"#,
        ),
        Call::goal("delete", "/v1/maps/drive/navigations/scout/goal", ""),
        Call::get("/v1/merges", "/v1/merges"),
        Call::get("/v1/merges/{merge}", format!("/v1/merges/{proposed}")),
        Call::get("/v1/merges/{merge}", format!("/v1/merges/{apart}")),
        Call::get("/v1/merges/{merge}/picture", format!("/v1/merges/{proposed}/picture")),
        Call::decision(&format!("/v1/merges/{proposed}/decision"), r#"{"decision": "discard"}"#),
        Call::merge(r#"{"sources": ["maps/empty"], "target": "maps/drive", "min_support": 7}"#),
        Call::label("put", "/v1/maps/looks/places/0/label", r#"{"label": "hall"}"#),
        Call::label("put", "/v1/maps/looks/places/1/label", r#"{"label": "the end", "reach": "space"}"#),
        Call::get("/v1/maps/{map}/labels", "/v1/maps/looks/labels"),
        Call::get("/v1/maps/{map}/labels", "/v1/maps/drive/labels"),
        Call::get("/v1/maps/{map}/appearance-graph", "/v1/maps/looks/appearance-graph"),
        Call::label("delete", "/v1/maps/looks/places/0/label", ""),
        Call::get("/v1/models", "/v1/models"),
        Call::get("/v1/models/{model}", "/v1/models/shipped"),
        Call::get("/v1/jobs", "/v1/jobs"),
        Call::get("/v1/jobs/{job}", format!("/v1/jobs/{job}")),
    ]
}

/// Questions that each route refuses, if they are put to it, and the status that it does so with.
fn bad_calls(method: &'static str, path: &str) -> Vec<(StatusCode, Call)> {
    let nowhere = path.replace("{map}", "nowhere").replace("{session}", "none").replace("{word}", "0");
    let nowhere = nowhere.replace("{place}", "0").replace("{sequence}", "1").replace("{job}", "999999");
    let nowhere = nowhere.replace("{model}", "nothing").replace("{navigation}", "nobody");
    let nowhere = nowhere.replace("{merge}", "999999");
    let body = ["post", "put"].contains(&method).then(|| ("application/json", b"{}".to_vec()));
    let asked = format!("{nowhere}?no_such_parameter=1");
    let mut calls = vec![(StatusCode::BAD_REQUEST, Call { method, path: path.to_owned(), asked, body })];
    if method == "post" && path == "/v1/merges" {
        for body in [
            "",
            "{}",
            r#"{"sources": ["maps/drive"], "target": "maps/drive"}"#,
            r#"{"sources": ["maps/drive"], "target": "drive", "min_support": 2}"#,
            r#"{"sources": ["maps/drive"], "target": "maps/new", "once_found": "maybe"}"#,
        ] {
            calls.push((StatusCode::BAD_REQUEST, Call::merge(body)));
        }
        let nowhere = r#"{"sources": ["maps/nowhere"], "target": "maps/drive"}"#;
        calls.push((StatusCode::NOT_FOUND, Call::merge(nowhere)));
    } else if method == "put" && path.ends_with("/decision") {
        calls.push((StatusCode::NOT_FOUND, Call::decision(&nowhere, r#"{"decision": "commit"}"#)));
        for body in ["", "{}", r#"{"decision": "maybe"}"#, r#"{"decision": "undo", "why": 1}"#] {
            calls.push((StatusCode::BAD_REQUEST, Call::decision(&nowhere, body)));
        }
    } else if method == "post" {
        let asked = nowhere.as_str();
        calls.push((StatusCode::UNSUPPORTED_MEDIA_TYPE, Call::query(asked, "text/plain", Vec::new())));
        calls.push((StatusCode::PAYLOAD_TOO_LARGE, Call::query(asked, "image/png", vec![0; (16 << 20) + 1])));
        calls.push((StatusCode::NOT_FOUND, Call::query(asked, "image/jpeg", images()[0].clone())));
    } else if path.ends_with("/label") {
        calls.push((StatusCode::NOT_FOUND, Call::label(method, &nowhere, r#"{"label": "hall"}"#)));
        for body in ["", "{}", r#"{"label": 1}"#, r#"{"label": " "}"#, r#"{"label": "a", "reach": "map"}"#] {
            if method == "put" {
                calls.push((StatusCode::BAD_REQUEST, Call::label("put", &nowhere, body)));
            }
        }
    } else if method == "put" {
        calls.push((StatusCode::NOT_FOUND, Call::goal("put", &nowhere, r#"{"place": 0}"#)));
        for body in
            ["", "{}", r#"{"place": -1}"#, r#"{"place": 1, "position": {"part": 0, "x_m": 0, "y_m": 0}}"#]
        {
            calls.push((StatusCode::BAD_REQUEST, Call::goal("put", &nowhere, body)));
        }
    } else if method == "delete" {
        calls.push((StatusCode::NOT_FOUND, Call::goal("delete", &nowhere, "")));
    } else if path.ends_with("/route") {
        calls.push((StatusCode::BAD_REQUEST, Call::get(path, nowhere.as_str())));
        calls.push((StatusCode::NOT_FOUND, Call::get(path, format!("{nowhere}?from=0&to=1"))));
    } else if path.contains('{') {
        calls.push((StatusCode::NOT_FOUND, Call::get(path, nowhere)));
    }
    calls
}

/// The description, with its objects closed: an answer must not have what is not described.
struct Description {
    document: Value,
}

impl Description {
    async fn of(server: &Server) -> Self {
        let mut document = found(server, "/v1/openapi.json").await;
        let schemas = document["components"]["schemas"].as_object_mut().unwrap();
        for schema in schemas.values_mut().filter(|schema| schema["type"] == "object") {
            schema["additionalProperties"] = json!(false);
        }
        Self { document }
    }

    /// Method and path of every operation.
    fn operations(&self) -> Vec<(&'static str, &str)> {
        let mut operations = Vec::new();
        for (path, methods) in self.document["paths"].as_object().unwrap() {
            for method in methods.as_object().unwrap().keys() {
                let known = ["get", "post", "put", "delete"].into_iter().find(|known| known == method);
                operations.push((known.expect("a method that this test can call"), path.as_str()));
            }
        }
        operations
    }

    /// What is said of an answer with this status.
    fn response(&self, call: &Call, status: StatusCode) -> &Value {
        let said = &self.document["paths"][&call.path][call.method]["responses"][status.as_str()];
        assert!(said.is_object(), "{} {} is not said to answer {status}", call.method, call.path);
        match said["$ref"].as_str() {
            Some(reference) => self.document.pointer(reference.strip_prefix('#').unwrap()).unwrap(),
            None => said,
        }
    }

    fn validator(&self, schema: &Value) -> Validator {
        let mut root = schema.clone();
        root["components"] = self.document["components"].clone();
        jsonschema::draft202012::new(&root).unwrap()
    }

    /// Whether an answer is as described; gives what it was checked by, if it is JSON.
    fn check(&self, call: &Call, status: StatusCode, answer: &Answer) -> Option<Validator> {
        let Call { asked, .. } = call;
        assert_eq!(answer.status, status, "{asked}: {}", String::from_utf8_lossy(&answer.body));
        let kind = answer.header("content-type").split(';').next().unwrap();
        let content = &self.response(call, status)["content"][kind];
        assert!(content["schema"].is_object(), "{asked}: {kind} is not described");
        if kind != "application/json" {
            return None;
        }
        let (validator, value) = (self.validator(&content["schema"]), answer.json());
        let wrong: Vec<String> = validator
            .iter_errors(&value)
            .map(|error| format!("{}: {error}", error.instance_path()))
            .collect();
        assert!(wrong.is_empty(), "{asked} is not as described:\n{}\n{value:#}", wrong.join("\n"));
        Some(validator)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_is_as_described() {
    let surveyed = Surveyed::start().await;
    let description = Description::of(&surveyed.server).await;
    let client = surveyed.server.client().await;
    let _led = led(&client).await;
    let model = client.model("shipped").await.unwrap();
    taught_hall(&client, &model.name).await;
    // It is taken away before it is set.
    client.set_label("maps/looks/places/0", "hall", v1::LabelReach::Place).await.unwrap();
    let calls = good_calls(&surveyed);
    for (method, path) in description.operations() {
        let described: Vec<&Call> =
            calls.iter().filter(|call| call.method == method && call.path == path).collect();
        assert!(!described.is_empty(), "{method} {path} is called by no test: say with which parameters");
        for call in described {
            let answer = call.answer(&surveyed.server).await;
            if let Some(validator) = description.check(call, StatusCode::OK, &answer) {
                assert_strict(&validator, &call.asked, &answer.json());
            }
        }
    }
    for call in &calls {
        assert!(
            description.operations().contains(&(call.method, call.path.as_str())),
            "{} is not described",
            call.path
        );
    }
    surveyed.server.stop().await;
}

/// A field less, or one more, is no longer as described.
#[track_caller]
fn assert_strict(validator: &Validator, asked: &str, answer: &Value) {
    let Some(fields) = answer.as_object() else { return };
    for field in fields.keys() {
        let mut less = answer.clone();
        less.as_object_mut().unwrap().remove(field);
        assert!(!validator.is_valid(&less), "{asked}: the description does not ask for {field}");
    }
    let mut more = answer.clone();
    more["unheard_of"] = json!(1);
    assert!(!validator.is_valid(&more), "{asked}: the description takes anything");
}

#[tokio::test(flavor = "multi_thread")]
async fn every_refusal_is_as_described() {
    let (server, _client) = Server::with_map().await;
    let description = Description::of(&server).await;
    let operations = description.operations();
    assert!(operations.len() >= 20, "{operations:?}");
    for (method, path) in operations {
        for (status, call) in bad_calls(method, path) {
            let answer = call.answer(&server).await;
            assert!(description.check(&call, status, &answer).is_some(), "{}: no JSON", call.asked);
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_described_is_described_well() {
    let server = Server::start().await;
    let description = Description::of(&server).await;
    let examples = check_examples(&description, &description.document);
    assert!(examples >= 10, "only {examples} examples");
    for (method, path) in description.operations() {
        let operation = &description.document["paths"][path][method];
        assert!(operation["summary"].as_str().is_some_and(|said| said.len() > 5), "{method} {path}");
        for parameter in operation["parameters"].as_array().into_iter().flatten() {
            assert!(parameter["description"].is_string(), "{method} {path}: {}", parameter["name"]);
        }
        let variables = path.matches('{').count();
        let declared = operation["parameters"].as_array().into_iter().flatten();
        assert_eq!(declared.filter(|parameter| parameter["in"] == "path").count(), variables, "{path}");
    }
    server.stop().await;
}

/// Checks all examples within a value of the description by the schema that they belong to; how many there were.
fn check_examples(description: &Description, value: &Value) -> usize {
    let mut checked = 0;
    if let Some(example) = value.get("example") {
        let schema = value.get("schema").unwrap_or(value);
        assert!(description.validator(schema).is_valid(example), "{example} is no example of {schema:#}");
        checked += 1;
    }
    match value {
        Value::Object(fields) => {
            let within = fields.iter().filter(|(name, _)| *name != "example");
            checked + within.map(|(_, value)| check_examples(description, value)).sum::<usize>()
        }
        Value::Array(values) => {
            checked + values.iter().map(|value| check_examples(description, value)).sum::<usize>()
        }
        Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => checked,
    }
}
