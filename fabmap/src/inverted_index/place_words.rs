//! The words of one place, small.

use crate::codec::Writer;
use crate::observation::WordId;

/// Words, ascending, as distances from one to the next in bytes of 7 bits: a byte or two a word.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct PlaceWords {
    bytes: Box<[u8]>,
    len: u32,
}

impl PlaceWords {
    /// From words ascending, each once.
    pub(super) fn new(words: impl Iterator<Item = WordId>) -> Self {
        let mut writer = Writer::default();
        let mut previous = 0;
        let mut len = 0;
        for word in words {
            writer.varint(u64::from(word.number() - previous));
            previous = word.number();
            len += 1;
        }
        Self { bytes: writer.into_bytes().into_boxed_slice(), len }
    }

    /// Number of words.
    pub(super) fn len(&self) -> usize {
        self.len as usize
    }

    /// The words, ascending.
    pub(super) fn iter(&self) -> impl Iterator<Item = WordId> + '_ {
        let mut bytes = self.bytes.iter();
        let mut word = 0;
        std::iter::from_fn(move || {
            let mut step = 0;
            let mut shift = 0;
            loop {
                let byte = *bytes.next()?;
                step |= u32::from(byte & 0x7f) << shift;
                if byte & 0x80 == 0 {
                    break;
                }
                shift += 7;
            }
            word += step;
            Some(WordId::new(word))
        })
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.bytes.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn words_come_back(words in proptest::collection::btree_set(any::<u32>(), 0..300)) {
            let words: Vec<WordId> = words.into_iter().map(WordId::new).collect();
            let kept = PlaceWords::new(words.iter().copied());
            prop_assert_eq!(kept.len(), words.len());
            prop_assert_eq!(kept.iter().collect::<Vec<_>>(), words);
        }
    }
}
