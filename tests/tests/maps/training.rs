//! Training at the server, as a job, and what can be done with the model.

use std::io;
use std::time::Duration;

use futures::{Stream, stream};
use waypost_client::{Code, v1};

use crate::harness::{
    Server, answers, assert_status, followed, frame, images, import_model, in_time, map_request, refused,
    said,
};

const TRAINING_IMAGES: usize = 40;

fn settings(display_name: &str, words: u32) -> v1::TrainModelSettings {
    v1::TrainModelSettings {
        display_name: display_name.to_owned(),
        extractor: Some("orb features=300 width=320".to_owned()),
        words,
        seed: 7,
        image_count: Some(TRAINING_IMAGES as u32),
    }
}

fn training_images() -> impl Stream<Item = io::Result<Vec<u8>>> + Send + 'static {
    stream::iter(images().iter().take(TRAINING_IMAGES).cloned().map(Ok))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trained_model_is_good_for_a_map_here_and_elsewhere() {
    let server = Server::start().await;
    let client = server.client().await;
    let job = in_time(client.train_model(settings("office", 300), training_images())).await.unwrap();
    let states = followed(&client, &job).await;
    let last = check_progress(&states);
    let made = last.result.as_ref().expect("a job that succeeded made a model");
    let model = client.model(made).await.unwrap();
    assert_eq!(client.job(&job.name).await.unwrap(), *last);
    assert_eq!(client.models().await.unwrap(), std::slice::from_ref(&model));
    assert_eq!((model.display_name.as_str(), model.words), ("office", 300));
    assert!(model.extractor.starts_with("orb") && model.samples > 0, "{model:?}");
    // Done is done.
    assert_eq!(client.cancel_job(&job.name).await.unwrap().state(), v1::job::State::Succeeded);

    let mut file = Vec::new();
    let length = client.export_model("office", &mut file).await.unwrap();
    assert_eq!((length, model.size_bytes), (file.len() as u64, file.len() as u64));
    let elsewhere = Server::start().await;
    let there = elsewhere.client().await;
    // The first name that it is given stays.
    for (given, kept) in [("", ""), ("office", "office"), ("other", "office"), ("", "office")] {
        let imported = there.import_model(given, io::Cursor::new(file.clone())).await.unwrap();
        assert_eq!((&imported.name, &imported.words_hash), (&model.name, &model.words_hash));
        assert_eq!(imported.display_name, kept, "{given:?}");
    }
    let mut again = Vec::new();
    there.export_model(&model.name[..20], &mut again).await.unwrap();
    assert!(again == file, "the exported files differ");

    for client in [&client, &there] {
        client.create_map(map_request("drive", "office")).await.unwrap();
    }
    let here = answers(&client, "drive", "robot", (1..=12).map(frame)).await;
    let there = answers(&there, "drive", "robot", (1..=12).map(frame)).await;
    let untimed =
        |answer: v1::FrameAnswer| v1::FrameAnswer { timings: None, last_committed_sequence: 0, ..answer };
    let here: Vec<_> = here.into_iter().map(untimed).collect();
    assert_eq!(here, there.into_iter().map(untimed).collect::<Vec<_>>());
    assert_eq!(here[0].reason(), v1::Reason::NewPlace);
    server.stop().await;
    elsewhere.stop().await;
}

/// Stages follow each other, fractions rise within each; the end is success. Gives the last state.
fn check_progress(states: &[v1::Job]) -> &v1::Job {
    let (last, before) = states.split_last().expect("a watch begins with the job as it is");
    assert_eq!(last.state(), v1::job::State::Succeeded, "{last:?}");
    assert_eq!((last.fraction, &last.error), (1.0, &None));
    for step in before {
        assert_eq!(step.state(), v1::job::State::Running, "{step:?}");
        assert!((0.0..=1.0).contains(&step.fraction) && step.result.is_none(), "{step:?}");
    }
    for pair in states.windows(2) {
        assert_eq!(pair[0].name, pair[1].name);
        assert!(pair[0].stage != pair[1].stage || pair[0].fraction <= pair[1].fraction, "{pair:?}");
    }
    last
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_images_and_seed_make_the_same_model() {
    let (one, other) = (Server::start().await, Server::start().await);
    let mut names = Vec::new();
    for server in [&one, &other] {
        let client = server.client().await;
        let job = in_time(client.train_model(settings("", 100), training_images())).await.unwrap();
        names.push(followed(&client, &job).await.pop().unwrap().result.unwrap());
    }
    assert_eq!(names[0], names[1]);
    one.stop().await;
    other.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_can_be_cancelled_while_they_run_and_while_they_wait() {
    let server = Server::start().await;
    let client = server.client().await;
    // Float descriptors and many words: seconds of work.
    let long = v1::TrainModelSettings { extractor: Some(String::new()), ..settings("long", 4000) };
    let running = in_time(client.train_model(long, training_images())).await.unwrap();
    let waiting = in_time(client.train_model(settings("waits", 100), training_images())).await.unwrap();
    assert_ne!(running.name, waiting.name);
    for job in [&waiting, &running] {
        client.cancel_job(&job.name).await.unwrap();
        let last = followed(&client, job).await.pop().unwrap();
        assert_eq!(last.state(), v1::job::State::Cancelled, "{last:?}");
        assert!(last.result.is_none());
    }
    assert!(client.models().await.unwrap().is_empty());
    // The next one has its turn.
    let job = in_time(client.train_model(settings("next", 50), training_images())).await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_training_that_fails_says_why() {
    let server = Server::start().await;
    let client = server.client().await;
    let mut grey = io::Cursor::new(Vec::new());
    image::GrayImage::from_pixel(320, 240, image::Luma([128]))
        .write_to(&mut grey, image::ImageFormat::Png)
        .unwrap();
    let nothing_to_see = stream::iter([Ok(grey.into_inner())]);
    let job = in_time(client.train_model(
        v1::TrainModelSettings { image_count: Some(1), ..settings("grey", 100) },
        nothing_to_see,
    ))
    .await
    .unwrap();
    let last = followed(&client, &job).await.pop().unwrap();
    assert_eq!(last.state(), v1::job::State::Failed, "{last:?}");
    assert!(said(&last.error).contains("; "), "{:?} does not say how to mend it", last.error);
    assert!(client.models().await.unwrap().is_empty());

    // An image that cannot be read here trains nothing there.
    let unreadable = stream::iter([Ok(images()[0].clone()), Err(io::Error::other("a broken disk"))]);
    let failed = in_time(client.train_model(settings("half", 10), unreadable)).await;
    assert!(
        matches!(&failed, Err(waypost_client::Error::Read(error)) if error.to_string() == "a broken disk")
    );
    tokio::time::sleep(Duration::from_millis(300)).await;
    let (code, message) = refused(client.job("jobs/2").await);
    assert_status("half an upload", (code, &message), Code::NotFound, "there is no job");
    server.stop().await;
}

/// Whatever display names people choose, a full hash names its model.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_hash_names_one_model_whatever_others_are_called() {
    let server = Server::start().await;
    let client = server.client().await;
    let shipped = import_model(&client).await;
    let hash = shipped.name.strip_prefix("models/").unwrap();
    let job = in_time(client.train_model(settings(hash, 50), training_images())).await.unwrap();
    let last = followed(&client, &job).await.pop().unwrap();
    if last.state() == v1::job::State::Succeeded {
        assert_eq!(client.model(&shipped.name).await.unwrap().name, shipped.name);
        assert_eq!(import_model(&client).await.name, shipped.name);
    }
    server.stop().await;
}
