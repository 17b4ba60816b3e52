use crate::descriptor::DescriptorKind;
use crate::vocabulary::test_vocabularies::{decoded, encoded};
use crate::vocabulary::{ImportError, TreeError, Vocabulary};
use proptest::prelude::*;

use super::DbowYamlError;

/// Two inner nodes with two leaves each, and a leaf beside them, as (id, parent, byte).
const NODES: [(u32, u32, u8); 7] =
    [(1, 0, 0), (2, 0, 255), (3, 0, 51), (4, 1, 0), (5, 1, 1), (6, 2, 252), (7, 2, 255)];

/// Words in the order of their numbers, as nodes.
const WORDS: [u32; 5] = [3, 4, 5, 6, 7];

const HEAD: &str = "%YAML:1.0\n---\nvocabulary:\n   k: 9\n   L: 3\n   scoringType: 0\n   weightingType: 0\n";

fn node(id: u32, parent: u32, descriptor: &str) -> String {
    format!(
        "      - {{ nodeId:{id}, parentId:{parent}, weight:5.5e-01,\n          descriptor:{descriptor} }}\n"
    )
}

fn words(nodes: &[u32]) -> String {
    let word = |(id, node): (usize, &u32)| format!("      - {{ wordId:{id}, nodeId:{node} }}\n");
    nodes.iter().enumerate().map(word).collect()
}

fn dbow2(byte: u8) -> String {
    format!("\"{}\"", format!("{byte} ").repeat(32))
}

/// A whole file of these nodes.
fn file(nodes: &[(u32, u32, u8)], descriptor: impl Fn(u8) -> String) -> String {
    let nodes: String = nodes.iter().map(|&(id, parent, byte)| node(id, parent, &descriptor(byte))).collect();
    format!("{HEAD}   nodes:\n{nodes}   words:\n{}", words(&WORDS))
}

/// A file as DBoW2 writes it.
pub(crate) fn dbow_yaml() -> String {
    file(&NODES, dbow2)
}

fn read(text: &str) -> Result<Vocabulary, ImportError> {
    Vocabulary::import(text.as_bytes())
}

fn fault(text: &str) -> DbowYamlError {
    match read(text).unwrap_err() {
        ImportError::Yaml(fault) => fault,
        other => panic!("{other}"),
    }
}

#[test]
fn words_and_their_tree_are_those_of_the_file() {
    let quoted = |byte: u8| format!("\"0 32 {}\"", format!("{byte} ").repeat(32));
    let marked = |byte: u8| format!("dbw3 0 32 {}", format!("{byte} ").repeat(32));
    let children_first = [5, 6, 3, 4, 0, 1, 2].map(|place: usize| NODES[place]);
    let in_brackets = dbow_yaml()
        .replace("   nodes:\n", "   nodes: [\n")
        .replace("   words:\n", "   ]\n   words: [\n")
        .replace("      - {", "      {")
        .replace("}\n", "},\n")
        + "]";
    for text in [
        dbow_yaml(),
        dbow_yaml().replace("---\n", ""),
        dbow_yaml().replace('\n', "\r\n"),
        dbow_yaml().replace(':', ": ").replace("%YAML: ", "%YAML:") + "...\n",
        dbow_yaml().replace("   words:\n", "   # what it means\n   words:\n"),
        file(&NODES, quoted),
        file(&NODES, marked),
        file(&children_first, dbow2),
        in_brackets,
    ] {
        let vocabulary = read(&text).unwrap_or_else(|fault| panic!("{fault}: {text}"));
        assert_eq!(
            (vocabulary.len(), vocabulary.kind(), vocabulary.width()),
            (5, DescriptorKind::Binary, 32)
        );
        let words = [0, 1, 3, 252, 255, 51].map(|byte| vocabulary.word(&[byte; 32]));
        let centres = vocabulary.centres();
        let stands_for = words.map(|word| centres.as_bytes()[word.index() * 32]);
        assert_eq!(stands_for, [0, 1, 1, 252, 255, 51]);
        assert_eq!(decoded(&encoded(&vocabulary)), Ok(vocabulary));
    }
}

#[test]
fn words_have_the_numbers_that_dbow2_gives_them() {
    let vocabulary = read(&dbow_yaml()).unwrap();
    for (byte, word) in [(51, 0), (0, 1), (1, 2), (252, 3), (255, 4)] {
        assert_eq!(vocabulary.word(&[byte; 32]).number(), word, "{byte}");
    }
    // As far from all below the root: the first in the file, then the nearer of its leaves.
    assert_eq!(vocabulary.word(&[0b0000_1111; 32]).number(), 2);
}

#[test]
fn each_fault_is_named_with_its_line() {
    let text = dbow_yaml();
    let changed = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        fault(&text.replacen(from, to, 1)).to_string()
    };
    let row = |byte: u8| format!("\"{}\"", format!("{byte} ").repeat(32));
    let node_7 = "nodeId:7, parentId:2";
    for (fault, expected) in [
        (fault("%YAML:1.0\n").to_string(), "the text ends at line 2, where `vocabulary` should be"),
        (changed("vocabulary", "database"), "line 3: \"database:\" stands where `vocabulary` should"),
        (changed("   k: 9\n", ""), "there are no `k`"),
        (changed("   L: 3\n", ""), "there are no `L`"),
        (changed("k: 9", "k: 21"), "line 4: k (children of a node) is 21, but must be 2 to 20"),
        (changed("k: 9", "k: nine"), "line 4: \"nine\" stands where a whole number should"),
        (changed("L: 3", "L: 0"), "line 5: L (levels) is 0, but must be 1 to 10"),
        (changed("scoringType: 0", "scoringType: 6"), "line 6: scoringType is 6, but must be 0 to 5"),
        (changed("weightingType: 0", "weightingType: 4"), "line 7: weightingType is 4"),
        (changed("scoringType", "scoring"), "line 6: \"scoring: 0\" stands where k, L, scoringType"),
        (changed("k: 9", "k: 2"), "line 13: node 3 does not fit the tree: its parent 0 has more than k = 2"),
        (changed("L: 3", "L: 1"), "line 15: node 4 does not fit the tree: it lies more than L = 1"),
        (changed("nodeId:1,", "nodeId:9,"), "line 9: a node has the number 9, but there are 7 nodes"),
        (changed("nodeId:1,", "nodeId:0,"), "line 9: a node has the number 0, but there are 7 nodes"),
        (changed("nodeId:1,", "nodeId:-1,"), "line 9: \"-1, parentId:0"),
        (changed("nodeId:1,", "nodeId:2,"), "line 11: there is a node 2 already"),
        (changed(node_7, "nodeId:7, parentId:8"), "line 21: the parent 8 of node 7 is not there"),
        (
            changed("nodeId:2, parentId:0", "nodeId:2, parentId:7"),
            "line 21: node 7 has 1 children and 1 words",
        ),
        (changed("nodeId:7 }", "nodeId:6 }"), "line 19: node 6 has 0 children and 2 words"),
        (changed("nodeId:7 }", "nodeId:1 }"), "line 9: node 1 has 2 children and 1 words"),
        (changed("nodeId:7 }", "nodeId:0 }"), "line 28: the node 0 of word 4 is not there"),
        (changed("nodeId:7 }", "nodeId:8 }"), "line 28: the node 8 of word 4 is not there"),
        (changed("wordId:4", "wordId:3"), "line 28: the word 3 is there twice or above"),
        (
            changed("wordId:4", "wordId:5"),
            "line 28: the word 5 is there twice or above the number of words, 5",
        ),
        (changed("parentId:0, ", ""), "line 9: this item needs a nodeId, parentId and descriptor"),
        (changed("wordId:4, ", ""), "line 28: this item needs a wordId and a nodeId"),
        (changed("weight:5.5e-01", "weight:heavy"), "line 9: \"heavy,\" stands where a weight should"),
        (changed("descriptor:", "row:"), "line 10: \"row:"),
        (changed("wordId", "id"), "line 24: \"id:0, nodeId:3 }\" stands where wordId or nodeId should"),
        (changed(&row(51), "\"1 2 3\""), "line 14: a descriptor has 3 bytes, and those of ORB have 32"),
        (changed(&row(51), &format!("\"{}\"", "7 ".repeat(61))), "line 14: a descriptor has 61 bytes"),
        (changed(&row(51), &row(51).replacen("51", "256", 1)), "line 14: \"256\" is not a byte"),
        (changed(&row(51), &row(51).replacen("51", "0.5", 1)), "line 14: the descriptors are not binary"),
        (
            changed(&row(51), &format!("\"{}\"", "0.01 ".repeat(64))),
            "line 14: the descriptors are not binary",
        ),
        (
            changed(&row(51), &format!("dbw3 5 64 {}", "0.1 ".repeat(64))),
            "line 14: the descriptors are not binary",
        ),
        (
            changed(&row(51), &format!("dbw3 0 33 {}", "51 ".repeat(32))),
            "line 14: a descriptor has not as many bytes",
        ),
        (
            changed(&row(51), &format!("\"0 31 {}\"", "51 ".repeat(32))),
            "line 14: a descriptor has not as many bytes",
        ),
        (changed(&row(51), "dbw3"), "line 14: \"dbw3\" is not a byte of a descriptor"),
        (changed(&row(51), "dbw3 zero 32"), "line 14: \"dbw3 zero 32\" is not a byte of a descriptor"),
        (changed("- { nodeId:3", "- nodeId:3"), "line 13: \"nodeId:3"),
    ] {
        assert!(fault.contains(expected), "\"{fault}\" does not say \"{expected}\"");
    }
}

#[test]
fn parts_that_are_missing_are_named() {
    let text = dbow_yaml();
    let (nodes, words) = (text.find("   nodes:").unwrap(), text.find("   words:").unwrap());
    assert_eq!(fault(&text[..nodes]), DbowYamlError::Missing { name: "nodes" });
    assert_eq!(fault(&text[..words]), DbowYamlError::Missing { name: "words" });
    assert_eq!(
        fault(&format!("{HEAD}   nodes: []\n   words: []\n")),
        DbowYamlError::Node { line: 1, id: 0, source: TreeError::NoWords }
    );
}

#[test]
fn a_circle_of_nodes_is_refused() {
    let circle = [(1, 0, 0), (2, 3, 1), (3, 2, 2), (4, 3, 3)];
    let nodes: String = circle.iter().map(|&(id, parent, byte)| node(id, parent, &dbow2(byte))).collect();
    let text = format!("{HEAD}   nodes:\n{nodes}   words:\n{}", words(&[1, 4]));
    assert_eq!(fault(&text), DbowYamlError::Circle { line: 11, id: 2 });
}

#[test]
fn a_chain_as_long_as_the_file_is_refused_and_takes_no_stack() {
    let nodes: String = (1..20_000).map(|id| node(id, id - 1, &dbow2(7))).collect();
    let text = format!("{HEAD}   nodes:\n{nodes}   words:\n{}", words(&[19_999]));
    assert_eq!(
        fault(&text),
        DbowYamlError::Node { line: 15, id: 4, source: TreeError::TooDeep { depth: 3 } }
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn no_cut_passes(cut in any::<prop::sample::Index>()) {
        let text = dbow_yaml();
        let whole = text.trim_end().len();
        let cut = cut.index(whole);
        prop_assert!(read(&text[..cut]).is_err(), "{}", &text[..cut]);
    }

    #[test]
    fn damaged_text_is_refused_or_quantizes_without_panic(
        damage in proptest::collection::vec((any::<prop::sample::Index>(), "[-0-9 :,{}\\[\\]\"#a\n.]"), 1..4),
    ) {
        let mut text = dbow_yaml();
        for (place, sign) in damage {
            let place = place.index(text.len());
            text.replace_range(place..=place, &sign);
        }
        if let Ok(vocabulary) = read(&text) {
            prop_assert!(vocabulary.word(&[170; 32]).index() < vocabulary.len());
        }
    }
}
