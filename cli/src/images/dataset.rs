//! Folders of data sets that have a table of their images: TUM RGB-D, EuRoC and KITTI odometry.

use std::path::{Path, PathBuf};

use super::{ImageFile, ListingError};
use crate::file_stamps::{nanoseconds, nanoseconds_with_exponent};

/// Describes the layouts in `--help`.
pub(crate) const LAYOUTS: &str = "\
Stamps of images are read from
  TUM RGB-D        rgb.txt, with lines `stamp_s rgb/NAME`
  EuRoC            mav0/cam0/data.csv, with lines `stamp_ns,NAME` for mav0/cam0/data
  KITTI odometry   times.txt, with a line `stamp_s` for each image of image_0 (else of image_2)
  file names       that end with seconds (1305031102.175304.png), or with milliseconds,
                   microseconds or nanoseconds since 1970 (13, 16 or 19 digits)
Images without stamps get some at the --rate.";

/// What is wrong with a data set's table of images.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DatasetError {
    #[error("cannot read {}: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    #[error("{}, line {line}: `{text}` is no line of such a table; write `{expected}`", path.display())]
    Line { path: PathBuf, line: usize, text: String, expected: &'static str },
    #[error("{}, line {line}: the stamp is not above that of the line before; sort the lines by time", path.display())]
    NotRising { path: PathBuf, line: usize },
    #[error("{}, line {line}: there is no file {}; check the path", path.display(), image.display())]
    NoImage { path: PathBuf, line: usize, image: PathBuf },
    #[error("{} names no images", .0.display())]
    Empty(PathBuf),
    #[error(
        "{} has {times} times for {images} images in {}; there has to be one line for each image",
        path.display(),
        folder.display()
    )]
    Times { path: PathBuf, folder: PathBuf, times: usize, images: usize },
}

/// Layout of a data set.
enum Layout {
    /// With the table, and the folder that its paths are in.
    TumRgbd {
        table: PathBuf,
        folder: PathBuf,
    },
    Euroc {
        table: PathBuf,
        folder: PathBuf,
    },
    Kitti {
        table: PathBuf,
        folder: PathBuf,
    },
}

impl Layout {
    fn of(folder: &Path) -> Option<Self> {
        let tum = folder.join("rgb.txt");
        if tum.is_file() {
            return Some(Layout::TumRgbd { table: tum, folder: folder.to_owned() });
        }
        for camera in ["mav0/cam0", "cam0", "."] {
            let camera = folder.join(camera);
            let (table, images) = (camera.join("data.csv"), camera.join("data"));
            if table.is_file() && images.is_dir() {
                return Some(Layout::Euroc { table, folder: images });
            }
        }
        let times = folder.join("times.txt");
        let images =
            ["image_0", "image_2"].map(|name| folder.join(name)).into_iter().find(|dir| dir.is_dir());
        match images {
            Some(images) if times.is_file() => Some(Layout::Kitti { table: times, folder: images }),
            Some(_) | None => None,
        }
    }
}

/// A line of a table that says something, with its number.
struct Line<'a> {
    number: usize,
    text: &'a str,
}

/// The images of a data set by its table, in the order of their stamps; none if the folder is no data set.
/// `listed` lists a folder's images in the order of their names.
pub(crate) fn images_of_dataset(
    folder: &Path,
    listed: impl Fn(&Path) -> Result<Vec<ImageFile>, ListingError>,
) -> Result<Option<Vec<ImageFile>>, ListingError> {
    let Some(layout) = Layout::of(folder) else { return Ok(None) };
    let (table, images) = match &layout {
        Layout::TumRgbd { table, folder } => {
            let text = read(table)?;
            let row = |line: &Line<'_>| {
                let (stamp_s, name) = line.text.split_once(char::is_whitespace)?;
                Some((nanoseconds(stamp_s)?, name.trim().to_owned()))
            };
            (table, named(table, folder, &text, "1305031102.175304 rgb/1305031102.175304.png", row)?)
        }
        Layout::Euroc { table, folder } => {
            let text = read(table)?;
            let row = |line: &Line<'_>| {
                let (stamp_ns, name) = line.text.split_once(',')?;
                Some((stamp_ns.trim().parse().ok()?, name.trim().to_owned()))
            };
            (table, named(table, folder, &text, "1403636579763555584,1403636579763555584.png", row)?)
        }
        Layout::Kitti { table, folder } => (table, timed(table, folder, &read(table)?, listed(folder)?)?),
    };
    if images.is_empty() {
        return Err(DatasetError::Empty(table.clone()).into());
    }
    Ok(Some(images))
}

fn read(path: &Path) -> Result<String, DatasetError> {
    std::fs::read_to_string(path).map_err(|source| DatasetError::Unreadable { path: path.to_owned(), source })
}

fn lines(text: &str) -> impl Iterator<Item = Line<'_>> {
    let text = text.trim_start_matches('\u{feff}');
    let lines = text.lines().zip(1..).map(|(text, number)| Line { number, text: text.trim() });
    lines.filter(|line| !line.text.is_empty() && !line.text.starts_with('#'))
}

/// Images that a table names, each with its stamp.
fn named(
    table: &Path,
    folder: &Path,
    text: &str,
    expected: &'static str,
    row: impl Fn(&Line<'_>) -> Option<(i64, String)>,
) -> Result<Vec<ImageFile>, DatasetError> {
    let mut images: Vec<ImageFile> = Vec::new();
    for line in lines(text) {
        let (stamp_ns, name) = row(&line).ok_or_else(|| wrong(table, &line, expected))?;
        check_rising(table, &line, images.last(), stamp_ns)?;
        let path = folder.join(&name);
        if !path.is_file() {
            return Err(DatasetError::NoImage { path: table.to_owned(), line: line.number, image: path });
        }
        images.push(ImageFile { name, path, stamp_ns: Some(stamp_ns) });
    }
    Ok(images)
}

/// Images in the order of their names, with times in the same order.
fn timed(
    table: &Path,
    folder: &Path,
    text: &str,
    images: Vec<ImageFile>,
) -> Result<Vec<ImageFile>, DatasetError> {
    let mut stamps: Vec<(Line<'_>, i64)> = Vec::new();
    for line in lines(text) {
        let stamp_ns = nanoseconds_with_exponent(line.text);
        let stamp_ns = stamp_ns.ok_or_else(|| wrong(table, &line, "1.036224e-01"))?;
        stamps.push((line, stamp_ns));
    }
    if stamps.len() != images.len() {
        return Err(DatasetError::Times {
            path: table.to_owned(),
            folder: folder.to_owned(),
            times: stamps.len(),
            images: images.len(),
        });
    }
    let mut timed: Vec<ImageFile> = Vec::new();
    for ((line, stamp_ns), image) in stamps.into_iter().zip(images) {
        check_rising(table, &line, timed.last(), stamp_ns)?;
        timed.push(ImageFile { stamp_ns: Some(stamp_ns), ..image });
    }
    Ok(timed)
}

fn check_rising(
    table: &Path,
    line: &Line<'_>,
    before: Option<&ImageFile>,
    stamp_ns: i64,
) -> Result<(), DatasetError> {
    match before.and_then(|image| image.stamp_ns) {
        Some(last_ns) if stamp_ns <= last_ns => {
            Err(DatasetError::NotRising { path: table.to_owned(), line: line.number })
        }
        Some(_) | None => Ok(()),
    }
}

fn wrong(table: &Path, line: &Line<'_>, expected: &'static str) -> DatasetError {
    DatasetError::Line {
        path: table.to_owned(),
        line: line.number,
        text: line.text.chars().take(80).collect(),
        expected,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::images::images_of;

    /// A folder with files of a line each, or none.
    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, content).unwrap();
        }
        folder
    }

    fn stamped(folder: &Path) -> Vec<(String, i64)> {
        let images = images_of(folder).unwrap();
        images.into_iter().map(|image| (image.name, image.stamp_ns.unwrap())).collect()
    }

    #[test]
    fn tum_rgbd_is_read_by_its_table() {
        let rgb =
            "# color images\n# timestamp filename\n1305031102.175304 rgb/a.png\n1305031102.2 rgb/b.png\n";
        let folder = folder(&[("rgb.txt", rgb), ("rgb/b.png", ""), ("rgb/a.png", ""), ("depth/a.png", "")]);
        let expected = [("rgb/a.png", 1_305_031_102_175_304_000), ("rgb/b.png", 1_305_031_102_200_000_000)];
        assert_eq!(stamped(folder.path()), expected.map(|(name, stamp)| (name.to_owned(), stamp)));
    }

    #[test]
    fn euroc_is_read_by_its_table() {
        let csv = "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n";
        let image = "mav0/cam0/data/1403636579763555584.png";
        let folder = folder(&[("mav0/cam0/data.csv", csv), (image, "")]);
        let expected = [("1403636579763555584.png".to_owned(), 1_403_636_579_763_555_584)];
        assert_eq!(stamped(folder.path()), expected);
        assert_eq!(stamped(&folder.path().join("mav0")), expected);
    }

    #[test]
    fn kitti_has_a_time_for_each_image() {
        let times = "0.000000e+00\n1.036224e-01\n";
        let images = [("image_0/000000.png", ""), ("image_0/000001.png", "")];
        let kitti = folder(&[&[("times.txt", times)][..], &images].concat());
        let expected = [("000000.png".to_owned(), 0), ("000001.png".to_owned(), 103_622_400)];
        assert_eq!(stamped(kitti.path()), expected);
        let more = folder(&[&[("times.txt", "0\n1\n2\n")][..], &images].concat());
        assert!(images_of(more.path()).unwrap_err().to_string().contains("3 times for 2 images"));
    }

    #[test]
    fn tables_that_are_wrong_name_their_line() {
        for (rgb, fragment) in [
            ("1 rgb/a.png\n1 rgb/a.png\n", "line 2: the stamp is not above"),
            ("# x\none rgb/a.png\n", "line 2: `one rgb/a.png` is no line"),
            ("1\n", "line 1: `1` is no line"),
            ("1 rgb/b.png\n", "line 1: there is no file"),
            ("# nothing\n", "names no images"),
        ] {
            let folder = folder(&[("rgb.txt", rgb), ("rgb/a.png", "")]);
            let error = images_of(folder.path()).unwrap_err().to_string();
            assert!(error.contains(fragment), "{rgb:?}: {error}");
        }
    }
}
