//! Observations and byte forms of whole vocabularies.

use super::test_vocabularies::{KINDS, clustered, decoded, encoded, settings, silent};
use super::*;
use crate::vocabulary::orb_text::tests::orb_text;
use proptest::prelude::*;

#[test]
fn descriptors_of_another_feature_are_refused_and_none_are_no_words() {
    let descriptors = clustered(DescriptorKind::Float, 8, 5, 5, 10);
    let vocabulary = Vocabulary::train(&descriptors, &settings(5), &mut silent).unwrap();
    let other = Descriptors::new(DescriptorKind::Binary, 8, vec![0; 8]).unwrap();
    assert!(matches!(
        vocabulary.words(&other),
        Err(VocabularyError::Descriptors(DescriptorError::Mismatch { .. }))
    ));
    let wider = Descriptors::new(DescriptorKind::Float, 9, vec![0; 9]).unwrap();
    assert!(vocabulary.observe(&wider).is_err());
    let none = Descriptors::new(DescriptorKind::Float, 8, Vec::new()).unwrap();
    assert_eq!(vocabulary.words(&none), Ok(Vec::new()));
    assert!(vocabulary.observe(&none).unwrap().is_empty());
}

#[test]
fn an_observation_counts_each_word() {
    let descriptors = clustered(DescriptorKind::Float, 16, 30, 7, 11);
    let vocabulary = Vocabulary::train(&descriptors, &settings(30), &mut silent).unwrap();
    let observation = vocabulary.observe(&descriptors).unwrap();
    assert_eq!(
        observation.word_counts().collect::<Vec<_>>(),
        WordId::first(30).map(|word| (word, 7)).collect::<Vec<_>>()
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn bytes_give_the_vocabulary_back_and_no_cut_passes(
        seed in any::<u64>(), tree in any::<bool>(), cut in any::<prop::sample::Index>(),
    ) {
        for kind in KINDS {
            let descriptors = clustered(kind, 13, 12, 5, seed);
            let limit = if tree { 2 } else { 100 };
            let vocabulary = Vocabulary::train_with_limit(&descriptors, &settings(20), limit, &mut silent).unwrap();
            let bytes = encoded(&vocabulary);
            prop_assert_eq!(decoded(&bytes), Ok(vocabulary));
            prop_assert!(decoded(&bytes[..cut.index(bytes.len())]).is_err());
        }
    }

    #[test]
    fn damaged_bytes_are_refused_or_quantize_without_panic(
        seed in any::<u64>(), form in 0..3u8,
        damage in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let vocabulary = match form {
            0 | 1 => {
                let descriptors = clustered(DescriptorKind::Float, 5, 12, 5, seed);
                let limit = if form == 0 { 2 } else { 100 };
                Vocabulary::train_with_limit(&descriptors, &settings(20), limit, &mut silent).unwrap()
            }
            _ => Vocabulary::from_orb_text(&orb_text()).unwrap(),
        };
        let mut bytes = encoded(&vocabulary);
        for (place, value) in damage {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(vocabulary) = decoded(&bytes) {
            let descriptor: Vec<u8> = (0..vocabulary.width()).map(|index| (seed >> (index % 64)) as u8).collect();
            prop_assert!(vocabulary.word(&descriptor).index() < vocabulary.len());
        }
    }

    #[test]
    fn foreign_bytes_are_refused_or_quantize_without_panic(
        head in (0..3u8, 1..4u8, 0..5u8), bytes in proptest::collection::vec(prop_oneof![any::<u8>(), 0..4u8], 0..120),
    ) {
        let bytes = [vec![head.0, head.1, head.2], bytes].concat();
        if let Ok(vocabulary) = Vocabulary::decode(&mut Reader::new(&bytes)) {
            prop_assert!(!vocabulary.is_empty());
            prop_assert!(vocabulary.word(&vec![170; vocabulary.width()]).index() < vocabulary.len());
        }
    }
}
