//! A vocabulary tree of any shape, descended greedily, as DBoW2 does.

use crate::codec::{DecodeError, Reader, Writer};
use crate::descriptor::DescriptorKind;
use crate::observation::WordId;
use std::ops::Range;

/// Most children a node can have (DBoW2's k).
pub(crate) const MAX_BRANCHING: usize = 20;

/// Most levels below the root (DBoW2's L).
pub(crate) const MAX_DEPTH: usize = 10;

/// A tree over descriptors whose leaves are the words, numbered in the order the nodes were added.
///
/// From the root on, the search goes to the child nearest to the descriptor, the first among
/// equals, until it reaches a leaf (Nistér & Stewénius 2006).
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct DescentTree {
    kind: DescriptorKind,
    width: usize,
    /// Parent of each node but the root, in the order added. The root is 0, the first node 1.
    parents: Vec<u32>,
    /// Descriptors of the nodes so that children of one node are together, in the order added.
    rows: Vec<u8>,
    /// For each of `rows` what lies below it.
    below: Vec<Below>,
    root: Range<usize>,
    len: usize,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Below {
    Word(WordId),
    Children(Range<usize>),
}

/// Why nodes are not a tree that can be descended.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// The parent is not one of the nodes before.
    #[error("its parent {parent} is not among the nodes before it; nodes must follow their parent")]
    UnknownParent {
        /// Number of the parent.
        parent: u32,
    },
    /// The parent is a leaf.
    #[error("its parent {parent} is marked as a leaf; a leaf has no children, so mend one of the two")]
    LeafWithChildren {
        /// Number of the parent.
        parent: u32,
    },
    /// The parent has more children than the tree allows.
    #[error("its parent {parent} has more than k = {branching} children; check k and the parent")]
    TooManyChildren {
        /// Number of the parent.
        parent: u32,
        /// Most children a node can have.
        branching: usize,
    },
    /// The node lies deeper than the tree allows.
    #[error("it lies more than L = {depth} levels below the root; check L and the parent")]
    TooDeep {
        /// Most levels below the root.
        depth: usize,
    },
    /// An inner node has no children, so a search could end there without a word.
    #[error("it is neither a leaf nor the parent of any node: the file was cut off, so fetch it again")]
    Childless,
    /// There is no node at all.
    #[error("there are no words; the file was cut short, so fetch it again")]
    NoWords,
    /// More nodes than 32 bits can number.
    #[error("there are more nodes than 32 bits can number; use a smaller vocabulary")]
    TooManyNodes,
}

/// Collects the nodes of a [`DescentTree`], each after its parent.
pub(crate) struct DescentTreeBuilder {
    kind: DescriptorKind,
    width: usize,
    branching: usize,
    depth: usize,
    rows: Vec<u8>,
    /// The root, then the nodes as they came.
    nodes: Vec<Node>,
}

struct Node {
    parent: u32,
    is_leaf: bool,
    depth: usize,
    children: usize,
}

impl DescentTreeBuilder {
    /// An empty tree with at most `branching` children a node and `depth` levels below the root.
    pub(crate) fn new(kind: DescriptorKind, width: usize, branching: usize, depth: usize) -> Self {
        let root = Node { parent: 0, is_leaf: false, depth: 0, children: 0 };
        Self { kind, width, branching, depth, rows: Vec::new(), nodes: vec![root] }
    }

    /// Adds a node; the first one is number 1.
    pub(crate) fn push(&mut self, parent: u32, is_leaf: bool, row: &[u8]) -> Result<(), TreeError> {
        if u32::try_from(self.nodes.len()).is_err() {
            return Err(TreeError::TooManyNodes);
        }
        let Some(above) = self.nodes.get_mut(parent as usize) else {
            return Err(TreeError::UnknownParent { parent });
        };
        if above.is_leaf {
            return Err(TreeError::LeafWithChildren { parent });
        }
        if above.children == self.branching {
            return Err(TreeError::TooManyChildren { parent, branching: self.branching });
        }
        if above.depth == self.depth {
            return Err(TreeError::TooDeep { depth: self.depth });
        }
        above.children += 1;
        let depth = above.depth + 1;
        self.nodes.push(Node { parent, is_leaf, depth, children: 0 });
        self.rows.extend_from_slice(row);
        Ok(())
    }

    /// The tree, or what is wrong and the number of the node that it is wrong with.
    pub(crate) fn finish(self) -> Result<DescentTree, (usize, TreeError)> {
        if self.nodes.len() == 1 {
            return Err((0, TreeError::NoWords));
        }
        if let Some(childless) = self.nodes.iter().position(|node| !node.is_leaf && node.children == 0) {
            return Err((childless, TreeError::Childless));
        }
        // Children of node i take the places starts[i]..starts[i + 1].
        let mut starts = Vec::with_capacity(self.nodes.len());
        let mut start = 0;
        for node in &self.nodes {
            starts.push(start);
            start += node.children;
        }
        let children = |node: usize| starts[node]..starts[node] + self.nodes[node].children;
        let root = children(0);

        let mut next = starts.clone();
        let mut rows = vec![0; self.rows.len()];
        let mut below = vec![Below::Word(WordId::default()); self.nodes.len() - 1];
        let mut len = 0;
        for ((number, node), row) in
            self.nodes.iter().enumerate().skip(1).zip(self.rows.chunks_exact(self.width))
        {
            let place = next[node.parent as usize];
            next[node.parent as usize] += 1;
            rows[place * self.width..(place + 1) * self.width].copy_from_slice(row);
            below[place] = if node.is_leaf {
                len += 1;
                Below::Word(WordId::from_index(len - 1))
            } else {
                Below::Children(children(number))
            };
        }
        let parents = self.nodes.iter().skip(1).map(|node| node.parent).collect();
        Ok(DescentTree { kind: self.kind, width: self.width, parents, rows, below, root, len })
    }
}

impl DescentTree {
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// The word a greedy descent ends at.
    pub(crate) fn word(&self, descriptor: &[u8]) -> WordId {
        let mut children = self.root.clone();
        loop {
            let rows =
                self.rows[children.start * self.width..children.end * self.width].chunks_exact(self.width);
            let distances = rows.map(|row| self.kind.distance(row, descriptor));
            // `min_by_key` keeps the first among equals; no range of children is empty.
            let nearest = distances.zip(children.clone()).min_by_key(|&(distance, _)| distance);
            match nearest.map(|(_, place)| &self.below[place]) {
                Some(Below::Children(below)) => children = below.clone(),
                Some(Below::Word(word)) => return *word,
                None => unreachable!("an inner node has children"),
            }
        }
    }

    /// Descriptors of all words in the order of their numbers.
    pub(crate) fn word_rows(&self) -> Vec<u8> {
        let mut rows = vec![0; self.len * self.width];
        for (below, row) in self.below.iter().zip(self.rows.chunks_exact(self.width)) {
            match below {
                Below::Word(word) => {
                    rows[word.index() * self.width..(word.index() + 1) * self.width].copy_from_slice(row);
                }
                Below::Children(_) => {}
            }
        }
        rows
    }

    /// Number of nodes; for each its parent, whether it is a leaf, and its descriptor.
    pub(crate) fn encode(&self, writer: &mut Writer) {
        writer.varint(self.parents.len() as u64);
        let mut next = vec![0; self.parents.len() + 1];
        next[0] = self.root.start;
        for (number, &parent) in self.parents.iter().enumerate() {
            let place = next[parent as usize];
            next[parent as usize] += 1;
            let is_leaf = match &self.below[place] {
                Below::Word(_) => true,
                Below::Children(children) => {
                    next[number + 1] = children.start;
                    false
                }
            };
            writer.varint(u64::from(parent) << 1 | u64::from(is_leaf));
            writer.raw(&self.rows[place * self.width..(place + 1) * self.width]);
        }
    }

    /// Reads what [`DescentTree::encode`] wrote.
    pub(crate) fn decode(
        kind: DescriptorKind,
        width: usize,
        reader: &mut Reader<'_>,
    ) -> Result<Self, DecodeError> {
        let nodes = reader.count(1 + width)?;
        let mut tree = DescentTreeBuilder::new(kind, width, MAX_BRANCHING, MAX_DEPTH);
        for number in 1..=nodes {
            let parent_and_leaf = reader.varint()?;
            let row = reader.raw(width)?;
            let wrong = |why| DecodeError::invalid(format_args!("node {number} of a vocabulary tree: {why}"));
            let parent = u32::try_from(parent_and_leaf >> 1).map_err(|_| wrong(TreeError::TooManyNodes))?;
            tree.push(parent, parent_and_leaf & 1 == 1, row).map_err(wrong)?;
        }
        tree.finish().map_err(|(number, why)| {
            DecodeError::invalid(format_args!("node {number} of a vocabulary tree: {why}"))
        })
    }
}
