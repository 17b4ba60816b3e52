//! Jobs: long work of the server.

use tonic::Streaming;
use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE};
use crate::error::Error;

impl Client {
    /// All jobs, newest first, except those that ended more than 30 days ago.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn jobs(&self) -> Call<'_, Vec<v1::Job>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListJobsRequest { page_size: PAGE_SIZE, page_token };
                let page = self.jobs_client().list_jobs(request).await?.into_inner();
                Ok((page.jobs, page.next_page_token))
            })
            .await
        })
    }

    /// The state of a job (`jobs/{number}`).
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn job<'a>(&'a self, name: &'a str) -> Call<'a, v1::Job> {
        Box::pin(async move {
            self.taken(self.jobs_client().get_job(v1::GetJobRequest { name: name.to_owned() }).await)
        })
    }

    /// Follows a job until it has ended. Where the server ends first, follow it again: many jobs go on with the next one.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn watch_job<'a>(&'a self, name: &'a str) -> Call<'a, JobProgress> {
        Box::pin(async move {
            let request = v1::WatchJobRequest { name: name.to_owned() };
            let jobs = self.taken(self.jobs_client().watch_job(request).await)?;
            Ok(JobProgress { jobs, endpoint: self.endpoint().to_owned() })
        })
    }

    /// Cancels a job; it stops at its next step.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND.
    pub fn cancel_job<'a>(&'a self, name: &'a str) -> Call<'a, v1::Job> {
        Box::pin(async move {
            self.taken(self.jobs_client().cancel_job(v1::CancelJobRequest { name: name.to_owned() }).await)
        })
    }
}

/// The progress of a job, until it has ended.
#[derive(Debug)]
pub struct JobProgress {
    jobs: Streaming<v1::Job>,
    endpoint: String,
}

impl JobProgress {
    /// Waits for the next progress of the job; none after its last state.
    ///
    /// # Errors
    /// [`Error::Connection`] if the connection broke: the job may still be running.
    pub async fn next(&mut self) -> Result<Option<v1::Job>, Error> {
        self.jobs.message().await.map_err(|status| Error::from_status(&status, &self.endpoint))
    }
}
