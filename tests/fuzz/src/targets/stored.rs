//! Files that Waypost writes, and takes back from anybody. Checksums are made right first: who forges a file does that, too.

use std::io::Write;
use std::sync::LazyLock;

use fabmap::codec::Container;
use fabmap::model::Model;
use fabmap::observation::WordId;
use sha2::{Digest, Sha256};
use topomap::log::MapEvent;
use topomap::mapper::Mapper;
use topomap::settings::MapperSettings;
use waypost_server::unconnected;

use crate::Fed;

const MODEL_MAGIC: &[u8; 8] = b"WPMODEL\n";
/// Magic, version and length.
const MODEL_HEADER: usize = 20;
const HASH_BYTES: usize = 32;

/// A model file.
pub(super) fn model(bytes: &[u8]) -> Fed {
    let sealed = sealed_model(bytes);
    let Ok(model) = Model::from_bytes(&sealed) else { return Fed::Refused };
    let again = Model::from_bytes(&model.to_bytes()).expect("what is written is read");
    assert_eq!((again.hash(), again.words_hash()), (model.hash(), model.words_hash()));
    let vocabulary = model.vocabulary();
    let word = vocabulary.word(&vec![0x5a; vocabulary.width()]);
    assert!(word.index() < vocabulary.len());
    if unconnected::check_model(&sealed).is_err() {
        return Fed::Refused;
    }
    // What is taken can be mapped with.
    Mapper::new(&model, MapperSettings::default()).expect("the default settings go with every model");
    Fed::Taken
}

/// The file with its length and checksum made right, as long as it says at all that it is a model.
fn sealed_model(bytes: &[u8]) -> Vec<u8> {
    let end = bytes.len().saturating_sub(HASH_BYTES);
    if !bytes.starts_with(MODEL_MAGIC) || end < MODEL_HEADER {
        return bytes.to_vec();
    }
    let version = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]);
    Container { magic: *MODEL_MAGIC, name: "model", version }.seal(&bytes[MODEL_HEADER..end])
}

/// An event of a log.
pub(super) fn event(bytes: &[u8]) -> Fed {
    const WORDS: usize = 1000;
    let Ok(event) = MapEvent::from_bytes(bytes, WORDS) else { return Fed::Refused };
    let written = event.to_bytes();
    let again = MapEvent::from_bytes(&written, WORDS).expect("what is written is read");
    assert_eq!(again.to_bytes(), written);
    if let MapEvent::Frame(frame) = &event {
        assert!(frame.observation.words().iter().copied().map(WordId::index).all(|word| word < WORDS));
    }
    Fed::Taken
}

/// A map with its model, all of it as an import checks it.
pub(super) fn snapshot(bytes: &[u8]) -> Fed {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| tempfile::tempdir().unwrap());
    let mut file = tempfile::tempfile_in(FOLDER.path()).unwrap();
    file.write_all(&sealed_snapshot(bytes)).unwrap();
    match unconnected::check_snapshot(&file) {
        Ok(()) => Fed::Taken,
        Err(why) => {
            assert!(!why.contains("internal"), "{why}");
            Fed::Refused
        }
    }
}

/// The file with lengths that fit, and the end that goes with its records, as long as it says at all that it is a snapshot.
fn sealed_snapshot(bytes: &[u8]) -> Vec<u8> {
    const HEADER: usize = 12;
    const END: u8 = 255;
    if !bytes.starts_with(b"WPSNAP\r\n") || bytes.len() < HEADER {
        return bytes.to_vec();
    }
    let (header, mut rest) = bytes.split_at(HEADER);
    let version = u32::from_le_bytes([header[8], header[9], header[10], header[11]]);
    let mut sealed = header.to_vec();
    let mut counts = [0_u64; 9];
    while let Some((&[kind, a, b, c, d], content)) = rest.split_first_chunk() {
        if kind == END {
            break;
        }
        let length = (u32::from_le_bytes([a, b, c, d]) as usize).min(content.len());
        sealed.push(kind);
        sealed.extend((length as u32).to_le_bytes());
        sealed.extend(&content[..length]);
        rest = &content[length..];
        if let Some(count) = counts.get_mut(usize::from(kind)) {
            *count += 1;
        }
    }
    let last = match version {
        1 => 6,
        2 | 3 => 7,
        _ => 8,
    };
    let mut end = Vec::new();
    for mut count in counts[3..=last].iter().copied() {
        while count > 0x7f {
            end.push(count as u8 | 0x80);
            count >>= 7;
        }
        end.push(count as u8);
    }
    let hash = Sha256::new().chain_update(&sealed);
    sealed.push(END);
    sealed.extend(((end.len() + HASH_BYTES) as u32).to_le_bytes());
    // The length of the end is hashed with the rest.
    let hash = hash.chain_update(&sealed[sealed.len() - 5..]).chain_update(&end).finalize();
    sealed.extend(end);
    sealed.extend(hash);
    sealed
}
