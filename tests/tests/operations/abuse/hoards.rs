//! Messages that are begun and not ended, and answers that nobody reads: what they may take of the memory.

use std::io::Write;
use std::time::Duration;

use waypost_client::{Client, ClientOptions, v1};

use super::wire::{Wire, block, data, frame, kind, opened};
use super::{Attacked, MOST_GROWTH};
use crate::harness::import_model;

/// What half-sent messages of one token may take, as the server has it, and what is around them.
const MOST_HOARDED: u64 = (64 << 20) + MOST_GROWTH;

/// Calls in all, and what each sends of a message of 16 MiB.
const CALLS: u32 = 24;
const EACH: usize = 15 << 20;

/// The token of a robot.
async fn robot(attacked: &Attacked) -> String {
    let options = ClientOptions::new(attacked.server.endpoint()).with_token(&attacked.secret);
    let admin = Client::connect(options).await.unwrap();
    admin.create_token("robot", v1::token::Role::Robot).await.unwrap().1
}

/// One connection of one robot, with so many calls, each with most of a message and no end, as fast as the server takes them;
/// and the bytes that it took.
fn hoarding(attacked: &Attacked, robot: String, calls: u32) -> tokio::task::JoinHandle<(Wire, usize)> {
    let port = attacked.server.grpc();
    tokio::task::spawn_blocking(move || {
        let mut wire = Wire::to(port).unwrap();
        let bearer = format!("Bearer {robot}");
        let call = block("/waypost.v1.RecognitionService/Query", &[("authorization", &bearer)]);
        let mut said = opened();
        for number in 0..calls {
            said.extend(frame(kind::HEADERS, kind::END_HEADERS, 2 * number + 1, &call));
        }
        wire.write_all(&said).unwrap();
        let prefix = [&[0][..], &(16_u32 << 20).to_be_bytes()].concat();
        let mut left: Vec<_> = (0..calls).map(|number| (2 * number + 1, prefix.len() + EACH)).collect();
        let sent = wire.pour(&mut left, Duration::from_secs(4), |stream, first, length| {
            let mut bytes = vec![0; length];
            if first {
                bytes[..prefix.len()].copy_from_slice(&prefix);
            }
            data(stream, &bytes)
        });
        (wire, sent)
    })
}

/// All calls with one token.
#[tokio::test(flavor = "multi_thread")]
async fn a_robots_half_sent_messages_have_a_bound() {
    let attacked = Attacked::start().await;
    let robot = robot(&attacked).await;
    let (wire, sent) = hoarding(&attacked, robot, CALLS).await.unwrap();
    attacked.others_are_served().await;
    println!("{} MiB of half-sent messages were taken", sent >> 20);
    assert!(sent > 30 << 20, "only {} MiB were taken: the server was hardly asked", sent >> 20);
    let growth = attacked.server.rss_bytes().saturating_sub(attacked.rss_before);
    assert!(growth <= MOST_HOARDED, "the memory grew by {} MiB", growth >> 20);
    drop(wire);
    attacked.ends(MOST_HOARDED);
}

/// What answers of one token may take that nobody reads.
const MOST_UNREAD: u64 = 64 << 20;

/// Calls for a file of almost a megabyte, on a connection that gives their answers no room.
const UNREAD: u32 = 200;

#[tokio::test(flavor = "multi_thread")]
async fn unread_answers_of_a_token_have_a_bound() {
    let attacked = Attacked::start().await;
    let options = ClientOptions::new(attacked.server.endpoint()).with_token(&attacked.secret);
    let admin = Client::connect(options).await.unwrap();
    let model = import_model(&admin).await.name;
    let bearer = format!("Bearer {}", robot(&attacked).await);
    let port = attacked.server.grpc();
    let wire = tokio::task::spawn_blocking(move || {
        let mut wire = Wire::to(port).unwrap();
        let call = block("/waypost.v1.ModelService/ExportModel", &[("authorization", &bearer)]);
        let name = [&[0x0a, model.len() as u8], model.as_bytes()].concat();
        let message = [&[0][..], &(name.len() as u32).to_be_bytes(), &name].concat();
        // An initial window of no bytes.
        let mut said = [opened(), frame(kind::SETTINGS, 0, 0, &[0, 4, 0, 0, 0, 0])].concat();
        for stream in (1..).step_by(2).take(UNREAD as usize) {
            said.extend(frame(kind::HEADERS, kind::END_HEADERS, stream, &call));
            said.extend(frame(kind::DATA, kind::END_STREAM, stream, &message));
        }
        wire.write_all(&said).unwrap();
        wire
    });
    let wire = wire.await.unwrap();
    tokio::time::sleep(Duration::from_secs(3)).await;
    attacked.others_are_served().await;
    let growth = attacked.server.rss_bytes().saturating_sub(attacked.rss_before);
    println!("{} MiB of answers were not read", growth >> 20);
    assert!(growth <= MOST_UNREAD, "the memory grew by {} MiB", growth >> 20);
    drop(wire);
    attacked.ends(MOST_UNREAD);
}
