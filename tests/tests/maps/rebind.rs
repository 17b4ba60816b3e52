//! A map goes on with another model over the same words.

use std::sync::atomic::{AtomicBool, Ordering};

use topomap::in_memory::{self, NoViews};
use topomap::mapper::Mapper;
use topomap::settings::MapperSettings;
use waypost_client::{Code, v1};

use crate::harness::{
    RawStream, Server, answers_of, as_histogram, assert_status, in_time, mapped, model_of_other_words, open,
    recalibrated_model, reference_by_words, refused, state_hash, take_model, told, wire, word_maker,
    words_options,
};

/// The first message of a stream of words.
fn opening(session: &str, mode: v1::SessionMode) -> v1::OpenSession {
    let words_hash = word_maker().words_hash().to_owned();
    v1::OpenSession { mode: mode.into(), words_hash, ..open("drive", session) }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recalibrated_model_is_taken_and_decides_from_then_on() {
    const MAPPED: u64 = 30;
    let (server, client) = Server::with_map_of_words().await;
    let shipped = client.map("drive", v1::MapView::Unspecified).await.unwrap().model;
    mapped(&client, "robot", 1..=MAPPED).await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let recalibrated = recalibrated_model(0.7);
    let taken = take_model(&client, "recalibrated", &recalibrated).await;
    assert_eq!(taken.words_hash, word_maker().words_hash());

    let rebound = client.rebind_map("drive", "recalibrated").await.unwrap();
    assert_eq!((&rebound.model, &before.model), (&taken.name, &shipped));
    let after = client.map("drive", v1::MapView::Full).await.unwrap();
    // The map was closed for it, which writes a checkpoint.
    assert_eq!(after, v1::Map { model: taken.name.clone(), storage: after.storage, ..before });

    // What is asked now is answered by the new model over what was learnt before.
    let mut mapper = Mapper::new(&recalibrated, MapperSettings::default()).unwrap();
    reference_by_words().fold_into(&mut mapper, MAPPED);
    for sequence in [10, MAPPED + 1] {
        let reference = reference_by_words();
        let observation = reference.observation(sequence);
        let queried = in_memory::query(&mapper, reference.log(), observation, &NoViews).unwrap();
        let content = as_histogram(sequence).content;
        let response = client.query("drive", content, word_maker().words_hash(), Some(0)).await.unwrap();
        let expected = queried.recognition.posterior.new_place;
        assert_eq!(response.new_place_posterior.to_bits(), expected.to_bits(), "frame {sequence}");
        let by_the_old_one = reference_by_words().queried(MAPPED, sequence).recognition.posterior.new_place;
        assert_ne!(expected.to_bits(), by_the_old_one.to_bits(), "the models do not differ");
    }

    // To the same model again is nothing; back to the first, and the drive goes on as if nothing had been.
    let again = client.rebind_map("drive", &taken.name).await.unwrap();
    assert_eq!(again, v1::Map { state_hash: None, storage: None, extent: None, ..after });
    client.rebind_map("drive", &shipped).await.unwrap();
    mapped(&client, "robot", MAPPED + 1..=60).await;
    assert_eq!(state_hash(&client, "drive").await, reference_by_words().maps[60].state_hash);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn models_that_a_map_cannot_go_on_with_are_refused() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "robot", 1..=5).await;
    let other = take_model(&client, "other", &model_of_other_words()).await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let words_hash = word_maker().words_hash();
    let unknown = format!("models/{}", "0".repeat(64));
    let (invalid, missing, precondition) = (Code::InvalidArgument, Code::NotFound, Code::FailedPrecondition);
    for (case, map, model, code, fragment) in [
        ("other words", "drive", "other", precondition, "has other words"),
        ("other words, by name", "drive", &other.name, precondition, &other.words_hash),
        ("the map's own words are named", "drive", "other", precondition, words_hash),
        ("unknown model", "drive", "nowhere", missing, "there is no model \"nowhere\"; list the models"),
        ("unknown hash", "drive", &unknown, missing, "train or import one"),
        ("no model", "drive", "", invalid, "name a model: by its hash"),
        ("unknown map", "nowhere", "shipped", missing, "there is no map nowhere"),
        ("no map name", "Drive", "shipped", invalid, "is no map name"),
    ] {
        let (found, message) = refused(client.rebind_map(map, model).await);
        assert_status(case, (found, &message), code, fragment);
    }
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);
    server.stop().await;
}

/// Frames stream while the model is changed to and fro: none is lost, and each is decided by the model that
/// the log says it was decided by.
#[tokio::test(flavor = "multi_thread")]
async fn streams_go_on_while_the_model_changes() {
    const FRAMES: u64 = 60;
    const REBINDINGS: u32 = 6;
    let (server, client) = Server::with_map_of_words().await;
    let shipped = client.model("shipped").await.unwrap();
    let keen = take_model(&client, "keen", &recalibrated_model(0.7)).await;
    let streamed = AtomicBool::new(false);
    let streaming = async {
        let frames = (1..=FRAMES).map(as_histogram);
        let answers = answers_of(&client, words_options("drive", "robot"), frames).await;
        streamed.store(true, Ordering::Relaxed);
        answers
    };
    let looking = async {
        let mode = v1::SessionMode::Localize;
        let options = waypost_client::SessionOptions { mode, ..words_options("drive", "looker") };
        answers_of(&client, options, (1..=40).map(as_histogram)).await.len()
    };
    let rebinding = async {
        let mut rebound = 0;
        while !streamed.load(Ordering::Relaxed) && rebound < REBINDINGS {
            let model = if rebound % 2 == 0 { &keen.name } else { &shipped.name };
            client.rebind_map("drive", model).await.unwrap();
            rebound += 1;
            tokio::time::sleep(std::time::Duration::from_millis(30)).await;
        }
        rebound
    };
    let (answers, looked, rebound) = in_time(async { tokio::join!(streaming, looking, rebinding) }).await;
    assert!(rebound >= 2, "the model was changed {rebound} times only");
    assert_eq!((answers.len() as u64, looked), (FRAMES, 40));
    let listed = client.frames("maps/drive/sessions/robot").await.unwrap();
    assert_eq!(listed.len() as u64, FRAMES);
    for (answer, record) in answers.iter().zip(&listed) {
        assert_eq!(told(record.answer.as_ref().unwrap()), told(answer), "{}", record.name);
        let explained = client.explain_frame(&record.name, None, Some(0)).await.unwrap();
        assert!(explained.reproduced, "{} was decided by another model than the log says", record.name);
    }
    server.stop().await;
}

/// A robot that looks is told to open again, and not that another robot took its place.
#[tokio::test(flavor = "multi_thread")]
async fn robots_that_look_are_not_mistaken_for_each_other_afterwards() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=10).await;
    take_model(&client, "keen", &recalibrated_model(0.7)).await;
    let look = async |name: &str| {
        let opening = opening(name, v1::SessionMode::Localize);
        RawStream::open(&server.endpoint(), opening).await.unwrap().0
    };
    let (mut one, mut other) = (look("one").await, look("other").await);
    one.answered(wire(as_histogram(1))).await;
    other.answered(wire(as_histogram(1))).await;

    client.rebind_map("drive", "keen").await.unwrap();
    // The other is back first.
    let mut other_again = look("other").await;
    other_again.answered(wire(as_histogram(2))).await;
    let status = one.frame(wire(as_histogram(2))).await.expect_err("localizing begins anew");
    assert_status("one", (status.code(), status.message()), Code::Unavailable, "open the session again");
    let mut one_again = look("one").await;
    one_again.answered(wire(as_histogram(2))).await;
    other_again.answered(wire(as_histogram(3))).await;
    server.stop().await;
}
