//! Why a text is not a vocabulary of DBoW2 or DBoW3.

use super::ORB_BYTES;
use crate::quantizer::TreeError;

/// Why a YAML text is not an ORB vocabulary of DBoW2 or DBoW3. Lines are counted from 1.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DbowYamlError {
    /// Something else stands where it should.
    #[error(
        "line {line}: \"{found}\" stands where {expected} should; give a vocabulary as DBoW2 or DBoW3 saves it, or fetch \
         the file again"
    )]
    Unexpected {
        /// The line.
        line: usize,
        /// What stands there, or its beginning.
        found: String,
        /// What should be there.
        expected: &'static str,
    },
    /// The text ends too early.
    #[error(
        "the text ends at line {line}, where {expected} should be: the file was cut off, so fetch it again"
    )]
    CutOff {
        /// The last line.
        line: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// A part of a vocabulary is not there.
    #[error(
        "there are no `{name}`: the file was cut off or is no vocabulary; fetch it again or check which was given"
    )]
    Missing {
        /// The part.
        name: &'static str,
    },
    /// A number of the head is out of its range.
    #[error("line {line}: {name} is {found}, but must be {lowest} to {highest}; check which file was given")]
    Range {
        /// The line.
        line: usize,
        /// Which number.
        name: &'static str,
        /// Its value.
        found: usize,
        /// Its lowest value.
        lowest: usize,
        /// Its highest value.
        highest: usize,
    },
    /// A node or a word lacks a field.
    #[error("line {line}: this item needs {needs}; mend that line or fetch the file again")]
    Item {
        /// The line that it begins in.
        line: usize,
        /// What it should have.
        needs: &'static str,
    },
    /// A descriptor is not bytes.
    #[error(
        "line {line}: \"{found}\" is not a byte of a descriptor, 0 to 255; mend that line or fetch the file again"
    )]
    Descriptor {
        /// The line.
        line: usize,
        /// The text, or its beginning.
        found: String,
    },
    /// The descriptors are numbers, as those of SURF or SIFT.
    #[error(
        "line {line}: the descriptors are not binary, so this is no vocabulary of ORB; give one of ORB, or train words \
         from your images without it"
    )]
    NotBinary {
        /// The line.
        line: usize,
    },
    /// The descriptors are not as long as those of ORB.
    #[error(
        "line {line}: a descriptor has {bytes} bytes, and those of ORB have {ORB_BYTES}; give a vocabulary of ORB, or fetch \
         the file again if it is one"
    )]
    DescriptorBytes {
        /// The line.
        line: usize,
        /// Its bytes.
        bytes: usize,
    },
    /// A descriptor of DBoW3 has not as many bytes as it says.
    #[error(
        "line {line}: a descriptor has not as many bytes as it says; mend that line or fetch the file again"
    )]
    DescriptorCut {
        /// The line.
        line: usize,
    },
    /// A node has a number that it cannot have.
    #[error(
        "line {line}: a node has the number {id}, but there are {nodes} nodes, numbered from 1; the file was cut off or \
         edited, so fetch it again"
    )]
    NodeNumber {
        /// The line.
        line: usize,
        /// The number.
        id: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// Two nodes have one number.
    #[error("line {line}: there is a node {id} already; fetch the file again")]
    NodeTwice {
        /// The line.
        line: usize,
        /// The number.
        id: u32,
    },
    /// A node's parent is not there.
    #[error(
        "line {line}: the parent {parent} of node {id} is not there; the file was cut off, so fetch it again"
    )]
    NoParent {
        /// The line.
        line: usize,
        /// The node.
        id: u32,
        /// Its parent.
        parent: u32,
    },
    /// The parents of a node lead round in a circle.
    #[error(
        "line {line}: the parents of node {id} go round in a circle, not to the root; fetch the file again"
    )]
    Circle {
        /// The line.
        line: usize,
        /// The node.
        id: u32,
    },
    /// A node does not fit into the tree.
    #[error("line {line}: node {id} does not fit the tree: {source}")]
    Node {
        /// The line.
        line: usize,
        /// The node.
        id: u32,
        /// What is wrong.
        source: TreeError,
    },
    /// A leaf is no word, or an inner node is one.
    #[error(
        "line {line}: node {id} has {children} children and {words} words, but a leaf has one word and another node none; \
         the file is incomplete, so fetch it again"
    )]
    WordsOfNode {
        /// The line.
        line: usize,
        /// The node.
        id: u32,
        /// Its children.
        children: usize,
        /// Words that name it.
        words: usize,
    },
    /// A word has a number that it cannot have, or that of another one.
    #[error(
        "line {line}: the word {word} is there twice or above the number of words, {words}; the file was cut off or \
         edited, so fetch it again"
    )]
    WordNumber {
        /// The line.
        line: usize,
        /// The word.
        word: u32,
        /// Number of words.
        words: usize,
    },
    /// A word is at a node that is not there.
    #[error(
        "line {line}: the node {node} of word {word} is not there; the file was cut off, so fetch it again"
    )]
    NoNodeOfWord {
        /// The line.
        line: usize,
        /// The word.
        word: u32,
        /// The node.
        node: u32,
    },
}
