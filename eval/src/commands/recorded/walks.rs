//! Walks of one robot in one odometry frame, each a session of one map: odometry says how far apart the frames of a
//! closure were taken, as well as it knows.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use posegraph::trajectory::StampedPose;
use posegraph::{PlanarPose, Pose};
use serde::Serialize;
use topomap::log::{FrameEvent, Reason};
use topomap::mapper::FrameError;
use topomap::metric::Odometry;
use topomap::settings::MapperSettings;
use waypost_vision::image;

use super::heard::HeardWheels;
use super::recording::Recording;
use crate::commands::map::judgement::FALSE_M;
use crate::commands::map::mapping::{Mapped, Mapping, SeenFrame};
use crate::{files, progress};

/// What came out.
#[derive(Serialize)]
pub(crate) struct WalksReport {
    /// Walks.
    pub walks: usize,
    /// Their frames that were mapped.
    pub frames: usize,
    /// Those that were refused.
    pub refused: usize,
    /// Places of the map.
    pub places: usize,
    /// Walks that hang together with the first by closures, itself among them.
    pub joined_walks: usize,
    /// Closures that were accepted.
    pub closures: usize,
    /// Those between different walks.
    pub closures_between_walks: usize,
    /// Those whose frames odometry puts more than 1.5 m apart.
    pub closures_far_apart: usize,
    /// Metres between the frames of a closure by odometry, median and largest.
    pub apart_m: [f64; 2],
    /// Every closure.
    pub closures_listed: Vec<WalkClosure>,
}

/// An accepted closure.
#[derive(Clone, Serialize)]
pub(crate) struct WalkClosure {
    /// The walk and the frame in it.
    pub frame: (String, usize),
    /// The same of the earlier frame.
    pub earlier: (String, usize),
    /// By odometry.
    pub apart_m: f64,
}

pub(super) fn run(folders: &[PathBuf], model: &Path, heard: HeardWheels) -> Result<WalksReport> {
    let (model, extractor) = files::read_model(model)?;
    let walks: Vec<Recording> =
        folders.iter().map(|folder| Recording::of_robot(folder)).collect::<Result<_>>()?;
    let frames: usize = walks.iter().map(|walk| walk.images.len()).sum();
    let bar = progress::bar("frames", frames);
    let mut mapping = Mapping::new(&model, extractor, MapperSettings::default())?;
    let mut taken = Vec::new();
    for (walk, recording) in walks.iter().enumerate() {
        mapping.open_session()?;
        let odometry: Vec<Odometry> = recording.poses.iter().map(odometry_of).collect::<Result<_>>()?;
        for (index, (path, stamped)) in recording.images.iter().zip(&recording.poses).enumerate() {
            let image = image::decode(&files::read(path)?).with_context(|| path.display().to_string())?;
            let odometry = heard.of_frame(index, &odometry);
            let frame = SeenFrame { stamp_ns: stamped.stamp_ns, odometry, image: &image, camera: None };
            match mapping.add(&frame) {
                Ok(()) => taken.push(Taken::new(walk, index, stamped)),
                Err(error) if error.is::<FrameError>() => {}
                Err(error) => return Err(error),
            }
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok(WalksReport::of(&walks, &taken, frames, &mapping.mapped))
}

fn odometry_of(stamped: &StampedPose) -> Result<Odometry> {
    let [i, j, k, w] = stamped.pose.rotation.coords.into();
    Ok(Odometry::new(stamped.pose.translation.vector.into(), [i, j, k, w], None)?)
}

/// A frame among all walks.
#[derive(Clone, Copy)]
struct Taken {
    walk: usize,
    index: usize,
    at: PlanarPose,
}

impl Taken {
    fn new(walk: usize, index: usize, stamped: &StampedPose) -> Self {
        let position = stamped.pose.translation.vector;
        let heading_rad = stamped.pose.rotation.euler_angles().2;
        Self { walk, index, at: PlanarPose::new(position.x, position.y, heading_rad) }
    }
}

impl WalksReport {
    fn of(walks: &[Recording], taken: &[Taken], sent: usize, mapped: &Mapped) -> Self {
        let pairs: Vec<(Taken, Taken)> =
            mapped.log.frames().filter_map(|event| closed(event, mapped, taken)).collect();
        let apart_m = |(later, earlier): &(Taken, Taken)| {
            let apart = earlier.at.inverse().compose(&later.at);
            apart.x_m().hypot(apart.y_m())
        };
        let mut distances: Vec<f64> = pairs.iter().map(apart_m).collect();
        distances.sort_by(f64::total_cmp);
        let named = |taken: &Taken| (walks[taken.walk].name.clone(), taken.index);
        Self {
            walks: walks.len(),
            frames: taken.len(),
            refused: sent - taken.len(),
            places: mapped.mapper.map().places().len(),
            joined_walks: joined(walks.len(), &pairs),
            closures: pairs.len(),
            closures_between_walks: pairs
                .iter()
                .filter(|(later, earlier)| later.walk != earlier.walk)
                .count(),
            closures_far_apart: distances.iter().filter(|metres| **metres > FALSE_M).count(),
            apart_m: [
                distances.get(distances.len() / 2).copied().unwrap_or(0.0),
                distances.last().copied().unwrap_or(0.0),
            ],
            closures_listed: pairs
                .iter()
                .map(|pair| WalkClosure {
                    frame: named(&pair.0),
                    earlier: named(&pair.1),
                    apart_m: apart_m(pair),
                })
                .collect(),
        }
    }
}

/// The two frames of an accepted closure.
fn closed(event: &FrameEvent, mapped: &Mapped, taken: &[Taken]) -> Option<(Taken, Taken)> {
    let closure = event.decision.closure.filter(|_| event.decision.reason == Reason::LoopClosure)?;
    let later = taken.get(usize::try_from(event.sequence).ok()?)?;
    let earlier = taken.get(mapped.log.index(closure.frame)?)?;
    Some((*later, *earlier))
}

/// Walks that hang together with the first.
fn joined(walks: usize, pairs: &[(Taken, Taken)]) -> usize {
    let mut with_first = vec![false; walks];
    with_first.iter_mut().take(1).for_each(|first| *first = true);
    loop {
        let reached = pairs.iter().find_map(|(later, earlier)| {
            match (with_first[later.walk], with_first[earlier.walk]) {
                (true, false) => Some(earlier.walk),
                (false, true) => Some(later.walk),
                (true, true) | (false, false) => None,
            }
        });
        match reached {
            Some(walk) => with_first[walk] = true,
            None => return with_first.into_iter().filter(|joined| *joined).count(),
        }
    }
}
