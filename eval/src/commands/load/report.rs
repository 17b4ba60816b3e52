//! Figures that every scenario reports.

use std::time::Duration;

use serde::Serialize;

/// How a time is distributed, in milliseconds; percentiles by nearest rank, null of nothing.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct LatencyReport {
    /// Half are at most this.
    pub p50_ms: Option<f64>,
    /// 99 of 100 are at most this.
    pub p99_ms: Option<f64>,
    /// The longest.
    pub max_ms: Option<f64>,
}

/// What the server took while it was under load.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct ServerUse {
    /// Cores kept busy, on average.
    pub cpu_cores: f64,
    /// Memory in RAM at the end, in MiB.
    pub rss_mib: f64,
}

impl LatencyReport {
    pub(super) fn of(times: impl IntoIterator<Item = Duration>) -> Self {
        let mut sorted: Vec<Duration> = times.into_iter().collect();
        sorted.sort_unstable();
        let ms = |time: &Duration| time.as_secs_f64() * 1e3;
        let percentile = |percent: usize| {
            let rank = (sorted.len() * percent).div_ceil(100).max(1);
            sorted.get(rank - 1).map(ms)
        };
        Self { p50_ms: percentile(50), p99_ms: percentile(99), max_ms: percentile(100) }
    }

    /// Whether half of the times, and 99 of 100, are within these, in milliseconds.
    pub(super) fn is_within(&self, [half_ms, most_ms]: [f64; 2]) -> bool {
        self.p50_ms.is_some_and(|ms| ms <= half_ms) && self.p99_ms.is_some_and(|ms| ms <= most_ms)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times_ms: impl IntoIterator<Item = u64>) -> [Option<f64>; 3] {
        let LatencyReport { p50_ms, p99_ms, max_ms } =
            LatencyReport::of(times_ms.into_iter().map(Duration::from_millis));
        [p50_ms, p99_ms, max_ms]
    }

    #[test]
    fn percentiles_by_hand() {
        assert_eq!(of([]), [None; 3]);
        assert_eq!(of([7]), [Some(7.0); 3]);
        assert_eq!(of((1..=100).rev()), [Some(50.0), Some(99.0), Some(100.0)]);
        assert_eq!(of(1..=1000), [Some(500.0), Some(990.0), Some(1000.0)]);
    }
}
