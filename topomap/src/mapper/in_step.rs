//! Where nothing is measured: frames that follow an earlier drive in its order.

use std::ops::RangeInclusive;

/// That one of the last frames was seen at a frame of an earlier drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Frames between it and the current one, from 1.
    pub(super) frames_ago: u64,
    /// Number of the earlier drive's frame.
    pub(super) number: u64,
    /// What speaks for it, in inliers.
    pub(super) evidence: f64,
}

/// Frames of the earlier drive that one frame goes past where a robot drives much as it did then.
const AS_BEFORE: RangeInclusive<f64> = 2.0 / 3.0..=3.0 / 2.0;

/// The same at another speed, or with images sent at another rate; what is in step so loosely is worth [`LOOSE`].
const OTHERWISE: RangeInclusive<f64> = 0.0..=4.0;
const LOOSE: f64 = 0.5;

/// Frames of the earlier drive that a match may be off: its neighbours show the same.
const SLACK_FRAMES: f64 = 1.0;

/// Frames of the earlier drive between the matches of two frames in a row, at most.
const MOST_FRAMES_PER_FRAME: i64 = 6;

impl Step {
    /// Whether any way can lead from there to frame `number`.
    pub(super) fn is_within_reach(&self, number: u64) -> bool {
        let most = OTHERWISE.end() * self.frames_ago as f64 + SLACK_FRAMES;
        self.number.abs_diff(number) as f64 <= most
    }
}

/// What the last frames say for the robot being at frame `number` of an earlier drive: the most
/// evidence, in inliers, of frames that follow that drive to there, forwards or backwards. Places
/// that look alike match one frame of it after the other, but seldom in step.
pub(super) fn evidence_in_step(mut steps: Vec<Step>, number: u64) -> f64 {
    steps.sort_by_key(|step| (step.frames_ago, step.number));
    let of_direction = |direction| {
        let most = |speeds| strongest_way(&steps, number, direction, speeds);
        most(&AS_BEFORE).max(LOOSE * most(&OTHERWISE))
    };
    of_direction(1).max(of_direction(-1))
}

/// The most evidence of a way, its steps last frame first, that never turns round and keeps to the
/// speeds all along. `direction` is 1 forwards along the earlier drive, -1 backwards.
fn strongest_way(steps: &[Step], number: u64, direction: i64, speeds: &RangeInclusive<f64>) -> f64 {
    let mut reached = vec![Reached { frames_ago: 0, gone: 0, evidence: 0.0 }];
    for step in steps {
        let gone = direction * (number.cast_signed() - step.number.cast_signed());
        let frames = step.frames_ago as f64;
        let within = speeds.start() * frames - SLACK_FRAMES..=speeds.end() * frames + SLACK_FRAMES;
        if !within.contains(&(gone as f64)) {
            continue;
        }
        let leads_here = |later: &&Reached| {
            let frames = step.frames_ago.cast_signed() - later.frames_ago.cast_signed();
            frames > 0 && (0..=MOST_FRAMES_PER_FRAME * frames).contains(&(gone - later.gone))
        };
        let strongest = reached.iter().filter(leads_here).map(|later| later.evidence).reduce(f64::max);
        if let Some(evidence) = strongest {
            reached.push(Reached { frames_ago: step.frames_ago, gone, evidence: evidence + step.evidence });
        }
    }
    reached.iter().map(|way| way.evidence).fold(0.0, f64::max)
}

/// Where a way back from the current frame has come to.
struct Reached {
    frames_ago: u64,
    /// Frames of the earlier drive.
    gone: i64,
    /// Of all on the way, in inliers.
    evidence: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// One match per frame, of 10 inliers: `numbers` from the last frame back.
    fn steps(numbers: &[u64]) -> Vec<Step> {
        let step = |(frames_ago, &number)| Step { frames_ago, number, evidence: 10.0 };
        (1..).zip(numbers).map(step).collect()
    }

    #[test]
    fn what_follows_in_order_counts_in_full() {
        let forwards = steps(&[99, 98, 97, 96]);
        assert_eq!(evidence_in_step(forwards.clone(), 100), 40.0);
        assert_eq!(evidence_in_step(steps(&[101, 102, 103, 104]), 100), 40.0);
        // Neighbours show the same, and one frame in between matched nothing.
        assert_eq!(evidence_in_step(steps(&[98, 98, 97, 95]), 100), 40.0);
        let with_a_gap = vec![forwards[0], forwards[1], forwards[3]];
        assert_eq!(evidence_in_step(with_a_gap, 100), 30.0);
    }

    #[test]
    fn what_goes_at_another_speed_counts_half() {
        assert_eq!(evidence_in_step(steps(&[97, 94, 91, 88]), 100), 20.0);
        assert_eq!(evidence_in_step(steps(&[100, 100, 100, 100]), 100), 20.0);
    }

    #[test]
    fn what_jumps_about_counts_for_little() {
        assert_eq!(evidence_in_step(steps(&[40, 160, 20, 180]), 100), 0.0);
        // To and fro: no way has both.
        assert_eq!(evidence_in_step(steps(&[99, 101, 99, 101]), 100), 20.0);
        assert_eq!(evidence_in_step(Vec::new(), 100), 0.0);
    }

    proptest! {
        /// Against every selection of one match a frame, tried one by one.
        #[test]
        fn the_strongest_way_is_the_best_of_all(
            of in prop::collection::vec((1..5u64, 90..110u64, 1..30u8), 0..9),
            number in 95..105u64,
        ) {
            let steps: Vec<Step> = of.iter()
                .map(|&(frames_ago, number, evidence)| Step { frames_ago, number, evidence: f64::from(evidence) })
                .collect();
            let mut best = 0.0_f64;
            for chosen in 0_u32..1 << steps.len() {
                let mut way: Vec<Step> =
                    (0..steps.len()).filter(|n| chosen >> n & 1 == 1).map(|n| steps[n]).collect();
                way.sort_by_key(|step| step.frames_ago);
                for direction in [1, -1] {
                    for (speeds, worth) in [(AS_BEFORE, 1.0), (OTHERWISE, LOOSE)] {
                        let (mut ago, mut gone, mut fits) = (0, 0, true);
                        for step in &way {
                            let now = direction * (number as i64 - step.number as i64);
                            let frames = step.frames_ago as f64;
                            fits &= step.frames_ago > ago
                                && (0..=MOST_FRAMES_PER_FRAME * (step.frames_ago - ago) as i64).contains(&(now - gone))
                                && now as f64 >= speeds.start() * frames - SLACK_FRAMES
                                && now as f64 <= speeds.end() * frames + SLACK_FRAMES;
                            (ago, gone) = (step.frames_ago, now);
                        }
                        let sum: f64 = way.iter().map(|step| step.evidence).sum();
                        if fits { best = best.max(worth * sum); }
                    }
                }
            }
            let within_reach: Vec<Step> =
                steps.iter().copied().filter(|step| step.is_within_reach(number)).collect();
            prop_assert!((evidence_in_step(within_reach, number) - best).abs() < 1e-9);
            prop_assert!((evidence_in_step(steps, number) - best).abs() < 1e-9);
        }
    }
}
