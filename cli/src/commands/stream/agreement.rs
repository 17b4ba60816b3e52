//! How odometry goes with what images show, as a server finds it over the last frames: what no look at the odometry alone
//! tells of a slow robot.

use std::future::pending;
use std::io::Write;

use tokio::sync::oneshot;
use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::files::Asking;
use crate::replay::{Recording, Replay};

/// Frames after which it is asked for the first time: a server looks back on 33.
pub(super) const FRAMES_AT_FIRST: usize = 40;

/// A server replays the map up to the frame. Maps of more frames take it too long.
const MOST_FRAMES: u64 = 5_000;

/// A session that is streamed.
pub(super) struct Streamed<'a> {
    pub(super) client: &'a Client,
    pub(super) map: &'a str,
    /// maps/{map}/sessions/{session}
    pub(super) session: &'a str,
}

impl Streamed<'_> {
    /// Says what is found once the first frames were answered, whose last one is told by `first`. Never ends well: it is
    /// awaited beside the stream.
    ///
    /// # Errors
    /// [`Failure`] if somebody who was asked does not want to go on.
    pub(super) async fn doubt(&self, first: oneshot::Receiver<u64>, asking: Asking) -> Failure {
        let Ok(sequence) = first.await else { return pending().await };
        let Some(finding) = self.finding(sequence).await else { return pending().await };
        let told = format!("after {FRAMES_AT_FIRST} frames: {finding}");
        let remove =
            format!("the map has its frames so far; `waypost session rm` takes {} out", self.session);
        let asked = tokio::task::spawn_blocking(move || asking.confirm_going_on(&told)).await;
        match asked {
            Ok(Ok(())) => pending().await,
            Ok(Err(Failure::Unfit(said))) => Failure::Unfit(format!("{said}\n{remove}")),
            Ok(Err(failure)) => failure,
            // The question was not answered, for the command ends.
            Err(_) => pending().await,
        }
    }

    /// What seems to be wrong with the odometry up to a frame, in a sentence.
    async fn finding(&self, sequence: u64) -> Option<String> {
        self.found(sequence).await?.finding
    }

    /// What is known of the odometry up to a frame. None where a server does not tell: it is no reason to fail.
    pub(super) async fn found(&self, sequence: u64) -> Option<Found> {
        let map = self.client.map(self.map, v1::MapView::Basic).await.ok()?;
        if map.frames > MOST_FRAMES {
            return None;
        }
        let frame = format!("{}/frames/{sequence}", self.session);
        let explained = self.client.explain_frame(&frame, None, Some(0)).await.ok()?;
        let v1::OdometryAgreement { turns, ways: _, finding } =
            explained.odometry_agreement.unwrap_or_default();
        Some(Found { turned: turns.is_some(), finding: Some(finding).filter(|finding| !finding.is_empty()) })
    }
}

/// What a server knows of how odometry goes with images.
pub(super) struct Found {
    /// Whether the robot turned often enough to tell.
    turned: bool,
    /// What seems to be wrong, if anything does.
    pub(super) finding: Option<String>,
}

impl Found {
    /// That a declared camera was not held against anything.
    pub(super) fn unchecked(&self) -> Option<String> {
        (!self.turned && self.finding.is_none()).then(|| {
            "the camera's field of view was not checked: that takes five turns of 5 degrees or more within 33 frames".to_owned()
        })
    }
}

/// Whether there is odometry that images can be held against.
pub(super) fn has_odometry(replay: &Replay) -> bool {
    match &replay.recording {
        Recording::Folder { images: _, moments } => moments.iter().any(|moment| moment.odometry.is_some()),
        Recording::Bag(_) => true,
        Recording::Database(drive) => drive.has_odometry(),
    }
}

/// If stderr is closed, it is lost.
pub(super) fn tell(finding: &str) {
    let _ = writeln!(std::io::stderr(), "odometry and images do not go together: {finding}");
}
