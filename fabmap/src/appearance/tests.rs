use super::*;
use proptest::prelude::*;

fn looks() -> impl Strategy<Value = Vec<Vec<u32>>> {
    proptest::collection::vec(proptest::collection::vec(0..20u32, 0..8), 0..40)
}

proptest! {
    #[test]
    fn counts_are_those_of_a_plain_tally(looks in looks()) {
        let mut appearance = Appearance::default();
        let mut n = 0u8;
        let mut tally = [0u8; 20];
        for look in &looks {
            appearance.observe(&Observation::from_words(look.iter().copied(), 20).unwrap());
            if n == 15 {
                n = 7;
                tally.iter_mut().filter(|k| **k > 0).for_each(|k| *k = (*k / 2).max(1));
            }
            n += 1;
            (0..20).filter(|word| look.contains(word)).for_each(|word| tally[word as usize] += 1);
        }
        prop_assert_eq!(appearance.looks(), n);
        for word in WordId::first(20) {
            prop_assert_eq!(appearance.hits(word), tally[word.index()]);
            prop_assert!(appearance.hits(word) <= n);
        }
    }

    #[test]
    fn bytes_give_the_appearance_back(looks in looks()) {
        let mut appearance = Appearance::default();
        for look in &looks {
            appearance.observe(&Observation::from_words(look.iter().copied(), 20).unwrap());
        }
        let mut writer = Writer::default();
        appearance.encode(&mut writer);
        let bytes = writer.into_bytes();
        prop_assert_eq!(Appearance::decode(&mut Reader::new(&bytes), 20), Ok(appearance.clone()));
        let mut writer = Writer::default();
        appearance.encode_packed(&mut writer);
        let bytes = writer.into_bytes();
        let mut reader = Reader::new(&bytes);
        prop_assert_eq!(Appearance::decode_packed(&mut reader, 20), Ok(appearance));
        prop_assert_eq!(reader.remaining(), 0);
    }

    #[test]
    fn foreign_bytes_never_make_impossible_counts(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
        let plain = Appearance::decode(&mut Reader::new(&bytes), 300);
        let packed = Appearance::decode_packed(&mut Reader::new(&bytes), 300);
        for appearance in [plain, packed].into_iter().flatten() {
            prop_assert!(appearance.word_hits().all(|(word, k)| word.index() < 300 && (1..=appearance.looks()).contains(&k)));
        }
    }
}
