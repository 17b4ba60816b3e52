//! Labels of a sequence: which earlier frames show the same place.

use std::collections::{BTreeMap, BTreeSet};
use std::io;

use serde::{Deserialize, Serialize};

/// Labels of a sequence. Frames are numbered from 0 in the order of their names.
#[derive(Debug, Default)]
pub(crate) struct Truth {
    loops: BTreeMap<u64, BTreeSet<u64>>,
    ignored: BTreeSet<(u64, u64)>,
}

/// What the labels say about a pair of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    Right,
    Wrong,
    /// Counted neither as right nor as wrong.
    Unlabelled,
}

impl Verdict {
    pub(crate) fn words(self) -> &'static str {
        match self {
            Verdict::Right => "right",
            Verdict::Wrong => "wrong",
            Verdict::Unlabelled => "not labelled",
        }
    }
}

/// What is wrong with a file of labels.
#[derive(Debug, thiserror::Error)]
pub(crate) enum TruthError {
    #[error("{0}; write a header `query_index,match_index` and two numbers per row")]
    Row(#[from] csv::Error),
}

#[derive(Deserialize)]
struct Pair {
    query_index: u64,
    match_index: u64,
}

impl Truth {
    /// Reads the true pairs, and those that do not count.
    pub(crate) fn new(loops: impl io::Read, ignored: impl io::Read) -> Result<Self, TruthError> {
        let mut truth = Truth::default();
        for pair in csv::Reader::from_reader(loops).deserialize() {
            let Pair { query_index, match_index } = pair?;
            truth.loops.entry(query_index).or_default().insert(match_index);
        }
        for pair in csv::Reader::from_reader(ignored).deserialize() {
            let Pair { query_index, match_index } = pair?;
            truth.ignored.insert((query_index, match_index));
        }
        Ok(truth)
    }

    pub(crate) fn verdict(&self, query_index: u64, match_index: u64) -> Verdict {
        if self.matches_of(query_index).any(|index| index == match_index) {
            Verdict::Right
        } else if self.ignored.contains(&(query_index, match_index)) {
            Verdict::Unlabelled
        } else {
            Verdict::Wrong
        }
    }

    /// The true matches of a frame.
    pub(crate) fn matches_of(&self, query_index: u64) -> impl Iterator<Item = u64> {
        self.loops.get(&query_index).into_iter().flatten().copied()
    }

    /// Frames that have a true match.
    pub(crate) fn frames_with_loop(&self) -> usize {
        self.loops.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_are_right_wrong_or_not_labelled() {
        let loops = "query_index,match_index\n5,1\n5,2\n6,2\n";
        let truth = Truth::new(loops.as_bytes(), "query_index,match_index\n5,3\n".as_bytes()).unwrap();
        assert_eq!(truth.verdict(5, 2), Verdict::Right);
        assert_eq!(truth.verdict(5, 3), Verdict::Unlabelled);
        assert_eq!(truth.verdict(6, 3), Verdict::Wrong);
        assert_eq!(truth.frames_with_loop(), 2);
        assert_eq!(truth.matches_of(5).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(truth.matches_of(7).count(), 0);
    }

    #[test]
    fn no_labels_to_ignore_is_fine_and_wrong_ones_are_named() {
        assert!(Truth::new("query_index,match_index\n".as_bytes(), io::empty()).is_ok());
        let error = Truth::new("query_index,match_index\n5,x\n".as_bytes(), io::empty()).unwrap_err();
        assert!(error.to_string().contains("line: 2"), "{error}");
    }
}
