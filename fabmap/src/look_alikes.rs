//! What look-alikes of a kind reach: how much geometry finds in common between *different* places,
//! learnt from a model's own training images, which are known to be different places.
//!
//! Floors of one architect share more than halls that have nothing to do with each other, so one
//! number for all places would be too bold for the ones and too shy for the others. An image is
//! therefore held against the training images that it resembles most.

use crate::baselines::TfIdf;
use crate::observation::Observation;

/// Training images that an image is held to be of the kind of. From 10 to 30 the development
/// sequences are told apart alike.
const KINDRED_IMAGES: usize = 30;

/// Training images before and after an image that may show the same place.
const NEIGHBOURS: usize = 40;

/// How fast what training images say loses weight beside what the map itself has seen, as an image
/// resembles them less than they resemble each other.
const FAMILIARITY_EXPONENT: i32 = 8;

/// What the best look-alike of each image of a model's sampling set shows, and how much those
/// images resemble each other.
#[derive(Clone, Debug, PartialEq)]
pub struct LookAlikes {
    shares: Vec<f32>,
    usual_likeness: f64,
}

/// Numbers that are not of the images of one sampling set.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LookAlikesError {
    /// One for each image is needed.
    #[error("{shares} look-alikes for {images} images; give one for each")]
    Count {
        /// Numbers given.
        shares: usize,
        /// Images of the sampling set.
        images: usize,
    },
    /// A share is a number from 0 on.
    #[error("a look-alike's share must be a number from 0 on, not {value}; leave look-alikes out")]
    Share {
        /// The number given.
        value: f32,
    },
    /// A cosine lies in 0 to 1.
    #[error("how much training images resemble each other must lie in 0 to 1, not {value}")]
    Likeness {
        /// The number given.
        value: f64,
    },
}

impl LookAlikes {
    /// `shares`: for each image of the sampling set of a model of `vocabulary_len` words, in its
    /// order, the evidence of the best wrong candidate (inliers beyond chance) over the different
    /// words of the image.
    ///
    /// # Errors
    /// [`LookAlikesError`] if they are not one number from 0 on for each image.
    pub fn new(
        shares: Vec<f32>,
        sampling_set: &[Observation],
        vocabulary_len: usize,
    ) -> Result<Self, LookAlikesError> {
        let images = all_of(sampling_set, vocabulary_len);
        let likeness = (0..).zip(sampling_set).map(|(image, seen)| likeness_to_others(&images, image, seen));
        let mut likeness: Vec<f64> = likeness.collect();
        likeness.sort_by(f64::total_cmp);
        let usual_likeness = likeness.get(likeness.len() / 2).copied().unwrap_or(0.0);
        Self::from_parts(shares, usual_likeness, sampling_set.len())
    }

    /// The same with the median likeness of training images to each other, a cosine.
    pub(crate) fn from_parts(
        shares: Vec<f32>,
        usual_likeness: f64,
        images: usize,
    ) -> Result<Self, LookAlikesError> {
        if shares.len() != images {
            return Err(LookAlikesError::Count { shares: shares.len(), images });
        }
        // Unit vectors are of length 1 but for rounding.
        if !(0.0..=1.0 + 1e-9).contains(&usual_likeness) {
            return Err(LookAlikesError::Likeness { value: usual_likeness });
        }
        match shares.iter().find(|share| !share.is_finite() || **share < 0.0) {
            Some(&value) => Err(LookAlikesError::Share { value }),
            None => Ok(Self { shares, usual_likeness }),
        }
    }

    /// Of each image of the sampling set.
    #[must_use]
    pub fn shares(&self) -> &[f32] {
        &self.shares
    }

    /// Median over the training images of their likeness to others of another place, a cosine.
    #[must_use]
    pub fn usual_likeness(&self) -> f64 {
        self.usual_likeness
    }
}

fn all_of(sampling_set: &[Observation], vocabulary_len: usize) -> TfIdf {
    let mut images = TfIdf::new(sampling_set, vocabulary_len);
    sampling_set.iter().for_each(|sample| images.add(sample));
    images
}

/// What look-alikes of one image's kind reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Evidence of the best look-alike that is expected, per word of the image: the mean of the
    /// thirty training images that resemble it most.
    pub share: f64,
    /// How much the image resembles those, over how much training images resemble each other,
    /// to the eighth power: about 1 where the model knows the kind.
    pub familiarity: f64,
}

/// Tells of what kind an image is, by its words.
#[derive(Clone, Debug)]
pub struct Kinds {
    images: TfIdf,
    shares: Vec<f64>,
    /// Median over the training images of their likeness to others.
    usual_likeness: f64,
}

impl Kinds {
    /// Over the sampling set of a model of `vocabulary_len` words, whose look-alikes are known.
    #[must_use]
    pub(crate) fn new(sampling_set: &[Observation], vocabulary_len: usize, look_alikes: &LookAlikes) -> Self {
        Self {
            images: all_of(sampling_set, vocabulary_len),
            shares: look_alikes.shares.iter().map(|&share| f64::from(share)).collect(),
            usual_likeness: look_alikes.usual_likeness,
        }
    }

    /// The kind of an image, by what it shows.
    #[must_use]
    pub fn of(&self, observation: &Observation) -> Kind {
        let mut similar: Vec<(f64, usize)> =
            self.images.similarities(observation).into_iter().zip(0..).collect();
        let kindred = most_similar(&mut similar);
        let count = kindred.len().max(1) as f64;
        let share = kindred.iter().map(|&(_, image)| self.shares[image]).sum::<f64>() / count;
        let likeness = kindred.iter().map(|(similarity, _)| similarity).sum::<f64>() / count;
        let relative = if self.usual_likeness > 0.0 { likeness / self.usual_likeness } else { 0.0 };
        Kind { share, familiarity: relative.powi(FAMILIARITY_EXPONENT) }
    }
}

/// Mean similarity of a training image to those that resemble it most, its neighbours left out.
fn likeness_to_others(images: &TfIdf, image: usize, observation: &Observation) -> f64 {
    let mut similar: Vec<(f64, usize)> = images.similarities(observation).into_iter().zip(0..).collect();
    similar.retain(|(_, other)| other.abs_diff(image) > NEIGHBOURS);
    let kindred = most_similar(&mut similar);
    kindred.iter().map(|(similarity, _)| similarity).sum::<f64>() / kindred.len().max(1) as f64
}

/// The [`KINDRED_IMAGES`] most similar; of equal ones the first. Summed in this order, the same
/// images give the same bits.
fn most_similar(similar: &mut [(f64, usize)]) -> &[(f64, usize)] {
    let by_similarity = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1));
    let wanted = KINDRED_IMAGES.min(similar.len());
    if wanted < similar.len() {
        similar.select_nth_unstable_by(wanted, by_similarity);
    }
    let kindred = &mut similar[..wanted];
    kindred.sort_by(by_similarity);
    kindred
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const WORDS: u32 = 60;

    fn observation(words: impl IntoIterator<Item = u32>) -> Observation {
        Observation::from_words(words, WORDS as usize).unwrap()
    }

    /// A hundred images of twenty words of one half of the vocabulary, and a hundred of the other;
    /// those of the first half have look-alikes.
    fn two_kinds() -> Kinds {
        let image = |number: u32| {
            let half = if number < 100 { 0 } else { WORDS / 2 };
            observation((0..10).map(|word| half + (7 * number + 3 * word) % (WORDS / 2)))
        };
        let images: Vec<Observation> = (0..200).map(image).collect();
        let shares = (0..200).map(|number| if number < 100 { 0.2 } else { 0.01 }).collect();
        let look_alikes = LookAlikes::new(shares, &images, WORDS as usize).unwrap();
        Kinds::new(&images, WORDS as usize, &look_alikes)
    }

    #[test]
    fn an_image_is_of_the_kind_that_it_resembles() {
        let kinds = two_kinds();
        let first = kinds.of(&observation([0, 3, 6, 9, 12, 15]));
        let second = kinds.of(&observation([30, 33, 36, 39, 42, 45]));
        assert!((first.share - 0.2).abs() < 1e-6, "{first:?}");
        assert!((second.share - 0.01).abs() < 1e-6, "{second:?}");
        assert!(first.familiarity > 0.1, "{first:?}");
        let unlike = kinds.of(&observation([]));
        assert_eq!(unlike.familiarity, 0.0);
    }

    #[test]
    fn what_is_not_of_the_sampling_set_is_refused() {
        let images = [observation([1]), observation([2])];
        let of = |shares: &[f32]| LookAlikes::new(shares.to_vec(), &images, WORDS as usize);
        assert_eq!(of(&[0.1]), Err(LookAlikesError::Count { shares: 1, images: 2 }));
        assert!(of(&[0.0, -0.1]).is_err() && of(&[f32::NAN, 0.0]).is_err() && of(&[0.3, 0.0]).is_ok());
        assert!(LookAlikes::from_parts(vec![0.1], 1.5, 1).is_err());
    }

    proptest! {
        /// Against sorting all of them.
        #[test]
        fn the_most_similar_are_the_first_of_all_sorted(values in proptest::collection::vec(0..20u32, 0..80)) {
            let all: Vec<(f64, usize)> = values.iter().map(|&value| f64::from(value)).zip(0..).collect();
            let mut sorted = all.clone();
            sorted.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            sorted.truncate(KINDRED_IMAGES);
            let mut unsorted = all.clone();
            prop_assert_eq!(most_similar(&mut unsorted), sorted.as_slice());
        }
    }
}
