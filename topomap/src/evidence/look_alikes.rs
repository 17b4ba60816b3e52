//! What the best look-alike of a frame is expected to show: by what the model learnt of places of
//! its kind, and by what other places of the map itself have shown.

use fabmap::look_alikes::Kind;
use fabmap::observation::Observation;

/// Frames of the map that what the model says of a kind that it knows is worth.
const FRAMES_OF_THE_MODEL: f64 = 1000.0;

/// Evidence that look-alikes of any kind show, in inliers.
const LEAST_INLIERS: f64 = 0.5;

/// How fast a session follows what its frames are like: evidence comes from the last eight.
const FOLLOWING: f64 = 0.2;

/// What each of the last frames adds to the evidence of a look-alike, over what it shows by itself:
/// those of eight frames in order come to 4.3 times that of one.
const ADDED_BY_A_FRAME: f64 = 3.3 / 8.0;

/// Look-alikes of one frame where the model does not know any, at most: closures then ask for as
/// much as floors of one architect do.
const UNKNOWN_INLIERS: f64 = 16.5;

/// The same per word, of small images: what models learn of such floors, 0.055 to 0.061 with images
/// 160 to 640 pixels wide.
const UNKNOWN_SHARE: f64 = 0.06;

/// Fewer words than this say nothing of what share of them a look-alike may have in common.
const FEWEST_WORDS: f64 = 40.0;

/// Frames between two of one drive that show different places.
const FRAMES_APART: u64 = 20;

/// What is known of look-alikes where a session drives; derived from the log.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LookAlikesSeen {
    /// What one frame's best look-alike is expected to show, as of the session's last frames, in
    /// inliers; `None` before the first.
    pub inliers: Option<f64>,
    /// Sum over the session's compared frames of what the best of the places that cannot be the one
    /// it is at showed, per word.
    pub shares: f64,
    /// Frames that were compared.
    pub frames: u64,
}

/// An earlier frame that a frame of a session was compared with, and what they show in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Compared {
    /// Session of the earlier frame, and its number there.
    pub(crate) seen: (u32, u64),
    /// By themselves, in inliers.
    pub(crate) evidence: f64,
    /// With the frames before.
    pub(crate) total_evidence: f64,
}

impl LookAlikesSeen {
    /// What the best look-alike of the next frame is expected to show by itself, in inliers, above
    /// 0, where one of an image like it shows `of_image`.
    #[must_use]
    pub(crate) fn expected_inliers(&self, of_image: f64) -> f64 {
        self.inliers.map_or(of_image, |before| before + FOLLOWING * (of_image - before))
    }

    /// Takes in a frame of the session of so many different `words`, whose best look-alike was
    /// expected to show `expected_inliers`.
    ///
    /// The candidate with the most evidence may be the place where the robot is. Others of the same
    /// drive that were seen long before or after it are not.
    pub(crate) fn follow(&mut self, expected_inliers: f64, words: usize, compared: &[Compared]) {
        self.inliers = Some(expected_inliers);
        self.frames += 1;
        let most = compared.iter().max_by(|a, b| a.total_evidence.total_cmp(&b.total_evidence));
        let Some(Compared { seen: (session, number), .. }) = most else { return };
        let elsewhere = compared
            .iter()
            .filter(|other| other.seen.0 == *session && other.seen.1.abs_diff(*number) > FRAMES_APART);
        let best = elsewhere.map(|other| other.evidence).fold(0.0, f64::max);
        self.shares += best / words.max(1) as f64;
    }
}

/// What the best look-alike of an image of a `kind` that the model knows is expected to show, in
/// inliers: of so many different `words`, on a map whose `frames` came to `shares`.
pub(crate) fn of_kind(kind: Kind, words: usize, (shares, frames): (f64, u64)) -> f64 {
    let of_model = FRAMES_OF_THE_MODEL * kind.familiarity;
    let all = (of_model + frames as f64).max(f64::MIN_POSITIVE);
    words as f64 * (of_model * kind.share + shares) / all + LEAST_INLIERS
}

/// The same where the model knows of none, in inliers. Small images can show little by chance. How
/// small they are is told by those that the model was trained on, and by no single frame: one of a
/// bare wall shows few words, too, and another wall the same.
pub(crate) fn of_unknown_kind(trained_on: &[Observation]) -> f64 {
    let words: usize = trained_on.iter().map(Observation::len).sum();
    let mean = words as f64 / trained_on.len() as f64;
    // Nothing is known where the model remembers no image.
    let inliers = mean.max(FEWEST_WORDS) * UNKNOWN_SHARE + LEAST_INLIERS;
    if trained_on.is_empty() { UNKNOWN_INLIERS } else { inliers.min(UNKNOWN_INLIERS) }
}

/// What look-alikes come to over a frame and the `frames` before it that may support it, where each
/// shows `inliers` by itself.
pub(crate) fn over_frames(inliers: f64, frames: u64) -> f64 {
    inliers * (1.0 + ADDED_BY_A_FRAME * frames as f64)
}

/// What candidates of logs are held against that were written before look-alikes were.
pub(crate) fn unknown_over_frames() -> f64 {
    over_frames(UNKNOWN_INLIERS, 8)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: Kind = Kind { share: 0.05, familiarity: 1.0 };

    #[test]
    fn a_known_kind_is_believed_before_the_map_has_seen_it() {
        assert_eq!(of_kind(KNOWN, 400, (0.0, 0)), 20.5);
        // Fifty frames without a look-alike say little against it.
        assert!(of_kind(KNOWN, 400, (0.0, 50)) > 19.0);
    }

    #[test]
    fn of_an_unknown_kind_the_map_tells_itself() {
        let unknown = Kind { familiarity: 0.01, ..KNOWN };
        let of_map = |shares, frames| of_kind(unknown, 100, (shares, frames));
        assert_eq!(of_map(0.0, 0), 5.5);
        assert!(of_map(0.0, 100) < 1.1);
        assert!(of_map(10.0, 100) > 9.0);
    }

    #[test]
    fn without_kinds_as_much_is_asked_as_in_a_tower_of_images_as_small() {
        let image = |words: u32| Observation::from_words(0..words, 1000).unwrap();
        assert_eq!(of_unknown_kind(&[]), UNKNOWN_INLIERS);
        assert_eq!(of_unknown_kind(&[image(400), image(500)]), UNKNOWN_INLIERS);
        assert!((of_unknown_kind(&[image(40), image(60)]) - 3.5).abs() < 1e-9);
        assert!((of_unknown_kind(&[image(4)]) - 2.9).abs() < 1e-9);
        assert!((unknown_over_frames() - 70.95).abs() < 1e-9);
    }

    #[test]
    fn what_lies_elsewhere_on_the_same_drive_is_a_look_alike() {
        let at = |session, number, evidence| Compared {
            seen: (session, number),
            evidence,
            total_evidence: 10.0 * evidence,
        };
        let mut seen = LookAlikesSeen::default();
        // Beside the best, of another drive, and elsewhere on the same one.
        seen.follow(3.0, 10, &[at(0, 50, 40.0), at(0, 60, 30.0), at(1, 500, 20.0), at(0, 100, 2.0)]);
        assert_eq!(seen, LookAlikesSeen { inliers: Some(3.0), shares: 0.2, frames: 1 });
        seen.follow(4.0, 10, &[]);
        assert_eq!(seen, LookAlikesSeen { inliers: Some(4.0), shares: 0.2, frames: 2 });
    }

    #[test]
    fn expectations_follow_the_way() {
        let before = LookAlikesSeen { inliers: Some(10.0), ..LookAlikesSeen::default() };
        assert!((before.expected_inliers(20.5) - 12.1).abs() < 1e-9);
    }
}
