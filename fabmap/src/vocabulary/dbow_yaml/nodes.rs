//! Nodes in any order, made a tree.

use crate::descriptor::DescriptorKind;
use crate::quantizer::{DescentTree, DescentTreeBuilder, TreeError};

use super::ORB_BYTES;
use super::error::DbowYamlError;

/// The nodes and words of a file, as they come.
#[derive(Default)]
pub(super) struct Nodes {
    nodes: Vec<Node>,
    /// Their descriptors.
    rows: Vec<u8>,
    words: Vec<Word>,
}

struct Node {
    id: u32,
    parent: u32,
    /// Where it begins in the text.
    at: usize,
}

struct Word {
    id: u32,
    node: u32,
    at: usize,
}

impl Nodes {
    pub(super) fn add_node(&mut self, id: u32, parent: u32, row: &[u8; ORB_BYTES], at: usize) {
        self.nodes.push(Node { id, parent, at });
        self.rows.extend_from_slice(row);
    }

    pub(super) fn add_word(&mut self, id: u32, node: u32, at: usize) {
        self.words.push(Word { id, node, at });
    }

    /// The tree of all nodes, if they are one and its leaves are the words. `line` is that of a
    /// place in the text.
    pub(super) fn tree(
        &self,
        branching: usize,
        depth: usize,
        line: &dyn Fn(usize) -> usize,
    ) -> Result<DescentTree, DbowYamlError> {
        self.check_numbers(line)?;
        let children = self.children(line)?;
        self.check_words(&children, line)?;

        let mut tree = DescentTreeBuilder::new(DescriptorKind::Binary, ORB_BYTES, branching, depth);
        let mut reached = vec![false; self.nodes.len() + 1];
        // Nodes that are in the tree and whose children are not: numbers in the file and in the tree.
        let mut waiting = vec![(0, 0)];
        let mut pushed = 0;
        while let Some((id, number)) = waiting.pop() {
            let first_inner = waiting.len();
            for &place in children.of(id) {
                let node = &self.nodes[place as usize];
                let is_leaf = children.of(node.id).is_empty();
                let row = &self.rows[place as usize * ORB_BYTES..][..ORB_BYTES];
                tree.push(number, is_leaf, row).map_err(|source| DbowYamlError::Node {
                    line: line(node.at),
                    id: node.id,
                    source: in_the_file(source, id),
                })?;
                reached[node.id as usize] = true;
                pushed += 1;
                if !is_leaf {
                    waiting.push((node.id, pushed));
                }
            }
            waiting[first_inner..].reverse();
        }
        if let Some(node) = self.nodes.iter().find(|node| !reached[node.id as usize]) {
            return Err(DbowYamlError::Circle { line: line(node.at), id: node.id });
        }
        tree.finish().map_err(|(_, source)| DbowYamlError::Node { line: 1, id: 0, source })
    }

    /// Each node has a number of its own, from 1 to their number.
    fn check_numbers(&self, line: &dyn Fn(usize) -> usize) -> Result<(), DbowYamlError> {
        let mut taken = vec![false; self.nodes.len() + 1];
        for &Node { id, at, .. } in &self.nodes {
            match taken.get_mut(id as usize) {
                Some(taken) if id > 0 && !*taken => *taken = true,
                Some(_) if id > 0 => return Err(DbowYamlError::NodeTwice { line: line(at), id }),
                Some(_) | None => {
                    return Err(DbowYamlError::NodeNumber { line: line(at), id, nodes: self.nodes.len() });
                }
            }
        }
        Ok(())
    }

    fn children(&self, line: &dyn Fn(usize) -> usize) -> Result<Children, DbowYamlError> {
        let mut starts = vec![0_u32; self.nodes.len() + 2];
        for &Node { id, parent, at } in &self.nodes {
            if parent as usize > self.nodes.len() {
                return Err(DbowYamlError::NoParent { line: line(at), id, parent });
            }
            starts[parent as usize + 1] += 1;
        }
        for id in 0..=self.nodes.len() {
            starts[id + 1] += starts[id];
        }
        let mut next = starts.clone();
        let mut of_all = vec![0; self.nodes.len()];
        for (node, place) in self.nodes.iter().zip(0..) {
            let next = &mut next[node.parent as usize];
            of_all[*next as usize] = place;
            *next += 1;
        }
        Ok(Children { starts, of_all })
    }

    /// Each leaf is one word, and each word a leaf.
    fn check_words(&self, children: &Children, line: &dyn Fn(usize) -> usize) -> Result<(), DbowYamlError> {
        let mut words_of = vec![0; self.nodes.len() + 1];
        let mut named = vec![false; self.words.len()];
        for &Word { id: word, node, at } in &self.words {
            match named.get_mut(word as usize) {
                Some(named) if !*named => *named = true,
                Some(_) | None => {
                    return Err(DbowYamlError::WordNumber { line: line(at), word, words: self.words.len() });
                }
            }
            match words_of.get_mut(node as usize) {
                Some(words) if node > 0 => *words += 1,
                Some(_) | None => return Err(DbowYamlError::NoNodeOfWord { line: line(at), word, node }),
            }
        }
        for node in &self.nodes {
            let (words, children) = (words_of[node.id as usize], children.of(node.id).len());
            if words != usize::from(children == 0) {
                return Err(DbowYamlError::WordsOfNode { line: line(node.at), id: node.id, children, words });
            }
        }
        Ok(())
    }
}

/// The children of each node, as places in the file, in its order.
struct Children {
    starts: Vec<u32>,
    of_all: Vec<u32>,
}

impl Children {
    fn of(&self, id: u32) -> &[u32] {
        &self.of_all[self.starts[id as usize] as usize..self.starts[id as usize + 1] as usize]
    }
}

/// The same fault, with the parent's number in the file.
fn in_the_file(fault: TreeError, parent: u32) -> TreeError {
    match fault {
        TreeError::UnknownParent { .. } => TreeError::UnknownParent { parent },
        TreeError::LeafWithChildren { .. } => TreeError::LeafWithChildren { parent },
        TreeError::TooManyChildren { branching, .. } => TreeError::TooManyChildren { parent, branching },
        TreeError::TooDeep { .. } | TreeError::Childless | TreeError::NoWords | TreeError::TooManyNodes => {
            fault
        }
    }
}
