//! What two images have in common: features, words, matches, and the motion between them.
//!
//! `cargo run --release -p waypost-vision --example two_views -- earlier.jpg current.jpg`

use std::error::Error;
use std::ops::ControlFlow;

use fabmap::{Vocabulary, VocabularySettings};
use waypost_vision::{
    Extractor, FeatureRecord, FeatureSettings, Features, GreyImage, VerificationSettings, Verifier, View,
};

/// Words of a vocabulary that is trained on the first image alone; real ones have thousands.
const WORDS: u32 = 50;

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [earlier, current] = paths.as_slice() else {
        return Err("give two images: two_views earlier.jpg current.jpg".into());
    };

    // JPEG or PNG; the bytes are checked before anything is believed.
    let extractor = Extractor::new(FeatureSettings::default());
    let (earlier_image, earlier_features) = extractor.extract_encoded(&std::fs::read(earlier)?)?;
    let (current_image, current_features) = extractor.extract_encoded(&std::fs::read(current)?)?;
    println!("{earlier}: {earlier_image:?}, {} features", earlier_features.keypoints.len());
    println!("{current}: {current_image:?}, {} features", current_features.keypoints.len());

    // Words are what places are recognised by.
    let settings = VocabularySettings { words: WORDS, ..VocabularySettings::default() };
    let go_on = &mut |_| ControlFlow::Continue(());
    let vocabulary = Vocabulary::train(&earlier_features.descriptors, &settings, go_on)?;
    let seen_before = vocabulary.observe(&earlier_features.descriptors)?;
    let seen_now = vocabulary.observe(&current_features.descriptors)?;
    let in_common = seen_now.words().iter().filter(|&&word| seen_before.contains(word)).count();
    println!("words in common: {in_common} of {WORDS}");

    // Geometry tells whether the features also lie as one motion would have them.
    let earlier = record(&vocabulary, &earlier_image, earlier_features)?;
    let current = record(&vocabulary, &current_image, current_features)?;
    let verifier = Verifier::new(VerificationSettings::default(), 0);
    let found = verifier
        .compare(View { features: &earlier, camera: None }, View { features: &current, camera: None });
    println!("{} of {} matches agree with one motion: {:?}", found.inliers, found.matches, found.motion);
    Ok(())
}

fn record(
    vocabulary: &Vocabulary,
    image: &GreyImage,
    features: Features,
) -> Result<FeatureRecord, Box<dyn Error>> {
    let words = vocabulary.words(&features.descriptors)?;
    let size_px = (image.width(), image.height());
    Ok(FeatureRecord::new(size_px, features.keypoints, words, Some(features.descriptors))?)
}
