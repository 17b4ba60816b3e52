//! Real images without odometry: a building that was walked through twice, each time mapped by itself.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use fabmap::model::Model;
use fabmap::observation::Observation;
use serde::Serialize;
use topomap::event::FrameId;
use topomap::mapper::{ArchiveError, Mapper, MapperSettings};
use topomap::merging::{
    KnownMap, Layout, MergePlan, MergeSettings, Verdict, ViewsBetween, find_matches, join, judge,
};
use topomap::verification::TwoView;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::features::{Extractor, Features};
use waypost_vision::verification::{Verifier, View};

use crate::dataset::{DatasetError, image_files};
use crate::error::EvalError;
use crate::ranking::{FabMap, Ranking};
use crate::timing::FrameWatch;
use crate::{files, progress};

/// What to merge, and with what.
#[derive(Clone, Debug, PartialEq)]
pub struct PassesOptions {
    /// Folder with `images/` and `index.csv`.
    pub folder: PathBuf,
    /// The model file.
    pub model: PathBuf,
    /// Seed of the random choices.
    pub seed: u64,
    /// What a merge has to show.
    pub merge: MergeSettings,
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PassesReport {
    /// The floors.
    pub floors: Vec<String>,
    /// Both passes, each as one map.
    pub whole: Meeting,
    /// Of the places that were fused then, how many are of each floor of the first pass, by the floor of the second.
    pub fused: Vec<Vec<usize>>,
    /// Every floor of the second pass with every floor of the first.
    pub by_floor: Vec<Meeting>,
    /// Floors that joined another's map.
    pub false_merges: usize,
    /// Floors that did not join their own.
    pub missed_overlaps: usize,
}

/// What was said of two maps.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Meeting {
    /// Floor of the second pass; `None` for all.
    pub source: Option<String>,
    /// Floor of the first.
    pub target: Option<String>,
    /// Places of both.
    pub places: [usize; 2],
    /// Places that were fused; none if the maps stayed apart.
    pub fused: usize,
    /// Those that are of different floors.
    pub false_fused: usize,
    /// Places of the map that both became.
    pub joined_places: usize,
    /// Why, or by what.
    pub said: String,
    /// From two maps to one.
    pub seconds: f64,
}

/// A frame of the sequence.
#[derive(Clone, Debug)]
struct Frame {
    pass: u32,
    floor: String,
    image: PathBuf,
}

/// What was seen of one.
#[derive(Clone)]
struct Seen {
    observation: Observation,
    features: FeatureRecord,
}

/// The map of some frames.
struct PassMap {
    fab_map: FabMap,
    /// By index in the map's own sequence.
    floors: Vec<String>,
}

/// Maps, merges, and counts the floors.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &PassesOptions) -> Result<PassesReport, EvalError> {
    let (model, extractor) = files::read_model(&options.model)?;
    let frames = frames(&options.folder)?;
    let bar = progress::bar("frames", frames.len());
    let seen = |frame: &Frame| {
        bar.inc(1);
        observe(&frame.image, &model, extractor, options)
    };
    let seen: Vec<Seen> = frames.iter().map(seen).collect::<Result<_, EvalError>>()?;
    bar.finish_and_clear();
    let floors: Vec<String> =
        frames.iter().map(|frame| frame.floor.clone()).collect::<BTreeSet<_>>().into_iter().collect();
    let map = |pass: u32, floor: Option<&String>| {
        let is_of = |frame: &Frame| frame.pass == pass && floor.is_none_or(|floor| frame.floor == *floor);
        let of_map = frames.iter().zip(&seen).filter(|(frame, _)| is_of(frame));
        PassMap::of(of_map, &model, options.seed)
    };
    let (whole, plan) = meet(&map(2, None)?, &map(1, None)?, options)?;
    let mut fused = vec![vec![0; floors.len()]; floors.len()];
    let number = |floor: &str| floors.iter().position(|other| other == floor).unwrap_or(0);
    for (source, target) in plan {
        fused[number(&source)][number(&target)] += 1;
    }
    let mut by_floor = Vec::new();
    for source_floor in &floors {
        for target_floor in &floors {
            let maps = (map(2, Some(source_floor))?, map(1, Some(target_floor))?);
            let (meeting, _) = meet(&maps.0, &maps.1, options)?;
            let (source, target) = (Some(source_floor.clone()), Some(target_floor.clone()));
            by_floor.push(Meeting { source, target, ..meeting });
        }
    }
    let count = |of: fn(&Meeting) -> bool| by_floor.iter().filter(|meeting| of(meeting)).count();
    let report = PassesReport {
        false_merges: count(|meeting| meeting.fused > 0 && meeting.source != meeting.target),
        missed_overlaps: count(|meeting| meeting.fused == 0 && meeting.source == meeting.target),
        floors,
        whole,
        fused,
        by_floor,
    };
    eprint!("{}", report.table());
    Ok(report)
}

/// What `index.csv` says of the images, in their order.
fn frames(folder: &Path) -> Result<Vec<Frame>, EvalError> {
    let images = image_files(folder)?;
    let path = folder.join("index.csv");
    let text = files::read(&path)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let not_csv = |error: csv::Error| DatasetError::Line {
        path: path.clone(),
        line: error.position().map_or(1, csv::Position::line),
        reason: error.to_string(),
    };
    let header = reader.headers().map_err(not_csv)?.clone();
    let column = |name: &'static str| {
        let position = header.iter().position(|column| column == name);
        position.ok_or(DatasetError::Header { path: path.clone(), column: name })
    };
    let (pass, floor) = (column("pass")?, column("floor")?);
    let mut frames = Vec::new();
    for (record, image) in reader.records().zip(images) {
        let record = record.map_err(not_csv)?;
        let text = record.get(pass).unwrap_or_default();
        let pass = text.parse().map_err(|_| DatasetError::Line {
            path: path.clone(),
            line: frames.len() as u64 + 2,
            reason: format!("\"{text}\" is no pass"),
        })?;
        frames.push(Frame { pass, floor: record.get(floor).unwrap_or_default().to_owned(), image });
    }
    Ok(frames)
}

fn observe(
    path: &Path,
    model: &Model,
    extractor: Extractor,
    options: &PassesOptions,
) -> Result<Seen, EvalError> {
    let encoded = files::read(path)?;
    let (image, Features { keypoints, descriptors }) = extractor
        .extract_encoded(&encoded)
        .map_err(|reason| EvalError::Image { path: path.to_owned(), reason })?;
    let words = model
        .vocabulary()
        .words(&descriptors)
        .map_err(|reason| EvalError::ForeignVocabulary { path: options.model.clone(), reason })?;
    let observation = Observation::from_words(words.iter().copied(), model.vocabulary().len())
        .unwrap_or_else(|_| unreachable!("a vocabulary's own words"));
    let size_px = (image.width(), image.height());
    let features = FeatureRecord::new(size_px, keypoints, words, Some(descriptors))
        .unwrap_or_else(|_| unreachable!("a keypoint, a word and a descriptor for each feature"));
    Ok(Seen { observation, features })
}

/// What comes of two maps, and the floors of all places that were fused.
fn meet(
    source: &PassMap,
    target: &PassMap,
    options: &PassesOptions,
) -> Result<(Meeting, Vec<(String, String)>), EvalError> {
    let verifier = Verifier::new(MapperSettings::default().verification, options.seed);
    let views = Between { source, target, verifier };
    let began = Instant::now();
    let matches = find_matches(source.known(), target.known(), &views, &options.merge, &())?;
    let verdict = judge(source.layout(), target.layout(), &matches, &options.merge);
    let places = [source, target].map(|map| map.mapper().map().places().len());
    let mut meeting = Meeting {
        source: None,
        target: None,
        places,
        fused: 0,
        false_fused: 0,
        joined_places: 0,
        said: String::new(),
        seconds: 0.0,
    };
    let mut floors = Vec::new();
    match verdict {
        Verdict::Overlap(plan) => {
            let joined = target.joined_by(source, &plan)?;
            floors = plan
                .fused
                .iter()
                .map(|fused| (source.floor(fused.matched.source), target.floor(fused.matched.target)))
                .collect();
            meeting.fused = plan.fused.len();
            meeting.false_fused = floors.iter().filter(|(source, target)| source != target).count();
            meeting.joined_places = joined.map().places().len();
            meeting.said = format!(
                "{} of {} matches, rival {}, {} of {} places confirmed",
                plan.matches.len(),
                matches.len(),
                plan.rival_support,
                plan.overlap.confirmed,
                plan.overlap.places
            );
        }
        Verdict::Apart(apart) => meeting.said = apart.to_string(),
    }
    meeting.seconds = began.elapsed().as_secs_f64();
    Ok((meeting, floors))
}

impl PassMap {
    fn of<'a>(
        frames: impl Iterator<Item = (&'a Frame, &'a Seen)>,
        model: &Model,
        seed: u64,
    ) -> Result<Self, EvalError> {
        let mut fab_map = FabMap::new(model, MapperSettings::default(), seed)?;
        let mut floors = Vec::new();
        for (index, (frame, seen)) in frames.enumerate() {
            let Seen { observation, features } = seen.clone();
            let mut watch = FrameWatch::start();
            watch.extracted();
            watch.quantized();
            fab_map.rank(index, observation, features, watch)?;
            floors.push(frame.floor.clone());
        }
        Ok(Self { fab_map, floors })
    }

    fn mapper(&self) -> &Mapper {
        self.fab_map.mapper()
    }

    fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: self.mapper(), archive: self.fab_map.log() }
    }

    fn layout(&self) -> Layout<'_> {
        let settings = self.mapper().settings();
        Layout {
            poses: self.mapper().poses(),
            noise: settings.odometry_noise,
            spacing: settings.place_spacing,
        }
    }

    fn joined_by(&self, source: &PassMap, plan: &MergePlan) -> Result<Mapper, EvalError> {
        let mut joined = self.mapper().clone();
        let events =
            join((source.mapper(), self.mapper()), plan, &source.fab_map.log().0).map_err(EvalError::Join)?;
        for (index, event) in events.iter().enumerate() {
            joined.fold(event).map_err(|reason| EvalError::Fold { index, reason })?;
        }
        Ok(joined)
    }

    /// The floor of the frame that made a place.
    fn floor(&self, place: u32) -> String {
        let made = self.mapper().map().places().get(place as usize).and_then(|place| place.frames.first());
        let index = made.and_then(|made| self.index(made.frame));
        index.and_then(|index| self.floors.get(index)).cloned().unwrap_or_default()
    }

    fn index(&self, frame: FrameId) -> Option<usize> {
        usize::try_from(self.fab_map.log().frame(frame)?.sequence).ok()
    }

    fn features(&self, frame: FrameId) -> Result<&FeatureRecord, ArchiveError> {
        let features = self.index(frame).and_then(|index| self.fab_map.features().get(index));
        features.ok_or_else(|| ArchiveError { frame, why: "it is not in the log".to_owned() })
    }
}

/// Frames of two maps, side by side.
struct Between<'a> {
    source: &'a PassMap,
    target: &'a PassMap,
    verifier: Verifier,
}

impl ViewsBetween for Between<'_> {
    fn compare(&self, source: FrameId, target: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        let (current, earlier) = (self.source.features(source)?, self.target.features(target)?);
        let view = |features| View { features, camera: None };
        Ok(Some(self.verifier.compare(view(earlier), view(current))))
    }

    fn focal_length_widths(&self, _source: FrameId) -> Option<f64> {
        None
    }
}

impl PassesReport {
    fn table(&self) -> String {
        let Meeting { places, fused, false_fused, joined_places, said, seconds, .. } = &self.whole;
        let mut table = format!(
            "both passes: {} and {} places became {joined_places}, {fused} fused, {false_fused} of different floors; {said}; {seconds:.1} s\n",
            places[0], places[1]
        );
        for (floor, row) in self.floors.iter().zip(&self.fused) {
            table += &format!("  {floor}: {row:?}\n");
        }
        for meeting in &self.by_floor {
            let [source, target] =
                [&meeting.source, &meeting.target].map(|floor| floor.as_deref().unwrap_or("all"));
            table += &format!("{source} with {target}: {} fused; {}\n", meeting.fused, meeting.said);
        }
        table + &format!("{} false merges, {} overlaps missed\n", self.false_merges, self.missed_overlaps)
    }
}
