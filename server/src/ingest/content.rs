//! What a robot saw: pixels, or words that it made of them itself.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use fabmap::observation::{Observation, WordId};
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::Keypoint;
use waypost_vision::image::MAX_SIDE_PX;

use super::extraction::Extraction;
use super::model::LoadedModel;
use super::observed::Observed;
use super::panoramic::PanoramicOptics;
use crate::error::ServiceError;
use crate::map_settings::Keep;
use crate::storage::{Medium, MediumKind};

/// A frame's content as it came.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Content {
    /// A JPEG or PNG.
    Image(Bytes),
    /// Words with how often each was seen.
    Histogram {
        words: Vec<WordId>,
        /// One for each word, or none: then each was seen once.
        counts: Vec<u32>,
    },
    /// A word for each feature.
    Words(WordList),
    /// Features whose words are to be those of another model; robots do not send them.
    Described(Described),
}

/// Features that were described before.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Described {
    /// With descriptors such as the model's words are made of.
    pub(crate) features: Arc<FeatureRecord>,
    pub(crate) thumbnail: Option<Vec<u8>>,
}

/// The features of an image; position i of each list is feature i.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct WordList {
    pub(crate) words: Vec<WordId>,
    pub(crate) x_px: Vec<f32>,
    pub(crate) y_px: Vec<f32>,
    /// Empty if not known.
    pub(crate) size_px: Vec<f32>,
    /// Empty if not known.
    pub(crate) angle_rad: Vec<f32>,
    pub(crate) image_width_px: u32,
    pub(crate) image_height_px: u32,
}

impl WordList {
    /// Features as a robot sends them that keeps descriptors to itself.
    pub(crate) fn of(features: &FeatureRecord) -> Self {
        let (image_width_px, image_height_px) = features.image_size_px();
        let each = |value: fn(&Keypoint) -> f32| features.keypoints().iter().map(value).collect();
        Self {
            words: features.words().to_vec(),
            x_px: each(|keypoint| keypoint.x_px),
            y_px: each(|keypoint| keypoint.y_px),
            size_px: each(|keypoint| keypoint.size_px),
            angle_rad: each(|keypoint| keypoint.angle_rad),
            image_width_px,
            image_height_px,
        }
    }
}

/// Words, or features, of one frame at most.
const MAX_WORDS: usize = 65_536;

/// How often a word can be seen in one frame at most.
const MAX_COUNT: u32 = 65_535;

/// What sender of words must have said: which words they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Words {
    /// They are the model's: the hashes agree.
    Declared,
    Undeclared,
}

impl Words {
    /// Whether the words of `words_hash` are those of a model; an empty hash declares nothing.
    pub(crate) fn declared(words_hash: &str, model: &LoadedModel) -> Result<Self, ServiceError> {
        if words_hash.is_empty() {
            return Ok(Words::Undeclared);
        }
        if words_hash.eq_ignore_ascii_case(&model.words_hash) {
            return Ok(Words::Declared);
        }
        Err(ServiceError::precondition(format_args!(
            "the words with hash {words_hash} are not those of the map's model models/{}, whose words_hash is {}; \
             download that model and make the words with it",
            model.hash, model.words_hash
        )))
    }
}

impl Extraction {
    /// What a frame's content shows, and what is to be kept of it. `optics` are those of a camera that sees all around;
    /// `stream` is what it came by; a query comes by none.
    pub(crate) async fn observe(
        &self,
        model: Arc<LoadedModel>,
        content: Content,
        words: Words,
        keep: Keep,
        optics: Option<PanoramicOptics>,
        stream: Option<u64>,
    ) -> Result<Observed, ServiceError> {
        if let (Content::Histogram { .. } | Content::Words(_), Words::Undeclared) = (&content, words) {
            return Err(ServiceError::invalid(
                "words were sent, but not which: give the words_hash of the model that they were made with",
            ));
        }
        match content {
            Content::Image(image) => self.observe_image(model, image, keep, optics, stream).await,
            Content::Histogram { words, counts } => {
                off_the_async_threads(move || histogram(&model, words, counts)).await
            }
            Content::Words(list) => off_the_async_threads(move || word_list(&model, list, keep)).await,
            Content::Described(described) => {
                off_the_async_threads(move || described_anew(&model, &described, keep)).await
            }
        }
    }
}

/// Sorting tens of thousands of words takes milliseconds.
async fn off_the_async_threads(
    check: impl FnOnce() -> Result<Checked, ServiceError> + Send + 'static,
) -> Result<Observed, ServiceError> {
    let start = Instant::now();
    let checked = tokio::task::spawn_blocking(check).await.map_err(ServiceError::internal)?;
    let Checked { observation, features, media } = checked?;
    let features = features.map(Arc::new);
    let quantize = start.elapsed();
    Ok(Observed { observation, features, media, extract: Duration::ZERO, quantize })
}

/// Words that are fit to be taken.
struct Checked {
    observation: Observation,
    /// None if the robot did not say where the words are.
    features: Option<FeatureRecord>,
    media: Vec<Medium>,
}

fn histogram(model: &LoadedModel, words: Vec<WordId>, counts: Vec<u32>) -> Result<Checked, ServiceError> {
    at_most(words.len())?;
    if !counts.is_empty() && counts.len() != words.len() {
        return Err(ServiceError::invalid(format_args!(
            "the histogram has {} words and {} counts; send one count a word, or none if each was seen once",
            words.len(),
            counts.len()
        )));
    }
    if let Some(count) = counts.iter().find(|&&count| count > MAX_COUNT) {
        return Err(ServiceError::invalid(format_args!(
            "a word was counted {count} times; the most that one frame can show is {MAX_COUNT}"
        )));
    }
    let counts = counts.into_iter().chain(std::iter::repeat(1));
    let observation =
        Observation::from_word_counts(words.into_iter().zip(counts), model.model.vocabulary().len());
    let observation = observation.map_err(ServiceError::invalid)?;
    Ok(Checked { observation, features: None, media: Vec::new() })
}

fn word_list(model: &LoadedModel, list: WordList, keep: Keep) -> Result<Checked, ServiceError> {
    let WordList { words, x_px, y_px, size_px, angle_rad, image_width_px, image_height_px } = list;
    at_most(words.len())?;
    for (what, side_px) in [("width", image_width_px), ("height", image_height_px)] {
        if !(1..=MAX_SIDE_PX).contains(&side_px) {
            return Err(ServiceError::invalid(format_args!(
                "the words' image has a {what} of {side_px} px; send the size of the image that the points are in"
            )));
        }
    }
    let (width_px, height_px) = (image_width_px as f32, image_height_px as f32);
    // Subpixel positions reach half a pixel beyond the outermost centres; a robot may count corners.
    check_values("x_px", &x_px, words.len(), Needed::Yes, -1.0..=width_px)?;
    check_values("y_px", &y_px, words.len(), Needed::Yes, -1.0..=height_px)?;
    check_values("size_px", &size_px, words.len(), Needed::No, 0.0..=MAX_SIDE_PX as f32)?;
    let turn = std::f32::consts::TAU;
    check_values("angle_rad", &angle_rad, words.len(), Needed::No, -turn..=turn)?;
    let observation = Observation::from_words(words.iter().copied(), model.model.vocabulary().len());
    let observation = observation.map_err(ServiceError::invalid)?;
    let value = |values: &[f32], index: usize| values.get(index).copied().unwrap_or_default();
    let keypoints = (0..words.len()).map(|index| Keypoint {
        x_px: x_px[index],
        y_px: y_px[index],
        size_px: value(&size_px, index),
        angle_rad: value(&angle_rad, index),
        response: 0.0,
    });
    let features = FeatureRecord::new((image_width_px, image_height_px), keypoints.collect(), words, None);
    let features = features.map_err(ServiceError::internal)?;
    let kept = (keep >= Keep::Features).then(|| features.to_bytes());
    let media = kept.map(|content| Medium { kind: MediumKind::Features, content }).into_iter().collect();
    Ok(Checked { observation, features: Some(features), media })
}

/// The same features with words of another model.
fn described_anew(model: &LoadedModel, described: &Described, keep: Keep) -> Result<Checked, ServiceError> {
    let Described { features, thumbnail } = described;
    let descriptors = features.descriptors().ok_or_else(|| ServiceError::internal("no descriptors"))?;
    let words = model.model.vocabulary().words(descriptors).map_err(ServiceError::internal)?;
    let observation = Observation::from_words(words.iter().copied(), model.model.vocabulary().len());
    let observation = observation.map_err(ServiceError::internal)?;
    let size_px = features.image_size_px();
    let keypoints = features.keypoints().to_vec();
    let features = FeatureRecord::new(size_px, keypoints, words, Some(descriptors.clone()));
    let features = features.map_err(ServiceError::internal)?;
    let mut media = Vec::new();
    if keep >= Keep::Features {
        media.push(Medium { kind: MediumKind::Features, content: features.to_bytes() });
        let thumbnail = thumbnail.clone().map(|content| Medium { kind: MediumKind::Thumbnail, content });
        media.extend(thumbnail);
    }
    Ok(Checked { observation, features: Some(features), media })
}

fn at_most(words: usize) -> Result<(), ServiceError> {
    if words <= MAX_WORDS {
        return Ok(());
    }
    Err(ServiceError::invalid(format_args!(
        "a frame has at most {MAX_WORDS} words, not {words}; send the strongest features"
    )))
}

#[derive(Clone, Copy, PartialEq)]
enum Needed {
    Yes,
    No,
}

fn check_values(
    name: &str,
    values: &[f32],
    words: usize,
    needed: Needed,
    range: std::ops::RangeInclusive<f32>,
) -> Result<(), ServiceError> {
    if values.is_empty() && needed == Needed::No {
        return Ok(());
    }
    if values.len() != words {
        let or_none = if needed == Needed::No { ", or none" } else { "" };
        return Err(ServiceError::invalid(format_args!(
            "the words' {name} has {} values for {words} words; send one a word{or_none}",
            values.len()
        )));
    }
    match values.iter().find(|value| !range.contains(value)) {
        None => Ok(()),
        Some(value) => Err(ServiceError::invalid(format_args!(
            "the words' {name} has the value {value}, which is not from {} to {}",
            range.start(),
            range.end()
        ))),
    }
}
