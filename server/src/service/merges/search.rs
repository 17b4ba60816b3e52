//! The search for maps on each other: it changes nothing.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use tokio::runtime::Handle;
use topomap::merging::{
    Apart, MergeError, MergeObserver, MergeSettings, PairComparison, PlaceMatch, PlacePair, Verdict,
    find_matches, join, judge, pairs_to_compare,
};

use super::cameras::difference;
use super::picture::{Panel, svg};
use super::report::Metres;
use super::{
    CommitPolicy, Joining, MapOverlap, MergeReport, MergeTarget, Merges, Proposal, SourceOutcome, Target,
};
use crate::camera::Camera;
use crate::error::ServiceError;
use crate::open_map::verifier;
use crate::service::jobs::{JobOutcome, JobReporter, Stopped};
use crate::service::read_map::{Between, Disk, Models, ReadMap};
use crate::storage::{MapRow, MergeOutcome, MergeState, Storage};

/// What the blocking part of a search works with.
struct Search {
    runtime: Handle,
    storage: Storage,
    target: MergeTarget,
    sources: Vec<MapRow>,
    /// The base's, then those of the sources.
    models: Models,
    settings: MergeSettings,
    reporter: JobReporter,
}

impl Merges {
    /// Looks for every source on the target; proposes what was found, or commits it, if all overlap.
    pub(super) async fn search(
        &self,
        number: u64,
        target: MergeTarget,
        sources: Vec<MapRow>,
        settings: &MergeSettings,
        commit_policy: CommitPolicy,
        reporter: &JobReporter,
    ) -> JobOutcome {
        let Some(turn) = reporter.wait_for_turn().await else { return JobOutcome::Cancelled };
        let (proposal, picture) = match self.look_for(target, sources, settings, reporter).await {
            Ok(found) => found,
            Err(stopped) => return stopped.into(),
        };
        let overlap = proposal.report.all_overlap();
        let state = if overlap { MergeState::Proposed } else { MergeState::NoOverlap };
        let report = match proposal.report.to_json() {
            Ok(report) => report,
            Err(error) => return JobOutcome::Failed(error),
        };
        let outcome = MergeOutcome { number, state, report };
        if overlap && commit_policy == CommitPolicy::Automatic {
            return match self.storage.end_search(&outcome, Some(&picture), None).await {
                Ok(()) => self.join_in_turn(number, proposal, reporter, turn).await,
                Err(error) => JobOutcome::Failed(error.into()),
            };
        }
        if overlap {
            self.proposals().insert(number, proposal);
        }
        let end = reporter.succeeded(format!("merges/{number}"));
        match self.storage.end_search(&outcome, Some(&picture), Some(&end)).await {
            Ok(()) => JobOutcome::Stored(end),
            Err(error) => {
                self.proposals().remove(&number);
                JobOutcome::Failed(error.into())
            }
        }
    }

    async fn look_for(
        &self,
        target: MergeTarget,
        sources: Vec<MapRow>,
        settings: &MergeSettings,
        reporter: &JobReporter,
    ) -> Result<(Proposal, String), Stopped> {
        let mut models = vec![self.models.get(&target.base.model).await?];
        for source in &sources {
            models.push(self.models.get(&source.model).await?);
        }
        let search = Search {
            runtime: Handle::current(),
            storage: self.storage.clone(),
            target,
            sources,
            models,
            settings: *settings,
            reporter: reporter.clone(),
        };
        let looking = tokio::task::spawn_blocking(move || search.look());
        looking.await.map_err(ServiceError::internal)?
    }
}

impl Search {
    /// Sources that overlap with nothing are looked for again whenever another has brought new places. Blocks.
    fn look(self) -> Result<(Proposal, String), Stopped> {
        let mut report = MergeReport::asked(self.target.new_base(), &self.sources);
        let mut merged = self.read(self.target.base.clone(), 0)?;
        let events = merged.log.events.len() as u64;
        let places = merged.mapper.map().places().len() as u32;
        if let Some(base) = &mut report.base {
            (base.events, base.places) = (events, u64::from(places));
        }
        let mut panels = vec![Panel::of(&format!("{} before", merged.row.name), &merged)];
        let mut left = Vec::new();
        for (index, row) in self.sources.iter().enumerate() {
            let source = self.read(row.clone(), index + 1)?;
            panels.push(Panel::of(&format!("{} before", row.name), &source));
            report.sources[index].events = source.log.events.len() as u64;
            report.sources[index].places = source.mapper.map().places().len() as u64;
            left.push((index, source));
        }
        let mut joining = Vec::new();
        loop {
            let before = left.len();
            left = self.try_all(left, &mut merged, &mut joining, &mut report)?;
            if left.is_empty() || left.len() == before {
                break;
            }
        }
        if !joining.is_empty() {
            panels.push(Panel::of("together", &merged));
        }
        let target = Target { base: merged.row, events, places, new: self.target.new };
        let picture = svg(&panels);
        Ok((Proposal { target, joining, report }, picture))
    }

    /// Looks for each source on what is merged so far, and takes in those that overlap; the others come back. Blocks.
    fn try_all(
        &self,
        sources: Vec<(usize, ReadMap)>,
        merged: &mut ReadMap,
        joining: &mut Vec<Joining>,
        report: &mut MergeReport,
    ) -> Result<Vec<(usize, ReadMap)>, Stopped> {
        let mut apart = Vec::new();
        for (index, source) in sources {
            let outcome = &mut report.sources[index].outcome;
            let plan = match self.meet(&source, merged)? {
                Verdict::Overlap(plan) => plan,
                Verdict::Apart(why) => {
                    *outcome = SourceOutcome::NoOverlap(self.reason(why, &source.row, &merged.row)?);
                    apart.push((index, source));
                    continue;
                }
            };
            let frames = |matched: &PlaceMatch| {
                let told = [
                    source.told_frame(self.disk(), matched.source_frame)?,
                    merged.told_frame(self.disk(), matched.target_frame)?,
                ];
                Ok(told)
            };
            let known = [&source, &*merged].iter().all(|map| map.mapper.poses().has_metres());
            let metres = if known { Metres::Known } else { Metres::Unknown };
            *outcome = SourceOutcome::Overlaps(Box::new(MapOverlap::of(&plan, metres, frames)?));
            let joined = join((&source.mapper, &merged.mapper), &plan, &source.log.events);
            merged.take(&source, joined.map_err(ServiceError::internal)?)?;
            let events = source.log.events.len() as u64;
            joining.push(Joining { source: index, row: source.row, events, plan });
        }
        Ok(apart)
    }

    /// Why a source stays apart; where too little matches, also that their cameras see differently. Blocks.
    fn reason(&self, why: Apart, source: &MapRow, target: &MapRow) -> Result<String, ServiceError> {
        let cameras = |map: &MapRow| -> Result<Vec<Camera>, ServiceError> {
            let declared = self.runtime.block_on(self.storage.cameras(map.id))?;
            Ok(declared.into_iter().map(|(_, camera)| camera).collect())
        };
        let difference = match why {
            Apart::NoMatches | Apart::TooLittleSupport { .. } | Apart::TooLittleEvidence { .. } => {
                difference((&source.name, &cameras(source)?), (&target.name, &cameras(target)?))
            }
            Apart::NothingMeasured
            | Apart::NothingToGoInto
            | Apart::Ambiguous { .. }
            | Apart::Contradicted(_) => None,
        };
        Ok(difference.map_or_else(|| why.to_string(), |difference| format!("{why}; {difference}")))
    }

    fn disk(&self) -> Disk<'_> {
        Disk { runtime: &self.runtime, storage: &self.storage }
    }

    fn read(&self, row: MapRow, model: usize) -> Result<ReadMap, Stopped> {
        self.go_on("reading the maps", model as f64 / self.models.len() as f64)?;
        Ok(ReadMap::read(self.disk(), row, &self.models[model], None)?)
    }

    /// What is said of a source and the target.
    fn meet(&self, source: &ReadMap, target: &ReadMap) -> Result<Verdict, Stopped> {
        let places = source.mapper.map().places().len();
        let observer = Progress { reporter: &self.reporter, places };
        let pairs = pairs_to_compare(source.known(), target.known(), &self.settings, &observer);
        let pairs = pairs.map_err(|error| match error {
            MergeError::Ended => Stopped::Cancelled,
            MergeError::Vocabulary { .. } | MergeError::Setting { .. } => {
                Stopped::Failed(ServiceError::precondition(error))
            }
        })?;
        let comparisons = self.compare(source, target, &pairs)?;
        let matches = find_matches(source.known(), target.known(), &pairs, &comparisons, &self.settings);
        self.go_on("judging what was found", 0.0)?;
        Ok(judge(source.layout(), target.layout(), &matches, &self.settings))
    }

    /// Compares the views of all pairs, side by side.
    fn compare(
        &self,
        source: &ReadMap,
        target: &ReadMap,
        pairs: &[PlacePair],
    ) -> Result<Vec<PairComparison>, Stopped> {
        let verifier = verifier(target.mapper.settings());
        let views = Between::new(self.disk(), &source.log, &target.log, verifier);
        let done = AtomicUsize::new(0);
        let compare = |pair: &PlacePair| {
            let compared = views.compare(pair).map_err(ServiceError::from)?;
            let fraction = (done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / pairs.len() as f64;
            self.go_on("comparing places that look alike", fraction)?;
            Ok(compared)
        };
        pairs.par_iter().map(compare).collect()
    }

    fn go_on(&self, stage: &'static str, fraction: f64) -> Result<(), Stopped> {
        Stopped::unless(self.reporter.progress(stage, fraction))
    }
}

struct Progress<'a> {
    reporter: &'a JobReporter,
    places: usize,
}

impl MergeObserver for Progress<'_> {
    fn goes_on(&self, places: usize) -> bool {
        let fraction = places as f64 / self.places.max(1) as f64;
        self.reporter.progress("looking for each other's places", fraction).is_continue()
    }
}
