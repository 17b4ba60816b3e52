//! Why a command failed, in words for the person at the keyboard.

use std::io;
use std::path::PathBuf;

use fabmap::calibration::LearnError;
use fabmap::codec::DecodeError;
use fabmap::descriptor::DescriptorError;
use fabmap::detector::DetectorError;
use fabmap::model::ModelTrainingError;
use fabmap::new_place::NoSamplesError;
use fabmap::place_filter::FilterError;
use fabmap::vocabulary::{OrbVocabularyError, VocabularyError};
use topomap::g2o::{G2oError, NamingError};
use topomap::mapper::{FoldError, FrameError, MapperError};
use topomap::merging::{JoinError, MergeError};
use topomap::navigation::{NavigationSettingsError, PlanError};
use waypost_sim::image::ImageError as SimulatedImageError;
use waypost_sim::link::LinkError;
use waypost_vision::features::{ExtractError, SettingsError};

use crate::commands::appearance::AppearanceError;
use crate::commands::map::MapError;
use crate::dataset::DatasetError;
use crate::workload::WorkloadError;
use crate::workload::files::WorkloadFileError;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// The images or the truth cannot be used.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A feature setting is out of range.
    #[error(transparent)]
    FeatureSettings(SettingsError),
    /// A rate of the detector model is out of range.
    #[error(transparent)]
    Detector(#[from] DetectorError),
    /// A setting of the recognizer or the mapper is out of range.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// An image cannot be decoded or has no place for features.
    #[error("{path}: {reason}")]
    Image {
        /// The image.
        path: PathBuf,
        /// What is wrong with it.
        reason: ExtractError,
    },
    /// The workload's files cannot be used.
    #[error(transparent)]
    WorkloadFile(#[from] WorkloadFileError),
    /// The workload's settings make no distribution.
    #[error(transparent)]
    Workload(#[from] WorkloadError),
    /// A new-place method needs a sampling set.
    #[error(transparent)]
    NoSamples(#[from] NoSamplesError),
    /// A setting of the filter is out of range.
    #[error(transparent)]
    Filter(FilterError),
    /// No model came out of the training images.
    #[error(transparent)]
    Training(#[from] ModelTrainingError),
    /// The training images do not show how reliable words are.
    #[error(transparent)]
    Calibration(#[from] LearnError),
    /// The file of a comparison is not one.
    #[error("{path}: {reason}")]
    Comparison {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and how to mend it.
        reason: String,
    },
    /// The frames of a sequence are not visits of the same places.
    #[error(
        "{path}: {reason}; give a sequence that shows the same places in the same order, visit after visit"
    )]
    Visits {
        /// The sequence's folder.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The file does not hold descriptors.
    #[error("{path}: {reason}")]
    Descriptors {
        /// The file of rows.
        path: PathBuf,
        /// What is wrong with it.
        reason: DescriptorError,
    },
    /// The ORB vocabulary cannot be read.
    #[error("{path}: {reason}")]
    OrbVocabulary {
        /// The vocabulary file.
        path: PathBuf,
        /// What is wrong with it.
        reason: OrbVocabularyError,
    },
    /// The model file is not a whole one.
    #[error("{path}: {reason}")]
    Model {
        /// The model file.
        path: PathBuf,
        /// What is wrong with it.
        reason: DecodeError,
    },
    /// The model's words are made with an extractor that this program does not have.
    #[error(
        "{path}: the model's words are made with an extractor that this program does not know ({reason}); use the \
         version of Waypost that trained it, or train it anew with `waypost-eval train`"
    )]
    UnknownExtractor {
        /// The model file.
        path: PathBuf,
        /// What about it is not known.
        reason: SettingsError,
    },
    /// Descriptors that the model's vocabulary does not quantize.
    #[error(
        "{path}: the model's vocabulary does not fit its own extractor ({reason}); train the model anew with \
         `waypost-eval train`"
    )]
    ForeignVocabulary {
        /// The model file.
        path: PathBuf,
        /// How they differ.
        reason: VocabularyError,
    },
    /// A file is no pose graph.
    #[error("{path}: {reason}")]
    PoseGraph {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, and how to mend it.
        reason: G2oError,
    },
    /// A pose graph without vertices says of no pose where it is.
    #[error("{path} has no VERTEX lines to start from; choose --start best")]
    NoVertices {
        /// The file.
        path: PathBuf,
    },
    /// A pose graph without closures shows nothing of what wrong ones are like.
    #[error("{path} has no closures, whose measurements false ones would have; leave out --false-loops")]
    NoClosures {
        /// The file.
        path: PathBuf,
    },
    /// A relaxed graph has other poses than its ids: a fault of the program.
    #[error("{0}; this is a fault of Waypost, please report it")]
    PoseGraphNames(NamingError),
    /// The mapper refused a frame of the sequence.
    #[error("frame {index}: {reason}")]
    Frame {
        /// Index of the frame.
        index: usize,
        /// Why.
        reason: FrameError,
    },
    /// The mapper refused its own decision: a fault of the program.
    #[error("frame {index}: {reason}; this is a fault of Waypost, please report it")]
    Fold {
        /// Index of the frame.
        index: usize,
        /// Why.
        reason: FoldError,
    },
    /// Two maps cannot be compared.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// A map's log does not fit the map: a fault of the program.
    #[error("{0}; this is a fault of Waypost, please report it")]
    Join(JoinError),
    /// A simulated robot could not map its world.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A setting of navigation is out of its range.
    #[error(transparent)]
    Navigation(#[from] NavigationSettingsError),
    /// A robot's goal cannot be planned to.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// What lies between robot and server is no link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// What a simulated robot sees cannot be written as an image.
    #[error(transparent)]
    SimulatedImage(#[from] SimulatedImageError),
    /// A simulated robot could not be sent by looks.
    #[error(transparent)]
    Appearance(#[from] AppearanceError),
    /// A file or folder cannot be read.
    #[error("{path} cannot be read ({reason}); check the path and its permissions")]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A file or folder cannot be written.
    #[error("{path} cannot be written ({reason}); check that the folder may be written to and has room")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// The server under load failed.
    #[error("the server under load failed: {problem}; what it logged last:\n{log}")]
    Server {
        /// What happened.
        problem: String,
        /// Its last lines.
        log: String,
    },
    /// The client library failed.
    #[error("the server under load was not reached: {0}")]
    Client(#[from] waypost_client::Error),
    /// A stream ended under load.
    #[error("a stream ended under load: {} ({:?})", .0.message(), .0.code())]
    Stream(Box<tonic::Status>),
    /// The server did not keep to the contract.
    #[error("the contract was broken: {0}; use a server of the same version")]
    Protocol(&'static str),
    /// Frames that were never answered.
    #[error(
        "{frames} frames of one robot were never answered; lower the load, or look for what holds the server up"
    )]
    Unanswered {
        /// How many.
        frames: usize,
    },
    /// A model without a sampling set has nothing to be sent.
    #[error("{path}: the model remembers no training image; give --images in place of --synthetic")]
    NoSamplingSet {
        /// The model file.
        path: PathBuf,
    },
    /// Words could not be made.
    #[error("{path}: {reason}")]
    Words {
        /// The image or the model file.
        path: PathBuf,
        /// What is wrong with it.
        reason: waypost_client::words::WordsError,
    },
    /// No socket to be had.
    #[error("no connection on the loopback interface ({0}); check that the machine has one")]
    Socket(io::Error),
    /// No threads to be had.
    #[error("no threads can be started ({0}); end other programs")]
    Runtime(io::Error),
    /// No threads to be had for computing.
    #[error("no threads can be started ({0}); end other programs")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// A robot's task failed: a fault of the program.
    #[error("a robot failed ({0}); this is a fault of Waypost, please report it")]
    Robot(#[from] tokio::task::JoinError),
    /// A plot could not be drawn.
    #[error("{path} could not be drawn ({reason}); this is a fault of Waypost, please report it")]
    Plot {
        /// The plot's file.
        path: PathBuf,
        /// What the plotting library says.
        reason: String,
    },
}

impl From<tonic::Status> for EvalError {
    fn from(status: tonic::Status) -> Self {
        Self::Stream(Box::new(status))
    }
}

impl EvalError {
    /// Exit code of the program: 2 if the command line asks for what cannot be, 1 for all else.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            EvalError::FeatureSettings(_)
            | EvalError::Detector(_)
            | EvalError::Mapper(_)
            | EvalError::Navigation(_)
            | EvalError::Link(_)
            | EvalError::Workload(_)
            | EvalError::Filter(_)
            | EvalError::Comparison { .. }
            | EvalError::NoVertices { .. }
            | EvalError::NoClosures { .. }
            | EvalError::Visits { .. } => 2,
            EvalError::Map(error) => error.exit_code(),
            EvalError::Dataset(_)
            | EvalError::WorkloadFile(_)
            | EvalError::NoSamples(_)
            | EvalError::Image { .. }
            | EvalError::Descriptors { .. }
            | EvalError::OrbVocabulary { .. }
            | EvalError::Training(_)
            | EvalError::Calibration(_)
            | EvalError::Model { .. }
            | EvalError::UnknownExtractor { .. }
            | EvalError::ForeignVocabulary { .. }
            | EvalError::PoseGraph { .. }
            | EvalError::PoseGraphNames(_)
            | EvalError::Frame { .. }
            | EvalError::Fold { .. }
            | EvalError::Plan(_)
            | EvalError::Appearance(_)
            | EvalError::SimulatedImage(_)
            | EvalError::Merge(_)
            | EvalError::Join(_)
            | EvalError::Read { .. }
            | EvalError::Write { .. }
            | EvalError::Server { .. }
            | EvalError::Client(_)
            | EvalError::Stream(_)
            | EvalError::Protocol(_)
            | EvalError::Unanswered { .. }
            | EvalError::NoSamplingSet { .. }
            | EvalError::Words { .. }
            | EvalError::Socket(_)
            | EvalError::Runtime(_)
            | EvalError::Threads(_)
            | EvalError::Robot(_)
            | EvalError::Plot { .. } => 1,
        }
    }
}
