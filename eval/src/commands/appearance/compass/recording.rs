//! Drives that were recorded: panoramas with times, and the robot's way as it was seen from above.

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use waypost_vision::image::{self, GreyImage};
use waypost_vision::panorama::compass::CompassView;

use crate::commands::appearance::AppearanceError;
use crate::dataset;
use crate::error::EvalError;
use crate::files;

/// Panoramas of a drive, and its track.
pub(super) struct Drive {
    /// In the order of time, columns from left to right.
    pub(super) views: Vec<CompassView>,
    /// When they were taken, by the camera's clock.
    pub(super) times_s: Vec<f64>,
    /// Where the robot was, by a clock of its own.
    pub(super) track: Track,
}

/// A drive along the taught route, by a compass of its own.
pub(super) struct Repeat {
    /// Its folder.
    pub(super) name: String,
    /// What it saw.
    pub(super) drive: Drive,
    /// Where that compass told the robot to turn, to the left, frame by frame.
    pub(super) headings_rad: Vec<f64>,
}

/// Positions over time, with gaps.
pub(super) struct Track {
    /// Time in seconds, position.
    points: Vec<(f64, Vector2<f64>)>,
}

/// Positions within so many seconds are averaged: single ones jump.
const AVERAGED_S: f64 = 0.25;

/// The course at a time is the way from so many seconds before it to as many after.
const COURSE_S: f64 = 0.75;

/// A shorter way than this has no course: the robot stands. In the track's unit, which seems to be centimetres.
const LEAST_WAY: f64 = 5.0;

impl Drive {
    /// The taught route.
    ///
    /// # Errors
    /// [`EvalError`] if the folder is not as it was published.
    pub(super) fn taught(folder: &Path) -> Result<Self, EvalError> {
        let rows = rows(&folder.join("training.csv"))?;
        Self::read(folder, &rows, &folder.join("training_path_scaled.csv"))
    }

    fn read(images: &Path, rows: &Rows, track: &Path) -> Result<Self, EvalError> {
        let paths = dataset::image_files(images)?;
        if paths.len() != rows.lines.len() {
            return Err(rows.refused(format!("{} lines for {} images", rows.lines.len(), paths.len())));
        }
        Ok(Self {
            views: paths.iter().map(|path| panorama(path)).collect::<Result<_, _>>()?,
            times_s: rows.column(0)?,
            track: Track::read(track)?,
        })
    }
}

impl Repeat {
    /// All of them.
    ///
    /// # Errors
    /// [`EvalError`] if the folder is not as it was published.
    pub(super) fn all(folder: &Path) -> Result<Vec<Self>, EvalError> {
        let repeat = |name: &str| {
            let rows = rows(&folder.join(format!("testing_{name}.csv")))?;
            let track = folder.join(format!("testing_path_{name}_scaled.csv"));
            let images = format!("test_{name}");
            let drive = Drive::read(&folder.join(&images), &rows, &track)?;
            let headings_rad = rows.column(1)?.into_iter().map(f64::to_radians).collect();
            Ok(Self { name: images, drive, headings_rad })
        };
        ["infomax", "infomax_binary"].into_iter().map(repeat).collect()
    }
}

/// A panorama of the recording runs from right to left. Nobody says so; but the other way around turns have another sign
/// than both the tracks and the recorded headings.
fn panorama(path: &Path) -> Result<CompassView, EvalError> {
    let refused = |reason: String| AppearanceError::Recording { path: path.to_owned(), reason };
    let image = image::decode(&files::read(path)?).map_err(|error| refused(error.to_string()))?;
    let mirrored = image.pixels().chunks_exact(image.width() as usize).flat_map(|row| row.iter().rev());
    let mirrored = GreyImage::new(image.width(), image.height(), mirrored.copied().collect());
    let view = CompassView::new(&mirrored.map_err(AppearanceError::Image)?);
    Ok(view.ok_or_else(|| refused("it looks the same all around".to_owned()))?)
}

impl Track {
    fn read(path: &Path) -> Result<Self, EvalError> {
        // Without a header.
        let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
        let rows = Rows::of(path, text.lines());
        let [milliseconds, x, y] = [rows.column(0)?, rows.column(1)?, rows.column(2)?];
        let points = milliseconds.iter().zip(x.iter().zip(&y));
        let mut points: Vec<(f64, Vector2<f64>)> =
            points.map(|(&time_ms, (&x, &y))| (time_ms / 1000.0, Vector2::new(x, y))).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(Self { points })
    }

    /// Where the robot was, by this track's clock; `None` where it was not seen.
    pub(super) fn position(&self, at_s: f64) -> Option<Vector2<f64>> {
        let before = |time_s: f64| self.points.partition_point(|point| point.0 < time_s);
        let seen = &self.points[before(at_s - AVERAGED_S)..before(at_s + AVERAGED_S)];
        let sum: Vector2<f64> = seen.iter().map(|point| point.1).sum();
        (seen.len() >= 4).then(|| sum / seen.len() as f64)
    }

    /// Which way it drove, to the left of the first axis; `None` where it was not seen or stood.
    pub(super) fn course_rad(&self, at_s: f64) -> Option<f64> {
        let way = self.position(at_s + COURSE_S)? - self.position(at_s - COURSE_S)?;
        (way.norm() >= LEAST_WAY).then(|| way.y.atan2(way.x))
    }

    /// From a point to the nearest of this track.
    pub(super) fn distance(&self, from: Vector2<f64>) -> f64 {
        self.points.iter().map(|point| (point.1 - from).norm()).fold(f64::INFINITY, f64::min)
    }
}

/// Lines of a file of numbers.
struct Rows {
    path: PathBuf,
    lines: Vec<Vec<String>>,
}

/// Those of a file with a header.
fn rows(path: &Path) -> Result<Rows, EvalError> {
    let text = String::from_utf8_lossy(&files::read(path)?).into_owned();
    Ok(Rows::of(path, text.lines().skip(1)))
}

impl Rows {
    fn of<'a>(path: &Path, lines: impl Iterator<Item = &'a str>) -> Self {
        let cells = |line: &str| line.split(',').map(|cell| cell.trim().to_owned()).collect();
        let lines = lines.filter(|line| !line.trim().is_empty()).map(cells).collect();
        Self { path: path.to_owned(), lines }
    }

    /// Numbers of a column, whatever unit stands behind them.
    fn column(&self, column: usize) -> Result<Vec<f64>, EvalError> {
        let number = |cells: &Vec<String>| {
            let text = cells.get(column).and_then(|cell| cell.split_whitespace().next()).unwrap_or_default();
            let number: Option<f64> = text.parse().ok().filter(|number: &f64| number.is_finite());
            number.ok_or_else(|| {
                self.refused(format!("\"{}\" has no number in column {}", cells.join(","), column + 1))
            })
        };
        self.lines.iter().map(number).collect()
    }

    fn refused(&self, reason: String) -> EvalError {
        AppearanceError::Recording { path: self.path.clone(), reason }.into()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn a_track_tells_nothing_where_the_robot_was_not_seen_or_stood() {
        // Along the second axis, with nothing seen from second 4 to 6, standing from second 8 on.
        let times = (0..300).map(|step| 0.04 * f64::from(step)).filter(|time| !(4.0..6.0).contains(time));
        let points = times.map(|time| (time, Vector2::new(1.0, 10.0 * time.min(8.0)))).collect();
        let track = Track { points };
        assert!((track.position(2.0).unwrap() - Vector2::new(1.0, 20.0)).norm() < 0.3);
        assert!((track.course_rad(2.0).unwrap() - FRAC_PI_2).abs() < 1e-9);
        assert_eq!((track.position(5.0), track.course_rad(3.6), track.course_rad(10.0)), (None, None, None));
        assert!((track.distance(Vector2::new(3.0, 20.0)) - 2.0).abs() < 0.3);
    }

    #[test]
    fn numbers_may_have_units_but_must_be_there() {
        let rows = Rows::of(Path::new("testing.csv"), "0.9, 45 deg, a.png\n2.4,\n".lines());
        assert_eq!(rows.column(0).unwrap(), [0.9, 2.4]);
        assert!(rows.column(1).unwrap_err().to_string().contains("column 2"));
    }
}
