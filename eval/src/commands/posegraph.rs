//! `waypost-eval posegraph`: relaxes a pose graph, and says what it cost.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use posegraph::g2o::{G2o, NamedGraph};
use posegraph::{Closures, Edge, EdgeKind, Pose, PoseGraph, RelaxationSettings, Relaxed, Start, relax};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::error::{fault, refused};
use crate::files;
use crate::timing::median;

/// Relax a pose graph: SE(2) or SE(3), from odometry alone unless told otherwise.
///
/// The cost is the sum of eᵀΩe, without a factor of one half: g2o's chi2. Edges between consecutive ids are odometry,
/// all others closures.
#[derive(Args)]
pub(crate) struct PoseGraphOptions {
    /// The graph, as g2o writes it (VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX).
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Judge closures, and leave out those that contradict what most agree on; `cost` counts those kept.
    #[arg(long)]
    robust: bool,
    /// Where to start from: along odometry, rotations first, both (the lower minimum counts), or the file's vertices.
    #[arg(long, value_enum, default_value_t)]
    start: GraphStart,
    /// Add wrong closures, as many as this share of the file's own, rounded up: between poses drawn at random, measured
    /// as another closure is. The report then says what the file's own edges cost.
    #[arg(long, value_name = "SHARE", value_parser = share)]
    false_loops: Option<f64>,
    /// Seed of the wrong closures.
    #[arg(long, value_name = "S", default_value_t = 0, requires = "false_loops")]
    seed: u64,
    /// How often the optimisation is run; its time is the median.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// The file to write the relaxed graph to; it has all edges.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Where relaxation starts from.
#[derive(Clone, Copy, Debug, Default, Serialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum GraphStart {
    /// Along odometry.
    Odometry,
    /// Rotations first.
    Chordal,
    /// Both of these; the lower minimum counts.
    #[default]
    Best,
    /// Where the file has its vertices.
    File,
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if share > 0.0 && share <= 1.0 => Ok(share),
        Ok(_) | Err(_) => Err("give a share above 0, at most 1".to_owned()),
    }
}

/// What came out.
#[derive(Serialize)]
pub(crate) struct PoseGraphReport {
    /// 2 or 3.
    pub dimensions: usize,
    /// Poses of the graph.
    pub poses: usize,
    /// Edges of the graph, false ones among them.
    pub edges: usize,
    /// Edges that are not between consecutive poses.
    pub closures: usize,
    /// Where it started from.
    pub start: GraphStart,
    /// Whether closures were judged.
    pub mode: &'static str,
    /// Cost of all edges at the start; null if there were several starts.
    pub start_cost: Option<f64>,
    /// Sum of eᵀΩe over all edges but those judged wrong, without a factor of one half.
    pub cost: f64,
    /// The same over all edges.
    pub cost_of_all: f64,
    /// Steps taken or tried.
    pub iterations: usize,
    /// Time of the optimisation from the start, in milliseconds; the median if it was repeated. The start itself
    /// counts only where there are several, or closures are judged.
    pub ms: f64,
    /// Ids of the ends of the closures that were judged wrong.
    pub left_out: Vec<[u64; 2]>,
    /// What is known because closures were added that are wrong; null if none were.
    pub false_loops: Option<FalseLoopsReport>,
}

/// How wrong closures were dealt with.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct FalseLoopsReport {
    /// Wrong closures added.
    pub added: usize,
    /// Those that were not judged wrong.
    pub kept: usize,
    /// Closures of the file that were.
    pub true_left_out: usize,
    /// Cost of the file's own edges.
    pub true_cost: f64,
    /// Their least cost, relaxed by themselves.
    pub optimum: f64,
    /// One over the other.
    pub optimum_ratio: f64,
}

/// Reads, relaxes and perhaps writes a graph.
pub(crate) fn run(options: &PoseGraphOptions) -> Result<PoseGraphReport> {
    let bytes = files::read(&options.file)?;
    let read = G2o::read(&bytes).with_context(|| options.file.display().to_string())?;
    let (report, relaxed) = match &read {
        G2o::Planar(graph) => {
            let (report, relaxed) = relax_named(graph, options)?;
            (report, G2o::Planar(relaxed))
        }
        G2o::Spatial(graph) => {
            let (report, relaxed) = relax_named(graph, options)?;
            (report, G2o::Spatial(relaxed))
        }
    };
    if let Some(out) = &options.out {
        files::write(out, &relaxed.write())?;
    }
    Ok(report)
}

fn relax_named<P: Pose<D>, const D: usize>(
    named: &NamedGraph<P, D>,
    options: &PoseGraphOptions,
) -> Result<(PoseGraphReport, NamedGraph<P, D>)> {
    let file = options.file.display();
    let graph = match options.false_loops {
        Some(share) => with_false_loops(named.graph(), share, options.seed).ok_or_else(|| {
            refused(format!(
                "{file} has no closures, whose measurements false ones would have; leave out --false-loops"
            ))
        })?,
        None => named.graph().clone(),
    };
    let closures = if options.robust { Closures::Judged } else { Closures::Trusted };
    let settings = RelaxationSettings { closures, ..RelaxationSettings::default() };
    let no_vertices = || refused(format!("{file} has no VERTEX lines to start from; choose --start best"));
    let start = match options.start {
        GraphStart::Odometry => Start::Odometry,
        GraphStart::Chordal => Start::Chordal,
        GraphStart::Best => Start::Best,
        GraphStart::File => Start::Poses(named.poses().ok_or_else(no_vertices)?),
    };
    // Where there is one start, it is made before the watch runs.
    let first = match (start, closures) {
        (Start::Best, _) | (_, Closures::Judged) => None,
        (_, Closures::Trusted) => {
            Some(relax(&graph, start, &RelaxationSettings { max_iterations: 0, ..settings }).poses)
        }
    };
    let start = first.as_deref().map_or(start, Start::Poses);
    let (relaxed, ms) = timed(options.repeats, || relax(&graph, start, &settings));

    let edges = graph.edges();
    let is_closure = |edge: &&Edge<P, D>| edge.kind() == EdgeKind::Closure;
    let ids = |edge: &Edge<P, D>| [named.ids()[edge.from()], named.ids()[edge.to()]];
    let left_out = edges.iter().zip(&relaxed.weights).filter(|&(_, &weight)| weight == 0.0);
    let report = PoseGraphReport {
        dimensions: P::SPACE,
        poses: graph.poses(),
        edges: edges.len(),
        closures: edges.iter().filter(is_closure).count(),
        start: options.start,
        mode: if options.robust { "judged" } else { "trusted" },
        start_cost: first.as_deref().map(|poses| graph.cost(poses)),
        cost: relaxed.cost,
        cost_of_all: graph.cost(&relaxed.poses),
        iterations: relaxed.iterations,
        ms,
        left_out: left_out.map(|(edge, _)| ids(edge)).collect(),
        false_loops: options.false_loops.map(|_| judged(named.graph(), &relaxed)),
    };
    let out = NamedGraph::new(named.ids().to_vec(), graph, Some(relaxed.poses));
    Ok((report, out.map_err(fault)?))
}

/// The graph with wrong closures behind its own edges; `None` if it has no closure to take measurements from.
fn with_false_loops<P: Pose<D>, const D: usize>(
    graph: &PoseGraph<P, D>,
    share: f64,
    seed: u64,
) -> Option<PoseGraph<P, D>> {
    let closures: Vec<&Edge<P, D>> =
        graph.edges().iter().filter(|edge| edge.kind() == EdgeKind::Closure).collect();
    if closures.is_empty() || graph.poses() < 3 {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut wrong = graph.clone();
    let wanted = graph.edges().len() + (share * closures.len() as f64).ceil() as usize;
    while wrong.edges().len() < wanted {
        let [from, to] = [(); 2].map(|()| random.random_range(0..graph.poses()));
        let measured = closures[random.random_range(0..closures.len())];
        if from.abs_diff(to) < 2 {
            continue;
        }
        let edge = Edge::new(from, to, *measured.measurement(), *measured.information(), EdgeKind::Closure);
        edge.ok().and_then(|edge| wrong.add_edge(edge).ok())?;
    }
    Some(wrong)
}

/// Compares with what the file's own edges come to by themselves; they are the first.
fn judged<P: Pose<D>, const D: usize>(own: &PoseGraph<P, D>, relaxed: &Relaxed<P>) -> FalseLoopsReport {
    let trusted = RelaxationSettings { closures: Closures::Trusted, ..RelaxationSettings::default() };
    let optimum = relax(own, Start::Best, &trusted).cost;
    let true_cost = own.cost(&relaxed.poses);
    let (of_file, added) = relaxed.weights.split_at(own.edges().len());
    FalseLoopsReport {
        added: added.len(),
        kept: added.iter().filter(|&&weight| weight > 0.0).count(),
        true_left_out: of_file.iter().filter(|&&weight| weight == 0.0).count(),
        true_cost,
        optimum,
        optimum_ratio: true_cost / optimum,
    }
}

fn timed<T>(repeats: u32, work: impl Fn() -> T) -> (T, f64) {
    let once = || {
        let began = Instant::now();
        let outcome = work();
        (outcome, began.elapsed().as_secs_f64() * 1e3)
    };
    let (outcome, first) = once();
    let mut times = vec![first];
    times.extend((1..repeats).map(|_| once().1));
    (outcome, median(times).unwrap_or(first))
}
