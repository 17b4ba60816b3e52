//! tf-idf ranking of images by cosine, as bag-of-words engines do it (Sivic & Zisserman, "Video
//! Google", ICCV 2003).
//!
//! An image is the vector of n_q · ln(N / (1 + N_q)) over words q: n_q times seen in it, N_q of N
//! training images show it. Images are compared by (v · w) / (‖v‖ ‖w‖).

use crate::observation::{Observation, WordId};

/// Images ranked by the cosine of their tf-idf vectors: no probabilities, no new place, no time.
#[derive(Clone, Debug)]
pub struct TfIdf {
    /// ln(N / (1 + N_q)) per word, at least 0. The 1 keeps words that no training image shows
    /// finite.
    inverse_document_frequency: Vec<f64>,
    /// Per word: image and weight, ascending by image.
    postings: Vec<Vec<(u32, f64)>>,
    images: u32,
}

impl TfIdf {
    /// Learns the words' weights from training observations of a vocabulary of `words` words.
    #[must_use]
    pub fn new(training: &[Observation], words: usize) -> Self {
        let mut seen = vec![0u32; words];
        for &word in training.iter().flat_map(Observation::words) {
            if let Some(count) = seen.get_mut(word.index()) {
                *count += 1;
            }
        }
        let images = training.len() as f64;
        let weight = |count: u32| (images / (1.0 + f64::from(count))).ln().max(0.0);
        Self {
            inverse_document_frequency: seen.into_iter().map(weight).collect(),
            postings: vec![Vec::new(); words],
            images: 0,
        }
    }

    /// Adds an image; images are numbered from 0 in order.
    pub fn add(&mut self, observation: &Observation) {
        for (word, weight) in self.unit_vector(observation) {
            self.postings[word.index()].push((self.images, weight));
        }
        self.images += 1;
    }

    /// Cosine with every image added, in [0, 1], in order of image.
    #[must_use]
    pub fn similarities(&self, observation: &Observation) -> Vec<f64> {
        let mut similarities = vec![0.0; self.images as usize];
        for (word, weight) in self.unit_vector(observation) {
            for &(image, other) in &self.postings[word.index()] {
                similarities[image as usize] += weight * other;
            }
        }
        similarities
    }

    fn unit_vector(&self, observation: &Observation) -> Vec<(WordId, f64)> {
        let mut vector: Vec<(WordId, f64)> = observation
            .word_counts()
            .filter_map(|(word, count)| {
                let weight = self.inverse_document_frequency.get(word.index())?;
                Some((word, f64::from(count) * weight))
            })
            .collect();
        let length = vector.iter().map(|(_, weight)| weight * weight).sum::<f64>().sqrt();
        if length > 0.0 {
            vector.iter_mut().for_each(|(_, weight)| *weight /= length);
        }
        vector
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(words: &[u32]) -> Observation {
        Observation::from_words(words.iter().copied(), 4).unwrap()
    }

    #[test]
    fn rare_words_in_common_rank_first() {
        let training = [observation(&[0, 1]), observation(&[0, 2]), observation(&[0, 1]), observation(&[1])];
        let mut baseline = TfIdf::new(&training, 4);
        baseline.add(&observation(&[1, 2]));
        baseline.add(&observation(&[0, 1]));
        baseline.add(&observation(&[2, 2, 1]));
        let similarities = baseline.similarities(&observation(&[2]));
        assert_eq!(similarities[1], 0.0);
        assert!(similarities[2] >= similarities[0] && similarities[0] > 0.9);
        let itself = baseline.similarities(&observation(&[2, 2, 1]))[2];
        assert!((itself - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_image_without_words_is_like_none() {
        let mut baseline = TfIdf::new(&[observation(&[0])], 4);
        baseline.add(&observation(&[1]));
        assert_eq!(baseline.similarities(&observation(&[])), [0.0]);
    }
}
