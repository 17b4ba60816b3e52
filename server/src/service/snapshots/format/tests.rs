use sha2::{Digest, Sha256};

use super::*;
use crate::camera::{Camera, CameraModel};

fn camera() -> Camera {
    let model = Some(CameraModel::FieldOfView { horizontal_rad: 0.5 });
    Camera { model, image_size_px: None, base_to_camera: None }
}

/// The same as versions 1 and 2 had it.
const CAMERA_MESSAGE: [u8; 11] = [0x12, 9, 9, 0, 0, 0, 0, 0, 0, 0xe0, 0x3f];

fn records() -> Vec<Record> {
    let session = |number, camera| {
        let name = format!("robot-{number}");
        Record::Session(StoredSession { number, name, camera, opened_ns: 5 })
    };
    let medium = |position, kind| Record::Medium(MediaRow { position, kind, content: vec![7; 9] });
    let label = |place, label: &str| Record::Label(LabelRow { place, label: label.to_owned() });
    let note = |position, note: &str| Record::Note(NoteRow { position, note: note.to_owned() });
    vec![
        Record::Map(MapRecord {
            name: "hall".to_owned(),
            model: "ab".repeat(32),
            settings: "{}".to_owned(),
            created_ns: -3,
        }),
        Record::Model { display_name: "office".to_owned(), file: vec![1, 2, 3] },
        Record::FormerModel(FormerModelRow { until_events: 1, model: "cd".repeat(32) }),
        session(0, None),
        session(1, Some(camera())),
        Record::Event { position: 0, event: vec![1] },
        Record::Event { position: 1, event: vec![] },
        medium(1, MediumKind::Features),
        medium(1, MediumKind::Thumbnail),
        label(0, "kitchen"),
        label(7, "Küche"),
        note(0, "left.jpg"),
        note(1, "right.jpg"),
    ]
}

fn write(records: &[Record]) -> Vec<u8> {
    let mut writer = SnapshotWriter::new();
    records.iter().for_each(|record| writer.record(record).unwrap());
    let mut bytes = writer.take();
    bytes.extend(writer.finish());
    bytes
}

fn read(bytes: &[u8]) -> Result<Vec<Record>, DecodeError> {
    let decode_error = |error| match error {
        SnapshotError::Decode(error) => error,
        SnapshotError::Source(error) => panic!("{error}"),
    };
    let mut reader = SnapshotReader::open(bytes).map_err(decode_error)?;
    let mut records = Vec::new();
    while let Some(record) = reader.next().map_err(decode_error)? {
        records.push(record);
    }
    assert_eq!(reader.bytes(), bytes.len() as u64);
    Ok(records)
}

#[test]
fn what_is_written_is_read() {
    assert_eq!(read(&write(&records())), Ok(records()));
    assert_eq!(read(&write(&records()[..2])), Ok(records()[..2].to_vec()));
}

#[test]
fn no_flipped_bit_passes() {
    let whole = write(&records());
    for position in 0..whole.len() {
        for bit in 0..8 {
            let mut flipped = whole.clone();
            flipped[position] ^= 1 << bit;
            assert!(read(&flipped).is_err(), "byte {position}, bit {bit}");
        }
    }
}

#[test]
fn no_cut_passes() {
    let whole = write(&records());
    for length in 0..whole.len() {
        let error = read(&whole[..length]).unwrap_err();
        assert!(matches!(error, DecodeError::Truncated { .. }), "{length} bytes: {error}");
    }
}

#[test]
fn records_out_of_order_or_there_twice_are_refused() {
    for (first, second) in (0..records().len()).flat_map(|a| (0..a).map(move |b| (b, a))) {
        let mut swapped = records();
        swapped.swap(first, second);
        assert!(read(&write(&swapped)).is_err(), "{first} and {second} swapped");
    }
    for index in 0..records().len() {
        let mut twice = records();
        twice.insert(index, records()[index].clone());
        assert!(read(&write(&twice)).is_err(), "record {index} twice");
    }
    for index in [0, 1, 5] {
        let mut fewer = records();
        fewer.remove(index);
        assert!(read(&write(&fewer)).is_err(), "record {index} is missing");
    }
}

#[test]
fn each_damage_has_its_own_name() {
    let whole = write(&records());
    let replaced = |at: usize, bytes: &[u8]| {
        let mut damaged = whole.clone();
        damaged[at..at + bytes.len()].copy_from_slice(bytes);
        read(&damaged).unwrap_err()
    };
    assert_eq!(read(b"WPMODEL\n and more").unwrap_err(), DecodeError::Magic { expected: "Waypost snapshot" });
    assert_eq!(replaced(8, &[5]), DecodeError::Version { found: 5, newest: 4 });
    assert_eq!(replaced(whole.len() - 1, &[0, 0][..1]), DecodeError::Checksum);
    assert!(matches!(replaced(13, &u32::MAX.to_le_bytes()), DecodeError::Invalid { .. }));
    assert!(matches!(replaced(13, &(16u32 << 20).to_le_bytes()), DecodeError::Truncated { .. }));
    let mut longer = whole.clone();
    longer.extend([0; 3]);
    assert_eq!(read(&longer).unwrap_err(), DecodeError::Trailing { bytes: 3 });
}

/// What the writer of an earlier version made of records.
fn written_before(version: u8, records: &[Record]) -> Vec<u8> {
    let whole = write(records);
    let mut bytes = whole[..whole.len() - HASH_BYTES].to_vec();
    bytes[MAGIC.len()] = version;
    let version = u32::from(version);
    if version < WITH_CAMERA_BYTES {
        let present = camera().to_bytes();
        let at = bytes.windows(present.len()).position(|bytes| bytes == present).unwrap();
        // The camera, its length, and that of its record, behind the session's number, name and flag.
        bytes.splice(at..at + present.len(), CAMERA_MESSAGE);
        bytes[at - 1] = CAMERA_MESSAGE.len() as u8;
        let record = at - 1 - 1 - "robot-1".len() - 1 - 1 - 4;
        bytes[record] -= (present.len() - CAMERA_MESSAGE.len()) as u8;
    }
    // Numbers in the end that there were not yet.
    let numbers = 6;
    let fewer = [WITH_LABELS, WITH_NOTES].into_iter().filter(|since| version < *since).count();
    bytes.truncate(bytes.len() - fewer);
    let length = bytes.len() - (numbers - fewer) - 4;
    bytes[length] -= fewer as u8;
    let hash = Sha256::digest(&bytes);
    bytes.extend(hash);
    bytes
}

#[test]
fn the_first_version_is_read_and_has_no_labels() {
    let without = &records()[..9];
    assert_eq!(read(&written_before(1, without)), Ok(without.to_vec()));
    let error = read(&written_before(1, &records())).unwrap_err();
    assert!(error.to_string().contains("a record of kind 7"), "{error}");
}

#[test]
fn the_second_version_is_read_with_its_cameras() {
    let without = &records()[..11];
    assert_eq!(read(&written_before(2, without)), Ok(without.to_vec()));
}

#[test]
fn the_third_version_is_read_and_has_no_notes() {
    let without = &records()[..11];
    assert_eq!(read(&written_before(3, without)), Ok(without.to_vec()));
    let error = read(&written_before(3, &records())).unwrap_err();
    assert!(error.to_string().contains("a record of kind 8"), "{error}");
}
