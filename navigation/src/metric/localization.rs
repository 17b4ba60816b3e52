//! What a frame shows of the map, and where that puts the robot.

use fabmap::appearance::PlaceId;
use fabmap::recognizer::StageObserver;
use nalgebra::{Matrix3, Vector3};

use super::planning::MapPosition;
use super::settings::LocalizationSettings;
use posegraph::{PlanarPose, Pose};
use topomap::evidence::{Candidate, ClosureNoise, Placement, TwoView, VerificationSettings, ViewMotion};
use topomap::ids::FrameId;
use topomap::log::Reason;
use topomap::mapper::{Decided, FrameError, FrameInput, Localizer, Mapper, Recognized};
use topomap::metric::RelativePose;

/// Recognises a map's places for a robot that drives along it, and changes nothing of the map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lookout {
    localizer: Localizer,
    episode: u64,
}

/// What a frame showed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// When the image was taken, by the robot's clock, in nanoseconds.
    pub stamp_ns: i64,
    /// Where the wheels put the robot then; a frame without that tells nothing.
    pub odometry: Option<PlanarPose>,
    /// What it showed.
    pub sight: Sight,
    /// What speaks for the place that most speaks for, recognised or not, in inliers: see
    /// [`Candidate::evidence`].
    pub evidence: f64,
    /// Each view that it was compared with and that something speaks for, recognised or not: that
    /// two views of one scene are alike says where the robot may be.
    pub glimpses: Glimpses,
    /// See [`super::Navigator::episode`].
    pub episode: u64,
}

/// Where a frame may have been taken.
pub type Glimpses = [Option<Closure>; VerificationSettings::MAX_CANDIDATES];

/// What a frame shows of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sight {
    /// A place.
    Closure(Closure),
    /// Something, but no place that would be recognised.
    Unknown,
    /// Too little to say anything: it is dark, or blurred, or something is close before the camera.
    TooLittle,
}

/// A recognised view: the robot is where it was taken, turned by what has moved the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closure {
    /// The place.
    pub place: PlaceId,
    /// The frame of it that was recognised.
    pub frame: FrameId,
    /// Where that puts the robot.
    pub at: MapPosition,
    /// The same in the frame of the view.
    pub from_view: PlanarPose,
    /// Covariance of that along its own axes, in m² and rad².
    pub covariance: Matrix3<f64>,
    /// That both frames show the same place, in [0, 1].
    pub probability: f64,
    /// What these two views alone say for that, in inliers: see [`Candidate::own_evidence`]; `None`
    /// without keypoints.
    pub evidence: Option<f64>,
}

impl Closure {
    /// Whether it may tell a robot where it is which does not know: from near, by these two views
    /// alone, and looking much the same way. What the frames before say does not count: a robot
    /// that stands and looks says the same again and again.
    pub(super) fn tells_where(&self, settings: &LocalizationSettings) -> bool {
        self.evidence.is_none_or(|evidence| evidence >= settings.found_evidence)
            && self.covariance[(0, 0)].sqrt() <= settings.found_along_m
            && self.from_view.heading_rad().abs() <= settings.found_turn_rad
    }
}

impl Lookout {
    /// A robot that may be anywhere.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Recognises a frame; [`Lookout::look`] takes what is decided of it. `episode` is the
    /// navigator's of when the frame was sent: with a new one everything before is forgotten.
    ///
    /// # Errors
    /// [`FrameError`] if the frame cannot be taken.
    pub fn recognize<'a>(
        &'a self,
        mapper: &'a Mapper,
        episode: u64,
        input: FrameInput,
        observer: &mut dyn StageObserver,
    ) -> Result<Recognized<'a>, FrameError> {
        if episode == self.episode {
            mapper.localize(&self.localizer, input, observer)
        } else {
            mapper.localize_anywhere(input, observer)
        }
    }

    /// What a frame shows, by what was decided of it. `focal_length_widths` is its camera's along
    /// x, in image widths; `None` if its model is not known.
    pub fn look(
        &mut self,
        mapper: &Mapper,
        settings: &LocalizationSettings,
        episode: u64,
        decided: &Decided,
        focal_length_widths: Option<f64>,
    ) -> Look {
        let event = &decided.event;
        let seen = Seeing { mapper, settings, decided, focal_length_widths };
        if episode != self.episode {
            *self = Self { localizer: Localizer::new(), episode };
        }
        self.localizer.follow(event, mapper);
        let odometry = event.odometry.as_ref().map(|odometry| PlanarPose::seen_from_above(odometry.pose()));
        let sight = match (seen.closure(), event.decision.reason) {
            (Some(closure), _) => Sight::Closure(closure),
            (None, Reason::TooFewWords) => Sight::TooLittle,
            (
                None,
                Reason::NewPlace
                | Reason::SamePlace
                | Reason::LoopClosure
                | Reason::BelowThreshold
                | Reason::GeometryRefused,
            ) => Sight::Unknown,
        };
        let evidence = event.candidates.iter().map(Candidate::evidence).fold(0.0, f64::max);
        let glimpses = seen.glimpses();
        Look { stamp_ns: event.stamp_ns, odometry, sight, evidence, glimpses, episode }
    }
}

/// A frame that was decided, beside what says where its views were taken.
struct Seeing<'a> {
    mapper: &'a Mapper,
    settings: &'a LocalizationSettings,
    decided: &'a Decided,
    focal_length_widths: Option<f64>,
}

impl Seeing<'_> {
    /// What the nearest view says: see [`Mapper::nearest_view`].
    fn closure(&self) -> Option<Closure> {
        let candidate = self.mapper.nearest_view(&self.decided.event.candidates)?;
        // Where a robot has just been carried off, the frames before speak for where it was.
        if candidate.view.is_some() && candidate.own_evidence() < self.settings.least_evidence {
            return None;
        }
        self.located(candidate)
    }

    fn glimpses(&self) -> Glimpses {
        let mut glimpses = [None; VerificationSettings::MAX_CANDIDATES];
        for (glimpse, candidate) in glimpses.iter_mut().zip(&self.decided.event.candidates) {
            if candidate.own_evidence() > 0.0 {
                *glimpse = self.located(candidate);
            }
        }
        glimpses
    }

    /// Where the robot is if it is a candidate that it sees.
    fn located(&self, candidate: &Candidate) -> Option<Closure> {
        let matched = candidate.matched;
        let at_frame = candidate.seen_from.unwrap_or_else(RelativePose::none);
        let poses = self.mapper.poses();
        let place = poses.pose(matched.place)?;
        let part = poses.part(matched.place)?;
        let (turn, covariance) = measured(candidate, self.focal_length_widths, self.settings)?;
        Some(Closure {
            place: matched.place,
            frame: matched.frame,
            at: MapPosition { part, pose: place.compose(at_frame.pose()).compose(&turn) },
            from_view: turn,
            covariance,
            probability: candidate.probability(),
            evidence: candidate.view.as_ref().map(TwoView::evidence),
        })
    }
}

/// Where the robot is in the frame of the earlier view, and how well that is known: by structure where that says it, or
/// else by how the image has moved.
fn measured(
    candidate: &Candidate,
    focal_length_widths: Option<f64>,
    settings: &LocalizationSettings,
) -> Option<(PlanarPose, Matrix3<f64>)> {
    match candidate.view.as_ref().map(|view| view.placement) {
        Some(Placement::At { pose, inliers: _ }) => {
            // Places of the map are not known better than that themselves.
            let deviations = [settings.map_m, settings.map_m, settings.map_rad];
            let of_map = Matrix3::from_diagonal(&Vector3::from(deviations.map(|sigma| sigma * sigma)));
            Some((*pose.pose(), pose.covariance() + of_map))
        }
        Some(Placement::Nowhere) => None,
        Some(Placement::Unknown) | None => guessed(candidate, focal_length_widths, settings),
    }
}

/// The same where nothing has a depth.
fn guessed(
    candidate: &Candidate,
    focal_length_widths: Option<f64>,
    settings: &LocalizationSettings,
) -> Option<(PlanarPose, Matrix3<f64>)> {
    let LocalizationSettings { closure_along_m, along_m_per_ln_scale, closure_across_m, depth_m, .. } =
        *settings;
    let noise = ClosureNoise {
        heading_rad: settings.closure_heading_rad,
        max_ln_scale: f64::INFINITY,
        max_image_rotation_rad: f64::INFINITY,
        max_shift_without_camera_widths: f64::INFINITY,
        ..ClosureNoise::of_spacing(2.0 * closure_along_m)
    };
    let Some(view) = &candidate.view else {
        // Words alone: it is there, and no more is known.
        return Some((PlanarPose::identity(), *noise.somewhere().covariance()));
    };
    let turned = noise.measure(view, focal_length_widths)?;
    let ln_scale = match view.motion {
        Some(ViewMotion::Similarity(motion)) => motion.ln_scale,
        Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => 0.0,
    };
    // What is seen larger is nearer: d ln s = d x / depth.
    let ahead = PlanarPose::new(depth_m * ln_scale, 0.0, 0.0);
    let along_m = closure_along_m + along_m_per_ln_scale * ln_scale.abs();
    let variances = [along_m * along_m, closure_across_m * closure_across_m, turned.covariance()[(2, 2)]];
    Some((ahead.compose(turned.pose()), Matrix3::from_diagonal(&Vector3::from(variances))))
}

#[cfg(test)]
mod tests {
    use topomap::evidence::{Match, Placement, Similarity};

    use super::*;

    /// A view that a good deal speaks for, whose image has grown and shifted by so much.
    fn shifted(ln_scale: f64, shift_widths: f64) -> Candidate {
        let motion = Similarity { rotation_rad: 0.0, ln_scale, translation_widths: [shift_widths, 0.0] };
        let motion = Some(ViewMotion::Similarity(motion));
        let placement = Placement::Unknown;
        let view = TwoView { matches: 90, inliers: 80, distinct_inliers: 80, motion, placement };
        let matched = Match { place: PlaceId::new(0), posterior: 1.0, log_odds: 9.0, frame: 1 };
        Candidate::new(matched, Some(view), None, 10.0)
    }

    /// 33 pixels of 320 are 4.73 degrees at the camera of Bazeille et al. 2011. A robot that has
    /// turned to the left sees things further to the right, one that has driven on sees them
    /// larger.
    #[test]
    fn a_shift_is_a_turn_and_a_scale_a_way() {
        let settings = LocalizationSettings::default();
        let focal_length_widths = 33.0 / 320.0 / 4.73_f64.to_radians().tan();
        let (turned, _) =
            measured(&shifted(0.0, 33.0 / 320.0), Some(focal_length_widths), &settings).unwrap();
        assert!((turned.heading_rad().to_degrees() - 4.73).abs() < 1e-9 && turned.x_m() == 0.0);
        let (nearer, unsure) = measured(&shifted(0.2, 0.0), Some(focal_length_widths), &settings).unwrap();
        assert!((nearer.x_m() - 0.2 * settings.depth_m).abs() < 1e-12 && nearer.heading_rad() == 0.0);
        let (_, sure) = measured(&shifted(0.0, 0.0), Some(focal_length_widths), &settings).unwrap();
        assert!(unsure[(0, 0)] > sure[(0, 0)]);
        // However far the image has moved.
        assert!(measured(&shifted(0.0, 0.9), Some(focal_length_widths), &settings).is_some());
    }

    /// What structure has measured is not moved on by how much larger the view is: that is the way which it measured.
    #[test]
    fn what_structure_measured_is_taken_as_it_is() {
        let settings = LocalizationSettings::default();
        let at = PlanarPose::new(0.31, -0.04, 0.02);
        let variances = Matrix3::from_diagonal(&Vector3::new(4e-4, 1e-4, 1e-6));
        let placed = |placement| {
            let candidate = shifted(0.1, 0.01);
            let view = candidate.view.map(|view| TwoView { placement, ..view });
            measured(&Candidate { view, ..candidate }, Some(0.8), &settings)
        };
        let solved = RelativePose::new(at, variances).unwrap();
        let (pose, covariance) = placed(Placement::At { pose: solved, inliers: 40 }).unwrap();
        assert_eq!(pose, at);
        let position = settings.map_m * settings.map_m;
        assert!((covariance[(0, 0)] - 4e-4 - position).abs() < 1e-12);
        assert!((covariance[(2, 2)] - 1e-6 - settings.map_rad * settings.map_rad).abs() < 1e-12);
        // Features of known depth that agree on no pose say that it is not there.
        assert!(placed(Placement::Nowhere).is_none());
        assert!(placed(Placement::Unknown).is_some());
    }
}
