//! How long the stages of a frame take.

use std::time::Instant;

use fabmap::recognizer::{Stage, StageObserver};
use serde::Serialize;

/// Wall time of the stages of one frame, or their medians over many, in milliseconds; `None` for a stage that was not gone
/// through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct StageTimes {
    /// Decoding the image, features and their descriptors.
    pub extract: Option<f64>,
    /// Descriptors to words.
    pub quantize: Option<f64>,
    /// ln p(Z | L_i) of all places, or the similarity with all frames.
    pub likelihood: Option<f64>,
    /// ln p(Z | L_new).
    pub new_place: Option<f64>,
    /// Prior and posterior.
    pub filter: Option<f64>,
    /// Depths of features, and geometric verification.
    pub verify: Option<f64>,
    /// From the encoded image to the map that has the frame in it.
    pub total: Option<f64>,
}

/// A watch that runs along with one frame: each stage is the time since the one before ended.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameWatch {
    started: Instant,
    stage_began: Instant,
    times: StageTimes,
}

impl StageTimes {
    /// The medians of each stage by itself.
    pub(crate) fn medians(frames: &[Self]) -> Self {
        let median_of = |stage: fn(&Self) -> Option<f64>| median(frames.iter().filter_map(stage).collect());
        Self {
            extract: median_of(|times| times.extract),
            quantize: median_of(|times| times.quantize),
            likelihood: median_of(|times| times.likelihood),
            new_place: median_of(|times| times.new_place),
            filter: median_of(|times| times.filter),
            verify: median_of(|times| times.verify),
            total: median_of(|times| times.total),
        }
    }
}

impl FrameWatch {
    /// The frame's image has been read and its work begins.
    pub(crate) fn start() -> Self {
        let now = Instant::now();
        Self { started: now, stage_began: now, times: StageTimes::default() }
    }

    /// The features have been extracted.
    pub(crate) fn extracted(&mut self) {
        self.times.extract = Some(self.end_stage_ms());
    }

    /// The words have been found.
    pub(crate) fn quantized(&mut self) {
        self.times.quantize = Some(self.end_stage_ms());
    }

    /// The features have their depths: geometry, as the comparisons are.
    pub(crate) fn tracked(&mut self) {
        self.verified();
    }

    fn verified(&mut self) {
        let stage = self.end_stage_ms();
        *self.times.verify.get_or_insert(0.0) += stage;
    }

    /// The frame is decided and on the map.
    pub(crate) fn stop(self) -> StageTimes {
        StageTimes { total: Some(milliseconds(self.started)), ..self.times }
    }

    fn end_stage_ms(&mut self) -> f64 {
        let now = Instant::now();
        let stage = now.duration_since(std::mem::replace(&mut self.stage_began, now));
        stage.as_secs_f64() * 1e3
    }
}

impl StageObserver for FrameWatch {
    fn completed(&mut self, stage: Stage) {
        match stage {
            Stage::Likelihood => self.times.likelihood = Some(self.end_stage_ms()),
            Stage::NewPlace => self.times.new_place = Some(self.end_stage_ms()),
            Stage::Filter => self.times.filter = Some(self.end_stage_ms()),
            Stage::Verification => self.verified(),
        }
    }
}

/// Time since then, in milliseconds.
pub(crate) fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

/// The middle value, or the mean of the two in the middle; `None` of none.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = *values.get(values.len().checked_sub(1)? / 2)?;
    Some((lower + upper) / 2.0)
}

/// The mean; 0 of none.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The smallest value that at least `share` of the values do not exceed; `None` of none.
pub(crate) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.max(1) - 1).copied()
}

/// Root of the mean of the squares; 0 of none.
pub(crate) fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

/// Time that this thread has spent on a processor, in seconds, whatever else the machine does; `None` where the system does
/// not tell.
pub(crate) fn thread_seconds() -> Option<f64> {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: u64 = told.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds as f64 * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_by_hand() {
        assert_eq!(median(vec![]), None);
        assert_eq!(median(vec![4.0]), Some(4.0));
        assert_eq!(median(vec![9.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![9.0, 1.0, 2.0, 4.0]), Some(3.0));
    }

    #[test]
    fn quantiles_by_hand() {
        let values: Vec<f64> = (1..=20).map(f64::from).collect();
        assert_eq!(quantile(values.clone(), 0.95), Some(19.0));
        assert_eq!(quantile(values, 0.951), Some(20.0));
        assert_eq!((quantile(vec![], 0.5), quantile(vec![7.0], 0.0)), (None, Some(7.0)));
    }

    #[test]
    fn stages_are_taken_apart_and_missing_ones_left_out() {
        let frame = |extract, filter| StageTimes { extract: Some(extract), filter, ..StageTimes::default() };
        let medians = StageTimes::medians(&[frame(1.0, None), frame(3.0, Some(7.0)), frame(8.0, None)]);
        assert_eq!((medians.extract, medians.filter, medians.verify), (Some(3.0), Some(7.0), None));
    }

    #[test]
    fn a_watch_fills_the_stages_it_hears_of() {
        let mut watch = FrameWatch::start();
        watch.extracted();
        watch.quantized();
        watch.completed(Stage::Likelihood);
        watch.completed(Stage::Filter);
        let times = watch.stop();
        let stages = [times.extract, times.quantize, times.likelihood, times.filter];
        let sum: f64 = stages.iter().map(|stage| stage.unwrap()).sum();
        assert!(stages.iter().all(|stage| stage.unwrap() >= 0.0) && sum <= times.total.unwrap());
        assert_eq!((times.new_place, times.verify), (None, None));
    }
}
