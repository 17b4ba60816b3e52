//! What robots call their frames is told back wherever the frames are, and goes where they go.

use std::io::Cursor;

use waypost_client::{Client, Code, FrameInput, FrameOutcome, v1};

use crate::harness::{
    Server, answers, first_return, followed, found, frame, get, import_model, session_options, stream,
};

fn note(sequence: u64) -> String {
    format!("{sequence:06}.jpg")
}

fn noted(sequence: u64) -> FrameInput {
    FrameInput { note: note(sequence), ..frame(sequence) }
}

async fn notes(client: &Client, session: &str) -> Vec<String> {
    let frames = client.frames(session).await.unwrap();
    frames.into_iter().map(|frame| frame.note).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn notes_are_told_back() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(crate::harness::map_request("drive", &model.name)).await.unwrap();
    let again = first_return();
    answers(&client, "drive", "monday", (1..=again + 3).map(noted)).await;
    let monday = "maps/drive/sessions/monday";
    assert_eq!(notes(&client, monday).await, (1..=again + 3).map(note).collect::<Vec<_>>());

    let told = answers(&client, "drive", "tuesday", (again..again + 4).map(frame)).await;
    let seen: Vec<&v1::FrameReference> = told
        .iter()
        .flat_map(|answer| [&answer.r#match, &answer.best_candidate])
        .flatten()
        .filter_map(|seen| seen.frame.as_ref())
        .collect();
    assert!(!seen.is_empty(), "{told:?}");
    for frame in seen.into_iter().filter(|frame| frame.session == monday) {
        assert_eq!(frame.note, note(frame.sequence));
    }
    assert_eq!(notes(&client, "maps/drive/sessions/tuesday").await, vec![""; 4]);

    let called = client.frames_called(monday, &note(7)).await.unwrap();
    assert_eq!(called.len(), 1, "{called:?}");
    assert_eq!(called[0].name, format!("{monday}/frames/7"));
    assert!(client.frames_called(monday, "7.jpg").await.unwrap().is_empty());
    let listed = found(&server, "/v1/maps/drive/sessions/monday/frames?note=000007.jpg").await;
    assert_eq!(
        (listed["frames"].as_array().unwrap().len(), &listed["frames"][0]["note"]),
        (1, &note(7).into())
    );
    for closure in client.loop_closures("drive").await.unwrap() {
        let matched = closure.matched_frame.unwrap();
        assert_eq!(
            matched.note,
            if matched.session == monday { note(matched.sequence) } else { String::new() }
        );
    }
    let place = client.place("maps/drive/places/0").await.unwrap();
    assert_eq!(place.frames[0].note, note(place.frames[0].sequence));
    let posteriors = get(&server, "/v1/maps/drive/posteriors.csv").await;
    let lines: Vec<&str> = posteriors.text().lines().collect();
    assert!(lines[0].ends_with(",note") && lines[7].ends_with(",000007.jpg"), "{}", lines[7]);
    let picture = client.frame_picture(&format!("{monday}/frames/{again}"), None).await.unwrap();
    assert!(String::from_utf8_lossy(&picture).contains(&format!("frames/{again} ({})", note(again))));

    // Sent again without a note, a frame keeps the one that it has; and from the disk, notes are told as from memory.
    server.stop().await;
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let resent = answers(&client, "drive", "tuesday", (again..again + 4).map(noted)).await;
    for (resent, told) in resent.iter().zip(&told) {
        assert_eq!((&resent.r#match, &resent.best_candidate), (&told.r#match, &told.best_candidate));
    }
    assert_eq!(notes(&client, "maps/drive/sessions/tuesday").await, vec![""; 4]);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_note_is_refused_and_changes_nothing() {
    let (server, client) = Server::with_map().await;
    let of = |sequence: u64, note: &str| FrameInput { note: note.to_owned(), ..frame(sequence) };
    let frames = [of(1, "a\nb"), of(1, &"x".repeat(201)), of(1, &"x".repeat(200)), of(2, "Küche 2.png")];
    for (index, (sent, fragment)) in
        frames.into_iter().zip([Some("control character"), Some("201 bytes"), None, None]).enumerate()
    {
        let session = client.open_session(session_options("drive", "robot")).await.unwrap();
        let outcome = stream(session, [sent]).await.pop().unwrap();
        match (outcome, fragment) {
            (FrameOutcome::Answer(_), None) => {}
            (FrameOutcome::Refusal(refusal), Some(fragment)) => {
                let status = refusal.status.unwrap();
                assert_eq!(status.code, Code::InvalidArgument as i32);
                assert!(status.message.contains(fragment), "{}", status.message);
            }
            (outcome, _) => panic!("{index}: {outcome:?}"),
        }
    }
    assert_eq!(client.map("drive", v1::MapView::Basic).await.unwrap().frames, 2);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn notes_go_where_frames_go() {
    const FRAMES: u64 = 12;
    let (server, client) = Server::with_map().await;
    let model = client.map("drive", v1::MapView::Basic).await.unwrap().model;
    answers(&client, "drive", "first", (1..=3).map(frame)).await;
    let expected: Vec<String> = (1..=FRAMES).map(note).collect();
    answers(&client, "drive", "noted", (1..=FRAMES).map(noted)).await;

    let mut snapshot = Vec::new();
    client.export_map("drive", &mut snapshot).await.unwrap();
    let job = client.import_map("twin", Cursor::new(snapshot)).await.unwrap();
    followed(&client, &job).await;
    assert_eq!(notes(&client, "maps/twin/sessions/noted").await, expected);
    assert_eq!(notes(&client, "maps/twin/sessions/first").await, vec![""; 3]);

    let job = client.rebuild_map("drive", &model, "anew").await.unwrap();
    followed(&client, &job).await;
    assert_eq!(notes(&client, "maps/anew/sessions/noted").await, expected);

    // Its frames come to stand elsewhere in the log.
    let job = client.delete_session("maps/drive/sessions/first").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(notes(&client, "maps/drive/sessions/noted").await, expected);

    for (target, base) in
        [("maps/drive", "maps/drive/sessions/noted"), ("maps/both", "maps/both/sessions/noted")]
    {
        let sources = ["maps/anew", "maps/twin"].map(str::to_owned).to_vec();
        let sources = if target == "maps/drive" { vec![sources[1].clone()] } else { sources };
        let request =
            v1::MergeMapsRequest { sources, target: target.to_owned(), ..v1::MergeMapsRequest::default() };
        let merge = client.merge_maps(request).await.unwrap();
        followed(&client, &client.job(&merge.job).await.unwrap()).await;
        let merge = client.commit_merge(&merge.name).await.unwrap();
        followed(&client, &client.job(&merge.job).await.unwrap()).await;
        assert_eq!(notes(&client, base).await, expected, "{target}");
        let joined = format!("{target}/sessions/twin-noted");
        assert_eq!(notes(&client, &joined).await, expected, "{target}");
    }
    server.stop().await;
}
