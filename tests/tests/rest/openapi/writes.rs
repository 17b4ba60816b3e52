//! Calls that make and remove maps, models and tokens: some that are answered, some that are refused.

use super::*;
use crate::harness::model_file;

impl Call {
    fn write(method: &'static str, path: &str, asked: &str, body: Option<(&'static str, Vec<u8>)>) -> Self {
        Self { method, path: path.to_owned(), asked: asked.to_owned(), body }
    }
}

const FRAME: &str = "/v1/maps/{map}/sessions/{session}/frames/{sequence}";

fn json_body(text: &str) -> Option<(&'static str, Vec<u8>)> {
    Some(("application/json", text.as_bytes().to_vec()))
}

fn file(bytes: Vec<u8>) -> Option<(&'static str, Vec<u8>)> {
    Some(("application/octet-stream", bytes))
}

/// What makes something comes before what removes it, in the order of the description.
pub(super) fn good_writes(surveyed: &Surveyed, snapshot: Vec<u8>) -> Vec<Call> {
    let create =
        r#"{"map_id": "made", "model": "shipped", "settings": {"keep": "images", "guard_frames": null}}"#;
    let model = std::fs::read(model_file()).unwrap();
    let (map, job) = ("/v1/maps/{map}", format!("/v1/jobs/{}/cancel", surveyed.job));
    let (session, token) = ("/v1/maps/{map}/sessions/{session}", r#"{"token_id": "made", "role": "robot"}"#);
    let (corrections, undo) = ("/v1/maps/{map}/corrections", "/v1/maps/{map}/corrections/{correction}/undo");
    let (closed, correction) = &surveyed.closed;
    let withdraw = format!(r#"{{"withdraw": {{"frame": "{closed}"}}}}"#);
    let words = json!({ "words_hash": surveyed.words_hash, "histogram": { "words": [0, 1, 2] } }).to_string();
    let undone = format!("/v1/maps/drive/corrections/{correction}/undo");
    vec![
        Call::write("post", "/v1/maps", "/v1/maps", json_body(create)),
        Call::write("delete", map, "/v1/maps/made", None),
        Call::get("/v1/maps/{map}/export", "/v1/maps/empty/export"),
        Call::write("post", "/v1/maps/{map}/import", "/v1/maps/copied/import", file(snapshot)),
        Call::get("/v1/maps/{map}/corrections", "/v1/maps/drive/corrections"),
        Call::write("post", corrections, "/v1/maps/drive/corrections", json_body(&withdraw)),
        Call::write("post", undo, &undone, None),
        Call::write("delete", session, "/v1/maps/twin/sessions/second", None),
        Call::write(
            "put",
            FRAME,
            "/v1/maps/drive/sessions/put/frames/1?stamp_ns=5&x_m=1&y_m=-2.5&heading_rad=0.5&note=a.jpg",
            Some(("image/jpeg", images()[3].clone())),
        ),
        Call::write("put", FRAME, "/v1/maps/drive/sessions/words/frames/1?stamp_ns=5", json_body(&words)),
        Call::write("post", "/v1/models", "/v1/models?display_name=again", file(model)),
        Call::write("delete", "/v1/models/{model}", "/v1/models/small", None),
        Call::write(
            "put",
            "/v1/models/{model}/display-name",
            "/v1/models/shipped/display-name",
            json_body(r#"{"display_name": "shipped"}"#),
        ),
        Call::get("/v1/models/{model}/export", "/v1/models/shipped/export"),
        Call::write("post", "/v1/jobs/{job}/cancel", &job, None),
        Call::get("/v1/tokens", "/v1/tokens"),
        Call::write("post", "/v1/tokens", "/v1/tokens", json_body(token)),
        Call::write(
            "patch",
            "/v1/tokens/{token}",
            "/v1/tokens/operator",
            json_body(r#"{"quotas": {"max_sessions": 3, "max_kept_mib": null}, "lifted": ["kept"]}"#),
        ),
        Call::write("delete", "/v1/tokens/{token}", "/v1/tokens/made", None),
        // Its secret, which all this is asked with, stays good for an hour.
        Call::write("post", "/v1/tokens/{token}/rotate", "/v1/tokens/operator/rotate", json_body("{}")),
        Call::get("/v1/whoami", "/v1/whoami"),
    ]
}

/// What such a route refuses, if it is one; `nowhere` is its path with names that nothing has.
pub(super) fn bad_writes(method: &'static str, path: &str, nowhere: &str) -> Option<Vec<(StatusCode, Call)>> {
    let (bad, missing) = (StatusCode::BAD_REQUEST, StatusCode::NOT_FOUND);
    let refused = |status, body| (status, Call::write(method, path, nowhere, body));
    match (method, path) {
        ("post", "/v1/maps") => Some(vec![
            refused(bad, json_body("")),
            refused(bad, json_body(r#"{"model": "shipped"}"#)),
            refused(bad, json_body(r#"{"map_id": "No Name", "model": "shipped"}"#)),
            refused(bad, json_body(r#"{"map_id": "new", "model": "shipped", "settings": {"keep": "all"}}"#)),
            refused(missing, json_body(r#"{"map_id": "new", "model": "nothing"}"#)),
            refused(StatusCode::CONFLICT, json_body(r#"{"map_id": "drive", "model": "shipped"}"#)),
        ]),
        ("post", "/v1/maps/{map}/import" | "/v1/models") => {
            Some(vec![refused(bad, file(Vec::new())), refused(bad, file(vec![7; 4000]))])
        }
        ("put", FRAME) => {
            let stamped = format!("{nowhere}?stamp_ns=1");
            let image =
                |asked: &str| Call::write(method, path, asked, Some(("image/jpeg", images()[0].clone())));
            let of_a_kind = |kind, body| Call::write(method, path, &stamped, Some((kind, body)));
            Some(vec![
                (bad, image(nowhere)),
                (bad, image(&format!("{stamped}&x_m=1&y_m=2"))),
                (bad, image(&format!("{stamped}&x_m=1&y_m=2&heading_rad=NaN"))),
                (StatusCode::UNSUPPORTED_MEDIA_TYPE, of_a_kind("text/plain", Vec::new())),
                (StatusCode::PAYLOAD_TOO_LARGE, of_a_kind("image/png", vec![0; (16 << 20) + 1])),
                (missing, image(&stamped)),
            ])
        }
        ("put", "/v1/models/{model}/display-name") => Some(vec![
            refused(bad, json_body("")),
            refused(bad, json_body(r#"{"name": "site"}"#)),
            refused(bad, json_body(r#"{"display_name": "a/b"}"#)),
            refused(missing, json_body(r#"{"display_name": "site"}"#)),
        ]),
        ("post", "/v1/maps/{map}/corrections") => Some(vec![
            refused(bad, json_body("")),
            refused(bad, json_body(r#"{"withdraw": {}}"#)),
            refused(bad, json_body(r#"{"withdraw": {"frame": "first"}}"#)),
            refused(bad, json_body(r#"{"withdraw": {"frame": "maps/drive/sessions/first/frames/1"}}"#)),
            refused(bad, json_body(r#"{"confirm": {"frame": "maps/nowhere/sessions/a/frames/1"}}"#)),
            refused(missing, json_body(r#"{"withdraw": {"frame": "maps/nowhere/sessions/a/frames/1"}}"#)),
        ]),
        ("post", "/v1/tokens/{token}/rotate") => Some(vec![
            refused(bad, json_body("")),
            refused(bad, json_body(r#"{"overlap_s": -1}"#)),
            refused(bad, json_body(r#"{"overlap_s": 604801}"#)),
            refused(bad, json_body(r#"{"lifetime_s": 0}"#)),
            refused(missing, json_body("{}")),
        ]),
        ("patch", "/v1/tokens/{token}") => Some(vec![
            refused(bad, json_body("{}")),
            refused(bad, json_body(r#"{"quotas": {"max_sessions": 0}}"#)),
            refused(bad, json_body(r#"{"quotas": {"max_sessions": -1}}"#)),
            refused(bad, json_body(r#"{"lifted": ["all"]}"#)),
            refused(missing, json_body(r#"{"lifted": ["kept"]}"#)),
        ]),
        ("post", "/v1/tokens") => Some(vec![
            refused(bad, json_body("")),
            refused(bad, json_body(r#"{"token_id": "new", "role": "king"}"#)),
            refused(bad, json_body(r#"{"token_id": "No Name", "role": "admin"}"#)),
            refused(bad, json_body(r#"{"token_id": "new", "role": "robot", "quotas": {"max_kept_mib": 0}}"#)),
            refused(StatusCode::CONFLICT, json_body(r#"{"token_id": "first", "role": "robot"}"#)),
        ]),
        ("post", "/v1/jobs/{job}/cancel" | "/v1/maps/{map}/corrections/{correction}/undo")
        | (
            "delete",
            "/v1/maps/{map}"
            | "/v1/maps/{map}/sessions/{session}"
            | "/v1/models/{model}"
            | "/v1/tokens/{token}",
        ) => Some(vec![refused(missing, None)]),
        _ => None,
    }
}
