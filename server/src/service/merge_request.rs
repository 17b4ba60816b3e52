//! What is asked for when maps are to become one.

use serde::{Deserialize, Serialize};

/// When a merge whose overlap was found is committed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum CommitPolicy {
    /// It is proposed, and a person decides.
    OnRequest,
    Automatic,
}

/// Maps that are to become one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MergeRequest {
    /// `maps/{map}` each.
    pub(crate) sources: Vec<String>,
    /// `maps/{map}`; made of the first source if there is no such map.
    pub(crate) target: String,
    pub(crate) commit_policy: CommitPolicy,
    /// Least matches that agree with each other; the default if `None`.
    pub(crate) min_support: Option<u32>,
}
