//! Wheels that see a turn where there is none: how much a metre, by the loops that the robot
//! closed.
//!
//! A drift of three degrees a metre turns a loop of sixty metres by half a circle. Taken for noise
//! it is no noise that a robust relaxation would believe, and closures would be judged by it. But
//! it is the same all along, so that one loop shows it: the heading that it closes with, over the
//! way around it.

use std::collections::BTreeMap;

use crate::ids::SessionId;
use crate::metric::RelativePose;
use posegraph::{PlanarPose, Pose};

/// A measured way from one place to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Way {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) measured: RelativePose,
}

/// Turn to the left that each session's wheels see where there is none, in radians per metre.
///
/// `driven` are ways by wheels alone, each to the next place that was made, with the session that
/// drove it; places that none leads to begin a tree of their own. `closed` are ways that
/// recognition measured. Where no loop shows it, or loops contradict each other, the drift is 0,
/// which it is expected to be within `expected_rad_per_m`.
pub(crate) fn drifts(
    places: usize,
    driven: &[(Way, SessionId)],
    closed: &[Way],
    expected_rad_per_m: f64,
) -> BTreeMap<SessionId, f64> {
    let mut drifts = BTreeMap::new();
    if closed.is_empty() || expected_rad_per_m <= 0.0 {
        return drifts;
    }
    let tree = Tree::of(places, driven);
    let sessions: std::collections::BTreeSet<SessionId> =
        driven.iter().map(|&(_, session)| session).collect();
    for session in sessions {
        let loops = tree.loops(driven, closed, session, &drifts);
        let mut best = (0.0, tree.cost(driven, &loops, &drifts, expected_rad_per_m, session, 0.0));
        for drift in candidates(&loops, expected_rad_per_m) {
            // Those that follow are no smaller.
            if (drift / expected_rad_per_m).powi(2) >= best.1 {
                break;
            }
            let cost = tree.cost(driven, &loops, &drifts, expected_rad_per_m, session, drift);
            if cost < best.1 {
                best = (drift, cost);
            }
        }
        if best.0 != 0.0 {
            drifts.insert(session, refined(best.0, &loops, expected_rad_per_m));
        }
    }
    drifts
}

/// What wheels measured, without their drift. Half of the turn that there was none lies before the
/// middle of the way.
#[must_use]
pub(crate) fn without_drift(measured: &PlanarPose, drift_rad_per_m: f64) -> PlanarPose {
    let turn_rad = drift_rad_per_m * way_m(measured);
    let ahead = PlanarPose::new(0.0, 0.0, -turn_rad / 2.0);
    ahead.compose(measured).compose(&ahead)
}

fn way_m(measured: &PlanarPose) -> f64 {
    measured.x_m().hypot(measured.y_m())
}

/// Ways by wheels: at most one leads to each place, and none back.
struct Tree {
    /// The way to each place: its number.
    to: Vec<Option<usize>>,
}

/// A closure around which wheels alone lead.
struct Loop {
    way: Way,
    /// Heading that is left over around it, in radians.
    left_rad: f64,
    /// How much of it a drift of 1 rad/m would explain, in metres, below 0 where it runs backwards.
    lever_m: f64,
    /// Metres around it.
    around_m: f64,
    /// Variance of its heading.
    heading_variance: f64,
}

/// Turn that wheels make at random, in rad/√m: what is left when the drift is taken off. Along a
/// loop of length L that closes in heading it moves the end by this L√L / √12, one standard
/// deviation.
pub(crate) const RANDOM_TURN: f64 = 0.01;
/// Squared deviations at which a closure counts as contradicted.
const CONTRADICTED: f64 = 9.0;
/// Loops that candidates are taken from, the shortest, and what they must have around them.
const CANDIDATE_LOOPS: usize = 6;
const LEAST_LEVER_M: f64 = 5.0;
/// What is left over around a loop by two drifts that are much the same, in radians.
const SAME_RAD: f64 = 0.05;
/// Expected deviations that a drift is looked for within.
const MOST_DEVIATIONS: f64 = 3.0;

impl Tree {
    fn of(places: usize, driven: &[(Way, SessionId)]) -> Self {
        let mut to = vec![None; places];
        for (number, (way, _)) in driven.iter().enumerate() {
            if way.from < way.to {
                to[way.to] = Some(number);
            }
        }
        Self { to }
    }

    /// The closures that this session's wheels lead around, with the drifts known for other
    /// sessions taken off.
    fn loops(
        &self,
        driven: &[(Way, SessionId)],
        closed: &[Way],
        session: SessionId,
        known: &BTreeMap<SessionId, f64>,
    ) -> Vec<Loop> {
        let loops = closed.iter().filter_map(|&way| {
            let mut left_rad = -way.measured.pose().heading_rad();
            let mut lever_m = 0.0;
            let mut around_m = 0.0;
            let mut heading_variance = way.measured.covariance()[(2, 2)];
            // Up from both ends to where they meet: places come after those that they were reached
            // from.
            let mut from = way.from;
            let mut to = way.to;
            while from != to {
                let (end, sign) = if from > to { (&mut from, -1.0) } else { (&mut to, 1.0) };
                let (step, by) = driven[self.to[*end]?];
                *end = step.from;
                let turned_rad = step.measured.pose().heading_rad();
                let metres = way_m(step.measured.pose());
                left_rad += sign * (turned_rad - known.get(&by).copied().unwrap_or(0.0) * metres);
                lever_m += if by == session { sign * metres } else { 0.0 };
                around_m += metres;
                heading_variance += step.measured.covariance()[(2, 2)];
            }
            let left_rad = wrapped(left_rad);
            Some(Loop { way, left_rad, lever_m, around_m, heading_variance })
        });
        loops.filter(|closed| closed.lever_m.abs() >= LEAST_LEVER_M).collect()
    }

    /// How badly the loops close with that drift, each as badly as a contradicted one at most. They
    /// share most of their way, and so of what is wrong about it: together they count as one. A
    /// drift that winds a long way up to a small circle closes any loop; the smallest that does is
    /// the most likely.
    fn cost(
        &self,
        driven: &[(Way, SessionId)],
        loops: &[Loop],
        known: &BTreeMap<SessionId, f64>,
        expected_rad_per_m: f64,
        session: SessionId,
        drift: f64,
    ) -> f64 {
        let mut poses: Vec<PlanarPose> = Vec::with_capacity(self.to.len());
        for way in &self.to {
            let pose = way.map_or_else(PlanarPose::identity, |number| {
                let (step, by) = &driven[number];
                let of_wheels = if *by == session { drift } else { known.get(by).copied().unwrap_or(0.0) };
                poses[step.from].compose(&without_drift(step.measured.pose(), of_wheels))
            });
            poses.push(pose);
        }
        let misses = loops.iter().map(|closed| {
            let Way { from, to, measured } = &closed.way;
            let missed = PlanarPose::error(measured.pose(), &poses[*from], &poses[*to]);
            let random_m = RANDOM_TURN * closed.around_m.powf(1.5) / 12_f64.sqrt();
            let position_variance = measured.covariance()[(0, 0)] + random_m * random_m;
            let squares = missed[2] * missed[2] / closed.heading_variance
                + (missed[0] * missed[0] + missed[1] * missed[1]) / position_variance;
            squares.min(CONTRADICTED)
        });
        (drift / expected_rad_per_m).powi(2) + misses.sum::<f64>() / loops.len().max(1) as f64
    }
}

/// Drifts that one of the shortest loops would close with, whole turns more or less; the smallest
/// first, and each of two that are much the same once.
fn candidates(loops: &[Loop], expected_rad_per_m: f64) -> Vec<f64> {
    let mut shortest: Vec<&Loop> = loops.iter().collect();
    shortest.sort_by(|a, b| a.lever_m.abs().total_cmp(&b.lever_m.abs()));
    let most = MOST_DEVIATIONS * expected_rad_per_m;
    let mut candidates: Vec<(f64, f64)> = Vec::new();
    for closed in shortest.into_iter().take(CANDIDATE_LOOPS) {
        let turns = (most * closed.lever_m.abs() / std::f64::consts::TAU).ceil().min(50.0) as i32;
        let drifts = (-turns..=turns)
            .map(|turn| (closed.left_rad + std::f64::consts::TAU * f64::from(turn)) / closed.lever_m);
        candidates.extend(drifts.filter(|drift| drift.abs() <= most).map(|drift| (drift, closed.lever_m)));
    }
    candidates.sort_by(|(a, _), (b, _)| a.abs().total_cmp(&b.abs()));
    let mut kept: Vec<f64> = Vec::new();
    for (drift, lever_m) in candidates {
        if kept.iter().all(|other| ((drift - other) * lever_m).abs() > SAME_RAD) {
            kept.push(drift);
        }
    }
    kept
}

/// Least squares over the loops that agree with a drift.
fn refined(drift: f64, loops: &[Loop], expected_rad_per_m: f64) -> f64 {
    let mut moment = 0.0;
    let mut weight = 1.0 / (expected_rad_per_m * expected_rad_per_m);
    for closed in loops {
        let left_rad = wrapped(closed.left_rad - drift * closed.lever_m);
        if left_rad * left_rad <= CONTRADICTED * closed.heading_variance {
            let levered = closed.lever_m / closed.heading_variance;
            moment += levered * (left_rad + drift * closed.lever_m);
            weight += levered * closed.lever_m;
        }
    }
    moment / weight
}

fn wrapped(angle_rad: f64) -> f64 {
    angle_rad.sin().atan2(angle_rad.cos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    const EXPECTED: f64 = 0.05;

    fn way(from: usize, to: usize, pose: PlanarPose, sigma: f64) -> Way {
        let measured = RelativePose::new(pose, Matrix3::identity() * sigma * sigma).unwrap();
        Way { from, to, measured }
    }

    /// A rectangle of `side` and of three times as many steps a side, 0.5 m each, driven by wheels
    /// of that drift; then it closes. A square would close as well with a whole turn more.
    fn rectangle(side: usize, drift: f64, first: usize, session: SessionId) -> (Vec<(Way, SessionId)>, Way) {
        let mut driven = Vec::new();
        let mut here = PlanarPose::identity();
        for step in 0..8 * side {
            let corner = [0, side].contains(&((step + 1) % (4 * side)));
            let turn = if corner { std::f64::consts::FRAC_PI_2 } else { 0.0 };
            let motion = PlanarPose::new(0.5, 0.0, turn);
            here = here.compose(&motion);
            let felt = without_drift(&motion, -drift);
            driven.push((way(first + step, first + step + 1, felt, 0.02), session));
        }
        (driven, way(first + 8 * side, first, here.inverse(), 0.05))
    }

    proptest! {
        #[test]
        fn what_is_taken_off_is_what_was_added(
            (x, y, turn) in (-2.0..2.0f64, -2.0..2.0f64, -3.0..3.0f64), drift in -0.1..0.1f64,
        ) {
            let pose = PlanarPose::new(x, y, turn);
            let apart = pose.inverse().compose(&without_drift(&without_drift(&pose, drift), -drift));
            prop_assert!(way_m(&apart) < 1e-12 && apart.heading_rad().abs() < 1e-12);
        }

        /// From a few metres to where the drift has turned the robot almost once round. Beyond that
        /// a rectangle, which looks the same from both ends, closes as well with two turns the
        /// other way.
        #[test]
        fn a_loop_shows_the_drift(side in 3..30usize, turns in -0.95..0.95f64) {
            let drift = (turns * std::f64::consts::TAU / (4 * side) as f64).clamp(-0.055, 0.055);
            let (driven, closed) = rectangle(side, drift, 0, 7);
            let found = drifts(8 * side + 1, &driven, &[closed], EXPECTED);
            let found = found.get(&7).copied().unwrap_or(0.0);
            prop_assert!((found - drift).abs() < 0.05 * drift.abs() + 1e-3, "{found}, not {drift}");
        }
    }

    #[test]
    fn a_closure_that_leads_elsewhere_shows_none() {
        let (driven, closed) = rectangle(10, 0.0, 0, 0);
        let elsewhere = PlanarPose::new(9.0, -7.0, 2.0).compose(closed.measured.pose());
        let wrong = way(closed.from, closed.to, elsewhere, 0.05);
        assert_eq!(drifts(81, &driven, &[wrong], EXPECTED), BTreeMap::new());
        assert_eq!(drifts(81, &driven, &[], EXPECTED), BTreeMap::new());
        // Beside true ones it changes nothing.
        let (driven, closed) = rectangle(10, 0.03, 0, 0);
        let other = way(79, 1, *closed.measured.pose(), 0.05);
        let found = drifts(81, &driven, &[wrong, closed, other], EXPECTED)[&0];
        assert!((found - 0.03).abs() < 2e-3, "{found}");
    }

    #[test]
    fn every_session_has_wheels_of_its_own() {
        let (mut driven, first) = rectangle(8, 0.04, 0, 0);
        let (second, last) = rectangle(10, -0.02, 65, 3);
        driven.extend(second);
        let found = drifts(65 + 81, &driven, &[first, last], EXPECTED);
        assert!((found[&0] - 0.04).abs() < 2e-3 && (found[&3] + 0.02).abs() < 2e-3, "{found:?}");
    }
}
