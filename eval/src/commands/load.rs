//! `waypost-eval load`: a real server in a process of its own, and robots that drive it over gRPC.

mod contents;
mod growth;
mod leading;
mod overload;
mod panoramas;
mod report;
mod robot;
mod robots;
mod server;
mod stalled;
mod words;

pub use growth::{GrowthOptions, GrowthReport};
pub use leading::{LeadingOptions, LeadingReport};
pub use overload::{OverloadOptions, OverloadReport};
pub use panoramas::{PanoramasOptions, PanoramasReport};
pub use report::{LatencyReport, ServerUse};
pub use robots::{RobotsOptions, RobotsReport};
pub use words::{WordsOptions, WordsReport};

use std::path::PathBuf;

use crate::error::EvalError;

/// The server that is put under load.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerOptions {
    /// The program; `waypost-server` beside this one if `None`.
    pub binary: Option<PathBuf>,
    /// The model file that its map is made with.
    pub model: PathBuf,
}

/// Where robots take their words from.
#[derive(Clone, Debug, PartialEq)]
pub enum WordSource {
    /// A folder of images: words with keypoints, made beforehand.
    Images(PathBuf),
    /// The training images of the model, as its sampling set remembers them: histograms.
    SamplingSet,
}

/// Streams of words into one map, and what the server adds to the time of computing.
///
/// # Errors
/// [`EvalError`].
pub fn words(server: &ServerOptions, options: &WordsOptions) -> Result<WordsReport, EvalError> {
    let report = block_on(words::run(server, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

/// Several times more images than the server can work off, and how it gets over that.
///
/// # Errors
/// [`EvalError`].
pub fn overload(server: &ServerOptions, options: &OverloadOptions) -> Result<OverloadReport, EvalError> {
    let report = block_on(overload::run(server, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

/// Four robots in one map, alone and beside clients that do not read their answers.
///
/// # Errors
/// [`EvalError`].
pub fn robots(server: &ServerOptions, options: &RobotsOptions) -> Result<RobotsReport, EvalError> {
    let report = block_on(robots::run(server, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

/// Robots that are led along one map, and how long they wait for commands.
///
/// # Errors
/// [`EvalError`].
pub fn leading(server: &ServerOptions, options: &LeadingOptions) -> Result<LeadingReport, EvalError> {
    let report = block_on(leading::run(server, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

/// Panoramas into maps with and without an appearance graph.
///
/// # Errors
/// [`EvalError`].
pub fn panoramas(server: &ServerOptions, options: &PanoramasOptions) -> Result<PanoramasReport, EvalError> {
    let report = block_on(panoramas::run(server, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

/// A map that grows large; the server is as [`ServerOptions::binary`] says.
///
/// # Errors
/// [`EvalError`].
pub fn growth(binary: Option<PathBuf>, options: &GrowthOptions) -> Result<GrowthReport, EvalError> {
    let report = block_on(growth::run(binary, options))?;
    eprint!("{}", report.table());
    Ok(report)
}

fn block_on<T>(scenario: impl Future<Output = Result<T, EvalError>>) -> Result<T, EvalError> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build();
    runtime.map_err(EvalError::Runtime)?.block_on(scenario)
}
