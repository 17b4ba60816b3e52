//! Bytes that are nearly those of a corpus, the same ones for the same seed.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Longest result.
const MOST_BYTES: usize = 1 << 16;

/// Numbers and pieces of text that code is most often wrong about, in the encodings that our formats have.
const NASTY: [&[u8]; 24] = [
    &[0],
    &[0xff],
    &[0; 4],
    &[0xff; 4],
    &[0xff, 0xff, 0xff, 0x7f],
    &[0, 0, 0, 0x80],
    &[0xff; 8],
    &[0, 0, 0, 0, 0, 0, 0, 0x80],
    // The largest varints of 32 and 64 bits, and one without an end.
    &[0xff, 0xff, 0xff, 0xff, 0x0f],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01],
    &[0x80; 11],
    // f64: NaN, infinity, the largest, the smallest, -0.
    &[0, 0, 0, 0, 0, 0, 0xf8, 0x7f],
    &[0, 0, 0, 0, 0, 0, 0xf0, 0x7f],
    &[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xef, 0x7f],
    &[1, 0, 0, 0, 0, 0, 0, 0],
    &[0, 0, 0, 0, 0, 0, 0, 0x80],
    // f32: NaN, infinity.
    &[0, 0, 0xc0, 0x7f],
    &[0, 0, 0x80, 0x7f],
    b"nan",
    b"1e999",
    b"-9223372036854775808",
    b"18446744073709551616",
    "\u{feff}\u{202e}é".as_bytes(),
    b"\n",
];

/// Makes one input after the other out of a corpus.
#[derive(Debug)]
pub struct Mutations<'a> {
    corpus: &'a [Vec<u8>],
    random: ChaCha8Rng,
}

impl<'a> Mutations<'a> {
    /// Of a corpus that is not empty.
    #[must_use]
    pub fn of(corpus: &'a [Vec<u8>], seed: u64) -> Self {
        Self { corpus, random: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn any(&mut self) -> &'a [u8] {
        &self.corpus[self.random.random_range(0..self.corpus.len())]
    }

    /// One of the corpus, changed in one to four ways.
    pub fn one(&mut self) -> Vec<u8> {
        let mut bytes = self.any().to_vec();
        // Few changes are the most likely: they get the furthest.
        for _ in 0..1 << self.random.random_range(0_u32..5).saturating_sub(2) {
            self.change(&mut bytes);
        }
        bytes.truncate(MOST_BYTES);
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        let at = self.random.random_range(0..=bytes.len());
        let length = self.random.random_range(1..=16).min(bytes.len() - at);
        match self.random.random_range(0..9) {
            0 if at < bytes.len() => bytes[at] ^= 1 << self.random.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = self.random.random(),
            2 => drop(bytes.drain(at..at + length)),
            3 if self.random.random_range(0..4) == 0 => bytes.truncate(at),
            4 => {
                let piece = NASTY[self.random.random_range(0..NASTY.len())];
                let end = (at + piece.len()).min(bytes.len());
                bytes.splice(at..end, piece.iter().copied());
            }
            5 => {
                let piece = NASTY[self.random.random_range(0..NASTY.len())];
                bytes.splice(at..at, piece.iter().copied());
            }
            6 => {
                let piece = bytes[at..at + length].repeat(self.random.random_range(1..=20));
                bytes.splice(at..at, piece);
            }
            7 => {
                let other = self.any();
                let from = self.random.random_range(0..=other.len());
                let most = self.random.random_range(0..=256).min(other.len() - from);
                bytes.splice(at..at + length, other[from..from + most].iter().copied());
            }
            // Also where there is no byte to change.
            _ => bytes.insert(at, self.random.random()),
        }
    }
}
