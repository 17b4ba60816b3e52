//! Image sequences and what is known to be true of them.

use std::collections::HashSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A drive to be run: its images in order of time and which of them show the same place.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// Name of its folder.
    pub name: String,
    /// Frame `i` is image `i`.
    pub images: Vec<PathBuf>,
    /// What is known of its loops.
    pub truth: Truth,
}

/// Pairs of frames (query, earlier match) that are known to be loops, and those nobody judges.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    loops: HashSet<(usize, usize)>,
    ignored: HashSet<(usize, usize)>,
}

/// What the truth says of a proposed pair of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// A loop.
    True,
    /// Not a loop.
    False,
    /// Not known, or arguable: counted neither way.
    Neutral,
}

/// A folder that is no dataset.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// There is no such folder.
    #[error("there is no folder {path}; give a folder that holds images, or a subfolder images/ of them")]
    MissingFolder {
        /// The folder asked for.
        path: PathBuf,
    },
    /// The folder has no images.
    #[error(
        "{path} has no image; put .jpg, .jpeg or .png files into it, named so that their names sort by time"
    )]
    NoImages {
        /// The folder.
        path: PathBuf,
    },
    /// An image of a format that is not read; leaving it out would shift all that follow it.
    #[error("{path} is neither JPEG nor PNG; convert it, or move it out of the folder")]
    ForeignImage {
        /// The image.
        path: PathBuf,
    },
    /// The sequence has no truth.
    #[error(
        "there is no {path}; write the known loops into it, one pair of frame numbers a line under the header \
         query_index,match_index (the header alone if there are none)"
    )]
    MissingTruth {
        /// The file.
        path: PathBuf,
    },
    /// A file or folder cannot be read.
    #[error("{path} cannot be read ({reason}); check its permissions")]
    Unreadable {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// The list of pairs does not name its columns.
    #[error("{path} line 1: the header has no column {column}; begin the file with query_index,match_index")]
    Header {
        /// The file.
        path: PathBuf,
        /// The column that is not there.
        column: &'static str,
    },
    /// A line is not a pair of frame numbers.
    #[error("{path} line {line}: {reason}; write two frame numbers, counted from 0, separated by a comma")]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// A frame that the sequence does not have.
    #[error(
        "{path} line {line}: frame {index} is beyond the sequence, whose {frames} frames are numbered from 0; \
         correct the line, or add the images that are missing"
    )]
    BeyondSequence {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// The frame's number.
        index: usize,
        /// Frames of the sequence.
        frames: usize,
    },
    /// A match that is not earlier than its query.
    #[error(
        "{path} line {line}: match {match_index} is not earlier than query {query_index}; write the later frame first"
    )]
    MatchNotEarlier {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// The query.
        query_index: usize,
        /// Its match.
        match_index: usize,
    },
}

impl Sequence {
    /// Opens a folder with `images/`, `loops.csv` and, if there is one, `ignore.csv`.
    ///
    /// # Errors
    /// [`DatasetError`].
    pub fn open(folder: &Path) -> Result<Self, DatasetError> {
        let images = image_files(folder)?;
        let loops = folder.join("loops.csv");
        if !loops.is_file() {
            return Err(DatasetError::MissingTruth { path: loops });
        }
        let ignored = folder.join("ignore.csv");
        let truth = Truth {
            loops: pairs(&loops, images.len())?,
            ignored: if ignored.exists() { pairs(&ignored, images.len())? } else { HashSet::new() },
        };
        Ok(Self { name: name_of(folder), images, truth })
    }
}

impl Truth {
    /// Takes pairs (query, match) of known loops, and pairs to be counted neither way.
    #[must_use]
    pub fn new(loops: HashSet<(usize, usize)>, ignored: HashSet<(usize, usize)>) -> Self {
        Self { loops, ignored }
    }

    /// Judges a proposal. A pair in both lists is a loop.
    #[must_use]
    pub fn verdict(&self, query: usize, earlier: usize) -> Verdict {
        if self.loops.contains(&(query, earlier)) {
            Verdict::True
        } else if self.ignored.contains(&(query, earlier)) {
            Verdict::Neutral
        } else {
            Verdict::False
        }
    }

    /// Whether the pair is a known loop.
    #[must_use]
    pub fn is_loop(&self, query: usize, earlier: usize) -> bool {
        self.loops.contains(&(query, earlier))
    }

    /// Frames that have a loop at least `gap` frames back: those that recall is counted over.
    #[must_use]
    pub fn queries_with_loop(&self, gap: usize) -> usize {
        let far_enough = self.loops.iter().filter(|(query, earlier)| query - earlier >= gap);
        far_enough.map(|&(query, _)| query).collect::<HashSet<_>>().len()
    }
}

/// The JPEG and PNG files of `folder/images`, or of `folder` itself if it has no such subfolder,
/// sorted by name.
///
/// # Errors
/// [`DatasetError`] if there is no such folder, or no image in it, or one of another format.
pub fn image_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let subfolder = folder.join("images");
    let folder = if subfolder.is_dir() { subfolder } else { folder.to_owned() };
    if !folder.is_dir() {
        return Err(DatasetError::MissingFolder { path: folder });
    }
    let unreadable = |reason| DatasetError::Unreadable { path: folder.clone(), reason };
    let mut images = Vec::new();
    for entry in fs::read_dir(&folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("jpg" | "jpeg" | "png") if !is_hidden => images.push(path),
            Some("bmp" | "gif" | "pgm" | "ppm" | "tif" | "tiff" | "webp") if !is_hidden => {
                return Err(DatasetError::ForeignImage { path });
            }
            Some(_) | None => {}
        }
    }
    if images.is_empty() {
        return Err(DatasetError::NoImages { path: folder });
    }
    images.sort();
    Ok(images)
}

/// Reads a list of pairs `query_index,match_index` of a sequence of `frames` frames.
pub(crate) fn pairs(path: &Path, frames: usize) -> Result<HashSet<(usize, usize)>, DatasetError> {
    let text = fs::read(path).map_err(|reason| DatasetError::Unreadable { path: path.to_owned(), reason })?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let not_csv = |error: csv::Error| DatasetError::Line {
        path: path.to_owned(),
        line: error.position().map_or(1, csv::Position::line),
        reason: error.to_string(),
    };
    let header = reader.headers().map_err(not_csv)?;
    let column = |name: &'static str| {
        let position = header.iter().position(|column| column == name);
        position.ok_or(DatasetError::Header { path: path.to_owned(), column: name })
    };
    let (query_column, match_column) = (column("query_index")?, column("match_index")?);

    let mut pairs = HashSet::new();
    for record in reader.records() {
        let record = record.map_err(not_csv)?;
        let line = record.position().map_or(1, csv::Position::line);
        let frame = |column: usize| {
            let text = record.get(column).unwrap_or_default();
            let index: usize = text.parse().map_err(|_| DatasetError::Line {
                path: path.to_owned(),
                line,
                reason: format!("\"{text}\" is no frame number"),
            })?;
            if index >= frames {
                return Err(DatasetError::BeyondSequence { path: path.to_owned(), line, index, frames });
            }
            Ok(index)
        };
        let (query_index, match_index) = (frame(query_column)?, frame(match_column)?);
        if match_index >= query_index {
            return Err(DatasetError::MatchNotEarlier {
                path: path.to_owned(),
                line,
                query_index,
                match_index,
            });
        }
        pairs.insert((query_index, match_index));
    }
    Ok(pairs)
}

fn name_of(folder: &Path) -> String {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    absolute
        .file_name()
        .map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with `frames` empty images and the given lists of pairs.
    fn dataset(frames: usize, loops: Option<&str>, ignored: Option<&str>) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("images")).unwrap();
        for index in 0..frames {
            fs::write(folder.path().join(format!("images/{index:06}.jpg")), b"").unwrap();
        }
        for (name, text) in [("loops.csv", loops), ("ignore.csv", ignored)] {
            if let Some(text) = text {
                fs::write(folder.path().join(name), text).unwrap();
            }
        }
        folder
    }

    fn refused(loops: &str) -> DatasetError {
        Sequence::open(dataset(5, Some(loops), None).path()).unwrap_err()
    }

    #[test]
    fn frames_are_the_images_in_order_of_name() {
        let folder = dataset(3, Some("query_index,match_index\n"), None);
        fs::write(folder.path().join("images/000001b.PNG"), b"").unwrap();
        fs::write(folder.path().join("images/.hidden.jpg"), b"").unwrap();
        fs::write(folder.path().join("images/notes.txt"), b"").unwrap();
        let sequence = Sequence::open(folder.path()).unwrap();
        let names: Vec<_> = sequence.images.iter().map(|path| path.file_name().unwrap()).collect();
        assert_eq!(names, ["000000.jpg", "000001.jpg", "000001b.PNG", "000002.jpg"]);
        assert_eq!(sequence.images, image_files(&folder.path().join("images")).unwrap());
    }

    #[test]
    fn loops_are_true_ignored_pairs_neutral_all_others_false() {
        let loops = "query_index,match_index\n3, 0\n4,1\n4,0\n";
        let folder = dataset(5, Some(loops), Some("query_index,match_index\n3,1\n4,0\n"));
        let truth = Sequence::open(folder.path()).unwrap().truth;
        assert_eq!(truth.verdict(3, 0), Verdict::True);
        assert_eq!(truth.verdict(4, 0), Verdict::True);
        assert_eq!(truth.verdict(3, 1), Verdict::Neutral);
        assert_eq!(truth.verdict(4, 2), Verdict::False);
    }

    #[test]
    fn a_query_counts_once_and_only_with_a_loop_beyond_the_gap() {
        let truth = Truth::new([(9, 0), (9, 1), (8, 3), (5, 4)].into(), HashSet::new());
        assert_eq!(truth.queries_with_loop(1), 3);
        assert_eq!(truth.queries_with_loop(5), 2);
        assert_eq!(truth.queries_with_loop(10), 0);
    }

    #[test]
    fn columns_may_stand_in_any_order() {
        let folder = dataset(5, Some("match_index,note,query_index\n1,x,4\n"), None);
        assert_eq!(Sequence::open(folder.path()).unwrap().truth.verdict(4, 1), Verdict::True);
    }

    #[test]
    fn what_is_not_there_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("nowhere");
        assert!(
            matches!(Sequence::open(&missing), Err(DatasetError::MissingFolder { path }) if path == missing)
        );
        assert!(matches!(Sequence::open(folder.path()), Err(DatasetError::NoImages { .. })));
        let no_truth = dataset(2, None, None);
        assert!(matches!(
            Sequence::open(no_truth.path()),
            Err(DatasetError::MissingTruth { path }) if path.ends_with("loops.csv")
        ));
    }

    #[test]
    fn an_image_that_would_be_left_out_is_refused() {
        let folder = dataset(2, Some("query_index,match_index\n"), None);
        fs::write(folder.path().join("images/000000b.ppm"), b"").unwrap();
        assert!(matches!(Sequence::open(folder.path()), Err(DatasetError::ForeignImage { .. })));
    }

    #[test]
    fn errors_in_the_truth_name_the_line() {
        assert!(matches!(refused("3,0\n4,1\n"), DatasetError::Header { column: "query_index", .. }));
        assert!(matches!(refused(""), DatasetError::Header { .. }));
        let header = "query_index,match_index\n";
        assert!(matches!(refused(&format!("{header}3,0\nthree,0\n")), DatasetError::Line { line: 3, .. }));
        assert!(matches!(refused(&format!("{header}3\n")), DatasetError::Line { line: 2, .. }));
        assert!(matches!(refused(&format!("{header}-1,0\n")), DatasetError::Line { line: 2, .. }));
        assert!(matches!(
            refused(&format!("{header}\n3,0\n5,0\n")),
            DatasetError::BeyondSequence { line: 4, index: 5, frames: 5, .. }
        ));
        assert!(matches!(
            refused(&format!("{header}2,2\n")),
            DatasetError::MatchNotEarlier { line: 2, query_index: 2, match_index: 2, .. }
        ));
    }
}
