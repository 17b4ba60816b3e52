//! `waypost-eval`: the command line of the evaluation.

mod arguments;

use std::fmt::Display;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Args, CommandFactory, Parser, Subcommand};
use fabmap::likelihood::Dependence;
use fabmap::new_place::NewPlaceMethod;
use fabmap::place_filter::FilterSettings;
use fabmap::recognizer::{RecognizerSettings, Scorer};
use fabmap::vocabulary::VocabularySettings;
use serde::Serialize;
use topomap::map::MAX_PAST_FRAMES;
use topomap::mapper::MapperSettings;
use topomap::relaxation::Closures;
use topomap::verification::VerificationMethod;
use waypost_eval::choices::{
    Choices, DEPENDENCES, DETECTORS, GRAPH_STARTS, NEW_PLACE_METHODS, RANKINGS, RankingName, SCORERS,
    VERIFICATION_METHODS, name_of, value_of,
};
use waypost_eval::commands::calibrate::{self, CalibrateOptions, DetectorChoice};
use waypost_eval::commands::compare::{self, CompareFile, CompareOptions, Configuration, ConfigurationEntry};
use waypost_eval::commands::load::{
    self, GrowthOptions, LeadingOptions, OverloadOptions, PanoramasOptions, RobotsOptions, ServerOptions,
    WordSource, WordsOptions,
};
use waypost_eval::commands::map::kitti::{self, KittiOptions};
use waypost_eval::commands::map::{self, MapOptions, ModelSource, WheelChoice, training::MapTraining};
use waypost_eval::commands::new_place::{self, NewPlaceOptions, WorkloadSource};
use waypost_eval::commands::posegraph::{self, FalseLoops, GraphStart, PoseGraphOptions};
use waypost_eval::commands::scale::{self, Compared, ScaleOptions, ScaleSource};
use waypost_eval::commands::sequence::{self, Knobs, SequenceOptions, System};
use waypost_eval::commands::train::{self, TrainOptions, VocabularySource};
use waypost_eval::commands::train_scale::{
    self, DescriptorOptions, TreeScaleOptions, VocabularyScaleOptions,
};
use waypost_eval::commands::visits::{self, VisitsOptions};
use waypost_eval::error::EvalError;
use waypost_eval::workload::WorkloadSettings;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::features::{Feature, FeatureSettings};

use arguments::merge::MergeArguments;
use arguments::navigate::NavigateArguments;

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Train(arguments) => arguments.run(),
        Command::Calibrate(arguments) => arguments.run(),
        Command::Sequence(arguments) => arguments.run(),
        Command::NewPlace(arguments) => arguments.run(),
        Command::Scale(arguments) => arguments.run(),
        Command::Compare(arguments) => arguments.run(),
        Command::Visits(arguments) => arguments.run(),
        Command::Load(arguments) => arguments.run(),
        Command::TrainScale(arguments) => arguments.run(),
        Command::Posegraph(arguments) => arguments.run(),
        Command::Map(arguments) => arguments.run(),
        Command::Navigate(arguments) => arguments.run(),
        Command::Appearance(arguments) => {
            let json = arguments.json;
            arguments.run().and_then(|report| print_if(json, &report))
        }
        Command::Merge(arguments) => arguments.run(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Measures Waypost: trains models, runs sequences in process and judges what is recognised, puts a server
/// under load.
///
/// Tables and progress go to stderr. Exit codes: 0 done, 1 failed, 2 wrong arguments.
#[derive(Parser)]
#[command(name = "waypost-eval", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Train(TrainArguments),
    Calibrate(CalibrateArguments),
    Sequence(Box<SequenceArguments>),
    Compare(CompareArguments),
    Visits(Box<VisitsArguments>),
    NewPlace(NewPlaceArguments),
    Scale(ScaleArguments),
    Load(LoadArguments),
    TrainScale(TrainScaleArguments),
    Posegraph(PosegraphArguments),
    Map(Box<MapArguments>),
    Navigate(NavigateArguments),
    Appearance(arguments::appearance::AppearanceArguments),
    Merge(Box<MergeArguments>),
}

/// Train a model (vocabulary, Chow-Liu tree, sampling set) from folders of images.
#[derive(Args)]
struct TrainArguments {
    /// Folders of JPEG or PNG images, or folders with a subfolder images/ of them.
    #[arg(long, required = true, num_args = 1.., value_name = "DIR")]
    images: Vec<PathBuf>,
    /// The local feature that words are made of.
    #[arg(long, default_value = FeatureSettings::default().feature().name(), value_parser = features())]
    feature: Feature,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "N", default_value_t = VocabularySettings::default().words)]
    words: u32,
    /// Seed of the random choices; the same images and seed give the same model.
    #[arg(long, value_name = "S", default_value_t = VocabularySettings::default().seed)]
    seed: u64,
    /// Take the words from an ORB vocabulary as text (ORBvoc.txt, as DBoW2 writes it) instead of the
    /// images; needs --feature orb.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["words", "seed"])]
    orb_vocabulary: Option<PathBuf>,
    /// How reliable words are: published rates, those with an exponent learnt that tempers likelihoods, or
    /// rates and exponent learnt from images that overlap the one before.
    #[arg(long, value_parser = choice(DETECTORS), default_value = name_of(DETECTORS, &DetectorChoice::default()))]
    detector: DetectorChoice,
    /// The model file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Most features taken from an image.
    #[arg(long, value_name = "N", default_value_t = FeatureSettings::default().max_features())]
    max_features: u32,
    /// Width that larger images are shrunk to, in pixels.
    #[arg(long, value_name = "PX", default_value_t = FeatureSettings::default().image_width())]
    image_width: u32,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// Learn anew how reliable a model's words are, from the training images that it remembers.
///
/// Words stay the same, so that maps can be bound to the new model.
#[derive(Args)]
struct CalibrateArguments {
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// As for `train`.
    #[arg(long, value_parser = choice(DETECTORS), default_value = name_of(DETECTORS, &DetectorChoice::Learned))]
    detector: DetectorChoice,
    /// The model file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// Stream a sequence with known loops once, in order, and judge the earlier frame proposed for each.
///
/// Writes precision_recall.csv and .svg, reliability.svg, match_matrix.png, frames.csv and summary.json.
#[derive(Args)]
struct SequenceArguments {
    /// Folder with images/, loops.csv and optionally ignore.csv (query_index,match_index).
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Frames closer than this many are not loops.
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..))]
    gap: u32,
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Seed of the random choices, which the verification makes.
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    system: SystemArguments,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// The system to judge, with its settings.
#[derive(Args)]
struct SystemArguments {
    #[arg(long, value_name = "P", help = with_default(
        "Posterior (with tf-idf: cosine) from which a loop closure is accepted",
        MapperSettings::default().closure_threshold,
    ))]
    threshold: Option<f64>,
    /// The system to judge.
    #[arg(long, value_parser = choice(RANKINGS), default_value = name_of(RANKINGS, &RankingName::default()))]
    ranking: RankingName,
    #[command(flatten)]
    knobs: KnobArguments,
}

/// Run several configurations over several sequences, and write one table and one plot.
///
/// Writes compare.md, compare.csv, compare.json and compare.svg (precision over recall, a panel for every
/// sequence), and beside them a folder for every run as `sequence` writes it.
///
/// The file has a table for every sequence and for every configuration; relative paths are taken from the
/// file's own folder:
///
///     [[sequence]]
///     path = "data/hall"                  # images/, loops.csv; its name is the folder's, or name = "..."
///     gap = 30                            # as for `sequence`
///     model = "indoor.waypost"            # within the configuration's folder of models
///
///     [[configuration]]
///     name = "default"
///
///     [[configuration]]
///     name = "tf-idf"
///     flags = "--ranking tf-idf"          # what `sequence` would be given
///     models = "other-models"             # folder of the models, if it is another
#[derive(Args)]
#[command(verbatim_doc_comment)]
struct CompareArguments {
    /// The TOML file that says what to compare.
    #[arg(value_name = "FILE")]
    comparison: PathBuf,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// The flags of a configuration in the file of a comparison.
#[derive(Parser)]
#[command(name = "flags", no_binary_name = true, disable_help_flag = true)]
struct ConfigurationFlags {
    #[command(flatten)]
    system: SystemArguments,
}

/// Learn one or two visits of the same places, and query with the later ones: does recognition get better?
///
/// Every choice of earlier visits is tried, and all visits from the third on count alike.
#[derive(Args)]
struct VisitsArguments {
    /// Folder with images/ and loops.csv: the same places in the same order, visit after visit.
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Places of a visit.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    places: u32,
    /// The model file, as `train` writes it.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    #[command(flatten)]
    knobs: KnobArguments,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

/// The paper's choices; of FAB-MAP alone.
#[derive(Args)]
#[command(next_help_heading = "FAB-MAP")]
struct KnobArguments {
    #[arg(long = "verify", value_parser = choice(VERIFICATION_METHODS), help = with_default(
        "Geometry that has to agree before a loop is closed",
        name_of(VERIFICATION_METHODS, &MapperSettings::default().verification.method),
    ))]
    verification: Option<VerificationMethod>,
    #[arg(long, value_name = "INLIERS", help = with_default(
        "Least evidence of a verified closure",
        MapperSettings::default().verification.min_evidence,
    ))]
    min_evidence: Option<f64>,
    #[arg(long, value_name = "FRAMES", help = with_default(
        "Earlier frames whose matches speak for those near them",
        MapperSettings::default().verification.consistency_frames,
    ))]
    consistency_frames: Option<u64>,
    #[arg(long, value_parser = choice(DEPENDENCES), help = with_default(
        "Whether words depend on each other",
        name_of(DEPENDENCES, &RecognizerSettings::default().dependence),
    ))]
    dependence: Option<Dependence>,
    #[arg(long, value_parser = choice(NEW_PLACE_METHODS), help = with_default(
        "What stands in for places nobody has seen",
        name_of(NEW_PLACE_METHODS, &RecognizerSettings::default().new_place),
    ))]
    new_place: Option<NewPlaceMethod>,
    #[arg(long, value_parser = choice(SCORERS), help = with_default(
        "How likelihoods are evaluated; the values are the same",
        name_of(SCORERS, &RecognizerSettings::default().scorer),
    ))]
    scorer: Option<Scorer>,
    /// p(z=1|e=1): how often a scene element that exists is seen [default: the model's].
    #[arg(long, value_name = "P")]
    true_positive_rate: Option<f64>,
    /// p(z=1|e=0): how often one is seen that does not exist [default: the model's].
    #[arg(long, value_name = "P")]
    false_positive_rate: Option<f64>,
    #[arg(long, value_name = "P", help = with_default(
        "p(new): prior probability of a place never seen",
        FilterSettings::default().new_place_prior,
    ))]
    new_place_prior: Option<f64>,
    #[arg(long, value_name = "SIGMA", help = with_default(
        "Weight of the normalised likelihoods against an even distribution; 1 is no smoothing",
        FilterSettings::default().likelihood_smoothing,
    ))]
    smoothing: Option<f64>,
    #[arg(long, value_name = "EPSILON", help = with_default(
        "Share of the prior that is spread evenly over all places whatever the motion",
        FilterSettings::default().even_share,
    ))]
    even_share: Option<f64>,
}

/// Ask synthetic maps of growing size about places they have and places they do not, and count how often
/// each new-place method takes one for the other.
///
/// With --out, writes new_place.json and new_place.svg.
#[derive(Args)]
struct NewPlaceArguments {
    /// Sizes of the maps.
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [100, 1_000, 10_000],
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    places: Vec<u32>,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "V", default_value_t = WorkloadSettings::default().words,
          value_parser = clap::value_parser!(u32).range(1..))]
    words: u32,
    /// Observations in the sampling set.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Queries from new places, and as many revisits.
    #[arg(long, value_name = "N", default_value_t = 2_000, value_parser = clap::value_parser!(u32).range(1..))]
    queries: u32,
    /// Seed of tree, places and queries.
    #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
    seed: u64,
    /// Take tree, places, samples and queries from the files of the numpy generator instead.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["places", "words", "samples", "queries", "seed"])]
    workload: Option<PathBuf>,
    /// Posterior from which the most probable place counts as accepted.
    #[arg(long, value_name = "P", default_value_t = 0.5)]
    threshold: f64,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl NewPlaceArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { places, words, samples, queries, seed, workload, threshold, out, json } = self;
        let settings = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
        let drawn = WorkloadSource::Drawn { settings, places, samples, queries };
        let source = workload.map_or(drawn, WorkloadSource::Files);
        print_if(json, &new_place::run(&NewPlaceOptions { source, threshold, out })?)
    }
}

/// Grow a synthetic map and measure what a filter update, a new place and a look cost, and what the index takes.
///
/// A filter update is everything from a query's words to the normalised posterior and its top ten. With --out,
/// writes scale.json and scale.svg.
#[derive(Args)]
struct ScaleArguments {
    /// Places of the map.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    places: u32,
    /// Number of words of the vocabulary.
    #[arg(long, value_name = "V", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
    words: u32,
    /// Threads that a query is spread over.
    #[arg(long, value_name = "T", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=256))]
    threads: u16,
    /// Most looks at a place: it is looked at from once to so often, and shows half of its words each time.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=15))]
    most_looks: u8,
    /// Observations in the sampling set.
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Queries, revisits and new places in turn.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..))]
    queries: u32,
    /// Seed of tree, places and queries.
    #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
    seed: u64,
    /// Take tree, places, samples and queries from the files of the numpy generator instead.
    #[arg(long, value_name = "DIR",
          conflicts_with_all = ["places", "words", "most_looks", "samples", "queries", "seed"])]
    workload: Option<PathBuf>,
    /// How places nobody has seen are stood in for.
    #[arg(long, value_parser = choice(NEW_PLACE_METHODS),
          default_value = name_of(NEW_PLACE_METHODS, &RecognizerSettings::default().new_place))]
    new_place: NewPlaceMethod,
    /// Compare the dense scorer with places dropped early and without; takes a byte for each word of each place.
    #[arg(long)]
    bail_out: bool,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl ScaleArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { places, words, threads, most_looks, samples, queries, seed, workload, .. } = self;
        let settings = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
        let drawn = ScaleSource::Drawn { settings, places, most_looks, samples, queries };
        let source = workload.map_or(drawn, ScaleSource::Files);
        let (threads, new_place, out) = (usize::from(threads), self.new_place, self.out);
        let compared = if self.bail_out { Compared::BailOut } else { Compared::Nothing };
        print_if(self.json, &scale::run(&ScaleOptions { source, threads, new_place, compared, out })?)
    }
}

/// Put a real server under load: it is started on a temporary directory, driven over gRPC, and stopped.
#[derive(Args)]
struct LoadArguments {
    #[command(subcommand)]
    scenario: Scenario,
    /// The model that the server's map is made with.
    #[arg(long, global = true, value_name = "FILE", default_value = "demo/model.waypost")]
    model: PathBuf,
    /// The server [default: waypost-server beside this program].
    #[arg(long, global = true, value_name = "FILE")]
    server_binary: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum Scenario {
    /// Many word streams into one map: what a frame takes beyond computing.
    Words {
        #[command(flatten)]
        source: WordSourceArguments,
        /// Robots.
        #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=1000))]
        streams: u32,
        /// Frames a second of each robot.
        #[arg(long, value_name = "HZ", default_value_t = 2.0, value_parser = positive)]
        rate_hz: f64,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
    },
    /// More images than the server can work off: goodput, memory, recovery.
    Overload {
        /// Folder of JPEG or PNG images.
        #[arg(long, value_name = "DIR")]
        images: PathBuf,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
        /// How many times the peak goodput is offered.
        #[arg(long, value_name = "TIMES", default_value_t = 5.0, value_parser = positive)]
        factor: f64,
    },
    /// A map that grows large: what looks wait for beside its checkpoints, and how long it takes to open. Its words
    /// are drawn, and so is its model.
    Growth {
        /// Frames, each of another place.
        #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        places: u32,
        /// Number of words of the vocabulary.
        #[arg(long, value_name = "V", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
        words: u32,
        /// Looks a second at places of the grown map.
        #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = positive)]
        rate_hz: f64,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
    },
    /// Robots that are led along one map: how long they wait for commands.
    Leading {
        /// Folder of JPEG or PNG images, which the map is made of and the robots see.
        #[arg(long, value_name = "DIR")]
        images: PathBuf,
        /// Robots.
        #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=200))]
        robots: u32,
        /// Wheel reports a second of each.
        #[arg(long, value_name = "HZ", default_value_t = 25.0, value_parser = positive)]
        rate_hz: f64,
        /// How long.
        #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
        seconds: f64,
    },
    /// Panoramas into maps with and without an appearance graph: answers' latencies, and how long the graph takes to be built
    /// anew.
    Panoramas {
        /// Panoramas, taken all over a simulated office.
        #[arg(long, value_name = "N", default_value_t = 600)]
        panoramas: usize,
        /// Panoramas a second.
        #[arg(long, value_name = "HZ", default_value_t = 4.0, value_parser = positive)]
        rate_hz: f64,
        /// Of building and poses.
        #[arg(long, value_name = "S", default_value_t = 1)]
        seed: u64,
    },
    /// Four robots in one map, alone and beside clients that do not read their answers.
    Robots {
        #[command(flatten)]
        source: WordSourceArguments,
        /// Frames a second of each robot.
        #[arg(long, value_name = "HZ", default_value_t = 5.0, value_parser = positive)]
        rate_hz: f64,
        /// How long, each time.
        #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = positive)]
        seconds: f64,
    },
}

#[derive(Args)]
#[group(required = true)]
struct WordSourceArguments {
    /// Folder of JPEG or PNG images that words are made of beforehand.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Words of the model's sampling set, so that no images are needed.
    #[arg(long, conflicts_with = "images")]
    synthetic: bool,
}

impl LoadArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { scenario, model, server_binary, json } = self;
        let server = ServerOptions { binary: server_binary, model };
        match scenario {
            Scenario::Growth { places, words, rate_hz, seconds } => {
                let workload = WorkloadSettings { words, ..WorkloadSettings::default() };
                let duration = Duration::from_secs_f64(seconds);
                let options = GrowthOptions { workload, places, rate_hz, duration };
                print_if(json, &load::growth(server.binary, &options)?)
            }
            Scenario::Words { source, streams, rate_hz, seconds } => {
                let (source, duration) = (source.source(), Duration::from_secs_f64(seconds));
                print_if(json, &load::words(&server, &WordsOptions { source, streams, rate_hz, duration })?)
            }
            Scenario::Overload { images, seconds, factor } => {
                let duration = Duration::from_secs_f64(seconds);
                print_if(json, &load::overload(&server, &OverloadOptions { images, duration, factor })?)
            }
            Scenario::Leading { images, robots, rate_hz, seconds } => {
                let duration = Duration::from_secs_f64(seconds);
                print_if(
                    json,
                    &load::leading(&server, &LeadingOptions { images, robots, rate_hz, duration })?,
                )
            }
            Scenario::Panoramas { panoramas, rate_hz, seed } => {
                print_if(json, &load::panoramas(&server, &PanoramasOptions { panoramas, rate_hz, seed })?)
            }
            Scenario::Robots { source, rate_hz, seconds } => {
                let (source, duration) = (source.source(), Duration::from_secs_f64(seconds));
                print_if(json, &load::robots(&server, &RobotsOptions { source, rate_hz, duration })?)
            }
        }
    }
}

impl WordSourceArguments {
    fn source(self) -> WordSource {
        let Self { images, synthetic: _ } = self;
        images.map_or(WordSource::SamplingSet, WordSource::Images)
    }
}

/// Measure training and quantization at the size of large models.
#[derive(Args)]
struct TrainScaleArguments {
    #[command(subcommand)]
    part: TrainScalePart,
    /// Print one JSON object on stdout.
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Subcommand)]
enum TrainScalePart {
    /// Extract descriptors of images into a file of rows, for `vocabulary`.
    Descriptors {
        /// Folders of JPEG or PNG images, or folders with a subfolder images/ of them.
        #[arg(long, required = true, num_args = 1.., value_name = "DIR")]
        images: Vec<PathBuf>,
        /// The local feature.
        #[arg(long, default_value = Feature::Sift.name(), value_parser = features())]
        feature: Feature,
        /// Most features taken from an image.
        #[arg(long, value_name = "N", default_value_t = FeatureSettings::default().max_features())]
        max_features: u32,
        /// Width that larger images are shrunk to, in pixels.
        #[arg(long, value_name = "PX", default_value_t = FeatureSettings::default().image_width())]
        image_width: u32,
        /// The file to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Train a vocabulary on a file of rows; time it and its quantization, and hold that against comparing
    /// with every word.
    Vocabulary {
        /// File of rows to train on.
        #[arg(long, value_name = "FILE")]
        descriptors: PathBuf,
        /// How many of them, evenly spread [default: all].
        #[arg(long, value_name = "N")]
        count: Option<usize>,
        /// File of rows of other images, to quantize.
        #[arg(long, value_name = "FILE")]
        queries: PathBuf,
        /// The local feature that both files hold.
        #[arg(long, default_value = Feature::Sift.name(), value_parser = features())]
        feature: Feature,
        /// Number of words.
        #[arg(long, value_name = "N")]
        words: u32,
        /// Seed of the random choices.
        #[arg(long, value_name = "S", default_value_t = VocabularySettings::default().seed)]
        seed: u64,
        /// File for the centres of the words, as rows.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Learn a Chow-Liu tree from images of the synthetic workload.
    Tree {
        /// Words of the vocabulary.
        #[arg(long, value_name = "N", default_value_t = 100_000)]
        words: u32,
        /// Images to learn from.
        #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..))]
        images: u32,
        /// Seed of tree and images.
        #[arg(long, value_name = "S", default_value_t = WorkloadSettings::default().seed)]
        seed: u64,
    },
}

impl TrainScaleArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { part, json } = self;
        match part {
            TrainScalePart::Descriptors { images, feature, max_features, image_width, out } => {
                let features = FeatureSettings::new(feature, max_features, image_width)
                    .map_err(EvalError::FeatureSettings)?;
                print_if(json, &train_scale::write_descriptors(&DescriptorOptions { images, features, out })?)
            }
            TrainScalePart::Vocabulary { descriptors, count, queries, feature, words, seed, out } => {
                let vocabulary = VocabularySettings { words, seed, ..VocabularySettings::default() };
                let count = count.unwrap_or(usize::MAX);
                let options =
                    VocabularyScaleOptions { descriptors, count, queries, feature, vocabulary, out };
                print_if(json, &train_scale::train_vocabulary(&options)?)
            }
            TrainScalePart::Tree { words, images, seed } => {
                let workload = WorkloadSettings { words, seed, ..WorkloadSettings::default() };
                print_if(json, &train_scale::train_tree(&TreeScaleOptions { workload, images })?)
            }
        }
    }
}

/// Drive a simulated robot along a route, map it in process and hold the map against the truth.
///
/// Each trial is another world, other wheels and other noise. Times are those of one thread. With --out, writes map.json
/// and for each trial map-SEED.svg: raw odometry, corrected map and truth over the floor plan.
#[derive(Args)]
struct MapArguments {
    /// The world.
    #[arg(long, default_value = NamedWorld::Office.name(), value_parser = worlds())]
    world: NamedWorld,
    /// One of its routes.
    #[arg(long, value_name = "NAME", required_unless_present = "kitti")]
    route: Option<String>,
    /// In place of a simulated world, a drive of known poses without images: a folder with poses.txt and loops.csv. Its
    /// true loops stand in for recognition, simulated wheels for its odometry; the map layer works alone.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["route", "world", "trials", "model", "out", "prior_frames",
          "verification", "feature", "words", "training_drives", "model_out"])]
    kitti: Option<PathBuf>,
    /// Seed of the first trial; the next ones take the next seeds.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Drives.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    trials: u32,
    /// The model file; without it, a model is trained on drives in other worlds.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["feature", "words", "training_drives", "model_out"])]
    model: Option<PathBuf>,
    /// The local feature that words are made of.
    #[arg(long, default_value = Feature::Orb.name(), value_parser = features())]
    feature: Feature,
    /// Number of words.
    #[arg(long, value_name = "N", default_value_t = MapTraining::default().words)]
    words: u32,
    /// Drives that the model is trained on.
    #[arg(long, value_name = "N", default_value_t = MapTraining::default().drives,
          value_parser = clap::value_parser!(u32).range(1..=1000))]
    training_drives: u32,
    /// File for the trained model.
    #[arg(long, value_name = "FILE")]
    model_out: Option<PathBuf>,
    /// Of the wheels: measured way = (1 + X) true way [default: drawn for each trial, within 0.05].
    #[arg(long, value_name = "X", requires = "drift_rad_per_m", allow_hyphen_values = true)]
    scale_error: Option<f64>,
    /// Of the wheels: turn that they see where there is none [default: drawn for each trial, within 3 degrees].
    #[arg(long, value_name = "RAD", requires = "scale_error", allow_hyphen_values = true)]
    drift_rad_per_m: Option<f64>,
    /// Frames that the prior looks back on.
    #[arg(long, value_name = "FRAMES", default_value_t = MAX_PAST_FRAMES as u32,
          value_parser = clap::value_parser!(u32).range(1..=MAX_PAST_FRAMES as i64))]
    prior_frames: u32,
    #[arg(long = "verify", value_parser = choice(VERIFICATION_METHODS), help = "Geometry that has to agree",
          default_value = name_of(VERIFICATION_METHODS, &MapperSettings::default().verification.method))]
    verification: VerificationMethod,
    /// Folder for the results; made if it does not exist.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl MapArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { world, route, kitti, seed, trials, prior_frames, verification, out, json, .. } = self;
        let wheels = match (self.scale_error, self.drift_rad_per_m) {
            (Some(scale), Some(drift_rad_per_m)) => WheelChoice::Biased { scale, drift_rad_per_m },
            (Some(_) | None, Some(_) | None) => WheelChoice::Drawn,
        };
        if let Some(folder) = kitti {
            return print_if(json, &kitti::run(&KittiOptions { folder, seed, wheels })?);
        }
        let route = route.unwrap_or_default();
        let default = MapTraining::default().features;
        let features = FeatureSettings::new(self.feature, default.max_features(), default.image_width())
            .map_err(EvalError::FeatureSettings)?;
        let training = MapTraining { features, words: self.words, drives: self.training_drives };
        let model = self.model.map_or(ModelSource::Drives(training, self.model_out), ModelSource::File);
        let prior_frames = prior_frames as usize;
        let mut settings = MapperSettings { prior_frames, ..MapperSettings::default() };
        settings.verification.method = verification;
        print_if(json, &map::run(&MapOptions { world, route, seed, trials, model, wheels, settings, out })?)
    }
}

fn worlds() -> impl TypedValueParser<Value = NamedWorld> {
    PossibleValuesParser::new(NamedWorld::ALL.map(NamedWorld::name))
        .try_map(|name| NamedWorld::from_name(&name).ok_or("not one of the worlds"))
}

/// A duration, a rate or a factor.
/// Relax a pose graph: SE(2) or SE(3), from odometry alone unless told otherwise.
///
/// The cost is the sum of eᵀΩe, without a factor of one half: g2o's chi2. Edges between consecutive ids are odometry,
/// all others closures.
#[derive(Args)]
struct PosegraphArguments {
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
    fn run(self) -> Result<(), EvalError> {
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

fn positive(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.1..=3600.0).contains(&value) { Ok(value) } else { Err("give a number from 0.1 to 3600".to_owned()) }
}

impl TrainArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self {
            images,
            feature,
            words,
            seed,
            orb_vocabulary,
            detector,
            out,
            max_features,
            image_width,
            json,
        } = self;
        let features =
            FeatureSettings::new(feature, max_features, image_width).map_err(EvalError::FeatureSettings)?;
        let vocabulary = match orb_vocabulary {
            Some(_) if feature != Feature::Orb => {
                refuse("an ORB vocabulary has words of ORB; add --feature orb")
            }
            Some(path) => VocabularySource::OrbText(path),
            None => {
                VocabularySource::Images(VocabularySettings { words, seed, ..VocabularySettings::default() })
            }
        };
        let report = train::run(&TrainOptions { images, features, vocabulary, detector, out })?;
        print_if(json, &report)
    }
}

impl CalibrateArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { model, detector, out, json } = self;
        print_if(json, &calibrate::run(&CalibrateOptions { model, detector, out })?)
    }
}

impl SequenceArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { sequence, gap, model, out, seed, system, json } = self;
        let system = system.system().unwrap_or_else(|message| refuse(message));
        let gap = gap as usize;
        let report = sequence::run(&SequenceOptions { sequence, gap, model, system, seed, out })?;
        print_if(json, &report)
    }
}

impl SystemArguments {
    /// # Errors
    /// What cannot be asked for together.
    fn system(self) -> Result<System, &'static str> {
        let Self { threshold, ranking, knobs } = self;
        Ok(match ranking {
            RankingName::FabMap => System::FabMap(knobs.with_threshold(threshold)),
            RankingName::Likelihood => System::Likelihood(knobs.with_threshold(threshold)),
            RankingName::TfIdf if knobs.are_untouched() => System::TfIdf { threshold },
            RankingName::TfIdf => {
                return Err(
                    "with --ranking tf-idf there are no FAB-MAP settings to make; leave out --verify, --min-evidence, \
                     --consistency-frames, --dependence, --new-place, --scorer, the rates, --new-place-prior, \
                     --smoothing and --even-share",
                );
            }
        })
    }
}

impl CompareArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { comparison: path, out, json } = self;
        let CompareFile { sequences, configurations } = CompareFile::read(&path)?;
        let configuration = |entry: ConfigurationEntry| {
            let ConfigurationEntry { name, flags, models } = entry;
            let refused = |reason: String| EvalError::Comparison {
                path: path.clone(),
                reason: format!("the flags of configuration {name:?}: {reason}"),
            };
            let flags = ConfigurationFlags::try_parse_from(flags.split_whitespace())
                .map_err(|error| refused(error.to_string()))?;
            let system = flags.system.system().map_err(|message| refused(message.to_owned()))?;
            Ok(Configuration { name, models, system })
        };
        let configurations =
            configurations.into_iter().map(configuration).collect::<Result<_, EvalError>>()?;
        print_if(json, &compare::run(&CompareOptions { configurations, sequences, out })?)
    }
}

impl VisitsArguments {
    fn run(self) -> Result<(), EvalError> {
        let Self { sequence, places, model, knobs, json } = self;
        let knobs = knobs.with_threshold(None);
        print_if(json, &visits::run(&VisitsOptions { sequence, places: places as usize, model, knobs })?)
    }
}

impl KnobArguments {
    fn with_threshold(self, closure_threshold: Option<f64>) -> Knobs {
        let Self {
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            smoothing,
            even_share,
        } = self;
        Knobs {
            closure_threshold,
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            even_share,
            likelihood_smoothing: smoothing,
        }
    }

    fn are_untouched(&self) -> bool {
        let Self {
            verification,
            min_evidence,
            consistency_frames,
            dependence,
            new_place,
            scorer,
            true_positive_rate,
            false_positive_rate,
            new_place_prior,
            smoothing,
            even_share,
        } = self;
        let rates = [true_positive_rate, false_positive_rate, new_place_prior, smoothing, even_share];
        verification.is_none()
            && min_evidence.is_none()
            && consistency_frames.is_none()
            && dependence.is_none()
            && new_place.is_none()
            && scorer.is_none()
            && rates.iter().all(|rate| rate.is_none())
    }
}

/// The one object on stdout.
fn print_if(json: bool, report: &impl Serialize) -> Result<(), EvalError> {
    if !json {
        return Ok(());
    }
    let not_printed = |reason: io::Error| EvalError::Write { path: PathBuf::from("stdout"), reason };
    let mut stdout = io::stdout().lock();
    serde_json::to_writer(&mut stdout, report).map_err(|error| not_printed(error.into()))?;
    writeln!(stdout).map_err(not_printed)
}

fn refuse(message: &str) -> ! {
    Cli::command().error(ErrorKind::ArgumentConflict, message).exit()
}

fn with_default(text: &str, default: impl Display) -> String {
    format!("{text} [default: {default}]")
}

fn choice<T: Copy + Send + Sync + 'static>(choices: Choices<T>) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(choices.iter().map(|(name, _)| *name))
        .try_map(|name| value_of(choices, &name).ok_or("not one of the choices"))
}

fn features() -> impl TypedValueParser<Value = Feature> {
    PossibleValuesParser::new(Feature::ALL.map(Feature::name)).try_map(|name| name.parse::<Feature>())
}
