use crate::vocabulary::dbow_yaml::tests::dbow_yaml;
use crate::vocabulary::test_vocabularies::{decoded, encoded};
use crate::vocabulary::{ImportError, TreeError, Vocabulary};
use proptest::prelude::*;

use super::FbowError;

/// What FBoW's own program made of the file of `dbow_yaml`.
const WRITTEN_BY_FBOW: &[u8] = include_bytes!("../../../tests/fixtures/small.fbow");

/// Bytes of a block: its head, nine descriptors, nine children.
const BLOCK_BYTES: usize = 8 + 9 * 32 + 9 * 8;

/// Where what is said of the children begins in a block.
const CHILDREN: usize = 128 + 8 + 9 * 32;

fn fault(bytes: &[u8]) -> FbowError {
    match Vocabulary::import(bytes).unwrap_err() {
        ImportError::Fbow(fault) => fault,
        other => panic!("{other}"),
    }
}

/// The file with other bytes at a place.
fn changed(at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = WRITTEN_BY_FBOW.to_vec();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    file
}

#[test]
fn a_file_of_fbow_is_the_vocabulary_that_it_was_made_of() {
    let vocabulary = Vocabulary::import(WRITTEN_BY_FBOW).unwrap();
    assert_eq!(vocabulary, Vocabulary::import(dbow_yaml().as_bytes()).unwrap());
    assert_eq!(decoded(&encoded(&vocabulary)), Ok(vocabulary));
}

#[test]
fn each_fault_is_named() {
    let end = WRITTEN_BY_FBOW.len();
    let longer = [WRITTEN_BY_FBOW, &[0]].concat();
    let said = 3 * BLOCK_BYTES as u64;
    for (file, expected) in [
        (WRITTEN_BY_FBOW[..8].to_vec(), FbowError::Head { bytes: 8 }),
        (WRITTEN_BY_FBOW[..127].to_vec(), FbowError::Head { bytes: 127 }),
        (WRITTEN_BY_FBOW[..end - 1].to_vec(), FbowError::Length { blocks: 3, said, found: said - 1 }),
        (longer, FbowError::Length { blocks: 3, said, found: said + 1 }),
        (changed(64, &[4]), FbowError::Length { blocks: 4, said, found: said }),
        (changed(64, &[255; 4]), FbowError::Length { blocks: u32::MAX, said, found: said }),
        (changed(64, &[0]), FbowError::Layout),
        (changed(72, &[31]), FbowError::Layout),
        (changed(72, &[255; 8]), FbowError::Layout),
        (changed(80, &[1, 0]), FbowError::Layout),
        (changed(88, &[0]), FbowError::Layout),
        (changed(96, &[0]), FbowError::Layout),
        (changed(96, &[255; 8]), FbowError::Layout),
        (changed(104, &[255; 8]), FbowError::Length { blocks: 3, said: u64::MAX, found: said }),
        (changed(112, &[5]), FbowError::NotBinary { kind: 5 }),
        (changed(116, &[61]), FbowError::DescriptorBytes { bytes: 61 }),
        (changed(120, &[21]), FbowError::Branching { found: 21 }),
        (changed(120, &[1]), FbowError::Branching { found: 1 }),
        (changed(128, &[0]), FbowError::Node { block: 0, source: TreeError::Childless }),
        (
            changed(128, &[10]),
            FbowError::Node { block: 0, source: TreeError::TooManyChildren { parent: 0, branching: 9 } },
        ),
        (changed(CHILDREN, &[3]), FbowError::NoBlock { block: 0, found: 3 }),
        (changed(CHILDREN, &[0]), FbowError::BlockTwice { block: 0, found: 0 }),
        (changed(CHILDREN, &[2]), FbowError::BlockTwice { block: 0, found: 2 }),
        (changed(CHILDREN + 3, &[128]), FbowError::Lost { block: 1 }),
    ] {
        assert_eq!(fault(&file), expected);
    }
}

#[test]
fn levels_without_end_are_refused() {
    // Each block has one node, whose children are the next block.
    let blocks = 50_u32;
    let mut file = WRITTEN_BY_FBOW[..128].to_vec();
    file[64..68].copy_from_slice(&blocks.to_le_bytes());
    file[104..112].copy_from_slice(&(u64::from(blocks) * BLOCK_BYTES as u64).to_le_bytes());
    for block in 0..blocks {
        let mut bytes = [0; BLOCK_BYTES];
        bytes[0] = 1;
        bytes[CHILDREN - 128..CHILDREN - 124].copy_from_slice(&(block + 1).to_le_bytes());
        file.extend_from_slice(&bytes);
    }
    assert_eq!(fault(&file), FbowError::Node { block: 10, source: TreeError::TooDeep { depth: 10 } });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_bytes_are_refused_or_quantize_without_panic(
        damage in proptest::collection::vec((8..WRITTEN_BY_FBOW.len(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = WRITTEN_BY_FBOW.to_vec();
        for (place, value) in damage {
            bytes[place] = value;
        }
        if let Ok(vocabulary) = Vocabulary::import(&bytes) {
            prop_assert!(vocabulary.word(&[170; 32]).index() < vocabulary.len());
        }
        prop_assert!(Vocabulary::import(&bytes[..cut.index(bytes.len())]).is_err());
    }
}
