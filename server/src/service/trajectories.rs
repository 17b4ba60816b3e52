//! Where robots were, as text that other tools read.

use std::collections::HashMap;

use fabmap::PlaceId;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use posegraph::Pose;
use posegraph::g2o::{G2o, NamedGraph};
use posegraph::trajectory::{StampedPose, to_kitti, to_tum};
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, MeasuredEvent};
use topomap::map::PlacePoses;

use super::corrections::Corrections;
use super::frames::{Frames, no_such_session};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::names::{map_in, session_in};
use crate::storage::FrameRow;

/// Frames read at a time.
const PAGE: u32 = 1000;

/// How a trajectory is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TrajectoryFormat {
    Tum,
    Kitti,
}

/// In whose coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum TrajectoryFrame {
    /// The map's.
    #[default]
    Map,
    /// The session's odometry.
    Odom,
}

/// Of what.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum TrajectoryBody {
    #[default]
    Base,
    Camera,
}

/// What of a session is written, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TrajectoryWanted {
    pub(crate) format: TrajectoryFormat,
    pub(crate) frame: TrajectoryFrame,
    pub(crate) body: TrajectoryBody,
    /// Of so many frames of the session only the first; 0 is as 1.
    pub(crate) every: u32,
}

/// Where robots were, written out. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Trajectories {
    pub(super) frames: Frames,
}

impl Trajectories {
    /// Where a session's robot was at each of its frames.
    pub(crate) async fn session(
        &self,
        name: &str,
        TrajectoryWanted { format, frame, body, every }: TrajectoryWanted,
    ) -> Result<Vec<u8>, ServiceError> {
        let (map, session) = session_in(name)?;
        let every = every.max(1);
        let row = self.frames.open_maps.row(map).await?;
        let summary = self.frames.storage.session_summary(row.id, session).await?;
        let summary = summary.ok_or_else(|| no_such_session(map, session))?;
        let mount = match body {
            TrajectoryBody::Base => Isometry3::identity(),
            TrajectoryBody::Camera => mount(summary.camera.as_ref(), name)?,
        };
        let poses = self.frames.open_maps.open(map).await?.poses().await?;
        let words = self.frames.vocabulary_len(&row).await?;
        let measured = self.frames.storage.measured_of_session(row.id, summary.number, words).await?;
        let measured: HashMap<FrameId, MeasuredEvent> =
            measured.into_iter().map(|event| (event.frame, event)).collect();
        // Of frames that are at no place only the odometry is known.
        let corrections = Corrections::read(&self.frames.storage, row.id).await?;
        let is_known = |row: &&FrameRow| match frame {
            TrajectoryFrame::Odom => true,
            TrajectoryFrame::Map => !corrections.is_withdrawn(row.event.frame),
        };
        let mut stamped: Vec<Located> = Vec::new();
        let (mut after, mut read) = (None, 0);
        loop {
            let frames =
                self.frames.storage.frames_of_session(row.id, summary.number, after, "", PAGE, words).await?;
            after = frames.last().map(|frame| frame.event.sequence);
            let located = |row: &FrameRow| located(&row.event, measured.get(&row.event.frame), frame, &poses);
            let first = (every as usize - read % every as usize) % every as usize;
            let thinned = frames.iter().skip(first).step_by(every as usize);
            stamped.extend(thinned.filter(is_known).filter_map(located));
            read += frames.len();
            if frames.len() < PAGE as usize {
                break;
            }
        }
        // A session that is not joined with the map's first part yet is in a frame of its own.
        let Some(part) = stamped.last().map(|last| last.part) else { return Err(nothing(name, frame)) };
        stamped.retain(|located| located.part == part);
        let stamped: Vec<StampedPose> = stamped
            .into_iter()
            .map(|Located { stamp_ns, pose, part: _ }| StampedPose { stamp_ns, pose: pose * mount })
            .collect();
        Ok(match format {
            TrajectoryFormat::Tum => to_tum(&stamped),
            TrajectoryFormat::Kitti => to_kitti(&stamped),
        })
    }

    /// A map's pose graph as g2o: the ways between its places that were measured, and the places at their ends.
    /// Comments before them say what people corrected.
    pub(crate) async fn pose_graph(&self, name: &str) -> Result<Vec<u8>, ServiceError> {
        let map = map_in(name)?;
        let row = self.frames.open_maps.row(map).await?;
        let poses = self.frames.open_maps.open(map).await?.poses().await?;
        if poses.graph().edges().is_empty() {
            return Err(ServiceError::precondition(format_args!(
                "no way between places of {name} was measured; it takes frames with odometry"
            )));
        }
        // Places of sessions without odometry are nowhere; a reader would take them for the origin.
        let (places, graph) = poses.graph().known_part();
        let at = places.iter().map(|&place| poses.poses()[place]).collect();
        let graph = NamedGraph::new(places.iter().map(|&place| place as u64).collect(), graph, Some(at));
        let storage = &self.frames.storage;
        let mut text = Corrections::read(storage, row.id).await?.told(storage, &row).await?.into_bytes();
        text.extend(G2o::Planar(graph.map_err(ServiceError::internal)?).write());
        Ok(text)
    }
}

/// A pose, and the part of the map whose coordinates it is in.
struct Located {
    stamp_ns: i64,
    pose: Isometry3<f64>,
    part: Option<PlaceId>,
}

fn located(
    event: &FrameEvent,
    measured: Option<&MeasuredEvent>,
    frame: TrajectoryFrame,
    poses: &PlacePoses,
) -> Option<Located> {
    let (pose, part) = match frame {
        TrajectoryFrame::Odom => (*event.odometry.as_ref()?.pose(), None),
        TrajectoryFrame::Map => {
            let (place, at) = match measured {
                Some(measured) => (measured.place, measured.at),
                None => (event.decision.place?, event.at?),
            };
            let pose = poses.pose(place)?.compose(at.pose());
            (pose.on_the_ground(), Some(poses.part(place)?))
        }
    };
    Some(Located { stamp_ns: event.stamp_ns, pose, part })
}

fn mount(camera: Option<&Camera>, name: &str) -> Result<Isometry3<f64>, ServiceError> {
    let declared = camera.and_then(|camera| camera.base_to_camera);
    let ([x, y, z], [i, j, k, w]) = declared.ok_or_else(|| {
        ServiceError::precondition(format_args!(
            "{name} did not declare how its camera is mounted (base_to_camera); ask for the poses of base_link"
        ))
    })?;
    // It was checked when the session was opened.
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

fn nothing(name: &str, frame: TrajectoryFrame) -> ServiceError {
    match frame {
        TrajectoryFrame::Odom => ServiceError::precondition(format_args!(
            "no frame of {name} carries odometry; send it with the frames"
        )),
        TrajectoryFrame::Map => ServiceError::precondition(format_args!(
            "the map does not know where {name} was; it takes frames with odometry"
        )),
    }
}
