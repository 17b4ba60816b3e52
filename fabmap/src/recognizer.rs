//! The story: an observation comes in, a belief about where the robot is comes out.

use std::sync::Arc;

use crate::appearance::{Appearance, PlaceId};
use crate::baselines;
use crate::detector::DetectorModel;
use crate::explanation::Explanation;
use crate::inverted_index::{InvertedIndex, QueryWeights};
use crate::likelihood::{Dependence, ObservationModel, WordState};
use crate::model::Model;
use crate::new_place::{NewPlace, NewPlaceMethod, NoSamplesError, SampleWorkspace};
use crate::observation::Observation;
use crate::place_filter::{FilterError, FilterSettings, MotionPrior, PlaceFilter};

pub use crate::recognition::{Association, Recognition};

/// FAB-MAP over a growing set of places.
#[derive(Clone, Debug)]
pub struct Recognizer {
    index: InvertedIndex,
    new_place: NewPlace,
    filter: PlaceFilter,
    scorer: Scorer,
}

/// The paper's choices, all in one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RecognizerSettings {
    /// Words coupled by the tree, or independent.
    pub dependence: Dependence,
    /// What stands in for the places that the map does not have.
    pub new_place: NewPlaceMethod,
    /// Which evaluation of the likelihood is used; both give the same values.
    pub scorer: Scorer,
    /// The model's own detector is used where this is `None`.
    pub detector: Option<DetectorModel>,
    /// Settings of the Bayes filter.
    pub filter: FilterSettings,
}

/// How likelihoods are evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scorer {
    /// The inverted index.
    #[default]
    Index,
    /// Every word of every place, see [`crate::baselines`]: the same values, slowly.
    Dense,
}

/// Settings and model do not make a recognizer.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RecognizerError {
    /// A setting of the filter is out of range.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The sampled new-place term needs a sampling set.
    #[error(transparent)]
    NoSamples(#[from] NoSamplesError),
}

/// Buffers that are reused between observations; see [`Recognizer::recognize_into`].
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    weights: QueryWeights,
    samples: SampleWorkspace,
}

/// A step of the work on one frame, for measuring how long it takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Stage {
    /// ln p(Z | L_i) of all places.
    Likelihood,
    /// ln p(Z | L_new).
    NewPlace,
    /// Prior, Bayes' rule, normalisation.
    Filter,
    /// Geometric verification; it is no work of this crate's.
    Verification,
}

/// Called when a stage is completed. This crate has no clock; `()` does nothing.
pub trait StageObserver {
    /// `stage` has just been completed.
    fn completed(&mut self, stage: Stage);
}

impl StageObserver for () {
    fn completed(&mut self, _stage: Stage) {}
}

impl Recognizer {
    /// A recognizer that knows no place yet.
    ///
    /// # Errors
    /// [`RecognizerError`] if a setting is out of range, or the model lacks what it asks for.
    pub fn new(model: &Model, settings: RecognizerSettings) -> Result<Self, RecognizerError> {
        let detector = settings.detector.unwrap_or(*model.detector());
        let observation_model = ObservationModel::new(model.tree(), detector, settings.dependence)
            .with_exponent(model.evidence_exponent());
        Self::over(Arc::new(observation_model), model.sampling_set(), settings)
    }

    /// The same over an observation model that has been made from the settings' dependence and
    /// detector, or from others.
    ///
    /// # Errors
    /// [`RecognizerError`] if a setting is out of range, or samples are asked for and there are
    /// none.
    pub fn over(
        model: Arc<ObservationModel>,
        sampling_set: &[Observation],
        settings: RecognizerSettings,
    ) -> Result<Self, RecognizerError> {
        let RecognizerSettings { new_place, scorer, filter, .. } = settings;
        Ok(Self {
            new_place: NewPlace::new(new_place, &model, sampling_set)?,
            index: InvertedIndex::new(model),
            filter: PlaceFilter::new(filter)?,
            scorer,
        })
    }

    /// Where the robot is, given what it sees and where motion puts it.
    #[must_use]
    pub fn recognize(&self, observation: &Observation, motion: &MotionPrior) -> Recognition {
        self.recognize_observed(observation, motion, &mut ())
    }

    /// [`Recognizer::recognize`]; `observer` is called as each stage ends, to measure how long it
    /// took.
    #[must_use]
    pub fn recognize_observed(
        &self,
        observation: &Observation,
        motion: &MotionPrior,
        observer: &mut dyn StageObserver,
    ) -> Recognition {
        let mut recognition = Recognition::default();
        self.recognize_into(observation, motion, observer, &mut Workspace::default(), &mut recognition);
        recognition
    }

    /// [`Recognizer::recognize_observed`] into `recognition`, which is overwritten. If `workspace`
    /// and `recognition` are kept from one observation to the next, nothing that grows with the map
    /// is allocated.
    pub fn recognize_into(
        &self,
        observation: &Observation,
        motion: &MotionPrior,
        observer: &mut dyn StageObserver,
        workspace: &mut Workspace,
        recognition: &mut Recognition,
    ) {
        let informative = self.index.model().informative_words(observation);
        let places = self.index.len();
        self.score(observation, &informative, workspace, &mut recognition.log_likelihoods);
        observer.completed(Stage::Likelihood);
        let new_place = self.new_place.term(&informative, places, &mut workspace.samples);
        observer.completed(Stage::NewPlace);
        let prior = self.filter.prior(motion, places);
        let Recognition { log_likelihoods, posterior, .. } = recognition;
        self.filter.update_into(log_likelihoods, &new_place, &prior, posterior);
        observer.completed(Stage::Filter);
        recognition.new_place_log_likelihood = new_place.log_likelihood;
        recognition.prior = prior;
    }

    /// Number of places.
    #[must_use]
    pub fn places(&self) -> usize {
        self.index.len()
    }

    /// Memory in use, in bytes, roughly; without the [`Model`].
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.index.memory_bytes() + self.index.model().memory_bytes() + self.new_place.memory_bytes()
    }

    /// The places and the index over them.
    #[must_use]
    pub fn index(&self) -> &InvertedIndex {
        &self.index
    }

    /// Adds a place and returns its id.
    ///
    /// # Panics
    /// If the appearance is of another vocabulary.
    pub fn add_place(&mut self, appearance: &Appearance) -> PlaceId {
        self.index.add(appearance)
    }

    /// Adds places in order, faster than one by one.
    ///
    /// # Panics
    /// If an appearance is of another vocabulary.
    pub fn add_places(&mut self, appearances: impl IntoIterator<Item = Appearance>) {
        self.index.extend(appearances);
    }

    /// Takes one more look at a place.
    ///
    /// # Panics
    /// If there is no such place, or the observation is of another vocabulary.
    pub fn observe_place(&mut self, place: PlaceId, observation: &Observation) {
        self.index.observe(place, observation);
    }

    /// Why `place` got its posterior; `None` if there is no such place. Lists at most `words` words
    /// for and as many against.
    #[must_use]
    pub fn explain(
        &self,
        observation: &Observation,
        recognition: &Recognition,
        place: PlaceId,
        words: usize,
    ) -> Option<Explanation> {
        let appearance = self.index.appearance(place)?;
        Explanation::new(
            self.index.model(),
            self.new_place.method(),
            observation,
            recognition,
            place,
            &appearance,
            words,
        )
    }

    fn score(
        &self,
        observation: &Observation,
        informative: &[WordState],
        workspace: &mut Workspace,
        scores: &mut Vec<f64>,
    ) {
        match self.scorer {
            Scorer::Index => self.index.log_likelihoods_into(informative, &mut workspace.weights, scores),
            Scorer::Dense => baselines::every_word_of_every_place(&self.index, observation, scores),
        }
    }
}
