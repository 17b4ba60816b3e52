use super::*;
use proptest::prelude::*;

const FORMAT: Container = Container { magic: *b"WPTEST\r\n", name: "test", version: 3 };

proptest! {
    #[test]
    fn what_is_written_is_read(a in any::<u64>(), b in any::<i64>(), c in any::<u64>(), text in ".*") {
        let mut writer = Writer::default();
        writer.varint(a);
        writer.i64(b);
        writer.f64(f64::from_bits(c));
        writer.str(&text);
        let bytes = writer.into_bytes();
        let mut reader = Reader::new(&bytes);
        prop_assert_eq!(reader.varint(), Ok(a));
        prop_assert_eq!(reader.i64(), Ok(b));
        prop_assert_eq!(reader.f64().map(f64::to_bits), Ok(c));
        prop_assert_eq!(reader.str(), Ok(text.as_str()));
        prop_assert_eq!(reader.end(), Ok(()));
    }

    #[test]
    fn a_sealed_payload_opens_and_no_flipped_bit_passes(
        payload in proptest::collection::vec(any::<u8>(), 0..200), position in any::<prop::sample::Index>(), bit in 0..8u8,
    ) {
        let mut sealed = FORMAT.seal(&payload);
        prop_assert_eq!(FORMAT.open(&sealed), Ok((3, payload.as_slice())));
        let flipped = position.index(sealed.len());
        sealed[flipped] ^= 1 << bit;
        prop_assert!(FORMAT.open(&sealed).is_err());
    }

    #[test]
    fn any_cut_is_refused(payload in proptest::collection::vec(any::<u8>(), 0..50), cut in any::<prop::sample::Index>()) {
        let sealed = FORMAT.seal(&payload);
        let shorter = &sealed[..cut.index(sealed.len())];
        prop_assert!(FORMAT.open(shorter).is_err());
    }
}

#[test]
fn each_damage_has_its_own_name() {
    let sealed = FORMAT.seal(b"payload");
    assert_eq!(FORMAT.open(b"GIF89a"), Err(DecodeError::Magic { expected: "test" }));
    let newer = Container { version: 9, ..FORMAT }.seal(b"payload");
    assert_eq!(FORMAT.open(&newer), Err(DecodeError::Version { found: 9, newest: 3 }));
    assert_eq!(FORMAT.open(&sealed[..sealed.len() - 1]), Err(DecodeError::Truncated { needed: 1 }));
    let mut longer = sealed.clone();
    longer.push(0);
    assert_eq!(FORMAT.open(&longer), Err(DecodeError::Trailing { bytes: 1 }));
}

#[test]
fn a_count_that_cannot_be_there_reserves_nothing() {
    let mut writer = Writer::default();
    writer.varint(u64::MAX >> 8);
    let bytes = writer.into_bytes();
    assert!(matches!(
        Reader::new(&bytes).count(4),
        Err(DecodeError::Truncated { .. } | DecodeError::Invalid { .. })
    ));
}
