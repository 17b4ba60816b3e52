//! Real images without odometry: a building that was walked through twice, each time mapped by itself.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use fabmap::model::Model;
use rayon::prelude::*;
use serde::Serialize;
use topomap::ids::FrameId;
use topomap::mapper::Mapper;
use topomap::merging::{
    KnownMap, MergePlan, PairComparison, PlacePair, Verdict, find_matches, join, judge, pairs_to_compare,
};
use topomap::settings::MapperSettings;
use waypost_vision::feature_record::FeatureRecord;
use waypost_vision::verification::{Verifier, View};

use super::MergeOptions;
use super::report::said;
use crate::dataset::{Row, image_files, rows};
use crate::error::fault;
use crate::event_log::{fold_all, layout};
use crate::observing::Observed;
use crate::ranking::{FabMap, Ranking};
use crate::timing::FrameWatch;
use crate::{files, progress};

/// What came out.
#[derive(Serialize)]
pub(crate) struct PassesReport {
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
#[derive(Serialize)]
pub(crate) struct Meeting {
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

/// The map of some frames.
struct PassMap {
    fab_map: FabMap,
    /// By index in the map's own sequence.
    floors: Vec<String>,
}

/// Maps, merges, and counts the floors, of a folder with `images/` and `index.csv`.
pub(super) fn run(folder: &Path, model_file: &Path, options: &MergeOptions) -> Result<PassesReport> {
    let (model, extractor) = files::read_model(model_file)?;
    let frames = frames(folder)?;
    let bar = progress::bar("frames", frames.len());
    let seen = |frame: &Frame| {
        bar.inc(1);
        let seen =
            Observed::in_file(&files::read(&frame.image)?, &model, extractor, &mut FrameWatch::start());
        seen.with_context(|| frame.image.display().to_string())
    };
    let seen: Vec<Observed> = frames.iter().map(seen).collect::<Result<_>>()?;
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
            let (meeting, _) = meet(&map(2, Some(source_floor))?, &map(1, Some(target_floor))?, options)?;
            by_floor.push(Meeting {
                source: Some(source_floor.clone()),
                target: Some(target_floor.clone()),
                ..meeting
            });
        }
    }
    let count = |of: fn(&Meeting) -> bool| by_floor.iter().filter(|meeting| of(meeting)).count();
    Ok(PassesReport {
        false_merges: count(|meeting| meeting.fused > 0 && meeting.source != meeting.target),
        missed_overlaps: count(|meeting| meeting.fused == 0 && meeting.source == meeting.target),
        floors,
        whole,
        fused,
        by_floor,
    })
}

/// What `index.csv` says of the images, in their order.
fn frames(folder: &Path) -> Result<Vec<Frame>> {
    let path = folder.join("index.csv");
    let frame = |(row, image): (Row<2>, PathBuf)| {
        let [pass, floor] = &row.fields;
        let number = pass.parse().map_err(|_| anyhow!("\"{pass}\" is no pass; write 1 or 2"));
        Ok(Frame { pass: number.with_context(|| row.place(&path))?, floor: floor.clone(), image })
    };
    rows(&path, ["pass", "floor"])?.into_iter().zip(image_files(folder)?).map(frame).collect()
}

/// What comes of two maps, and the floors of all places that were fused.
fn meet(
    source: &PassMap,
    target: &PassMap,
    options: &MergeOptions,
) -> Result<(Meeting, Vec<(String, String)>)> {
    let verifier = Verifier::new(MapperSettings::default().verification, options.seed);
    let settings = options.merge();
    let began = Instant::now();
    let pairs = pairs_to_compare(source.known(), target.known(), &settings, &())?;
    let view = |features| View { features, camera: None };
    let compared = |pair: &PlacePair| {
        let views = target.features(pair.target_frame).zip(source.features(pair.source_frame));
        let view = views.map(|(earlier, current)| verifier.compare(view(earlier), view(current)));
        PairComparison { view, focal_length_widths: None }
    };
    let comparisons: Vec<_> = pairs.par_iter().map(compared).collect();
    let matches = find_matches(source.known(), target.known(), &pairs, &comparisons, &settings);
    let verdict = judge(layout(&source.fab_map.mapper), layout(&target.fab_map.mapper), &matches, &settings);
    let places = [source, target].map(|map| map.fab_map.mapper.map().places().len());
    let mut meeting = Meeting {
        source: None,
        target: None,
        places,
        fused: 0,
        false_fused: 0,
        joined_places: 0,
        said: said(&verdict, matches.len()),
        seconds: 0.0,
    };
    let mut floors = Vec::new();
    if let Verdict::Overlap(plan) = verdict {
        let joined = target.joined_by(source, &plan)?;
        floors = plan
            .fused
            .iter()
            .map(|fused| (source.floor(fused.matched.source), target.floor(fused.matched.target)))
            .collect();
        meeting.fused = plan.fused.len();
        meeting.false_fused = floors.iter().filter(|(source, target)| source != target).count();
        meeting.joined_places = joined.map().places().len();
    }
    meeting.seconds = began.elapsed().as_secs_f64();
    Ok((meeting, floors))
}

impl PassMap {
    fn of<'a>(
        frames: impl Iterator<Item = (&'a Frame, &'a Observed)>,
        model: &Model,
        seed: u64,
    ) -> Result<Self> {
        let mut fab_map = FabMap::new(model, MapperSettings::default(), seed)?;
        let mut floors = Vec::new();
        for (index, (frame, seen)) in frames.enumerate() {
            fab_map.rank(index, seen.clone(), FrameWatch::start())?;
            floors.push(frame.floor.clone());
        }
        Ok(Self { fab_map, floors })
    }

    fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.fab_map.mapper, log: &self.fab_map.log.0 }
    }

    fn joined_by(&self, source: &PassMap, plan: &MergePlan) -> Result<Mapper> {
        let mut joined = self.fab_map.mapper.clone();
        let events = join((&source.fab_map.mapper, &self.fab_map.mapper), plan, &source.fab_map.log.0)
            .map_err(fault)?;
        fold_all(&mut joined, &events)?;
        Ok(joined)
    }

    /// The floor of the frame that made a place.
    fn floor(&self, place: u32) -> String {
        let made =
            self.fab_map.mapper.map().places().get(place as usize).and_then(|place| place.frames.first());
        let index = made.and_then(|made| self.index(made.frame));
        index.and_then(|index| self.floors.get(index)).cloned().unwrap_or_default()
    }

    fn index(&self, frame: FrameId) -> Option<usize> {
        self.fab_map.log.index(frame)
    }

    fn features(&self, frame: FrameId) -> Option<&FeatureRecord> {
        self.fab_map.features.get(self.index(frame)?).map(Arc::as_ref)
    }
}
