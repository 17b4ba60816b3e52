use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tokio_stream::wrappers::WatchStream;
use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::job_service_server::JobService;

use super::Adapter;
use super::models::model;
use crate::error::ServiceError;
use crate::service::jobs::{JobState, JobStatus};

#[tonic::async_trait]
impl JobService for Adapter {
    async fn list_jobs(
        &self,
        _: Request<v1::ListJobsRequest>,
    ) -> Result<Response<v1::ListJobsResponse>, Status> {
        Err(Status::unimplemented("not yet"))
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> Result<Response<v1::Job>, Status> {
        let v1::GetJobRequest { name } = request.into_inner();
        Ok(Response::new(job(self.service.job(&name)?)))
    }

    type WatchJobStream = BoxStream<'static, Result<v1::Job, Status>>;

    async fn watch_job(
        &self,
        request: Request<v1::WatchJobRequest>,
    ) -> Result<Response<Self::WatchJobStream>, Status> {
        let v1::WatchJobRequest { name } = request.into_inner();
        let statuses = WatchStream::new(self.service.watch_job(&name)?);
        let stopping = self.service.stopping().clone();
        let stopped = stopping.clone();
        let stopped =
            stream::once(async move { stopped.is_cancelled().then(|| Err(ServiceError::stopping().into())) });
        // The watch goes on for as long as the job's last word has not been said.
        let until_the_end = statuses.scan(false, |ended, status| {
            let before = std::mem::replace(ended, status.state != JobState::Running);
            std::future::ready((!before).then_some(Ok(job(status))))
        });
        let statuses = until_the_end.take_until(stopping.cancelled_owned());
        Ok(Response::new(statuses.chain(stopped.filter_map(std::future::ready)).boxed()))
    }

    async fn cancel_job(&self, request: Request<v1::CancelJobRequest>) -> Result<Response<v1::Job>, Status> {
        let v1::CancelJobRequest { name } = request.into_inner();
        Ok(Response::new(job(self.service.cancel_job(&name)?)))
    }
}

pub(super) fn job(status: JobStatus) -> v1::Job {
    use v1::job::State;
    let JobStatus { number, state, stage, fraction } = status;
    let (state, error, made) = match state {
        JobState::Running => (State::Running, String::new(), None),
        JobState::Succeeded(made) => (State::Succeeded, String::new(), Some(model(*made))),
        JobState::Failed(error) => (State::Failed, error.to_string(), None),
        JobState::Cancelled => (State::Cancelled, String::new(), None),
    };
    v1::Job {
        name: format!("jobs/{number}"),
        state: state.into(),
        stage: stage.to_owned(),
        fraction,
        error,
        model: made,
        kind: 0,
        result: String::new(),
        create_time_ns: 0,
        end_time_ns: 0,
    }
}
