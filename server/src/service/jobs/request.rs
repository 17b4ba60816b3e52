//! What a job is to do, and how that is kept, so that another server can go on with it.

use serde::{Deserialize, Serialize};

use super::JobReporter;
use crate::service::merge_request::MergeRequest;
use crate::storage::JobKind;

/// A job that is to run.
#[derive(Clone, Debug)]
pub(in crate::service) struct JobRequest {
    pub(in crate::service) kind: JobKind,
    /// Names of the maps that it reads or writes.
    pub(in crate::service) maps: Vec<String>,
    /// What another server goes on with if this one ends first. None of what came in a stream, which is gone then; none
    /// either of what gives places other numbers, by which robots may have been sent to them meanwhile.
    pub(in crate::service) task: Option<Task>,
    pub(in crate::service) begun: Begun,
}

/// Whether a job is a new one.
#[derive(Clone, Debug)]
pub(in crate::service) enum Begun {
    Now,
    /// By a server that ended before the job did.
    Before(Box<JobReporter>),
}

/// What was asked for, and by which token; none where the server has none. Names are those of the request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(in crate::service) enum Task {
    CompactMap { map: String, asked_by: Option<String> },
    RebuildMap { map: String, model: String, into: String, asked_by: Option<String> },
    RepairMap { map: String, into: String, copy: String, asked_by: Option<String> },
    SearchMerge { merge: u64, request: MergeRequest, asked_by: Option<String> },
}

impl JobRequest {
    /// A job that ends with the server on which it began.
    pub(in crate::service) fn of_this_server(kind: JobKind, maps: &[&str]) -> Self {
        let maps = maps.iter().map(|&map| map.to_owned()).collect();
        Self { kind, maps, task: None, begun: Begun::Now }
    }
}

impl Task {
    /// `None` if it is of a later server.
    pub(in crate::service) fn from_json(json: &str) -> Option<Self> {
        serde_json::from_str(json).ok()
    }

    pub(in crate::service) fn asked_by(&self) -> Option<&str> {
        match self {
            Self::CompactMap { asked_by, .. }
            | Self::RebuildMap { asked_by, .. }
            | Self::RepairMap { asked_by, .. }
            | Self::SearchMerge { asked_by, .. } => asked_by.as_deref(),
        }
    }

    pub(super) fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_else(|_| unreachable!("names and numbers are JSON"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::merge_request::CommitPolicy;

    /// What is in databases is read by later servers.
    #[test]
    fn tasks_are_written_as_they_were() {
        let request = MergeRequest {
            sources: vec!["maps/a".to_owned(), "maps/b".to_owned()],
            target: "maps/c".to_owned(),
            commit_policy: CommitPolicy::Automatic,
            min_support: Some(3),
        };
        let asked_by = Some("fleet".to_owned());
        for (task, json) in [
            (
                Task::CompactMap { map: "maps/a".to_owned(), asked_by: None },
                r#"{"compact_map":{"map":"maps/a","asked_by":null}}"#,
            ),
            (
                Task::RebuildMap {
                    map: "maps/a".to_owned(),
                    model: "models/7".to_owned(),
                    into: "b".to_owned(),
                    asked_by: None,
                },
                r#"{"rebuild_map":{"map":"maps/a","model":"models/7","into":"b","asked_by":null}}"#,
            ),
            (
                Task::SearchMerge { merge: 4, request, asked_by },
                r#"{"search_merge":{"merge":4,"request":{"sources":["maps/a","maps/b"],"target":"maps/c","commit_policy":"automatic","min_support":3},"asked_by":"fleet"}}"#,
            ),
        ] {
            assert_eq!(task.to_json(), json);
            assert_eq!(Task::from_json(json), Some(task));
        }
        for other in [
            r#"{"of_a_later_server":{}}"#,
            r#"{"compact_map":{"map":"maps/a","asked_by":null,"twice":true}}"#,
        ] {
            assert_eq!(Task::from_json(other), None);
        }
    }
}
