//! Accepted closures one by one: what each measured, and what was true.

use nalgebra::Vector3;
use posegraph::{PlanarPose, Pose};
use serde::Serialize;
use topomap::evidence::{Candidate, Placement};
use topomap::log::{FrameEvent, Reason};

use super::drive::DrivenFrame;
use super::judgement::is_far;
use super::mapping::Mapped;
use crate::timing::quantile;

/// One accepted closure.
#[derive(Clone, Serialize)]
pub(crate) struct ClosureCheck {
    /// Index of the frame.
    pub frame: usize,
    /// Index of the frame that it names.
    pub earlier: usize,
    /// Whether it names a frame that was taken elsewhere.
    #[serde(rename = "false")]
    pub is_false: bool,
    /// Where the robot was, seen from the earlier frame: x, y in metres, heading in degrees.
    pub truth: [f64; 3],
    /// The same as structure measured it, if it did.
    pub measured: Option<[f64; 3]>,
    /// Features of known depth that agree with it.
    pub placed_inliers: u32,
    /// Inliers of the two views.
    pub inliers: u32,
    /// Evidence of the two views and the frames before.
    pub evidence: f64,
    /// Posterior of the place.
    pub posterior: f64,
    /// Metres between what was measured and the truth.
    pub position_error_m: Option<f64>,
    /// The same in degrees.
    pub heading_error_deg: Option<f64>,
    /// Squared standard deviations between what was measured and the truth, of three degrees of freedom.
    pub chi_squared: Option<f64>,
}

/// How well the closures of some drives measured.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct MeasuredFigures {
    /// Closures that were accepted.
    pub accepted: usize,
    /// Those of them that structure measured.
    pub measured: usize,
    /// Median and 95 % of the error, in metres.
    pub position_error_m: [f64; 2],
    /// The same of the heading, in degrees.
    pub heading_error_deg: [f64; 2],
    /// Share of those whose truth lies within what they call 95 % likely.
    pub within_own_95: f64,
}

/// 95 % of what has three degrees of freedom lie below.
pub(crate) const CHI_SQUARED_95: f64 = 7.815;

/// All accepted closures of a drive.
pub(crate) fn closures(frames: &[DrivenFrame], mapped: &Mapped) -> Vec<ClosureCheck> {
    let events = mapped.log.frames().enumerate();
    events.filter_map(|(index, event)| check(frames, mapped, index, event)).collect()
}

fn check(frames: &[DrivenFrame], mapped: &Mapped, index: usize, event: &FrameEvent) -> Option<ClosureCheck> {
    let closure = event.decision.closure.filter(|_| event.decision.reason == Reason::LoopClosure)?;
    let earlier = mapped.log.index(closure.frame)?;
    let truth = frames[earlier].truth.inverse().compose(&frames[index].truth);
    let numbers = |pose: &PlanarPose| [pose.x_m(), pose.y_m(), pose.heading_rad().to_degrees()];
    let view = event.verified_by().and_then(|candidate| candidate.view);
    let placed = view.and_then(|view| match view.placement {
        Placement::At { pose, inliers } => Some((pose, inliers)),
        Placement::Unknown | Placement::Nowhere => None,
    });
    let off = placed.map(|(pose, _)| {
        let off: Vector3<f64> = PlanarPose::error(pose.pose(), &PlanarPose::identity(), &truth);
        (off, off.dot(&(pose.information() * off)))
    });
    Some(ClosureCheck {
        frame: index,
        earlier,
        is_false: is_far(&truth),
        truth: numbers(&truth),
        measured: placed.map(|(pose, _)| numbers(pose.pose())),
        placed_inliers: placed.map_or(0, |(_, inliers)| inliers),
        inliers: view.map_or(0, |view| view.inliers),
        evidence: event.verified_by().map_or(0.0, Candidate::evidence),
        posterior: closure.posterior,
        position_error_m: off.map(|(off, _)| off.x.hypot(off.y)),
        heading_error_deg: off.map(|(off, _)| off.z.abs().to_degrees()),
        chi_squared: off.map(|(_, squared)| squared),
    })
}

impl MeasuredFigures {
    pub(crate) fn of(closures: &[ClosureCheck]) -> Self {
        let spread = |error: fn(&ClosureCheck) -> Option<f64>| {
            let errors: Vec<f64> = closures.iter().filter_map(error).collect();
            [0.5, 0.95].map(|share| quantile(errors.clone(), share).unwrap_or(0.0))
        };
        let squares: Vec<f64> = closures.iter().filter_map(|closure| closure.chi_squared).collect();
        let within = squares.iter().filter(|&&squared| squared <= CHI_SQUARED_95).count();
        Self {
            accepted: closures.len(),
            measured: squares.len(),
            position_error_m: spread(|closure| closure.position_error_m),
            heading_error_deg: spread(|closure| closure.heading_error_deg),
            within_own_95: within as f64 / squares.len().max(1) as f64,
        }
    }
}
