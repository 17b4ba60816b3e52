//! How far a session has come.

use std::collections::VecDeque;

/// How far a session has come, and at which of its frames: images may come every few centimetres.
///
/// Ways are in place spacings: as many as fit into the metres driven, or into the angle turned,
/// whichever are more. From one frame to the next they are at most one, and one where there is no
/// odometry.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Milestones {
    /// To the last frame.
    pub way_spacings: f64,
    /// Ascending, as far back as was asked for.
    pub passed: VecDeque<Milestone>,
}

/// A frame, and how far the session had come then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Milestone {
    /// Number of the frame in its session, from 0.
    pub frame: u64,
    /// To this frame, in place spacings.
    pub way_spacings: f64,
}

/// Milestones are so far apart, at least.
const APART_SPACINGS: f64 = 0.5;

impl Milestones {
    /// Takes in that the session went so much further to `frame`; what lies further back than
    /// `kept_spacings` is forgotten.
    pub(super) fn pass(&mut self, frame: u64, step_spacings: f64, kept_spacings: f64) {
        self.way_spacings += step_spacings;
        let way_spacings = self.way_spacings;
        let is_apart = |last: &Milestone| way_spacings - last.way_spacings >= APART_SPACINGS;
        if self.passed.back().is_none_or(is_apart) {
            self.passed.push_back(Milestone { frame, way_spacings });
        }
        while self.passed.front().is_some_and(|first| way_spacings - first.way_spacings >= kept_spacings) {
            self.passed.pop_front();
        }
    }

    /// The way since a frame, in place spacings, to within the distance of milestones and never too
    /// short; `None` if it is further back than is remembered.
    #[must_use]
    pub fn since(&self, frame: u64) -> Option<f64> {
        let before = self.passed.iter().rev().find(|passed| passed.frame <= frame)?;
        Some(self.way_spacings - before.way_spacings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ways_are_the_sums_of_steps(steps in prop::collection::vec(0.0..2.0f64, 1..200), kept in 1.0..30.0f64) {
            let mut milestones = Milestones::default();
            for (frame, &step) in steps.iter().enumerate() {
                milestones.pass(frame as u64, step, kept);
            }
            for frame in 0..steps.len() {
                let way: f64 = steps[frame + 1..].iter().sum();
                match milestones.since(frame as u64) {
                    Some(since) => prop_assert!((-1e-9..APART_SPACINGS).contains(&(since - way)), "{since} for {way}"),
                    None => prop_assert!(way > kept - APART_SPACINGS - 1e-9, "{way} forgotten"),
                }
            }
            prop_assert!(milestones.passed.len() as f64 <= kept / APART_SPACINGS + 1.0);
        }
    }

    #[test]
    fn frames_a_spacing_apart_are_counted() {
        let mut milestones = Milestones::default();
        (0..50).for_each(|frame| milestones.pass(frame, 1.0, 20.0));
        assert_eq!(
            (milestones.since(49), milestones.since(30), milestones.since(29)),
            (Some(0.0), Some(19.0), None)
        );
    }
}
