//! The drives of a database, streamed one after another.

use std::hash::{BuildHasher, RandomState};
use std::io::Write;
use std::sync::Arc;

use serde::Serialize;
use waypost_bags::Camera;
use waypost_bags::rtabmap::{NoCamera, RtabMap};
use waypost_client::{Client, SessionOptions, v1};

use crate::camera_file::described_camera;
use crate::commands::stream::closure_line;
use crate::drive::camera_message;
use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::names::short_map;
use crate::output::Output;
use crate::progress;
use crate::replay::{Recording, Replay};
use crate::resumed::{Compared, check_begun_with};
use crate::robot_words::ContentMaker;
use crate::rtab_drive::RtabDrive;

/// What stands for no camera.
const NONE: &str = "none";

/// A session that is in the map.
#[derive(Serialize)]
pub(super) struct Imported {
    /// RTAB-Map's.
    pub(super) map_id: i64,
    /// maps/{map}/sessions/{session}
    pub(super) session: String,
    pub(super) nodes: usize,
    pub(super) frames: usize,
    /// Null in a new session.
    pub(super) resumed_after_sequence: Option<u64>,
    /// Frames that were answered now, and not in an earlier run.
    pub(super) answered: usize,
    pub(super) refused: usize,
    /// Whether a camera was declared.
    pub(super) camera: bool,
    #[serde(skip)]
    pub(super) index: usize,
}

/// The sessions with frames, each with its camera.
///
/// # Errors
/// [`Failure::Unfit`] where a calibration is missing and none is given.
pub(super) fn drives(map: &Arc<RtabMap>, camera: Option<&str>) -> Result<Vec<Arc<RtabDrive>>, Failure> {
    let with_frames =
        map.sessions().iter().enumerate().filter(|(_, session)| session.frames().next().is_some());
    let drives = with_frames.map(|(index, session)| {
        let size_px = session.frames().find_map(|node| node.image.ok()).unwrap_or_default();
        let camera: Option<Camera> = match (camera, &session.camera) {
            (Some(NONE), _) => None,
            (Some(described), _) => Some(described_camera(described, size_px)?),
            (None, Ok(camera)) => Some(camera.clone()),
            (None, Err(reason)) => return Err(no_camera(session.map_id, reason)),
        };
        let camera = camera.as_ref().map(camera_message);
        Ok(Arc::new(RtabDrive { map: Arc::clone(map), index, camera }))
    });
    drives.collect()
}

fn no_camera(map_id: i64, reason: &NoCamera) -> Failure {
    Failure::Unfit(format!(
        "the camera of map_id {map_id} is not known: {reason}. Nothing was sent; describe it with --camera FILE_OR_NUMBERS, or \
         give --camera none, and loop closures measure no metres"
    ))
}

/// Where drives are streamed to.
pub(super) struct Importing<'a> {
    pub(super) client: &'a Client,
    pub(super) map: &'a str,
    /// Of the sessions' names.
    pub(super) prefix: &'a str,
    pub(super) output: Output,
}

impl Importing<'_> {
    /// Streams what is not in the map yet.
    pub(super) async fn session(&self, drive: Arc<RtabDrive>) -> Result<Imported, Failure> {
        let map_id = drive.session().map_id;
        let session_id = format!("{}-{map_id}", self.prefix);
        let run_id = format!("{:016x}", RandomState::new().hash_one(()));
        let camera = drive.camera.clone();
        let options = SessionOptions { session_id, run_id, camera, ..SessionOptions::new(self.map) };
        let session = self.client.open_session(options).await?;
        let v1::SessionOpened { session: name, last_committed_sequence: committed, .. } =
            session.opened().clone();
        let replay = Replay {
            recording: Recording::Database(Arc::clone(&drive)),
            pace_hz: None,
            contents: ContentMaker::Images,
        };
        if let Some(committed) = committed {
            let compared = Compared::of(drive.camera.as_ref());
            check_begun_with(self.client, (self.map, &name), &replay, committed, compared).await?;
        }
        let after_sequence = committed.unwrap_or(0);
        let to_stream = drive.count_after(after_sequence);
        match committed {
            Some(_) if to_stream == 0 => self.output.line(format_args!("{name} is complete"))?,
            Some(sequence) => self.output.line(format_args!("{name} resumed after frame {sequence}"))?,
            None => self.output.line(format_args!("{name} begun: {to_stream} frames of map_id {map_id}"))?,
        }
        let bar = progress::counter(self.output, "frames answered", to_stream);
        let mut imported = Imported {
            map_id,
            session: name.clone(),
            nodes: drive.session().nodes.len(),
            frames: drive.session().frames().count(),
            resumed_after_sequence: committed,
            answered: 0,
            refused: 0,
            camera: drive.camera.is_some(),
            index: drive.index,
        };
        let streaming = replay.stream(session, after_sequence, |row| {
            bar.inc(1);
            *(if row.refusal_code.is_some() { &mut imported.refused } else { &mut imported.answered }) += 1;
            bar.suspend(|| self.tell(&row, &replay, &name))
        });
        tokio::select! {
            streamed = streaming => streamed?,
            interrupt = tokio::signal::ctrl_c() => {
                interrupt.map_err(Failure::Runtime)?;
                bar.abandon();
                return Err(Failure::Interrupted(self.stopped(&name)));
            }
        };
        bar.finish_and_clear();
        Ok(imported)
    }

    fn tell(&self, row: &FrameRow, replay: &Replay, session: &str) -> Result<(), Failure> {
        if let Some(message) = &row.refusal_message {
            let code = row.refusal_code.unwrap_or_default();
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "{}: refused, {code}: {message}", row.image);
        }
        match row.reason {
            Some("loop_closure") => self.output.line(closure_line(row, replay, session)),
            _ => Ok(()),
        }
    }

    fn stopped(&self, session: &str) -> String {
        let id = session.rsplit('/').next().unwrap_or_default();
        let map = short_map(self.map);
        format!(
            "stopped in {id}; the same command goes on there, and `waypost session rm {map} {id}` takes it out"
        )
    }
}
