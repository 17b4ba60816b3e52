//! Drives with pixels are decided as they were when the golden files were written, bit for bit.

#[path = "../../../topomap/tests/transcript.rs"]
mod transcript;

use std::path::PathBuf;

use fabmap::model::Model;
use fabmap::observation::Observation;
use topomap::evidence::{TwoView, VerificationMethod, VerificationSettings};
use topomap::ids::FrameId;
use topomap::in_memory::{self, Views};
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{FrameInput, Mapper};
use topomap::metric::Odometry;
use topomap::settings::{MapperSettings, PlaceRule};
use waypost_sim::drive::{Building, FIELD_OF_VIEW_RAD};
use waypost_sim::robot::WheelErrors;
use waypost_sim::simulation::CameraFrame;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};
use waypost_vision::structure::RobotCamera;
use waypost_vision::verification::{Pinhole, Verifier, View};

use crate::harness::{Reference, building, driven, model_file, reference, reference_by_words};

/// Decides all frames of a drive, and writes down what was decided.
type Drive = fn() -> String;

/// Golden file and the drive whose decisions it has.
const DRIVES: [(&str, Drive); 4] = [
    ("shipped", || shipped(reference())),
    ("shipped-by-words", || shipped(reference_by_words())),
    ("shipped-each-frame", each_frame),
    ("office", office),
];

fn file(name: &str) -> PathBuf {
    PathBuf::from(format!("{}/tests/robots/golden/{name}.txt", env!("CARGO_MANIFEST_DIR")))
}

#[test]
fn drives_with_pixels_are_decided_as_before() {
    for (name, drive) in DRIVES {
        transcript::check(&file(name), &drive());
    }
}

#[test]
#[ignore = "writes what is decided now as what is to be decided"]
fn write_golden() {
    for (name, drive) in DRIVES {
        std::fs::write(file(name), drive()).unwrap();
    }
}

/// The shipped drive, a robot that localizes in its first half, and queries.
fn shipped(reference: &Reference) -> String {
    let half = reference.events.len() as u64 / 2;
    let mut text = transcript::of_log(reference.model(), reference.settings(), reference.log());
    text += &transcript::of_frames(&reference.localized([(half, 1..=half)]));
    for sequence in [1, half / 2, half, 2 * half] {
        text += &transcript::of_query(&reference.queried(half, sequence));
    }
    text
}

fn each_frame() -> String {
    let settings = MapperSettings { place_rule: PlaceRule::EachFrame, ..MapperSettings::default() };
    let reference = Reference::of(settings);
    transcript::of_log(reference.model(), settings, reference.log())
}

/// A robot with wheels that drives through the simulated office, and its camera.
fn office() -> String {
    let building = building(NamedWorld::Office, 1, NamedWorld::Office.routes()[0].name);
    let recording = driven(&building, WheelErrors::drawn(1), 1);
    let frames: Vec<&CameraFrame> = recording.frames().collect();
    let model = Model::from_bytes(&std::fs::read(model_file()).unwrap()).unwrap();
    let (first, second) = frames.split_at(frames.len() / 2);
    let seen = std::thread::scope(|scope| {
        let first =
            scope.spawn(|| first.iter().map(|frame| seen(&building, &model, frame)).collect::<Vec<_>>());
        let second: Vec<_> = second.iter().map(|frame| seen(&building, &model, frame)).collect();
        [first.join().unwrap(), second].concat()
    });
    let similarity = mapped(&model, MapperSettings::default(), &frames, &seen);
    let method = VerificationMethod::Epipolar;
    let verification = VerificationSettings { method, ..VerificationSettings::default() };
    let settings = MapperSettings { verification, ..MapperSettings::default() };
    similarity + &mapped(&model, settings, &frames, &seen)
}

/// What the drive comes to in a map with such settings.
fn mapped(
    model: &Model,
    settings: MapperSettings,
    frames: &[&CameraFrame],
    seen: &[(Observation, FeatureRecord)],
) -> String {
    let mut mapper = Mapper::new(model, settings).unwrap();
    let opened = MapEvent::SessionOpened { session: 0 };
    mapper.apply(&opened).unwrap();
    let mut log = vec![opened];
    for (sequence, (frame, (observation, current))) in (1..).zip(frames.iter().zip(seen)) {
        let (position_m, orientation) = frame.odometry.position_and_orientation();
        let odometry =
            Odometry::new(position_m, orientation, Some(&frame.odometry.covariance_6x6())).unwrap();
        let input = FrameInput {
            session: 0,
            sequence,
            stamp_ns: frame.stamp_ns + 1,
            odometry: Some(odometry),
            observation: observation.clone(),
        };
        let verifier = Verifier::new(settings.verification, 0);
        let view = Office { log: &log, seen, current, verifier };
        let decided = in_memory::decide(&mapper, &log, input, &view, &mut ()).unwrap();
        let event = MapEvent::Frame(Box::new(decided.event));
        mapper.apply(&event).unwrap();
        log.push(event);
    }
    transcript::of_log(model, settings, &log)
}

fn seen(building: &Building, model: &Model, frame: &CameraFrame) -> (Observation, FeatureRecord) {
    let image = building.image(&frame.shot).to_png().unwrap();
    let extractor = Extractor::new(model.extractor().parse().unwrap());
    let (image, Features { keypoints, descriptors }) = extractor.extract_encoded(&image).unwrap();
    let words = model.vocabulary().words(&descriptors).unwrap();
    let observation = Observation::from_words(words.iter().copied(), model.vocabulary().len()).unwrap();
    let size_px = (image.width(), image.height());
    (observation, FeatureRecord::new(size_px, keypoints, words, Some(descriptors)).unwrap())
}

/// A frame of the office beside those before it.
struct Office<'a> {
    log: &'a [MapEvent],
    seen: &'a [(Observation, FeatureRecord)],
    current: &'a FeatureRecord,
    verifier: Verifier,
}

impl Office<'_> {
    fn camera(&self) -> RobotCamera {
        RobotCamera::ahead(Pinhole::of_field_of_view(FIELD_OF_VIEW_RAD, self.current.image_size_px()))
    }

    fn event(&self, frame: FrameId) -> &FrameEvent {
        match &self.log[frame as usize] {
            MapEvent::Frame(event) => event,
            MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => {
                panic!("{frame} is no frame")
            }
        }
    }
}

impl Views for Office<'_> {
    fn compare(&self, earlier: FrameId) -> Option<TwoView> {
        let view = |features| View { features, camera: Some(self.camera()) };
        let earlier = &self.seen[self.event(earlier).sequence as usize - 1].1;
        Some(self.verifier.compare(view(earlier), view(self.current)))
    }

    fn focal_length_widths(&self) -> Option<f64> {
        Some(self.camera().pinhole.focal_length_widths(self.current.image_size_px().0))
    }
}
