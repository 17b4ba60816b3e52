//! Reads the files that the numpy generator writes.
//!
//! `places.bin`, `train.bin`, `queries.bin`: 32-bit little-endian numbers: "BOW1", words of the
//! vocabulary, images; then per image its number of words and those, ascending. `truth.txt`: a line per query,
//! the place or -1. `tree.txt`: a line per word, `parent p(q) p(q|parent) p(q|no parent)`.

use std::path::Path;

use anyhow::{Result, anyhow};
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::observation::{Observation, WordId};

/// A workload as the generator wrote it.
#[derive(Clone, Debug)]
pub(crate) struct WorkloadFiles {
    /// The tree that all images were drawn from.
    pub tree: ChowLiuTree,
    /// The places of the map, one look each.
    pub places: Vec<Observation>,
    /// The training images.
    pub training: Vec<Observation>,
    /// The queries.
    pub queries: Vec<Query>,
}

/// An observation and where it was made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Query {
    /// The place visited; `None` for a new one.
    pub place: Option<u32>,
    /// What was seen.
    pub observation: Observation,
}

const MAGIC: u32 = u32::from_le_bytes(*b"BOW1");

impl WorkloadFiles {
    /// Reads a folder.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let tree: ChowLiuTree = parse(&folder.join("tree.txt"), |bytes| tree(text(bytes)?))?;
        let read = |name: &str| parse(&folder.join(name), |bytes| images(bytes, tree.len()));
        let places = read("places.bin")?;
        let training = read("train.bin")?;
        let queries = read("queries.bin")?;
        let truth =
            parse(&folder.join("truth.txt"), |bytes| truth(text(bytes)?, queries.len(), places.len()))?;
        let queries = truth.into_iter().zip(queries);
        let queries = queries.map(|(place, observation)| Query { place, observation }).collect();
        Ok(Self { tree, places, training, queries })
    }
}

fn parse<T>(path: &Path, parse: impl FnOnce(&[u8]) -> Result<T, String>) -> Result<T> {
    let bytes = std::fs::read(path).map_err(|reason| {
        let path = path.display();
        anyhow!("{path} cannot be read ({reason}); give the folder that the generator wrote with --out")
    })?;
    parse(&bytes).map_err(|problem| anyhow!("{}: {problem}; generate the workload anew", path.display()))
}

fn text(bytes: &[u8]) -> Result<&str, String> {
    std::str::from_utf8(bytes).map_err(|error| error.to_string())
}

fn images(bytes: &[u8], vocabulary_len: usize) -> Result<Vec<Observation>, String> {
    let (numbers, rest) = bytes.as_chunks::<4>();
    if !rest.is_empty() {
        return Err("it is cut within a number".to_owned());
    }
    let mut numbers = numbers.iter().map(|number| u32::from_le_bytes(*number));
    let mut next = || numbers.next().ok_or("it ends too early");
    if next()? != MAGIC {
        return Err("it does not begin with BOW1".to_owned());
    }
    let words = next()?;
    if words as usize != vocabulary_len {
        return Err(format!("it is of {words} words, the tree of {vocabulary_len}"));
    }
    let count = next()?;
    let mut images = Vec::new();
    for _ in 0..count {
        let len = next()?;
        let words = (0..len).map(|_| next()).collect::<Result<Vec<u32>, _>>()?;
        images.push(Observation::from_words(words, vocabulary_len).map_err(|error| error.to_string())?);
    }
    match next() {
        Ok(_) => Err("there is more than its images".to_owned()),
        Err(_) => Ok(images),
    }
}

fn tree(text: &str) -> Result<ChowLiuTree, String> {
    let row = |line: &str| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let &[parent, marginal, seen, unseen] = &fields[..] else { return None };
        Some(WordDependence {
            parent: WordId::new(parent.parse().ok()?),
            marginal: marginal.parse().ok()?,
            given_parent_seen: seen.parse().ok()?,
            given_parent_unseen: unseen.parse().ok()?,
        })
    };
    let rows = (1..).zip(text.lines()).map(|(number, line)| {
        row(line).ok_or_else(|| format!("line {number} is not a parent and three probabilities"))
    });
    ChowLiuTree::from_rows(rows.collect::<Result<Vec<_>, _>>()?).map_err(|error| error.to_string())
}

fn truth(text: &str, queries: usize, places: usize) -> Result<Vec<Option<u32>>, String> {
    let place = |line: &str| match line.trim() {
        "-1" => Some(None),
        number => number.parse().ok().filter(|&place| (place as usize) < places).map(Some),
    };
    let lines = (1..).zip(text.lines()).map(|(number, line)| {
        place(line).ok_or_else(|| format!("line {number} is neither one of {places} places nor -1"))
    });
    let truth = lines.collect::<Result<Vec<_>, String>>()?;
    if truth.len() == queries {
        Ok(truth)
    } else {
        Err(format!("it has {} lines for {queries} queries", truth.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workload::{Use, Workload, WorkloadSettings};
    use std::fs;
    use std::path::PathBuf;

    /// Written by the generator: `--V 60 --N 25 --W 12 --train 15 --queries 10 --seed 7`.
    fn fixture() -> PathBuf {
        PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/workload"))
    }

    #[test]
    fn the_generators_files_are_read() {
        let WorkloadFiles { tree, places, training, queries } = WorkloadFiles::open(&fixture()).unwrap();
        assert_eq!((tree.len(), places.len(), training.len(), queries.len()), (60, 25, 15, 10));
        // What the generator printed of them.
        let words = places.iter().map(Observation::len).sum::<usize>();
        assert_eq!(words, 278);
        for (index, query) in queries.iter().enumerate() {
            assert_eq!(query.place.is_some(), index % 2 == 0);
        }
        assert_eq!(queries.iter().filter_map(|query| query.place).collect::<Vec<_>>(), [3, 3, 1, 5, 4]);
    }

    /// The generator's tree has other parents, by other random numbers, but the law of its marginals is
    /// ours to the digits written.
    #[test]
    fn our_marginals_are_the_generators() {
        let tree = WorkloadFiles::open(&fixture()).unwrap().tree;
        let settings =
            WorkloadSettings { words: 60, words_per_image: 12.0, seed: 7, ..WorkloadSettings::default() };
        let workload = Workload::new(settings).unwrap();
        for word in WordId::first(60) {
            let (theirs, ours) = (tree.marginal(word, true), workload.tree().marginal(word, true));
            assert!((theirs - ours).abs() < 1e-8, "word {word}: {theirs} {ours}");
            let Some(parent) = tree.parent(word) else { continue };
            let row = crate::workload::coupled(parent, theirs, tree.marginal(parent, true), settings.boost);
            assert!((row.given_parent_seen - tree.conditional(word, true, true)).abs() < 1e-7);
            assert!((row.given_parent_unseen - tree.conditional(word, true, false)).abs() < 1e-7);
        }
        assert!(!workload.images(Use::Place, 5).is_empty());
    }

    #[test]
    fn damaged_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = |name: &str, damage: &dyn Fn(Vec<u8>) -> Vec<u8>| {
            for file in fs::read_dir(fixture()).unwrap().map(Result::unwrap) {
                fs::copy(file.path(), folder.path().join(file.file_name())).unwrap();
            }
            let path = folder.path().join(name);
            fs::write(&path, damage(fs::read(&path).unwrap())).unwrap();
            let message = WorkloadFiles::open(folder.path()).unwrap_err().to_string();
            assert!(message.contains(name), "{message}");
            message
        };
        assert!(refusal("places.bin", &|bytes| bytes[..bytes.len() - 4].to_vec()).contains("too early"));
        assert!(refusal("train.bin", &|bytes| [bytes, vec![0; 4]].concat()).contains("more than"));
        assert!(refusal("queries.bin", &|_| b"nonsense".to_vec()).contains("BOW1"));
        assert!(refusal("truth.txt", &|_| b"25\n".to_vec()).contains("neither"));
        assert!(refusal("truth.txt", &|_| b"-1\n".to_vec()).contains("1 lines for 10"));
        assert!(refusal("tree.txt", &|_| b"0 0.5 0.5\n".to_vec()).contains("line 1"));
        fs::remove_file(folder.path().join("tree.txt")).unwrap();
        let message = WorkloadFiles::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("tree.txt cannot be read"), "{message}");
    }
}
