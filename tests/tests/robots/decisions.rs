//! The server decides as the library does in process: frame by frame, bit by bit.

use topomap::log::Reason;
use waypost_client::{FrameContent, v1};

use crate::harness::{
    Reference, Server, answers, decided, frame, frame_count, in_time, reference, state_hash, told,
};

/// Places that an answer lists.
const LISTED: usize = 10;

#[tokio::test(flavor = "multi_thread")]
async fn server_decides_as_in_process() {
    let (server, client) = Server::with_map().await;
    let answers = answers(&client, "drive", "robot", (1..=frame_count()).map(frame)).await;

    let reference = reference();
    assert_eq!(answers.len(), reference.events.len());
    for (index, (answer, event)) in answers.iter().zip(&reference.events).enumerate() {
        assert_eq!(told(answer), decided(event, reference), "frame {}", event.sequence);
        if event.decision.reason != Reason::TooFewWords {
            assert_eq!(listed(answer), probable(index, reference), "frame {}", event.sequence);
        }
        // Frames share commits: later ones may be durable by the time this one is answered.
        assert!(answer.last_committed_sequence >= event.sequence);
        assert!(!answer.resent);
        let timings = answer.timings.as_ref().expect("a new answer has timings");
        assert!(timings.extract_ms > 0.0 && timings.total_ms > timings.extract_ms, "{timings:?}");
    }

    let map = in_time(client.map("drive", v1::MapView::Full)).await.unwrap();
    let expected = &reference.maps[answers.len()];
    assert_eq!(map.state_hash, Some(expected.state_hash.clone()));
    assert_eq!((map.places, map.links), (expected.places, expected.links));
    assert_eq!((map.frames, map.sessions), (frame_count(), 1));
    check_loop_closures(&client, reference).await;
    check_places(&client, map.places).await;
    server.stop().await;
}

/// Places and p(new) of an answer are parts of one distribution, also where too little was seen.
#[tokio::test(flavor = "multi_thread")]
async fn the_probabilities_of_an_answer_belong_together() {
    let (server, client) = Server::with_map().await;
    let black = image::GrayImage::from_pixel(320, 240, image::Luma([9]));
    let mut nothing_to_see = std::io::Cursor::new(Vec::new());
    black.write_to(&mut nothing_to_see, image::ImageFormat::Png).unwrap();
    let mut frames: Vec<_> = (1..=12).map(frame).collect();
    frames[5].content = FrameContent::Image(nothing_to_see.into_inner());
    let answers = answers(&client, "drive", "robot", frames).await;
    assert_eq!(answers[5].reason(), v1::Reason::TooFewWords);
    assert_eq!(answers[5].place_number, None);
    for answer in &answers {
        let places: f64 = answer.places.iter().map(|place| place.posterior).sum();
        let sum = places + answer.new_place_posterior;
        assert!(sum <= 1.0 + 1e-9, "the probabilities add up to {sum}: {answer:?}");
        assert!(answer.places.is_sorted_by(|a, b| a.posterior >= b.posterior), "{answer:?}");
    }
    server.stop().await;
}

/// Loop closures exist, and the list of them says what the answers said.
async fn check_loop_closures(client: &waypost_client::Client, reference: &Reference) {
    let closures = reference.events.iter().filter(|event| event.decision.reason == Reason::LoopClosure);
    let expected: Vec<(u64, u64, u32, u64)> = closures
        .map(|event| {
            let closure = event.decision.closure.expect("a closure has a match");
            let matched = reference.sequence_of(closure.frame);
            (event.sequence, matched, closure.place.number(), closure.posterior.to_bits())
        })
        .collect();
    assert!(!expected.is_empty(), "the shipped drive closes no loop");
    let matches = client.loop_closures("drive").await.unwrap();
    let listed: Vec<(u64, u64, u32, u64)> = matches
        .iter()
        .map(|closure| {
            let sequence = |frame: &Option<v1::FrameReference>| frame.as_ref().unwrap().sequence;
            let (frame, matched) = (sequence(&closure.frame), sequence(&closure.matched_frame));
            (frame, matched, closure.place_number, closure.posterior.to_bits())
        })
        .collect();
    assert_eq!(listed, expected);
    let map = client.map("drive", v1::MapView::Unspecified).await.unwrap();
    assert_eq!(map.loop_closures, expected.len() as u64);
}

/// Every place has learnt something, and links go both ways.
async fn check_places(client: &waypost_client::Client, count: u64) {
    let places = client.places("drive").await.unwrap();
    assert_eq!(places.len() as u64, count);
    for (number, place) in (0_u32..).zip(&places) {
        assert_eq!(place.name, format!("maps/drive/places/{number}"));
        assert!(place.looks >= 1 && place.words >= 1 && !place.frames.is_empty(), "{place:?}");
        for &other in &place.linked_place_numbers {
            assert!(places[other as usize].linked_place_numbers.contains(&number), "{number} and {other}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_maps_grow_side_by_side_as_if_alone() {
    const FRAMES: u64 = 25;
    let (server, client) = Server::with_map().await;
    let model = client.model("shipped").await.unwrap();
    client.create_map(crate::harness::map_request("other", &model.name)).await.unwrap();
    let drive = async |map: &str| answers(&client, map, "robot", (1..=FRAMES).map(frame)).await;
    let (one, other) = tokio::join!(drive("drive"), drive("other"));
    let expected = &reference().maps[FRAMES as usize].state_hash;
    assert_eq!(&state_hash(&client, "drive").await, expected);
    assert_eq!(&state_hash(&client, "other").await, expected);
    assert_eq!((one.len(), other.len()), (FRAMES as usize, FRAMES as usize));
    server.stop().await;
}

fn listed(answer: &v1::FrameAnswer) -> Vec<(u32, u64)> {
    answer.places.iter().map(|place| (place.place_number, place.posterior.to_bits())).collect()
}

/// What the answer should list, from the whole posterior.
fn probable(index: usize, reference: &Reference) -> Vec<(u32, u64)> {
    let probable = reference.most_probable(index, LISTED).into_iter();
    probable.map(|(place, posterior)| (place.number(), posterior.to_bits())).collect()
}
