//! What people and other programs write as text.

use std::io::Write;

use fabmap::codec::{Reader, Writer};
use fabmap::vocabulary::Vocabulary;
use posegraph::g2o::G2o;
use posegraph::trajectory::{from_tum, to_kitti, to_tum};

use crate::{Fed, camera_file, odometry};

/// A pose graph.
pub(super) fn g2o(bytes: &[u8]) -> Fed {
    let Ok(graph) = G2o::read(bytes) else { return Fed::Refused };
    let text = graph.write();
    let again = G2o::read(&text).expect("what is written is read");
    assert_eq!(again.write(), text);
    Fed::Taken
}

/// A trajectory.
pub(super) fn tum(bytes: &[u8]) -> Fed {
    let Ok(poses) = from_tum(bytes) else { return Fed::Refused };
    let text = to_tum(&poses);
    let again = from_tum(&text).expect("what is written is read");
    assert_eq!(to_tum(&again), text);
    assert_eq!(to_kitti(&poses).iter().filter(|byte| **byte == b'\n').count(), poses.len());
    Fed::Taken
}

/// Poses by the wheels, as the command line reads them.
pub(super) fn odometry_file(bytes: &[u8]) -> Fed {
    let Some(poses) = std::str::from_utf8(bytes).ok().and_then(|text| odometry::parse(text).ok()) else {
        return Fed::Refused;
    };
    assert!(poses.iter().zip(&poses[1..]).all(|(before, after)| before.stamp_ns < after.stamp_ns));
    for pose in &poses {
        let numbers = pose.pose.position_m.iter().chain(&pose.pose.orientation);
        assert!(numbers.into_iter().all(|number| number.is_finite()), "{pose:?}");
    }
    Fed::Taken
}

/// What `--camera` takes: a file, or numbers in its place.
pub(super) fn camera_file(bytes: &[u8]) -> Fed {
    const IMAGE_PX: (u32, u32) = (640, 480);
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(bytes).unwrap();
    let path = file.path().to_str().unwrap();
    let in_file = camera_file::described_camera(path, IMAGE_PX);
    let as_numbers = std::str::from_utf8(bytes).ok().filter(|text| text.contains(','));
    let as_numbers = as_numbers.map(|text| camera_file::described_camera(text, IMAGE_PX));
    match (in_file, as_numbers) {
        (Ok(_), _) | (_, Some(Ok(_))) => Fed::Taken,
        (Err(error), _) => {
            assert!(!error.to_string().is_empty());
            Fed::Refused
        }
    }
}

/// ORB vocabularies of other programs, in each of their formats.
pub(super) fn orb_vocabulary(bytes: &[u8]) -> Fed {
    let vocabulary = match Vocabulary::import(bytes) {
        Ok(vocabulary) => vocabulary,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return Fed::Refused;
        }
    };
    let encoded = |vocabulary: &Vocabulary| {
        let mut writer = Writer::default();
        vocabulary.encode(&mut writer);
        writer.into_bytes()
    };
    let bytes = encoded(&vocabulary);
    let mut reader = Reader::new(&bytes);
    let again = Vocabulary::decode(&mut reader).expect("what is encoded is decoded");
    reader.end().unwrap();
    assert_eq!(encoded(&again), bytes);
    let word = vocabulary.word(&vec![0x5a; vocabulary.width()]);
    assert!((word.index()) < vocabulary.len() && again.word(&vec![0x5a; again.width()]) == word);
    Fed::Taken
}
