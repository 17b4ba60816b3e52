//! What it takes to merge two large maps of frames that came as words alone.

use std::sync::Mutex;
use std::time::Instant;

use anyhow::Result;
use fabmap::model::Model;
use fabmap::observation::Observation;
use fabmap::place_filter::Belief;
use rayon::prelude::*;
use serde::Serialize;
use topomap::log::{Decision, FrameEvent, Link, LinkKind, MapEvent, Reason};
use topomap::mapper::Mapper;
use topomap::merging::{
    KnownMap, MergeObserver, PairComparison, Verdict, find_matches, join, judge, pairs_to_compare,
};
use topomap::settings::MapperSettings;

use super::MergeOptions;
use crate::error::{fault, refused};
use crate::event_log::{EventLog, fold_all, layout};
use crate::memory;
use crate::workload::{Use, Workload, WorkloadSettings};

/// What it took.
#[derive(Serialize)]
pub(crate) struct LargeReport {
    /// Places of either map.
    pub places: u32,
    /// Places of the source that are places of the target.
    pub shared: u32,
    /// Threads.
    pub threads: u16,
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
    /// Rewriting the source's log, and folding it in.
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

/// Draws two maps of so many places and merges them; the second half of the target's places are the first half of the
/// source's.
pub(super) fn run(places: u32, options: &MergeOptions) -> Result<LargeReport> {
    let &MergeOptions { threads, seed, .. } = options;
    let merge = &options.merge();
    let workload = Workload::new(WorkloadSettings { seed, ..WorkloadSettings::default() })?;
    let model = workload.model()?;
    let shared = places / 2;
    let target = RowMap::of(&model, places, |place| workload.image(Use::Place, place))?;
    let source = RowMap::of(&model, places, |place| {
        let there = places - shared + place;
        if place < shared { workload.revisit_to(place, there) } else { workload.image(Use::Place, there) }
    })?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(usize::from(threads)).build()?;
    let silence = Silence::new();
    let began = Instant::now();
    let [source_map, target_map] = [source.known(), target.known()];
    let pairs = pool.install(|| pairs_to_compare(source_map, target_map, merge, &silence))?;
    // No frame has keypoints.
    let comparisons = vec![PairComparison::default(); pairs.len()];
    let matches = find_matches(source_map, target_map, &pairs, &comparisons, merge);
    let found = began.elapsed().as_secs_f64();
    let verdict = pool.install(|| judge(layout(&source.mapper), layout(&target.mapper), &matches, merge));
    let judged = began.elapsed().as_secs_f64();
    let mut fused = 0;
    let mut false_fused = 0;
    let mut apart = None;
    match verdict {
        Verdict::Overlap(plan) => {
            fused = plan.fused.len();
            let is_false = |source: u32, target: u32| source >= shared || target != places - shared + source;
            false_fused =
                plan.fused.iter().filter(|one| is_false(one.matched.source, one.matched.target)).count();
            let mut joined = target.mapper.clone();
            let events = join((&source.mapper, &target.mapper), &plan, &source.log.0).map_err(fault)?;
            fold_all(&mut joined, &events)?;
            joined.relax();
        }
        Verdict::Apart(reason) => apart = Some(reason.to_string()),
    }
    let seconds = began.elapsed().as_secs_f64();
    Ok(LargeReport {
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
    })
}

impl RowMap {
    fn of(model: &Model, places: u32, seen: impl Fn(u32) -> Observation + Sync + Send) -> Result<Self> {
        let observations: Vec<Observation> = (0..places).into_par_iter().map(seen).collect();
        let opened = std::iter::once(MapEvent::SessionOpened { session: 0 });
        let frames =
            (0..).zip(observations).map(|(place, seen)| MapEvent::Frame(Box::new(new_place(place, seen))));
        let log = EventLog(opened.chain(frames).collect());
        let mut mapper = Mapper::new(model, MapperSettings::default()).map_err(refused)?;
        fold_all(&mut mapper, &log.0)?;
        Ok(Self { mapper, log })
    }

    fn known(&self) -> KnownMap<'_> {
        KnownMap { mapper: &self.mapper, log: &self.log.0 }
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
        look_alike_inliers: None,
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
