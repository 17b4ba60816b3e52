//! A merge is asked for, and looked for.

use std::collections::BTreeSet;
use std::sync::Arc;

use topomap::merging::MergeSettings;

use super::report::forgotten;
use super::{
    MAX_PROPOSALS, MAX_SOURCES, MergeReport, MergeRequest, MergeState, MergeTarget, MergeView, Merges,
};
use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::{check_id, map_in};
use crate::service::jobs::{Begun, JobOutcome, JobReporter, JobRequest, Task};
use crate::service::tokens::Caller;
use crate::storage::{JobKind, MapRow};

/// What is to be looked for, and is asked for rightly.
#[derive(Debug)]
struct Search {
    target: MergeTarget,
    sources: Vec<MapRow>,
    settings: MergeSettings,
    report: MergeReport,
}

impl Merges {
    pub(super) async fn begin_whole(
        &self,
        caller: &Caller,
        request: MergeRequest,
    ) -> Result<MergeView, ServiceError> {
        for map in request.sources.iter().chain([&request.target]) {
            caller.check_resource(map)?;
        }
        if self.proposals().len() >= MAX_PROPOSALS {
            return Err(ServiceError::ResourceExhausted {
                message: format!(
                    "{MAX_PROPOSALS} merges wait for a decision; commit or discard some of them first"
                ),
            });
        }
        let search = self.search_of(caller, &request).await?;
        let report = search.report.to_json()?;
        let number = self.storage.insert_merge(search.target.name(), &report, now_ns()).await?;
        let job = self.start_search(number, search, request, caller, Begun::Now).await?;
        self.storage.set_merge_job(number, job).await?;
        self.merge_of_number(number).await
    }

    /// What is to be looked for.
    async fn search_of(&self, caller: &Caller, request: &MergeRequest) -> Result<Search, ServiceError> {
        let settings = merge_settings(request.min_support)?;
        let owner = caller.token.as_deref();
        let (target, sources) = self.to_merge(&request.sources, &request.target, owner).await?;
        let report = MergeReport::asked(target.new_base(), &sources);
        Ok(Search { target, sources, settings, report })
    }

    /// Gives the number of the job.
    async fn start_search(
        &self,
        number: u64,
        search: Search,
        request: MergeRequest,
        caller: &Caller,
        begun: Begun,
    ) -> Result<u64, ServiceError> {
        let Search { target, sources, settings, report } = search;
        let commit_policy = request.commit_policy;
        let asked_by = caller.token.clone();
        let job = JobRequest {
            kind: JobKind::MergeMaps,
            maps: report.maps().chain([target.name()]).map(str::to_owned).collect(),
            task: Some(Task::SearchMerge { merge: number, request, asked_by }),
            begun,
        };
        let merges = self.clone();
        let work = move |reporter: JobReporter| async move {
            let outcome = merges.search(number, target, sources, &settings, commit_policy, &reporter).await;
            // A server that stops leaves it to the next one.
            if !merges.stopping.is_cancelled() {
                merges.note_failure(number, &outcome).await;
            }
            outcome
        };
        match self.jobs.start(job, work).await {
            Ok(job) => Ok(job.number),
            Err(error) => {
                self.note_failure(number, &JobOutcome::Failed(error.clone())).await;
                Err(error)
            }
        }
    }

    /// Looks once more for what an earlier server was looking for, or had found and was to commit.
    pub(in crate::service) async fn search_again(
        &self,
        number: u64,
        request: MergeRequest,
        caller: &Caller,
        begun: Begun,
    ) -> Result<(), ServiceError> {
        let search = self.search_of(caller, &request).await?;
        self.storage.begin_search_again(number, &search.report.to_json()?).await?;
        if self.merge_of_number(number).await?.state != MergeState::Searching {
            return Err(forgotten());
        }
        self.start_search(number, search, request, caller, begun).await.map(drop)
    }

    /// A merge says why its job failed, too.
    pub(in crate::service) async fn fail_with_job(&self, job: u64, error: &ServiceError) {
        if let Err(error) = self.storage.fail_merge_of_job(job, &error.clone().into()).await {
            tracing::warn!(job, %error, "the end of a merge could not be stored");
        }
    }

    /// The target and the sources of a request, as rows.
    async fn to_merge(
        &self,
        sources: &[String],
        target: &str,
        owner: Option<&str>,
    ) -> Result<(MergeTarget, Vec<MapRow>), ServiceError> {
        let target = check_id("map name", map_in(target)?)?;
        let mut names = BTreeSet::new();
        let mut rows = Vec::new();
        for source in sources {
            let source = map_in(source)?;
            if !names.insert(source) {
                return Err(ServiceError::invalid(format_args!(
                    "the map {source} is named twice; a map overlaps with itself everywhere, so name each once"
                )));
            }
            let row = self.open_maps.row(source).await?;
            // Named among the sources, the target is what the others go into all the same.
            if source != target {
                rows.push(row);
            }
        }
        let existing = self.storage.map(target).await?;
        let target = match existing {
            Some(row) => MergeTarget { base: row, new: None },
            None if rows.len() < 2 => {
                return Err(ServiceError::invalid(format_args!(
                    "there is no map {target} yet: name two maps or more that it is to be made of, or a target that \
                     there is"
                )));
            }
            None => {
                let new = self.names.reserve(target, owner).await?;
                MergeTarget { base: rows.remove(0), new: Some(Arc::new(new)) }
            }
        };
        if rows.is_empty() {
            return Err(ServiceError::invalid(format_args!(
                "nothing is to go into the map {}; name the maps that are",
                target.base.name
            )));
        }
        if rows.len() > MAX_SOURCES {
            return Err(ServiceError::invalid(format_args!(
                "at most {MAX_SOURCES} maps go into another at a time, not {}; merge them in several steps",
                rows.len()
            )));
        }
        self.check_words(&target.base, &rows).await?;
        Ok((target, rows))
    }

    /// Words mean the same only if they are of one vocabulary.
    async fn check_words(&self, base: &MapRow, sources: &[MapRow]) -> Result<(), ServiceError> {
        let model = self.models.get(&base.model).await?;
        for source in sources {
            let other = self.models.get(&source.model).await?;
            if other.words_hash != model.words_hash {
                return Err(ServiceError::precondition(format_args!(
                    "the maps {} and {} have models of different words (words_hash {} and {}), which cannot be compared; \
                     make one of them anew with the other's model: `waypost map rebuild {} --model {} --into NEW-NAME`",
                    base.name,
                    source.name,
                    model.words_hash,
                    other.words_hash,
                    source.name,
                    &base.model[..12]
                )));
            }
        }
        Ok(())
    }
}

fn merge_settings(min_support: Option<u32>) -> Result<MergeSettings, ServiceError> {
    let mut settings = MergeSettings::default();
    if let Some(min_support) = min_support {
        settings.min_support = min_support as usize;
    }
    settings.check().map_err(ServiceError::invalid)?;
    Ok(settings)
}
