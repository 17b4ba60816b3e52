//! What time it is, and how times are written.

use std::time::{SystemTime, UNIX_EPOCH};

/// Nanoseconds of a second.
pub(crate) const SECOND_NS: i64 = 1_000_000_000;

const DAY_S: i64 = 24 * 60 * 60;

/// Now, in nanoseconds since 1970.
pub(crate) fn now_ns() -> i64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX)
}

/// `seconds` after a time, in nanoseconds since 1970.
pub(crate) fn after_ns(time_ns: i64, seconds: u32) -> i64 {
    time_ns.saturating_add(i64::from(seconds).saturating_mul(SECOND_NS))
}

/// A time in nanoseconds since 1970 for people, as in `2026-02-28 13:05:09 UTC`.
pub(crate) fn in_words(time_ns: i64) -> String {
    let seconds = time_ns.div_euclid(SECOND_NS);
    let (year, month, day) = date(seconds.div_euclid(DAY_S));
    let of_day = seconds.rem_euclid(DAY_S);
    format!("{year}-{month:02}-{day:02} {:02}:{:02}:{:02} UTC", of_day / 3600, of_day / 60 % 60, of_day % 60)
}

/// Year, month and day of a day since 1970: H. Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`.
/// Years begin in March there, so that the leap day is the last.
fn date(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_dates() {
        for (seconds, written) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (-1, "1969-12-31 23:59:59 UTC"),
            (951_782_400, "2000-02-29 00:00:00 UTC"),
            (1_772_283_909, "2026-02-28 13:05:09 UTC"),
            (4_107_542_399, "2100-02-28 23:59:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
        ] {
            assert_eq!(in_words(seconds * SECOND_NS), written);
        }
        assert_eq!(after_ns(i64::MAX - 1, 7), i64::MAX);
        assert_eq!(after_ns(5, 2), 2 * SECOND_NS + 5);
    }
}
