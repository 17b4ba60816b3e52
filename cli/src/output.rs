//! What goes to stdout: text for people, or one JSON object for scripts.

use std::fmt::Display;
use std::io::{self, Write};
use std::time::{Duration, UNIX_EPOCH};

use serde::Serialize;
use serde_json::Value;

use crate::failure::Failure;

const DEGREES: &str = " degrees";
/// Endings of the names of fields, and the units that they stand for.
const UNITS: [(&str, &str); 4] =
    [("_m", " m"), ("_rad", DEGREES), ("_frames", " frames"), ("_bytes", " bytes")];

/// What the command writes: text for people, or JSON for scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Output {
    Text,
    Json,
}

impl Output {
    /// The result of a command: `object` for scripts, or what `text` writes for people.
    pub(crate) fn result(
        self,
        object: &impl Serialize,
        text: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), Failure> {
        let mut stdout = io::stdout().lock();
        let written = match self {
            Output::Text => text(&mut stdout),
            Output::Json => serde_json::to_writer(&mut stdout, object)
                .map_err(io::Error::from)
                .and_then(|()| writeln!(stdout)),
        };
        written.and_then(|()| stdout.flush()).map_err(Failure::Stdout)
    }

    /// A line about progress, for people only.
    pub(crate) fn line(self, text: impl Display) -> Result<(), Failure> {
        match self {
            Output::Text => writeln!(io::stdout().lock(), "{text}").map_err(Failure::Stdout),
            Output::Json => Ok(()),
        }
    }
}

/// Writes a line for each field of a message, by its name; `absent` stands for a missing value.
/// Nothing for a message that is itself missing.
pub(crate) fn fields(out: &mut dyn Write, message: &impl Serialize, absent: &str) -> io::Result<()> {
    let Value::Object(fields) = serde_json::to_value(message)? else { return Ok(()) };
    for (name, value) in fields {
        let (name, unit) = UNITS.iter().fold((name.as_str(), ""), |(name, unit), (suffix, of_suffix)| {
            name.strip_suffix(suffix).map_or((name, unit), |name| (name, of_suffix))
        });
        let value = match value {
            Value::Null => absent.to_owned(),
            Value::String(text) => text,
            Value::Number(angle) if unit == DEGREES => {
                format!("{:.1}{unit}", angle.as_f64().unwrap_or(f64::NAN).to_degrees())
            }
            // A mean: nobody wants parts of a byte.
            Value::Number(bytes) if name.starts_with("bytes_per_") => {
                format!("{:.0}{unit}", bytes.as_f64().unwrap_or(f64::NAN))
            }
            other => format!("{other}{unit}"),
        };
        writeln!(out, "  {:<20} {value}", name.replace('_', " "))?;
    }
    Ok(())
}

/// Writes rows under their headings, in columns as wide as they need.
pub(crate) fn table<const COLUMNS: usize>(
    out: &mut dyn Write,
    headings: [&str; COLUMNS],
    rows: impl IntoIterator<Item = [String; COLUMNS]>,
) -> io::Result<()> {
    let lines: Vec<[String; COLUMNS]> = std::iter::once(headings.map(str::to_owned)).chain(rows).collect();
    let mut widths = [0; COLUMNS];
    for line in &lines {
        for (width, cell) in widths.iter_mut().zip(line) {
            *width = cell.chars().count().max(*width);
        }
    }
    for line in lines {
        let cells: Vec<String> =
            line.iter().zip(widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
        writeln!(out, "{}", cells.join("  ").trim_end())?;
    }
    Ok(())
}

/// A time of the server, as in `2026-02-28T13:05:09Z`.
pub(crate) fn in_words(time_ns: i64) -> String {
    let since_1970 = Duration::from_nanos(u64::try_from(time_ns).unwrap_or_default());
    humantime::format_rfc3339_seconds(UNIX_EPOCH + since_1970).to_string()
}

/// A number with so many decimals, without a minus before a zero.
pub(crate) fn rounded(value: f64, decimals: u8) -> String {
    let steps = 10_f64.powi(decimals.into());
    format!("{:.*}", usize::from(decimals), (value * steps).round() / steps + 0.0)
}

pub(crate) fn mebibytes(size_bytes: u64) -> String {
    format!("{:.1} MiB", size_bytes as f64 / f64::from(1 << 20))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_have_their_names_and_units() {
        let mut out = Vec::new();
        let message = serde_json::json!({ "spacing_rad": 0.5, "log_bytes": 7, "bytes_per_frame": 8.51, "keep": "words", "rate": null });
        fields(&mut out, &message, "the model's").unwrap();
        let lines = [
            "  spacing              28.6 degrees",
            "  log                  7 bytes",
            "  bytes per frame      9",
            "  keep                 words",
            "  rate                 the model's",
        ];
        let mut found: Vec<&str> = std::str::from_utf8(&out).unwrap().lines().collect();
        found.sort_unstable();
        let mut expected = lines.to_vec();
        expected.sort_unstable();
        assert_eq!(found, expected);
    }

    #[test]
    fn zeros_have_no_minus() {
        assert_eq!([rounded(-0.004, 2), rounded(-0.006, 2), rounded(7.25, 1)], ["0.00", "-0.01", "7.3"]);
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let mut out = Vec::new();
        let rows = [["a".to_owned(), "1".to_owned()], ["longer".to_owned(), "22".to_owned()]];
        table(&mut out, ["NAME", "N"], rows).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "NAME    N\na       1\nlonger  22\n");
    }
}
