//! Jobs as messages.

use waypost_proto::v1;

use super::status::as_message;
use crate::service::jobs::JobKind;
use crate::service::jobs::{JobState, JobStatus};

pub(crate) fn job(status: JobStatus) -> v1::Job {
    use v1::job::{Kind, State};
    let JobStatus { number, kind, state, stage, fraction, created_ns, ended_ns, maps: _ } = status;
    let (state, error, result) = match state {
        JobState::Running => (State::Running, None, None),
        JobState::Succeeded(result) => (State::Succeeded, None, Some(result)),
        JobState::Failed(error) => (State::Failed, Some(as_message(&error)), None),
        JobState::Cancelled => (State::Cancelled, None, None),
    };
    let kind = match kind {
        JobKind::TrainModel => Kind::TrainModel,
        JobKind::ImportMap => Kind::ImportMap,
        JobKind::MergeMaps => Kind::MergeMaps,
        JobKind::RemoveSessions => Kind::DeleteSessions,
        JobKind::RebuildMap => Kind::RebuildMap,
        JobKind::RepairMap => Kind::RepairMap,
        JobKind::CompactMap => Kind::CompactMap,
    };
    v1::Job {
        name: format!("jobs/{number}"),
        kind: kind.into(),
        state: state.into(),
        stage,
        fraction,
        error,
        result,
        create_time_ns: created_ns,
        end_time_ns: ended_ns,
    }
}
