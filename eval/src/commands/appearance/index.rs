//! A graph through the index against one of all pairs.

use std::ops::ControlFlow;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rayon::prelude::*;
use serde::Serialize;
use waypost_navigation::appearance::graph::candidates::{CandidateIndex, IndexedFeature};
use waypost_navigation::appearance::graph::{
    AppearanceGraph, Checks, ImageId, LINK_SIMILARITY, Overlap, Panorama,
};
use waypost_navigation::appearance::signature::Signatures;
use waypost_sim::pose::Pose;
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::panorama::PanoramicView;

use super::eye::{Acuity, Eye, scattered};
use crate::commands::map::training::FIRST_TRAINING_SEED;
use crate::timing::thread_seconds;
use crate::{files, memory};

/// Buildings that the words are learnt in.
const TRAINING_BUILDINGS: u64 = 3;

/// From image to image in metres: some 1,200 find place in the large office.
const SPACING_M: f64 = 0.5;

/// Two images that are further apart share no room, or too little to be told.
const FAR_M: f64 = 6.0;

/// How large a graph is made, and how much of it is looked over.
#[derive(Args)]
pub(super) struct IndexOptions {
    /// Panoramas of the graph that is made through the index, of as many buildings as have room for them.
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u16).range(2..=5000))]
    panoramas: u16,
    /// Panoramas that are compared with all others, to see which links the index does not lead to; all if there are no
    /// more.
    #[arg(long, value_name = "N", default_value_t = 600, value_parser = clap::value_parser!(u16).range(1..))]
    reference: u16,
    /// How fine the panoramas of that graph are: 512x128 with 300 features, or 1024x256 with 500.
    #[arg(long, value_name = "ACUITY", value_enum, default_value_t = Acuity::Coarse)]
    acuity: Acuity,
    /// Model with the words of the index [default: they are learnt of panoramas of three other buildings].
    #[arg(long, value_name = "FILE", conflicts_with = "words")]
    model: Option<PathBuf>,
    /// How many words are learnt.
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(2..=20_000))]
    words: u32,
}

/// What the index saves, and what it costs.
#[derive(Serialize)]
pub(crate) struct IndexFigures {
    /// Panoramas.
    pub panoramas: usize,
    /// Buildings that they are of.
    pub buildings: usize,
    /// Panoramas that were compared with all others.
    pub reference: usize,
    /// Links that those have.
    pub links: usize,
    /// Comparisons of each with each.
    pub pair_checks_of_all: usize,
    /// Comparisons through the index.
    pub pair_checks: usize,
    /// The first over the second.
    pub pair_check_ratio: f64,
    /// Share of the links that the index does not lead to.
    pub links_lost_fraction: f64,
    /// Similarities of the links that it does not lead to, the largest first.
    pub lost_similarities: Vec<f64>,
    /// Links between images that are further apart than 6 m, or of different buildings.
    pub links_far_apart: usize,
    /// Time on the processor for the graph through the index, on one thread: words and signatures, votes, comparisons.
    /// `None` where the system does not tell, as all times.
    pub seconds: Option<IndexSeconds>,
    /// Time on the processor for comparing all pairs on one thread, by the pairs that were compared.
    pub seconds_of_all: Option<f64>,
    /// The longest that one panorama took through the index, in milliseconds.
    pub panorama_ms_max: Option<f64>,
    /// What the index takes, in MiB.
    pub index_mib: f64,
    /// The most memory that was held so far, in MiB.
    pub peak_mib: Option<f64>,
}

/// Where the time goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct IndexSeconds {
    /// Words, and where within their words features lie.
    pub words: f64,
    /// Votes, and taking the panorama into the index.
    pub votes: f64,
    /// Comparisons of two panoramas.
    pub comparisons: f64,
    /// All of it.
    pub total: f64,
}

/// Panoramas of some buildings.
struct Seen {
    views: Vec<PanoramicView>,
    /// Building and pose of each.
    poses: Vec<(u64, Pose)>,
}

/// What came of the index.
struct Built {
    graph: AppearanceGraph,
    checks: usize,
    seconds: Option<IndexSeconds>,
    panorama_ms_max: Option<f64>,
    index_mib: f64,
}

/// A comparison of two images, the later one first.
struct Compared {
    images: (ImageId, ImageId),
    similarity: f64,
}

/// A view on its way into a graph of others.
struct Coming<'a> {
    eye: &'a Eye,
    view: &'a PanoramicView,
    earlier: &'a [PanoramicView],
}

impl Panorama for Coming<'_> {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        self.view.compare(&self.earlier[image as usize], &self.eye.search).overlap
    }
}

/// Builds the graph of panoramas of the large office through the index, and looks which links it lacks.
pub(super) fn measure(options: &IndexOptions, seed: u64) -> Result<IndexFigures> {
    let eye = &Eye::new(options.acuity)?;
    let vocabulary = match &options.model {
        Some(path) => files::read_model(path)?.0.vocabulary().clone(),
        None => train(eye, options.words)?,
    };
    let seen = see(eye, usize::from(options.panoramas), seed)?;
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let built = one_thread.install(|| through_index(eye, &vocabulary, &seen.views))?;
    let (compared, compared_seconds) = compared_with_all(eye, &seen.views, usize::from(options.reference));
    let links: Vec<&Compared> = compared.iter().filter(|pair| pair.similarity > LINK_SIMILARITY).collect();
    let is_lost = |pair: &&&Compared| built.graph.similarity(pair.images.0, pair.images.1).is_none();
    let mut lost: Vec<f64> = links.iter().filter(is_lost).map(|pair| pair.similarity).collect();
    lost.sort_by(|a, b| b.total_cmp(a));
    let is_far = |pair: &&&Compared| {
        let [a, b] = [pair.images.0, pair.images.1].map(|image| &seen.poses[image as usize]);
        a.0 != b.0 || a.1.distance_m(&b.1) > FAR_M
    };
    let panoramas = seen.views.len();
    let pair_checks_of_all = panoramas * panoramas.saturating_sub(1) / 2;
    Ok(IndexFigures {
        panoramas,
        buildings: seen.poses.last().map_or(0, |(last, _)| (last - seed + 1) as usize),
        reference: usize::from(options.reference).min(panoramas),
        links: links.len(),
        pair_checks_of_all,
        pair_checks: built.checks,
        pair_check_ratio: pair_checks_of_all as f64 / built.checks.max(1) as f64,
        links_lost_fraction: lost.len() as f64 / links.len().max(1) as f64,
        lost_similarities: lost,
        links_far_apart: links.iter().filter(is_far).count(),
        seconds: built.seconds,
        seconds_of_all: compared_seconds
            .map(|seconds| seconds * pair_checks_of_all as f64 / compared.len().max(1) as f64),
        panorama_ms_max: built.panorama_ms_max,
        index_mib: built.index_mib,
        peak_mib: memory::peak_mib(),
    })
}

/// So many panoramas, of building after building.
fn see(eye: &Eye, panoramas: usize, first_seed: u64) -> Result<Seen> {
    let mut seen = Seen { views: Vec::new(), poses: Vec::new() };
    for seed in first_seed.. {
        let plan = NamedWorld::Office.plan(seed);
        let mut poses = scattered(&plan, SPACING_M, seed);
        poses.truncate(panoramas - seen.views.len());
        seen.views.extend(eye.see_all(&Scene::new(plan), &poses, seed)?);
        seen.poses.extend(poses.into_iter().map(|pose| (seed, pose)));
        if seen.views.len() == panoramas {
            break;
        }
    }
    Ok(seen)
}

/// Image by image: words, votes, comparisons.
fn through_index(eye: &Eye, vocabulary: &Vocabulary, views: &[PanoramicView]) -> Result<Built> {
    let signatures = Signatures::new(vocabulary);
    let mut index = CandidateIndex::default();
    let mut graph = AppearanceGraph::default();
    let mut checks = 0;
    let mut seconds = Some(IndexSeconds::default());
    let mut slowest = 0.0_f64;
    for (image, view) in views.iter().enumerate() {
        let began = thread_seconds();
        let words = vocabulary.words(view.descriptors())?;
        let signed = signatures.sign(&words, view.descriptors())?.into_iter();
        let features: Vec<IndexedFeature> =
            signed.zip(view.rays()).map(|(word, ray)| IndexedFeature::new(word, ray)).collect();
        let signed = thread_seconds();
        let votes = index.votes(&features);
        index.add(&features);
        let voted = thread_seconds();
        let coming = Coming { eye, view, earlier: &views[..image] };
        checks += graph.add(&coming, Checks::Promising(&votes)).checks;
        seconds = seconds.zip(began).zip(signed).zip(voted).zip(thread_seconds()).map(
            |((((so_far, began), signed), voted), compared)| {
                slowest = slowest.max(compared - began);
                so_far.and([began, signed, voted, compared])
            },
        );
    }
    let index_mib = index.memory_bytes() as f64 / f64::from(1 << 20);
    let panorama_ms_max = seconds.map(|_| 1e3 * slowest);
    Ok(Built { graph, checks, seconds, panorama_ms_max, index_mib })
}

impl IndexSeconds {
    /// One panorama more, with the times between its stages.
    fn and(self, [began, signed, voted, compared]: [f64; 4]) -> Self {
        Self {
            words: self.words + signed - began,
            votes: self.votes + voted - signed,
            comparisons: self.comparisons + compared - voted,
            total: self.total + compared - began,
        }
    }
}

/// Compares so many images with all others, and each pair once; and the time that took, by each thread's own clock.
fn compared_with_all(eye: &Eye, views: &[PanoramicView], reference: usize) -> (Vec<Compared>, Option<f64>) {
    let count = views.len();
    let is_reference: Vec<bool> =
        (0..count).map(|image| reference >= count || image * reference % count < reference).collect();
    let row = |image: usize| {
        let began = thread_seconds();
        let others = (0..image).filter(|&other| is_reference[image] || is_reference[other]);
        let pairs: Vec<Compared> = others
            .map(|other| {
                let overlap = views[image].compare(&views[other], &eye.search).overlap;
                let similarity = overlap.map_or(0.0, |overlap| overlap.similarity());
                Compared { images: (image as ImageId, other as ImageId), similarity }
            })
            .collect();
        (pairs, thread_seconds().zip(began).map(|(ended, began)| ended - began))
    };
    let (pairs, seconds): (Vec<Vec<Compared>>, Vec<Option<f64>>) =
        (0..count).into_par_iter().map(row).unzip();
    (pairs.into_iter().flatten().collect(), seconds.into_iter().sum())
}

/// Words of panoramas, from buildings that nothing is reported of.
fn train(eye: &Eye, words: u32) -> Result<Vocabulary> {
    let mut rows: Vec<u8> = Vec::new();
    let mut kind = DescriptorKind::Float;
    let mut width = 0;
    for seed in FIRST_TRAINING_SEED..FIRST_TRAINING_SEED + TRAINING_BUILDINGS {
        let plan = NamedWorld::Office.plan(seed);
        let poses = scattered(&plan, 1.5, seed);
        for view in eye.see_all(&Scene::new(plan), &poses, seed)? {
            kind = view.descriptors().kind();
            width = view.descriptors().width();
            rows.extend_from_slice(view.descriptors().as_bytes());
        }
    }
    let descriptors = Descriptors::new(kind, width, rows)?;
    let settings = VocabularySettings { words, ..VocabularySettings::default() };
    Ok(Vocabulary::train(&descriptors, &settings, &mut |_| ControlFlow::Continue(()))?)
}
