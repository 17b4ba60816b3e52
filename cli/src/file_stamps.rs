//! Times written as decimal numbers: in tables of images, and in the names of images.

use std::num::ParseIntError;

const NANOSECONDS_PER_SECOND: i64 = 1_000_000_000;

/// Digits before the point of seconds since 1970, from 1973 on: fewer may count something else.
const DIGITS_OF_EPOCH_SECONDS: usize = 9;

/// Decimal seconds as nanoseconds, exactly: an f64 has too few digits for seconds since 1970. Digits beyond the ninth
/// after the point are cut off.
pub(crate) fn nanoseconds(seconds: &str) -> Option<i64> {
    let (sign, digits) = match seconds.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, seconds),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if whole.is_empty() || !all_digits(whole) || !all_digits(fraction) {
        return None;
    }
    let nine_digits: String = fraction.chars().chain("000000000".chars()).take(9).collect();
    let parsed: Result<(i64, i64), ParseIntError> =
        whole.parse().and_then(|whole| Ok((whole, nine_digits.parse()?)));
    let (whole, fraction) = parsed.ok()?;
    whole.checked_mul(NANOSECONDS_PER_SECOND)?.checked_add(fraction)?.checked_mul(sign)
}

/// Seconds that may have an exponent, as printf's %e writes them.
pub(crate) fn nanoseconds_with_exponent(seconds: &str) -> Option<i64> {
    if let Some(exact) = nanoseconds(seconds) {
        return Some(exact);
    }
    let seconds: f64 = seconds.parse().ok()?;
    let nanoseconds = (seconds * NANOSECONDS_PER_SECOND as f64).round();
    (nanoseconds.abs() < i64::MAX as f64).then_some(nanoseconds as i64)
}

/// The stamps that file names end with, in their order; none unless all names have one, and no two the same.
///
/// A name ends with a stamp if it is seconds with a point and at least nine digits before it, or with as many digits
/// after it as all others have, or else milliseconds, microseconds or nanoseconds since 1970: 13, 16 or 19 digits.
pub(crate) fn stamps_of(names: &[&str]) -> Option<Vec<i64>> {
    let stems: Vec<&str> =
        names.iter().map(|name| name.rsplit_once('.').map_or(*name, |split| split.0)).collect();
    let numbers: Vec<(&str, &str)> = stems.iter().map(|stem| last_number(stem)).collect::<Option<_>>()?;
    let (first_before, first) = numbers.first()?;
    if numbers.iter().any(|(before, _)| before != first_before) {
        return None;
    }
    let fraction_digits = |number: &str| number.split_once('.').map(|(_, fraction)| fraction.len());
    let first_digits = fraction_digits(first);
    let is_even = numbers.iter().all(|(_, number)| fraction_digits(number) == first_digits);
    let stamps: Vec<i64> =
        numbers.iter().map(|(_, number)| stamp(number, is_even)).collect::<Option<Vec<_>>>()?;
    let mut sorted = stamps.clone();
    sorted.sort_unstable();
    sorted.windows(2).all(|pair| pair[0] < pair[1]).then_some(stamps)
}

/// The number that a stem ends with, behind what is before it.
fn last_number(stem: &str) -> Option<(&str, &str)> {
    let is_digit = |byte: u8| byte.is_ascii_digit();
    let digits = |text: &str| text.bytes().rev().take_while(|byte| is_digit(*byte)).count();
    let last = digits(stem);
    let (before, number) = stem.split_at(stem.len() - last);
    if number.is_empty() {
        return None;
    }
    match before.strip_suffix('.').map(|whole| (whole, digits(whole))) {
        Some((whole, digits)) if digits > 0 => Some(stem.split_at(whole.len() - digits)),
        Some(_) | None => Some((before, number)),
    }
}

/// `is_even` where all numbers have as many digits after the point: then as decimals they come in the order that they
/// have as text, and it cannot be chapters and sections.
fn stamp(number: &str, is_even: bool) -> Option<i64> {
    match number.split_once('.') {
        Some((whole, fraction)) => {
            let is_epoch = whole.len() >= DIGITS_OF_EPOCH_SECONDS && !whole.starts_with('0');
            (is_epoch || is_even && fraction.len() >= 3).then(|| nanoseconds(number)).flatten()
        }
        None if number.starts_with('0') => None,
        None => {
            let unit_ns = match number.len() {
                13 => 1_000_000,
                16 => 1_000,
                19 => 1,
                _ => return None,
            };
            number.parse::<i64>().ok()?.checked_mul(unit_ns)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_keep_their_nanoseconds() {
        for (text, exact) in [
            ("1403636579.763555527", Some(1_403_636_579_763_555_527)),
            ("1.5", Some(1_500_000_000)),
            ("-0.25", Some(-250_000_000)),
            ("1e3", None),
            ("", None),
            (".5", None),
        ] {
            assert_eq!(nanoseconds(text), exact, "{text}");
        }
        assert_eq!(nanoseconds_with_exponent("1.036224e-01"), Some(103_622_400));
        assert_eq!(nanoseconds_with_exponent("0.000000e+00"), Some(0));
        assert_eq!(nanoseconds_with_exponent("one"), None);
    }

    #[test]
    fn names_that_end_with_times_have_stamps() {
        let of = |names: &[&str]| stamps_of(names);
        assert_eq!(
            of(&["1305031102.9.png", "1305031102.175304.png"]),
            Some(vec![1_305_031_102_900_000_000, 1_305_031_102_175_304_000])
        );
        assert_eq!(of(&["left-0.125.png", "left-2.250.png"]), Some(vec![125_000_000, 2_250_000_000]));
        assert_eq!(of(&["1403636579763555584.png"]), Some(vec![1_403_636_579_763_555_584]));
        assert_eq!(of(&["cam_1403636579763.jpg"]), Some(vec![1_403_636_579_763_000_000]));
    }

    #[test]
    fn names_that_count_have_none() {
        for names in [
            &["000147.jpg", "000148.jpg"][..],
            &["0000000000.png", "0000000001.png"],
            &["frame1.jpg", "frame2.jpg"],
            // Of a chapter: 1.2 is before 1.10.
            &["1.2.png", "1.10.png"],
            &["a.jpg", "1305031102.175304.jpg"],
            &["left-1305031102.1.png", "right-1305031102.2.png"],
            // Two of one time.
            &["1305031102.1.png", "1305031102.10.png"],
            &[],
        ] {
            assert_eq!(stamps_of(names), None, "{names:?}");
        }
    }
}
