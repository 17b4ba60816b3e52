//! Whole panoramas as a compass on a route that a real robot was taught and drove again.

mod recording;

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use waypost_sim::pose::wrapped;
use waypost_vision::panorama::compass::{CompassReading, CompassView, SizesDiffer};

use super::AppearanceError;
use crate::error::EvalError;

use self::recording::{Drive, Repeat};

/// Frames of the taught route that are held against each other are so many apart.
const GAPS: [usize; 4] = [4, 8, 15, 30];

/// The gap by which the clock's offset is fitted.
const FITTED_GAP: usize = 15;

/// A match so many taught frames before the last one is a step back.
const STEP_BACK: usize = 5;

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompassFigures {
    /// Frames of the taught route.
    pub taught: usize,
    /// By what its track's clock is ahead of the camera's, fitted, in seconds.
    pub clock_offset_s: f64,
    /// Turns between frames of the taught route.
    pub turns: Vec<TurnFigures>,
    /// The route driven again.
    pub repeats: Vec<RepeatFigures>,
}

/// Turns between frames so far apart, against those of the track.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TurnFigures {
    /// Frames from the one to the other.
    pub frames_apart: usize,
    /// Pairs of which the track tells the turn.
    pub pairs: usize,
    /// Of the compass, in radians.
    pub error: Sizes,
    /// Of the track's turns, in radians: a compass that always says "not turned" is wrong by that.
    pub turned: Sizes,
}

/// A drive along the taught route.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RepeatFigures {
    /// Its folder.
    pub name: String,
    /// Its frames.
    pub frames: usize,
    /// Those that match the taught route more than five frames before the last one.
    pub steps_back: usize,
    /// Correlation with the most similar taught frame.
    pub correlation_median: f64,
    /// Of the rotation against the heading that the recording's own compass chose, in radians.
    pub against_recorded: Sizes,
    /// By what its track's clock is ahead of the camera's, fitted, in seconds.
    pub clock_offset_s: f64,
    /// Frames of which both tracks tell the position.
    pub located: usize,
    /// From there to where the most similar taught frame was taken, in the tracks' unit.
    pub distance: Sizes,
    /// From there to the taught track: no choice of a frame comes nearer.
    pub beside_route: Sizes,
    /// Frames of which both tracks tell the course.
    pub oriented: usize,
    /// Of the rotation against the difference of the courses, in radians.
    pub against_tracks: Sizes,
}

/// Of what is told without its sign.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sizes {
    /// As many are larger as smaller.
    pub median: f64,
    /// A tenth is larger.
    pub p90: f64,
}

/// The most similar frame of the taught route.
struct Match {
    taught: usize,
    reading: CompassReading,
}

/// Reads the recordings, and measures the compass on them.
///
/// # Errors
/// [`EvalError`] if the folder is not as it was published.
pub fn measure(folder: &Path) -> Result<CompassFigures, EvalError> {
    let taught = Drive::taught(folder)?;
    let fitted = rotations(&taught, FITTED_GAP).map_err(AppearanceError::Sizes)?;
    let clock_offset_s = best_offset_s(|offset_s| turns(&taught, FITTED_GAP, &fitted, offset_s).error.median);
    let of_gap = |gap: usize| {
        let rotations = rotations(&taught, gap).map_err(AppearanceError::Sizes)?;
        Ok(turns(&taught, gap, &rotations, clock_offset_s))
    };
    let turns = GAPS.into_iter().map(of_gap).collect::<Result<_, EvalError>>()?;
    let repeats = Repeat::all(folder)?;
    let repeats = repeats.iter().map(|repeat| repeated(repeat, &taught, clock_offset_s));
    let repeats = repeats.collect::<Result<_, SizesDiffer>>().map_err(AppearanceError::Sizes)?;
    Ok(CompassFigures { taught: taught.views.len(), clock_offset_s, turns, repeats })
}

/// From every frame to the one that comes so many later.
fn rotations(drive: &Drive, gap: usize) -> Result<Vec<f64>, SizesDiffer> {
    let pairs = drive.views.iter().zip(drive.views.iter().skip(gap));
    pairs.map(|(current, target)| Ok(current.read(target)?.rotation_rad)).collect()
}

fn turns(drive: &Drive, gap: usize, rotations: &[f64], offset_s: f64) -> TurnFigures {
    let course = |frame: usize| drive.track.course_rad(drive.times_s[frame] + offset_s);
    let known = rotations.iter().enumerate().filter_map(|(frame, rotation)| {
        let turned = wrapped(course(frame + gap)? - course(frame)?);
        Some((wrapped(rotation - turned), turned))
    });
    let (errors, turned): (Vec<f64>, Vec<f64>) = known.unzip();
    TurnFigures {
        frames_apart: gap,
        pairs: errors.len(),
        error: Sizes::of(errors),
        turned: Sizes::of(turned),
    }
}

fn repeated(repeat: &Repeat, taught: &Drive, taught_offset_s: f64) -> Result<RepeatFigures, SizesDiffer> {
    let Repeat { name, drive, headings_rad } = repeat;
    let matches = drive.views.par_iter().map(|view| most_similar(view, &taught.views));
    let matches: Vec<Match> = matches.collect::<Result<_, _>>()?;
    let taught_s = |found: &Match| taught.times_s[found.taught] + taught_offset_s;
    let frames = || drive.times_s.iter().zip(&matches);
    let distances = |offset_s: f64| -> Vec<[f64; 2]> {
        let known = frames().filter_map(|(time_s, found)| {
            let here = drive.track.position(time_s + offset_s)?;
            let there = taught.track.position(taught_s(found))?;
            Some([(here - there).norm(), taught.track.distance(here)])
        });
        known.collect()
    };
    let distance = |offset_s: f64| Sizes::of(distances(offset_s).iter().map(|known| known[0]));
    let clock_offset_s = best_offset_s(|offset_s| {
        // A clock that leaves most frames without a position explains little.
        if 3 * distances(offset_s).len() < drive.views.len() {
            f64::INFINITY
        } else {
            distance(offset_s).median
        }
    });
    let against_tracks = frames().filter_map(|(time_s, found)| {
        let here = drive.track.course_rad(time_s + clock_offset_s)?;
        let there = taught.track.course_rad(taught_s(found))?;
        Some(wrapped(found.reading.rotation_rad - (there - here)))
    });
    let against_tracks: Vec<f64> = against_tracks.collect();
    let against_recorded = matches
        .iter()
        .zip(headings_rad)
        .map(|(found, heading)| wrapped(found.reading.rotation_rad - heading));
    let located = distances(clock_offset_s);
    Ok(RepeatFigures {
        name: name.clone(),
        frames: matches.len(),
        steps_back: matches.windows(2).filter(|pair| pair[1].taught + STEP_BACK < pair[0].taught).count(),
        correlation_median: Sizes::of(matches.iter().map(|found| found.reading.correlation)).median,
        against_recorded: Sizes::of(against_recorded),
        clock_offset_s,
        located: located.len(),
        distance: distance(clock_offset_s),
        beside_route: Sizes::of(located.iter().map(|known| known[1])),
        oriented: against_tracks.len(),
        against_tracks: Sizes::of(against_tracks),
    })
}

fn most_similar(view: &CompassView, taught: &[CompassView]) -> Result<Match, SizesDiffer> {
    let mut best: Option<Match> = None;
    for (index, target) in taught.iter().enumerate() {
        let reading = view.read(target)?;
        if best.as_ref().is_none_or(|best| reading.correlation > best.reading.correlation) {
            best = Some(Match { taught: index, reading });
        }
    }
    Ok(best.unwrap_or(Match { taught: 0, reading: view.read(view)? }))
}

/// The offset of a clock, within ten seconds, at which a cost is least.
fn best_offset_s(cost: impl Fn(f64) -> f64) -> f64 {
    let offsets = (-40..=40).map(|quarter| 0.25 * f64::from(quarter));
    offsets.min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(0.0)
}

impl Sizes {
    /// NaN of nothing.
    fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut sizes: Vec<f64> = values.into_iter().map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        let at = |share: f64| sizes.get((share * sizes.len() as f64) as usize).copied().unwrap_or(f64::NAN);
        Self { median: at(0.5), p90: at(0.9) }
    }
}
