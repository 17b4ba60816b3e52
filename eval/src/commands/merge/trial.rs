//! One trial: a building, the sessions in it, and what comes of merging their maps.

use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use fabmap::model::Model;
use posegraph::{PlanarPose, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use topomap::evidence::ClosureNoise;
use topomap::merging::{MergePlan, PlaceMatch, Verdict, find_matches, join, judge, pairs_to_compare};
use topomap::metric::{PlaceSpacing, RelativePose};
use topomap::settings::MapperSettings;
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Extractor;
use waypost_vision::verification::Verifier;

use super::report::{MergeRun, said};
use super::world::{TrueFrame, TrueMap, compared, map_all};
use super::{MergeOptions, MergeScenario, picture, sessions};
use crate::choices::own_name;
use crate::commands::map::alignment::{Alignment, rmse_m};
use crate::commands::map::drive::DrivenFrame;
use crate::commands::map::judgement::{REVISIT_RAD, is_far};
use crate::error::fault;
use crate::event_log::layout;
use crate::files;

/// Places of one map that are truly places of another, from which two maps overlap: more than a turn on the spot.
const OVERLAP_PLACES: usize = 12;

/// A building and the sessions in it.
struct Staged {
    scene: Arc<Scene>,
    sessions: Vec<Vec<DrivenFrame>>,
    /// The same frames as they were driven, where it was one drive.
    whole: Option<Vec<DrivenFrame>>,
    /// The building of each session.
    buildings: Vec<usize>,
}

/// Stages, maps and merges with one seed.
pub(super) fn run(
    options: &MergeOptions,
    seed: u64,
    model: &Model,
    extractor: Extractor,
) -> Result<MergeRun> {
    let staged = stage(options, seed)?;
    let maps = map_all(&staged.sessions, model, extractor, MapperSettings::default())?;
    let mut run = MergeRun {
        seed,
        maps: maps.len(),
        places: maps.iter().map(|map| map.mapper.map().places().len()).collect(),
        ..MergeRun::default()
    };
    let mut left = maps.clone();
    let mut merged = left.remove(0);
    // A map that overlaps with none yet may with what another one brings.
    loop {
        let before = left.len();
        let mut apart = Vec::new();
        for source in left {
            match meet(options, seed, &source, &merged, &mut run)? {
                Verdict::Overlap(plan) => {
                    run.judge(&plan, &source, &merged, &staged.buildings);
                    let events =
                        join((&source.mapper, &merged.mapper), &plan, &source.log.0).map_err(fault)?;
                    merged.take(&source, events)?;
                }
                Verdict::Apart(_) => apart.push(source),
            }
        }
        left = apart;
        if left.len() == before || left.is_empty() {
            break;
        }
    }
    run.missed_overlaps =
        left.iter().filter(|source| overlap(source, &merged, &staged.buildings) >= OVERLAP_PLACES).count();
    let (poses, truth) = merged.trajectory();
    run.rmse_m = rmse_m(&poses, &truth, Alignment::Rigid);
    if let Some(whole) = &staged.whole {
        let one_go = TrueMap::of(0, whole, model, extractor, MapperSettings::default())?;
        let (poses, truth) = one_go.trajectory();
        run.one_go_rmse_m = Some(rmse_m(&poses, &truth, Alignment::Rigid));
    }
    if let Some(out) = &options.out {
        let name = |what: &str| out.join(format!("{}-{seed}-{what}.svg", own_name(&options.scenario)));
        files::write(&name("inputs"), picture::inputs(&staged.scene, &maps).as_bytes())?;
        files::write(&name("merged"), picture::merged(&staged.scene, &merged).as_bytes())?;
    }
    Ok(run)
}

fn stage(options: &MergeOptions, seed: u64) -> Result<Staged> {
    let wheels = options.wheels();
    Ok(match options.scenario {
        MergeScenario::Sessions => {
            let (drive, sessions) = sessions::cut_drive(NamedWorld::Office, &options.route, seed, wheels)?;
            let buildings = vec![0; sessions.len()];
            Staged { scene: drive.scene, sessions, whole: Some(drive.frames), buildings }
        }
        MergeScenario::Robots => {
            let (scene, sessions) = sessions::robots(NamedWorld::Office, seed, wheels)?;
            let buildings = vec![0; sessions.len()];
            Staged { scene, sessions, whole: None, buildings }
        }
        MergeScenario::LookAlike => {
            let (drive, sessions) = sessions::look_alikes(seed, wheels)?;
            Staged { scene: drive.scene, sessions, whole: None, buildings: vec![0, 1] }
        }
    })
}

/// What is said of two maps.
fn meet(
    options: &MergeOptions,
    seed: u64,
    source: &TrueMap,
    target: &TrueMap,
    run: &mut MergeRun,
) -> Result<Verdict> {
    let verifier = Verifier::new(MapperSettings::default().verification, 0);
    let settings = options.merge();
    let began = Instant::now();
    let pairs = pairs_to_compare(source.known(), target.known(), &settings, &())?;
    let comparisons: Vec<_> =
        pairs.par_iter().map(|pair| compared(source, target, pair, &verifier)).collect();
    let mut matches = find_matches(source.known(), target.known(), &pairs, &comparisons, &settings);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    matches.extend(made_up(&matches, options.false_matches, source, target, &mut random));
    let verdict = judge(layout(&source.mapper), layout(&target.mapper), &matches, &settings);
    run.seconds.push(began.elapsed().as_secs_f64());
    run.said.push(said(&verdict, matches.len()));
    Ok(verdict)
}

/// Matches of any places, as strong as true ones, turned by anything.
fn made_up(
    matches: &[PlaceMatch],
    share: f64,
    source: &TrueMap,
    target: &TrueMap,
    random: &mut ChaCha8Rng,
) -> Vec<PlaceMatch> {
    let noise = ClosureNoise::of_spacing(target.mapper.settings().place_spacing.distance_m);
    let places = |map: &TrueMap| map.mapper.map().places().len() as u32;
    let count = (matches.len() as f64 * share / (1.0 - share)).round() as usize;
    let mut made_up = Vec::new();
    for _ in 0..count {
        let like = matches[random.random_range(0..matches.len())];
        let heading = PlanarPose::new(0.0, 0.0, 0.3 * (random.random::<f64>() - 0.5));
        let covariance = *like.measured.unwrap_or_else(|| noise.somewhere()).covariance();
        made_up.push(PlaceMatch {
            source: random.random_range(0..places(source)),
            target: random.random_range(0..places(target)),
            measured: RelativePose::new(heading, covariance).ok(),
            ..like
        });
    }
    made_up
}

/// Places of one map that are truly places of another.
fn overlap(source: &TrueMap, target: &TrueMap, buildings: &[usize]) -> usize {
    let again = PlaceSpacing { angle_rad: REVISIT_RAD, ..target.mapper.settings().place_spacing };
    let building = |map: &TrueMap| map.frames.iter().flatten().next().map(|frame| buildings[frame.drive]);
    if building(source) != building(target) {
        return 0;
    }
    let known = target.makers();
    let is_known =
        |place: &&PlanarPose| known.iter().any(|known| again.holds(&known.inverse().compose(place)));
    source.makers().iter().filter(is_known).count()
}

impl MergeRun {
    fn judge(&mut self, plan: &MergePlan, source: &TrueMap, target: &TrueMap, buildings: &[usize]) {
        let is_false = |matched: &&PlaceMatch| {
            let frames = source.makers_of(matched.source).zip(target.makers_of(matched.target));
            frames.is_none_or(|(source, target)| {
                buildings[source.drive] != buildings[target.drive]
                    || is_far(&target.pose.inverse().compose(&source.pose))
            })
        };
        self.count(plan, plan.matches.iter().filter(is_false).count());
    }
}

impl TrueMap {
    fn makers_of(&self, place: u32) -> Option<&TrueFrame> {
        self.frame(self.mapper.map().places().get(place as usize)?.frames.first()?.frame)
    }
}
