//! `waypost-eval appearance`: a simulated robot with a panoramic camera goes where it was never shown, by looks alone.

mod candidates;
pub(crate) mod eye;
mod headings;
mod index;
mod picture;
mod rooms;
mod trials;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};
use serde::Serialize;

use crate::files;

use self::candidates::LookAlikeFigures;
use self::eye::{Acuity, Eye};
use self::headings::HeadingFigures;
use self::index::{IndexFigures, IndexOptions};
use self::rooms::RoomFigures;
use self::trials::{Drive, DrivenMap};

/// Buildings that headings are measured in.
const GRIDS: u32 = 4;

/// Send a simulated robot with a panoramic camera to goals by looks alone, in buildings that it has images of.
#[derive(Args)]
pub(crate) struct AppearanceOptions {
    /// Buildings that the robot drives in, each with two goals.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// Seed of the first building; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Most people in the robot's way, each number up to it tried.
    #[arg(long, value_name = "K", default_value_t = 0, value_parser = clap::value_parser!(u8).range(..=8))]
    people: u8,
    #[command(flatten)]
    index: IndexOptions,
    /// What to measure [default: all].
    #[arg(long, value_name = "PART", value_enum, num_args = 1..)]
    parts: Option<Vec<Part>>,
    /// Folder for the pictures; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Something to measure.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Part {
    /// Headings of grids of images.
    Headings,
    /// Drives to goals.
    Drives,
    /// A graph through the index against one of all pairs.
    Index,
    /// Links in a building whose offices look alike.
    LookAlikes,
    /// Labels that are put on whole rooms.
    Rooms,
}

/// What came out.
#[derive(Serialize)]
pub(crate) struct AppearanceReport {
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
    /// Of labels that are put on whole rooms.
    pub rooms: Option<Vec<RoomFigures>>,
    /// Drive by drive.
    pub drives: Vec<Drive>,
}

/// Measures headings, drives to goals, and compares graphs.
pub(crate) fn run(options: &AppearanceOptions) -> Result<AppearanceReport> {
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let coarse = Eye::new(Acuity::Coarse)?;
    let is_asked = |part| options.parts.as_ref().is_none_or(|parts| parts.contains(&part));
    let headings = is_asked(Part::Headings).then(|| measure_headings(options)).transpose()?;
    let drives = is_asked(Part::Drives).then(|| drive(&coarse, options)).transpose()?.unwrap_or_default();
    let index = is_asked(Part::Index).then(|| index::measure(&options.index, options.seed)).transpose()?;
    let look_alikes =
        is_asked(Part::LookAlikes).then(|| candidates::look_alikes(&coarse, options.seed)).transpose()?;
    let rooms = is_asked(Part::Rooms)
        .then(|| rooms::measure(&coarse, &seeds(options, options.trials)))
        .transpose()?;
    Ok(AppearanceReport {
        rooms,
        links_lost_fraction: index.as_ref().map(|index| index.links_lost_fraction),
        pair_check_ratio: index.as_ref().map(|index| index.pair_check_ratio),
        index,
        look_alikes,
        heading_error_std_rad: headings.as_ref().map(|headings| headings.heading_error_std_rad),
        trials: drives.len(),
        arrived: drives.iter().filter(|drive| drive.arrived).count(),
        collisions: drives.iter().map(|drive| drive.collisions).sum(),
        path_ratio_mean: path_ratio(&drives, 0),
        path_ratio_by_people: (0..=options.people).map(|people| path_ratio(&drives, people.into())).collect(),
        headings,
        drives,
    })
}

fn seeds(options: &AppearanceOptions, count: u32) -> Vec<u64> {
    (options.seed..).take(count as usize).collect()
}

fn measure_headings(options: &AppearanceOptions) -> Result<HeadingFigures> {
    let figures = headings::measure(&Eye::new(Acuity::Fine)?, &seeds(options, GRIDS))?;
    if let Some(out) = &options.out {
        files::write(&out.join("heading-errors.svg"), headings::svg(&figures)?.as_bytes())?;
    }
    Ok(figures)
}

fn drive(eye: &Eye, options: &AppearanceOptions) -> Result<Vec<Drive>> {
    let people: Vec<usize> = (0..=options.people.into()).collect();
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
