//! A map is rebuilt with a model of other words.

use waypost_client::{Code, v1};

use crate::harness::{
    Server, answers, assert_status, followed, frame, images, import_model, map_request, model_of_other_words,
    refused, said, state_hash, take_model,
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
