//! Vocabularies of other programs: trained over, imported as a model, mapped with.

use std::io::Write;
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::Value;
use waypost_vision::features::{Extractor, FeatureSettings};

use crate::harness::{Built, CommandLine, folder, images, json_object, path, run_to_its_end, workspace};

/// Children of a node, and levels below the root.
const BRANCHING: usize = 9;
const LEVELS: usize = 3;

const EXTRACTOR: &str = "orb features=500 width=320";

type Descriptor = [u8; 32];

fn distance(one: &Descriptor, other: &Descriptor) -> u32 {
    one.iter().zip(other).map(|(one, other)| (one ^ other).count_ones()).sum()
}

/// Every fifth photo's descriptors.
fn descriptors() -> Vec<Descriptor> {
    let extractor = Extractor::new(EXTRACTOR.parse::<FeatureSettings>().unwrap());
    let mut all = Vec::new();
    for image in images().iter().step_by(5) {
        let (_, features) = extractor.extract_encoded(image).unwrap();
        all.extend(
            features.descriptors.as_bytes().chunks_exact(32).map(|row| Descriptor::try_from(row).unwrap()),
        );
    }
    all
}

/// A tree as DBoW3 writes it: nodes by levels, each with the descriptors nearest to it.
#[derive(Default)]
struct Tree {
    nodes: String,
    words: String,
    node_count: usize,
    word_count: usize,
}

impl Tree {
    fn of(descriptors: &[Descriptor]) -> String {
        let mut tree = Self::default();
        tree.grow(0, descriptors, LEVELS);
        format!(
            "%YAML:1.0\n---\nvocabulary:\n   k: {BRANCHING}\n   L: {LEVELS}\n   scoringType: 0\n   weightingType: 0\n   \
             nodes:\n{}   words:\n{}",
            tree.nodes, tree.words
        )
    }

    fn grow(&mut self, parent: usize, descriptors: &[Descriptor], levels: usize) {
        let centres: Vec<Descriptor> =
            descriptors.iter().step_by(descriptors.len().div_ceil(BRANCHING)).copied().collect();
        let nearest = |descriptor: &Descriptor| {
            (0..centres.len()).min_by_key(|&centre| distance(&centres[centre], descriptor)).unwrap()
        };
        let of: Vec<usize> = descriptors.iter().map(nearest).collect();
        let first = self.node_count + 1;
        self.node_count += centres.len();
        for (id, centre) in (first..).zip(&centres) {
            let bytes: Vec<String> = centre.iter().map(u8::to_string).collect();
            self.nodes += &format!(
                "      - {{ nodeId:{id}, parentId:{parent}, weight:1.,\n          descriptor:dbw3 0 32 {}  }}\n",
                bytes.join(" ")
            );
        }
        for (centre, id) in (first..first + centres.len()).enumerate() {
            let below: Vec<Descriptor> = descriptors
                .iter()
                .zip(&of)
                .filter(|(_, of)| **of == centre)
                .map(|(descriptor, _)| *descriptor)
                .collect();
            if levels > 1 && below.len() > BRANCHING {
                self.grow(id, &below, levels - 1);
            } else {
                self.words += &format!("      - {{ wordId:{}, nodeId:{id} }}\n", self.word_count);
                self.word_count += 1;
            }
        }
    }
}

/// Trains over a vocabulary, as the guide tells, and maps the shipped drive with it.
fn map_with(vocabulary: &Path) -> (Value, CommandLine) {
    let photos = folder(images().len());
    let model = photos.path().join("model.waypost");
    let mut command = Built::command("waypost-eval");
    command.args([
        "train",
        "--feature",
        "orb",
        "--max-features",
        "500",
        "--image-width",
        "320",
        "--json",
        "--images",
    ]);
    command.args([photos.path(), Path::new("--orb-vocabulary"), vocabulary, Path::new("--out"), &model]);
    let trained = run_to_its_end(command);
    assert!(trained.status.success(), "{}", String::from_utf8_lossy(&trained.stderr));
    let trained = json_object(&String::from_utf8(trained.stdout).unwrap());

    let waypost = CommandLine::new();
    waypost.text(&["model", "import", path(&model), "--name", "theirs"]);
    waypost.text(&["map", "create", "drive", "--model", "theirs"]);
    std::fs::remove_file(&model).unwrap();
    waypost.text(&["stream", path(photos.path()), "--map", "drive", "--session", "walk"]);
    (trained, waypost)
}

/// Whether the truth has a pair of frames within three of these, numbered from 1.
fn is_true(truth: &str, sequence: u64, matched: u64) -> bool {
    truth.lines().skip(1).any(|line| {
        let (query, earlier) = line.split_once(',').unwrap();
        let (query, earlier): (u64, u64) = (query.parse().unwrap(), earlier.parse().unwrap());
        query + 1 == sequence && (earlier + 1).abs_diff(matched) <= 3
    })
}

/// Closes the loops of the drive, and no others.
fn closes_loops(waypost: &CommandLine) {
    let truth = std::fs::read_to_string(workspace().join("demo/sequence/loops.csv")).unwrap();
    let list = waypost.json(&["map", "loop-closures", "drive"]);
    let closures: Vec<(u64, u64)> = list["loop_closures"]
        .as_array()
        .unwrap()
        .iter()
        .map(|closure| {
            ["frame", "matched_frame"].map(|frame| closure[frame]["sequence"].as_u64().unwrap()).into()
        })
        .collect();
    let wrong: Vec<_> =
        closures.iter().filter(|(frame, matched)| !is_true(&truth, *frame, *matched)).collect();
    assert!(closures.len() >= 20 && wrong.is_empty(), "{} closures, wrong: {wrong:?}", closures.len());
}

#[test]
fn a_packed_vocabulary_of_dbow3_makes_a_map_that_closes_loops() {
    let file = tempfile::Builder::new().suffix(".yml.gz").tempfile().unwrap();
    let text = Tree::of(&descriptors());
    let mut encoder = GzEncoder::new(&file, Compression::fast());
    encoder.write_all(text.as_bytes()).unwrap();
    encoder.finish().unwrap();
    let (trained, waypost) = map_with(file.path());
    let words = text.matches("wordId").count();
    assert!(words > 300, "{words}");
    assert_eq!(trained["words"], words);
    assert_eq!(waypost.json(&["model", "show", "theirs"])["words"], words);
    closes_loops(&waypost);
}

#[test]
fn a_real_vocabulary_of_dbow2_makes_a_map_that_closes_loops() {
    let beside_the_repository = || workspace().join("../shared/data");
    let data = std::env::var_os("WAYPOST_DATA").map_or_else(beside_the_repository, PathBuf::from);
    let file = data.join("imports/orb_vocabularies/dbow2_orb_k9L4_13941nodes.yml.gz");
    if !file.is_file() {
        println!("skipped: there is no {}", file.display());
        return;
    }
    let (trained, waypost) = map_with(&file);
    assert_eq!(trained["words"], 6561);
    closes_loops(&waypost);
}
