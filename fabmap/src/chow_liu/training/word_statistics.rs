//! How often words are seen, alone and together, and what follows of it.

use super::TreeTrainingError;
use crate::chow_liu::WordDependence;
use crate::observation::{Observation, WordId};

/// The edge from a word to its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    pub(super) parent: WordId,
    /// Images that show both.
    pub(super) both: u32,
    pub(super) mutual_information_nats: f64,
}

/// How often words are seen, and the probabilities that follow.
pub(super) struct WordStatistics {
    images: u32,
    /// Images that show each word.
    pub(super) seen: Vec<u32>,
    /// Images of word q: `images_of[first_image[q]..first_image[q + 1]]`.
    first_image: Vec<usize>,
    images_of: Vec<u32>,
    /// x ln x for x = 0..=images.
    x_ln_x: Vec<f64>,
    prior_images: f64,
    /// How often a word is seen on average, in (0, 1).
    mean_rate: f64,
}

impl WordStatistics {
    /// Counts all words of the observations, each below `words`.
    pub(super) fn count(
        observations: &[Observation],
        words: usize,
        prior_images: f64,
    ) -> Result<Self, TreeTrainingError> {
        if !(prior_images > 0.0 && prior_images.is_finite()) {
            return Err(TreeTrainingError::Prior { prior_images });
        }
        let images = u32::try_from(observations.len()).unwrap_or(u32::MAX);
        if images == 0 {
            return Err(TreeTrainingError::NoObservations);
        }
        let mut first_image = vec![0usize; words + 1];
        for (observation, z) in observations.iter().enumerate() {
            for &word in z.words() {
                let count = first_image.get_mut(word.index() + 1);
                *count.ok_or(TreeTrainingError::UnknownWord { observation, word, words })? += 1;
            }
        }
        let seen: Vec<u32> = first_image[1..].iter().map(|&count| count as u32).collect();
        for word in 0..words {
            first_image[word + 1] += first_image[word];
        }
        let mut next = first_image.clone();
        let mut images_of = vec![0u32; first_image[words]];
        for (image, z) in (0u32..).zip(observations) {
            for &word in z.words() {
                images_of[next[word.index()]] = image;
                next[word.index()] += 1;
            }
        }
        let x_ln_x =
            (0..=images).map(|x| if x == 0 { 0.0 } else { f64::from(x) * f64::from(x).ln() }).collect();
        // One imagined sighting and one imagined miss keep the rate off 0 and 1.
        let mean_rate = (images_of.len() as f64 + 1.0) / (f64::from(images) * words as f64 + 2.0);
        Ok(Self { images, seen, first_image, images_of, x_ln_x, prior_images, mean_rate })
    }

    pub(super) fn images_of(&self, word: WordId) -> &[u32] {
        &self.images_of[self.first_image[word.index()]..self.first_image[word.index() + 1]]
    }

    /// Mutual information of two words seen in `a` and `b` images, `both` of them in common:
    ///
    /// I(X; Y) = Σ p(x, y) ln [p(x, y) / (p(x) p(y))] over the four states, in nats, which Chow &
    /// Liu 1968 weigh edges by. With counts for probabilities it is (Σ n_xy ln n_xy - Σ n_x ln n_x
    /// - Σ n_y ln n_y + n ln n) / n. Symmetric in the two words to the bit.
    pub(super) fn mutual_information_nats(&self, a: u32, b: u32, both: u32) -> f64 {
        let h = |count: u32| self.x_ln_x[count as usize];
        let (only_a, only_b) = (a - both, b - both);
        let neither = self.images - a - only_b;
        let joint = h(both) + h(neither) + (h(only_a) + h(only_b));
        let apart = (h(a) + h(b)) + (h(self.images - a) + h(self.images - b));
        (joint - apart + h(self.images)) / f64::from(self.images)
    }

    /// (n_seen + m · prior) / (n + m): the mean of a Beta distribution after n images, which began
    /// as if m images had shown the word at the rate `prior` (the m-estimate; Laplace's rule is m =
    /// 2, prior ½).
    fn smoothed(&self, seen: u32, images: u32, prior: f64) -> f64 {
        (f64::from(seen) + self.prior_images * prior) / (f64::from(images) + self.prior_images)
    }

    /// The row of a word: smoothed p(z_q), and p(z_q | z_pq) if it has a parent.
    pub(super) fn dependence(&self, word: WordId, edge: Option<Edge>) -> WordDependence {
        let seen = self.seen[word.index()];
        let marginal = self.smoothed(seen, self.images, self.mean_rate);
        let Some(Edge { parent, both, .. }) = edge else {
            return WordDependence {
                parent: word,
                marginal,
                given_parent_seen: marginal,
                given_parent_unseen: marginal,
            };
        };
        let parent_seen = self.seen[parent.index()];
        WordDependence {
            parent,
            marginal,
            given_parent_seen: self.smoothed(both, parent_seen, marginal),
            given_parent_unseen: self.smoothed(seen - both, self.images - parent_seen, marginal),
        }
    }
}
