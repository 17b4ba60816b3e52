//! What goes to stdout: text for people, or one JSON object for scripts.

use std::fmt::Display;
use std::io::{self, Write};

use serde::Serialize;

use crate::failure::Failure;

/// For whom the command writes.
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

    /// Something that happened on the way; scripts do not get it.
    pub(crate) fn line(self, text: impl Display) -> Result<(), Failure> {
        match self {
            Output::Text => writeln!(io::stdout().lock(), "{text}").map_err(Failure::Stdout),
            Output::Json => Ok(()),
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let mut out = Vec::new();
        let rows = [["a".to_owned(), "1".to_owned()], ["longer".to_owned(), "22".to_owned()]];
        table(&mut out, ["NAME", "N"], rows).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "NAME    N\na       1\nlonger  22\n");
    }
}
