//! A map held against the truth of the drive that made it.

use posegraph::{PlanarPose, Pose};
use serde::Serialize;
use topomap::ids::FrameId;
use topomap::log::{FrameEvent, LinkKind, Reason};
use topomap::metric::PlaceSpacing;

use super::alignment::{Alignment, rmse_m};
use super::drive::DrivenFrame;
use super::mapping::Mapped;
use crate::timing::{median, quantile, root_mean_square};

/// What was true of one drive, what was found, and what it took.
#[derive(Clone, Serialize)]
pub(crate) struct Figures {
    /// Frames.
    pub images: f64,
    /// Places of the map.
    pub places: f64,
    /// Frames whose true pose lies within 0.5 m and 15 degrees of that of a frame that made a place, 20 frames before or
    /// earlier.
    pub closures_true: f64,
    /// Those of them that were taken for a place made 20 frames before or earlier, and rightly so: by a closure or by staying
    /// where one had led.
    pub closures_found: f64,
    /// The share of them that was not.
    pub missed_fraction: f64,
    /// Loop closures that were accepted, at whatever frame.
    pub closures_accepted: f64,
    /// Those of them whose true pose lies farther than 1.5 m or 40 degrees from that of the frame they name.
    pub closures_false: f64,
    /// The share of them that is.
    pub false_fraction: f64,
    /// The wheels' error at the frames that made places, laid over the truth at the first pose.
    pub odometry_rmse_m: f64,
    /// The same, after the best rigid alignment.
    pub odometry_rmse_rigid_m: f64,
    /// The error of the places' poses at the end, against the truth of the frames that made them, laid over it at the
    /// first pose.
    pub map_rmse_m: f64,
    /// The same, after the best rigid alignment.
    pub map_rmse_rigid_m: f64,
    /// The same, after the best alignment that may also scale: without what no loop can show of the wheels' scale.
    pub map_rmse_scaled_m: f64,
    /// Median error of where the map put the robot while it drove, laid over the truth at the first pose.
    pub robot_error_m_median: f64,
    /// The same, of frames from the first accepted closure on.
    pub robot_error_closed_m_median: f64,
    /// Places that nothing measured joins to the first.
    pub places_apart: f64,
    /// Links that measured a closure, and are in the pose graph.
    pub map_closure_links: f64,
    /// Those of them that relaxation left out.
    pub map_contradicted_links: f64,
    /// Root of the mean squared distance between place and robot as closures measured it and as it was, in metres.
    pub closure_position_error_m: f64,
    /// The same of the heading, in degrees.
    pub closure_heading_error_deg: f64,
}

/// Turn within which a frame shows a place again: between the angle from place to place, and twice that.
pub(crate) const REVISIT_RAD: f64 = 15.0 / 180.0 * std::f64::consts::PI;

/// Beyond these a closure is false.
pub(crate) const FALSE_M: f64 = 1.5;
pub(crate) const FALSE_RAD: f64 = 40.0 / 180.0 * std::f64::consts::PI;

/// A drive and the map that was made of it.
struct Judge<'a> {
    frames: &'a [DrivenFrame],
    mapped: &'a Mapped,
    guard_frames: usize,
}

/// Holds a map against the drive that made it.
pub(crate) fn judge(frames: &[DrivenFrame], mapped: &Mapped) -> Figures {
    let guard_frames = usize::try_from(mapped.mapper.settings().guard_frames).unwrap_or(usize::MAX);
    Judge { frames, mapped, guard_frames }.figures()
}

impl Judge<'_> {
    fn figures(&self) -> Figures {
        let Mapped { mapper, log, .. } = self.mapped;
        let revisits: Vec<(usize, &FrameEvent)> =
            log.frames().enumerate().filter(|&(index, _)| self.is_revisit(index)).collect();
        let found = revisits.iter().filter(|&&(index, event)| self.is_found(index, event)).count();
        let accepted: Vec<(usize, FrameId)> = log.frames().enumerate().filter_map(accepted_closure).collect();
        let wrong = accepted.iter().filter(|&&(index, matched)| self.is_false(index, matched)).count();
        let share = |part: usize, whole: usize| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };

        let first_closure = accepted.first().map_or(self.frames.len(), |&(index, _)| index);

        let (places, made) = self.places();
        let truth: Vec<PlanarPose> = made.iter().map(|&index| self.frames[index].truth).collect();
        let wheels: Vec<PlanarPose> =
            made.iter().map(|&index| super::drive::planar(&self.frames[index].odometry.pose)).collect();
        let (position_errors, heading_errors) = self.measured_errors();
        Figures {
            images: self.frames.len() as f64,
            places: mapper.map().places().len() as f64,
            closures_true: revisits.len() as f64,
            closures_found: found as f64,
            missed_fraction: share(revisits.len() - found, revisits.len()),
            closures_accepted: accepted.len() as f64,
            closures_false: wrong as f64,
            false_fraction: share(wrong, accepted.len()),
            odometry_rmse_m: rmse_m(&wheels, &truth, Alignment::FirstPose),
            odometry_rmse_rigid_m: rmse_m(&wheels, &truth, Alignment::Rigid),
            map_rmse_m: rmse_m(&places, &truth, Alignment::FirstPose),
            map_rmse_rigid_m: rmse_m(&places, &truth, Alignment::Rigid),
            map_rmse_scaled_m: rmse_m(&places, &truth, Alignment::Similarity),
            robot_error_m_median: median(self.robot_errors_m(0)).unwrap_or(0.0),
            robot_error_closed_m_median: median(self.robot_errors_m(first_closure)).unwrap_or(0.0),
            places_apart: (mapper.map().places().len() - places.len()) as f64,
            map_closure_links: mapper
                .map()
                .links()
                .iter()
                .filter(|link| matches!(link.kind, LinkKind::Closed(_)))
                .count() as f64,
            map_contradicted_links: mapper.poses().contradicted().count() as f64,
            closure_position_error_m: root_mean_square(&position_errors),
            closure_heading_error_deg: root_mean_square(&heading_errors).to_degrees(),
        }
    }

    /// Poses of the places that are joined to the first, and the frames that made them.
    fn places(&self) -> (Vec<PlanarPose>, Vec<usize>) {
        let poses = self.mapped.mapper.poses();
        let made = (0..).zip(self.mapped.mapper.map().places()).filter_map(|(place, of_place)| {
            let made = self.index_of(of_place.frames.first()?.frame)?;
            (poses.part(place) == Some(0)).then_some((*poses.pose(place)?, made))
        });
        made.unzip()
    }

    /// The index in the drive of a frame of the log.
    fn index_of(&self, frame: FrameId) -> Option<usize> {
        self.mapped.log.index(frame)
    }

    fn between(&self, index: usize, earlier: usize) -> PlanarPose {
        self.frames[earlier].truth.inverse().compose(&self.frames[index].truth)
    }

    /// Frames that made a place, outside of the guard of a later frame.
    fn makers(&self, index: usize) -> impl Iterator<Item = usize> {
        let places = self.mapped.mapper.map().places().iter();
        let makers = places.filter_map(|place| self.index_of(place.frames.first()?.frame));
        makers.filter(move |&maker| maker + self.guard_frames <= index)
    }

    fn is_revisit(&self, index: usize) -> bool {
        let again = PlaceSpacing { angle_rad: REVISIT_RAD, ..self.mapped.mapper.settings().place_spacing };
        self.makers(index).any(|maker| again.holds(&self.between(index, maker)))
    }

    fn is_found(&self, index: usize, event: &FrameEvent) -> bool {
        let Some(place) = event.decision.place else { return false };
        let of_place = self.mapped.mapper.map().places().get(place as usize);
        let maker = of_place.and_then(|place| self.index_of(place.frames.first()?.frame));
        maker.is_some_and(|maker| maker + self.guard_frames <= index && !is_far(&self.between(index, maker)))
    }

    fn is_false(&self, index: usize, matched: FrameId) -> bool {
        self.index_of(matched).is_none_or(|earlier| is_far(&self.between(index, earlier)))
    }

    /// Where the map put the robot, against where it was, from one frame on.
    fn robot_errors_m(&self, from: usize) -> Vec<f64> {
        let Some(first) = self.frames.first() else { return Vec::new() };
        let poses = self.mapped.robot.iter().zip(self.frames);
        let error_m = |(robot, frame): (&Option<PlanarPose>, &DrivenFrame)| {
            let robot = first.truth.compose(robot.as_ref()?);
            Some(distance_m(&robot, &frame.truth))
        };
        poses.skip(from).filter_map(error_m).collect()
    }

    /// Of closures that are true: how wrong the measured pose in the place's frame is, in metres and radians.
    fn measured_errors(&self) -> (Vec<f64>, Vec<f64>) {
        let errors = self.mapped.log.frames().enumerate().filter_map(|(index, event)| {
            accepted_closure((index, event)).filter(|&(_, matched)| !self.is_false(index, matched))?;
            let measured = event.at?;
            let place = self.mapped.mapper.map().places().get(event.decision.place? as usize)?;
            let maker = self.index_of(place.frames.first()?.frame)?;
            let error = measured.pose().inverse().compose(&self.between(index, maker));
            Some((error.x_m().hypot(error.y_m()), error.heading_rad()))
        });
        errors.unzip()
    }
}

/// The frame that an accepted closure names, with the index of the frame that it was accepted at.
fn accepted_closure((index, event): (usize, &FrameEvent)) -> Option<(usize, FrameId)> {
    let closure = event.decision.closure.filter(|_| event.decision.reason == Reason::LoopClosure)?;
    Some((index, closure.frame))
}

pub(crate) fn is_far(apart: &PlanarPose) -> bool {
    apart.x_m().hypot(apart.y_m()) > FALSE_M || apart.heading_rad().abs() > FALSE_RAD
}

fn distance_m(a: &PlanarPose, b: &PlanarPose) -> f64 {
    (a.x_m() - b.x_m()).hypot(a.y_m() - b.y_m())
}

impl Figures {
    /// Every figure by itself, taken together by `of`.
    pub(crate) fn combined(runs: &[Figures], of: impl Fn(Vec<f64>) -> Option<f64>) -> Self {
        let each = |figure: fn(&Figures) -> f64| of(runs.iter().map(figure).collect()).unwrap_or(0.0);
        Self {
            images: each(|f| f.images),
            places: each(|f| f.places),
            closures_true: each(|f| f.closures_true),
            closures_found: each(|f| f.closures_found),
            missed_fraction: each(|f| f.missed_fraction),
            closures_accepted: each(|f| f.closures_accepted),
            closures_false: each(|f| f.closures_false),
            false_fraction: each(|f| f.false_fraction),
            odometry_rmse_m: each(|f| f.odometry_rmse_m),
            odometry_rmse_rigid_m: each(|f| f.odometry_rmse_rigid_m),
            map_rmse_m: each(|f| f.map_rmse_m),
            map_rmse_rigid_m: each(|f| f.map_rmse_rigid_m),
            map_rmse_scaled_m: each(|f| f.map_rmse_scaled_m),
            robot_error_m_median: each(|f| f.robot_error_m_median),
            robot_error_closed_m_median: each(|f| f.robot_error_closed_m_median),
            places_apart: each(|f| f.places_apart),
            map_closure_links: each(|f| f.map_closure_links),
            map_contradicted_links: each(|f| f.map_contradicted_links),
            closure_position_error_m: each(|f| f.closure_position_error_m),
            closure_heading_error_deg: each(|f| f.closure_heading_error_deg),
        }
    }
}

/// What frames took, in milliseconds.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct MapTimes {
    /// Median over frames, from pixels to the map that has the frame: all on one thread.
    pub ms_per_image_p50: f64,
    /// What one frame of twenty takes longer than.
    pub ms_per_image_p95: f64,
    /// Median over frames that close a loop, of the relaxation alone.
    pub relax_ms_p50: f64,
    /// What one such frame of twenty takes longer than.
    pub relax_ms_p95: f64,
    /// The longest.
    pub relax_ms_max: f64,
}

impl MapTimes {
    /// Over all frames of these maps.
    pub(crate) fn of<'a>(maps: impl Iterator<Item = &'a Mapped> + Clone) -> Self {
        let frames: Vec<f64> =
            maps.clone().flat_map(|mapped| &mapped.times).filter_map(|times| times.total).collect();
        let relax: Vec<f64> = maps.flat_map(|mapped| mapped.relax_ms.iter().copied()).collect();
        let at = |values: &[f64], share| quantile(values.to_vec(), share).unwrap_or(0.0);
        Self {
            ms_per_image_p50: at(&frames, 0.5),
            ms_per_image_p95: at(&frames, 0.95),
            relax_ms_p50: at(&relax, 0.5),
            relax_ms_p95: at(&relax, 0.95),
            relax_ms_max: at(&relax, 1.0),
        }
    }
}
