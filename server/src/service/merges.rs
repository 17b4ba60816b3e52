//! Maps that become one: looked for, proposed, and then committed, discarded or undone.

mod asking;
mod cameras;
mod commit;
mod picture;
mod report;
mod search;
mod undo;
mod view;

use self::report::forgotten;
use self::view::{merge_in, no_such_merge, undecidable, view};
pub(crate) use super::merge_request::{CommitPolicy, MergeRequest};
pub(crate) use report::{MapOverlap, MatchedPlaces, MergeReport, MergedSource, SourceOutcome};
pub(crate) use view::MergeView;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio_util::sync::CancellationToken;
use topomap::merging::MergePlan;

use super::deleted_maps::DeletedMaps;
use super::jobs::{JobOutcome, JobReporter, JobRequest, Jobs, to_its_end};
use super::map_names::{MapNames, Reservation};
use super::rewriting::Rewriting;
use super::tokens::Caller;
use crate::error::ServiceError;
use crate::ingest::model::LoadedModels;
use crate::open_map::OpenMaps;
use crate::pages::{Page, numbered_page, page_from, page_size, rows_of_page};
pub(crate) use crate::storage::MergeState;
use crate::storage::{JobKind, MapId, MapRow, Storage};

/// Most maps that go into another at a time.
const MAX_SOURCES: usize = 16;

/// Proposals that may wait for a decision at a time.
const MAX_PROPOSALS: usize = 32;

/// Merges of maps. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Merges {
    storage: Storage,
    models: LoadedModels,
    open_maps: OpenMaps,
    jobs: Jobs,
    names: MapNames,
    deleted_maps: DeletedMaps,
    rewriting: Rewriting,
    stopping: CancellationToken,
    /// What was found and is not decided yet. In memory: it is of no use to a server that has not read the maps.
    proposals: Arc<Mutex<HashMap<u64, Proposal>>>,
}

/// How sources go into a target.
#[derive(Clone, Debug)]
struct Proposal {
    target: Target,
    /// In the order in which they join.
    joining: Vec<Joining>,
    report: MergeReport,
}

/// The map that others go into, as it was when it was looked at.
#[derive(Clone, Debug)]
struct Target {
    /// Either the target itself, or the source that it is to be a copy of.
    base: MapRow,
    events: u64,
    places: u32,
    /// Held while a map of this name is to be made.
    new: Option<Arc<Reservation>>,
}

/// A source that overlaps with the target, or with what others bring.
#[derive(Clone, Debug)]
struct Joining {
    /// Its place among the sources of the report.
    source: usize,
    row: MapRow,
    events: u64,
    plan: MergePlan,
}

impl Merges {
    pub(super) fn new(
        rewriting: Rewriting,
        names: MapNames,
        deleted_maps: DeletedMaps,
        stopping: CancellationToken,
    ) -> Self {
        let Rewriting { storage, models, open_maps, jobs, .. } = rewriting.clone();
        let proposals = Arc::default();
        Self { storage, models, open_maps, jobs, names, deleted_maps, rewriting, stopping, proposals }
    }

    /// Begins to look for maps on each other.
    pub(crate) async fn begin(
        &self,
        caller: &Caller,
        request: MergeRequest,
    ) -> Result<MergeView, ServiceError> {
        let (merges, caller) = (self.clone(), caller.clone());
        to_its_end(async move { merges.begin_whole(&caller, request).await }).await
    }

    /// A merge by `merges/{number}`.
    pub(crate) async fn get(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let view = self.merge_of_number(merge_in(name)?).await?;
        caller.check_reaches(name, view.maps())?;
        Ok(view)
    }

    /// All merges of maps that the caller reaches, newest first.
    pub(crate) async fn list(
        &self,
        caller: &Caller,
        size: u32,
        token: &str,
    ) -> Result<Page<MergeView>, ServiceError> {
        let size = page_size(size)?;
        let before = numbered_page(token)?;
        let read = |before| async move {
            let rows = self.storage.merges(before, size + 1).await?;
            rows.into_iter().map(view).collect::<Result<Vec<_>, ServiceError>>()
        };
        let number = |view: &MergeView| Some(view.number);
        let reached = |view: &MergeView| caller.reaches(view.maps());
        let mut items = rows_of_page(size, before, read, number, reached).await?;
        let more = items.len() > size as usize;
        items.truncate(size as usize);
        let next = items.last().filter(|_| more).map_or_else(String::new, |view| page_from(view.number));
        Ok(Page { items, next })
    }

    /// The maps before and after, as SVG.
    pub(crate) async fn picture(&self, caller: &Caller, name: &str) -> Result<String, ServiceError> {
        let view = self.get(caller, name).await?;
        self.storage.merge_picture(view.number).await?.ok_or_else(|| {
            ServiceError::precondition(format_args!(
                "{name} has no picture: the maps were not looked at to the end"
            ))
        })
    }

    /// Makes the maps one, as was proposed.
    pub(crate) async fn commit(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let (merges, caller, name) = (self.clone(), caller.clone(), name.to_owned());
        to_its_end(async move { merges.commit_whole(&caller, &name).await }).await
    }

    async fn commit_whole(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let view = self.get(caller, name).await?;
        let number = view.number;
        // Taken out: it is committed once.
        let proposal = self.proposals().remove(&number).ok_or_else(|| undecidable(&view, "committed"))?;
        let kept = proposal.clone();
        let merges = self.clone();
        let work = move |reporter: JobReporter| async move {
            let kept = proposal.clone();
            let outcome = merges.join(number, proposal, &reporter).await;
            match &outcome {
                // A person may think again.
                JobOutcome::Cancelled => {
                    merges.proposals().insert(number, kept);
                }
                JobOutcome::Stored(_) | JobOutcome::Failed(_) => {
                    merges.note_failure(number, &outcome).await;
                }
            }
            outcome
        };
        let request = JobRequest::of_this_server(JobKind::MergeMaps, &view.maps());
        let job = match self.jobs.start(request, work).await {
            Ok(job) => job,
            Err(error) => {
                self.proposals().insert(number, kept);
                return Err(error);
            }
        };
        self.storage.set_merge_job(number, job.number).await?;
        self.merge_of_number(number).await
    }

    /// Leaves the maps as they are.
    pub(crate) async fn discard(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let (merges, caller, name) = (self.clone(), caller.clone(), name.to_owned());
        to_its_end(async move { merges.discard_whole(&caller, &name).await }).await
    }

    async fn discard_whole(&self, caller: &Caller, name: &str) -> Result<MergeView, ServiceError> {
        let view = self.get(caller, name).await?;
        let proposed = self.proposals().contains_key(&view.number);
        if !proposed || !self.storage.discard_merge(view.number).await? {
            return Err(undecidable(&view, "discarded"));
        }
        self.proposals().remove(&view.number);
        self.merge_of_number(view.number).await
    }

    /// At the start of a server: what an earlier one proposed is forgotten, and what it looked for if this one cannot go on
    /// with that.
    pub(crate) async fn settle(&self) -> Result<(), ServiceError> {
        Ok(self.storage.fail_open_merges(&forgotten().into()).await?)
    }

    async fn merge_of_number(&self, number: u64) -> Result<MergeView, ServiceError> {
        let row = self.storage.merge(number).await?;
        view(row.ok_or_else(|| no_such_merge(&format!("merges/{number}")))?)
    }

    /// The merge says why its job failed, too.
    async fn note_failure(&self, number: u64, outcome: &JobOutcome) {
        let error = match outcome {
            JobOutcome::Stored(_) => return,
            JobOutcome::Failed(error) => error.clone(),
            JobOutcome::Cancelled if self.stopping.is_cancelled() => forgotten(),
            JobOutcome::Cancelled => ServiceError::aborted("it was cancelled; ask for it again"),
        };
        if let Err(error) = self.storage.fail_merge(number, &error.into()).await {
            tracing::warn!(merge = number, %error, "the end of a merge could not be stored");
        }
    }
}

impl Merges {
    fn proposals(&self) -> MutexGuard<'_, HashMap<u64, Proposal>> {
        self.proposals.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Where the sources are to go.
#[derive(Debug)]
struct MergeTarget {
    /// The target, or the source that it is to begin with.
    base: MapRow,
    new: Option<Arc<Reservation>>,
}

impl MergeTarget {
    fn name(&self) -> &str {
        self.new.as_ref().map_or(&self.base.name, |new| new.name())
    }

    /// The source that a new target is to be a copy of.
    fn new_base(&self) -> Option<&MapRow> {
        self.new.is_some().then_some(&self.base)
    }
}

impl Target {
    /// `None` for a copy, which is a map of its own.
    fn existing(&self) -> Option<MapId> {
        self.new.is_none().then_some(self.base.id)
    }
}
