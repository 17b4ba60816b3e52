//! Flags for command lines: the contract's enums as their values, `MapSettings` and `Quotas` as a flag a field.

include!(concat!(env!("OUT_DIR"), "/flags.rs"));

/// A length of time on a command line in whole seconds, of numbers and units as in `90s`, `12h` or `30d`.
///
/// # Errors
/// If it is no such time, has a fraction of a second, or is longer than 136 years; the message says how to write it.
pub fn seconds(text: &str) -> Result<u32, String> {
    let wrong = |why: &dyn std::fmt::Display| {
        format!("{why}; write a whole number and its unit, as in 90s, 12h or 30d")
    };
    let time = humantime::parse_duration(text).map_err(|error| wrong(&error))?;
    match (u32::try_from(time.as_secs()), time.subsec_nanos()) {
        (Ok(seconds), 0) => Ok(seconds),
        (Ok(_), _) => Err(wrong(&"this has a fraction of a second")),
        (Err(_), _) => Err(wrong(&"this is more than 136 years")),
    }
}

#[cfg(test)]
mod tests {
    use super::seconds;

    #[test]
    fn times_are_numbers_and_units() {
        for (text, expected) in
            [("0s", 0), ("90s", 90), ("45m", 2700), ("12h", 43_200), ("30d", 2_592_000), ("1h 30m", 5400)]
        {
            assert_eq!(seconds(text), Ok(expected), "{text}");
        }
        for bad in
            ["", "30", "d", "1.5", "-1d", "5ä", "500ms", "4294967296s", "50000d", "99999999999999999999s"]
        {
            let said = seconds(bad);
            assert!(
                said.as_ref().is_err_and(|said| said.contains("as in 90s, 12h or 30d")),
                "{bad}: {said:?}"
            );
        }
    }
}
