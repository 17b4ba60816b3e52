//! Questions to every route: some that it answers, some that it refuses.

use super::*;

/// A question that is answered with what the description promises.
pub(super) struct Call {
    pub(super) method: &'static str,
    /// The path as the description has it.
    pub(super) path: String,
    /// The path that is asked for.
    pub(super) asked: String,
    /// Content type and body of what is sent.
    pub(super) body: Option<(&'static str, Vec<u8>)>,
}

impl Call {
    pub(super) fn get(path: &str, asked: impl Into<String>) -> Self {
        Self { method: "get", path: path.to_owned(), asked: asked.into(), body: None }
    }

    pub(super) fn query(asked: &str, kind: &'static str, body: Vec<u8>) -> Self {
        let path = "/v1/maps/{map}/query".to_owned();
        Self { method: "post", path, asked: asked.to_owned(), body: Some((kind, body)) }
    }

    pub(super) fn goal(method: &'static str, asked: &str, body: &str) -> Self {
        let path = "/v1/maps/{map}/navigations/{navigation}/goal".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method, path, asked: asked.to_owned(), body }
    }

    pub(super) fn merge(body: &str) -> Self {
        let (path, body) = ("/v1/merges".to_owned(), Some(("application/json", body.as_bytes().to_vec())));
        Self { method: "post", asked: path.clone(), path, body }
    }

    pub(super) fn decision(asked: &str, body: &str) -> Self {
        let path = "/v1/merges/{merge}/decision".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method: "put", path, asked: asked.to_owned(), body }
    }

    pub(super) fn label(method: &'static str, asked: &str, body: &str) -> Self {
        let path = "/v1/maps/{map}/places/{place}/label".to_owned();
        let body = Some(("application/json", body.as_bytes().to_vec()));
        Self { method, path, asked: asked.to_owned(), body }
    }

    pub(super) async fn answer(&self, server: &Server, token: Option<&str>) -> Answer {
        let url = server.url(&self.asked);
        let method = self.method.to_uppercase().parse().unwrap();
        let request = http().request(method, url);
        let request = match token {
            Some(token) => request.bearer_auth(token),
            None => request,
        };
        let request = match &self.body {
            Some((kind, body)) => request.header("content-type", *kind).body(body.clone()),
            None => request,
        };
        if self.path.ends_with("/events") {
            return Answer::begun(request).await;
        }
        Answer::to(request).await
    }
}

/// Questions to every route.
pub(super) fn good_calls(surveyed: &Surveyed) -> Vec<Call> {
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
        Call::get("/v1/maps/{map}/events", "/v1/maps/drive/events?from_position=0"),
        Call::get("/v1/maps/{map}/places", "/v1/maps/drive/places"),
        Call::get("/v1/maps/{map}/places", "/v1/maps/empty/places"),
        Call::get("/v1/maps/{map}/places/{place}", "/v1/maps/drive/places/0"),
        Call::get("/v1/maps/{map}/words/{word}/places", "/v1/maps/drive/words/0/places"),
        Call::get(
            "/v1/maps/{map}/places",
            "/v1/maps/drive/places?every=2&from_place_number=1&to_place_number=4",
        ),
        Call::get(
            "/v1/maps/{map}/places",
            "/v1/maps/drive/places?part=0&min_x_m=-1&max_x_m=1&min_y_m=-1&max_y_m=1",
        ),
        Call::get("/v1/maps/{map}/matrix", "/v1/maps/drive/matrix"),
        Call::get("/v1/maps/{map}/matrix", "/v1/maps/drive/matrix?against=empty"),
        Call::get(
            "/v1/maps/{map}/matrix/tiles/{level}/{row}/{column}",
            "/v1/maps/drive/matrix/tiles/0/0/0?against=drive",
        ),
        Call::get("/v1/maps/{map}/loop-closures", "/v1/maps/drive/loop-closures"),
        Call::get("/v1/maps/{map}/loop-closures.csv", "/v1/maps/drive/loop-closures.csv"),
        Call::get("/v1/maps/{map}/loop-closures.json", "/v1/maps/drive/loop-closures.json"),
        Call::get("/v1/maps/{map}/loop-closures.json", "/v1/maps/empty/loop-closures.json"),
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
            "/v1/maps/drive/sessions/first/frames/15/explanation?place_number=0&max_words=3",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture",
            "/v1/maps/drive/sessions/second/frames/100/picture",
        ),
        Call::get(
            "/v1/maps/{map}/sessions/{session}/frames/{sequence}/picture",
            "/v1/maps/drive/sessions/second/frames/100/picture?place_number=0",
        ),
        Call::query("/v1/maps/drive/query?explained_words=4", "image/jpeg", images()[3].clone()),
        Call::query("/v1/maps/empty/query", "image/jpeg", images()[3].clone()),
        Call::query("/v1/maps/drive/query", "application/json", histogram.to_string().into_bytes()),
        Call::query("/v1/maps/drive/query", "application/json", list.to_string().into_bytes()),
        Call::get("/v1/maps/{map}/route", "/v1/maps/drive/route?from_place_number=0&to_place_number=3"),
        Call::get(
            "/v1/maps/{map}/route",
            "/v1/maps/drive/route?from_place_number=3&to_place_number=0&reverse_travel=costly",
        ),
        Call::get("/v1/maps/{map}/navigations", "/v1/maps/drive/navigations"),
        Call::get("/v1/maps/{map}/navigations", "/v1/maps/empty/navigations"),
        Call::get("/v1/maps/{map}/navigations/{navigation}", "/v1/maps/drive/navigations/robot"),
        Call::get("/v1/maps/{map}/navigations/{navigation}", "/v1/maps/drive/navigations/scout"),
        Call::goal("put", "/v1/maps/drive/navigations/scout/goal", r#"{"place_number": 2}"#),
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
        Call::label("put", "/v1/maps/looks/places/1/label", r#"{"label": "the end", "scope": "space"}"#),
        Call::get("/v1/maps/{map}/labels", "/v1/maps/looks/labels"),
        Call::get("/v1/maps/{map}/labels", "/v1/maps/drive/labels"),
        Call::get("/v1/maps/{map}/appearance-graph", "/v1/maps/looks/appearance-graph"),
        Call::label("delete", "/v1/maps/looks/places/0/label", ""),
        Call::get("/v1/models", "/v1/models"),
        Call::get("/v1/models/{model}", "/v1/models/shipped"),
        Call::get("/v1/streams", "/v1/streams"),
        Call::get("/v1/streams", "/v1/streams?map=drive"),
        Call::get("/v1/refusals", "/v1/refusals"),
        Call::get("/v1/metrics-history", "/v1/metrics-history"),
        Call::get("/v1/cluster", "/v1/cluster"),
        Call::get("/v1/jobs", "/v1/jobs"),
        Call::get("/v1/jobs/{job}", format!("/v1/jobs/{job}")),
    ]
}

/// Questions that each route refuses, if they are put to it, and the status that it does so with.
pub(super) fn bad_calls(method: &'static str, path: &str) -> Vec<(StatusCode, Call)> {
    let nowhere = path.replace("{map}", "nowhere").replace("{session}", "none").replace("{word}", "0");
    let nowhere = nowhere.replace("{place}", "0").replace("{sequence}", "1").replace("{job}", "999999");
    let nowhere = nowhere.replace("{model}", "nothing").replace("{navigation}", "nobody");
    let nowhere = nowhere.replace("{merge}", "999999").replace("{token}", "nobody");
    let nowhere = nowhere.replace("{correction}", "999999");
    let nowhere = nowhere.replace("{level}", "0").replace("{row}", "0").replace("{column}", "0");
    let body = ["post", "put", "patch"].contains(&method).then(|| ("application/json", b"{}".to_vec()));
    let asked = format!("{nowhere}?no_such_parameter=1");
    let mut calls = vec![(StatusCode::BAD_REQUEST, Call { method, path: path.to_owned(), asked, body })];
    if let Some(writes) = bad_writes(method, path, &nowhere) {
        calls.extend(writes);
    } else if method == "post" && path == "/v1/merges" {
        for body in [
            "",
            "{}",
            r#"{"sources": ["maps/drive"], "target": "maps/drive"}"#,
            r#"{"sources": ["maps/drive"], "target": "drive", "min_support": 2}"#,
            r#"{"sources": ["maps/drive"], "target": "maps/new", "auto_commit": "maybe"}"#,
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
        for body in ["", "{}", r#"{"label": 1}"#, r#"{"label": " "}"#, r#"{"label": "a", "scope": "map"}"#] {
            if method == "put" {
                calls.push((StatusCode::BAD_REQUEST, Call::label("put", &nowhere, body)));
            }
        }
    } else if method == "put" {
        calls.push((StatusCode::NOT_FOUND, Call::goal("put", &nowhere, r#"{"place_number": 0}"#)));
        for body in [
            "",
            "{}",
            r#"{"place_number": -1}"#,
            r#"{"place_number": 1, "position": {"part": 0, "x_m": 0, "y_m": 0}}"#,
        ] {
            calls.push((StatusCode::BAD_REQUEST, Call::goal("put", &nowhere, body)));
        }
    } else if method == "delete" {
        calls.push((StatusCode::NOT_FOUND, Call::goal("delete", &nowhere, "")));
    } else if path.ends_with("/route") {
        calls.push((StatusCode::BAD_REQUEST, Call::get(path, nowhere.as_str())));
        calls.push((
            StatusCode::NOT_FOUND,
            Call::get(path, format!("{nowhere}?from_place_number=0&to_place_number=1")),
        ));
    } else if path.contains('{') {
        calls.push((StatusCode::NOT_FOUND, Call::get(path, nowhere)));
    }
    calls
}
