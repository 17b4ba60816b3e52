use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tokio_stream::wrappers::WatchStream;
use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::job_service_server::JobService;

use super::Adapter;
use super::reach::with_caller;
use crate::error::ServiceError;
use crate::pages::Page;
use crate::service::jobs::JobState;
use crate::wire::jobs::job;

#[tonic::async_trait]
impl JobService for Adapter {
    async fn list_jobs(
        &self,
        request: Request<v1::ListJobsRequest>,
    ) -> Result<Response<v1::ListJobsResponse>, Status> {
        let (caller, v1::ListJobsRequest { page_size, page_token }) = with_caller(request)?;
        let Page { items, next } = self.service.jobs.list(&caller, page_size, &page_token).await?;
        let jobs = items.into_iter().map(job).collect();
        Ok(Response::new(v1::ListJobsResponse { jobs, next_page_token: next }))
    }

    async fn get_job(&self, request: Request<v1::GetJobRequest>) -> Result<Response<v1::Job>, Status> {
        let (caller, v1::GetJobRequest { name }) = with_caller(request)?;
        Ok(Response::new(job(self.service.jobs.get(&caller, &name).await?)))
    }

    type WatchJobStream = BoxStream<'static, Result<v1::Job, Status>>;

    async fn watch_job(
        &self,
        request: Request<v1::WatchJobRequest>,
    ) -> Result<Response<Self::WatchJobStream>, Status> {
        let (caller, v1::WatchJobRequest { name }) = with_caller(request)?;
        let statuses = WatchStream::new(self.service.jobs.watch(&caller, &name).await?);
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
        let (caller, v1::CancelJobRequest { name }) = with_caller(request)?;
        Ok(Response::new(job(self.service.jobs.cancel(&caller, &name).await?)))
    }
}
