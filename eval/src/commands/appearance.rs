//! `waypost-eval appearance`: a simulated robot with a panoramic camera goes where it was never shown, by looks alone.

pub mod eye;
pub mod headings;

use std::path::PathBuf;

use serde::Serialize;
use topomap::appearance_graph::NoSuchImage;
use topomap::mapper::ArchiveError;
use waypost_sim::camera::CameraError;
use waypost_sim::people::PersonError;
use waypost_sim::range::OutOfRange;
use waypost_sim::route::RouteError;
use waypost_sim::simulation::SimulationError;
use waypost_vision::features::FeatureError;
use waypost_vision::image::ImageError;
use waypost_vision::panorama::PanoramaError;

use crate::error::EvalError;

use self::eye::Eye;
use self::headings::HeadingFigures;

/// What to measure, and how often.
#[derive(Clone, Debug, PartialEq)]
pub struct AppearanceOptions {
    /// Buildings that the robot drives in, each with two goals.
    pub trials: u32,
    /// Of the first building; the others have the next ones.
    pub seed: u64,
    /// Folder for the pictures.
    pub out: Option<PathBuf>,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AppearanceReport {
    /// Root mean square of the heading's error, in radians.
    pub heading_error_std_rad: Option<f64>,
    /// Of grids of images.
    pub headings: Option<HeadingFigures>,
}

/// Why a simulated robot could not be sent by looks.
#[derive(Debug, thiserror::Error)]
pub enum AppearanceError {
    /// A building without a large room.
    #[error("building {seed} has no room for a grid of images; take another seed")]
    NoGrid {
        /// Its seed.
        seed: u64,
    },
    /// A number of the robot is out of its range.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// The camera cannot be.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The panorama cannot be.
    #[error(transparent)]
    Panorama(#[from] PanoramaError),
    /// The robot does not fit.
    #[error(transparent)]
    Blocked(#[from] RouteError),
    /// The robot cannot start.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// Somebody has no room.
    #[error(transparent)]
    Person(#[from] PersonError),
    /// An image is none.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// An image has no place for features.
    #[error(transparent)]
    Features(FeatureError),
    /// A goal that the map does not have.
    #[error(transparent)]
    Goal(#[from] NoSuchImage),
    /// An image of the map that is not there.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
}

/// Measures headings, drives to goals, and compares graphs.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &AppearanceOptions) -> Result<AppearanceReport, EvalError> {
    let eye = Eye::new()?;
    let seeds: Vec<u64> = (options.seed..).take(4).collect();
    let headings = headings::measure(&eye, &seeds)?;
    Ok(AppearanceReport {
        heading_error_std_rad: Some(headings.heading_error_std_rad),
        headings: Some(headings),
    })
}
