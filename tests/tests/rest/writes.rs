//! Maps, sessions, models, jobs and tokens over REST: made, taken out and in, removed; and what browsers may not do.

use reqwest::{Method, RequestBuilder, StatusCode};
use serde_json::{Value, json};
use waypost_client::{FrameContent, FrameInput, v1};

use crate::harness::{
    Answer, Server, Surveyed, answers_of, followed, found, frame, get, http, images, map_request, model_file,
    refused, session_options, state_hash,
};

/// The JSON that a request is answered with.
async fn done(request: RequestBuilder) -> Value {
    let answer = Answer::to(request).await;
    assert_eq!(answer.status, StatusCode::OK, "{}", answer.text());
    answer.json()
}

/// Whether a request is refused with this status, and says this.
async fn assert_refused(case: &str, request: RequestBuilder, status: StatusCode, says: &str) {
    let answer = Answer::to(request).await;
    assert_eq!(answer.status, status, "{case}: {}", answer.text());
    let problem = answer.json();
    assert_eq!(
        (&problem["type"], &problem["status"]),
        (&json!("about:blank"), &json!(status.as_u16())),
        "{case}"
    );
    assert_eq!(problem["detail"], problem["error"]["message"], "{case}");
    assert!(problem["detail"].as_str().unwrap().contains(says), "{case}: {problem} does not say {says:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_made_with_settings_and_deleted() {
    let (server, client) = Server::with_map().await;
    let create = |body: Value| http().post(server.url("/v1/maps")).json(&body);
    let settings =
        json!({ "keep": "images", "closure_threshold": 0.9, "guard_frames": 3, "dependence": null });
    let made = done(create(json!({ "map_id": "made", "model": "shipped", "settings": settings }))).await;
    assert_eq!((&made["name"], &made["places"]), (&json!("maps/made"), &json!(0)));
    let kept = &made["settings"];
    assert_eq!((&kept["keep"], &kept["closure_threshold"]), (&json!("images"), &json!(0.9)));
    assert_eq!((&kept["guard_frames"], &kept["dependence"]), (&json!(3), &json!("chow_liu")));
    assert_eq!(found(&server, "/v1/maps/made").await, made);
    // What was read can be sent: another map like this one.
    let again = done(create(json!({ "map_id": "again", "model": "shipped", "settings": kept }))).await;
    assert_eq!(&again["settings"], kept);

    let (bad, conflict) = (StatusCode::BAD_REQUEST, StatusCode::CONFLICT);
    let with = |settings: Value| json!({ "map_id": "new", "model": "shipped", "settings": settings });
    let cases = [
        ("twice", json!({ "map_id": "made", "model": "shipped" }), conflict, "choose another name"),
        ("no name", json!({ "model": "shipped" }), bad, "map_id"),
        ("a model of another kind", json!({ "map_id": "new", "model": 7 }), bad, "application/json"),
        ("a bad name", json!({ "map_id": "No Name", "model": "shipped" }), bad, "is no map name"),
        ("another field", json!({ "map_id": "new", "model": "shipped", "size": 1 }), bad, "size"),
        (
            "a model that is none",
            json!({ "map_id": "new", "model": "nothing" }),
            StatusCode::NOT_FOUND,
            "list",
        ),
        ("a setting that is none", with(json!({ "keeps": "images" })), bad, "unknown field `keeps`"),
        ("a choice that is none", with(json!({ "keep": "all" })), bad, "`words`, `features`, `images`"),
        ("out of range", with(json!({ "closure_threshold": 2 })), bad, "closure threshold"),
        ("half a detector", with(json!({ "true_positive_rate": 0.4 })), bad, "both rates"),
    ];
    for (case, body, status, says) in cases {
        assert_refused(case, create(body), status, says).await;
    }
    let text = http().post(server.url("/v1/maps")).body(r#"{"map_id": "new", "model": "shipped"}"#);
    assert_refused("no type", text, bad, "as application/json").await;

    let delete = |map: &str| http().delete(server.url(&format!("/v1/maps/{map}")));
    assert_eq!(done(delete("made")).await, json!({}));
    assert_refused("deleted", delete("made"), StatusCode::NOT_FOUND, "there is no map made").await;
    let left: Vec<String> = client.maps().await.unwrap().into_iter().map(|map| map.name).collect();
    assert_eq!(left, ["maps/again", "maps/drive"]);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_goes_out_and_in_and_a_session_out_of_it() {
    let Surveyed { server, .. } = Surveyed::start().await;
    let client = server.client().await;
    let file = get(&server, "/v1/maps/drive/export").await;
    assert_eq!((file.status, file.header("content-type")), (StatusCode::OK, "application/octet-stream"));
    assert_eq!(file.header("content-disposition"), "attachment; filename=\"drive.waypost-map\"");
    let import =
        |map: &str, body: Vec<u8>| http().post(server.url(&format!("/v1/maps/{map}/import"))).body(body);
    let job = done(import("copy", file.body.clone())).await;
    assert_eq!(job["kind"], "import_map");
    let job = client.job(job["name"].as_str().unwrap()).await.unwrap();
    followed(&client, &job).await;
    assert_eq!(state_hash(&client, "copy").await, state_hash(&client, "drive").await);

    let (bad, conflict) = (StatusCode::BAD_REQUEST, StatusCode::CONFLICT);
    assert_refused("taken", import("copy", file.body.clone()), conflict, "choose another name").await;
    assert_refused("a bad name", import("No", file.body.clone()), bad, "is no map name").await;
    assert_refused("nothing", import("none", Vec::new()), bad, "snapshot").await;
    assert_refused("a photograph", import("none", images()[0].clone()), bad, "snapshot").await;
    let half = done(import("half", file.body[..file.body.len() / 2].to_vec())).await;
    let half = client.job(half["name"].as_str().unwrap()).await.unwrap();
    let mut steps = client.watch_job(&half.name).await.unwrap();
    let mut last = half;
    while let Some(step) = steps.next().await.unwrap() {
        last = step;
    }
    assert_eq!(last.state(), v1::job::State::Failed, "{last:?}");
    assert_eq!(get(&server, "/v1/maps/half").await.status, StatusCode::NOT_FOUND);

    let session = |name: &str| http().delete(server.url(&format!("/v1/maps/copy/sessions/{name}")));
    assert_refused("no session", session("none"), StatusCode::NOT_FOUND, "none").await;
    let job = done(session("second")).await;
    assert_eq!(job["kind"], "delete_sessions");
    let job = client.job(job["name"].as_str().unwrap()).await.unwrap();
    followed(&client, &job).await;
    let left = found(&server, "/v1/maps/copy/sessions").await;
    assert_eq!(left["sessions"].as_array().unwrap().len(), 1, "{left}");
    // It has ended, so nothing is left to cancel; what never was cannot be.
    let cancel = |job: &str| http().post(server.url(&format!("/v1/{job}/cancel")));
    assert_eq!(done(cancel(&job.name)).await["state"], "succeeded");
    assert_refused("no job", cancel("jobs/999999"), StatusCode::NOT_FOUND, "there is no job").await;
    assert_refused("no number", cancel("jobs/first"), StatusCode::NOT_FOUND, "list the jobs").await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_goes_in_and_out_and_is_deleted_when_no_map_needs_it() {
    let server = Server::start().await;
    let shipped = std::fs::read(model_file()).unwrap();
    let import = |body: Vec<u8>| http().post(server.url("/v1/models?display_name=site")).body(body);
    let model = done(import(shipped.clone())).await;
    assert_eq!(model["display_name"], "site");
    let out = get(&server, "/v1/models/site/export").await;
    assert!(out.status == StatusCode::OK && out.body == shipped, "the file is not the one that was sent");
    let bad = StatusCode::BAD_REQUEST;
    assert_refused("nothing", import(Vec::new()), bad, "model").await;
    assert_refused("half a file", import(shipped[..shipped.len() / 2].to_vec()), bad, "cut short").await;
    let named = http().post(server.url("/v1/models?name=site")).body(shipped);
    assert_refused("another parameter", named, bad, "display_name=NAME").await;

    let delete = || http().delete(server.url("/v1/models/site"));
    let create = http().post(server.url("/v1/maps"));
    done(create.json(&json!({ "map_id": "drive", "model": "site" }))).await;
    assert_refused("in use", delete(), StatusCode::CONFLICT, "delete the map first").await;
    done(http().delete(server.url("/v1/maps/drive"))).await;
    assert_eq!(done(delete()).await, json!({}));
    assert_refused("deleted", delete(), StatusCode::NOT_FOUND, "list the models").await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tokens_are_made_listed_and_deleted_and_told_who_they_are() {
    let (server, client) = Server::with_map().await;
    let (bad, conflict) = (StatusCode::BAD_REQUEST, StatusCode::CONFLICT);
    let create = |name: &str, role: &str| {
        http().post(server.url("/v1/tokens")).json(&json!({ "token_id": name, "role": role }))
    };
    assert_refused("a robot first", create("robot", "robot"), conflict, "must be an admin's").await;
    assert_refused("no role", create("operator", "king"), bad, "application/json").await;
    // Who makes the first token hears its secret, though the server serves nobody without one from then on.
    let made = done(create("operator", "admin")).await;
    assert_eq!(
        (&made["token"]["name"], &made["token"]["role"]),
        (&json!("tokens/operator"), &json!("admin"))
    );
    let admin = made["secret"].as_str().unwrap();
    let unknown = http().get(server.url("/v1/tokens"));
    assert_refused("no token", unknown, StatusCode::UNAUTHORIZED, "asks for a token").await;
    assert!(refused(client.maps().await).1.contains("asks for a token"));
    let robot = done(create("robot", "robot").bearer_auth(admin)).await;
    let robot = robot["secret"].as_str().unwrap();
    assert_refused("twice", create("robot", "robot").bearer_auth(admin), conflict, "choose another").await;

    let ask = |method: Method, path: &str, secret: &str| {
        http().request(method, server.url(path)).bearer_auth(secret)
    };
    let who = done(ask(Method::GET, "/v1/whoami", robot)).await;
    let may = json!(["read", "localize", "stream", "navigate"]);
    let unlimited = json!({ "max_maps": null, "max_sessions": null, "max_frames_per_second": null, "max_kept_mib": null });
    let robots = json!({ "token": "tokens/robot", "role": "robot", "asks_for_token": true, "abilities": may, "maps": [],
                         "expire_time_ns": null, "quotas": unlimited });
    assert_eq!(who, robots);
    let listed = Answer::to(ask(Method::GET, "/v1/tokens", admin)).await;
    let names: Vec<Value> =
        listed.json()["tokens"].as_array().unwrap().iter().map(|token| token["name"].clone()).collect();
    assert_eq!(names, ["tokens/operator", "tokens/robot"]);
    assert!(!listed.text().contains("secret"), "{}", listed.text());
    let forbidden = StatusCode::FORBIDDEN;
    for (method, path) in [
        (Method::GET, "/v1/tokens"),
        (Method::DELETE, "/v1/tokens/operator"),
        (Method::DELETE, "/v1/maps/drive"),
        (Method::GET, "/v1/maps/drive/export"),
        (Method::POST, "/v1/maps/copy/import"),
        (Method::DELETE, "/v1/models/shipped"),
    ] {
        assert_refused(path, ask(method, path, robot), forbidden, "takes the token of an admin").await;
    }
    let last = ask(Method::DELETE, "/v1/tokens/operator", admin);
    assert_refused("the last admin's", last, conflict, "create another admin token first").await;
    assert_eq!(done(ask(Method::DELETE, "/v1/tokens/robot", admin)).await, json!({}));
    let gone = ask(Method::GET, "/v1/whoami", robot);
    assert_refused("deleted", gone, StatusCode::UNAUTHORIZED, "not known here").await;
    // Who deletes the own token hears that it is gone.
    assert_eq!(done(ask(Method::DELETE, "/v1/tokens/operator", admin)).await, json!({}));
    assert_eq!(found(&server, "/v1/whoami").await["asks_for_token"], false);
    server.stop().await;
}

/// Requests that a browser sends for a page of any site without asking the server first.
#[tokio::test(flavor = "multi_thread")]
async fn pages_of_other_sites_change_nothing() {
    let (server, client) = Server::with_map().await;
    let mut snapshot = Vec::new();
    client.export_map("drive", &mut snapshot).await.unwrap();
    let create = r#"{"map_id": "theirs", "model": "shipped"}"#.as_bytes().to_vec();
    let token = r#"{"token_id": "theirs", "role": "admin"}"#.as_bytes().to_vec();
    let writes = [
        ("/v1/maps", create),
        ("/v1/tokens", token),
        ("/v1/maps/theirs/import", snapshot.clone()),
        ("/v1/models", std::fs::read(model_file()).unwrap()),
        ("/v1/jobs/1/cancel", Vec::new()),
        ("/v1/merges", br#"{"sources": ["maps/drive"], "target": "maps/theirs"}"#.to_vec()),
    ];
    let own = format!("http://{}", server.http());
    let other_port = format!("http://127.0.0.1:{}", server.http().port().wrapping_add(1));
    let forbidden = StatusCode::FORBIDDEN;
    for (path, body) in &writes {
        let simple = || http().post(server.url(path)).header("content-type", "text/plain").body(body.clone());
        for origin in ["https://evil.example", "null", other_port.as_str()] {
            let request = simple().header("origin", origin);
            assert_refused(path, request, forbidden, "page of another site").await;
        }
        let fetched = simple().header("sec-fetch-site", "cross-site");
        assert_refused(path, fetched, forbidden, "page of another site").await;
        // A browser adds what it remembers of a password by itself.
        let remembered =
            simple().header("origin", "https://evil.example").basic_auth("me", Some("waypost_0"));
        assert_refused(path, remembered, forbidden, "page of another site").await;
    }
    let state = client.maps().await.unwrap();
    assert_eq!(state.len(), 1, "{state:?}");
    assert!(client.tokens().await.unwrap().is_empty());
    assert!(client.jobs().await.unwrap().is_empty());
    // The page of this server itself, and programs that hold a token, may.
    let own_page = http().post(server.url("/v1/maps/copy/import")).header("origin", &own).body(snapshot);
    assert_eq!(done(own_page).await["kind"], "import_map");
    let first = http().post(server.url("/v1/tokens")).header("sec-fetch-site", "same-origin");
    let made = done(first.json(&json!({ "token_id": "operator", "role": "admin" }))).await;
    let (robot, secret) = (json!({ "token_id": "robot", "role": "robot" }), made["secret"].as_str().unwrap());
    let program = http().post(server.url("/v1/tokens")).header("origin", "https://fleet.example");
    assert_eq!(done(program.bearer_auth(secret).json(&robot)).await["token"]["name"], "tokens/robot");
    // None is told that it may read an answer, or send anything but such simple requests.
    let asked =
        http().request(Method::OPTIONS, server.url("/v1/maps")).header("origin", "https://evil.example");
    let preflight = asked.header("access-control-request-method", "DELETE").bearer_auth(secret);
    let preflight = Answer::to(preflight).await;
    assert!(!preflight.status.is_success() && preflight.header("access-control-allow-origin").is_empty());
    server.stop().await;
}

/// As `curl -T` does, for a script that holds no stream open.
#[tokio::test(flavor = "multi_thread")]
async fn frames_one_by_one_make_the_session_that_a_stream_makes() {
    const FRAMES: u64 = 20;
    let (server, client) = Server::with_map().await;
    client.create_map(map_request("single", "shipped")).await.unwrap();
    let put = |map: &str, number: u64, more: &str| {
        let FrameInput { sequence, stamp_ns, content, .. } = frame(number);
        let FrameContent::Image(image) = content else { panic!("no image") };
        let path = format!("/v1/maps/{map}/sessions/robot/frames/{sequence}?stamp_ns={stamp_ns}{more}");
        http().put(server.url(&path)).header("content-type", "image/jpeg").body(image)
    };
    let streamed = answers_of(&client, session_options("drive", "robot"), (1..=FRAMES).map(frame)).await;
    for answer in &streamed {
        let told = done(put("single", answer.sequence, "&note=one.jpg")).await;
        let reason = answer.reason().as_str_name().trim_start_matches("REASON_").to_lowercase();
        assert_eq!((&told["reason"], &told["place_number"]), (&json!(reason), &json!(answer.place_number)));
    }
    assert_eq!(state_hash(&client, "single").await, state_hash(&client, "drive").await);
    let last = done(put("single", FRAMES, "")).await;
    assert_eq!((&last["resent"], &last["last_committed_sequence"]), (&json!(true), &json!(FRAMES)));
    let record = found(&server, "/v1/maps/single/sessions/robot/frames/1").await;
    assert_eq!(record["note"], "one.jpg");
    let moved = done(put("single", FRAMES + 1, "&x_m=1&y_m=-2&heading_rad=0.5")).await;
    assert_eq!(moved["resent"], false, "{moved}");
    let record = found(&server, &format!("/v1/maps/single/sessions/robot/frames/{}", FRAMES + 1)).await;
    assert_eq!(record["odometry"]["pose"]["position_m"], json!({ "x": 1.0, "y": -2.0, "z": 0.0 }));

    // A number that is taken is no other frame's, and who sends one twice at once hears one answer.
    let other = format!("/v1/maps/single/sessions/robot/frames/{FRAMES}?stamp_ns=7");
    let other =
        || http().put(server.url(&other)).header("content-type", "image/jpeg").body(images()[0].clone());
    assert_refused("another frame", other(), StatusCode::CONFLICT, "begin another session").await;
    let (one, two) = tokio::join!(done(put("single", FRAMES + 2, "")), done(put("single", FRAMES + 2, "")));
    assert_eq!(one["place_number"], two["place_number"]);
    assert!(one["resent"].as_bool().unwrap() != two["resent"].as_bool().unwrap(), "{one}, {two}");

    // What is refused begins no session, and is noted once.
    let unread = http().put(server.url("/v1/maps/single/sessions/none/frames/1?stamp_ns=1"));
    let unread = unread.header("content-type", "image/jpeg").body("hello");
    assert_refused("no image", unread, StatusCode::BAD_REQUEST, "neither JPEG nor PNG").await;
    let sessions = found(&server, "/v1/maps/single/sessions").await;
    assert_eq!(sessions["sessions"].as_array().unwrap().len(), 1, "{sessions}");
    let refusals = found(&server, "/v1/refusals").await.to_string();
    assert_eq!(refusals.matches("neither JPEG nor PNG").count(), 1, "{refusals}");

    let bad = StatusCode::BAD_REQUEST;
    let without_stamp = http().put(server.url("/v1/maps/single/sessions/robot/frames/30"));
    assert_refused("no stamp", without_stamp, bad, "this route takes stamp_ns=NUMBER").await;
    assert_refused("half a pose", put("single", 30, "&x_m=1"), bad, "give all three, or none").await;
    assert_refused("no map", put("nowhere", 30, ""), StatusCode::NOT_FOUND, "there is no map").await;
    let no_number = http().put(server.url("/v1/maps/single/sessions/robot/frames/one?stamp_ns=1"));
    assert_refused("no number", no_number, bad, "with the frame's sequence number").await;

    // It takes what a stream takes.
    let token = async |name: &str, role: &str, by: Option<&str>| {
        let request = http().post(server.url("/v1/tokens")).json(&json!({ "token_id": name, "role": role }));
        let request = by.into_iter().fold(request, RequestBuilder::bearer_auth);
        done(request).await["secret"].as_str().unwrap().to_owned()
    };
    let admin = token("boss", "admin", None).await;
    let reader = token("guest", "reader", Some(&admin)).await;
    let robot = token("cart", "robot", Some(&admin)).await;
    let own = || {
        let url = server.url("/v1/maps/drive/sessions/cart/frames/1?stamp_ns=1");
        http().put(url).header("content-type", "image/jpeg").body(images()[0].clone())
    };
    assert_refused("a reader", own().bearer_auth(reader), StatusCode::FORBIDDEN, "stream").await;
    assert_eq!(done(own().bearer_auth(robot)).await["sequence"], 1);
    server.stop().await;
}
