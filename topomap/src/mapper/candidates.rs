//! Which places a frame is compared with, and what comes of it.

use std::cmp::Ordering;

use fabmap::appearance::PlaceId;

use super::frame::FrameInHand;
use super::state::Mapper;
use crate::evidence::{
    Candidate, Check, Placement, Quantity, TwoView, Verdict, VerificationSettings, ViewMotion,
};
use crate::settings::MapperSettings;

/// Candidates with this share of the strongest evidence are as good as it: the nearest of them is
/// taken.
pub const AS_GOOD: f64 = 0.9;

/// Views with less than this share of the strongest own evidence are not the nearest.
pub(super) const HALF_AS_GOOD: f64 = 0.5;

/// Largest |ln s| of a view that was taken beside the current one. On a walk with a frame a step,
/// four in five of those a frame apart are within.
const BESIDE_LN_SCALE: f64 = 0.25;

/// How many place spacings around that is.
const AROUND_SPACINGS: f64 = 6.0;

impl Mapper {
    /// Whether geometry has a say.
    #[must_use]
    pub fn verifies(&self) -> bool {
        self.settings().verification.method.verifies()
    }

    /// Whether geometry and words hold a candidate of a frame for the same place, and why.
    #[must_use]
    pub fn verdict(&self, candidate: &Candidate) -> Verdict {
        self.settings().verdict(candidate)
    }

    /// The candidate that is the same place by `settings`, of places that the session has not just
    /// been at, and that its wheels do not rule out.
    pub(super) fn verified<'a>(
        &self,
        settings: &MapperSettings,
        frame: &FrameInHand<'_>,
        candidates: &'a [Candidate],
    ) -> Option<&'a Candidate> {
        let accepted = self
            .accepted(settings, candidates)
            .filter(|candidate| !frame.session.is_near(candidate.matched.place, settings))
            .filter(|candidate| self.out_of_reach(&frame.input, candidate.matched.place).is_none());
        taken_nearest(accepted, self.strongest(candidates))
    }

    /// The same wherever the session is: with about the most evidence of all and accepted, the one
    /// taken from nearest.
    pub(super) fn verified_anywhere<'a>(
        &self,
        settings: &MapperSettings,
        candidates: &'a [Candidate],
    ) -> Option<&'a Candidate> {
        taken_nearest(self.accepted(settings, candidates), self.strongest(candidates))
    }

    fn accepted<'a>(
        &self,
        settings: &MapperSettings,
        candidates: &'a [Candidate],
    ) -> impl Iterator<Item = &'a Candidate> + Clone {
        self.possible(candidates)
            .filter(|candidate| candidate.view.is_some())
            .filter(move |candidate| settings.verdict(candidate).is_accepted())
    }

    /// The most evidence of all. One with far less than another is not verified: words may be sure
    /// of a place that merely looks alike.
    fn strongest(&self, candidates: &[Candidate]) -> f64 {
        self.most_evident(candidates).map_or(0.0, Candidate::evidence)
    }

    fn most_evident<'a>(&self, candidates: &'a [Candidate]) -> Option<&'a Candidate> {
        self.possible(candidates).max_by(|a, b| a.evidence().total_cmp(&b.evidence()))
    }

    /// The one beside which a candidate is not believed, whatever its probability: it has far more evidence.
    #[must_use]
    pub fn outdone_by<'a>(
        &self,
        candidate: &Candidate,
        candidates: &'a [Candidate],
    ) -> Option<&'a Candidate> {
        let most = self.most_evident(candidates)?;
        (candidate.evidence() < AS_GOOD * most.evidence()).then_some(most)
    }

    /// Those that structure does not put elsewhere: for the others it has explained why they look
    /// alike.
    fn possible<'a>(&self, candidates: &'a [Candidate]) -> impl Iterator<Item = &'a Candidate> + Clone {
        candidates.iter().filter(|candidate| !self.is_elsewhere(candidate))
    }

    /// Whether structure measured that the robot is not at the candidate's place.
    fn is_elsewhere(&self, candidate: &Candidate) -> bool {
        let MapperSettings { verification, place_spacing, .. } = self.settings();
        candidate.view.as_ref().is_some_and(|view| {
            view.placement != Placement::Unknown
                && !verification.of_one_place(view, place_spacing).iter().all(Check::passed)
        })
    }

    /// The view that is nearest to where a frame was taken, for a robot that steers by the shift of
    /// the image: it may be of where the robot has just been, and however far the image has moved.
    /// That the robot is about there takes a candidate that passes all the rest; which of the views
    /// around it is nearest, these two views alone say.
    #[must_use]
    pub fn nearest_view<'a>(&self, candidates: &'a [Candidate]) -> Option<&'a Candidate> {
        let verification =
            VerificationSettings { max_translation_widths: f64::INFINITY, ..self.settings().verification };
        let bounds = MapperSettings { verification, ..*self.settings() };
        let most = candidates.iter().map(Candidate::evidence).fold(0.0, f64::max);
        let verified = candidates
            .iter()
            .filter(|candidate| candidate.evidence() >= AS_GOOD * most)
            .filter(|candidate| bounds.verdict(candidate).is_accepted())
            .max_by(|a, b| a.own_evidence().total_cmp(&b.own_evidence()))?;
        let around =
            candidates.iter().filter(|other| self.is_around(verified.matched.place, other.matched.place));
        let most = around.clone().map(Candidate::own_evidence).fold(0.0, f64::max);
        let alike = around.filter(|other| {
            let of_one_place =
                |view| verification.of_one_place(view, &bounds.place_spacing).iter().all(Check::passed);
            other.own_evidence() >= HALF_AS_GOOD * most && other.view.as_ref().is_some_and(of_one_place)
        });
        alike.min_by(|a, b| nearer(a, b)).or(Some(verified))
    }

    /// Whether two places lie so near to each other that much the same may be seen from both.
    fn is_around(&self, place: PlaceId, other: PlaceId) -> bool {
        let pose =
            |place| self.poses().pose(place).filter(|_| self.poses().part(place) == self.poses().part(other));
        let (Some(pose), Some(other)) = (pose(place), pose(other)) else { return place == other };
        (pose.x_m() - other.x_m()).hypot(pose.y_m() - other.y_m())
            <= AROUND_SPACINGS * self.settings().place_spacing.distance_m
    }
}

/// Of candidates with about the `strongest` evidence the one taken from nearest to the current
/// frame: by metres, where they are measured; else the one that shows most of it by itself. If that
/// one is seen larger or smaller, another that is not, and has half as much, was taken beside it:
/// on a straight way the frames behind the robot are in step as those beside it are.
fn taken_nearest<'a>(
    candidates: impl Iterator<Item = &'a Candidate> + Clone,
    strongest: f64,
) -> Option<&'a Candidate> {
    let as_good = candidates.clone().filter(|candidate| candidate.evidence() >= AS_GOOD * strongest);
    let measured = as_good.clone().filter(|candidate| measured_m(candidate).is_some());
    if let Some(nearest) = measured.min_by(|a, b| nearer(a, b)) {
        return Some(nearest);
    }
    let shows_more = |best: &'a Candidate, next: &'a Candidate| {
        if next.own_evidence() > best.own_evidence() { next } else { best }
    };
    let alike = as_good.reduce(shows_more)?;
    if magnification(alike) <= BESIDE_LN_SCALE {
        return Some(alike);
    }
    let half_as_good = candidates.filter(|other| {
        other.evidence() >= HALF_AS_GOOD * strongest
            && other.own_evidence() >= HALF_AS_GOOD * alike.own_evidence()
    });
    half_as_good.min_by(|a, b| magnification(a).total_cmp(&magnification(b)))
}

/// |ln s| of a motion in the image plane; 0 where that is not known.
fn magnification(candidate: &Candidate) -> f64 {
    match candidate.view.as_ref().and_then(|view| view.motion) {
        Some(ViewMotion::Similarity(motion)) => motion.ln_scale.abs(),
        Some(ViewMotion::Essential { .. } | ViewMotion::Fundamental(_)) | None => 0.0,
    }
}

fn nearer(a: &Candidate, b: &Candidate) -> Ordering {
    let by_distance = match (measured_m(a), measured_m(b)) {
        (Some(a), Some(b)) => a.total_cmp(&b),
        (Some(_), None) => Ordering::Less,
        (None, Some(_)) => Ordering::Greater,
        (None, None) => distance_widths(a).total_cmp(&distance_widths(b)),
    };
    by_distance.then(b.evidence().total_cmp(&a.evidence()))
}

fn measured_m(candidate: &Candidate) -> Option<f64> {
    candidate.view.as_ref()?.placement.distance_m()
}

fn distance_widths(candidate: &Candidate) -> f64 {
    candidate.view.as_ref().map_or(0.0, TwoView::distance_widths)
}

/// Whether the place was compared, and had nothing to be compared by.
pub(super) fn is_without_keypoints(candidates: &[Candidate], place: PlaceId) -> bool {
    candidates.iter().any(|candidate| candidate.matched.place == place && candidate.view.is_none())
}

/// Whether views of the place show the current scene, and it is their probability alone that does not
/// reach the threshold.
pub(super) fn lacks_probability_alone(
    settings: &MapperSettings,
    candidates: &[Candidate],
    place: PlaceId,
) -> bool {
    candidates.iter().filter(|candidate| candidate.matched.place == place).any(|candidate| {
        let Verdict { checks } = settings.verdict(candidate);
        let mut failed = checks.iter().filter(|check| !check.passed()).peekable();
        failed.peek().is_some() && failed.all(|check| check.quantity == Quantity::Probability)
    })
}

/// The candidate that a judge of loop closures would be shown: of those that geometry has evidence
/// for, the nearest of the strongest; else the most probable by words.
pub(super) fn most_likely(candidates: &[Candidate]) -> Option<&Candidate> {
    let strongest = candidates.iter().map(Candidate::evidence).fold(0.0, f64::max);
    if strongest > 0.0 {
        return taken_nearest(candidates.iter().filter(|candidate| candidate.view.is_some()), strongest);
    }
    // The first of equal ones: those come in order of probability.
    candidates.iter().reduce(|best, next| if next.score() > best.score() { next } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A candidate with so many inliers, seen larger by a factor of e to `ln_scale`.
    fn seen_larger(inliers: u32, ln_scale: f64, support: f64) -> Candidate {
        let candidate = Candidate::shifted(ln_scale, 0.0);
        let view = candidate.view.map(|view| TwoView { inliers, distinct_inliers: inliers, ..view });
        Candidate { view, support, ..candidate }
    }

    #[test]
    fn of_frames_in_step_the_one_beside_the_robot_is_taken() {
        let taken = |candidates: &[Candidate]| {
            let strongest = candidates.iter().map(Candidate::evidence).fold(0.0, f64::max);
            let nearest = taken_nearest(candidates.iter(), strongest).unwrap();
            candidates.iter().position(|candidate| candidate == nearest).unwrap()
        };
        let (behind, ahead) = (seen_larger(60, 0.1, 300.0), seen_larger(35, -0.05, 300.0));
        assert_eq!(taken(&[behind, ahead]), 0);
        // Far behind, while one ahead shows half as much: that was taken beside the robot.
        let far_behind = seen_larger(60, 0.4, 300.0);
        assert_eq!(taken(&[far_behind, ahead]), 1);
        assert_eq!(taken(&[far_behind, seen_larger(20, -0.05, 300.0)]), 0);
        // What is in step, but shows little of it, does not outdo what shows more.
        assert_eq!(taken(&[seen_larger(23, 0.2, 340.0), seen_larger(60, 0.1, 290.0)]), 1);
    }

    #[test]
    fn the_end_of_a_corridor_is_nearer_where_it_is_no_larger() {
        assert_eq!(distance_widths(&Candidate::shifted(0.0, 0.0)), 0.0);
        // Half as large again, in the middle as before; and a turn of five degrees.
        assert!(
            distance_widths(&Candidate::shifted(0.3, 0.0)) > distance_widths(&Candidate::shifted(0.0, 0.07))
        );
        assert!(
            distance_widths(&Candidate::shifted(0.02, 0.05))
                < distance_widths(&Candidate::shifted(0.02, 0.1))
        );
        // By integration over the image: points at (x, y) move by (s - 1) times that.
        let at = |index: u32, count: u32| (f64::from(index) + 0.5) / f64::from(count) - 0.5;
        let points = (0..400).flat_map(|x| (0..300).map(move |y| (at(x, 400), 0.75 * at(y, 300))));
        let squares: f64 = points.map(|(x, y)| (x * x + y * y) * (0.3_f64.exp() - 1.0).powi(2)).sum();
        let by_integration = (squares / 120_000.0).sqrt();
        assert!(
            (distance_widths(&Candidate::shifted(0.3, 0.0)) - by_integration).abs() < 1e-3,
            "{by_integration}"
        );
    }
}
