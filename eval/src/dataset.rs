//! Image sequences and what is known to be true of them.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use csv::StringRecord;

use crate::files;

/// A drive to be run: its images in order of time and which of them show the same place.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Sequence {
    /// Name of its folder.
    pub name: String,
    /// Frame `i` is image `i`.
    pub images: Vec<PathBuf>,
    /// What is known of its loops.
    pub truth: Truth,
}

/// Pairs of frames (query, earlier match) that are known to be loops, and those nobody judges.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Truth {
    loops: HashSet<(usize, usize)>,
    ignored: HashSet<(usize, usize)>,
}

/// What the truth says of a proposed pair of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Verdict {
    /// A loop.
    True,
    /// Not a loop.
    False,
    /// Not known, or arguable: counted neither way.
    Neutral,
}

impl Sequence {
    /// Opens a folder with `images/`, `loops.csv` and, if there is one, `ignore.csv`.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let images = image_files(folder)?;
        let loops = folder.join("loops.csv");
        ensure!(
            loops.is_file(),
            "there is no {}; write the known loops into it, one pair of frame numbers a line under the header \
             query_index,match_index (the header alone if there are none)",
            loops.display()
        );
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
    #[cfg(test)]
    pub(crate) fn new(loops: HashSet<(usize, usize)>, ignored: HashSet<(usize, usize)>) -> Self {
        Self { loops, ignored }
    }

    /// Judges a proposal. A pair in both lists is a loop.
    pub(crate) fn verdict(&self, query: usize, earlier: usize) -> Verdict {
        if self.loops.contains(&(query, earlier)) {
            Verdict::True
        } else if self.ignored.contains(&(query, earlier)) {
            Verdict::Neutral
        } else {
            Verdict::False
        }
    }

    /// Frames that have a loop at least `gap` frames back: those that recall is counted over.
    pub(crate) fn queries_with_loop(&self, gap: usize) -> usize {
        let far_enough = self.loops.iter().filter(|(query, earlier)| query - earlier >= gap);
        far_enough.map(|&(query, _)| query).collect::<HashSet<_>>().len()
    }
}

/// The JPEG and PNG files of `folder/images`, or of `folder` itself if it has no such subfolder,
/// sorted by name.
pub(crate) fn image_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let subfolder = folder.join("images");
    let folder = if subfolder.is_dir() { subfolder } else { folder.to_owned() };
    ensure!(
        folder.is_dir(),
        "there is no folder {}; give a folder that holds images, or a subfolder images/ of them",
        folder.display()
    );
    let mut images = Vec::new();
    for entry in fs::read_dir(&folder).map_err(files::not_read(&folder))? {
        let path = entry.map_err(files::not_read(&folder))?.path();
        let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("jpg" | "jpeg" | "png") if !is_hidden => images.push(path),
            Some("bmp" | "gif" | "pgm" | "ppm" | "tif" | "tiff" | "webp") if !is_hidden => {
                bail!("{} is neither JPEG nor PNG; convert it, or move it out of the folder", path.display());
            }
            Some(_) | None => {}
        }
    }
    ensure!(
        !images.is_empty(),
        "{} has no image; put .jpg, .jpeg or .png files into it, named so that their names sort by time",
        folder.display()
    );
    images.sort();
    Ok(images)
}

/// Reads a list of pairs `query_index,match_index` of a sequence of `frames` frames.
pub(crate) fn pairs(path: &Path, frames: usize) -> Result<HashSet<(usize, usize)>> {
    let rows = rows(path, ["query_index", "match_index"])?;
    let pair = |row: &Row<2>| {
        let query = frame(&row.fields[0], frames)?;
        let earlier = frame(&row.fields[1], frames)?;
        ensure!(
            earlier < query,
            "match {earlier} is not earlier than query {query}; write the later frame first"
        );
        Ok((query, earlier))
    };
    rows.iter().map(|row| pair(row).with_context(|| row.place(path))).collect()
}

fn frame(text: &str, frames: usize) -> Result<usize> {
    let index: usize = text.parse().map_err(|_| {
        anyhow!(
            "\"{text}\" is no frame number; write two frame numbers, counted from 0, separated by a comma"
        )
    })?;
    ensure!(
        index < frames,
        "frame {index} is beyond the sequence, whose {frames} frames are numbered from 0; correct the line, or add the \
         images that are missing"
    );
    Ok(index)
}

/// A row of a table, with the fields that were asked for.
pub(crate) struct Row<const FIELDS: usize> {
    /// From 1.
    line: u64,
    pub(crate) fields: [String; FIELDS],
}

impl<const FIELDS: usize> Row<FIELDS> {
    /// For messages: the file and the line.
    pub(crate) fn place(&self, path: &Path) -> String {
        format!("{} line {}", path.display(), self.line)
    }
}

/// Reads a table with a header, and of each row the fields in these columns.
pub(crate) fn rows<const FIELDS: usize>(path: &Path, columns: [&str; FIELDS]) -> Result<Vec<Row<FIELDS>>> {
    let text = files::read(path)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let not_csv = |error: csv::Error| {
        let line = error.position().map_or(1, csv::Position::line);
        anyhow!(
            "{} line {line}: {error}; write fields separated by commas, as many as the header has",
            path.display()
        )
    };
    let header = reader.headers().map_err(not_csv)?.clone();
    let position = |column: &str| {
        header.iter().position(|other| other == column).with_context(|| {
            let path = path.display();
            format!(
                "{path} line 1: the header has no column {column}; begin the file with {}",
                columns.join(",")
            )
        })
    };
    let positions = columns.iter().map(|column| position(column)).collect::<Result<Vec<usize>>>()?;
    let row = |record: StringRecord| Row {
        line: record.position().map_or(1, csv::Position::line),
        fields: std::array::from_fn(|field| record.get(positions[field]).unwrap_or_default().to_owned()),
    };
    reader.records().map(|record| Ok(row(record.map_err(not_csv)?))).collect()
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

    fn assert_refused(loops: &str, says: &str) {
        let refusal = Sequence::open(dataset(5, Some(loops), None).path()).unwrap_err();
        assert!(format!("{refusal:#}").contains(says), "{refusal:#}");
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
        let refusal = |folder: &Path| Sequence::open(folder).unwrap_err().to_string();
        assert!(refusal(&missing).starts_with(&format!("there is no folder {}", missing.display())));
        assert!(refusal(folder.path()).contains("has no image"));
        let no_truth = dataset(2, None, None);
        let truth = no_truth.path().join("loops.csv");
        assert!(refusal(no_truth.path()).starts_with(&format!("there is no {};", truth.display())));
    }

    #[test]
    fn an_image_that_would_be_left_out_is_refused() {
        let folder = dataset(2, Some("query_index,match_index\n"), None);
        fs::write(folder.path().join("images/000000b.ppm"), b"").unwrap();
        let refusal = Sequence::open(folder.path()).unwrap_err().to_string();
        assert!(refusal.contains("000000b.ppm is neither JPEG nor PNG"), "{refusal}");
    }

    #[test]
    fn errors_in_the_truth_name_the_line() {
        assert_refused("3,0\n4,1\n", "line 1: the header has no column query_index");
        assert_refused("", "the header has no column");
        let header = "query_index,match_index\n";
        assert_refused(&format!("{header}3,0\nthree,0\n"), "line 3: \"three\" is no frame number");
        assert_refused(&format!("{header}3\n"), "line 2:");
        assert_refused(&format!("{header}-1,0\n"), "line 2: \"-1\" is no frame number");
        assert_refused(
            &format!("{header}\n3,0\n5,0\n"),
            "line 4: frame 5 is beyond the sequence, whose 5 frames",
        );
        assert_refused(&format!("{header}2,2\n"), "line 2: match 2 is not earlier than query 2");
    }
}
