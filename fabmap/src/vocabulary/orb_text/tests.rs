use crate::descriptor::DescriptorKind;
use crate::vocabulary::test_vocabularies::{decoded, encoded};
use crate::vocabulary::{OrbVocabularyError, TreeError, Vocabulary};
use proptest::prelude::*;

/// A tree of two inner nodes with two leaves each, between lines of other kinds.
pub(crate) fn orb_text() -> String {
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
            assert_eq!(vocabulary.word(&[byte; 32]).number(), word, "{byte}");
        }
        // As far from both inner nodes: the first in the file, then the nearer of its leaves.
        assert_eq!(vocabulary.word(&[0b0000_1111; 32]).number(), 2);
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
    fn foreign_text_never_panics(text in "[0-9 .\n-]{0,200}") {
        prop_assert!(Vocabulary::from_orb_text(&text).is_err());
    }
}
