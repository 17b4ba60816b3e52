//! What people say of loop closures, from the command line, and by whom.

use serde_json::Value;
use waypost_client::v1::token::Role;
use waypost_client::{Client, ClientOptions, Code, v1};

use crate::harness::{
    CommandLine, Server, answers, assert_status, first_return, folder, followed, frame, http, import_model,
    map_request, path, refused, state_hash,
};

#[track_caller]
fn assert_refused<T: std::fmt::Debug>(result: Result<T, waypost_client::Error>, code: Code, says: &str) {
    let (status, message) = refused(result);
    assert_status(says, (status, &message), code, says);
}

#[test]
fn closures_are_withdrawn_and_undone_from_the_command_line() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let images = usize::try_from(first_return() + 20).unwrap();
    let folder = folder(images);
    waypost.text(&["stream", path(folder.path()), "--map", "drive", "--session", "robot"]);
    let shown = waypost.json(&["map", "show", "drive"]);
    let closures = waypost.json(&["map", "loop-closures", "drive"]);
    let closures = closures["loop_closures"].as_array().unwrap();
    assert!(!closures.is_empty(), "no loop was closed");
    let sequence = closures[0]["frame"]["sequence"].to_string();
    assert!(!waypost.text(&["map", "loop-closures", "drive"]).contains("SAID"));

    let told = waypost.text(&["closure", "withdraw", "drive", "robot", &sequence]);
    assert!(
        told.contains(&format!("robot#{sequence}")) && told.contains("withdrawn without a token, 2"),
        "{told}"
    );
    let listed = waypost.json(&["closure", "ls", "drive"]);
    let [correction] = listed["corrections"].as_array().unwrap().as_slice() else { panic!("{listed}") };
    assert_eq!((&correction["verdict"], &correction["undone"]), (&"withdrawn".into(), &Value::Null));
    let number = correction["name"].as_str().unwrap().rsplit('/').next().unwrap();
    for (command, says) in [
        (&["closure", "ls", "drive"][..], "withdrawn without a token"),
        (&["map", "loop-closures", "drive"], "withdrawn without a token"),
        (&["map", "show", "drive"], "withdrawn          1"),
        (&["explain", "drive", "robot", &sequence], "withdrawn without a token"),
    ] {
        let text = waypost.text(command);
        assert!(text.contains(says), "{command:?}: {text}");
    }
    let (code, message) = waypost.fails(&["closure", "withdraw", "drive", "robot", &sequence]);
    assert!(code == 4 && message.contains("undo that to have it back"), "{code}: {message}");
    // What came later about the same session is undone first.
    let confirmed = waypost.json(&["closure", "confirm", "drive", "robot", "2", "robot", "1"]);
    assert_eq!(
        (&confirmed["verdict"], &confirmed["matched_frame"]["sequence"]),
        (&"confirmed".into(), &1.into())
    );
    assert!(waypost.text(&["map", "show", "drive"]).contains("confirmed by people  1"));
    let (code, message) = waypost.fails(&["closure", "undo", "drive", number]);
    assert!(code == 4 && message.contains("came after correction"), "{code}: {message}");
    let later = confirmed["name"].as_str().unwrap().rsplit('/').next().unwrap();
    waypost.text(&["closure", "undo", "drive", later]);
    let (code, message) = waypost.fails(&["closure", "confirm", "drive", "robot", "1", "robot", "2"]);
    assert!(code == 4 && message.contains("name the frame first that came in last"), "{code}: {message}");

    let told = waypost.text(&["closure", "undo", "drive", number]);
    assert!(told.contains("; undone without a token"), "{told}");
    let (code, message) = waypost.fails(&["closure", "undo", "drive", number]);
    assert!(code == 4 && message.contains("list its corrections"), "{code}: {message}");
    let now = waypost.json(&["map", "show", "drive"]);
    assert_eq!((&now["state_hash"], &now["links"]), (&shown["state_hash"], &shown["links"]));
}

/// The map says who said it; who may only drive may not.
#[tokio::test(flavor = "multi_thread")]
async fn the_token_of_who_says_it_is_kept() {
    let server = Server::start().await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let again = first_return();
    answers(&client, "drive", "robot", (1..=24).map(frame).chain((again..again + 12).map(frame))).await;
    let closures = client.loop_closures("drive").await.unwrap();
    let closed = closures.last().and_then(|closure| closure.frame.clone()).unwrap();
    let name = format!("{}/frames/{}", closed.session, closed.sequence);
    let (_, anna) = client.create_token("anna", Role::Admin).await.unwrap();
    let with = async |secret: &str| {
        Client::connect(ClientOptions::new(server.endpoint()).with_token(secret)).await.unwrap()
    };
    let anna = with(&anna).await;
    let (_, robot) = anna.create_token("robot", Role::Robot).await.unwrap();
    let robot = with(&robot).await;
    assert_refused(
        robot.withdraw_loop_closure(&name).await,
        Code::PermissionDenied,
        "takes the token of an admin",
    );
    let (_, onlooker) = anna.create_token("onlooker", Role::Reader).await.unwrap();
    let onlooker = with(&onlooker).await;
    assert_refused(
        onlooker.withdraw_loop_closure(&name).await,
        Code::PermissionDenied,
        "onlooker is a reader's; ask",
    );
    let withdrawn = anna.withdraw_loop_closure(&name).await.unwrap();
    assert_eq!(withdrawn.token, "anna");
    assert_eq!(robot.corrections("drive").await.unwrap(), std::slice::from_ref(&withdrawn));
    // Who may only read sees who said it, and cannot take it back.
    assert_eq!(onlooker.corrections("drive").await.unwrap(), std::slice::from_ref(&withdrawn));
    assert_refused(
        onlooker.undo_correction(&withdrawn.name).await,
        Code::PermissionDenied,
        "onlooker is a reader's; ask",
    );

    // A session that goes takes along what was said of it.
    let job = anna.delete_session("maps/drive/sessions/robot").await.unwrap();
    assert_eq!(followed(&anna, &job).await.last().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(anna.corrections("drive").await.unwrap(), []);
    drop((onlooker, robot, anna));
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_corrected_is_refused_with_the_way_out() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=12).map(frame)).await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    client.create_map(map_request("other", &model)).await.unwrap();
    answers(&client, "other", "robot", (1..=2).map(frame)).await;
    let before = state_hash(&client, "drive").await;
    let of = |map: &str, sequence: u64| format!("maps/{map}/sessions/robot/frames/{sequence}");
    let (first, second) = (of("drive", 1), of("drive", 2));
    for (name, code, says) in [
        ("drive/robot/1", Code::InvalidArgument, "maps/"),
        ("maps/drive/sessions/nobody/frames/1", Code::NotFound, "nobody"),
        (&of("nowhere", 1), Code::NotFound, "nowhere"),
        (&of("drive", 999), Code::NotFound, "999"),
        (&second, Code::FailedPrecondition, "list the map's loop closures to see which did"),
    ] {
        assert_refused(client.withdraw_loop_closure(name).await, code, says);
    }
    for (frame, matched, code, says) in [
        (&first, &first, Code::InvalidArgument, "did not come in before"),
        (&first, &second, Code::InvalidArgument, "name the frame first that came in last"),
        (&second, &of("other", 1), Code::InvalidArgument, "maps are merged"),
        (&second, &of("drive", 999), Code::NotFound, "999"),
        (&second, &String::new(), Code::InvalidArgument, "maps/"),
    ] {
        assert_refused(client.confirm_loop_closure(frame, matched).await, code, says);
    }
    for (name, code, says) in [
        ("maps/drive/corrections/first", Code::InvalidArgument, "corrections/NUMBER"),
        ("maps/drive/corrections/3", Code::NotFound, "list its corrections to see what there is"),
        ("maps/nowhere/corrections/3", Code::NotFound, "nowhere"),
    ] {
        assert_refused(client.undo_correction(name).await, code, says);
    }
    assert_eq!(state_hash(&client, "drive").await, before);
    assert_eq!(client.corrections("drive").await.unwrap(), []);
    let confirmed = client.confirm_loop_closure(&second, &first).await.unwrap();
    assert_refused(
        client.confirm_loop_closure(&second, &first).await,
        Code::FailedPrecondition,
        "says so already",
    );
    assert_eq!(client.corrections("drive").await.unwrap(), std::slice::from_ref(&confirmed));

    // They are listed a page at a time.
    let later = client.confirm_loop_closure(&of("drive", 12), &of("drive", 6)).await.unwrap();
    let mut listed = Vec::new();
    let mut token = String::new();
    loop {
        let url = server.url(&format!("/v1/maps/drive/corrections?page_size=1&page_token={token}"));
        let page: Value = http().get(url).send().await.unwrap().json().await.unwrap();
        listed.extend(page["corrections"].as_array().unwrap().iter().map(|said| said["name"].clone()));
        token = page["next_page_token"].as_str().unwrap().to_owned();
        if token.is_empty() {
            break;
        }
    }
    assert_eq!(listed, [confirmed.name, later.name]);
    server.stop().await;
}
