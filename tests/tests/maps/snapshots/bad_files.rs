//! Files that are no snapshots, or no longer: refused with what to do, and nothing is left of them.

use fabmap::PlaceId;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::log::{FrameEvent, MapEvent};

use super::file::{EVENT, LABEL, MAP, MEDIUM, MODEL, SESSION, records, sealed};
use super::*;
use crate::harness::{model_file, said};

/// Words of the fixture's vocabulary.
const WORDS: usize = 120;

fn fixture() -> Vec<u8> {
    std::fs::read(workspace().join(VERSION_2)).unwrap()
}

/// What a file is refused with: at once, or by the job.
async fn refusal(client: &Client, case: &str, file: Vec<u8>) -> String {
    match import(client, "", file).await {
        Ok(job) => {
            assert_eq!(job.state(), v1::job::State::Failed, "{case}: {job:?}");
            assert_eq!(job.result, None, "{case}");
            said(&job.error).to_owned()
        }
        Err(waypost_client::Error::Status { code: Code::InvalidArgument, message }) => message,
        Err(other) => panic!("{case}: {other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn damaged_files_are_refused_and_leave_nothing() {
    let server = Server::start().await;
    let client = server.client().await;
    let before = rows(server.directory()).await;
    let whole = fixture();
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut flips: Vec<usize> = (0..40).map(|_| random.random_range(0..whole.len())).collect();
    flips.extend([0, 8, 12, 13, 16, 20, whole.len() - 33, whole.len() - 1]);
    for position in flips {
        let mut flipped = whole.clone();
        flipped[position] ^= 1 << random.random_range(0..8);
        let message = refusal(&client, &format!("byte {position}"), flipped).await;
        assert!(message.starts_with("the snapshot cannot be imported: "), "byte {position}: {message}");
        assert!(message.contains("; "), "byte {position}: {message:?} does not say how to mend it");
    }
    for _ in 0..12 {
        let length = random.random_range(0..whole.len());
        let message = refusal(&client, &format!("{length} bytes"), whole[..length].to_vec()).await;
        assert!(message.contains("it was cut short, so fetch it again"), "{length} bytes: {message}");
    }
    rows_become(server.directory(), &before).await;
    imported(&client, "", whole).await;
    server.stop().await;
}

type Edit = fn(&mut Vec<(u8, Vec<u8>)>);

fn first(records: &[(u8, Vec<u8>)], kind: u8) -> usize {
    records.iter().position(|(of, _)| *of == kind).unwrap()
}

/// Changes the frame at this position of the log; positions below 128 are one byte.
fn with_frame(records: &mut [(u8, Vec<u8>)], position: usize, change: impl FnOnce(&mut FrameEvent)) {
    let event = first(records, EVENT) + position;
    let content = &mut records[event].1;
    let MapEvent::Frame(mut frame) = MapEvent::from_bytes(&content[1..], WORDS).unwrap() else {
        panic!("event {position} is no frame")
    };
    change(&mut frame);
    content.truncate(1);
    content.extend(MapEvent::Frame(frame).to_bytes());
}

/// The map record with a text in it replaced by one of the same length.
fn replace(content: &mut [u8], from: &str, to: &str) {
    assert_eq!(from.len(), to.len());
    let at = content.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
    content[at..at + to.len()].copy_from_slice(to.as_bytes());
}

/// Right by their checksum, and wrong all the same.
#[tokio::test(flavor = "multi_thread")]
async fn forged_files_are_refused_and_leave_nothing() {
    let cases: [(&str, Edit, &str); 29] = [
        ("no map", |r| drop(r.remove(0)), "out of order"),
        ("no model", |r| drop(r.remove(1)), "out of order"),
        ("two maps", |r| r.insert(1, r[0].clone()), "there twice"),
        (
            "event twice",
            |r| {
                let e = first(r, EVENT);
                r.insert(e, r[e].clone());
            },
            "event 0 where 1 should be",
        ),
        (
            "event missing",
            |r| {
                let e = first(r, EVENT);
                r.remove(e + 4);
            },
            "event 5 where 4 should be",
        ),
        (
            "session twice",
            |r| {
                let s = first(r, SESSION);
                r.insert(s, r[s].clone());
            },
            "there twice",
        ),
        (
            "session missing",
            |r| {
                let s = first(r, SESSION);
                r.remove(s + 1);
            },
            "its sessions are not those of its log",
        ),
        (
            "session's name",
            |r| {
                let s = first(r, SESSION);
                replace(&mut r[s].1, "first", "FIRST");
            },
            "is no session name",
        ),
        (
            "medium twice",
            |r| {
                let m = first(r, MEDIUM);
                r.insert(m, r[m].clone());
            },
            "there twice",
        ),
        (
            "medium of no frame",
            |r| {
                let m = first(r, MEDIUM);
                r[m].1[0] = 0;
            },
            "frame 0, which does not exist",
        ),
        (
            "medium beyond",
            |r| {
                let m = first(r, LABEL) - 1;
                r[m].1[0] = 100;
            },
            "frame 100, which does not exist",
        ),
        (
            "medium's kind",
            |r| {
                let m = first(r, MEDIUM);
                r[m].1[1] = 9;
            },
            "a medium of kind 9",
        ),
        (
            "features that are none",
            |r| {
                let m = first(r, MEDIUM);
                r[m].1.pop();
            },
            "the features of frame 1: ",
        ),
        (
            "label of no place",
            |r| {
                let l = r.len() - 1;
                r[l].1[0] = 99;
            },
            "it calls the place 99 \"Küche\", which does not exist",
        ),
        (
            "no label",
            |r| {
                let l = first(r, LABEL);
                replace(&mut r[l].1, "kitchen", "kitche ");
            },
            "is no label",
        ),
        (
            "labels out of order",
            |r| {
                let l = first(r, LABEL);
                r.swap(l, l + 1);
            },
            "a record of kind 7 out of order",
        ),
        ("record's kind", |r| r.push((9, Vec::new())), "a record of kind 9"),
        ("map's name", |r| replace(&mut r[0].1, "fixture", "Fixture"), "is no map name"),
        (
            "settings",
            |r| replace(&mut r[0].1, "\"min_words\"", "\"min_wurst\""),
            "import it with the version that exported it",
        ),
        (
            "threshold",
            |r| replace(&mut r[0].1, "\"closure_threshold\":0", "\"closure_threshold\":7"),
            "closure threshold",
        ),
        (
            "model's hash",
            |r| {
                let at = r[0].1.iter().position(|byte| *byte == 64).unwrap() + 1;
                r[0].1[at..at + 64].fill(b'a');
            },
            "it names the model aaaa",
        ),
        ("damaged model", |r| r[1].1[100] ^= 1, "its model: the checksum does not match"),
        (
            "other model",
            |r| {
                assert_eq!(r[1].0, MODEL);
                r[1].1.truncate(8);
                r[1].1.extend(std::fs::read(model_file()).unwrap());
            },
            "and holds the model",
        ),
        (
            "foreign word",
            |r| {
                with_frame(r, 3, |f| {
                    f.observation =
                        fabmap::observation::Observation::from_words(vec![7, 119, 5000], 6000).unwrap();
                });
            },
            "event 3 of its log",
        ),
        (
            "unknown place",
            |r| {
                with_frame(r, 3, |f| {
                    f.decision.place = Some(PlaceId::new(500));
                });
            },
            "event 3 of its log",
        ),
        (
            "unknown believed",
            |r| with_frame(r, 3, |f| f.belief.places = vec![(PlaceId::new(900), 0.5)]),
            "believes in a place that does not exist",
        ),
        (
            "no probability",
            |r| with_frame(r, 4, |f| f.new_place_posterior = f64::NAN),
            "a probability that is none",
        ),
        ("sequence again", |r| with_frame(r, 4, |f| f.sequence = 1), "sequence number does not rise"),
        ("wrong position", |r| with_frame(r, 4, |f| f.frame = 9), "event 9 of the log stands where 4 should"),
    ];
    let server = Server::start().await;
    let client = server.client().await;
    let before = rows(server.directory()).await;
    let whole = records(&fixture());
    assert_eq!((whole[0].0, whole[1].0), (MAP, MODEL));
    assert!(sealed(&whole) == fixture(), "taken apart and sealed again it differs");
    for (case, edit, fragment) in cases {
        let mut forged = whole.clone();
        edit(&mut forged);
        let message = refusal(&client, case, sealed(&forged)).await;
        assert!(message.contains(fragment), "{case}: {message:?} does not say {fragment:?}");
        assert!(message.contains("; "), "{case}: {message:?} does not say how to mend it");
    }
    rows_become(server.directory(), &before).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn other_files_are_refused_at_once() {
    let server = Server::start().await;
    let client = server.client().await;
    let whole = fixture();
    let with = |at: usize, bytes: &[u8]| {
        let mut changed = whole.clone();
        changed[at..at + bytes.len()].copy_from_slice(bytes);
        changed
    };
    let cases = [
        ("nothing", Vec::new(), "it was cut short, so fetch it again"),
        (
            "a model",
            std::fs::read(model_file()).unwrap(),
            "this is not a Waypost snapshot file; check which file",
        ),
        ("an image", images()[0].clone(), "this is not a Waypost snapshot file"),
        ("a newer version", with(8, &[5]), "format version 5, this program reads up to 4; update Waypost"),
        ("version 0", with(8, &[0]), "format version 0"),
        ("a huge record", with(13, &u32::MAX.to_le_bytes()), "a record of kind 1 with 4294967295 bytes"),
        ("a record beyond the end", with(13, &(16_u32 << 20).to_le_bytes()), "it was cut short"),
    ];
    for (case, file, fragment) in cases {
        let (code, message) = refused(import(&client, "", file).await);
        assert_status(case, (code, &message), Code::InvalidArgument, fragment);
    }
    let mut raw = MapServiceClient::new(channel(&server.endpoint()).await);
    let large = v1::ImportMapRequest { map_id: Some(String::new()), chunk: vec![0; (1 << 20) + 1] };
    let status = in_time(raw.import_map(futures::stream::iter([large]))).await.unwrap_err();
    assert_status(
        "a large chunk",
        (status.code(), status.message()),
        Code::InvalidArgument,
        "at most 1048576 bytes",
    );
    assert!(client.jobs().await.unwrap().is_empty(), "a job was begun");
    server.stop().await;
}
