//! Tests of the whole vocabulary, through its public functions.

use super::*;
use proptest::prelude::*;
use rand::RngExt;

const KINDS: [DescriptorKind; 2] = [DescriptorKind::Float, DescriptorKind::Binary];

fn silent(_: TrainingProgress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn settings(words: u32) -> VocabularySettings {
    VocabularySettings { words, ..VocabularySettings::default() }
}

/// Random rows with slightly different copies of each, group by group: float values differ by up to
/// 6 of 255, binary rows in up to `width / 16` bits. `noise` makes other copies of the same rows.
fn clustered(kind: DescriptorKind, width: usize, groups: usize, members: usize, noise: u64) -> Descriptors {
    let mut centres = ChaCha8Rng::seed_from_u64(1);
    let mut noise = ChaCha8Rng::seed_from_u64(noise);
    let mut bytes = Vec::with_capacity(groups * members * width);
    for _ in 0..groups {
        let group: Vec<u8> = (0..width).map(|_| centres.random()).collect();
        for _ in 0..members {
            let start = bytes.len();
            bytes.extend_from_slice(&group);
            match kind {
                DescriptorKind::Float => {
                    for value in &mut bytes[start..] {
                        *value = value.saturating_add_signed(noise.random_range(-6..=6));
                    }
                }
                DescriptorKind::Binary => {
                    for _ in 0..width.div_ceil(16) {
                        bytes[start + noise.random_range(0..width)] ^= 1 << noise.random_range(0..8);
                    }
                }
            }
        }
    }
    Descriptors::new(kind, width, bytes).unwrap()
}

fn encoded(vocabulary: &Vocabulary) -> Vec<u8> {
    let mut writer = Writer::default();
    vocabulary.encode(&mut writer);
    writer.into_bytes()
}

fn decoded(bytes: &[u8]) -> Result<Vocabulary, DecodeError> {
    let mut reader = Reader::new(bytes);
    let vocabulary = Vocabulary::decode(&mut reader)?;
    reader.end()?;
    Ok(vocabulary)
}

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
        assert_eq!(of_groups, (0..groups as u32).collect::<Vec<_>>(), "{kind:?}: two clusters share a word");
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
                let word = vocabulary.word(row) as usize;
                kind.distance(row, &rows[word * 32..(word + 1) * 32]) == exact.nearest_one(row).distance
            })
            .count();
        assert!(as_near * 100 >= queries.len() * 97, "{kind:?}: {as_near} of {}", queries.len());
    }
}

/// The form says how many words a search compares; one that does not say it compares as many as when
/// it was made, so its words stay what they were.
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
                let word = vocabulary.word(row) as usize;
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
        (0..30).map(|word| (word, 7)).collect::<Vec<_>>()
    );
}

/// A tree of two inner nodes with two leaves each, between lines of other kinds.
fn orb_text() -> String {
    let node =
        |parent: u32, leaf: u8, byte: u8| format!("{parent} {leaf} {}0.5", format!("{byte} ").repeat(32));
    let nodes =
        [node(0, 0, 0), node(0, 0, 255), node(2, 1, 252), node(1, 1, 0), node(1, 1, 1), node(2, 1, 255)];
    format!("10 6 0 0\n{}\n", nodes.join("\n"))
}

#[test]
fn an_orb_text_is_descended_as_written() {
    for text in
        [orb_text(), orb_text().replace('\n', "\r\n"), orb_text() + "\n  \n\n", orb_text().replace(' ', "  ")]
    {
        let vocabulary = Vocabulary::from_orb_text(&text).unwrap();
        assert_eq!(
            (vocabulary.len(), vocabulary.kind(), vocabulary.width()),
            (4, DescriptorKind::Binary, 32)
        );
        // Leaves in file order: 252 (below 255), 0 and 1 (below 0), 255.
        for (byte, word) in [(252, 0), (0, 1), (1, 2), (255, 3), (3, 2), (128, 1)] {
            assert_eq!(vocabulary.word(&[byte; 32]), word, "{byte}");
        }
        // As far from both inner nodes: the first in the file, then the nearer of its leaves.
        assert_eq!(vocabulary.word(&[0b0000_1111; 32]), 2);
        assert_eq!(decoded(&encoded(&vocabulary)), Ok(vocabulary));
    }
}

#[test]
fn each_fault_of_an_orb_text_is_named_with_its_line() {
    let message = |text: &str| Vocabulary::from_orb_text(text).unwrap_err().to_string();
    let text = orb_text();
    let with_line = |line: usize, changed: &str| {
        let mut lines: Vec<&str> = text.lines().collect();
        lines[line - 1] = changed;
        message(&lines.join("\n"))
    };
    let row = "7 ".repeat(32);
    for (fault, expected) in [
        (message(""), "line 1 should be four whole numbers"),
        (message("%YAML:1.0"), "but is \"%YAML:1.0\""),
        (message("10 6 0"), "line 1 should be four whole numbers"),
        (with_line(1, "21 6 0 0"), "k (children of a node) is 21, but must be 2 to 20"),
        (with_line(1, "1 6 0 0"), "k (children of a node) is 1, but must be 2 to 20"),
        (with_line(1, "10 11 0 0"), "L (levels) is 11, but must be 1 to 10"),
        (with_line(1, "10 0 0 0"), "L (levels) is 0, but must be 1 to 10"),
        (with_line(1, "10 6 6 0"), "the scoring is 6, but must be 0 to 5"),
        (with_line(1, "10 6 0 4"), "the weighting is 4, but must be 0 to 3"),
        (message("10 6 0 0\n\n"), "there are no words"),
        (with_line(3, "0 0 1 2 3"), "line 3 has 5 fields, but a node has 35"),
        (with_line(3, &format!("0 0 {row} 7 0.5")), "line 3 has 36 fields"),
        (with_line(4, &format!("-1 1 {row} 0.5")), "line 4: \"-1\" is not the number of a node"),
        (with_line(4, &format!("2 2 {row} 0.5")), "line 4: \"2\" is not a leaf flag, 0 or 1"),
        (with_line(4, &format!("2 x {row} 0.5")), "line 4: \"x\" is not a leaf flag, 0 or 1"),
        (
            with_line(5, &format!("1 1 {} 0.5", row.replacen('7', "256", 1))),
            "\"256\" is not a byte, 0 to 255",
        ),
        (with_line(5, &format!("1 1 {row} heavy")), "line 5: \"heavy\" is not a weight"),
        (with_line(5, &format!("9 1 {row} 0.5")), "line 5: this node does not fit the tree: its parent 9"),
        (
            with_line(6, &format!("3 1 {row} 0.5")),
            "line 6: this node does not fit the tree: its parent 3 is marked",
        ),
        (with_line(7, &format!("0 0 {row} 0.5")), "line 7: this node does not fit the tree: it is neither"),
        (with_line(1, "10 1 0 0"), "line 4: this node does not fit the tree: it lies more than L = 1"),
        (
            message(&format!("{text}0 1 {row} 1\n").replacen("10", "2", 1)),
            "its parent 0 has more than k = 2 children",
        ),
    ] {
        assert!(fault.contains(expected), "\"{fault}\" does not say \"{expected}\"");
    }
}

#[test]
fn a_blank_line_does_not_shift_the_line_of_a_fault() {
    let row = "7 ".repeat(32);
    let text = format!("10 6 0 0\n\n0 1 {row}1\n0 0 {row}1\n0 1 {row}1\n");
    let fault = Vocabulary::from_orb_text(&text).unwrap_err();
    assert_eq!(fault, OrbVocabularyError::Node { line: 4, source: TreeError::Childless });
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
                prop_assert_eq!(word, distances.zip(0..).min().unwrap().1);
                prop_assert_eq!(word, vocabulary.word(row));
            }
        }
    }

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
            prop_assert!((vocabulary.word(&descriptor) as usize) < vocabulary.len());
        }
    }

    #[test]
    fn foreign_bytes_are_refused_or_quantize_without_panic(
        head in (0..3u8, 1..4u8, 0..5u8), bytes in proptest::collection::vec(prop_oneof![any::<u8>(), 0..4u8], 0..120),
    ) {
        let bytes = [vec![head.0, head.1, head.2], bytes].concat();
        if let Ok(vocabulary) = Vocabulary::decode(&mut Reader::new(&bytes)) {
            prop_assert!(!vocabulary.is_empty());
            prop_assert!((vocabulary.word(&vec![170; vocabulary.width()]) as usize) < vocabulary.len());
        }
    }

    #[test]
    fn foreign_text_never_panics(text in "[0-9 .\n-]{0,200}") {
        prop_assert!(Vocabulary::from_orb_text(&text).is_err());
    }
}
