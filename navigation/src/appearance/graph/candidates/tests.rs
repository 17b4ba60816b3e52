use std::ops::ControlFlow;

use crate::appearance::signature::Signatures;
use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use proptest::prelude::*;

use super::*;

const WIDTH: usize = 16;

fn vocabulary() -> Vocabulary {
    let training =
        (0..40 * WIDTH as u32).map(|number| (number.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let training = Descriptors::new(DescriptorKind::Float, WIDTH, training).unwrap();
    let settings = VocabularySettings { words: 6, ..VocabularySettings::default() };
    Vocabulary::train(&training, &settings, &mut |_| ControlFlow::Continue(())).unwrap()
}

/// Descriptors and slopes of an image's features.
type Look = Vec<([u8; WIDTH], f64)>;

/// Looks of which many features are much like each other.
fn look() -> impl Strategy<Value = Look> {
    let descriptor = (0..12_u8, prop::array::uniform16(0..40_u8)).prop_map(|(thing, noise)| {
        std::array::from_fn(|dimension| noise[dimension] + thing.wrapping_mul(41 + 16 * dimension as u8) / 2)
    });
    prop::collection::vec((descriptor, -0.8..0.8), 0..15)
}

fn indexed(signatures: &Signatures, vocabulary: &Vocabulary, look: &Look) -> Vec<IndexedFeature> {
    let rows = look.iter().flat_map(|(descriptor, _)| *descriptor).collect();
    let descriptors = Descriptors::new(DescriptorKind::Float, WIDTH, rows).unwrap();
    let words = vocabulary.words(&descriptors).unwrap();
    let signed = signatures.sign(&words, &descriptors).unwrap();
    let ray = |slope: f64| Vector3::new(0.6, -0.8, slope).normalize();
    signed.iter().zip(look).map(|(&word, &(_, slope))| IndexedFeature::new(word, &ray(slope))).collect()
}

/// Each feature with each, from the equation.
fn plain_votes(features: &[IndexedFeature], earlier: &[IndexedFeature]) -> f64 {
    let best = |feature: &IndexedFeature| {
        let of_word = earlier.iter().filter(|other| other.word == feature.word);
        let alike = of_word.filter(|other| {
            let slopes = [feature.slope, other.slope].map(f64::from);
            (slopes[0] > 0.0) == (slopes[1] > 0.0) || (slopes[0] - slopes[1]).abs() < 30.5
        });
        let votes = alike.map(|other| {
            let bits = f64::from(feature.signature.differing_bits(other.signature));
            (-(bits / 128.0 / 0.16).powi(2)).exp()
        });
        votes.fold(0.0, f64::max)
    };
    features.iter().map(best).sum::<f64>() / features.len().min(earlier.len()).max(1) as f64
}

proptest! {
    #[test]
    fn the_index_counts_as_the_equation_does(looks in prop::collection::vec(look(), 1..12), now in look(), most in 0..15_usize) {
        let vocabulary = vocabulary();
        let signatures = Signatures::new(&vocabulary);
        let looks: Vec<_> = looks.iter().map(|look| indexed(&signatures, &vocabulary, look)).collect();
        let now = indexed(&signatures, &vocabulary, &now);
        let mut index = CandidateIndex::default();
        // Beyond a block.
        for image in 0..2 * BLOCK_IMAGES + 3 {
            index.add(&looks[image % looks.len()]);
        }
        let votes = index.votes(&now);
        prop_assert_eq!(votes.len(), index.len());
        for (image, vote) in votes.iter().enumerate() {
            let plain = plain_votes(&now, &looks[image % looks.len()]);
            prop_assert!((vote - plain).abs() < 1e-4, "image {image}: {vote} {plain}");
        }
        let mut turned = now.clone();
        turned.reverse();
        prop_assert_eq!(&index.votes(&turned), &votes);
        let named = index.most_voted(&now, most);
        prop_assert_eq!(named.len(), most.min(index.len()));
        let last = named.last().map_or(f64::INFINITY, |&image| votes[image as usize]);
        let others = (0..index.len() as ImageId).filter(|image| !named.contains(image));
        prop_assert!(others.into_iter().all(|image| votes[image as usize] <= last));
        prop_assert!(named.windows(2).all(|pair| votes[pair[0] as usize] >= votes[pair[1] as usize]));
    }
}

#[test]
fn a_clone_shares_full_blocks_and_is_left_as_it_was() {
    let vocabulary = vocabulary();
    let look = vec![([9; WIDTH], 0.1)];
    let features = indexed(&Signatures::new(&vocabulary), &vocabulary, &look);
    let mut index = CandidateIndex::default();
    (0..BLOCK_IMAGES + 1).for_each(|_| index.add(&features));
    let before = index.clone();
    index.add(&features);
    assert_eq!((before.len(), index.len()), (BLOCK_IMAGES + 1, BLOCK_IMAGES + 2));
    assert!(Arc::ptr_eq(&before.blocks[0], &index.blocks[0]));
    assert_eq!(before.votes(&features), vec![1.0; BLOCK_IMAGES + 1]);
    assert!(index.memory_bytes() >= index.len() * size_of::<Posting>());
}
