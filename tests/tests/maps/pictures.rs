//! A frame beside the one that it was compared with: what is drawn is what the two have in common.

use std::collections::HashSet;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use reqwest::StatusCode;
use reqwest::header::IF_NONE_MATCH;
use roxmltree::{Document, Node};
use waypost_client::{Client, Code, FrameContent, FrameInput, v1};

use crate::harness::{
    Answer, CommandLine, Server, answers, answers_of, as_histogram, as_words, assert_status, first_return,
    folder, frame, get, http, images, map_request, model_of_other_words, path, refused, take_model,
    word_maker, words_options,
};

const GREEN: &str = "#3ddc5b";
const RED: &str = "#d7263d";

async fn create(
    client: &Client,
    map: &str,
    keep: v1::map_settings::Keep,
    verified: v1::map_settings::Verification,
) {
    let settings =
        v1::MapSettings { keep: keep.into(), verification: verified.into(), ..v1::MapSettings::default() };
    let request = v1::CreateMapRequest { settings: Some(settings), ..map_request(map, "shipped") };
    client.create_map(request).await.unwrap();
}

fn name(map: &str, sequence: u64) -> String {
    format!("maps/{map}/sessions/robot/frames/{sequence}")
}

/// What a picture shows.
#[derive(Debug)]
struct Drawn {
    text: String,
    /// Where something is drawn in a colour, and which word it is.
    green: Vec<(String, String, u32)>,
    red: Vec<(String, String, u32)>,
    /// Words in squares.
    expected: Vec<u32>,
    lines: usize,
    /// The images within, from the left.
    images: Vec<Vec<u8>>,
}

impl Drawn {
    fn of(svg: &[u8]) -> Self {
        let svg = std::str::from_utf8(svg).unwrap();
        let document = Document::parse(svg).unwrap();
        let named = |name: &'static str| {
            document.descendants().filter(move |node| node.has_tag_name(("http://www.w3.org/2000/svg", name)))
        };
        let circles = |colour: &str| {
            let within = |circle: &Node<'_, '_>| circle.parent().unwrap().attribute("stroke") == Some(colour);
            named("circle")
                .filter(within)
                .map(|circle| {
                    let at = |axis| circle.attribute(axis).unwrap().to_owned();
                    let word = circle.first_element_child().and_then(|title| title.text()).unwrap();
                    (at("cx"), at("cy"), word.strip_prefix("word ").unwrap().parse().unwrap())
                })
                .collect()
        };
        let image = |node: Node<'_, '_>| {
            let data = node.attribute("href").unwrap().strip_prefix("data:image/jpeg;base64,");
            STANDARD.decode(data.expect("an image that is within the picture")).unwrap()
        };
        let text = named("text")
            .flat_map(|node| node.descendants())
            .filter_map(|node| node.text().filter(|_| node.is_text()));
        Self {
            text: text.collect::<Vec<_>>().join("\n"),
            green: circles(GREEN),
            red: circles(RED),
            expected: named("rect")
                .filter_map(|square| square.first_element_child()?.text())
                .map(|title| {
                    title.strip_prefix("word ").unwrap().strip_suffix(", expected").unwrap().parse().unwrap()
                })
                .collect(),
            lines: named("line").count(),
            images: named("image").map(image).collect(),
        }
    }
}

/// The words of a frame's features.
fn words_of(sequence: u64) -> Vec<u32> {
    word_maker().words(&images()[sequence as usize - 1]).unwrap().words
}

fn sorted(mut words: Vec<u32>) -> Vec<u32> {
    words.sort_unstable();
    words
}

#[tokio::test(flavor = "multi_thread")]
async fn words_in_common_are_green_and_the_others_red() {
    use v1::map_settings::{Keep, Verification};
    let (server, client) = Server::with_map().await;
    create(&client, "words", Keep::Images, Verification::None).await;
    answers(&client, "words", "robot", (1..=3).map(frame)).await;
    let frame_3 = name("words", 3);
    let drawn = Drawn::of(&client.frame_picture(&frame_3, Some(0)).await.unwrap());
    let (ours, theirs) = (words_of(3), words_of(1));
    let known = |words: &[u32]| words.iter().copied().collect::<HashSet<u32>>();
    let (our_words, their_words) = (known(&ours), known(&theirs));
    let (ours_green, ours_red): (Vec<u32>, Vec<u32>) =
        ours.into_iter().partition(|word| their_words.contains(word));
    let (theirs_green, theirs_red): (Vec<u32>, Vec<u32>) =
        theirs.into_iter().partition(|word| our_words.contains(word));
    let words = |marks: &[(String, String, u32)]| sorted(marks.iter().map(|mark| mark.2).collect());
    assert!(!ours_green.is_empty() && !ours_red.is_empty());
    assert_eq!(words(&drawn.green), sorted([ours_green, theirs_green].concat()));
    assert_eq!(words(&drawn.red), sorted([ours_red, theirs_red].concat()));
    assert_eq!(drawn.lines, 0, "no motion was looked for");
    assert_eq!(drawn.images, [images()[2].clone(), images()[0].clone()]);
    for told in [
        &frame_3,
        &name("words", 1),
        "place 0",
        &format!("{} words in common", our_words.intersection(&their_words).count()),
    ] {
        assert!(drawn.text.contains(told), "{told}: {}", drawn.text);
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_motion_explains_is_joined() {
    use v1::map_settings::{Keep, Verification};
    let (server, client) = Server::with_map().await;
    create(&client, "hall", Keep::Features, Verification::Similarity).await;
    let drive = (1..=first_return() + 12).map(frame);
    let told = answers(&client, "hall", "robot", drive).await;
    let closed = told.iter().find(|answer| answer.reason() == v1::Reason::LoopClosure).expect("a loop");
    let closure = closed.r#match.as_ref().unwrap();
    let explained = client.explain_frame(&name("hall", closed.sequence), None, Some(0)).await.unwrap();
    let linked = explained.picture.clone().expect("there is a place");
    let answer = get(&server, &linked).await;
    assert_eq!((answer.status, answer.header("content-type")), (StatusCode::OK, "image/svg+xml"));
    let drawn = Drawn::of(&answer.body);
    assert_eq!(drawn.lines, closure.geometry.as_ref().unwrap().inliers as usize);
    assert!(drawn.green.len() >= drawn.lines && !drawn.red.is_empty());
    let matched = closure.frame.as_ref().unwrap();
    assert!(
        drawn.text.contains(&format!("{}/frames/{}", matched.session, matched.sequence)),
        "{}",
        drawn.text
    );
    assert!(drawn.text.contains("loop_closure"), "{}", drawn.text);
    // Every gate of geometry is told, with its numbers.
    for gate in explained.gates.iter().filter(|gate| gate.description.starts_with("geometry")) {
        assert!(drawn.text.contains(&gate.description), "{}: {}", gate.description, drawn.text);
    }
    // Thumbnails stand for images that are not kept.
    assert_eq!(drawn.images.len(), 2);
    assert!(drawn.images.iter().all(|image| image.len() < 10_000 && image.starts_with(b"\xff\xd8")));
    // By itself it shows the match that was decided about; and it loads nothing but what is within it.
    let by_itself = get(&server, &format!("/v1/{}/picture", name("hall", closed.sequence))).await;
    assert_eq!(by_itself.body, answer.body);
    assert!(by_itself.header("content-security-policy").contains("default-src 'none'; img-src data:;"));
    let known = http().get(server.url(&linked)).header(IF_NONE_MATCH, answer.header("etag"));
    assert_eq!(Answer::to(known).await.status, StatusCode::NOT_MODIFIED);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_expected_and_not_seen_is_marked() {
    use v1::map_settings::{Keep, Verification};
    let (server, client) = Server::with_map().await;
    create(&client, "hall", Keep::Images, Verification::None).await;
    answers(&client, "hall", "robot", (1..=3).map(frame)).await;
    let explained = client.explain_frame(&name("hall", 3), Some(0), Some(40)).await.unwrap();
    let missed = explained.place_explanation.as_ref().unwrap().words_against.iter().filter(|word| !word.seen);
    let missed: HashSet<u32> = missed.map(|word| word.word).collect();
    assert!(!missed.is_empty(), "{explained:?}");
    let drawn = Drawn::of(&get(&server, explained.picture.as_ref().unwrap()).await.body);
    let ours: HashSet<u32> = words_of(3).into_iter().collect();
    let wanted: Vec<u32> = words_of(1).into_iter().filter(|word| missed.contains(word)).collect();
    assert!(!wanted.is_empty() && wanted.iter().all(|word| !ours.contains(word)));
    assert_eq!(sorted(drawn.expected.clone()), sorted(wanted));
    assert!(drawn.text.contains("squares: expected in the other, and not seen"), "{}", drawn.text);
    // What both show was not missed.
    let [common] = *words_of(1)
        .iter()
        .filter(|word| ours.contains(word))
        .copied()
        .collect::<Vec<_>>()
        .first_chunk()
        .unwrap();
    let asked = |words: &[u32]| v1::GetFramePictureRequest {
        name: name("hall", 3),
        place_number: Some(0),
        expected_words: words.to_vec(),
        ..v1::GetFramePictureRequest::default()
    };
    let drawn = Drawn::of(&client.frame_pair_picture(asked(&[common])).await.unwrap());
    assert_eq!(drawn.expected, [] as [u32; 0]);
    for (words, fragment) in
        [(vec![u32::MAX], "there is no word 4294967295"), (vec![1; 101], "at most 100 expected words")]
    {
        let (code, message) = refused(client.frame_pair_picture(asked(&words)).await);
        assert_status("words", (code, &message), Code::InvalidArgument, fragment);
    }
    let nonsense = get(&server, &format!("/v1/{}/picture?expected_words=3,,4", name("hall", 3))).await;
    assert_eq!(nonsense.status, StatusCode::BAD_REQUEST);
    assert!(nonsense.text().contains("commas between them"), "{}", nonsense.text());
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_is_shown_beside_one_of_another_map() {
    use v1::map_settings::{Keep, Verification};
    let (server, client) = Server::with_map().await;
    for (map, verified) in [("hall", Verification::Similarity), ("attic", Verification::None)] {
        create(&client, map, Keep::Images, verified).await;
    }
    answers(&client, "hall", "robot", (1..=2).map(frame)).await;
    answers(&client, "attic", "robot", (1..=3).map(frame)).await;
    let asked = |frame: String, beside: String| v1::GetFramePictureRequest {
        name: frame,
        beside_frame: beside,
        ..v1::GetFramePictureRequest::default()
    };
    let picture = client.frame_pair_picture(asked(name("hall", 2), name("attic", 2))).await.unwrap();
    let drawn = Drawn::of(&picture);
    // The same image: all is in common, and one motion joins it as far as the first map's settings look for one.
    assert_eq!(drawn.images, [images()[1].clone(), images()[1].clone()]);
    assert!(drawn.red.is_empty() && drawn.lines > 50, "{} red, {} lines", drawn.red.len(), drawn.lines);
    assert!(drawn.text.contains("side by side") && drawn.text.contains(&name("attic", 2)), "{}", drawn.text);
    let reversed = client.frame_pair_picture(asked(name("attic", 2), name("hall", 2))).await.unwrap();
    assert_eq!(Drawn::of(&reversed).lines, 0);
    // A frame that came later is as good.
    let later = client.frame_pair_picture(asked(name("attic", 1), name("attic", 3))).await.unwrap();
    assert_eq!(Drawn::of(&later).images, [images()[0].clone(), images()[2].clone()]);

    let both =
        v1::GetFramePictureRequest { place_number: Some(0), ..asked(name("hall", 2), name("attic", 2)) };
    let (code, message) = refused(client.frame_pair_picture(both).await);
    assert_status("both", (code, &message), Code::InvalidArgument, "leave one of them out");
    let (code, message) = refused(client.frame_pair_picture(asked(name("hall", 2), name("attic", 9))).await);
    assert_status("no frame", (code, &message), Code::NotFound, "has no frame 9");
    let other = take_model(&client, "other", &model_of_other_words()).await;
    client.create_map(map_request("barn", &other.name)).await.unwrap();
    answers(&client, "barn", "robot", [frame(1)]).await;
    let (code, message) = refused(client.frame_pair_picture(asked(name("hall", 2), name("barn", 1))).await);
    assert_status("models", (code, &message), Code::FailedPrecondition, "have different models");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_not_kept_is_said() {
    let (server, client) = Server::with_map().await;
    let few = v1::WordHistogram { words: vec![3, 5], counts: vec![1, 2] };
    let few = FrameInput { content: FrameContent::Histogram(few), ..frame(4) };
    let frames = [as_words(1), as_words(2), as_histogram(3), few];
    answers_of(&client, words_options("drive", "robot"), frames).await;
    let of_words = Drawn::of(&client.frame_picture(&name("drive", 2), Some(0)).await.unwrap());
    assert!(of_words.images.is_empty() && !of_words.green.is_empty(), "{of_words:?}");
    assert!(of_words.text.contains("no image of it is kept") && !of_words.text.contains("is not known"));
    let counted = Drawn::of(&client.frame_picture(&name("drive", 3), Some(0)).await.unwrap());
    assert!(counted.text.contains("where its words are is not known"), "{}", counted.text);
    // Those of the frame beside it are known.
    assert_eq!(counted.green.len() + counted.red.len(), words_of(1).len());

    for (sequence, place, fragment) in [
        (1, None, "no frame of place 0 was there"),
        (2, Some(7), "no frame of place 7 was there"),
        (4, None, "showed too little"),
        (9, None, "has no frame 9"),
    ] {
        let (code, message) = refused(client.frame_picture(&name("drive", sequence), place).await);
        assert_status(&format!("frame {sequence}"), (code, &message), Code::NotFound, fragment);
    }
    assert!(client.frame_picture(&name("drive", 4), Some(0)).await.is_ok());
    server.stop().await;
}

#[test]
fn the_command_line_writes_pictures() {
    let waypost = CommandLine::new();
    waypost.prepare();
    let folder = folder(6);
    waypost.json(&["stream", path(folder.path()), "--map", "drive", "--session", "robot"]);
    let file = folder.path().join("six.svg");
    let text = waypost.text(&["explain", "drive", "robot", "6", "--picture", path(&file)]);
    assert!(text.contains(path(&file)), "{text}");
    let drawn = Drawn::of(&std::fs::read(&file).unwrap());
    assert!(drawn.text.contains(&name("drive", 6)) && !drawn.green.is_empty(), "{drawn:?}");
    let explained = waypost.json(&["explain", "drive", "robot", "6", "--place", "0"]);
    let picture = explained["picture"].as_str().unwrap();
    assert!(picture.starts_with(&format!("/v1/{}/picture?place_number=0", name("drive", 6))), "{picture}");
    let beside = name("drive", 1);
    waypost.text(&[
        "explain",
        "drive",
        "robot",
        "6",
        "--picture",
        path(&file),
        "--force",
        "--beside",
        &beside,
    ]);
    let drawn = Drawn::of(&std::fs::read(&file).unwrap());
    assert!(drawn.text.contains("side by side") && drawn.text.contains(&beside), "{drawn:?}");
    assert_eq!(drawn.expected, [] as [u32; 0], "nothing was expected of that frame");
    let (code, stderr) = waypost.fails(&[
        "explain",
        "drive",
        "robot",
        "6",
        "--picture",
        path(&folder.path().join("none/six.svg")),
    ]);
    assert!(code == 1 && stderr.contains("there is no folder"), "{code}: {stderr}");
    let late = ["explain", "drive", "robot", "1", "--picture", path(&file), "--force"];
    let (code, stderr) = waypost.fails(&late);
    assert!(code == 4 && stderr.contains("no frame of place 0"), "{code}: {stderr}");
}
