//! Every place of one map, looked for on the other.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use fabmap::appearance::PlaceId;
use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use rayon::prelude::*;

use super::{KnownMap, MergeError, MergeObserver, MergeSettings, PairComparison, PlaceMatch, PlacePair};
use crate::evidence::{Check, ClosureNoise, TwoView};
use crate::ids::FrameId;
use crate::metric::RelativePose;

/// Frames of a place of the target that one of the source is compared with, the latest: as many as
/// a stay teaches, twice.
const MAX_COMPARED_FRAMES: usize = 6;

/// Pairs of places whose frames are to be compared, in the order of the source's places; of each at
/// most [`MergeSettings::candidates`], the most probable first. On the calling thread's pool; the
/// same on any number of threads.
///
/// # Errors
/// [`MergeError`] if a setting is out of range, the vocabularies differ, or the observer ends it.
pub fn pairs_to_compare(
    source: KnownMap<'_>,
    target: KnownMap<'_>,
    settings: &MergeSettings,
    observer: &dyn MergeObserver,
) -> Result<Vec<PlacePair>, MergeError> {
    settings.check()?;
    let words = |map: KnownMap<'_>| map.mapper.vocabulary_len();
    if words(source) != words(target) {
        return Err(MergeError::Vocabulary { source_words: words(source), target_words: words(target) });
    }
    let done = AtomicUsize::new(0);
    let ended = AtomicBool::new(false);
    let of_place = |place: PlaceId| {
        if ended.load(Ordering::Relaxed) {
            return Err(MergeError::Ended);
        }
        let found = pairs_of(place, source, target, settings);
        if !observer.goes_on(done.fetch_add(1, Ordering::Relaxed) + 1) {
            ended.store(true, Ordering::Relaxed);
        }
        Ok(found)
    };
    let places = source.mapper.map().places().len() as PlaceId;
    let found = (0..places).into_par_iter().map(of_place).collect::<Result<Vec<_>, MergeError>>()?;
    Ok(found.into_iter().flatten().collect())
}

/// One place, as it was first seen: there its frame is.
fn pairs_of(
    place: PlaceId,
    source: KnownMap<'_>,
    target: KnownMap<'_>,
    settings: &MergeSettings,
) -> Vec<PlacePair> {
    let frames = &source.mapper.map().places()[place as usize].frames;
    let Some(seen) = frames.first().and_then(|frame| source.frame(frame.frame)) else { return Vec::new() };
    let observation = &seen.observation;
    let recognizer = target.mapper.recognizer();
    if observation.len() < target.mapper.settings().min_words || recognizer.places() == 0 {
        return Vec::new();
    }
    let posterior = recognizer.recognize(observation, &MotionPrior::even()).posterior;
    let pair = |(candidate, posterior)| {
        let target_frame = best_frame(candidate, target, observation)?;
        Some(PlacePair {
            source: place,
            target: candidate,
            source_frame: seen.frame,
            target_frame,
            posterior,
        })
    };
    posterior.top(settings.candidates).into_iter().filter_map(pair).collect()
}

/// Of the frames that a place learnt from, the one that explains an observation best.
fn best_frame(place: PlaceId, target: KnownMap<'_>, observation: &Observation) -> Option<FrameId> {
    let frames = &target.mapper.map().places()[place as usize].frames;
    let single_looks = target.mapper.recognizer().index().model().single_looks(observation);
    let mut best: Option<(f64, FrameId)> = None;
    for frame in frames.iter().rev().take(MAX_COMPARED_FRAMES) {
        let Some(seen) = target.frame(frame.frame) else { continue };
        let log_likelihood = single_looks.log_likelihood(&seen.observation);
        if best.is_none_or(|(best, _)| log_likelihood > best) {
            best = Some((log_likelihood, frame.frame));
        }
    }
    best.map(|(_, frame)| frame)
}

/// The pairs that match by what was compared: a comparison for each pair, in their order.
#[must_use]
pub fn find_matches(
    source: KnownMap<'_>,
    target: KnownMap<'_>,
    pairs: &[PlacePair],
    comparisons: &[PairComparison],
    settings: &MergeSettings,
) -> Vec<PlaceMatch> {
    let at = |map: KnownMap<'_>, frame| {
        map.frame(frame).and_then(|event| event.at).unwrap_or_else(RelativePose::none)
    };
    let compared = pairs.iter().zip(comparisons);
    let enough = compared
        .filter(|(pair, compared)| is_enough(compared.view.as_ref(), pair.posterior, target, settings));
    let matched = |(pair, compared): (&PlacePair, &PairComparison)| {
        let &PlacePair { source: place, target: candidate, source_frame, target_frame, posterior } = pair;
        let measured = measured(compared.view.as_ref(), compared.focal_length_widths, target);
        let in_places = |measured: RelativePose| {
            at(target, target_frame).then(&measured).then(&at(source, source_frame).back())
        };
        PlaceMatch {
            source: place,
            target: candidate,
            source_frame,
            target_frame,
            posterior,
            view: compared.view,
            measured: measured.map(in_places),
        }
    };
    enough.map(matched).collect()
}

/// Whether a match has enough for it to be looked at with the others. Without keypoints words have
/// to be sure.
fn is_enough(view: Option<&TwoView>, posterior: f64, target: KnownMap<'_>, settings: &MergeSettings) -> bool {
    let verification = &target.mapper.settings().verification;
    match view {
        Some(view) => {
            let one_scene = verification.of_one_scene(view).iter().all(Check::passed);
            one_scene && view.evidence() >= settings.min_evidence
        }
        None => posterior >= target.mapper.settings().closure_threshold,
    }
}

/// Where the robot was at the source's frame, seen from where it was at the target's.
fn measured(
    view: Option<&TwoView>,
    focal_length_widths: Option<f64>,
    target: KnownMap<'_>,
) -> Option<RelativePose> {
    let noise = ClosureNoise::of_spacing(target.mapper.settings().place_spacing.distance_m);
    match view {
        Some(view) => noise.measure(view, focal_length_widths),
        None => Some(noise.somewhere()),
    }
}
