//! Of the formats that are bytes.

use std::collections::BTreeMap;
use std::io::Cursor;

use fabmap::codec::Reader;
use fabmap::observation::WordId;
use fabmap::{DescriptorKind, Descriptors};
use image::{DynamicImage, ImageFormat, Rgb, RgbImage};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Keypoint;

use super::{Seed, fixture};

/// Kind and content of each record of a snapshot.
pub(super) fn records(snapshot: &[u8]) -> Vec<(u8, Vec<u8>)> {
    let mut rest = &snapshot[12..];
    let mut records = Vec::new();
    while let Some((&[kind, a, b, c, d], content)) = rest.split_first_chunk() {
        let (content, further) = content.split_at(u32::from_le_bytes([a, b, c, d]) as usize);
        records.push((kind, content.to_vec()));
        rest = further;
    }
    records
}

/// The model in a snapshot.
pub(super) fn model_in(snapshot: &[u8]) -> Vec<u8> {
    let records = records(snapshot);
    let (_, record) = records.iter().find(|(kind, _)| *kind == 2).unwrap();
    let mut reader = Reader::new(record);
    reader.str().unwrap();
    record[record.len() - reader.remaining()..].to_vec()
}

fn events() -> Vec<Seed> {
    let mut all = Vec::new();
    for version in 1..=3 {
        let snapshot = fixture(&format!("tests/tests/fixtures/map-v{version}.snapshot"));
        for (_, record) in records(&snapshot).iter().filter(|(kind, _)| *kind == 5) {
            let mut reader = Reader::new(record);
            reader.varint().unwrap();
            all.push(record[record.len() - reader.remaining()..].to_vec());
        }
    }
    for version in 1..=4 {
        let log = fixture(&format!("topomap/tests/fixtures/log-v{version}.bin"));
        let mut reader = Reader::new(&log);
        while reader.remaining() > 0 {
            all.push(reader.bytes().unwrap().to_vec());
        }
    }
    // By version and kind: the shortest and the longest.
    let mut chosen: BTreeMap<(u8, u8), Vec<Vec<u8>>> = BTreeMap::new();
    all.sort_by_key(Vec::len);
    for event in all {
        let alike = chosen.entry((event[0], event[1])).or_default();
        if alike.len() == 2 {
            alike[1] = event;
        } else {
            alike.push(event);
        }
    }
    let named = chosen.into_iter().flat_map(|((version, kind), events)| {
        events.into_iter().enumerate().map(move |(number, event)| {
            Seed::new("event", format!("version-{version}-kind-{kind}-{number}"), event)
        })
    });
    named.collect()
}

fn features() -> Vec<Seed> {
    let keypoint = |index: u8| Keypoint {
        x_px: f32::from(index) * 3.5,
        y_px: f32::from(index),
        size_px: 4.0,
        angle_rad: 0.5,
        response: 1.0,
    };
    let of = |count: u8, descriptors: Option<Descriptors>| {
        let keypoints = (0..count).map(keypoint).collect();
        let words = (0..count).map(|index| WordId::new(u32::from(index) * 300)).collect();
        FeatureRecord::new((64, 48), keypoints, words, descriptors).unwrap().to_bytes()
    };
    let binary = Descriptors::new(DescriptorKind::Binary, 32, vec![0xa5; 3 * 32]).unwrap();
    let float = Descriptors::new(DescriptorKind::Float, 8, vec![7; 2 * 8]).unwrap();
    let seeds =
        [("none", 0, None), ("words", 5, None), ("binary", 3, Some(binary)), ("float", 2, Some(float))];
    seeds.map(|(name, count, descriptors)| Seed::new("features", name, of(count, descriptors))).into()
}

fn images() -> Vec<Seed> {
    let colour = RgbImage::from_fn(40, 36, |x, y| Rgb([x as u8 * 6, y as u8 * 7, (x * y) as u8]));
    let colour = DynamicImage::ImageRgb8(colour);
    let file = |image: &DynamicImage, format| {
        let mut file = Cursor::new(Vec::new());
        image.write_to(&mut file, format).unwrap();
        file.into_inner()
    };
    let jpeg = file(&colour, ImageFormat::Jpeg);
    // An orientation in EXIF, and a thumbnail's end marker that is not the picture's.
    let exif = b"Exif\0\0MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0\xff\xd9";
    let segment = [&[0xff, 0xe1][..], &(exif.len() as u16 + 2).to_be_bytes(), exif].concat();
    let turned = [&jpeg[..2], &segment, &jpeg[2..]].concat();
    let grey = DynamicImage::ImageLuma8(colour.to_luma8());
    [
        ("grey.jpg", file(&grey, ImageFormat::Jpeg)),
        ("colour.jpg", jpeg),
        ("turned.jpg", turned),
        ("grey.png", file(&grey, ImageFormat::Png)),
        ("colour.png", file(&colour, ImageFormat::Png)),
        ("alpha-16.png", file(&DynamicImage::ImageRgba16(colour.to_rgba16()), ImageFormat::Png)),
        ("webp", b"RIFF\0\0\0\0WEBPVP8 ".to_vec()),
    ]
    .map(|(name, bytes)| Seed::new("image", name, bytes))
    .into()
}

pub(super) fn seeds() -> Vec<Seed> {
    let map = |version| fixture(&format!("tests/tests/fixtures/map-v{version}.snapshot"));
    let mut seeds = vec![
        Seed::new("model", "version-1", fixture("fabmap/tests/fixtures/model-v1.waypost")),
        Seed::new("model", "version-2", fixture("fabmap/tests/fixtures/model-v2.waypost")),
        Seed::new("model", "of-a-map", model_in(&map(3))),
        Seed::new("snapshot", "version-1", map(1)),
        Seed::new("snapshot", "version-3", map(3)),
    ];
    seeds.extend(events());
    seeds.extend(features());
    seeds.extend(images());
    seeds
}
