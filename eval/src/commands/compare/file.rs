//! The file that says what to compare.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::error::EvalError;
use crate::files;

/// A comparison, as its TOML file has it: `[[sequence]]` and `[[configuration]]` tables.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompareFile {
    /// What to run on.
    #[serde(default, rename = "sequence")]
    pub sequences: Vec<SequenceEntry>,
    /// What to run.
    #[serde(default, rename = "configuration")]
    pub configurations: Vec<ConfigurationEntry>,
}

/// A sequence with the model for it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SequenceEntry {
    /// What tables and plot call it; the folder's name if it is left out.
    #[serde(default)]
    pub name: String,
    /// The sequence's folder.
    pub path: PathBuf,
    /// Frames closer than this in time are not loops; at least 1.
    pub gap: usize,
    /// The model file, within the configuration's folder of models.
    pub model: PathBuf,
}

/// A system, by the flags that `waypost-eval sequence` would be given.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConfigurationEntry {
    /// What tables and plot call it.
    pub name: String,
    /// Flags of `waypost-eval sequence`, separated by spaces.
    #[serde(default)]
    pub flags: String,
    /// Folder of the models; the file's own folder if it is left out.
    #[serde(default)]
    pub models: PathBuf,
}

impl CompareFile {
    /// Reads the file; its relative paths are taken from its own folder.
    ///
    /// # Errors
    /// [`EvalError::Read`], or [`EvalError::Comparison`] that says what is wrong with it.
    pub fn read(path: &Path) -> Result<Self, EvalError> {
        let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
        let refused = |reason: String| EvalError::Comparison { path: path.to_owned(), reason };
        let mut comparison: Self = toml::from_str(&text).map_err(|error| refused(error.to_string()))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        for sequence in &mut comparison.sequences {
            sequence.path = folder.join(&sequence.path);
            if sequence.name.is_empty() {
                let name = sequence.path.file_name();
                sequence.name = name.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            }
        }
        for configuration in &mut comparison.configurations {
            configuration.models = folder.join(&configuration.models);
        }
        comparison.check().map_err(refused)?;
        Ok(comparison)
    }

    fn check(&self) -> Result<(), String> {
        if self.sequences.is_empty() {
            return Err("there is no [[sequence]]; give each its path, gap and model".to_owned());
        }
        if self.configurations.is_empty() {
            return Err(
                "there is no [[configuration]]; give each a name, and flags if they are not the defaults"
                    .to_owned(),
            );
        }
        if let Some(sequence) = self.sequences.iter().find(|sequence| sequence.gap == 0) {
            return Err(format!(
                "the gap of {} is 0; a frame is no loop of itself, so give at least 1",
                sequence.name
            ));
        }
        let names = self.sequences.iter().map(|sequence| &sequence.name);
        twice(names).map_or(Ok(()), |name| {
            Err(format!("two sequences are named {name:?}; give one of them a name"))
        })?;
        let names = self.configurations.iter().map(|configuration| &configuration.name);
        twice(names).map_or(Ok(()), |name| Err(format!("two configurations are named {name:?}; rename one")))
    }
}

fn twice<'a>(names: impl Iterator<Item = &'a String>) -> Option<&'a String> {
    let mut seen = HashSet::new();
    names.into_iter().find(|name| !seen.insert(*name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<CompareFile, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("compare.toml");
        std::fs::write(&path, text).unwrap();
        let comparison = CompareFile::read(&path).map_err(|error| error.to_string())?;
        assert!(comparison.sequences.iter().all(|sequence| sequence.path.starts_with(folder.path())));
        Ok(comparison)
    }

    const SEQUENCE: &str = "[[sequence]]\npath = \"data/hall\"\ngap = 3\nmodel = \"indoor.waypost\"\n";

    #[test]
    fn a_sequence_is_named_by_its_folder() {
        let text = format!("{SEQUENCE}[[configuration]]\nname = \"plain\"\n");
        let comparison = read(&text).unwrap();
        assert_eq!((comparison.sequences[0].name.as_str(), comparison.sequences[0].gap), ("hall", 3));
        assert_eq!(comparison.configurations[0].flags, "");
    }

    #[test]
    fn what_cannot_be_compared_is_refused_in_words() {
        let configuration = "[[configuration]]\nname = \"plain\"\n";
        for (text, says) in [
            (configuration.to_owned(), "no [[sequence]]"),
            (SEQUENCE.to_owned(), "no [[configuration]]"),
            (format!("{SEQUENCE}{configuration}{configuration}"), "two configurations are named"),
            (format!("{SEQUENCE}{SEQUENCE}{configuration}"), "two sequences are named"),
            (format!("{SEQUENCE}colour = 1\n{configuration}"), "colour"),
            (SEQUENCE.replace('3', "0") + configuration, "at least 1"),
        ] {
            let refused = read(&text).unwrap_err();
            assert!(refused.contains(says), "{refused}");
        }
    }
}
