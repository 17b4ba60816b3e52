//! The binary format of FBoW: a signature, parameters, then blocks of one size.
//!
//! A block has the children of one node: their number, their descriptors, and for each whether it
//! is a leaf (the highest bit), else the block of its children. Block 0 has those of the root.
//! Numbers are little-endian, and laid out as x86-64 lays out the structs that are written.

use crate::descriptor::DescriptorKind;
use crate::quantizer::{DescentTree, DescentTreeBuilder, MAX_BRANCHING, MAX_DEPTH, TreeError};

use super::ORB_BYTES;

/// What a file begins with.
pub(super) const SIGNATURE: [u8; 8] = 55_824_124_u64.to_le_bytes();

/// Signature and parameters.
const HEAD_BYTES: usize = 128;

/// OpenCV's number for bytes.
const BYTES_TYPE: u32 = 0;

/// Before the descriptors of a block: the number of children, a flag and the parent.
const BLOCK_HEAD_BYTES: usize = 8;

/// Of a child behind the descriptors: leaf or block, and weight.
const CHILD_BYTES: usize = 8;

const LEAF: u32 = 1 << 31;

/// Why bytes are not an ORB vocabulary of FBoW.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FbowError {
    /// The bytes end within the parameters.
    #[error(
        "there are {bytes} bytes, less than what each file begins with; it was cut off, so fetch it again"
    )]
    Head {
        /// Bytes that are there.
        bytes: usize,
    },
    /// The descriptors are numbers, as those of SURF or SIFT.
    #[error(
        "its descriptors are not binary (OpenCV's type {kind}), so this is no vocabulary of ORB; give one of ORB, or \
         train words from your images without it"
    )]
    NotBinary {
        /// OpenCV's type of the descriptors.
        kind: u32,
    },
    /// The descriptors are not as long as those of ORB.
    #[error(
        "its descriptors have {bytes} bytes, and those of ORB have {ORB_BYTES}; give a vocabulary of ORB"
    )]
    DescriptorBytes {
        /// Bytes of a descriptor.
        bytes: u32,
    },
    /// Nodes may have more children than are read.
    #[error(
        "its nodes have up to {found} children; those of 2 to {MAX_BRANCHING} are read, so give a smaller one"
    )]
    Branching {
        /// Most children of a node.
        found: u32,
    },
    /// The parts of a block do not fit into it.
    #[error("its blocks are laid out as no version of FBoW does; the file is damaged, so fetch it again")]
    Layout,
    /// There are more or fewer bytes than the blocks that are said to be there.
    #[error(
        "it says that it has {blocks} blocks, {said} bytes, but has {found}; the file was cut off, so fetch it again"
    )]
    Length {
        /// Blocks that there should be.
        blocks: u32,
        /// Bytes that there should be behind the parameters.
        said: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// A node's children are in a block that is not there.
    #[error(
        "block {block} leads to block {found}, which is not there; the file is damaged, so fetch it again"
    )]
    NoBlock {
        /// The block of the node.
        block: u32,
        /// The block that it names.
        found: u32,
    },
    /// Two nodes have the same children, or a node leads back to one above it.
    #[error("block {block} leads to block {found}, as another does; the file is damaged, so fetch it again")]
    BlockTwice {
        /// The block of the node.
        block: u32,
        /// The block that it names.
        found: u32,
    },
    /// No node leads to a block.
    #[error("no node leads to block {block}; the file is damaged, so fetch it again")]
    Lost {
        /// The block.
        block: u32,
    },
    /// The nodes of a block do not fit into the tree.
    #[error("a node of block {block} does not fit the tree: {source}")]
    Node {
        /// The block.
        block: u32,
        /// What is wrong.
        source: TreeError,
    },
}

/// What is said of all blocks.
struct Blocks {
    count: u32,
    branching: usize,
    block_bytes: usize,
    row_bytes: usize,
    rows_start: usize,
    children_start: usize,
}

/// Reads the whole file, which begins with [`SIGNATURE`].
pub(super) fn parse(bytes: &[u8]) -> Result<DescentTree, FbowError> {
    let (head, data) = bytes.split_at_checked(HEAD_BYTES).ok_or(FbowError::Head { bytes: bytes.len() })?;
    let blocks = Blocks::read(head, data.len())?;
    let mut tree = DescentTreeBuilder::new(DescriptorKind::Binary, ORB_BYTES, blocks.branching, MAX_DEPTH);
    let mut reached = vec![false; blocks.count as usize];
    // Blocks whose nodes are not in the tree, with the number of their parent.
    let mut waiting = vec![(0, 0)];
    reached[0] = true;
    let mut pushed = 0;
    while let Some((block, parent)) = waiting.pop() {
        let data = &data[block as usize * blocks.block_bytes..][..blocks.block_bytes];
        let first_inner = waiting.len();
        for index in 0..blocks.nodes(block, data)? {
            let (row, child) = blocks.node(data, index);
            let is_leaf = child & LEAF != 0;
            tree.push(parent, is_leaf, row).map_err(|source| FbowError::Node { block, source })?;
            pushed += 1;
            if is_leaf {
                continue;
            }
            match reached.get_mut(child as usize) {
                Some(reached) if !*reached => *reached = true,
                Some(_) => return Err(FbowError::BlockTwice { block, found: child }),
                None => return Err(FbowError::NoBlock { block, found: child }),
            }
            waiting.push((child, pushed));
        }
        // As DBoW2 numbers words: those below the first child come first.
        waiting[first_inner..].reverse();
    }
    if let Some((_, block)) = reached.iter().zip(0..).find(|(reached, _)| !**reached) {
        return Err(FbowError::Lost { block });
    }
    tree.finish().map_err(|(_, source)| FbowError::Node { block: 0, source })
}

impl Blocks {
    /// Reads and checks the parameters.
    fn read(head: &[u8], data_bytes: usize) -> Result<Self, FbowError> {
        // Behind the signature: a name of 50 bytes and two of padding, then alignment and so on.
        let (count, kind) = (u32_at(head, 64), u32_at(head, 112));
        let (bytes, branching) = (u32_at(head, 116), u32_at(head, 120));
        if kind != BYTES_TYPE {
            return Err(FbowError::NotBinary { kind });
        }
        if bytes as usize != ORB_BYTES {
            return Err(FbowError::DescriptorBytes { bytes });
        }
        if !(2..=MAX_BRANCHING).contains(&(branching as usize)) {
            return Err(FbowError::Branching { found: branching });
        }
        let sizes = [72, 80, 88, 96].map(|at| u64_at(head, at));
        let said = u64_at(head, 104);
        let [row_bytes, block_bytes, rows_start, children_start] =
            sizes.map(|size| usize::try_from(size).unwrap_or(usize::MAX));
        let branching = branching as usize;
        let ends = |start: usize, each: usize| each.checked_mul(branching)?.checked_add(start);
        let fits = row_bytes >= ORB_BYTES
            && rows_start >= BLOCK_HEAD_BYTES
            && ends(rows_start, row_bytes).is_some_and(|end| end <= children_start)
            && ends(children_start, CHILD_BYTES).is_some_and(|end| end <= block_bytes);
        if !fits || count == 0 {
            return Err(FbowError::Layout);
        }
        let needed = (block_bytes as u64).checked_mul(u64::from(count));
        if needed != Some(said) || said != data_bytes as u64 {
            return Err(FbowError::Length { blocks: count, said, found: data_bytes as u64 });
        }
        Ok(Self { count, branching, block_bytes, row_bytes, rows_start, children_start })
    }

    /// How many nodes a block has.
    fn nodes(&self, block: u32, data: &[u8]) -> Result<usize, FbowError> {
        let nodes = usize::from(u16::from_le_bytes([data[0], data[1]]));
        match nodes {
            0 => Err(FbowError::Node { block, source: TreeError::Childless }),
            nodes if nodes > self.branching => Err(FbowError::Node {
                block,
                source: TreeError::TooManyChildren { parent: block, branching: self.branching },
            }),
            nodes => Ok(nodes),
        }
    }

    /// The descriptor of a node of a block, and its children's block or that it is a leaf.
    fn node<'a>(&self, data: &'a [u8], index: usize) -> (&'a [u8], u32) {
        let row = &data[self.rows_start + index * self.row_bytes..][..ORB_BYTES];
        (row, u32_at(data, self.children_start + index * CHILD_BYTES))
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let mut number = [0; 4];
    number.copy_from_slice(&bytes[at..at + 4]);
    u32::from_le_bytes(number)
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    let mut number = [0; 8];
    number.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(number)
}

#[cfg(test)]
mod tests;
