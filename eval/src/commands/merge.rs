//! `waypost-eval merge`: drives become maps, maps become one, and that is held against the truth.

pub mod kitti;
pub mod large;
pub mod passes;
mod picture;
mod sessions;
mod world;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use fabmap::model::Model;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use topomap::mapper::MapperSettings;
use topomap::merging::{MergePlan, MergeSettings, PlaceMatch, Verdict, find_matches, join, judge};
use topomap::odometry_prior::PlaceSpacing;
use topomap::relative_pose::{ClosureNoise, RelativePose};
use topomap::relaxation::{PlanarPose, Pose};
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::Extractor;
use waypost_vision::verification::Verifier;

use self::world::{Between, TrueMap, map_all};
use super::map::alignment::{Alignment, rmse_m};
use super::map::drive::DrivenFrame;
use super::map::judgement::{REVISIT_RAD, is_far};
use super::map::{ModelSource, WheelChoice, model_of};
use crate::error::EvalError;
use crate::timing::median;
use crate::{files, progress};

/// What is merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MergeScenario {
    /// A drive, cut into two to four sessions.
    Sessions,
    /// Five robots in one building.
    Robots,
    /// A drive in each of two buildings with the same offices in another arrangement: nothing may merge.
    LookAlike,
}

/// What to merge, with what, and how often.
#[derive(Clone, Debug, PartialEq)]
pub struct MergeOptions {
    /// What is merged.
    pub scenario: MergeScenario,
    /// The route of [`MergeScenario::Sessions`], in the office.
    pub route: String,
    /// Of the first trial; the next ones take the next seeds.
    pub seed: u64,
    /// Trials, at least 1.
    pub trials: u32,
    /// Where the model comes from.
    pub model: ModelSource,
    /// How wrong the wheels are.
    pub wheels: WheelChoice,
    /// How the maps decide.
    pub settings: MapperSettings,
    /// What a merge has to show.
    pub merge: MergeSettings,
    /// Of all matches that are judged, the share that is made up, in [0, 1).
    pub false_share: f64,
    /// Folder for the pictures.
    pub out: Option<PathBuf>,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MergeReport {
    /// What was merged.
    pub scenario: &'static str,
    /// Of the first trial.
    pub seed: u64,
    /// Trials.
    pub trials: u32,
    /// Share of matches that were made up.
    pub false_match_share: f64,
    /// Median error of the trajectories on the merged map, after the best rigid alignment.
    pub rmse_m: f64,
    /// The largest.
    pub rmse_m_worst: f64,
    /// Median of the error over that of the map built in one go, where there is one.
    pub rmse_ratio: Option<f64>,
    /// The largest.
    pub rmse_ratio_worst: Option<f64>,
    /// Merges.
    pub merges: usize,
    /// Merges most of whose matches are of different places.
    pub false_merges: usize,
    /// Maps that stayed apart although they overlap.
    pub missed_overlaps: usize,
    /// Matches of merges.
    pub matches: usize,
    /// Those of them that are of different places.
    pub false_matches: usize,
    /// Median time from two maps to one.
    pub seconds: f64,
    /// Trial by trial.
    pub runs: Vec<MergeRun>,
}

/// One trial.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MergeRun {
    /// Its seed.
    pub seed: u64,
    /// Maps before.
    pub maps: usize,
    /// Places of each.
    pub places: Vec<usize>,
    /// See [`MergeReport::merges`].
    pub merges: usize,
    /// See [`MergeReport::false_merges`].
    pub false_merges: usize,
    /// See [`MergeReport::missed_overlaps`].
    pub missed_overlaps: usize,
    /// See [`MergeReport::matches`].
    pub matches: usize,
    /// See [`MergeReport::false_matches`].
    pub false_matches: usize,
    /// See [`MergeReport::rmse_m`].
    pub rmse_m: f64,
    /// The same of the map built in one go.
    pub one_go_rmse_m: Option<f64>,
    /// Of each merge or refusal.
    pub seconds: Vec<f64>,
    /// What was said of each pair of maps.
    pub said: Vec<String>,
}

/// Places of one map that are truly places of another, from which two maps overlap: more than a turn on the spot.
const OVERLAP_PLACES: usize = 12;

impl MergeScenario {
    /// All, by the names that command lines have for them.
    pub const ALL: &'static [(&'static str, MergeScenario)] = &[
        ("sessions", MergeScenario::Sessions),
        ("robots", MergeScenario::Robots),
        ("look-alike", MergeScenario::LookAlike),
    ];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, scenario)| *scenario == self).map_or("", |(name, _)| name)
    }
}

/// A building and the sessions in it.
struct Staged {
    scene: Arc<Scene>,
    sessions: Vec<Vec<DrivenFrame>>,
    /// The same frames as they were driven, where it was one drive.
    whole: Option<Vec<DrivenFrame>>,
    /// The building of each session.
    buildings: Vec<usize>,
}

/// Stages, maps, merges, and judges.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &MergeOptions) -> Result<MergeReport, EvalError> {
    let (model, extractor) = model_of(&options.model)?;
    if let Some(out) = &options.out {
        files::create_folder(out)?;
    }
    let bar = progress::bar("trials", options.trials as usize);
    let mut runs = Vec::new();
    for seed in (options.seed..).take(options.trials as usize) {
        runs.push(trial(options, seed, &model, extractor)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let report = MergeReport::of(options, runs);
    eprint!("{}", report.table());
    Ok(report)
}

fn trial(
    options: &MergeOptions,
    seed: u64,
    model: &Model,
    extractor: Extractor,
) -> Result<MergeRun, EvalError> {
    let staged = stage(options, seed)?;
    let maps = map_all(&staged.sessions, model, extractor, options.settings)?;
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
                    let events = join((&source.mapper, &merged.mapper), &plan, &source.log.0)
                        .map_err(EvalError::Join)?;
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
        let one_go = TrueMap::of(0, whole, model, extractor, options.settings)?;
        let (poses, truth) = one_go.trajectory();
        run.one_go_rmse_m = Some(rmse_m(&poses, &truth, Alignment::Rigid));
    }
    if let Some(out) = &options.out {
        let name = |what: &str| out.join(format!("{}-{seed}-{what}.svg", options.scenario.name()));
        files::write(&name("inputs"), picture::inputs(&staged.scene, &maps).as_bytes())?;
        files::write(&name("merged"), picture::merged(&staged.scene, &merged).as_bytes())?;
    }
    Ok(run)
}

fn stage(options: &MergeOptions, seed: u64) -> Result<Staged, EvalError> {
    let MergeOptions { scenario, route, wheels, .. } = options;
    Ok(match scenario {
        MergeScenario::Sessions => {
            let (drive, sessions) = sessions::cut_drive(NamedWorld::Office, route, seed, *wheels)?;
            let buildings = vec![0; sessions.len()];
            Staged { scene: drive.scene, sessions, whole: Some(drive.frames), buildings }
        }
        MergeScenario::Robots => {
            let (scene, sessions) = sessions::robots(NamedWorld::Office, seed, *wheels)?;
            let buildings = vec![0; sessions.len()];
            Staged { scene, sessions, whole: None, buildings }
        }
        MergeScenario::LookAlike => {
            let (drive, sessions) = sessions::look_alikes(seed, *wheels)?;
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
) -> Result<Verdict, EvalError> {
    let views = Between { source, target, verifier: Verifier::new(options.settings.verification, 0) };
    let began = Instant::now();
    let mut matches = find_matches(source.known(), target.known(), &views, &options.merge, &())?;
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    matches.extend(made_up(&matches, options.false_share, source, target, &mut random));
    let verdict = judge(source.layout(), target.layout(), &matches, &options.merge);
    run.seconds.push(began.elapsed().as_secs_f64());
    run.said.push(match &verdict {
        Verdict::Overlap(plan) => format!(
            "{} of {} matches, rival {}, {} of {} places confirmed, cost {:.0} to {:.0}",
            plan.matches.len(),
            matches.len(),
            plan.rival_support,
            plan.overlap.confirmed,
            plan.overlap.places,
            plan.cost_before,
            plan.cost_after,
        ),
        Verdict::Apart(apart) => apart.to_string(),
    });
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
        let wrong = plan.matches.iter().filter(is_false).count();
        self.merges += 1;
        self.matches += plan.matches.len();
        self.false_matches += wrong;
        self.false_merges += usize::from(2 * wrong > plan.matches.len());
    }
}

impl TrueMap {
    fn makers_of(&self, place: u32) -> Option<&world::TrueFrame> {
        self.frame(self.mapper.map().places().get(place as usize)?.frames.first()?.frame)
    }
}

impl MergeReport {
    fn of(options: &MergeOptions, runs: Vec<MergeRun>) -> Self {
        let sum = |of: fn(&MergeRun) -> usize| runs.iter().map(of).sum();
        let ratio = |run: &MergeRun| run.one_go_rmse_m.map(|one_go| run.rmse_m / one_go);
        let most = |values: Vec<f64>| values.into_iter().reduce(f64::max);
        let errors: Vec<f64> = runs.iter().map(|run| run.rmse_m).collect();
        let ratios: Vec<f64> = runs.iter().filter_map(ratio).collect();
        Self {
            scenario: options.scenario.name(),
            seed: options.seed,
            trials: options.trials,
            false_match_share: options.false_share,
            rmse_m: median(errors.clone()).unwrap_or(0.0),
            rmse_m_worst: most(errors).unwrap_or(0.0),
            rmse_ratio: median(ratios.clone()),
            rmse_ratio_worst: most(ratios),
            merges: sum(|run| run.merges),
            false_merges: sum(|run| run.false_merges),
            missed_overlaps: sum(|run| run.missed_overlaps),
            matches: sum(|run| run.matches),
            false_matches: sum(|run| run.false_matches),
            seconds: median(runs.iter().flat_map(|run| run.seconds.clone()).collect()).unwrap_or(0.0),
            runs,
        }
    }

    fn table(&self) -> String {
        let mut table = format!(
            "{}, {} trials\nseed  maps  merges  false  missed  matches  false  rmse m  one go m\n",
            self.scenario, self.trials
        );
        for run in &self.runs {
            let one_go = run.one_go_rmse_m.map_or("–".to_owned(), |metres| format!("{metres:.2}"));
            table += &format!(
                "{:<6}{:>4}{:>8}{:>7}{:>8}{:>9}{:>7}{:>8.2}{one_go:>10}\n",
                run.seed,
                run.maps,
                run.merges,
                run.false_merges,
                run.missed_overlaps,
                run.matches,
                run.false_matches,
                run.rmse_m,
            );
        }
        table
            + &format!(
                "rmse {:.2} m, at most {:.2} m; over that of one go {}; {} merges, {} false; {} missed; {:.2} s\n",
                self.rmse_m,
                self.rmse_m_worst,
                self.rmse_ratio.map_or("–".to_owned(), |ratio| format!("{ratio:.2}")),
                self.merges,
                self.false_merges,
                self.missed_overlaps,
                self.seconds,
            )
    }
}
