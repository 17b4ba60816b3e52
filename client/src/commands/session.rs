//! `waypost session`: what robots streamed into a map.

use clap::Subcommand;
use serde::Serialize;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use super::job;
use crate::failure::Failure;
use crate::output::{Output, table};
use crate::views::{FrameRow, SessionView};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List the sessions of a map, oldest first
    #[command(visible_alias = "list")]
    Ls {
        /// Name of the map
        map: String,
    },
    /// List the frames of a session with what was decided about them
    Frames {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
    },
    /// Take a session out of its map, with its images and all that only it has shown. It cannot be undone
    Rm {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
    },
}

/// A frame as the log keeps it.
#[derive(Serialize)]
struct Frame {
    learnt: bool,
    log_bytes: u64,
    features_bytes: u64,
    thumbnail_bytes: u64,
    image_bytes: u64,
    #[serde(flatten)]
    row: FrameRow,
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Ls { map } => list(client.sessions(&map).await?, output),
        Command::Frames { map, session } => {
            let map = map.strip_prefix("maps/").unwrap_or(&map);
            frames(client.frames(&format!("maps/{map}/sessions/{session}")).await?, output)
        }
        Command::Rm { map, session } => {
            let map = map.strip_prefix("maps/").unwrap_or(&map);
            let name = format!("maps/{map}/sessions/{session}");
            let job = client.remove_session(&name).await?;
            job::follow(&client, &job.name, output).await?;
            output.result(&json!({ "removed": name }), |out| writeln!(out, "removed {name}"))
        }
    }
}

fn list(sessions: Vec<v1::Session>, output: Output) -> Result<(), Failure> {
    let sessions: Vec<SessionView> = sessions.into_iter().map(SessionView::from).collect();
    output.result(&json!({ "sessions": sessions }), |out| {
        let or_none = |number: Option<u64>| number.map_or("-".to_owned(), |number| number.to_string());
        let rows = sessions.iter().map(|session| {
            [
                session.name.rsplit('/').next().unwrap_or_default().to_owned(),
                session.frames.to_string(),
                session.loop_closures.to_string(),
                or_none(session.first_sequence),
                or_none(session.last_sequence),
            ]
        });
        table(out, ["SESSION", "FRAMES", "CLOSURES", "FIRST", "LAST"], rows)
    })
}

fn frames(frames: Vec<v1::FrameRecord>, output: Output) -> Result<(), Failure> {
    let frames: Vec<Frame> = frames.into_iter().map(Frame::from).collect();
    output.result(&json!({ "frames": frames }), |out| {
        let rows = frames.iter().map(
            |Frame { row, log_bytes, features_bytes, thumbnail_bytes, image_bytes, .. }| {
                let bytes = log_bytes + features_bytes + thumbnail_bytes + image_bytes;
                [
                    row.sequence.to_string(),
                    row.reason.unwrap_or_default().to_owned(),
                    row.place.map_or("-".to_owned(), |place| place.to_string()),
                    row.posterior.map_or("-".to_owned(), |posterior| format!("{posterior:.6}")),
                    bytes.to_string(),
                ]
            },
        );
        table(out, ["FRAME", "REASON", "PLACE", "POSTERIOR", "BYTES"], rows)
    })
}

impl From<v1::FrameRecord> for Frame {
    fn from(record: v1::FrameRecord) -> Self {
        let v1::FrameRecord { name: _, stamp_ns, answer, odometry: _, learnt, storage, histogram: _ } =
            record;
        let storage = storage.unwrap_or_default();
        let v1::FrameStorage { log_bytes, features_bytes, thumbnail_bytes, image_bytes } = storage;
        let row = FrameRow::answered("", stamp_ns, answer.unwrap_or_default());
        Self { learnt, log_bytes, features_bytes, thumbnail_bytes, image_bytes, row }
    }
}
