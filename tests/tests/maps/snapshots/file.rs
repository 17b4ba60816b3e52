//! Snapshots taken apart and sealed again, so that what is wrong is not the checksum.

use sha2::{Digest, Sha256};

pub(super) const MAP: u8 = 1;
pub(super) const MODEL: u8 = 2;
pub(super) const SESSION: u8 = 4;
pub(super) const EVENT: u8 = 5;
pub(super) const MEDIUM: u8 = 6;
pub(super) const LABEL: u8 = 7;
const END: u8 = 255;
const HEADER_BYTES: usize = 12;

/// The records of a snapshot, but for the end: kind and content.
pub(super) fn records(file: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut rest = &file[HEADER_BYTES..];
    let mut records = Vec::new();
    while rest[0] != END {
        let length = u32::from_le_bytes(rest[1..5].try_into().unwrap()) as usize;
        records.push((rest[0], rest[5..5 + length].to_vec()));
        rest = &rest[5 + length..];
    }
    records
}

/// A snapshot of these records, whatever they are.
pub(super) fn sealed(records: &[(u8, Vec<u8>)]) -> Vec<u8> {
    let mut file = b"WPSNAP\r\n".to_vec();
    file.extend(2_u32.to_le_bytes());
    for (kind, content) in records {
        file.push(*kind);
        file.extend((content.len() as u32).to_le_bytes());
        file.extend(content);
    }
    let mut counts = Vec::new();
    for kind in [3, SESSION, EVENT, MEDIUM, LABEL] {
        varint(records.iter().filter(|(of, _)| *of == kind).count() as u64, &mut counts);
    }
    file.push(END);
    file.extend((counts.len() as u32 + 32).to_le_bytes());
    file.extend(counts);
    let hash = Sha256::digest(&file);
    file.extend(hash);
    file
}

fn varint(mut value: u64, bytes: &mut Vec<u8>) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}
