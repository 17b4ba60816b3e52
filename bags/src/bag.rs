//! A bag: one file, or the folder that rosbag2 writes.

use std::ops::ControlFlow;
use std::path::{Component, Path, PathBuf};

use serde::Deserialize;

use crate::error::BagError;
use crate::input::Progress;
use crate::source::{Ending, Format, Visit, visit_file};
use crate::survey::{Survey, Topic};
use crate::transforms::StaticTransforms;

const METADATA: &str = "metadata.yaml";
/// What rosbag2 writes of a bag in thousands of files is shorter.
const MOST_METADATA_BYTES: u64 = 64 << 20;

/// A bag that was read once, to its end.
#[derive(Debug)]
pub struct Bag {
    path: PathBuf,
    files: Vec<(Format, PathBuf)>,
    topics: Vec<Topic>,
    pub(crate) transforms: StaticTransforms,
    cut_off: Vec<CutOff>,
}

/// A file that ends in the middle.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CutOff {
    /// The file.
    pub path: PathBuf,
    /// Where it ends.
    pub at_byte: u64,
}

/// What of `metadata.yaml` is needed.
#[derive(Deserialize)]
struct Metadata {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    relative_file_paths: Vec<PathBuf>,
}

impl Bag {
    /// Whether a path names a bag, by the end of its name or, of a folder, by what is in it.
    pub fn is_bag(path: &Path) -> bool {
        if path.is_dir() {
            path.join(METADATA).is_file() || !files_in(path).is_empty()
        } else {
            Format::of(path).is_some()
        }
    }

    /// Reads a bag to its end, with all its checksums, and says what is in it. Memory is bounded whatever its length.
    ///
    /// # Errors
    /// What is damaged is named by its byte. A file that was cut off is read up to there (see [`Bag::cut_off`]).
    pub fn open(path: &Path, progress: &mut Progress<'_>) -> Result<Self, BagError> {
        let files = files(path)?;
        let mut survey = Survey::default();
        let cut_off = visit_all(&files, progress, &mut |message| {
            survey.message(message);
            Ok(ControlFlow::Continue(()))
        })?;
        let Survey { mut topics, transforms, by_name: _ } = survey;
        topics.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(Self { path: path.to_owned(), files, topics, transforms, cut_off })
    }

    /// File or folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// By their names. One that changes its type is there once for each.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Files that end in the middle; what is before that counts.
    pub fn cut_off(&self) -> &[CutOff] {
        &self.cut_off
    }

    /// Passes each message to `visit`, until that breaks off.
    pub(crate) fn visit(&self, progress: &mut Progress<'_>, visit: &mut Visit<'_>) -> Result<(), BagError> {
        visit_all(&self.files, progress, visit).map(|_| ())
    }
}

fn visit_all(
    files: &[(Format, PathBuf)],
    progress: &mut Progress<'_>,
    visit: &mut Visit<'_>,
) -> Result<Vec<CutOff>, BagError> {
    let size = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let total: u64 = files.iter().map(|(_, path)| size(path)).sum();
    let mut before = 0;
    let mut cut_off = Vec::new();
    let mut flow = ControlFlow::Continue(());
    for (format, path) in files {
        let mut within = |done: u64, _| progress(before + done, total);
        let ending = visit_file(*format, path, &mut within, &mut |message| {
            flow = visit(message)?;
            Ok(flow)
        })?;
        if let Ending::CutOff { at_byte } = ending {
            cut_off.push(CutOff { path: path.clone(), at_byte });
        }
        before += size(path);
        progress(before, total);
        if flow.is_break() {
            break;
        }
    }
    Ok(cut_off)
}

fn files(path: &Path) -> Result<Vec<(Format, PathBuf)>, BagError> {
    let not_a_bag = |reason: &str| BagError::NotABag { path: path.to_owned(), reason: reason.to_owned() };
    if !path.exists() {
        return Err(not_a_bag("there is no such file or folder; check the path"));
    }
    if !path.is_dir() {
        let format = Format::of(path)
            .ok_or_else(|| not_a_bag("bags end in .mcap, .db3 or .bag, and .zstd behind it if compressed"))?;
        return Ok(vec![(format, path.to_owned())]);
    }
    let listed = if path.join(METADATA).is_file() { listed_files(path)? } else { files_in(path) };
    if listed.is_empty() {
        return Err(not_a_bag("it is a folder without metadata.yaml, .mcap or .db3"));
    }
    Ok(listed)
}

/// The bags of a folder that has no metadata, as one that was not closed: by their names, shorter ones first.
fn files_in(folder: &Path) -> Vec<(Format, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<(Format, PathBuf)> = entries
        .map(|entry| entry.path())
        .filter(|path| path.is_file())
        .filter_map(|path| Some((Format::of(&path).filter(|format| *format != Format::Ros1)?, path)))
        .collect();
    files.sort_by_key(|(_, path)| (path.as_os_str().len(), path.clone()));
    files
}

/// The files that the metadata names, in their order.
fn listed_files(folder: &Path) -> Result<Vec<(Format, PathBuf)>, BagError> {
    let path = folder.join(METADATA);
    let not_a_bag = |reason: String| BagError::NotABag { path: path.clone(), reason };
    let failed = |source| BagError::File { path: path.clone(), source };
    if std::fs::metadata(&path).map_err(failed)?.len() > MOST_METADATA_BYTES {
        return Err(not_a_bag("it is longer than any metadata.yaml; is it another file?".to_owned()));
    }
    let text = std::fs::read_to_string(&path).map_err(failed)?;
    let metadata: Metadata = serde_norway::from_str(&text).map_err(|error| {
        not_a_bag(format!("{error}; without the file the folder is read by the names in it"))
    })?;
    let names = metadata.rosbag2_bagfile_information.relative_file_paths;
    names.iter().map(|name| listed_file(folder, name).map_err(not_a_bag)).collect()
}

fn listed_file(folder: &Path, name: &Path) -> Result<(Format, PathBuf), String> {
    if !name.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(format!("it names {}, which is not in its folder", name.display()));
    }
    // People who decompress a file, or compress it, forget the metadata.
    let candidates = [folder.join(name), folder.join(name).with_extension(""), with_zstd(&folder.join(name))];
    let found = candidates.into_iter().find(|path| path.is_file() && Format::of(path).is_some());
    let path = found.ok_or_else(|| format!("it names {}, which is not there", name.display()))?;
    let format = Format::of(&path).ok_or_else(|| format!("it names {}, which is no bag", name.display()))?;
    Ok((format, path))
}

fn with_zstd(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".zstd");
    PathBuf::from(name)
}
