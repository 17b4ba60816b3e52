//! `waypost-eval posegraph`.

use std::path::PathBuf;

use clap::Args;
use topomap::relaxation::Closures;
use waypost_eval::choices::{GRAPH_STARTS, name_of};
use waypost_eval::commands::posegraph::{self, FalseLoops, GraphStart, PoseGraphOptions};
use waypost_eval::error::EvalError;

use crate::arguments::values::choice;
use crate::print_if;

/// Relax a pose graph: SE(2) or SE(3), from odometry alone unless told otherwise.
///
/// The cost is the sum of eᵀΩe, without a factor of one half: g2o's chi2. Edges between consecutive ids are odometry,
/// all others closures.
#[derive(Args)]
pub(crate) struct PosegraphArguments {
    /// The graph, as g2o writes it (VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT, FIX).
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Judge closures, and leave out those that contradict what most agree on; `cost` counts those kept.
    #[arg(long)]
    robust: bool,
    /// Where to start from: along odometry, rotations first, both (the lower minimum counts), or the file's vertices.
    #[arg(long, value_parser = choice(GRAPH_STARTS), default_value = name_of(GRAPH_STARTS, &GraphStart::default()))]
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
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl PosegraphArguments {
    pub(crate) fn run(self) -> Result<(), EvalError> {
        let Self { file, robust, start, false_loops, seed, repeats, out, json } = self;
        let closures = if robust { Closures::Judged } else { Closures::Trusted };
        let false_loops = false_loops.map(|share| FalseLoops { share, seed });
        print_if(
            json,
            &posegraph::run(&PoseGraphOptions { file, start, closures, false_loops, repeats, out })?,
        )
    }
}

fn share(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().map_err(|error| error.to_string())?;
    if value > 0.0 && value <= 1.0 { Ok(value) } else { Err("give a share above 0, at most 1".to_owned()) }
}
