//! Words that are none: for frames and for queries.

use waypost_client::v1;
use waypost_proto::v1::frame::Content;

use crate::harness::reference;

/// What is sent in place of good words, and what is said to it.
pub(super) struct BadWords {
    pub(super) case: &'static str,
    pub(super) content: Content,
    pub(super) fragment: &'static str,
}

const WIDTH_PX: u32 = 640;
const HEIGHT_PX: u32 = 360;

/// Three features, as they should be.
fn three() -> v1::WordList {
    v1::WordList {
        words: vec![4, 4, 9],
        x_px: vec![1.0, 2.0, 639.5],
        y_px: vec![1.0, 2.0, 359.5],
        size_px: vec![3.0; 3],
        angle_rad: vec![0.5; 3],
        image_width_px: WIDTH_PX,
        image_height_px: HEIGHT_PX,
    }
}

fn list(case: &'static str, spoil: impl FnOnce(&mut v1::WordList), fragment: &'static str) -> BadWords {
    let mut words = three();
    spoil(&mut words);
    BadWords { case, content: Content::Words(words), fragment }
}

fn counts(case: &'static str, words: Vec<u32>, counts: Vec<u32>, fragment: &'static str) -> BadWords {
    BadWords { case, content: Content::Histogram(v1::WordHistogram { words, counts }), fragment }
}

/// Each is bad in one way.
pub(super) fn bad_words() -> Vec<BadWords> {
    let foreign = reference().model().vocabulary().len() as u32;
    let many: Vec<u32> = (0..70_000).map(|word| word % 1000).collect();
    let all = |value: f32| vec![value; 3];
    vec![
        counts("one count too few", vec![1, 2], vec![1], "has 2 words and 1 counts; send one count a word"),
        counts("one count too many", vec![1], vec![1, 1], "or none if each was seen once"),
        counts("counts without words", vec![], vec![3], "has 0 words and 1 counts"),
        counts("a word twice", vec![5, 6, 5], vec![1, 1, 1], "word 5 is listed twice; list each word once"),
        counts("a word twice without counts", vec![5, 5], vec![], "list each word once"),
        counts("a count of 0", vec![5, 6], vec![1, 0], "a count of 0; leave out words that were not seen"),
        counts("a count of 65,536", vec![5], vec![65_536], "the most that one frame can show is 65535"),
        counts("the largest count", vec![5], vec![u32::MAX], "the most that one frame can show is 65535"),
        counts("a word out of range", vec![1, foreign], vec![], "quantize with the map's own model"),
        counts("the largest word", vec![u32::MAX], vec![], "quantize with the map's own model"),
        counts("70,000 words", (0..70_000).collect(), vec![], "at most 65536 words, not 70000"),
        list("a listed word out of range", |w| w.words[1] = foreign, "quantize with the map's own model"),
        list("no x", |w| w.x_px.clear(), "x_px has 0 values for 3 words; send one a word"),
        list("an x too few", |w| w.x_px.truncate(2), "x_px has 2 values for 3 words"),
        list("an x too many", |w| w.x_px.push(1.0), "x_px has 4 values for 3 words"),
        list("x NaN", |w| w.x_px[1] = f32::NAN, "x_px has the value NaN, which is not from -1 to 640"),
        list("x infinite", |w| w.x_px[0] = f32::INFINITY, "x_px has the value inf"),
        list("x left of the image", |w| w.x_px[0] = -2.0, "which is not from -1 to 640"),
        list("x right of the image", |w| w.x_px[0] = 641.0, "which is not from -1 to 640"),
        list("no y", |w| w.y_px.clear(), "y_px has 0 values for 3 words; send one a word"),
        list("y NaN", |w| w.y_px[2] = f32::NAN, "y_px has the value NaN, which is not from -1 to 360"),
        list("y infinite", |w| w.y_px[2] = f32::NEG_INFINITY, "y_px has the value -inf"),
        list("y below the image", |w| w.y_px[2] = 400.0, "which is not from -1 to 360"),
        list("points without words", |w| w.words.clear(), "x_px has 3 values for 0 words"),
        list("a size too few", |w| w.size_px.truncate(2), "send one a word, or none"),
        list("size negative", |w| w.size_px = all(-1.0), "size_px has the value -1, which is not from 0"),
        list("size NaN", |w| w.size_px = all(f32::NAN), "size_px has the value NaN"),
        list("size infinite", |w| w.size_px = all(f32::INFINITY), "size_px has the value inf"),
        list("an angle too many", |w| w.angle_rad.push(0.0), "send one a word, or none"),
        list("angle in degrees", |w| w.angle_rad = all(270.0), "angle_rad has the value 270"),
        list("angle NaN", |w| w.angle_rad = all(f32::NAN), "angle_rad has the value NaN"),
        list("no image size", |w| w.image_width_px = 0, "send the size of the image that the points are in"),
        list("no image height", |w| w.image_height_px = 0, "a height of 0 px; send the size of the image"),
        list("image too wide", |w| w.image_width_px = 65_536, "a width of 65536 px"),
        list("image height of all", |w| w.image_height_px = u32::MAX, "send the size of the image"),
        list(
            "70,000 features",
            |w| {
                (w.x_px, w.y_px) = (vec![1.0; many.len()], vec![1.0; many.len()]);
                (w.size_px, w.angle_rad) = (Vec::new(), Vec::new());
                w.words = many;
            },
            "at most 65536 words, not 70000; send the strongest features",
        ),
    ]
}
