//! Merging alone, on a drive whose poses are known and whose images are not: true loops stand in for recognition.

use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use anyhow::Result;
use posegraph::{PlanarPose, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use topomap::evidence::ClosureNoise;
use topomap::log::{Link, LinkKind};
use topomap::map::PlacePoses;
use topomap::merging::{Layout, MergeSettings, PlaceMatch, Verdict, joined_poses, judge};
use topomap::metric::{OdometryNoise, PlaceSpacing, RelativePose};

use super::MergeOptions;
use super::report::{MergeReport, MergeRun, said};
use super::sessions::cuts;
use crate::commands::map::alignment::{Alignment, rmse_m};
use crate::commands::map::judgement::is_far;
use crate::commands::map::kitti::{closures, driven, poses};

/// A session or several: poses, and which places of the drive they are.
struct Piece {
    poses: PlacePoses,
    places: Vec<usize>,
}

impl Piece {
    fn layout(&self, noise: OdometryNoise, spacing: PlaceSpacing) -> Layout<'_> {
        Layout { poses: &self.poses, noise, spacing }
    }
}

/// Cuts the drive in a folder with `poses.txt` and `loops.csv`, merges, and holds the map against the truth.
pub(super) fn run(folder: &Path, options: &MergeOptions) -> Result<MergeReport> {
    let truth = poses(&folder.join("poses.txt"))?;
    let runs = (options.seed..).take(options.trials as usize);
    let runs = runs.map(|seed| trial(folder, options, seed, &truth)).collect::<Result<Vec<MergeRun>>>()?;
    Ok(MergeReport::of("kitti".to_owned(), options, runs))
}

fn trial(folder: &Path, options: &MergeOptions, seed: u64, truth: &[PlanarPose]) -> Result<MergeRun> {
    // Nothing was seen, so there is no evidence.
    let merge = MergeSettings { min_total_evidence: 0.0, ..options.merge() };
    let noise = OdometryNoise::default();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let driven = driven(truth, options.wheels(), seed, &noise)?.links;
    let length_m: f64 = truth.windows(2).map(|pair| far_m(&pair[0], &pair[1])).sum();
    let spacing_m = length_m / truth.len() as f64;
    let mut closed = closures(&folder.join("loops.csv"), truth, spacing_m, seed)?;
    let is_true = closed.len();
    let pieces = random.random_range(2..=4);
    let cuts = cuts(truth.len(), pieces, &mut random);
    closed.extend(made_up(is_true, options.false_matches, &cuts, spacing_m, &mut random));

    let whole: Vec<Link> = driven.iter().chain(&closed).copied().collect();
    let one_go = PlacePoses::new(vec![0; truth.len()], &whole, &noise);
    let mut left: Vec<Piece> = cuts
        .into_iter()
        .map(|cut| {
            let inside = |link: &&Link| [link.from, link.to].iter().all(|&end| cut.contains(&(end as usize)));
            let first = cut.start as u32;
            let links: Vec<Link> = whole
                .iter()
                .filter(inside)
                .map(|link| Link { from: link.from - first, to: link.to - first, kind: link.kind })
                .collect();
            Piece { poses: PlacePoses::new(vec![0; cut.len()], &links, &noise), places: cut.collect() }
        })
        .collect();
    let mut run = MergeRun {
        seed,
        maps: left.len(),
        places: left.iter().map(|piece| piece.places.len()).collect(),
        ..MergeRun::default()
    };
    let spacing = PlaceSpacing { distance_m: spacing_m, ..PlaceSpacing::default() };
    // The last one closes most loops.
    let mut merged = left.remove(left.len() - 1);
    loop {
        let before = left.len();
        for source in std::mem::take(&mut left) {
            let matches = between(&source, &merged, &closed);
            let began = Instant::now();
            let verdict =
                judge(source.layout(noise, spacing), merged.layout(noise, spacing), &matches, &merge);
            run.seconds.push(began.elapsed().as_secs_f64());
            run.said.push(said(&verdict, matches.len()));
            let Verdict::Overlap(plan) = verdict else {
                left.push(source);
                continue;
            };
            let apart = |matched: &&PlaceMatch| {
                let [a, b] = [source.places[matched.source as usize], merged.places[matched.target as usize]];
                is_far(&truth[a].inverse().compose(&truth[b]))
            };
            run.count(&plan, plan.matches.iter().filter(apart).count());
            merged = Piece {
                poses: joined_poses(
                    source.layout(noise, spacing),
                    merged.layout(noise, spacing),
                    &plan.matches,
                ),
                places: merged.places.iter().chain(&source.places).copied().collect(),
            };
        }
        if left.len() == before || left.is_empty() {
            break;
        }
    }
    let enough =
        |source: &&Piece| between(source, &merged, &closed[..is_true]).len() >= 2 * merge.min_support;
    run.missed_overlaps = left.iter().filter(enough).count();
    let of = |poses: &PlacePoses, place: usize| poses.poses()[place];
    let laid: Vec<PlanarPose> = (0..merged.places.len()).map(|place| of(&merged.poses, place)).collect();
    let was: Vec<PlanarPose> = merged.places.iter().map(|&place| truth[place]).collect();
    let whole: Vec<PlanarPose> = merged.places.iter().map(|&place| of(&one_go, place)).collect();
    run.rmse_m = rmse_m(&laid, &was, Alignment::Rigid);
    run.one_go_rmse_m = Some(rmse_m(&whole, &was, Alignment::Rigid));
    Ok(run)
}

fn far_m(a: &PlanarPose, b: &PlanarPose) -> f64 {
    (a.x_m() - b.x_m()).hypot(a.y_m() - b.y_m())
}

/// Closures between any places of different sessions, as sure as true ones.
fn made_up(
    true_ones: usize,
    share: f64,
    cuts: &[Range<usize>],
    spacing_m: f64,
    random: &mut ChaCha8Rng,
) -> Vec<Link> {
    let noise = ClosureNoise::of_spacing(spacing_m);
    let deviations = nalgebra::Vector3::new(noise.position_m, noise.position_m, noise.heading_rad);
    let variances = nalgebra::Matrix3::from_diagonal(&deviations.map(|deviation| deviation * deviation));
    let count = (true_ones as f64 * share / (1.0 - share)).round() as usize;
    let places = cuts.last().map_or(0, |cut| cut.end) as u32;
    let mut made_up = Vec::new();
    while made_up.len() < count {
        let [to, from] = [random.random_range(0..places), random.random_range(0..places)];
        let session = |place: u32| cuts.iter().position(|cut| cut.contains(&(place as usize)));
        let heading = PlanarPose::new(0.0, 0.0, 0.3 * (random.random::<f64>() - 0.5));
        if let Some(measured) =
            RelativePose::new(heading, variances).ok().filter(|_| session(to) < session(from))
        {
            made_up.push(Link { from, to, kind: LinkKind::Closed(measured) });
        }
    }
    made_up
}

/// The closures between two pieces, as matches.
fn between(source: &Piece, target: &Piece, closed: &[Link]) -> Vec<PlaceMatch> {
    let number = |piece: &Piece, place: u32| {
        piece.places.iter().position(|&other| other == place as usize).map(|place| place as u32)
    };
    let matched = |link: &Link| {
        let LinkKind::Closed(measured) = link.kind else { return None };
        let (source, target, measured) = match (number(source, link.to), number(target, link.from)) {
            (Some(to), Some(from)) => (to, from, measured),
            _ => (number(source, link.from)?, number(target, link.to)?, measured.back()),
        };
        Some(PlaceMatch {
            source,
            target,
            source_frame: u64::from(source),
            target_frame: u64::from(target),
            posterior: 1.0,
            view: None,
            measured: Some(measured),
        })
    };
    closed.iter().filter_map(matched).collect()
}
