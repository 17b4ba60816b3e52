//! `waypost-eval appearance`: a simulated robot with a panoramic camera goes where it was never shown, by looks alone; and
//! what whole panoramas of a real robot are worth as a compass.

pub mod candidates;
pub mod compass;
pub mod eye;
pub mod headings;
pub mod index;
pub mod picture;
pub mod trials;

use std::path::PathBuf;

use fabmap::signature::SignatureError;
use fabmap::vocabulary::VocabularyError;
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
use waypost_vision::panorama::compass::SizesDiffer;

use crate::error::EvalError;
use crate::files;

use self::candidates::LookAlikeFigures;
use self::compass::CompassFigures;
use self::eye::{Acuity, Eye};
use self::headings::HeadingFigures;
use self::index::{IndexFigures, IndexOptions, WordSource};
use self::trials::{Drive, DrivenMap};

/// Buildings that headings are measured in.
const GRIDS: u32 = 4;

/// What to measure, and how often.
#[derive(Clone, Debug, PartialEq)]
pub struct AppearanceOptions {
    /// Buildings that the robot drives in, each with two goals.
    pub trials: u32,
    /// Of the first building; the others have the next ones.
    pub seed: u64,
    /// Most people in the robot's way; each number up to it is tried.
    pub people: usize,
    /// Panoramas of the graph that is made through the index.
    pub panoramas: usize,
    /// Panoramas that are compared with all others, to see which links the index does not lead to.
    pub reference: usize,
    /// How fine those panoramas are.
    pub acuity: Acuity,
    /// Where the words of the index are from.
    pub words: WordSource,
    /// What is measured.
    pub parts: Vec<Part>,
    /// Folder of the recorded panoramas; without it there is no compass to measure.
    pub data: Option<PathBuf>,
    /// Folder for the pictures.
    pub out: Option<PathBuf>,
}

/// Something to measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Headings of grids of images.
    Headings,
    /// Drives to goals.
    Drives,
    /// A graph through the index against one of all pairs.
    Index,
    /// Links in a building whose offices look alike.
    LookAlikes,
    /// Headings by whole panoramas, recorded by a real robot.
    Compass,
}

impl Part {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Headings, Self::Drives, Self::Index, Self::LookAlikes, Self::Compass];

    /// What the command line calls it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Headings => "headings",
            Self::Drives => "drives",
            Self::Index => "index",
            Self::LookAlikes => "look-alikes",
            Self::Compass => "compass",
        }
    }

    /// The part of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|part| part.name() == name)
    }
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AppearanceReport {
    /// Root mean square of the heading's error, in radians.
    pub heading_error_std_rad: Option<f64>,
    /// Drives, with people and without.
    pub trials: usize,
    /// Those that came to the goal.
    pub arrived: usize,
    /// How often a robot touched something, over all drives.
    pub collisions: u64,
    /// Length of the way against the shortest over the graph's images, mean of the drives with nobody about.
    pub path_ratio_mean: Option<f64>,
    /// The same with as many people in the way as its place in the list tells.
    pub path_ratio_by_people: Vec<Option<f64>>,
    /// Of grids of images.
    pub headings: Option<HeadingFigures>,
    /// Share of the links that the index does not lead to.
    pub links_lost_fraction: Option<f64>,
    /// Comparisons of all pairs over those through the index.
    pub pair_check_ratio: Option<f64>,
    /// Of the graph through the index.
    pub index: Option<IndexFigures>,
    /// Of the building whose offices look alike.
    pub look_alikes: Option<LookAlikeFigures>,
    /// Of whole panoramas.
    pub compass: Option<CompassFigures>,
    /// Drive by drive.
    pub drives: Vec<Drive>,
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
    /// A file of the recorded panoramas is not as it was published.
    #[error("{path}: {reason}; give the folder of recordings as it was published")]
    Recording {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Recorded panoramas of different sizes.
    #[error(transparent)]
    Sizes(#[from] SizesDiffer),
    /// No words can be learnt.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
    /// Words that are not those of the features.
    #[error(transparent)]
    Signatures(#[from] SignatureError),
    /// An image of the map that is not there.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
}

/// Measures headings, drives to goals, and compares graphs.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &AppearanceOptions) -> Result<AppearanceReport, EvalError> {
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let (fine, coarse) = (Eye::new(Acuity::FINE)?, Eye::new(Acuity::COARSE)?);
    let is_asked = |part| options.parts.contains(&part);
    let headings = is_asked(Part::Headings).then(|| measure_headings(&fine, options)).transpose()?;
    let drives = is_asked(Part::Drives).then(|| drive(&coarse, options)).transpose()?.unwrap_or_default();
    let index = is_asked(Part::Index)
        .then(|| {
            let AppearanceOptions { panoramas, reference, seed, acuity, words, .. } = options;
            let (panoramas, reference, seed) = (*panoramas, *reference, *seed);
            let index = IndexOptions { panoramas, reference, seed, words };
            index::measure(&Eye::new(*acuity)?, &index)
        })
        .transpose()?;
    let look_alikes =
        is_asked(Part::LookAlikes).then(|| candidates::look_alikes(&coarse, options.seed)).transpose()?;
    let compass = match &options.data {
        Some(folder) if is_asked(Part::Compass) => Some(compass::measure(folder)?),
        Some(_) | None => None,
    };
    Ok(AppearanceReport {
        links_lost_fraction: index.as_ref().map(|index| index.links_lost_fraction),
        pair_check_ratio: index.as_ref().map(|index| index.pair_check_ratio),
        index,
        look_alikes,
        compass,
        heading_error_std_rad: headings.as_ref().map(|headings| headings.heading_error_std_rad),
        trials: drives.len(),
        arrived: drives.iter().filter(|drive| drive.arrived).count(),
        collisions: drives.iter().map(|drive| drive.collisions).sum(),
        path_ratio_mean: path_ratio(&drives, 0),
        path_ratio_by_people: (0..=options.people).map(|people| path_ratio(&drives, people)).collect(),
        headings,
        drives,
    })
}

fn seeds(options: &AppearanceOptions, count: u32) -> Vec<u64> {
    (options.seed..).take(count as usize).collect()
}

fn measure_headings(eye: &Eye, options: &AppearanceOptions) -> Result<HeadingFigures, EvalError> {
    let figures = headings::measure(eye, &seeds(options, GRIDS))?;
    if let Some(out) = &options.out {
        let path = out.join("heading-errors.svg");
        let not_drawn = |reason| EvalError::Plot { path: path.clone(), reason };
        files::write(&path, headings::svg(&figures).map_err(not_drawn)?.as_bytes())?;
    }
    Ok(figures)
}

fn drive(eye: &Eye, options: &AppearanceOptions) -> Result<Vec<Drive>, EvalError> {
    let people: Vec<usize> = (0..=options.people).collect();
    let driven = trials::drive_all(eye, &seeds(options, options.trials), &people)?;
    if let Some(out) = &options.out {
        for DrivenMap { map, drives } in &driven {
            let seed = drives.first().map_or(0, |drive| drive.seed);
            let svg = picture::svg(map, drives);
            files::write(&out.join(format!("appearance-{seed}.svg")), svg.as_bytes())?;
        }
    }
    Ok(driven.into_iter().flat_map(|driven| driven.drives).collect())
}

fn path_ratio(drives: &[Drive], people: usize) -> Option<f64> {
    let ratios: Vec<f64> =
        drives.iter().filter(|drive| drive.people == people).map(|drive| drive.path_ratio).collect();
    (!ratios.is_empty()).then(|| ratios.iter().sum::<f64>() / ratios.len() as f64)
}
