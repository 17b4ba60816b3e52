//! How the server fared over the last hour, for those who were not there to ask.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often the metrics are looked at, and how many looks are kept.
pub(crate) const EVERY: Duration = Duration::from_secs(15);
const KEPT: usize = 240;

/// Labels that tell things apart that do not add up.
const APART: [&str; 2] = ["stage", "outcome"];

/// A metric, and which of its stages or outcomes; without one, all of its labels together.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct SeriesName {
    pub(crate) metric: String,
    pub(crate) part: Option<String>,
}

/// Values at times; of a metric that was not there yet, 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct HistoryView {
    pub(crate) times_ns: Vec<i64>,
    pub(crate) series: Vec<(SeriesName, Vec<f64>)>,
}

/// When the metrics were looked at, and what they were.
type Look = (i64, BTreeMap<SeriesName, f64>);

/// What the metrics were. Cheap to clone.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    looks: Arc<Mutex<VecDeque<Look>>>,
}

impl History {
    /// Keeps what the metrics, in Prometheus' text format, are at a time.
    pub(crate) fn keep(&self, at_ns: i64, rendered: &str) {
        let mut looks = self.looks();
        looks.push_back((at_ns, sums(rendered)));
        if looks.len() > KEPT {
            looks.pop_front();
        }
    }

    /// The last hour, oldest first.
    pub(crate) fn view(&self) -> HistoryView {
        let looks = self.looks();
        let mut series: BTreeMap<SeriesName, Vec<f64>> = BTreeMap::new();
        for (index, (_, values)) in looks.iter().enumerate() {
            for (name, value) in values {
                let known = series.entry(name.clone()).or_default();
                known.resize(index, 0.0);
                known.push(*value);
            }
        }
        series.values_mut().for_each(|values| values.resize(looks.len(), 0.0));
        HistoryView {
            times_ns: looks.iter().map(|(at_ns, _)| *at_ns).collect(),
            series: series.into_iter().collect(),
        }
    }

    fn looks(&self) -> MutexGuard<'_, VecDeque<Look>> {
        self.looks.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Sums over labels, and over each stage and outcome. Buckets of histograms are left out.
fn sums(rendered: &str) -> BTreeMap<SeriesName, f64> {
    let mut sums = BTreeMap::new();
    for line in rendered.lines().filter(|line| !line.starts_with('#')) {
        let Some((name, value)) = line.rsplit_once(' ') else { continue };
        let (metric, labels) = name.split_once('{').unwrap_or((name, ""));
        let Some(value) = value.parse().ok().filter(|value: &f64| value.is_finite()) else { continue };
        if metric.ends_with("_bucket") {
            continue;
        }
        let part = APART.iter().find_map(|label| {
            let (_, rest) = labels.split_once(&format!("{label}=\""))?;
            Some(rest.split_once('"')?.0.to_owned())
        });
        for part in [None].into_iter().chain(part.map(Some)) {
            *sums.entry(SeriesName { metric: metric.to_owned(), part }).or_default() += value;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series<'a>(view: &'a HistoryView, metric: &str, part: Option<&str>) -> &'a [f64] {
        let wanted =
            |(name, _): &&(SeriesName, Vec<f64>)| name.metric == metric && name.part.as_deref() == part;
        &view.series.iter().find(wanted).unwrap().1
    }

    #[test]
    fn sums_are_over_labels_and_by_stage_and_outcome() {
        let history = History::default();
        history.keep(
            1,
            "# TYPE frames counter\nframes{outcome=\"new_place\"} 2\nframes{outcome=\"resent\"} 3\nmaps 1\n",
        );
        history.keep(2, "frames{outcome=\"resent\"} 4\ntime_bucket{stage=\"total\",le=\"1\"} 9\ntime_sum{stage=\"total\"} 0.5\nmaps NaN\n");
        let view = history.view();
        assert_eq!(view.times_ns, [1, 2]);
        assert_eq!(series(&view, "frames", None), [5.0, 4.0]);
        assert_eq!(series(&view, "frames", Some("resent")), [3.0, 4.0]);
        // Gone, not there yet, and not known.
        assert_eq!(series(&view, "frames", Some("new_place")), [2.0, 0.0]);
        assert_eq!(series(&view, "time_sum", Some("total")), [0.0, 0.5]);
        assert_eq!(series(&view, "maps", None), [1.0, 0.0]);
        assert!(!view.series.iter().any(|(name, _)| name.metric.ends_with("_bucket")));
    }

    #[test]
    fn an_hour_is_kept() {
        let history = History::default();
        for at in 0..KEPT as i64 + 7 {
            history.keep(at, &format!("maps {at}\n"));
        }
        let view = history.view();
        assert_eq!((view.times_ns.len(), view.times_ns[0]), (KEPT, 7));
        assert_eq!(series(&view, "maps", None)[0], 7.0);
        assert_eq!(EVERY * KEPT as u32, Duration::from_secs(3600));
    }
}
