//! Tokens that may do less than others, or reach some maps alone.

use prost::Message;
use reqwest::StatusCode;
use serde_json::json;
use waypost_client::v1::token::{Ability, Role};
use waypost_client::{Code, SessionOptions, v1};

use super::callable::{FOR_ADMINS, ROUTES_FOR_ADMINS, call_with, guarded_routes, methods};
use super::{Guarded, assert_let_in};
use crate::harness::{
    Answer, answers, as_words, assert_status, channel, followed, frame, http, images, in_time, map_request,
    refused, session_options,
};

/// Every method that names a map in the first field of its request, and how.
const NAMING_A_MAP: [(&str, &str); 44] = [
    ("SessionService/ListSessions", "maps/MAP"),
    ("SessionService/ListOpenStreams", "maps/MAP"),
    ("SessionService/GetSession", "maps/MAP/sessions/tour"),
    ("SessionService/ListFrames", "maps/MAP/sessions/tour"),
    ("SessionService/GetFrame", "maps/MAP/sessions/tour/frames/1"),
    ("SessionService/GetFrameImage", "maps/MAP/sessions/tour/frames/1"),
    ("SessionService/ExplainFrame", "maps/MAP/sessions/tour/frames/1"),
    ("SessionService/GetFramePicture", "maps/MAP/sessions/tour/frames/1"),
    ("SessionService/AddRelativePose", "maps/MAP/sessions/tour/frames/1"),
    ("SessionService/DeleteSession", "maps/MAP/sessions/tour"),
    ("NavigationService/SetGoal", "maps/MAP/navigations/robot"),
    ("NavigationService/CancelGoal", "maps/MAP/navigations/robot"),
    ("NavigationService/GetNavigation", "maps/MAP/navigations/robot"),
    ("NavigationService/ListNavigations", "maps/MAP"),
    ("NavigationService/PlanRoute", "maps/MAP"),
    ("RecognitionService/Query", "maps/MAP"),
    ("LabelService/ListLabels", "maps/MAP"),
    ("LabelService/SetLabel", "maps/MAP/places/0"),
    ("LabelService/DeleteLabel", "maps/MAP/places/0"),
    ("AppearanceService/GetAppearanceGraph", "maps/MAP"),
    ("EventService/Watch", "maps/MAP"),
    ("CorrectionService/ListCorrections", "maps/MAP"),
    ("CorrectionService/WithdrawLoopClosure", "maps/MAP/sessions/tour/frames/1"),
    ("CorrectionService/ConfirmLoopClosure", "maps/MAP/sessions/tour/frames/1"),
    ("CorrectionService/UndoCorrection", "maps/MAP/corrections/1"),
    ("MergeService/MergeMaps", "maps/MAP"),
    ("MapService/CreateMap", "MAP"),
    ("MapService/GetMap", "maps/MAP"),
    ("MapService/ListPlaces", "maps/MAP"),
    ("MapService/GetPlace", "maps/MAP/places/0"),
    ("MapService/ListWordPlaces", "maps/MAP"),
    ("MapService/GetMatchMatrix", "maps/MAP"),
    ("MapService/GetMatchMatrixTile", "maps/MAP"),
    ("MapService/ListLoopClosures", "maps/MAP"),
    ("MapService/RebindMap", "maps/MAP"),
    ("MapService/ExportPoses", "maps/MAP"),
    ("MapService/ExportPoses", "maps/MAP/sessions/tour"),
    ("MapService/ExportMap", "maps/MAP"),
    ("MapService/ImportMap", "MAP"),
    ("MapService/TrimMap", "maps/MAP"),
    ("MapService/CompactMap", "maps/MAP"),
    ("MapService/DeleteMap", "maps/MAP"),
    ("SessionService/Stream", "maps/MAP"),
    ("NavigationService/Navigate", "maps/MAP"),
];

/// Methods about the whole server.
const SERVER: [&str; 11] = [
    "EventService/ListRefusals",
    "ClusterService/GetCluster",
    "ModelService/TrainModel",
    "ModelService/ImportModel",
    "ModelService/RenameModel",
    "ModelService/DeleteModel",
    "TokenService/CreateToken",
    "TokenService/RotateToken",
    "TokenService/UpdateToken",
    "TokenService/ListTokens",
    "TokenService/DeleteToken",
];

/// Those that name no map: they show what the token reaches, or are for everybody. `RebuildMap` and `RepairMap` name several.
const OTHERS: [&str; 18] = [
    "MapService/ListMaps",
    "MapService/RebuildMap",
    "MapService/RepairMap",
    "MergeService/GetMerge",
    "MergeService/ListMerges",
    "MergeService/GetMergePicture",
    "MergeService/CommitMerge",
    "MergeService/DiscardMerge",
    "MergeService/UndoMerge",
    "ModelService/ListModels",
    "ModelService/GetModel",
    "ModelService/ExportModel",
    "JobService/ListJobs",
    "JobService/GetJob",
    "JobService/WatchJob",
    "JobService/CancelJob",
    "TokenService/GetCaller",
    "EventService/GetMetricsHistory",
];

/// What a robot may do, and a reader may not.
const READERS_MAY_NOT: [&str; 8] = [
    "SessionService/Stream",
    "SessionService/AddRelativePose",
    "RecognitionService/Query",
    "NavigationService/Navigate",
    "NavigationService/SetGoal",
    "NavigationService/CancelGoal",
    "LabelService/SetLabel",
    "LabelService/DeleteLabel",
];

fn path(method: &str) -> String {
    format!("/waypost.v1.{method}")
}

/// A token for some maps.
fn of_maps(name: &str, role: Role, maps: &[&str]) -> v1::CreateTokenRequest {
    let maps = maps.iter().map(|&map| map.to_owned()).collect();
    v1::CreateTokenRequest { token_id: name.to_owned(), role: role.into(), maps, ..Default::default() }
}

/// A message whose first field is `name`; or, for a stream, whose first field is a message like that.
fn naming(method: &str, name: String) -> Vec<u8> {
    let named = v1::GetMapRequest { name, ..Default::default() };
    if !["SessionService/Stream", "NavigationService/Navigate"].contains(&method) {
        return named.encode_to_vec();
    }
    let open = named.encode_to_vec();
    [[0x0a, u8::try_from(open.len()).unwrap()].to_vec(), open].concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_token_for_some_maps_is_refused_on_all_others() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let (_, secret) =
        admin.create_limited_token(of_maps("floor2", Role::Admin, &["hall", "floor2-*"])).await.unwrap();
    let channel = channel(&guarded.server.endpoint()).await;
    let bearer = format!("Bearer {secret}");
    let call = async |method: &str, map: &str, name: &str| {
        let message = naming(method, name.replace("MAP", map));
        call_with(&channel, &path(method), Some(&bearer), message).await
    };
    for (method, name) in NAMING_A_MAP {
        // Whether there is such a map or not.
        for map in ["drive", "nowhere", "floor2"] {
            let status = call(method, map, name).await.expect_err(method);
            let says =
                format!("the token floor2 is for the maps floor2-* and hall, and not for the map {map}; ask");
            assert_status(method, (status.code(), status.message()), Code::PermissionDenied, &says);
        }
        for map in ["hall", "floor2-east"] {
            if let Err(status) = call(method, map, name).await {
                assert_let_in(method, &status);
            }
        }
    }
    for method in SERVER {
        let status = call(method, "hall", "MAP").await.expect_err(method);
        assert_status(
            method,
            (status.code(), status.message()),
            Code::PermissionDenied,
            "about the whole server",
        );
    }
    let limited = guarded.client(&secret).await;
    for (from, into) in [("drive", "hall"), ("hall", "drive")] {
        let (code, message) = refused(limited.rebuild_map(from, "", into).await);
        assert_status("rebuild", (code, &message), Code::PermissionDenied, "and not for the map drive");
    }
    // Nor by the second name of a request.
    let beside = v1::GetFramePictureRequest {
        name: "maps/hall/sessions/tour/frames/1".to_owned(),
        beside_frame: "maps/drive/sessions/tour/frames/1".to_owned(),
        ..Default::default()
    };
    let (code, message) = refused(limited.frame_pair_picture(beside).await);
    assert_status("a picture", (code, &message), Code::PermissionDenied, "and not for the map drive");
    let (code, message) = refused(limited.match_matrix("hall", Some("drive")).await);
    assert_status("a matrix", (code, &message), Code::PermissionDenied, "and not for the map drive");
    let covered = NAMING_A_MAP.iter().map(|(method, _)| *method).chain(SERVER).chain(OTHERS);
    let covered: std::collections::BTreeSet<String> = covered.map(path).collect();
    assert_eq!(covered, methods().into_iter().collect(), "decide what the limit to maps means for a method");
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn routes_know_the_maps_that_a_token_reaches() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let (_, secret) =
        admin.create_limited_token(of_maps("floor2", Role::Admin, &["hall", "upper-*"])).await.unwrap();
    let ask = async |method: &reqwest::Method, path: &str| {
        Answer::to(http().request(method.clone(), guarded.server.url(path)).bearer_auth(&secret)).await
    };
    // Nor what a query names, however it is written.
    for path in [
        "/v1/maps/hall/matrix?against=drive",
        "/v1/maps/hall/sessions/tour/frames/1/picture?beside_frame=maps/drive/sessions/tour/frames/1",
        "/v1/maps/hall/sessions/tour/frames/1/picture?beside_frame=maps%2Fdriv%65%2Fsessions%2Ftour%2Fframes%2F1",
    ] {
        let refused = ask(&reqwest::Method::GET, path).await;
        assert_eq!(refused.status, StatusCode::FORBIDDEN, "{path}: {}", refused.text());
    }
    for (method, path, _) in guarded_routes() {
        let Some(rest) = path.strip_prefix("/v1/maps/") else { continue };
        let (_, rest) =
            rest.split_once('/').map_or(("", String::new()), |(map, rest)| (map, format!("/{rest}")));
        // A map is the same, however its name is written.
        for map in ["drive", "driv%65", "nowhere"] {
            let path = format!("/v1/maps/{map}{rest}");
            let refused = ask(&method, &path).await;
            assert_eq!(refused.status, StatusCode::FORBIDDEN, "{method} {path}: {}", refused.text());
            assert!(refused.text().contains("the token floor2 is for the maps hall and upper-*"));
        }
        for map in ["hall", "upper-%65"] {
            let path = format!("/v1/maps/{map}{rest}");
            assert_ne!(ask(&method, &path).await.status, StatusCode::FORBIDDEN, "{method} {path}");
        }
    }
    for (method, path) in ROUTES_FOR_ADMINS {
        if ["/v1/models", "/v1/tokens", "/v1/refusals"].iter().any(|server| path.starts_with(server)) {
            let refused = ask(&method, path).await;
            assert_eq!(refused.status, StatusCode::FORBIDDEN, "{method} {path}");
            assert!(refused.text().contains("about the whole server"), "{}", refused.text());
        }
    }
    let body = json!({ "map_id": "attic" });
    let create = http().post(guarded.server.url("/v1/maps")).bearer_auth(&secret).json(&body);
    assert_eq!(Answer::to(create).await.status, StatusCode::FORBIDDEN);
    let merge = json!({ "sources": ["maps/hall", "maps/drive"], "target": "maps/upper-all" });
    let merge = http().post(guarded.server.url("/v1/merges")).bearer_auth(&secret).json(&merge);
    let merge = Answer::to(merge).await;
    assert!(merge.status == StatusCode::FORBIDDEN && merge.text().contains("not for the map drive"));
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_show_what_a_token_reaches() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let model = admin.models().await.unwrap().remove(0);
    for map in ["hall", "upper-a", "upper-b", "attic", "zoo"] {
        admin.create_map(map_request(map, &model.name)).await.unwrap();
    }
    let merge = |sources: &[&str], target: &str| v1::MergeMapsRequest {
        sources: sources.iter().map(|map| format!("maps/{map}")).collect(),
        target: format!("maps/{target}"),
        ..Default::default()
    };
    let seen = admin.merge_maps(merge(&["hall"], "upper-a")).await.unwrap();
    let hidden = [
        admin.merge_maps(merge(&["attic"], "upper-a")).await.unwrap(),
        admin.merge_maps(merge(&["hall", "upper-a"], "new")).await.unwrap(),
        admin.merge_maps(merge(&["hall", "attic"], "upper-new")).await.unwrap(),
    ];
    for merge in hidden.iter().chain([&seen]) {
        followed(&admin, &admin.job(&merge.job).await.unwrap()).await;
    }
    let (_, secret) =
        admin.create_limited_token(of_maps("floor2", Role::Admin, &["hall", "upper-*"])).await.unwrap();
    let limited = guarded.client(&secret).await;
    let names = |maps: Vec<v1::Map>| maps.into_iter().map(|map| map.name).collect::<Vec<_>>();
    assert_eq!(names(limited.maps().await.unwrap()), ["maps/hall", "maps/upper-a", "maps/upper-b"]);
    assert_eq!(admin.maps().await.unwrap().len(), 6);
    assert_eq!(limited.merges().await.unwrap(), [limited.merge(&seen.name).await.unwrap()]);
    assert_eq!(limited.jobs().await.unwrap(), [limited.job(&seen.job).await.unwrap()]);
    assert_eq!(admin.jobs().await.unwrap().len(), 4);
    for merge in &hidden {
        for (what, answer) in [
            ("merge", refused(limited.merge(&merge.name).await)),
            ("merge_picture", refused(limited.merge_picture(&merge.name).await)),
            ("commit_merge", refused(limited.commit_merge(&merge.name).await)),
            ("discard_merge", refused(limited.discard_merge(&merge.name).await)),
            ("undo_merge", refused(limited.undo_merge(&merge.name).await)),
            ("job", refused(limited.job(&merge.job).await)),
            ("cancel_job", refused(limited.cancel_job(&merge.job).await)),
        ] {
            assert_status(
                what,
                (answer.0, &answer.1),
                Code::PermissionDenied,
                "is for the maps hall and upper-* alone",
            );
        }
    }
    // Pages are full, though what lies between is left out, and go on where they ended.
    let page = async |token: &str| {
        let path = format!("/v1/maps?page_size=2&page_token={token}");
        Answer::to(http().get(guarded.server.url(&path)).bearer_auth(&secret)).await.json()
    };
    let first = page("").await;
    assert_eq!(
        (&first["maps"][0]["name"], &first["maps"][1]["name"]),
        (&json!("maps/hall"), &json!("maps/upper-a"))
    );
    let second = page(first["next_page_token"].as_str().unwrap()).await;
    assert_eq!(
        (&second["maps"][0]["name"], &second["next_page_token"]),
        (&json!("maps/upper-b"), &json!(""))
    );
    let jobs = http().get(guarded.server.url("/v1/jobs?page_size=1")).bearer_auth(&secret);
    assert_eq!(Answer::to(jobs).await.json()["next_page_token"], "");

    // Without a name, an import would take the one in the file.
    let mut snapshot = Vec::new();
    limited.export_map("hall", &mut snapshot).await.unwrap();
    let (code, message) = refused(limited.import_map("", std::io::Cursor::new(snapshot)).await);
    assert_status("import", (code, &message), Code::InvalidArgument, "name the map that it is to be");
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_is_shown_to_a_token_for_some_maps_and_not_cancelled() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let extractor = Some("orb features=100 width=320".to_owned());
    let settings = v1::TrainModelSettings { extractor, words: 20, seed: 7, ..Default::default() };
    let training = futures::stream::iter(images().iter().take(8).cloned().map(Ok));
    let job = in_time(admin.train_model(settings, training)).await.unwrap();
    let (_, secret) = admin.create_limited_token(of_maps("floor2", Role::Admin, &["drive"])).await.unwrap();
    let limited = guarded.client(&secret).await;
    assert_eq!(limited.job(&job.name).await.unwrap().name, job.name);
    let (code, message) = refused(limited.cancel_job(&job.name).await);
    assert_status("cancel_job", (code, &message), Code::PermissionDenied, "this is about the whole server");
    admin.cancel_job(&job.name).await.unwrap();
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_changes_nothing() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    let (_, secret) = admin.create_token("prometheus", Role::Reader).await.unwrap();
    let (channel, bearer) = (channel(&guarded.server.endpoint()).await, format!("Bearer {secret}"));
    let may_not: Vec<String> = READERS_MAY_NOT.into_iter().map(path).collect();
    for path in methods() {
        let called = call_with(&channel, &path, Some(&bearer), Vec::new()).await;
        match called {
            Err(status) if may_not.contains(&path) => {
                let said = (status.code(), status.message());
                assert_status(&path, said, Code::PermissionDenied, "and prometheus may only read; ask");
            }
            Err(status) if FOR_ADMINS.contains(&path.as_str()) => {
                let said = (status.code(), status.message());
                assert_status(&path, said, Code::PermissionDenied, "prometheus is a reader's; ask");
            }
            Err(status) => assert_let_in(&path, &status),
            Ok(()) => {
                assert!(
                    !may_not.contains(&path) && !FOR_ADMINS.contains(&path.as_str()),
                    "{path} lets a reader in"
                );
            }
        }
    }
    for (method, path, for_admins) in guarded_routes() {
        let asked = http().request(method.clone(), guarded.server.url(&path)).bearer_auth(&secret);
        // Events go on for ever.
        let status = in_time(asked.send()).await.unwrap().status();
        let is_read = method == reqwest::Method::GET && !for_admins;
        assert_eq!(status != StatusCode::FORBIDDEN, is_read, "{method} {path}: {status}");
    }
    let metrics = http().get(guarded.server.url("/metrics")).bearer_auth(&secret);
    assert!(Answer::to(metrics).await.text().contains("waypost_build_info"));
    guarded.server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_may_be_allowed_to_look_alone() {
    let guarded = Guarded::start().await;
    let admin = guarded.client(&guarded.admin).await;
    answers(&admin, "drive", "tour", (1..=3).map(as_words)).await;
    let request = v1::CreateTokenRequest {
        token_id: "scout".to_owned(),
        role: Role::Robot.into(),
        abilities: vec![Ability::Localize.into()],
        ..Default::default()
    };
    let (token, secret) = admin.create_limited_token(request).await.unwrap();
    assert_eq!(token.abilities, [i32::from(Ability::Localize)]);
    let scout = guarded.client(&secret).await;
    let (code, message) =
        refused(in_time(scout.open_session(session_options("drive", "scout"))).await.map(drop));
    let says = "takes a token that may stream, and scout may only localize";
    assert_status("map", (code, &message), Code::PermissionDenied, says);
    let looking = SessionOptions { mode: v1::SessionMode::Localize, ..session_options("drive", "scout") };
    let (mut sender, mut outcomes) = in_time(scout.open_session(looking)).await.unwrap().split();
    sender.send(frame(2)).await.unwrap();
    assert!(in_time(outcomes.next()).await.unwrap().is_some());
    let (code, message) = refused(scout.maps().await);
    assert_status("read", (code, &message), Code::PermissionDenied, "may read, and scout may only localize");
    let who = scout.caller().await.unwrap();
    assert_eq!((who.token.as_str(), who.abilities), ("tokens/scout", token.abilities));
    guarded.server.stop().await;
}
