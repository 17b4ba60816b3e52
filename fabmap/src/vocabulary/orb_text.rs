//! The text format of ORB vocabularies (`ORBvoc.txt`), as DBoW2 writes it.
//!
//! The first line is `k L scoring weighting`; each further line is a node,
//! `parent is_leaf d0 … d31 weight`. Nodes are numbered by their order from 1; 0 is the root.

use crate::descriptor::DescriptorKind;
use crate::quantizer::{DescentTree, DescentTreeBuilder, MAX_BRANCHING, MAX_DEPTH, TreeError};
use std::str::{FromStr, SplitAsciiWhitespace};

use super::ORB_BYTES;

/// Fields of a node: parent, leaf flag, descriptor, weight.
const NODE_FIELDS: usize = 2 + ORB_BYTES + 1;

/// Why a text is not an ORB vocabulary. Lines are counted from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OrbVocabularyError {
    /// The first line is not the header.
    #[error(
        "line 1 should be four whole numbers, \"k L scoring weighting\", like \"10 6 0 0\", but is \"{found}\"; \
         give an unpacked vocabulary text as DBoW2 writes it"
    )]
    Header {
        /// The line, or its beginning.
        found: String,
    },
    /// A number of the header is out of its range.
    #[error("line 1: {name} is {found}, but must be {lowest} to {highest}; check which file was given")]
    HeaderRange {
        /// Which number.
        name: &'static str,
        /// Its value.
        found: usize,
        /// Its lowest value.
        lowest: usize,
        /// Its highest value.
        highest: usize,
    },
    /// A line has more or fewer fields than a node.
    #[error(
        "line {line} has {found} fields, but a node has {NODE_FIELDS}: parent, leaf flag, {ORB_BYTES} bytes, weight; \
         the file is not for ORB or was cut short, so fetch it again"
    )]
    FieldCount {
        /// The line.
        line: usize,
        /// Its number of fields.
        found: usize,
    },
    /// A field is not the number it should be.
    #[error("line {line}: \"{found}\" is not {expected}; mend that line or fetch the file again")]
    Field {
        /// The line.
        line: usize,
        /// The field's text, or its beginning.
        found: String,
        /// What the field should be.
        expected: &'static str,
    },
    /// A node does not fit into the tree.
    #[error("line {line}: this node does not fit the tree: {source}")]
    Node {
        /// The line.
        line: usize,
        /// What is wrong.
        source: TreeError,
    },
}

/// Reads the whole text.
pub(super) fn parse(text: &str) -> Result<DescentTree, OrbVocabularyError> {
    let (branching, depth) = parse_header(text.lines().next().unwrap_or_default())?;
    let mut tree = DescentTreeBuilder::new(DescriptorKind::Binary, ORB_BYTES, branching, depth);
    for (line, node) in node_lines(text) {
        let (parent, is_leaf, row) = parse_node(line, node)?;
        tree.push(parent, is_leaf, &row).map_err(|source| OrbVocabularyError::Node { line, source })?;
    }
    tree.finish().map_err(|(number, source)| {
        let line = node_lines(text).nth(number.saturating_sub(1)).map_or(1, |(line, _)| line);
        OrbVocabularyError::Node { line, source }
    })
}

/// The lines after the header that are not blank, with their numbers.
fn node_lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().zip(1..).map(|(text, line)| (line, text)).skip(1).filter(|(_, text)| !text.trim().is_empty())
}

/// Branching k and depth L.
fn parse_header(header: &str) -> Result<(usize, usize), OrbVocabularyError> {
    let numbers: Option<Vec<usize>> =
        header.split_ascii_whitespace().map(|field| field.parse().ok()).collect();
    let Some(&[branching, depth, scoring, weighting]) = numbers.as_deref() else {
        return Err(OrbVocabularyError::Header { found: beginning(header) });
    };
    for (name, found, lowest, highest) in [
        ("k (children of a node)", branching, 2, MAX_BRANCHING),
        ("L (levels)", depth, 1, MAX_DEPTH),
        ("the scoring", scoring, 0, 5),
        ("the weighting", weighting, 0, 3),
    ] {
        if !(lowest..=highest).contains(&found) {
            return Err(OrbVocabularyError::HeaderRange { name, found, lowest, highest });
        }
    }
    Ok((branching, depth))
}

/// Parent, whether it is a leaf, and descriptor. The weight belongs to DBoW2's scoring and is only
/// checked.
fn parse_node(line: usize, node: &str) -> Result<(u32, bool, [u8; ORB_BYTES]), OrbVocabularyError> {
    let found = node.split_ascii_whitespace().count();
    if found != NODE_FIELDS {
        return Err(OrbVocabularyError::FieldCount { line, found });
    }
    let mut fields = node.split_ascii_whitespace();
    let parent = parse_field(line, &mut fields, "the number of a node")?;
    let leaf_flag: u8 = parse_field(line, &mut fields, "a leaf flag, 0 or 1")?;
    if leaf_flag > 1 {
        let found = leaf_flag.to_string();
        return Err(OrbVocabularyError::Field { line, found, expected: "a leaf flag, 0 or 1" });
    }
    let mut row = [0; ORB_BYTES];
    for byte in &mut row {
        *byte = parse_field(line, &mut fields, "a byte, 0 to 255")?;
    }
    let _weight: f64 = parse_field(line, &mut fields, "a weight")?;
    Ok((parent, leaf_flag == 1, row))
}

fn parse_field<T: FromStr>(
    line: usize,
    fields: &mut SplitAsciiWhitespace<'_>,
    expected: &'static str,
) -> Result<T, OrbVocabularyError> {
    let field = fields.next().unwrap_or_default();
    field.parse().map_err(|_| OrbVocabularyError::Field { line, found: beginning(field), expected })
}

/// Enough of a text to recognise it in a message.
fn beginning(text: &str) -> String {
    text.chars().take(40).collect()
}

#[cfg(test)]
pub(super) mod tests;
