//! Which images of a map may be similar to a new one: a vote of features, without a look at the
//! images themselves.
//!
//! A feature votes for the images that have one of the same word, the more the less their
//! signatures differ (Jégou, Douze & Schmid, "Hamming embedding and weak geometric consistency",
//! ECCV 2008). Of their geometry one thing is used: who moves in a plane sees above the horizon
//! what was above it. Votes over the rotation between the images, as there, bring nothing here:
//! things as near as those of a room do not turn alike.

use std::sync::{Arc, LazyLock};

use crate::appearance::signature::{Signature, SignedWord};
use fabmap::observation::WordId;
use nalgebra::Vector3;

use super::ImageId;

/// A feature of a panorama as the index has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IndexedFeature {
    word: WordId,
    signature: Signature,
    /// Height over distance, in thousandths.
    slope: i16,
}

/// The images of a map by the words of their features.
///
/// A clone shares all that is no longer added to.
#[derive(Clone, Debug, Default)]
pub struct CandidateIndex {
    /// All but the last are full.
    blocks: Vec<Arc<Block>>,
    /// By image.
    features: Vec<u32>,
}

/// Features of [`BLOCK_IMAGES`] images, by word, then image.
#[derive(Clone, Debug, Default)]
struct Block {
    postings: Vec<Posting>,
}

#[derive(Clone, Copy, Debug)]
struct Posting {
    word: WordId,
    signature: Signature,
    slope: i16,
    /// Within the block.
    image: u16,
}

/// As many as make it cheap to add one.
const BLOCK_IMAGES: usize = 256;

/// Heights over distance, in thousandths, that differ by no more may be on different sides of the
/// horizon: twice the tolerance of a matched ray.
const HORIZON_SLOPE: u16 = 30;

/// Share of a signature's bits at whose square a vote falls by e. The larger it is, the more do
/// features count that merely share a word: those of a vocabulary that was learnt elsewhere, whose
/// centres are not in the middle of what falls to them, differ in fewer than half of the bits.
const BITS_SHARE: f64 = 0.16;

/// A whole vote. Votes are integers, so that it does not matter in which order they are counted.
const WHOLE_VOTE: f64 = 65_536.0;

/// Votes by the number of bits that differ.
static VOTES: LazyLock<[u32; Signature::BITS as usize + 1]> = LazyLock::new(|| {
    std::array::from_fn(|bits| {
        let share = bits as f64 / f64::from(Signature::BITS);
        (WHOLE_VOTE * (-(share / BITS_SHARE).powi(2)).exp()).round() as u32
    })
});

impl IndexedFeature {
    /// A feature that lies in the direction of `ray`, z up.
    #[must_use]
    pub fn new(SignedWord { word, signature }: SignedWord, ray: &Vector3<f64>) -> Self {
        // Of a ray straight up it is the largest there is.
        Self { word, signature, slope: (1000.0 * ray.z / ray.xy().norm()).round() as i16 }
    }

    /// What the feature gives to the image of one of the same word.
    fn vote(&self, other: &Posting) -> u32 {
        let is_on_one_side = (self.slope > 0) == (other.slope > 0);
        if !is_on_one_side && self.slope.abs_diff(other.slope) > HORIZON_SLOPE {
            return 0;
        }
        VOTES[self.signature.differing_bits(other.signature) as usize]
    }
}

impl CandidateIndex {
    /// Adds an image; images are numbered from 0 in order.
    pub fn add(&mut self, features: &[IndexedFeature]) {
        let image = (self.features.len() % BLOCK_IMAGES) as u16;
        if image == 0 {
            self.blocks.push(Arc::default());
        }
        if let Some(last) = self.blocks.last_mut() {
            let postings = &mut Arc::make_mut(last).postings;
            let posting = |feature: &IndexedFeature| {
                let IndexedFeature { word, signature, slope } = *feature;
                Posting { word, signature, slope, image }
            };
            postings.extend(features.iter().map(posting));
            // It is in order but for the new ones; equal words keep the order of their images.
            postings.sort_by_key(|posting| posting.word);
        }
        self.features.push(features.len() as u32);
    }

    /// Number of images.
    #[must_use]
    pub fn len(&self) -> usize {
        self.features.len()
    }

    /// Whether there are no images yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.features.is_empty()
    }

    /// What an image's features vote for each image of the map, by the smaller number of features:
    /// an estimate of the share that match, from 0 up.
    ///
    /// Each feature gives each image its best vote. The order of features is of no account.
    #[must_use]
    pub fn votes(&self, features: &[IndexedFeature]) -> Vec<f64> {
        let mut features = features.to_vec();
        features.sort_unstable_by_key(|feature| feature.word);
        let mut votes = vec![0_u64; self.len()];
        for (block, votes) in self.blocks.iter().zip(votes.chunks_mut(BLOCK_IMAGES)) {
            block.vote(&features, votes);
        }
        let share = |(&votes, &earlier): (&u64, &u32)| {
            let fewer = (features.len() as u32).min(earlier).max(1);
            votes as f64 / WHOLE_VOTE / f64::from(fewer)
        };
        votes.iter().zip(&self.features).map(share).collect()
    }

    /// The `most` images that an image's features vote for most, those first.
    #[must_use]
    pub fn most_voted(&self, features: &[IndexedFeature], most: usize) -> Vec<ImageId> {
        let votes = self.votes(features);
        let mut images: Vec<ImageId> = (0..votes.len() as ImageId).collect();
        images.sort_unstable_by(|&a, &b| votes[b as usize].total_cmp(&votes[a as usize]).then(a.cmp(&b)));
        images.truncate(most);
        images
    }

    /// Memory that the features take.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        self.blocks.iter().map(|block| block.postings.capacity() * size_of::<Posting>()).sum()
    }
}

impl Block {
    /// Adds the votes of features, which are in the order of their words.
    fn vote(&self, features: &[IndexedFeature], votes: &mut [u64]) {
        let mut rest = self.postings.as_slice();
        for feature in features {
            let word = feature.word;
            rest = &rest[rest.partition_point(|posting| posting.word < word)..];
            let same = &rest[..rest.partition_point(|posting| posting.word == word)];
            for of_image in same.chunk_by(|a, b| a.image == b.image) {
                let best = of_image.iter().map(|posting| feature.vote(posting)).max();
                votes[usize::from(of_image[0].image)] += u64::from(best.unwrap_or(0));
            }
        }
    }
}

#[cfg(test)]
mod tests;
