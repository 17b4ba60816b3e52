//! For what reasons frames were decided as they were: counts that add up to the frames.

use std::io::{self, Write};

use serde::Serialize;

/// How many frames were decided for each reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Reasons {
    pub(crate) new_place: usize,
    pub(crate) same_place: usize,
    pub(crate) loop_closure: usize,
    pub(crate) below_threshold: usize,
    pub(crate) geometry_refused: usize,
    pub(crate) too_few_words: usize,
}

impl Reasons {
    /// Of reasons by their names in JSON.
    pub(crate) fn of<'a>(reasons: impl Iterator<Item = &'a str>) -> Self {
        let mut counts = Self::default();
        for reason in reasons {
            match reason {
                "new_place" => counts.new_place += 1,
                "same_place" => counts.same_place += 1,
                "loop_closure" => counts.loop_closure += 1,
                "below_threshold" => counts.below_threshold += 1,
                "geometry_refused" => counts.geometry_refused += 1,
                "too_few_words" => counts.too_few_words += 1,
                // Of a newer server: in no row, so that the sum tells.
                _ => {}
            }
        }
        counts
    }

    /// Each in words, with its count; `recognised` says what a loop closure is called.
    pub(crate) fn rows(self, recognised: &'static str) -> [(&'static str, usize); 6] {
        let Self { new_place, same_place, loop_closure, below_threshold, geometry_refused, too_few_words } =
            self;
        [
            ("somewhere new", new_place),
            ("same place", same_place),
            (recognised, loop_closure),
            ("known place, not sure enough", below_threshold),
            ("known place, refused by geometry", geometry_refused),
            ("too few words", too_few_words),
        ]
    }

    /// A line for each reason; they add up to the frames that were answered.
    pub(crate) fn write(self, recognised: &'static str, out: &mut dyn Write) -> io::Result<()> {
        self.rows(recognised)
            .into_iter()
            .try_for_each(|(what, frames)| writeln!(out, "  {what:<33}{frames:6}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_is_counted_once() {
        let reasons = [
            "new_place",
            "same_place",
            "same_place",
            "loop_closure",
            "below_threshold",
            "geometry_refused",
            "too_few_words",
        ];
        let mut text = Vec::new();
        Reasons::of(reasons.into_iter()).write("loop closures", &mut text).unwrap();
        let text = String::from_utf8(text).unwrap();
        let numbers = text.lines().map(|line| line.rsplit(' ').next().unwrap().parse::<usize>().unwrap());
        assert_eq!(numbers.collect::<Vec<_>>(), [1, 2, 1, 1, 1, 1], "{text}");
    }
}
