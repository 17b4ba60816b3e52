//! The frames of the shipped drive as a robot sends them that makes its words itself.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

use waypost_client::words::WordMaker;
use waypost_client::{Client, FrameContent, FrameInput, SessionOptions, v1};

use super::{answers_of, frame, model_file, reference, session_options};

static WORD_MAKER: LazyLock<WordMaker> =
    LazyLock::new(|| WordMaker::new(&std::fs::read(model_file()).unwrap()).unwrap());

/// Words by image, of those that a test has asked for: to make them is what takes the time of most tests.
static WORDS: LazyLock<Mutex<HashMap<Vec<u8>, v1::WordList>>> = LazyLock::new(Mutex::default);

/// Makes words by the shipped model.
pub(crate) fn word_maker() -> &'static WordMaker {
    &WORD_MAKER
}

/// The frame numbered `sequence` as a list of words with keypoints, made as a robot would.
pub(crate) fn as_words(sequence: u64) -> FrameInput {
    in_words(frame(sequence))
}

/// A frame with the words of its image in place of the image.
pub(crate) fn in_words(frame: FrameInput) -> FrameInput {
    let FrameContent::Image(image) = frame.content else { panic!("not an image: {frame:?}") };
    let known = WORDS.lock().unwrap().get(&image).cloned();
    let words = known.unwrap_or_else(|| {
        let made = word_maker().words(&image).unwrap();
        WORDS.lock().unwrap().insert(image, made.clone());
        made
    });
    FrameInput { content: FrameContent::Words(words), ..frame }
}

/// The frame numbered `sequence` as counts of words: cheap, for its words are known in process.
pub(crate) fn as_histogram(sequence: u64) -> FrameInput {
    FrameInput { content: FrameContent::Histogram(histogram(sequence)), ..frame(sequence) }
}

pub(crate) fn histogram(sequence: u64) -> v1::WordHistogram {
    let (words, counts) = reference().events[sequence as usize - 1].observation.histogram();
    v1::WordHistogram { words, counts }
}

/// A session of that name that may send words.
pub(crate) fn words_options(map: &str, session: &str) -> SessionOptions {
    SessionOptions { words_hash: word_maker().words_hash().to_owned(), ..session_options(map, session) }
}

/// Maps frames of the drive, as histograms, in one session that takes them all.
pub(crate) async fn mapped(
    client: &Client,
    session: &str,
    sequences: impl IntoIterator<Item = u64>,
) -> Vec<v1::FrameAnswer> {
    answers_of(client, words_options("drive", session), sequences.into_iter().map(as_histogram)).await
}
