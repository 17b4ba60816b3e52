//! Vocabularies of other programs, as files: packed or not.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use fabmap::vocabulary::Vocabulary;
use flate2::bufread::MultiGzDecoder;

use crate::files::not_read;

/// What a file may have, unpacked: twice as much as `ORBvoc.txt` has as YAML.
const MOST_BYTES: u64 = 512 << 20;

/// What gzip's files begin with.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Reads any vocabulary that [`Vocabulary::import`] knows, also if it is packed by gzip.
pub(crate) fn read(path: &Path) -> Result<Vocabulary> {
    let bytes = unpacked(path, MOST_BYTES)?;
    Vocabulary::import(&bytes).with_context(|| path.display().to_string())
}

fn unpacked(path: &Path, most_bytes: u64) -> Result<Vec<u8>> {
    let mut file = BufReader::new(File::open(path).map_err(not_read(path))?);
    let mut bytes = Vec::new();
    if file.fill_buf().map_err(not_read(path))?.starts_with(&GZIP) {
        MultiGzDecoder::new(file).take(most_bytes + 1).read_to_end(&mut bytes).map_err(|reason| {
            anyhow!(
                "{} cannot be unpacked ({reason}); it is cut off or damaged, so fetch it again",
                path.display()
            )
        })?;
    } else {
        file.take(most_bytes + 1).read_to_end(&mut bytes).map_err(not_read(path))?;
    }
    if bytes.len() as u64 > most_bytes {
        let path = path.display();
        return Err(anyhow!(
            "{path} has more than {most_bytes} bytes unpacked, far more than any vocabulary has; check which file was given"
        ));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::path::PathBuf;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    fn packed(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn file(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vocabulary.yml.gz");
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    fn refusal(bytes: &[u8]) -> String {
        let (_folder, path) = file(bytes);
        format!("{:#}", read(&path).unwrap_err())
    }

    fn orb_text() -> String {
        let word = |byte: u8| format!("0 1 {}0.5\n", format!("{byte} ").repeat(32));
        "10 1 0 0\n".to_owned() + &word(0) + &word(255)
    }

    #[test]
    fn a_packed_file_is_read_as_what_it_holds() {
        let (_folder, plain) = file(orb_text().as_bytes());
        let (_folder, once) = file(&packed(orb_text().as_bytes()));
        let halves = orb_text();
        let (first, second) = halves.split_at(40);
        let (_folder, in_parts) = file(&[packed(first.as_bytes()), packed(second.as_bytes())].concat());
        let vocabulary = read(&plain).unwrap();
        assert_eq!(vocabulary.len(), 2);
        assert_eq!((read(&once).unwrap(), read(&in_parts).unwrap()), (vocabulary.clone(), vocabulary));
    }

    #[test]
    fn what_cannot_be_unpacked_or_is_no_vocabulary_is_refused() {
        let whole = packed(orb_text().as_bytes());
        for cut in [10, whole.len() / 2, whole.len() - 1] {
            let told = refusal(&whole[..cut]);
            assert!(told.contains("cut off or damaged, so fetch it again"), "{told}");
        }
        assert!(refusal(&packed(&whole)).contains("packed by gzip; unpack it first"));
        assert!(refusal(b"PK\x03\x04").contains("no vocabulary that is known"));
        assert!(refusal(b"").contains("no vocabulary that is known"));
        let dbow3 = [&88_877_711_233_u64.to_le_bytes()[..], &[0; 20]].concat();
        assert!(refusal(&dbow3).contains("DBoW3's own binary format"));
    }

    #[test]
    fn a_bomb_is_refused_before_it_bursts() {
        for bytes in [vec![b' '; 3000], packed(&[b' '; 3000])] {
            let (_folder, path) = file(&bytes);
            let told = unpacked(&path, 2999).unwrap_err().to_string();
            assert!(told.contains("more than 2999 bytes unpacked"), "{told}");
            assert_eq!(unpacked(&path, 3000).unwrap().len(), 3000);
        }
    }

    /// A real vocabulary, where it is at hand.
    fn sample(name: &str) -> Option<PathBuf> {
        let beside_the_repository =
            || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
        let data = std::env::var_os("WAYPOST_DATA").map_or_else(beside_the_repository, PathBuf::from);
        let path = data.join("imports/orb_vocabularies").join(name);
        if path.is_file() {
            return Some(path);
        }
        println!("skipped: there is no {}", path.display());
        None
    }

    /// The words of 2,000 descriptors that anybody can make, as one number.
    fn words_as_one_number(vocabulary: &Vocabulary) -> u64 {
        let mut state: u64 = 1;
        let mut byte = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            state.to_be_bytes()[0]
        };
        (0..2000).fold(0, |number: u64, _| {
            let descriptor: [u8; 32] = std::array::from_fn(|_| byte());
            number.wrapping_mul(31).wrapping_add(u64::from(vocabulary.word(&descriptor).number()))
        })
    }

    /// What DBoW2, DBoW3 and FBoW themselves say of the same descriptors.
    #[test]
    fn real_vocabularies_give_the_words_that_their_own_programs_give() {
        for (name, words, number) in [
            ("dbow2_orb_k9L3_1518nodes.yml.gz", 714, 3_338_420_863_546_516_786),
            ("dbow2_orb_k9L3_1548nodes.yml.gz", 729, 13_693_836_763_886_854_459),
            ("dbow2_orb_k9L4_13941nodes.yml.gz", 6561, 1_748_914_164_147_912_297),
            ("dbow3_orb_k10L5_11145nodes.yml.gz", 4983, 2_333_264_923_183_082_085),
        ] {
            let Some(path) = sample(name) else { continue };
            let vocabulary = read(&path).unwrap();
            assert_eq!((vocabulary.len(), words_as_one_number(&vocabulary)), (words, number), "{name}");
        }
    }

    #[test]
    fn a_real_vocabulary_that_was_cut_off_is_refused() {
        let Some(path) = sample("ORBvoc_first9999lines.txt") else { return };
        let told = format!("{:#}", read(&path).unwrap_err());
        assert!(told.contains("the file was cut off, so fetch it again"), "{told}");
    }
}
