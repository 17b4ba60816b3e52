//! A data directory with something of everything, and what can be asked about it.

use std::collections::BTreeMap;
use std::path::Path;

use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;
use waypost_client::{Client, ClientOptions, v1};
use waypost_server::Role;
use waypost_server::offline::{TokenLimits, create_token};

use crate::harness::{
    Server, answers, answers_of, as_histogram, by_words_request, database_options, followed, frame,
    import_model, map_request, recalibrated_model, take_model, words_options,
};

/// A map of images, of two sessions.
pub(super) const BASE: &str = "base";
/// A map of some of the same images.
pub(super) const OTHER: &str = "other";

/// The frame of a map whose features [`rot`] damages.
pub(super) const ROTTEN: &str = "sessions/o/frames/8";

/// Flips a bit of what is kept of that frame of the map [`OTHER`].
pub(super) async fn rot(data: &Path) {
    let mut database = database_options(data).connect().await.unwrap();
    let select = "SELECT content FROM frame_media WHERE kind = 'features' AND (map_id, position) = \
                  (SELECT map_id, position FROM log WHERE sequence = 8 AND map_id = \
                  (SELECT id FROM maps WHERE name = 'other'))";
    let features: Vec<u8> = sqlx::query_scalar(select).fetch_one(&mut database).await.unwrap();
    database.close().await.unwrap();
    let file = data.join("waypost.sqlite");
    let mut content = std::fs::read(&file).unwrap();
    let end = features.last_chunk::<24>().unwrap();
    // The map that was made before keeps the same of the same image.
    let at = content.windows(end.len()).rposition(|window| window == end).expect("it is in the file");
    content[at] ^= 1;
    std::fs::write(&file, content).unwrap();
}

pub(super) struct Template {
    pub(super) directory: TempDir,
    /// Of an admin's token.
    pub(super) secret: String,
}

impl Template {
    pub(super) async fn new() -> Self {
        let directory = super::super::scratch();
        let limits = TokenLimits::default();
        let secret = create_token(directory.path().into(), "operator", Role::Admin, limits).await.unwrap();
        let template = Self { directory, secret };
        let server = Server::start_on(template.directory.path()).await;
        let client = template.client(&server.endpoint()).await;
        let model = import_model(&client).await;
        take_model(&client, "second", &recalibrated_model(0.45)).await;
        client.create_map(by_words_request("drive", &model.name)).await.unwrap();
        answers_of(&client, words_options("drive", "robot"), (1..=20).map(as_histogram)).await;
        for map in [BASE, OTHER] {
            client.create_map(map_request(map, &model.name)).await.unwrap();
        }
        answers(&client, BASE, "a", (1..=24).map(frame)).await;
        answers(&client, BASE, "b", (60..=64).map(frame)).await;
        answers(&client, OTHER, "o", (1..=22).map(frame)).await;
        server.stop().await;
        template
    }

    /// A client that may do everything.
    pub(super) async fn client(&self, endpoint: &str) -> Client {
        Client::connect(ClientOptions::new(endpoint).with_token(&self.secret)).await.unwrap()
    }

    /// What a directory holds, as a server tells it that takes a frame, too, once it has come to the end of what was begun.
    pub(super) async fn told(&self, data: &Path) -> (State, BTreeMap<String, v1::job::State>) {
        let server = Server::start_on(data).await;
        let client = self.client(&server.endpoint()).await;
        for job in client.jobs().await.unwrap() {
            followed(&client, &job).await;
        }
        let state = state(&client).await;
        let jobs = client.jobs().await.unwrap();
        let jobs = jobs.into_iter().map(|job| (job.name.clone(), job.state())).collect();
        for map in [BASE, "drive"] {
            let answered = answers_of(&client, words_options(map, "afterwards"), [as_histogram(45)]).await;
            assert_eq!(answered.len(), 1);
        }
        server.stop().await;
        (state, jobs)
    }
}

/// All that a server tells, but for times: one line for each thing, by its name.
pub(super) type State = BTreeMap<String, String>;

pub(super) async fn state(client: &Client) -> State {
    let mut state = State::new();
    for model in client.models().await.unwrap() {
        state.insert(model.name, model.display_name);
    }
    for token in client.tokens().await.unwrap() {
        let v1::Token { name, role, abilities, maps, quotas, .. } = token;
        state.insert(name, format!("{role:?} {abilities:?} {maps:?} {quotas:?}"));
    }
    for map in client.maps().await.unwrap() {
        let whole = client.map(&map.name, v1::MapView::Full).await.unwrap();
        let v1::Map { model, frames, places, links, loop_closures, sessions, state_hash, .. } = whole;
        let counts = (frames, places, links, loop_closures, sessions);
        let corrections = client.corrections(&map.name).await.unwrap();
        // The log has when somebody said something, so that the map has another hash each time.
        let state_hash = state_hash.filter(|_| corrections.is_empty());
        state.insert(map.name.clone(), format!("{state_hash:?} {counts:?} {model}"));
        let labels = client.labels(&map.name).await.unwrap();
        let labels = labels.into_iter().map(|label| format!("{label:?}")).collect::<Vec<_>>();
        state.insert(format!("{}: labels", map.name), labels.join(", "));
        for correction in corrections {
            let said = (correction.verdict, correction.undone.is_some());
            state.insert(correction.name, format!("{said:?}"));
        }
        for session in client.sessions(&map.name).await.unwrap() {
            let frames = client.frames(&session.name).await.unwrap();
            let answers = frames.into_iter().map(|frame| format!("{:?}", frame.answer)).collect::<Vec<_>>();
            state.insert(session.name, answers.join(", "));
        }
    }
    state
}
