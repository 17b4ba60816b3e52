//! One number: how probable it is that a candidate is the same place.

/// What a candidate's log-odds are made of:
/// ln [p / (1 - p)] = offset + per_look_alike · e / m + per_word_nat · w
/// with e the evidence of geometry over the last frames, m what the best look-alike of this
/// kind of place is expected to show over as many, and w the log-odds by words, which are at least
/// [`ProbabilityWeights::LEAST_WORD_NATS`].
///
/// The evidence of the best wrong candidate falls off as an exponential of mean m. Against evidence
/// that is spread evenly over M at the right place that is ln (m / M) + e / m: linear, as here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbabilityWeights {
    /// Log-odds without evidence, in nats.
    pub offset_nats: f64,
    /// Nats for each time that the evidence is as much as a look-alike's.
    pub per_look_alike_nats: f64,
    /// Nats for each nat by words.
    pub per_word_nat: f64,
}

/// What speaks for a candidate and against it, in nats; the sum is its log-odds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contributions {
    /// That most candidates are none.
    pub offset_nats: f64,
    /// Geometry of this frame and the last ones, against what look-alikes show.
    pub geometry_nats: f64,
    /// The filter's belief, by words and order.
    pub words_nats: f64,
}

impl ProbabilityWeights {
    /// Words that say that the place is new are worth no more: a change of light alone does as much.
    pub const LEAST_WORD_NATS: f64 = -20.0;

    /// What `evidence_inliers` is worth where look-alikes show `look_alike_inliers`, beside words.
    #[must_use]
    pub fn contributions(
        &self,
        evidence_inliers: f64,
        look_alike_inliers: f64,
        word_log_odds_nats: f64,
    ) -> Contributions {
        let Self { offset_nats, per_look_alike_nats, per_word_nat } = *self;
        Contributions {
            offset_nats,
            geometry_nats: per_look_alike_nats * evidence_inliers / look_alike_inliers,
            words_nats: per_word_nat * word_log_odds_nats.max(Self::LEAST_WORD_NATS),
        }
    }
}

impl Default for ProbabilityWeights {
    /// By logistic regression over the proposals of all four development sequences, each of the same
    /// weight; ACCURACY.md says how the same does on one that is left out.
    fn default() -> Self {
        Self { offset_nats: -1.59, per_look_alike_nats: 1.38, per_word_nat: 0.131 }
    }
}

impl Contributions {
    /// ln [p / (1 - p)], in nats.
    #[must_use]
    pub fn log_odds_nats(&self) -> f64 {
        self.offset_nats + self.geometry_nats + self.words_nats
    }
}
