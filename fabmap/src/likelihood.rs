//! p(Z | L_i), term by term: the observation model and its plain, dense evaluation.
//!
//! [`ObservationModel::dense_log_likelihood`] is the oracle: written straight from the equations,
//! over all words, in f64. Every faster path is held to it.

use std::sync::OnceLock;

use crate::appearance::Appearance;
use crate::chow_liu::ChowLiuTree;
use crate::detector::DetectorModel;
use crate::evidence_exponent::EvidenceExponent;
use crate::observation::{Observation, WordId};
use crate::slices;

/// Whether words depend on each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dependence {
    /// Each word depends on its parent in the Chow-Liu tree.
    #[default]
    ChowLiu,
    /// Words are independent of each other: naive Bayes.
    NaiveBayes,
}

/// How a place makes an observation: Chow-Liu tree, detector model and how much words count for.
#[derive(Clone, Debug)]
pub struct ObservationModel {
    tree: ChowLiuTree,
    detector: DetectorModel,
    exponent: EvidenceExponent,
    /// Σ_q ln p(z_q = 0 | z_pq = 0, k_q = 0, n) for n = 0..=MAX_LOOKS: the log-likelihood that
    /// nothing is seen at a place where nothing was seen in n looks.
    nothing_seen: Vec<f64>,
    /// Per word: how much likelier it makes an observation that shows neither the word nor its
    /// parent if it was seen in the one look at a place, and not missed.
    unseen_gain_of_one_look: Vec<f64>,
    /// Per word, for the states of [`INFORMATIVE_STATES`]. Made when first asked for.
    one_look: OnceLock<Vec<[OneLook; 3]>>,
    /// By [`count_index`]: p(k of n looks show a word | e = 1) and the same for e = 0, over the
    /// larger of the two.
    evidence_of_looks: Vec<[f64; 2]>,
}

/// What an informative word says of a place that was looked at once, beyond what it would say if
/// neither it nor its parent were seen; in nats.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OneLook {
    /// Of any place.
    pub(crate) anywhere: f64,
    /// Of a place whose one look showed the word, besides.
    pub(crate) at_places_with_it: f64,
}

/// Pairs of n = 0..=MAX_LOOKS and k = 0..=n.
pub(crate) const COUNTS: usize = count_index(0, Appearance::MAX_LOOKS + 1);

/// The number of (k, n) among them: by n, then by k.
pub(crate) const fn count_index(hits: u8, looks: u8) -> usize {
    looks as usize * (looks as usize + 1) / 2 + hits as usize
}

/// (z_q, z_pq) of an informative word.
const INFORMATIVE_STATES: [(bool, bool); 3] = [(false, true), (true, false), (true, true)];

/// ln p(Z | L) of one Z for many places that were looked at once: what they have in common is
/// computed once.
#[derive(Clone, Debug)]
pub struct SingleLooks<'a> {
    model: &'a ObservationModel,
    /// Ascending, each with its gain if the place has it.
    informative: Vec<(WordId, f64)>,
    empty_place: f64,
}

/// What an observation says of one word: z_q and z_pq. A root has no parent; its `parent_seen` is
/// false and does not matter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WordState {
    /// The word q.
    pub word: WordId,
    /// z_q.
    pub seen: bool,
    /// z_pq.
    pub parent_seen: bool,
}

impl ObservationModel {
    /// Joins tree and detector; with [`Dependence::NaiveBayes`] the tree's edges are left out.
    #[must_use]
    pub fn new(tree: &ChowLiuTree, detector: DetectorModel, dependence: Dependence) -> Self {
        let tree = match dependence {
            Dependence::ChowLiu => tree.clone(),
            Dependence::NaiveBayes => tree.independent(),
        };
        let (exponent, nothing_seen, unseen_gain_of_one_look) =
            (EvidenceExponent::NONE, Vec::new(), Vec::new());
        let one_look = OnceLock::new();
        let evidence = |looks| (0..=looks).map(move |hits| detector.evidence(hits, looks));
        let evidence_of_looks = (0..=Appearance::MAX_LOOKS).flat_map(evidence).collect();
        let model = Self {
            tree,
            detector,
            exponent,
            nothing_seen,
            unseen_gain_of_one_look,
            one_look,
            evidence_of_looks,
        };
        model.with_exponent(exponent)
    }

    /// The same model with every term, and so every likelihood, raised to `exponent`: all that is
    /// made of it (places, samples, the average place) is tempered alike.
    #[must_use]
    pub fn with_exponent(mut self, exponent: EvidenceExponent) -> Self {
        self.exponent = exponent;
        self.one_look = OnceLock::new();
        self.unseen_gain_of_one_look =
            self.unseen_words().map(|unseen| self.gain_of_one_look(unseen)).collect();
        self.nothing_seen = (0..=Appearance::MAX_LOOKS)
            .map(|looks| self.unseen_words().map(|unseen| self.log_term(unseen, 0, looks)).sum())
            .collect();
        self
    }

    /// Memory of what is kept per word, roughly.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        let of_tree = size_of::<WordId>() + 3 * size_of::<f64>();
        self.vocabulary_len() * (of_tree + size_of::<f64>() + size_of::<[OneLook; 3]>())
    }

    /// Number of words.
    #[must_use]
    pub fn vocabulary_len(&self) -> usize {
        self.tree.len()
    }

    /// The tree in use: without edges under naive Bayes.
    #[must_use]
    pub fn tree(&self) -> &ChowLiuTree {
        &self.tree
    }

    /// ln p(Z | L_i) = ln p(z_r | L_i) + Σ_q ln p(z_q | z_pq, L_i) over all words, Cummins &
    /// Newman 2008, eq. (9). Slow on purpose: time grows with the vocabulary.
    #[must_use]
    pub fn dense_log_likelihood(&self, observation: &Observation, place: &Appearance) -> f64 {
        WordId::first(self.vocabulary_len())
            .map(|word| self.log_term(self.word_state(word, observation), place.hits(word), place.looks()))
            .sum()
    }

    /// ln p(Z | L_avg): the mean-field approximation of an unknown place, Cummins & Newman
    /// 2008, eq. (16). The average place is one with no looks at all.
    #[must_use]
    pub fn dense_log_likelihood_of_average_place(&self, observation: &Observation) -> f64 {
        self.dense_log_likelihood(observation, &Appearance::default())
    }

    /// ln p(z_q | z_pq, L_i) = ln Σ_s p(z_q | e_q = s, z_pq) p(e_q = s | L_i) at a place where the
    /// word was seen in `hits` of `looks`, times the exponent. Cummins & Newman 2008, eq. (10).
    #[must_use]
    pub fn log_term(&self, state: WordState, hits: u8, looks: u8) -> f64 {
        let belief = self.detector.belief(self.tree.marginal(state.word, true), hits, looks);
        let given_element = self.word_probability(state, true);
        let given_no_element = self.word_probability(state, false);
        self.exponent.value() * (given_element * belief + given_no_element * (1.0 - belief)).ln()
    }

    /// p(z_q = a | e_q = s, z_pq = b) = β / (α + β) with
    /// α = p(z_q = a) p(z_q = ¬a | e_q = s) p(z_q = ¬a | z_pq = b) and
    /// β = p(z_q = ¬a) p(z_q = a | e_q = s) p(z_q = a | z_pq = b).
    /// Cummins & Newman 2008, eqs. (13), (14). For a root it is p(z_q = a | e_q = s).
    fn word_probability(&self, WordState { word, seen, parent_seen }: WordState, exists: bool) -> f64 {
        let alpha = self.tree.marginal(word, seen)
            * self.detector.probability(!seen, exists)
            * self.tree.conditional(word, !seen, parent_seen);
        let beta = self.tree.marginal(word, !seen)
            * self.detector.probability(seen, exists)
            * self.tree.conditional(word, seen, parent_seen);
        beta / (alpha + beta)
    }

    /// What `observation` says of `word`.
    #[must_use]
    pub fn word_state(&self, word: WordId, observation: &Observation) -> WordState {
        let parent_seen = self.tree.parent(word).is_some_and(|parent| observation.contains(parent));
        WordState { word, seen: observation.contains(word), parent_seen }
    }

    /// The words of which `observation` says more than "neither the word nor its parent is seen",
    /// ascending: the words seen, and the unseen children of words seen.
    #[must_use]
    pub fn informative_words(&self, observation: &Observation) -> Vec<WordState> {
        let seen_words = observation.words().iter();
        let mut words: Vec<WordId> = seen_words
            .flat_map(|&word| std::iter::once(word).chain(self.tree.children(word).iter().copied()))
            .collect();
        words.sort_unstable();
        words.dedup();
        words.into_iter().map(|word| self.word_state(word, observation)).collect()
    }

    /// ln p(Z | a place where nothing was seen in `looks` looks), from the informative words of Z
    /// alone: C_n(Z). With `looks` = 0 it is the mean-field term ln p(Z | L_avg).
    #[must_use]
    pub fn log_likelihood_of_empty_place(&self, informative: &[WordState], looks: u8) -> f64 {
        let more: f64 = if looks == 1 {
            informative.iter().map(|&state| self.one_look(state).anywhere).sum()
        } else {
            let gain = |&state| self.log_term(state, 0, looks) - self.log_term(unseen(state.word), 0, looks);
            informative.iter().map(gain).sum()
        };
        self.nothing_seen[usize::from(looks)] + more
    }

    /// ln p(nothing is seen | a place where nothing was seen in `looks` looks).
    pub(crate) fn log_likelihood_of_nothing(&self, looks: u8) -> f64 {
        self.nothing_seen[usize::from(looks)]
    }

    /// See [`OneLook`]; the state must be an informative one.
    pub(crate) fn one_look(&self, state: WordState) -> OneLook {
        let by_word = self.one_look.get_or_init(|| {
            let states = |word| INFORMATIVE_STATES.map(|state| self.evaluate_one_look(word, state));
            WordId::first(self.vocabulary_len()).map(states).collect()
        });
        let position = 2 * usize::from(state.seen) + usize::from(state.parent_seen) - 1;
        by_word[state.word.index()][position]
    }

    fn evaluate_one_look(&self, word: WordId, (seen, parent_seen): (bool, bool)) -> OneLook {
        let state = WordState { word, seen, parent_seen };
        OneLook {
            anywhere: self.log_term(state, 0, 1) - self.log_term(unseen(word), 0, 1),
            at_places_with_it: self.gain_of_one_look(state) - self.gain_of_one_look(unseen(word)),
        }
    }

    /// For n = 0..=`most_looks` and k = 0..=n, in the order of [`count_index`]: how much more than
    /// "neither the word nor its parent is seen" the word's state says of a place where the word
    /// was seen in k of n looks, in nats.
    ///
    /// As ln [Σ_s p(z_q | e_q = s, z_pq) p(e_q = s | L)] less the same of the unseen state, in
    /// which the normaliser of p(e_q | L) cancels: p(e_q = s | L) ∝ p(e_q = s) Π p(z|e_q = s) over
    /// the looks.
    pub(crate) fn gains_over_unseen(&self, state: WordState, most_looks: u8, gains: &mut [f64; COUNTS]) {
        let marginal = self.tree.marginal(state.word, true);
        let weighted = |state| {
            [
                self.word_probability(state, true) * marginal,
                self.word_probability(state, false) * (1.0 - marginal),
            ]
        };
        let counts = ..=count_index(most_looks, most_looks);
        let (state, unseen) = (weighted(state), weighted(unseen(state.word)));
        slices::log_ratios(&self.evidence_of_looks[counts], state, unseen, &mut gains[counts]);
        gains[counts].iter_mut().for_each(|gain| *gain *= self.exponent.value());
    }

    /// Σ over the words of a place of what they say, beyond what they would if the place did not
    /// have them, to a query that shows neither them nor their parents; in nats.
    pub(crate) fn unseen_gain(&self, appearance: &Appearance) -> f64 {
        let looks = appearance.looks();
        if looks == 1 {
            return appearance.word_hits().map(|(word, _)| self.unseen_gain_of_one_look[word.index()]).sum();
        }
        let gain =
            |(word, hits)| self.log_term(unseen(word), hits, looks) - self.log_term(unseen(word), 0, looks);
        appearance.word_hits().map(gain).sum()
    }

    /// Readies `observation` for comparison with places that were looked at once.
    #[must_use]
    pub fn single_looks(&self, observation: &Observation) -> SingleLooks<'_> {
        let informative = self.informative_words(observation);
        let empty_place = self.log_likelihood_of_empty_place(&informative, 1);
        let informative =
            informative.into_iter().map(|state| (state.word, self.gain_of_one_look(state))).collect();
        SingleLooks { model: self, informative, empty_place }
    }

    fn gain_of_one_look(&self, state: WordState) -> f64 {
        self.log_term(state, 1, 1) - self.log_term(state, 0, 1)
    }

    fn unseen_words(&self) -> impl Iterator<Item = WordState> {
        WordId::first(self.vocabulary_len()).map(unseen)
    }
}

impl SingleLooks<'_> {
    /// ln p(Z | L) of a place whose one look showed `place`.
    ///
    /// # Panics
    /// If `place` is of another vocabulary.
    #[must_use]
    pub fn log_likelihood(&self, place: &Observation) -> f64 {
        let mut informative = self.informative.iter().peekable();
        let gains = place.words().iter().map(|&word| {
            while informative.next_if(|&&(informative, _)| informative < word).is_some() {}
            match informative.peek() {
                Some(&&(informative, gain)) if informative == word => gain,
                Some(_) | None => self.model.unseen_gain_of_one_look[word.index()],
            }
        });
        self.empty_place + gains.sum::<f64>()
    }
}

/// Neither the word nor its parent is seen.
pub(crate) fn unseen(word: WordId) -> WordState {
    WordState { word, seen: false, parent_seen: false }
}

#[cfg(test)]
mod tests;
