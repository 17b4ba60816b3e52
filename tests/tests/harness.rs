//! What every test needs: servers, the shipped drive and model, streams.

mod command_line;
mod database;
mod driving;
mod evo;
mod machines;
mod models;
mod panoramas;
mod postgres;
mod process;
mod proxy;
mod reference;
mod rest;
mod sequence;
mod server;
mod small_disk;
mod stream;
mod template;
mod told;
mod words;

pub(crate) use command_line::{CommandLine, folder, json_object, path};
pub(crate) use database::{database_options, tables};
pub(crate) use driving::{Drive, building, camera_ahead, driven, exported, frame_input, odometry, planar};
pub(crate) use evo::evo_rmse_m;
pub(crate) use machines::Machines;
pub(crate) use models::{model_of_other_words, recalibrated_model, take_model};
pub(crate) use panoramas::{PANORAMA_PX, Panoramas, TaughtPlace, by_looks_request, taught_at, taught_hall};
pub(crate) use postgres::{Cluster, TestDatabase, location};
pub(crate) use process::{Built, ServerProcess, run_to_its_end};
pub(crate) use proxy::Proxy;
pub(crate) use reference::{BY_WORDS_THRESHOLD, Reference, reference, reference_by_words};
pub(crate) use rest::{Answer, Surveyed, found, get, http, led};
pub(crate) use sequence::{SECOND_NS, first_return, frame, frame_count, images, model_file, workspace};
pub(crate) use server::{Server, channel, channel_with_window, import_model, said, state_hash};
pub(crate) use small_disk::SmallDisk;
pub(crate) use stream::{
    RawStream, answers, answers_of, open, session_options, stream, stream_through, wire,
};
pub(crate) use template::Template;
pub(crate) use told::{Told, ToldMatch, decided, decided_match, told, told_match};
pub(crate) use words::{as_histogram, as_words, histogram, in_words, mapped, word_maker, words_options};

use std::time::Duration;

use waypost_client::{Client, Code, Error, v1};

/// Far more than anything here takes: only what hangs gets there.
const PATIENCE: Duration = Duration::from_secs(120);

/// The result of `work`, unless it hangs.
pub(crate) async fn in_time<T>(work: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, work).await.expect("this hangs")
}

/// The status that the server refused with.
#[track_caller]
pub(crate) fn refused<T: std::fmt::Debug>(result: Result<T, Error>) -> (Code, String) {
    match result {
        Err(Error::Status { code, message }) => (code, message),
        other => panic!("not refused by the server: {other:?}"),
    }
}

/// Whether a status is the one expected: its exact code, and a part of its message.
#[track_caller]
pub(crate) fn assert_status(case: &str, (code, message): (Code, &str), expected: Code, fragment: &str) {
    assert_eq!(code, expected, "{case}: {message}");
    assert!(message.contains(fragment), "{case}: {message:?} does not say {fragment:?}");
}

/// Follows a job to its end; all states, the last one included.
pub(crate) async fn followed(client: &Client, job: &v1::Job) -> Vec<v1::Job> {
    let mut steps = client.watch_job(&job.name).await.unwrap();
    let mut states = Vec::new();
    while let Some(step) = in_time(steps.next()).await.unwrap() {
        states.push(step);
    }
    states
}

/// A map that is recognised by words alone, for frames of all forms to decide alike, and soon sure of itself.
pub(crate) fn by_words_request(map: &str, model: &str) -> v1::CreateMapRequest {
    let settings = v1::MapSettings {
        verification: v1::map_settings::Verification::None.into(),
        closure_threshold: Some(BY_WORDS_THRESHOLD),
        ..v1::MapSettings::default()
    };
    v1::CreateMapRequest { settings: Some(settings), ..map_request(map, model) }
}

/// A map with the server's default settings.
pub(crate) fn map_request(map: &str, model: &str) -> v1::CreateMapRequest {
    v1::CreateMapRequest { map_id: map.to_owned(), model: model.to_owned(), settings: None }
}
