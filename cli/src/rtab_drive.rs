//! A session of RTAB-Map's database as what is streamed.

use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use tokio::sync::mpsc::{Receiver, channel};
use tokio::task::JoinHandle;
use waypost_bags::rtabmap::{RtabError, RtabMap, RtabNode, RtabSession};
use waypost_client::v1;

use crate::drive::Shot;
use crate::failure::Failure;
use crate::odometry::message;
use crate::output::Output;
use crate::progress;

/// Images that are read ahead.
const MOST_AHEAD: usize = 4;

/// Checks and lists a database, away from the asynchronous threads.
pub(crate) async fn open_database(path: &Path, output: Output) -> Result<RtabMap, Failure> {
    let bar = progress::spinner(output, "checking the database");
    let path = path.to_owned();
    let reading = tokio::task::spawn_blocking(move || RtabMap::open(&path));
    let opened = reading.await.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()));
    bar.finish_and_clear();
    Ok(opened?)
}

/// What a frame is called: a number alone would be that of a frame.
pub(crate) fn node_name(node: i64) -> String {
    format!("node {node}")
}

/// One session of a database. Frame numbers are positions among its nodes, from 1.
pub(crate) struct RtabDrive {
    pub(crate) map: Arc<RtabMap>,
    /// Which of the map's sessions.
    pub(crate) index: usize,
    /// As it is declared.
    pub(crate) camera: Option<v1::Camera>,
}

impl RtabDrive {
    pub(crate) fn session(&self) -> &RtabSession {
        &self.map.sessions()[self.index]
    }

    /// Number of the last frame.
    pub(crate) fn last_sequence(&self) -> u64 {
        let last = self.session().nodes.iter().rposition(|node| node.image.is_ok());
        last.map_or(0, |index| index as u64 + 1)
    }

    pub(crate) fn count_after(&self, after_sequence: u64) -> usize {
        let after = usize::try_from(after_sequence).unwrap_or(usize::MAX);
        self.session().nodes.iter().skip(after).filter(|node| node.image.is_ok()).count()
    }

    /// The node of a number, if it is a frame.
    pub(crate) fn node(&self, sequence: u64) -> Option<&RtabNode> {
        let index = usize::try_from(sequence.checked_sub(1)?).ok()?;
        self.session().nodes.get(index).filter(|node| node.image.is_ok())
    }

    pub(crate) fn size_px(&self) -> Option<(u32, u32)> {
        self.session().frames().find_map(|node| node.image.ok())
    }

    pub(crate) fn has_odometry(&self) -> bool {
        self.session().frames().any(|node| node.pose.is_some())
    }

    /// Begins to read the frames above a number.
    pub(crate) fn read(self: Arc<Self>, after_sequence: u64) -> RtabReading {
        let (sender, shots) = channel(MOST_AHEAD);
        let thread = tokio::task::spawn_blocking(move || {
            self.map.read_images(self.session(), after_sequence, &mut |sequence, node, image| {
                let &RtabNode { id, stamp_ns, pose, image: _ } = node;
                let odometry = pose.as_ref().map(message);
                // The sender may have given up.
                match sender.blocking_send(Shot { sequence, stamp_ns, image, odometry, note: node_name(id) })
                {
                    Ok(()) => ControlFlow::Continue(()),
                    Err(_) => ControlFlow::Break(()),
                }
            })
        });
        RtabReading { shots, thread }
    }
}

/// A session that is being read.
pub(crate) struct RtabReading {
    shots: Receiver<Shot>,
    thread: JoinHandle<Result<(), RtabError>>,
}

impl RtabReading {
    pub(crate) async fn next(&mut self) -> Option<Shot> {
        self.shots.recv().await
    }

    /// Says why reading ended early, if it did.
    pub(crate) async fn end(self) -> Result<(), Failure> {
        Ok(self.thread.await.unwrap_or_else(|panic| std::panic::resume_unwind(panic.into_panic()))?)
    }
}

/// What of a database is not as it should be, or of no use here, a line each.
pub(crate) fn remarks(map: &RtabMap) -> Vec<String> {
    let contents = map.contents();
    let mut lines: Vec<String> = contents
        .omitted
        .iter()
        .map(|(reason, count)| format!("{count} of {} nodes are left out: {reason}", contents.nodes))
        .collect();
    if contents.without_pose > 0 {
        lines.push(format!(
            "{} of {} frames are without odometry: RTAB-Map had lost it there; the map may be in parts until a loop closes",
            contents.without_pose, contents.frames
        ));
    }
    for session in map.sessions() {
        if session.other_calibrations > 0 {
            lines.push(format!(
                "map_id {}: the calibration of {} frames is not that of the first, which is declared for all",
                session.map_id, session.other_calibrations
            ));
        }
    }
    let unused: Vec<String> = contents.unused.iter().map(|(what, count)| format!("{count} {what}")).collect();
    if !unused.is_empty() {
        lines.push(format!("not taken over: {}", unused.join(", ")));
    }
    let links = map.link_counts();
    let unused = [(links.landmarks, "sightings of landmarks"), (links.other, "other links, as of gravity")];
    for (count, what) in unused.into_iter().filter(|(count, _)| *count > 0) {
        lines.push(format!("not taken over: {count} {what}"));
    }
    lines
}

/// Says lines about a file on stderr.
pub(crate) fn tell(path: &Path, lines: &[String]) {
    for line in lines {
        // If stderr is closed, the message is lost.
        let _ = writeln!(std::io::stderr(), "{}: {line}", path.display());
    }
}
