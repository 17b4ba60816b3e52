//! Every place of one map, looked for on the other.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use fabmap::appearance::PlaceId;
use fabmap::observation::Observation;
use fabmap::place_filter::MotionPrior;
use rayon::prelude::*;

use super::{KnownMap, MergeError, MergeObserver, MergeSettings, PlaceMatch, ViewsBetween};
use crate::evidence::{ArchiveError, Check, ClosureNoise, TwoView};
use crate::ids::FrameId;
use crate::metric::RelativePose;

/// Frames of a place of the target that one of the source is compared with, the latest: as many as
/// a stay teaches, twice.
const MAX_COMPARED_FRAMES: usize = 6;

/// Matches of all places of the source with places of the target, in the order of the source's; of
/// each at most [`MergeSettings::candidates`]. On the calling thread's pool; the same on any number
/// of threads.
///
/// # Errors
/// [`MergeError`] if the vocabularies differ, a frame cannot be read, or the observer ends it.
pub fn find_matches(
    source: KnownMap<'_>,
    target: KnownMap<'_>,
    views: &dyn ViewsBetween,
    settings: &MergeSettings,
    observer: &dyn MergeObserver,
) -> Result<Vec<PlaceMatch>, MergeError> {
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
        let found = matches_of(place, source, target, views, settings)?;
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
fn matches_of(
    place: PlaceId,
    source: KnownMap<'_>,
    target: KnownMap<'_>,
    views: &dyn ViewsBetween,
    settings: &MergeSettings,
) -> Result<Vec<PlaceMatch>, ArchiveError> {
    let frames = &source.mapper.map().places()[place as usize].frames;
    let Some(source_frame) = frames.first().map(|frame| frame.frame) else { return Ok(Vec::new()) };
    let Some(observation) = source.archive.observation(source_frame)? else { return Ok(Vec::new()) };
    let recognizer = target.mapper.recognizer();
    if observation.len() < target.mapper.settings().min_words || recognizer.places() == 0 {
        return Ok(Vec::new());
    }
    let posterior = recognizer.recognize(&observation, &MotionPrior::even()).posterior;
    let at_source = source.archive.at(source_frame)?.unwrap_or_else(RelativePose::none);
    let mut found = Vec::new();
    for (candidate, probability) in posterior.top(settings.candidates) {
        let Some(target_frame) = best_frame(candidate, target, &observation)? else { continue };
        let view = views.compare(source_frame, target_frame)?;
        if !is_enough(view.as_ref(), probability, target, settings) {
            continue;
        }
        let focal_length = views.focal_length_widths(source_frame);
        let at_target = target.archive.at(target_frame)?.unwrap_or_else(RelativePose::none);
        let measured = measured(view.as_ref(), focal_length, target);
        let measured = measured.map(|measured| at_target.then(&measured).then(&at_source.back()));
        let posterior = probability;
        found.push(PlaceMatch {
            source: place,
            target: candidate,
            source_frame,
            target_frame,
            posterior,
            view,
            measured,
        });
    }
    Ok(found)
}

/// Of the frames that a place learnt from, the one that explains an observation best.
fn best_frame(
    place: PlaceId,
    target: KnownMap<'_>,
    observation: &Observation,
) -> Result<Option<FrameId>, ArchiveError> {
    let frames = &target.mapper.map().places()[place as usize].frames;
    let single_looks = target.mapper.recognizer().index().model().single_looks(observation);
    let mut best: Option<(f64, FrameId)> = None;
    for frame in frames.iter().rev().take(MAX_COMPARED_FRAMES) {
        let Some(seen) = target.archive.observation(frame.frame)? else { continue };
        let log_likelihood = single_looks.log_likelihood(&seen);
        if best.is_none_or(|(best, _)| log_likelihood > best) {
            best = Some((log_likelihood, frame.frame));
        }
    }
    Ok(best.map(|(_, frame)| frame))
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
