//! What it takes to merge two large maps of frames that came as words alone.

use std::ops::ControlFlow;
use std::sync::Mutex;
use std::time::Instant;

use fabmap::descriptor::{DescriptorKind, Descriptors};
use fabmap::detector::DetectorModel;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::place_filter::Belief;
use fabmap::vocabulary::{Vocabulary, VocabularySettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use topomap::event::{Decision, FrameEvent, FrameId, Link, LinkKind, MapEvent, Reason};
use topomap::mapper::{ArchiveError, Mapper, MapperSettings};
use topomap::merging::{
    KnownMap, Layout, MergeObserver, MergeSettings, Verdict, ViewsBetween, find_matches, join, judge,
};
use topomap::verification::TwoView;

use crate::error::EvalError;
use crate::event_log::EventLog;
use crate::workload::{Use, Workload, WorkloadSettings};
use crate::{memory, progress};

/// How large, and on how much of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct LargeOptions {
    /// Places of either map, at least 2; the second half of the target's are the first half of the source's.
    pub places: u32,
    /// Threads, at least 1.
    pub threads: usize,
    /// Seed of all images.
    pub seed: u64,
    /// What a merge has to show.
    pub merge: MergeSettings,
}

/// What it took.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LargeReport {
    /// Places of either map.
    pub places: u32,
    /// Places of the source that are places of the target.
    pub shared: u32,
    /// Threads.
    pub threads: usize,
    /// Matches that were found.
    pub matches: usize,
    /// Places that were fused.
    pub fused: usize,
    /// Those that are different places.
    pub false_fused: usize,
    /// Why the maps stayed apart, if they did.
    pub apart: Option<String>,
    /// Asking for each place of the source.
    pub find_seconds: f64,
    /// Choosing what agrees.
    pub judge_seconds: f64,
    /// Telling the source's log anew, and folding it in.
    pub join_seconds: f64,
    /// All of it.
    pub seconds: f64,
    /// The longest that nothing was heard while places were asked for.
    pub longest_silence_seconds: f64,
    /// Memory held at the end.
    pub rss_mib: Option<f64>,
}

/// A map whose places were seen once each, in a row.
struct RowMap {
    mapper: Mapper,
    log: EventLog,
}

/// Draws two maps and merges them.
///
/// # Errors
/// [`EvalError`].
pub fn run(options: &LargeOptions) -> Result<LargeReport, EvalError> {
    let LargeOptions { places, threads, seed, ref merge } = *options;
    let workload = Workload::new(WorkloadSettings { seed, ..WorkloadSettings::default() })?;
    let model = model(&workload);
    let shared = places / 2;
    let target = RowMap::of(&model, places, |place| workload.image(Use::Place, place))?;
    let source = RowMap::of(&model, places, |place| {
        let there = places - shared + place;
        if place < shared { workload.revisit_to(place, there) } else { workload.image(Use::Place, there) }
    })?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let silence = Silence::new();
    let began = Instant::now();
    let matches =
        pool.install(|| find_matches(source.known(), target.known(), &WordsAlone, merge, &silence))?;
    let found = began.elapsed().as_secs_f64();
    let verdict = pool.install(|| judge(source.layout(), target.layout(), &matches, merge));
    let judged = began.elapsed().as_secs_f64();
    let (mut fused, mut false_fused, mut apart) = (0, 0, None);
    match verdict {
        Verdict::Overlap(plan) => {
            fused = plan.fused.len();
            let is_false = |source: u32, target: u32| source >= shared || target != places - shared + source;
            false_fused =
                plan.fused.iter().filter(|one| is_false(one.matched.source, one.matched.target)).count();
            let mut joined = target.mapper.clone();
            let events =
                join((&source.mapper, &target.mapper), &plan, &source.log.0).map_err(EvalError::Join)?;
            for (index, event) in events.iter().enumerate() {
                joined.fold(event).map_err(|reason| EvalError::Fold { index, reason })?;
            }
            joined.relax();
        }
        Verdict::Apart(reason) => apart = Some(reason.to_string()),
    }
    let seconds = began.elapsed().as_secs_f64();
    let report = LargeReport {
        places,
        shared,
        threads,
        matches: matches.len(),
        fused,
        false_fused,
        apart,
        find_seconds: found,
        judge_seconds: judged - found,
        join_seconds: seconds - judged,
        seconds,
        longest_silence_seconds: silence.longest_s(),
        rss_mib: memory::resident_mib(),
    };
    eprintln!(
        "{places} places each, {shared} of both: {} matches, {fused} fused, {false_fused} of them false; {found:.1} s to find, \
         {:.1} s to judge, {:.1} s to join; nothing heard for {:.2} s at most",
        report.matches, report.judge_seconds, report.join_seconds, report.longest_silence_seconds
    );
    Ok(report)
}

/// The workload's tree, over words that no descriptor is ever asked for.
fn model(workload: &Workload) -> Model {
    const SAMPLES: u32 = 1_000;
    let words = workload.tree().len() as u32;
    let mut random = ChaCha8Rng::seed_from_u64(0);
    let rows: Vec<u8> = (0..words as usize * 32).map(|_| random.random()).collect();
    let settings = VocabularySettings { words, seed: 0, iterations: 1 };
    let vocabulary = Descriptors::new(DescriptorKind::Binary, 32, rows)
        .ok()
        .and_then(|rows| Vocabulary::train(&rows, &settings, &mut |_| ControlFlow::Continue(())).ok());
    let training = workload.images(Use::Training, SAMPLES);
    vocabulary
        .and_then(|vocabulary| {
            let tree = workload.tree().clone();
            Model::new("synthetic".to_owned(), vocabulary, tree, DetectorModel::default(), training).ok()
        })
        .unwrap_or_else(|| unreachable!("as many different words as the tree has"))
}

impl RowMap {
    fn of(
        model: &Model,
        places: u32,
        seen: impl Fn(u32) -> Observation + Sync + Send,
    ) -> Result<Self, EvalError> {
        let bar = progress::bar("places", places as usize);
        let observations: Vec<Observation> = (0..places).into_par_iter().map(seen).collect();
        let opened = std::iter::once(MapEvent::SessionOpened { session: 0 });
        let frames =
            (0..).zip(observations).map(|(place, seen)| MapEvent::Frame(Box::new(new_place(place, seen))));
        let log = EventLog(opened.chain(frames).collect());
        let mut mapper = Mapper::new(model, MapperSettings::default())?;
        for (index, event) in log.0.iter().enumerate() {
            mapper.fold(event).map_err(|reason| EvalError::Fold { index, reason })?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(Self { mapper, log })
    }

    fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, archive: &self.log }
    }

    fn layout(&self) -> Layout<'_> {
        let settings = self.mapper.settings();
        Layout { poses: self.mapper.poses(), noise: settings.odometry_noise, spacing: settings.place_spacing }
    }
}

/// The frame that makes the next place, linked with the one before.
fn new_place(place: u32, observation: Observation) -> FrameEvent {
    let link = place.checked_sub(1).map(|from| Link { from, to: place, kind: LinkKind::Session });
    FrameEvent {
        frame: u64::from(place) + 1,
        session: 0,
        sequence: u64::from(place),
        stamp_ns: i64::from(place) * 1_000_000_000,
        odometry: None,
        observation,
        decision: Decision { reason: Reason::NewPlace, place: Some(place), posterior: 1.0, closure: None },
        new_place_posterior: 1.0,
        proposal: None,
        candidates: Vec::new(),
        learnt: true,
        link,
        at: None,
        belief: Belief { places: vec![(place, 1.0)], new_place: 0.0, remainder: 0.0 },
    }
}

/// No frame has keypoints.
struct WordsAlone;

impl ViewsBetween for WordsAlone {
    fn compare(&self, _source: FrameId, _target: FrameId) -> Result<Option<TwoView>, ArchiveError> {
        Ok(None)
    }

    fn focal_length_widths(&self, _source: FrameId) -> Option<f64> {
        None
    }
}

/// How long nothing was heard.
struct Silence(Mutex<(Instant, f64)>);

impl Silence {
    fn new() -> Self {
        Self(Mutex::new((Instant::now(), 0.0)))
    }

    fn longest_s(&self) -> f64 {
        self.0.lock().map_or(f64::NAN, |heard| heard.1)
    }
}

impl MergeObserver for Silence {
    fn goes_on(&self, _places: usize) -> bool {
        let Ok(mut heard) = self.0.lock() else { return false };
        let (last, longest) = *heard;
        *heard = (Instant::now(), longest.max(last.elapsed().as_secs_f64()));
        true
    }
}
