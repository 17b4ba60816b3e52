//! A map is rebuilt with a model of other words.

use waypost_client::{Code, v1};

use crate::harness::{
    CommandLine, Server, answers, assert_status, folder, followed, frame, images, import_model, map_request,
    model_of_other_words, path, refused, said, state_hash, take_model,
};

/// The words of a map can be made anew from the descriptors that it keeps, and are as if its robots had sent them there.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_made_anew_with_another_model() {
    const FRAMES: u64 = 30;
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
    let shipped = import_model(&client).await;
    let settings = v1::TrainModelSettings {
        display_name: "fewer words".to_owned(),
        extractor: Some(shipped.extractor),
        words: 300,
        seed: 1,
        image_count: Some(40),
    };
    let images = futures::stream::iter(images()[..40].iter().cloned().map(Ok));
    let job = client.train_model(settings, images).await.unwrap();
    let made = followed(&client, &job).await.pop().unwrap().result.unwrap();
    let other = client.model(&made).await.unwrap();
    let job = client.rebuild_map("drive", &other.name, "anew").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().result.as_deref(), Some("maps/anew"));
    client.create_map(map_request("sent", &other.name)).await.unwrap();
    answers(&client, "sent", "robot", (1..=FRAMES).map(frame)).await;
    assert_eq!(state_hash(&client, "anew").await, state_hash(&client, "sent").await);
    let anew = client.map("anew", v1::MapView::Full).await.unwrap();
    assert_eq!((anew.frames, &anew.model), (FRAMES, &other.name));

    // Asked for again, it goes on with what has come since.
    answers(&client, "drive", "robot", (FRAMES + 1..=FRAMES + 3).map(frame)).await;
    let job = client.rebuild_map("drive", &other.name, "anew").await.unwrap();
    followed(&client, &job).await;
    assert_eq!(client.map("anew", v1::MapView::Full).await.unwrap().frames, FRAMES + 3);

    // Of two sessions that are removed at once, neither takes another one's place.
    for session in ["second", "third", "fourth"] {
        answers(&client, "anew", session, (1..=3).map(frame)).await;
    }
    let jobs = [
        client.delete_session("maps/anew/sessions/robot").await.unwrap(),
        client.delete_session("maps/anew/sessions/third").await.unwrap(),
    ];
    let mut ends = Vec::new();
    for job in &jobs {
        ends.push(followed(&client, job).await.pop().unwrap());
    }
    assert_eq!(ends[0].state(), v1::job::State::Succeeded, "{ends:?}");
    let left = client.sessions("anew").await.unwrap();
    let left: Vec<&str> = left.iter().map(|session| session.name.rsplit('/').next().unwrap()).collect();
    match ends[1].state() {
        v1::job::State::Succeeded => assert_eq!(left, ["second", "fourth"]),
        _ => {
            assert!(said(&ends[1].error).contains("try again"), "{ends:?}");
            assert_eq!(left, ["second", "third", "fourth"]);
        }
    }

    let foreign = take_model(&client, "foreign", &model_of_other_words()).await;
    for (map, model, into, code, fragment) in [
        ("drive", &foreign, "new", Code::FailedPrecondition, "give a model of the same features"),
        ("drive", &other, "drive", Code::AlreadyExists, "there is a map drive already"),
        ("drive", &other, "New", Code::InvalidArgument, "is no map name"),
        ("nowhere", &other, "new", Code::NotFound, "there is no map nowhere"),
    ] {
        let answer = refused(client.rebuild_map(map, &model.name, into).await);
        assert_status(map, (answer.0, &answer.1), code, fragment);
    }
    server.stop().await;
}

/// Its summary counts every frame for one reason, and those of the map before beside them.
#[test]
fn what_a_rebuild_prints_adds_up() {
    const FRAMES: usize = 30;
    let waypost = CommandLine::new();
    waypost.prepare();
    let images = folder(FRAMES);
    let streamed = waypost.json(&["stream", path(images.path()), "--map", "drive", "--session", "robot"]);
    waypost.text(&["map", "label", "drive", "1", "kitchen"]);
    let features = waypost.json(&["model", "show", "shipped"])["extractor"].as_str().unwrap().to_owned();
    let train = ["model", "train", "--images", path(images.path()), "--words", "200", "--name", "other"];
    waypost.text(&[&train[..], &["--extractor", &features]].concat());
    let rebuild = ["map", "rebuild", "drive", "--model", "other", "--into", "anew"];
    let rebuilt = waypost.json(&rebuild);
    assert_eq!(rebuilt["map"]["name"], "maps/anew");
    assert_eq!(rebuilt["reasons_before"], streamed["reasons"]);
    let counts = rebuilt["reasons"].as_object().unwrap();
    let counted: u64 = counts.values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!((counts.len(), counted), (6, FRAMES as u64), "{rebuilt}");
    assert_ne!(rebuilt["reasons"], rebuilt["reasons_before"]);
    assert_eq!((&rebuilt["labels_left"], &rebuilt["corrections_left"]), (&1.into(), &0.into()));
    // The same for people; the same command again finds all of it done.
    let said = waypost.text(&rebuild);
    let numbers = |row: &str| {
        let row = said.lines().find(|line| line.trim_start().starts_with(row)).unwrap();
        row.split_whitespace().filter_map(|cell| cell.parse::<usize>().ok()).collect::<Vec<_>>()
    };
    assert_eq!(numbers("frames"), [FRAMES, FRAMES], "{said}");
    let rows =
        ["somewhere new", "same place", "loop closures", "known place, not", "known place, ref", "too few"];
    for column in [0, 1] {
        assert_eq!(rows.iter().map(|row| numbers(row)[column]).sum::<usize>(), FRAMES, "{said}");
    }
    assert!(said.contains("labels 1, corrections by people 0"), "{said}");
}
