//! What look-alikes show, learnt from training images: of different places, in the order in which a
//! camera passed them.

use std::ops::ControlFlow;

use fabmap::baselines::TfIdf;
use fabmap::descriptor::Descriptors;
use fabmap::look_alikes::{LookAlikes, LookAlikesError};
use fabmap::model::{Model, ModelTrainingSettings};
use fabmap::vocabulary::VocabularyError;
use rayon::prelude::*;
use topomap::evidence::VerificationSettings;

use crate::feature_record::{FeatureRecord, UnevenFeatures};
use crate::features::Features;
use crate::verification::{Verifier, View};

/// The features of a training image.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingImage {
    /// Width and height, in pixels.
    pub size_px: (u32, u32),
    /// What it shows.
    pub features: Features,
}

impl AsRef<Descriptors> for TrainingImage {
    fn as_ref(&self) -> &Descriptors {
        &self.features.descriptors
    }
}

/// Why nothing was learnt of look-alikes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// There are too few images to tell kinds of places from each other.
    #[error("{images} training images are too few to learn look-alikes from; give at least {MIN_IMAGES}")]
    TooFew {
        /// Images given.
        images: usize,
    },
    /// Images beside each other show different places.
    #[error(
        "the training images are not in the order in which a camera took them, so that places seen twice \
         cannot be told from look-alikes; give image sequences"
    )]
    NoOrder,
    /// The features are not the model's.
    #[error(transparent)]
    Vocabulary(#[from] VocabularyError),
    /// Keypoints and descriptors are not of one image.
    #[error(transparent)]
    Uneven(#[from] UnevenFeatures),
    /// The images are not those that the model was trained on.
    #[error(transparent)]
    LookAlikes(#[from] LookAlikesError),
    /// The observer asked to stop.
    #[error("learning look-alikes was cancelled")]
    Cancelled,
}

/// Images from which kinds of places can be told from each other.
const MIN_IMAGES: usize = 100;

/// Images before and after an image that may show the same place.
const SAME_PLACE_IMAGES: usize = 30;

/// Images around one that show the same as it.
const ONE_VIEW_IMAGES: usize = 10;

/// An image that shows as large a share of what the next image shows was taken at the same place.
const REVISIT_SHARE: f64 = 0.8;

/// Median evidence of images beside each other, in inliers, below which they are in no order.
const LEAST_OF_NEIGHBOURS: f64 = 8.0;

/// The best look-alike counts as far as it is at most so many times the next one, of another place,
/// and a few inliers: one that stands alone may be the very place, seen again.
const MOST_OF_NEXT: f64 = 3.0;
const FEW_INLIERS: f64 = 4.0;

/// Images between two calls of the observer.
const CHUNK: usize = 32;

/// Learns from the images that `model` was trained on, all of them in order. `observer` is called
/// with the share that is done, and may cancel.
///
/// Each image of the sampling set is compared with the eight that resemble it most in words, as a
/// frame is with the places of a map; those around it are left out. Images that show nearly as much
/// of it as the one beside it does are taken for the same place.
///
/// # Errors
/// [`LearnError`].
pub fn learn(
    model: &Model,
    images: &[TrainingImage],
    observer: &mut dyn FnMut(f64) -> ControlFlow<()>,
) -> Result<LookAlikes, LearnError> {
    let sampled: Vec<usize> = ModelTrainingSettings::sampled(images.len()).collect();
    if sampled.len() < MIN_IMAGES {
        return Err(LearnError::TooFew { images: images.len() });
    }
    let gallery = Gallery::new(model, images, sampled)?;
    let mut found = Vec::with_capacity(gallery.records.len());
    let all: Vec<usize> = (0..gallery.records.len()).collect();
    for chunk in all.chunks(CHUNK) {
        found.par_extend(chunk.par_iter().map(|&image| gallery.look_alike(image)));
        if observer(found.len() as f64 / all.len() as f64).is_break() {
            return Err(LearnError::Cancelled);
        }
    }
    let mut of_neighbours: Vec<f64> = found.iter().map(|found| found.of_neighbours).collect();
    of_neighbours.sort_by(f64::total_cmp);
    if of_neighbours[of_neighbours.len() / 2] < LEAST_OF_NEIGHBOURS {
        return Err(LearnError::NoOrder);
    }
    let samples = model.sampling_set();
    let share = |(found, sample): (&Found, &fabmap::Observation)| {
        (found.look_alike / sample.len().max(1) as f64) as f32
    };
    let shares = found.iter().zip(samples).map(share).collect();
    Ok(LookAlikes::new(shares, samples, model.vocabulary().len())?)
}

/// The training images that a model samples.
struct Gallery<'a> {
    model: &'a Model,
    verifier: Verifier,
    words: TfIdf,
    records: Vec<FeatureRecord>,
    /// Their numbers among all training images.
    numbers: Vec<usize>,
}

/// What was found for one image, in inliers beyond chance.
struct Found {
    /// Of the best look-alike.
    look_alike: f64,
    /// Of the better of the two images beside it.
    of_neighbours: f64,
}

impl<'a> Gallery<'a> {
    fn new(model: &'a Model, images: &[TrainingImage], numbers: Vec<usize>) -> Result<Self, LearnError> {
        let record = |&number: &usize| {
            let TrainingImage { size_px, features: Features { keypoints, descriptors } } = &images[number];
            let words = model.vocabulary().words(descriptors)?;
            Ok(FeatureRecord::new(*size_px, keypoints.clone(), words, Some(descriptors.clone()))?)
        };
        let records = numbers.par_iter().map(record).collect::<Result<Vec<_>, LearnError>>()?;
        let mut words = TfIdf::new(model.sampling_set(), model.vocabulary().len());
        model.sampling_set().iter().for_each(|sample| words.add(sample));
        let verifier = Verifier::new(VerificationSettings::default(), 0);
        Ok(Self { model, verifier, words, records, numbers })
    }

    fn look_alike(&self, image: usize) -> Found {
        let beside = [image.checked_sub(1), Some(image + 1)].into_iter().flatten();
        let of_neighbours = beside
            .filter(|&neighbour| neighbour < self.records.len())
            .map(|neighbour| self.evidence(image, neighbour))
            .fold(0.0, f64::max);
        let is_revisit =
            |evidence: f64| of_neighbours >= LEAST_OF_NEIGHBOURS && evidence >= REVISIT_SHARE * of_neighbours;
        let mut others: Vec<(f64, usize)> = self
            .resembling(image)
            .into_iter()
            .map(|other| (self.evidence(image, other), self.numbers[other]))
            .filter(|&(evidence, _)| !is_revisit(evidence))
            .collect();
        others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let Some(&(best, number)) = others.first() else { return Found { look_alike: 0.0, of_neighbours } };
        let next = others.iter().find(|(_, other)| other.abs_diff(number) > ONE_VIEW_IMAGES);
        let next = next.map_or(0.0, |&(evidence, _)| evidence);
        Found { look_alike: best.min(MOST_OF_NEXT * next + FEW_INLIERS), of_neighbours }
    }

    /// As many as a frame is compared with, the most similar in words first.
    fn resembling(&self, image: usize) -> Vec<usize> {
        let similarities = self.words.similarities(&self.model.sampling_set()[image]);
        let mut others: Vec<(f64, usize)> = similarities.into_iter().zip(0..).collect();
        others.retain(|&(_, other)| self.numbers[other].abs_diff(self.numbers[image]) > SAME_PLACE_IMAGES);
        others.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        others.truncate(VerificationSettings::MAX_CANDIDATES);
        others.into_iter().map(|(_, other)| other).collect()
    }

    fn evidence(&self, image: usize, other: usize) -> f64 {
        let view = |image: usize| View { features: &self.records[image], camera: None };
        self.verifier.compare(view(other), view(image)).evidence()
    }
}

#[cfg(test)]
mod tests {
    use fabmap::model::ModelTrainingSettings;
    use fabmap::vocabulary::VocabularySettings;
    use fabmap::{DetectorModel, TreeTrainingSettings};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::features::Keypoint;

    const FEATURES: usize = 40;
    const VIEWS_OF_A_PLACE: usize = 3;

    /// Places passed in order, three images of each: place `p` shows features of its own, and
    /// `shared` features that its look-alike in the other half of the drive shows at the same spots.
    fn drive(places: u64, shared: usize) -> Vec<TrainingImage> {
        let feature = |seed: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let keypoint = Keypoint {
                x_px: random.random_range(20.0..300.0),
                y_px: random.random_range(20.0..220.0),
                size_px: 8.0,
                angle_rad: 0.0,
                response: 1.0,
            };
            (keypoint, (0..128).map(|_| random.random::<u8>()).collect::<Vec<u8>>())
        };
        let image = |place: u64| {
            let of_look_alikes = place % (places / 2);
            let seeds = (0..FEATURES as u64).map(|number| {
                let shown_by = if (number as usize) < shared { of_look_alikes } else { place + places };
                1_000 * shown_by + number
            });
            let (keypoints, rows): (Vec<_>, Vec<_>) = seeds.map(feature).unzip();
            let descriptors = Descriptors::new(fabmap::DescriptorKind::Float, 128, rows.concat()).unwrap();
            TrainingImage { size_px: (320, 240), features: Features { keypoints, descriptors } }
        };
        (0..places).flat_map(|place| vec![image(place); VIEWS_OF_A_PLACE]).collect()
    }

    fn learnt(images: &[TrainingImage]) -> Result<LookAlikes, LearnError> {
        let settings = ModelTrainingSettings {
            vocabulary: VocabularySettings { words: 200, ..VocabularySettings::default() },
            tree: TreeTrainingSettings::default(),
            detector: DetectorModel::default(),
        };
        let go_on = &mut |_| ControlFlow::Continue(());
        let model = Model::train("test", images, &settings, go_on).unwrap();
        learn(&model, images, &mut |_| ControlFlow::Continue(()))
    }

    fn median(look_alikes: &LookAlikes) -> f32 {
        let mut shares = look_alikes.shares().to_vec();
        shares.sort_by(f32::total_cmp);
        shares[shares.len() / 2]
    }

    #[test]
    fn look_alikes_count_by_what_they_share() {
        let unlike = learnt(&drive(40, 0)).unwrap();
        let alike = learnt(&drive(40, 16)).unwrap();
        assert_eq!(unlike.shares().len(), 40 * VIEWS_OF_A_PLACE);
        assert!(median(&unlike) < 0.05, "{unlike:?}");
        assert!(median(&alike) > 0.08, "{alike:?}");
    }

    /// Who drives a way twice sees the same places again: those are no look-alikes.
    #[test]
    fn places_seen_twice_are_no_look_alikes() {
        let again = learnt(&drive(40, FEATURES)).unwrap();
        assert!(median(&again) < 0.05, "{again:?}");
    }

    #[test]
    fn what_does_not_tell_is_refused() {
        assert_eq!(learnt(&drive(20, 0)).unwrap_err(), LearnError::TooFew { images: 60 });
        let ordered = drive(120, 0);
        let shuffled: Vec<_> = (0..360).map(|number| ordered[(number * 127) % 360].clone()).collect();
        assert_eq!(learnt(&shuffled).unwrap_err(), LearnError::NoOrder);
    }
}
