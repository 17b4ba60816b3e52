//! The dense oracle and the index against the log-likelihoods of openFABMAP.
#![expect(clippy::unwrap_used, reason = "a fixture that does not read is a failed test")]

use std::path::Path;
use std::sync::Arc;

use fabmap::appearance::Appearance;
use fabmap::chow_liu::{ChowLiuTree, WordDependence};
use fabmap::detector::DetectorModel;
use fabmap::inverted_index::InvertedIndex;
use fabmap::likelihood::{Dependence, ObservationModel};
use fabmap::observation::Observation;

const GOLDEN_VALUES: usize = 3408;
const TOLERANCE: f64 = 1e-8;

fn read(name: &str) -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)).unwrap()
}

fn observations(name: &str) -> Vec<Observation> {
    let bytes = read(name);
    let mut numbers = bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap()));
    assert_eq!(numbers.next(), Some(0x3157_4f42));
    let vocabulary_len = numbers.next().unwrap() as usize;
    let images = numbers.next().unwrap();
    (0..images)
        .map(|_| {
            let words = numbers.next().unwrap() as usize;
            Observation::from_words(numbers.by_ref().take(words), vocabulary_len).unwrap()
        })
        .collect()
}

fn tree() -> ChowLiuTree {
    let text = String::from_utf8(read("tree.txt")).unwrap();
    ChowLiuTree::from_rows(text.lines().map(|line| {
        let fields: Vec<&str> = line.split(' ').collect();
        let probability = |field: usize| fields[field].parse().unwrap();
        WordDependence {
            parent: fields[0].parse::<u32>().unwrap().into(),
            marginal: probability(1),
            given_parent_seen: probability(2),
            given_parent_unseen: probability(3),
        }
    }))
    .unwrap()
}

struct Golden<'a> {
    dependence: Dependence,
    detector: DetectorModel,
    query: usize,
    target: &'a str,
    index: usize,
    log_likelihood: f64,
}

fn golden(line: &str) -> Golden<'_> {
    let fields: Vec<&str> = line.split(',').collect();
    let dependence = match fields[0] {
        "naive-bayes" => Dependence::NaiveBayes,
        "chow-liu" => Dependence::ChowLiu,
        other => panic!("unknown dependence {other}"),
    };
    Golden {
        dependence,
        detector: DetectorModel::new(fields[1].parse().unwrap(), fields[2].parse().unwrap()).unwrap(),
        query: fields[3].parse().unwrap(),
        target: fields[4],
        index: fields[5].parse().unwrap_or(0),
        log_likelihood: fields[6].parse().unwrap(),
    }
}

#[test]
fn dense_and_indexed_likelihoods_are_those_of_openfabmap() {
    let (tree, places, samples, queries) =
        (tree(), observations("places.bin"), observations("train.bin"), observations("queries.bin"));
    let csv = String::from_utf8(read("openfabmap.csv")).unwrap();
    let indexed =
        |model: &ObservationModel, observations: &[Observation], query: &Observation, index: usize| {
            let mut inverted = InvertedIndex::new(Arc::new(model.clone()));
            observations.iter().for_each(|z| {
                inverted.add(&Appearance::of(z));
            });
            inverted.log_likelihoods(query)[index]
        };
    let mut checked = 0;
    for value in csv.lines().skip(1).map(golden) {
        let model = ObservationModel::new(&tree, value.detector, value.dependence);
        let query = &queries[value.query];
        let (dense, sparse) = match value.target {
            "mean-field" => (
                model.dense_log_likelihood_of_average_place(query),
                model.log_likelihood_of_empty_place(&model.informative_words(query), 0),
            ),
            target => {
                let observations = if target == "place" { &places } else { &samples };
                (
                    model.dense_log_likelihood(query, &Appearance::of(&observations[value.index])),
                    indexed(&model, observations, query, value.index),
                )
            }
        };
        for found in [dense, sparse] {
            assert!(
                (found - value.log_likelihood).abs() < TOLERANCE,
                "{found} is not {}",
                value.log_likelihood
            );
        }
        checked += 1;
    }
    assert_eq!(checked, GOLDEN_VALUES);
}
