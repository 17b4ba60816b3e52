//! Every field of every message, bad in every way that we could think of: an exact status, a message that
//! says how to mend it, and a map that stays as it is.

mod deletion;
mod frames;
mod maps;
mod models;
mod opening;
mod rest;
mod sessions;
mod words;

use std::collections::BTreeSet;
use std::fmt::Debug;

use tonic::transport::Channel;
use tonic::{Code, Status};
use waypost_client::{Client, v1};

use crate::harness::{Server, channel, map_request, mapped, model_of_other_words, state_hash, take_model};

/// The least number of cases in all tables.
const CASES: usize = 500;

/// A server with a map of a few frames, and one over other words.
struct Ground {
    server: Server,
    client: Client,
}

/// All that a bad request must leave alone.
#[derive(Debug, PartialEq)]
struct Untouched {
    state_hash: String,
    maps: Vec<v1::Map>,
    models: Vec<v1::Model>,
    sessions: Vec<v1::Session>,
}

impl Ground {
    async fn new() -> Self {
        let (server, client) = Server::with_map().await;
        mapped(&client, "robot", 1..=10).await;
        take_model(&client, "other", &model_of_other_words()).await;
        client.create_map(map_request("other", "other")).await.unwrap();
        Self { server, client }
    }

    async fn channel(&self) -> Channel {
        channel(&self.server.endpoint()).await
    }

    async fn untouched(&self) -> Untouched {
        Untouched {
            state_hash: state_hash(&self.client, "drive").await,
            maps: self.client.maps().await.unwrap(),
            models: self.client.models().await.unwrap(),
            sessions: self.client.sessions("drive").await.unwrap(),
        }
    }
}

/// The cases that were checked, by name, and what was wrong with some: one run tells all of it.
struct Cases {
    table: &'static str,
    names: BTreeSet<String>,
    wrong: Vec<String>,
}

impl Cases {
    fn new(table: &'static str) -> Self {
        Self { table, names: BTreeSet::new(), wrong: Vec::new() }
    }

    /// A call that must be refused just so.
    fn refused<T: Debug>(&mut self, case: &str, result: Result<T, Status>, code: Code, fragment: &str) {
        match result {
            Err(status) => self.says(case, (status.code(), status.message()), (code, fragment)),
            Ok(taken) => self.is_right(case, false, &format!("not refused: {taken:?}")),
        }
    }

    /// What is said must be of the code, and have the fragment in it.
    fn says<C: Copy + Debug + PartialEq>(
        &mut self,
        case: &str,
        (code, message): (C, &str),
        (expected, fragment): (C, &str),
    ) {
        let right = code == expected && message.contains(fragment);
        self.is_right(case, right, &format!("{code:?} {message:?}, not {expected:?} {fragment:?}"));
    }

    /// Counts a case, which must not have been there yet.
    fn is_right(&mut self, case: &str, right: bool, found: &str) {
        let name = format!("{}: {case}", self.table);
        if !right {
            self.wrong.push(format!("{name}: {found}"));
        }
        assert!(self.names.insert(name), "{case} is there twice");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_input_of_every_kind_is_refused_and_changes_nothing() {
    let ground = Ground::new().await;
    let (mut names, mut wrong) = (BTreeSet::new(), Vec::new());
    let mut before = ground.untouched().await;
    macro_rules! tables {
        ($($table:path),+ $(,)?) => {$(
            let mut cases = $table(&ground).await;
            names.append(&mut cases.names);
            wrong.append(&mut cases.wrong);
            let after = ground.untouched().await;
            assert_eq!(after, before, stringify!($table));
            before = after;
        )+};
    }
    tables!(
        maps::creating,
        maps::names,
        maps::pages,
        maps::places_and_words,
        maps::not_protobuf,
        models::models,
        models::jobs,
        sessions::queries,
        sessions::queried_words,
        sessions::names,
        sessions::pages,
        opening::openings,
        opening::cameras,
        rest::paths_and_queries,
        rest::requests,
    );
    drop(before);
    // These stream: the frames that are mended are taken, and each case looks for itself.
    for mut cases in [frames::bad_words_in_frames(&ground).await, frames::bad_frames(&ground).await] {
        names.append(&mut cases.names);
        wrong.append(&mut cases.wrong);
    }
    assert!(wrong.is_empty(), "{} of {} cases:\n{}", wrong.len(), names.len(), wrong.join("\n"));
    assert!(names.len() >= CASES, "only {} cases", names.len());
    ground.server.stop().await;
}
