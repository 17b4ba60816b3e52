//! A merge as those see it who ask.

use super::report::MergeReport;
use crate::error::ServiceError;
use crate::names::id_in;
use crate::storage::{MergeRow, MergeState};

/// A merge as it stands.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MergeView {
    pub(crate) number: u64,
    /// The name of the map that the sources go into.
    pub(crate) target: String,
    /// What works on it, or did last.
    pub(crate) job: u64,
    pub(crate) state: MergeState,
    pub(crate) report: MergeReport,
    /// Why it failed.
    pub(crate) error: Option<ServiceError>,
    pub(crate) created_ns: i64,
}

impl MergeView {
    /// The names of all maps that it is about: target and sources.
    pub(crate) fn maps(&self) -> Vec<&str> {
        self.report.maps().chain([self.target.as_str()]).collect()
    }
}

pub(super) fn view(row: MergeRow) -> Result<MergeView, ServiceError> {
    let MergeRow { number, target, map: _, job, state, report, error, created_ns } = row;
    let report = MergeReport::from_json(&report)?;
    let error = error.map(ServiceError::from);
    Ok(MergeView { number, target, job, state, report, error, created_ns })
}

pub(super) fn merge_in(name: &str) -> Result<u64, ServiceError> {
    id_in("merges", name)?.parse().map_err(|_| no_such_merge(name))
}

pub(super) fn no_such_merge(name: &str) -> ServiceError {
    ServiceError::not_found(format_args!("there is no merge {name}; list the merges to see what there is"))
}

pub(super) fn undecidable(merge: &MergeView, what: &str) -> ServiceError {
    let MergeView { number, state, .. } = merge;
    ServiceError::precondition(match state {
        MergeState::Searching => {
            format!("merges/{number} is still being looked for; wait for jobs/{}", merge.job)
        }
        MergeState::Proposed => format!("merges/{number} is being committed by jobs/{}", merge.job),
        MergeState::NoOverlap => format!(
            "merges/{number} found no overlap between the maps, and cannot be {what}; its report says what was looked for: \
             ask for a new one once the maps share places"
        ),
        MergeState::Committed | MergeState::Discarded | MergeState::Undone | MergeState::Failed => format!(
            "merges/{number} is {} and cannot be {what}; ask for a new one if you want the maps merged",
            state.word()
        ),
    })
}
