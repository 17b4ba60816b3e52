//! Where a robot may be that does not know: what all frames of a look around say together.
//!
//! One frame of a robot that was put down somewhere may match views of two places, or none clearly.
//! But its wheels tell how it turned from frame to frame, so each glimpse of each frame names a
//! pose for the same robot now, and those of the true one agree, frame after frame.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use super::localization::{Closure, Glimpses};
use super::planning::MapPosition;
use super::settings::LocalizationSettings;
use posegraph::{PlanarPose, Pose};

/// What a lost robot has seen since it is lost.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Search {
    frames: VecDeque<Frame>,
}

#[derive(Clone, Debug, PartialEq)]
struct Frame {
    odometry: PlanarPose,
    glimpses: Vec<Closure>,
    /// The place of the frame, if that is clear by this frame alone.
    clear: Option<Closure>,
}

/// Where the robot is now if one glimpse is true.
struct Guess<'a> {
    closure: &'a Closure,
    now: PlanarPose,
    sector: usize,
}

/// Two turns and a half at two frames a second.
const MOST_FRAMES: usize = 160;

/// Headings that count as one: a robot that stands sees the same again and again.
const SECTORS: usize = 36;

/// A robot has looked all around if it left out no more than this: what is seen to the left of one
/// frame is seen to the right of the next.
const LARGEST_GAP_RAD: f64 = 0.6;

/// Evidence below which a glimpse may be anything, in inliers.
const LEAST_EVIDENCE: f64 = 8.0;

/// From where guesses are rivals, in metres and radians: those nearer may be poor measurements of
/// the same pose.
const RIVALS: (f64, f64) = (2.5, 0.7);

/// A view that is turned by this counts half: the shift of its image says less exactly by how much.
const AHEAD_RAD: f64 = 0.1;

/// Deviations of what is found, in metres and radians.
const FOUND_SIGMAS: [f64; 3] = [0.3, 0.3, 0.1];

impl Search {
    pub(super) fn is_promising(&self) -> bool {
        self.frames.back().is_some_and(|frame| frame.clear.is_some())
    }

    /// Takes a frame in; where the robot is at that frame, once that is clear.
    pub(super) fn see(
        &mut self,
        odometry: &PlanarPose,
        closure: Option<&Closure>,
        glimpses: &Glimpses,
        settings: &LocalizationSettings,
    ) -> Option<Closure> {
        let clear = closure.filter(|closure| closure.tells_where(settings)).copied();
        let of_worth = |closure: &&Closure| worth(closure, settings) >= LEAST_EVIDENCE;
        let glimpses = glimpses.iter().flatten().chain(&clear).filter(of_worth).copied().collect();
        if self.frames.len() == MOST_FRAMES {
            self.frames.pop_front();
        }
        self.frames.push_back(Frame { odometry: *odometry, glimpses, clear });
        let guesses = self.guesses(odometry);
        let (best, evidence) = strongest(&guesses, |_| true, settings)?;
        let is_rival = |guess: &Guess<'_>| !agree(guess, best, RIVALS);
        let rival = strongest(&guesses, is_rival, settings).map_or(0.0, |(_, evidence)| evidence);
        if rival > settings.search_rival * evidence {
            return None;
        }
        let is_clear = self.clear_frames(best, odometry, settings) >= settings.confirmations as usize;
        let is_sure = evidence >= settings.search_evidence && self.has_looked_around();
        (is_clear || is_sure).then(|| fused(&guesses, best, settings))
    }

    /// Frames that show by themselves that the robot is there.
    fn clear_frames(
        &self,
        best: &Guess<'_>,
        odometry: &PlanarPose,
        settings: &LocalizationSettings,
    ) -> usize {
        let shows_it = |frame: &&Frame| {
            frame.clear.as_ref().is_some_and(|closure| {
                let guess = Guess { closure, now: at(frame, closure, odometry), sector: best.sector };
                agree(&guess, best, near(settings))
            })
        };
        self.frames.iter().filter(shows_it).count()
    }

    fn guesses(&self, odometry: &PlanarPose) -> Vec<Guess<'_>> {
        let mut guesses = Vec::new();
        for frame in &self.frames {
            let turn = frame.odometry.heading_rad().rem_euclid(TAU) / TAU;
            let sector = ((turn * SECTORS as f64) as usize).min(SECTORS - 1);
            let guess = |closure| Guess { closure, now: at(frame, closure, odometry), sector };
            guesses.extend(frame.glimpses.iter().map(guess));
        }
        guesses
    }

    fn has_looked_around(&self) -> bool {
        let mut headings_rad: Vec<f64> =
            self.frames.iter().map(|frame| frame.odometry.heading_rad().rem_euclid(TAU)).collect();
        headings_rad.sort_by(f64::total_cmp);
        let (Some(first), Some(last)) = (headings_rad.first(), headings_rad.last()) else { return false };
        let around = TAU - last + first;
        headings_rad.windows(2).map(|pair| pair[1] - pair[0]).fold(around, f64::max) <= LARGEST_GAP_RAD
    }
}

/// Where the robot is at `odometry` if it was there at a frame.
fn at(frame: &Frame, closure: &Closure, odometry: &PlanarPose) -> PlanarPose {
    closure.at.pose.compose(&frame.odometry.inverse().compose(odometry))
}

/// The guess that most speaks for, of those asked for: the strongest evidence of each heading, over
/// all headings.
fn strongest<'a, 'b>(
    guesses: &'b [Guess<'a>],
    wanted: impl Fn(&Guess<'_>) -> bool,
    settings: &LocalizationSettings,
) -> Option<(&'b Guess<'a>, f64)> {
    let evidence = |guess: &Guess<'_>| {
        let mut sectors = [0.0_f64; SECTORS];
        for other in guesses.iter().filter(|other| agree(guess, other, near(settings))) {
            sectors[other.sector] = sectors[other.sector].max(worth(other.closure, settings));
        }
        sectors.iter().sum::<f64>()
    };
    let scored = guesses.iter().filter(|guess| wanted(guess)).map(|guess| (guess, evidence(guess)));
    scored.reduce(|best, next| if next.1 > best.1 { next } else { best })
}

/// What a view says for itself, in inliers; words alone are as sure as they have to be.
fn worth(closure: &Closure, settings: &LocalizationSettings) -> f64 {
    closure.evidence.unwrap_or(settings.found_evidence)
}

fn near(settings: &LocalizationSettings) -> (f64, f64) {
    (settings.agreement_m, settings.agreement_rad)
}

fn agree(guess: &Guess<'_>, other: &Guess<'_>, within: (f64, f64)) -> bool {
    guess.closure.at.part == other.closure.at.part && is_within(&guess.now, &other.now, within)
}

fn is_within(pose: &PlanarPose, other: &PlanarPose, (metres, radians): (f64, f64)) -> bool {
    let apart = pose.inverse().compose(other);
    apart.x_m().hypot(apart.y_m()) <= metres && apart.heading_rad().abs() <= radians
}

/// The mean of what agrees; views from near, and straight ahead, count for more.
fn fused(guesses: &[Guess<'_>], best: &Guess<'_>, settings: &LocalizationSettings) -> Closure {
    let mut sum = Vector3::zeros();
    let mut weights = 0.0;
    let mut shown = best.closure;
    for guess in guesses.iter().filter(|guess| agree(best, guess, near(settings))) {
        let Closure { covariance, from_view, .. } = guess.closure;
        let turned = from_view.heading_rad() / AHEAD_RAD;
        let weight = worth(guess.closure, settings) / covariance[(0, 0)] / (1.0 + turned * turned);
        let apart = best.now.inverse().compose(&guess.now);
        sum += weight * Vector3::new(apart.x_m(), apart.y_m(), apart.heading_rad());
        weights += weight;
        if worth(guess.closure, settings) > worth(shown, settings) {
            shown = guess.closure;
        }
    }
    let [x_m, y_m, heading_rad] = (sum / weights).into();
    let pose = best.now.compose(&PlanarPose::new(x_m, y_m, heading_rad));
    let covariance = Matrix3::from_diagonal(&Vector3::from(FOUND_SIGMAS.map(|sigma| sigma * sigma)));
    Closure { at: MapPosition { part: shown.at.part, pose }, covariance, ..*shown }
}

#[cfg(test)]
mod tests;
