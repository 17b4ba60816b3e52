//! A simulated robot that goes twice round a building, and what merges are asked with.

use std::path::Path;

use posegraph::trajectory::from_tum;
use tempfile::TempDir;
use waypost_client::v1::export_poses_request::{Body, Format, Frame};
use waypost_client::v1::merge_source::Outcome;
use waypost_client::{Client, FrameInput, FrameOutcome, SessionOptions, v1};
use waypost_sim::robot::WheelErrors;
use waypost_sim::simulation::CameraFrame;
use waypost_sim::worlds::NamedWorld;

use crate::harness::{
    Drive, Server, ServerProcess, Template, camera_ahead, exported, followed, import_model, map_request,
    session_options, stream,
};

static MAPPED: Template = Template::new();

/// Twice round a ring of corridors: a round each day.
pub(super) struct Rounds(pub(super) Drive);

impl Rounds {
    pub(super) fn new() -> Self {
        let wheels = WheelErrors { scale: 0.01, drift_rad_per_m: 0.2_f64.to_radians(), ..WheelErrors::NONE };
        Self(Drive::new(NamedWorld::Loop, 3, "twice", wheels))
    }

    /// A round, the first or the second.
    pub(super) fn day(&self, day: usize) -> &[CameraFrame] {
        let (first, second) = self.0.frames.split_at(self.0.frames.len() / 2);
        if day == 0 { first } else { second }
    }

    /// A directory with a map of each day, "monday" and "tuesday".
    pub(super) async fn mapped(&self) -> TempDir {
        let make = async |directory: &Path| {
            let server = Server::start_on(directory).await;
            self.map(&server.client().await).await;
            server.stop().await;
        };
        MAPPED.directory(make).await
    }

    /// The same for servers that are processes of their own.
    pub(super) async fn mapped_in_sqlite(&self) -> TempDir {
        let make = async |directory: &Path| {
            let server = ServerProcess::start(directory);
            self.map(&server.client().await).await;
            server.stop();
        };
        MAPPED.in_sqlite(make).await
    }

    async fn map(&self, client: &Client) {
        let model = import_model(client).await;
        for (day, map) in ["monday", "tuesday"].into_iter().enumerate() {
            client.create_map(map_request(map, &model.name)).await.unwrap();
            let outcomes = self.drive(client, map, "robot", self.day(day)).await;
            assert_eq!(outcomes.len(), self.day(day).len());
        }
    }

    pub(super) async fn drive(
        &self,
        client: &Client,
        map: &str,
        session: &str,
        frames: &[CameraFrame],
    ) -> Vec<v1::FrameAnswer> {
        let options = SessionOptions { camera: Some(camera_ahead()), ..session_options(map, session) };
        let noted = self.0.inputs_of(frames).map(|frame| FrameInput { note: note(frame.sequence), ..frame });
        let outcomes = stream(client.open_session(options).await.unwrap(), noted).await;
        let answer = |outcome| match outcome {
            FrameOutcome::Answer(answer) => answer,
            FrameOutcome::Refusal(refusal) => panic!("{refusal:?}"),
        };
        outcomes.into_iter().map(answer).collect()
    }

    /// A drive on the map as TUM.
    pub(super) async fn exported(&self, client: &Client, session: &str) -> Vec<u8> {
        exported(client, session, Format::Tum, Frame::Map, Body::Base).await
    }

    /// Root mean square of how far the frames of a session are from the truth, in the frame of the first day's first.
    pub(super) async fn rmse_m(&self, client: &Client, session: &str) -> f64 {
        self.0.rmse_m(&from_tum(&self.exported(client, session).await).unwrap())
    }
}

/// What the robot calls a frame.
pub(super) fn note(sequence: u64) -> String {
    format!("{sequence:04}.png")
}

/// What becomes of an overlap that was found.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum OnceFound {
    Propose,
    Commit,
}

pub(super) fn request(sources: &[&str], target: &str, once_found: OnceFound) -> v1::MergeMapsRequest {
    v1::MergeMapsRequest {
        sources: sources.iter().map(|map| format!("maps/{map}")).collect(),
        target: format!("maps/{target}"),
        auto_commit: once_found == OnceFound::Commit,
        min_support: None,
    }
}

/// The merge once its job is done.
pub(super) async fn done(client: &Client, merge: &v1::Merge) -> v1::Merge {
    let job = client.job(&merge.job).await.unwrap();
    followed(client, &job).await;
    client.merge(&merge.name).await.unwrap()
}

pub(super) fn overlap(merge: &v1::Merge) -> &v1::MapOverlap {
    match &merge.sources[0].outcome {
        Some(Outcome::Overlap(overlap)) => overlap,
        other => panic!("{other:?}"),
    }
}
