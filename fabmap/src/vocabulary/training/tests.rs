//! Training, through the vocabularies that it makes.

use super::*;
use crate::codec::Writer;
use crate::descriptor::DescriptorKind;
use crate::observation::WordId;
use crate::quantizer::FIRST_FORM_WORDS_COMPARED;
use crate::vocabulary::test_vocabularies::{KINDS, clustered, decoded, encoded, settings, silent};
use proptest::prelude::*;

#[test]
fn well_separated_clusters_are_found() {
    for kind in KINDS {
        let groups = 12;
        let descriptors = clustered(kind, 64, groups, 20, 1);
        let vocabulary = Vocabulary::train(&descriptors, &settings(groups as u32), &mut silent).unwrap();
        let words = vocabulary.words(&descriptors).unwrap();
        let mut of_groups: Vec<WordId> = words
            .chunks(20)
            .map(|group| {
                assert!(group.iter().all(|word| *word == group[0]), "{kind:?}: a cluster was torn");
                group[0]
            })
            .collect();
        of_groups.sort_unstable();
        assert_eq!(
            of_groups,
            WordId::first(groups).collect::<Vec<_>>(),
            "{kind:?}: two clusters share a word"
        );
    }
}

#[test]
fn a_large_vocabulary_has_exactly_its_words_and_its_tree_finds_nearly_always_the_nearest() {
    for kind in KINDS {
        let descriptors = clustered(kind, 32, 100, 300, 2);
        let settings = VocabularySettings { words: 20_000, seed: 3, iterations: 4 };
        let vocabulary = Vocabulary::train_with_limit(&descriptors, &settings, 1000, &mut silent).unwrap();
        assert!(matches!(vocabulary.quantizer, Quantizer::Tree(_)));
        assert_eq!(vocabulary.len(), 20_000);

        let queries = clustered(kind, 32, 100, 30, 4);
        let rows = vocabulary.centres().as_bytes().to_vec();
        let exact = Centres::pack(kind, 32, &rows);
        let as_near = queries
            .rows()
            .filter(|row| {
                let word = vocabulary.word(row).index();
                kind.distance(row, &rows[word * 32..(word + 1) * 32]) == exact.nearest_one(row).distance
            })
            .count();
        assert!(as_near * 100 >= queries.len() * 97, "{kind:?}: {as_near} of {}", queries.len());
    }
}

/// The form says how many words a search compares; one that does not say it compares as many as
/// when it was made, so its words stay what they were.
#[test]
fn trees_of_the_first_form_keep_their_bytes_and_their_search() {
    let descriptors = clustered(DescriptorKind::Float, 8, 60, 10, 12);
    let made = Vocabulary::train_with_limit(&descriptors, &settings(300), 100, &mut silent).unwrap();
    let bytes = encoded(&made);
    // Kind, width, form; then the number of words compared, which takes two bytes.
    assert_eq!(bytes[..3], [0, 8, 3]);
    let first_form = [&[0, 8, 1], &bytes[5..]].concat();
    let read = decoded(&first_form).unwrap();
    assert!(matches!(&read.quantizer, Quantizer::Tree(tree) if tree.words_compared() == 8192));
    assert_eq!(encoded(&read), first_form);
    // A vocabulary of fewer words is searched whole, so here the two agree with brute force.
    let exact = read.with_exact_search().words(&descriptors);
    assert_eq!(read.words(&descriptors), exact);
    assert_eq!(made.words(&descriptors), exact);

    for words_compared in [0, FIRST_FORM_WORDS_COMPARED] {
        let mut writer = Writer::default();
        writer.varint(u64::from(words_compared));
        let said = [&[0, 8, 3], &writer.into_bytes()[..], &bytes[5..]].concat();
        assert!(decoded(&said).is_err());
    }
}

#[test]
fn a_tree_can_have_as_many_words_as_there_are_descriptors() {
    for kind in KINDS {
        let descriptors = clustered(kind, 16, 40, 10, 4);
        let distinct = TrainingSet::new(&descriptors).len() as u32;
        for exact_words_max in [2, u32::MAX] {
            let train = |words| {
                Vocabulary::train_with_limit(&descriptors, &settings(words), exact_words_max, &mut silent)
            };
            let vocabulary = train(distinct).unwrap();
            assert_eq!(vocabulary.len(), distinct as usize);
            let rows = vocabulary.centres().as_bytes().to_vec();
            for row in descriptors.rows() {
                let word = vocabulary.word(row).index();
                assert_eq!(&rows[word * 16..(word + 1) * 16], row, "each descriptor is a word of its own");
            }
            let refused = train(distinct + 1).unwrap_err();
            assert_eq!(
                refused,
                VocabularyError::TooFewDescriptors { words: distinct + 1, distinct: distinct as usize }
            );
            assert!(refused.to_string().ends_with(&format!("ask for at most {distinct} words")));
        }
    }
}

#[test]
fn neither_threads_nor_the_order_of_descriptors_matter() {
    let on_threads = |threads: usize, train: &(dyn Fn() -> Vocabulary + Sync)| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(train)
    };
    for kind in KINDS {
        let descriptors = clustered(kind, 24, 300, 12, 5);
        let mut rows: Vec<&[u8]> = descriptors.rows().collect();
        rows.reverse();
        rows.rotate_left(1234);
        let reordered = Descriptors::new(kind, 24, rows.concat()).unwrap();
        for exact_words_max in [100, 1000] {
            let settings = VocabularySettings { words: 700, seed: 6, iterations: 5 };
            let train = |descriptors: &Descriptors| {
                Vocabulary::train_with_limit(descriptors, &settings, exact_words_max, &mut silent).unwrap()
            };
            let one = on_threads(1, &|| train(&descriptors));
            assert_eq!(one, on_threads(3, &|| train(&descriptors)));
            assert_eq!(one, on_threads(2, &|| train(&reordered)));
            assert_eq!(one.words(&descriptors), on_threads_words(4, &one, &descriptors));

            let other_seed = VocabularySettings { seed: 7, ..settings.clone() };
            let other = Vocabulary::train_with_limit(&descriptors, &other_seed, exact_words_max, &mut silent);
            assert_ne!(Ok(one), other);
        }
    }
}

fn on_threads_words(
    threads: usize,
    vocabulary: &Vocabulary,
    descriptors: &Descriptors,
) -> Result<Vec<WordId>, VocabularyError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| vocabulary.words(descriptors))
}

#[test]
fn progress_rises_and_training_can_be_cancelled_at_every_step() {
    let descriptors = clustered(DescriptorKind::Float, 8, 60, 10, 8);
    for exact_words_max in [10, 1000] {
        let mut steps = Vec::new();
        let train = |observer: &mut dyn FnMut(TrainingProgress) -> ControlFlow<()>| {
            Vocabulary::train_with_limit(&descriptors, &settings(400), exact_words_max, observer)
        };
        train(&mut |progress| {
            steps.push(progress);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert!(steps.len() >= 3);
        assert!(steps.is_sorted_by(|a, b| a.fraction <= b.fraction), "{steps:?}");
        assert!(steps.iter().all(|step| (0.0..=1.0).contains(&step.fraction)));

        for cancel_at in 0..steps.len() {
            let mut calls = 0;
            let cancelled = train(&mut |_| {
                calls += 1;
                if calls > cancel_at { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            });
            assert_eq!((cancelled, calls), (Err(VocabularyError::Cancelled), cancel_at + 1));
        }
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    let descriptors = clustered(DescriptorKind::Binary, 8, 5, 5, 9);
    let train = |words, iterations| {
        Vocabulary::train(&descriptors, &VocabularySettings { words, seed: 0, iterations }, &mut silent)
    };
    for words in [0, 1, 1_000_001] {
        assert_eq!(train(words, 5), Err(VocabularyError::Words { words }));
    }
    for iterations in [0, 1_001] {
        assert_eq!(train(5, iterations), Err(VocabularyError::Iterations { iterations }));
    }
    assert_eq!(
        train(1, 5).unwrap_err().to_string(),
        "a vocabulary of 1 words is not supported; ask for 2 to 1000000"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn quantization_below_the_limit_is_brute_force(
        width in 1..50usize, groups in 2..30usize, words in 2..60u32, seed in any::<u64>(),
    ) {
        for kind in KINDS {
            let descriptors = clustered(kind, width, groups, 8, seed);
            let words = words.min(TrainingSet::new(&descriptors).len() as u32);
            prop_assume!(words >= 2);
            let vocabulary = Vocabulary::train(&descriptors, &settings(words), &mut silent).unwrap();
            prop_assert_eq!(vocabulary.len(), words as usize);
            let centres = vocabulary.centres().as_bytes().to_vec();
            let queries = clustered(kind, width, groups, 3, seed ^ 1);
            let found = vocabulary.words(&queries).unwrap();
            for (row, word) in queries.rows().zip(found) {
                let distances = centres.chunks_exact(width).map(|centre| kind.distance(centre, row));
                prop_assert_eq!(word.number(), distances.zip(0..).min().unwrap().1);
                prop_assert_eq!(word, vocabulary.word(row));
            }
        }
    }
}
