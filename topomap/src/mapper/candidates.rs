//! Which places a frame is compared with, and what comes of it.

use std::cmp::Ordering;

use fabmap::appearance::PlaceId;

use super::state::Mapper;
use crate::evidence::{Candidate, Check, Placement, TwoView, Verdict, VerificationSettings};
use crate::map::Session;
use crate::settings::MapperSettings;

/// Candidates with this share of the strongest evidence are as good as it: the nearest of them is
/// taken.
const AS_GOOD: f64 = 0.9;

/// Views with less than this share of the strongest own evidence are not the nearest.
const HALF_AS_GOOD: f64 = 0.5;

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

    /// The candidate that is the same place: of those with about the most evidence, the nearest
    /// view that is accepted. One with far less evidence than another is left out: words may be
    /// sure of a place that merely looks alike. Those do not count that structure puts elsewhere: it
    /// has explained why they look alike.
    pub(super) fn verified<'a>(
        &self,
        session: &Session,
        candidates: &'a [Candidate],
    ) -> Option<&'a Candidate> {
        let possible = candidates.iter().filter(|candidate| !self.is_elsewhere(candidate));
        let strongest = possible.map(Candidate::evidence).fold(0.0, f64::max);
        let as_good = candidates
            .iter()
            .filter(|candidate| !session.is_near(candidate.matched.place, self.settings()))
            .filter(|candidate| candidate.view.is_some() && candidate.evidence() >= AS_GOOD * strongest)
            .filter(|candidate| !self.is_elsewhere(candidate));
        let passed = as_good
            .clone()
            .filter(|candidate| self.verdict(candidate).is_accepted())
            .filter(|candidate| !is_outdone(candidate, as_good.clone()));
        passed.min_by(|a, b| nearer(a, b))
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

/// Whether another candidate with about as much evidence has more than twice as much of its own: on
/// a straight way the frames behind the robot are in step as those beside it are, and look less like
/// what it sees. Where the distance is measured, that decides.
fn is_outdone<'a>(candidate: &Candidate, mut others: impl Iterator<Item = &'a Candidate>) -> bool {
    measured_m(candidate).is_none()
        && others.any(|other| candidate.own_evidence() < HALF_AS_GOOD * other.own_evidence())
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

/// The candidate that a judge of loop closures would be shown.
pub(super) fn most_likely(candidates: &[Candidate]) -> Option<&Candidate> {
    // The first of equal ones: those come in order of probability.
    candidates.iter().reduce(|best, next| if next.score() > best.score() { next } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_shows_far_less_of_it_is_further_behind() {
        let of_inliers = |inliers| {
            let candidate = Candidate::shifted(0.3, 0.0);
            let view = candidate.view.map(|view| TwoView { inliers, distinct_inliers: inliers, ..view });
            Candidate { view, ..candidate }
        };
        let beside = [of_inliers(60), of_inliers(40)];
        assert!(is_outdone(&of_inliers(20), beside.iter()));
        assert!(!is_outdone(&of_inliers(40), beside.iter()));
        assert!(!is_outdone(&of_inliers(60), beside.iter()));
        assert!(!is_outdone(&of_inliers(20), [].iter()));
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
