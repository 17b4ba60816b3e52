//! A graph through the index against one of all pairs, and links between places that look alike.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use fabmap::chow_liu::TreeTrainingSettings;
use fabmap::descriptor::Descriptors;
use fabmap::detector::DetectorModel;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::model::{Model, ModelTrainingSettings};
use fabmap::vocabulary::VocabularySettings;
use serde::Serialize;
use topomap::appearance_graph::candidates::CandidateIndex;
use topomap::appearance_graph::{AppearanceGraph, Checks, ImageId, Overlap, Panorama};
use topomap::mapper::ArchiveError;
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::panorama::PanoramicView;

use super::AppearanceError;
use super::eye::{Eye, TaughtMap, compared_with_all, scattered};
use crate::commands::map::training::FIRST_TRAINING_SEED;
use crate::error::EvalError;

/// Words of the panoramas' vocabulary.
const WORDS: u32 = 3_000;

/// Buildings that the words are learnt in.
const TRAINING_BUILDINGS: u64 = 3;

/// From image to image in metres: as many as are wanted find place in the large office.
const SPACING_M: f64 = 0.5;

/// Images that the index names.
const NAMED: usize = 64;

/// Checks in a row without a link after which an image is done.
pub const MISSES: usize = 4;

/// Two images that are further apart share no room, or too little to be told.
const FAR_M: f64 = 6.0;

/// What the index saves, and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IndexFigures {
    /// Panoramas.
    pub panoramas: usize,
    /// Links of the graph where each is compared with each.
    pub links: usize,
    /// Comparisons of each with each.
    pub pair_checks_of_all: usize,
    /// Comparisons through the index.
    pub pair_checks: usize,
    /// The first over the second.
    pub pair_check_ratio: f64,
    /// Share of the links that the index does not lead to.
    pub links_lost_fraction: f64,
    /// Seconds for the graph through the index, words and comparisons, on one thread.
    pub seconds: f64,
    /// Links between images that are further apart than 6 m.
    pub links_far_apart: usize,
}

/// Links of a building whose offices look alike.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LookAlikeFigures {
    /// Panoramas.
    pub panoramas: usize,
    /// Links, each compared with each.
    pub links: usize,
    /// Links between images that are further apart than 6 m.
    pub links_far_apart: usize,
    /// Pairs that are further apart.
    pub pairs_far_apart: usize,
    /// The largest similarity of a pair that is further apart.
    pub similarity_far_apart_max: f64,
}

/// A view on its way into a graph of others.
struct Coming<'a> {
    eye: &'a Eye,
    view: &'a PanoramicView,
    earlier: &'a [PanoramicView],
}

impl Panorama for Coming<'_> {
    fn overlap(&self, image: ImageId) -> Result<Option<Overlap>, ArchiveError> {
        Ok(self.view.compare(&self.earlier[image as usize], &self.eye.search).overlap)
    }
}

/// Builds the graph of so many panoramas of the large office both ways.
///
/// # Errors
/// [`EvalError`] if no words can be learnt.
pub fn measure(eye: &Eye, panoramas: usize, seed: u64) -> Result<IndexFigures, EvalError> {
    let model = train(eye)?;
    let plan = NamedWorld::Office.plan(seed);
    let mut poses = scattered(&plan, SPACING_M, seed);
    poses.truncate(panoramas);
    let scene = Scene::new(plan);
    let views = eye.see_all(&scene, &poses, seed)?;
    let all = compared_with_all(eye, &views);
    let started = Instant::now();
    let (found, pair_checks) = through_index(eye, &model, &views)?;
    let seconds = started.elapsed().as_secs_f64();
    let links = all.links().count();
    let lost = all.links().filter(|(from, link)| found.similarity(*from, link.to).is_none()).count();
    let is_far = |from: u32, to: u32| poses[from as usize].distance_m(&poses[to as usize]) > FAR_M;
    let pair_checks_of_all = views.len() * views.len().saturating_sub(1) / 2;
    Ok(IndexFigures {
        panoramas: views.len(),
        links,
        pair_checks_of_all,
        pair_checks,
        pair_check_ratio: pair_checks_of_all as f64 / pair_checks.max(1) as f64,
        links_lost_fraction: lost as f64 / links.max(1) as f64,
        seconds,
        links_far_apart: all.links().filter(|(from, link)| is_far(*from, link.to)).count(),
    })
}

/// Compares all images of a building with offices that differ in a fifth of their texture.
///
/// # Errors
/// [`AppearanceError`] if an image shows nothing.
pub fn look_alikes(eye: &Eye, seed: u64) -> Result<LookAlikeFigures, AppearanceError> {
    let map = TaughtMap::new(eye, NamedWorld::Corridors.plan(seed), 1.2, seed)?;
    let is_far = |a: usize, b: usize| map.poses[a].distance_m(&map.poses[b]) > FAR_M;
    let far: Vec<f64> = map
        .graph
        .links()
        .filter(|(from, link)| is_far(*from as usize, link.to as usize))
        .map(|(_, link)| link.similarity)
        .collect();
    let count = map.poses.len();
    Ok(LookAlikeFigures {
        panoramas: count,
        links: map.graph.links().count(),
        links_far_apart: far.len(),
        pairs_far_apart: (0..count).map(|a| (0..a).filter(|&b| is_far(a, b)).count()).sum(),
        similarity_far_apart_max: far.into_iter().fold(0.0, f64::max),
    })
}

/// Image by image: words, the index's candidates, comparisons.
fn through_index(
    eye: &Eye,
    model: &Model,
    views: &[PanoramicView],
) -> Result<(AppearanceGraph, usize), EvalError> {
    let observation_model = ObservationModel::new(model.tree(), *model.detector(), Dependence::ChowLiu);
    let mut index = CandidateIndex::new(Arc::new(observation_model));
    let (mut graph, mut checks) = (AppearanceGraph::default(), 0);
    for (image, view) in views.iter().enumerate() {
        let words = model.vocabulary().observe(view.descriptors());
        let observation =
            words.map_err(|reason| EvalError::Map(crate::commands::map::MapError::Vocabulary(reason)))?;
        let coming = Coming { eye, view, earlier: &views[..image] };
        let named = index.most_likely(&observation, NAMED);
        let added = graph.add(&coming, named, Checks::UntilMisses(MISSES)).map_err(AppearanceError::from)?;
        checks += added.checks;
        index.add(&observation);
    }
    Ok((graph, checks))
}

/// Words of panoramas, from buildings that nothing is reported of.
fn train(eye: &Eye) -> Result<Model, EvalError> {
    let mut seen: Vec<Descriptors> = Vec::new();
    for seed in FIRST_TRAINING_SEED..FIRST_TRAINING_SEED + TRAINING_BUILDINGS {
        let plan = NamedWorld::Office.plan(seed);
        let poses = scattered(&plan, 1.5, seed);
        let views = eye.see_all(&Scene::new(plan), &poses, seed)?;
        seen.extend(views.iter().map(|view| view.descriptors().clone()));
    }
    let settings = ModelTrainingSettings {
        vocabulary: VocabularySettings { words: WORDS, ..VocabularySettings::default() },
        tree: TreeTrainingSettings::default(),
        detector: DetectorModel::default(),
    };
    let name = eye.extractor_settings().to_string();
    Ok(Model::train(&name, &seen, &settings, &mut |_| ControlFlow::Continue(()))?)
}
