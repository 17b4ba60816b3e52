//! Where one image, or bag of words, was taken: whatever it comes as, and as the library says.

use std::time::Duration;

use fabmap::PlaceId;
use futures::future::join_all;
use topomap::mapper::Queried;
use waypost_client::{Client, Code, Error, FrameContent, v1};

use crate::harness::{
    CommandLine, Server, ToldMatch, as_histogram, as_words, decided_match, first_return, frame, images,
    in_time, map_request, mapped, model_of_other_words, path, reference_by_words, state_hash, take_model,
    told_match, word_maker,
};

/// Places that an answer lists.
const LISTED: usize = 10;

/// What an answer says, with the bits of every number.
#[derive(Clone, Debug, PartialEq)]
struct Answered {
    places: Vec<(u32, u64)>,
    new_place_posterior_bits: u64,
    matched: Option<ToldMatch>,
    accepted: bool,
    words: usize,
}

fn answered(response: &v1::QueryResponse) -> Answered {
    let v1::QueryResponse { places, new_place_posterior, r#match, accepted, words, place_explanation: _ } =
        response;
    Answered {
        places: places.iter().map(|place| (place.place_number, place.posterior.to_bits())).collect(),
        new_place_posterior_bits: new_place_posterior.to_bits(),
        matched: r#match.as_ref().map(told_match),
        accepted: *accepted,
        words: *words as usize,
    }
}

fn found(queried: &Queried, sequence: u64) -> Answered {
    let Queried { recognition, candidates: _, matched, accepted } = queried;
    let posterior = &recognition.posterior;
    Answered {
        places: posterior
            .top(LISTED)
            .iter()
            .map(|&(place, posterior)| (place.number(), posterior.to_bits()))
            .collect(),
        new_place_posterior_bits: posterior.new_place.to_bits(),
        matched: matched.map(|matched| decided_match(matched, reference_by_words())),
        accepted: *accepted,
        words: reference_by_words().observation(sequence).len(),
    }
}

async fn query(client: &Client, content: FrameContent, explained_words: u32) -> v1::QueryResponse {
    client.query("drive", content, word_maker().words_hash(), Some(explained_words)).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_form_of_a_query_gets_the_answer_of_the_library() {
    let (server, client) = Server::with_map_of_words().await;
    let before_return = first_return() - 1;
    mapped(&client, "mapper", 1..=before_return).await;
    let before = client.map("drive", v1::MapView::Full).await.unwrap();
    let mut accepted = Vec::new();
    // Of the map, on the way back, and of the way's end.
    for sequence in [1, 50, first_return(), first_return() + 5, first_return() + 30] {
        let expected = found(&reference_by_words().queried(before_return, sequence), sequence);
        for (form, input) in
            [("image", frame(sequence)), ("words", as_words(sequence)), ("histogram", as_histogram(sequence))]
        {
            let response = query(&client, input.content, 0).await;
            assert_eq!(answered(&response), expected, "frame {sequence} as {form}");
            assert_eq!(response.place_explanation, None, "it was not asked for");
        }
        accepted.push(expected.accepted);
    }
    assert!(accepted.contains(&true), "{accepted:?}");
    // Without a declaration of words an image is taken all the same.
    let undeclared = client.query("drive", frame(1).content, "", Some(0)).await.unwrap();
    assert_eq!(answered(&undeclared), found(&reference_by_words().queried(before_return, 1), 1));
    assert_eq!(client.map("drive", v1::MapView::Full).await.unwrap(), before);
    server.stop().await;
}

/// Accepted is what reaches the threshold of the map, and is more probable than a new place.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_accepted_goes_by_the_maps_threshold() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=40).await;
    let ask = async |sequence: u64| query(&client, as_histogram(sequence).content, 0).await;
    let mut accepted = Vec::new();
    for sequence in [10, 41, 60] {
        let response = ask(sequence).await;
        let matched = response.r#match.clone().expect("there are places");
        let best = &response.places[0];
        assert_eq!((matched.place_number, matched.posterior), (best.place_number, best.posterior));
        let settings = client.map("drive", v1::MapView::Unspecified).await.unwrap().settings.unwrap();
        let reached =
            matched.posterior >= settings.closure_threshold.expect("a map that is read back shows all");
        let passes = reached && matched.posterior > response.new_place_posterior;
        assert_eq!(response.accepted, passes, "frame {sequence}: {response:?}");
        accepted.push(passes);
    }
    assert!(accepted[0], "a frame of the map is not found in it");
    assert!(accepted.contains(&false), "everything is accepted: {accepted:?}");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_empty_map_and_too_few_words_match_nothing() {
    let (server, client) = Server::with_map_of_words().await;
    let response = query(&client, frame(1).content, 10).await;
    assert_eq!((&response.places[..], &response.r#match), (&[][..], &None));
    assert_eq!(
        (response.accepted, response.new_place_posterior, response.place_explanation),
        (false, 1.0, None)
    );

    mapped(&client, "mapper", 1..=10).await;
    for words in [vec![], vec![7, 8, 9]] {
        let few = v1::WordHistogram { words: words.clone(), counts: Vec::new() };
        let response = query(&client, FrameContent::Histogram(few), 0).await;
        assert_eq!((response.accepted, &response.r#match), (false, &None));
        assert_eq!(response.words as usize, words.len());
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_query_is_explained_by_its_words_if_asked() {
    let (server, client) = Server::with_map_of_words().await;
    mapped(&client, "mapper", 1..=40).await;
    let before = state_hash(&client, "drive").await;
    for asked in [1, 10, 100] {
        let response = query(&client, as_histogram(20).content, asked).await;
        let explanation = response.place_explanation.expect("it was asked for");
        assert_eq!(explanation.place_number, response.places[0].place_number);
        assert_eq!(explanation.posterior.to_bits(), response.places[0].posterior.to_bits());
        assert_eq!(explanation.new_place_posterior.to_bits(), response.new_place_posterior.to_bits());
        super::explain::assert_adds_up(&explanation, asked as usize);
        let index = reference_by_words().mapper(40);
        let appearance =
            index.recognizer().index().appearance(PlaceId::new(explanation.place_number)).unwrap();
        for evidence in explanation.words_for.iter().chain(&explanation.words_against) {
            let there = (u32::from(appearance.hits(evidence.word.into())), u32::from(appearance.looks()));
            assert_eq!((evidence.hits, evidence.looks), there, "{evidence:?}");
            assert_eq!(
                evidence.seen,
                reference_by_words().observation(20).contains(evidence.word.into()),
                "{evidence:?}"
            );
        }
    }
    assert_eq!(state_hash(&client, "drive").await, before);
    server.stop().await;
}

#[test]
fn the_command_line_asks_where_an_image_was_taken() {
    const FRAMES: usize = 10;
    let waypost = CommandLine::new();
    waypost.prepare_by_words();
    let folder = crate::harness::folder(FRAMES);
    waypost.json(&["stream", path(folder.path()), "--map", "drive", "--session", "mapper", "--words"]);
    let image = folder.path().join("000004.jpg");
    let ask = ["query", "drive", path(&image)];
    let answer = waypost.json(&ask);
    let expected = reference_by_words().queried(FRAMES as u64, 5);
    let matched = expected.matched.expect("the frame is of the map");
    assert_eq!((&answer["accepted"], &answer["place_explanation"]), (&expected.accepted.into(), &().into()));
    assert_eq!(answer["words"].as_u64(), Some(reference_by_words().observation(5).len() as u64));
    assert_eq!(answer["match"]["place_number"].as_u64(), Some(u64::from(matched.place)));
    let frame = &answer["match"]["frame"];
    assert_eq!(frame["sequence"].as_u64(), Some(reference_by_words().sequence_of(matched.frame)));
    assert_eq!(frame["session"], "maps/drive/sessions/mapper");
    assert_eq!(
        answer["places"].as_array().unwrap().len(),
        expected.recognition.posterior.places.len().min(10)
    );
    for words in ["--words", "--words=histogram"] {
        assert_eq!(waypost.json(&[&ask[..], &[words]].concat()), answer, "{words}");
    }
    let explained = waypost.json(&[&ask[..], &["--explain=3"]].concat());
    assert_eq!(explained["place_explanation"]["words_for"].as_array().unwrap().len(), 3);
    assert!(waypost.text(&[&ask[..], &["--explain"]].concat()).contains("seen before: place"));

    let nothing = folder.path().join("nothing.jpg");
    std::fs::write(&nothing, &images()[0][..100]).unwrap();
    let (code, stderr) = waypost.fails(&["query", "drive", path(&nothing)]);
    assert_eq!(code, 4, "{stderr}");
    assert!(stderr.contains("send the whole file again"), "{stderr}");
}

/// Two maps of one server know nothing of each other.
#[tokio::test(flavor = "multi_thread")]
async fn a_query_looks_in_its_map_alone() {
    let (server, client) = Server::with_map_of_words().await;
    client.create_map(map_request("other", "shipped")).await.unwrap();
    mapped(&client, "mapper", 1..=10).await;
    let content = || as_histogram(5).content;
    let words_hash = word_maker().words_hash();
    assert!(client.query("drive", content(), words_hash, Some(0)).await.unwrap().accepted);
    assert_eq!(client.query("other", content(), words_hash, Some(0)).await.unwrap().places, []);
    server.stop().await;
}

/// The words of a query are made by the model of the map that was there when it came.
#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_takes_the_place_of_the_one_asked_about_does_not_answer_for_it() {
    const ATTEMPTS: usize = 10;
    /// More than are looked at at a time: the last ones wait.
    const QUERIES: usize = 16;
    let (server, client) = Server::with_map_of_words().await;
    let shipped = client.map("drive", v1::MapView::Full).await.unwrap().model;
    let other = take_model(&client, "other words", &model_of_other_words()).await.name;
    let slow = FrameContent::Image(enlarged(&images()[0], 4000));
    let mut said = Vec::new();
    for model in [&other, &shipped].into_iter().cycle().take(ATTEMPTS) {
        let asking = join_all((0..QUERIES).map(|_| client.query("drive", slow.clone(), "", Some(0))));
        let replacing = async {
            // While the images are looked at; if they have not come by then, there is another attempt.
            tokio::time::sleep(Duration::from_millis(100)).await;
            client.delete_map("drive").await.unwrap();
            client.create_map(map_request("drive", model)).await.unwrap();
        };
        let (answers, ()) = in_time(async { tokio::join!(asking, replacing) }).await;
        let replaced = |answer: &Result<v1::QueryResponse, Error>| match answer {
            Err(Error::Status { code, message }) => {
                *code == Code::NotFound && message.contains("another of its name")
            }
            Ok(_) | Err(_) => false,
        };
        if answers.iter().any(replaced) {
            server.stop().await;
            return;
        }
        said.extend(answers.into_iter().map(|answer| answer.map(|answer| answer.words)));
    }
    panic!("the new map answered for the old one: {said:?}");
}

/// The image as a JPEG of that width: one that takes long to look at.
fn enlarged(jpeg: &[u8], width: u32) -> Vec<u8> {
    let image = image::load_from_memory(jpeg).unwrap();
    let large = image.resize(width, width, image::imageops::FilterType::Nearest).to_luma8();
    let mut encoded = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut encoded, 60).encode_image(&large).unwrap();
    encoded
}
