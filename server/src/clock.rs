//! What time it is, and how times are written.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Nanoseconds of a second.
pub(crate) const SECOND_NS: i64 = 1_000_000_000;

/// Now, in nanoseconds since 1970.
pub(crate) fn now_ns() -> i64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX)
}

/// `seconds` after a time, in nanoseconds since 1970.
pub(crate) fn after_ns(time_ns: i64, seconds: u32) -> i64 {
    time_ns.saturating_add(i64::from(seconds).saturating_mul(SECOND_NS))
}

/// A time in nanoseconds since 1970 for people, as in `2026-02-28T13:05:09Z`.
pub(crate) fn in_words(time_ns: i64) -> String {
    let since_1970 = Duration::from_nanos(u64::try_from(time_ns).unwrap_or_default());
    humantime::format_rfc3339_seconds(UNIX_EPOCH + since_1970).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_dates() {
        assert_eq!(in_words(1_772_283_909 * SECOND_NS + 1), "2026-02-28T13:05:09Z");
        assert_eq!((in_words(0), in_words(-1)), ("1970-01-01T00:00:00Z".to_owned(), in_words(0)));
        assert_eq!(in_words(i64::MAX), "2262-04-11T23:47:16Z");
        assert_eq!(after_ns(i64::MAX - 1, 7), i64::MAX);
        assert_eq!(after_ns(5, 2), 2 * SECOND_NS + 5);
    }
}
