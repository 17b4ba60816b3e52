//! `waypost job`: long work of the server.

use std::pin::pin;
use std::time::Duration;

use clap::Subcommand;
use serde_json::json;
use tokio::sync::watch;
use tokio::time::{Instant, sleep, timeout};
use waypost_client::{Client, ClientOptions, Code, Error, JobProgress, v1};

use crate::failure::Failure;
use crate::names::numbered;
use crate::output::{Output, table};
use crate::progress;

/// How long an interrupted upload may take to end.
const STOPPING_TIMEOUT: Duration = Duration::from_secs(5);

/// How long a server that is away is waited for while a job is followed, and how often it is tried.
const PATIENCE: Duration = Duration::from_secs(60);
const AGAIN: Duration = Duration::from_millis(500);

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List jobs, newest first
    #[command(visible_alias = "list")]
    Ls,
    /// Show how far a job is
    #[command(visible_alias = "get")]
    Show {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
    /// Follow a job until it is done; Ctrl-C cancels it
    Watch {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
    /// Cancel a job
    Cancel {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    let full = |name: &str| numbered("jobs", name);
    let job = match command {
        Command::Ls => return list(&client.jobs().await?, output),
        Command::Show { name } => client.job(&full(&name)).await?,
        Command::Watch { name } => follow(&client, &full(&name), output).await?,
        Command::Cancel { name } => cancelled(client.cancel_job(&full(&name)).await?)?,
    };
    show(&job, output)
}

/// A job that was told to end; an error if it had ended before.
fn cancelled(job: v1::Job) -> Result<v1::Job, Failure> {
    match job.state() {
        v1::job::State::Succeeded | v1::job::State::Failed => Err(Failure::JobFailed(format!(
            "{} has ended already ({}); nothing was cancelled",
            job.name,
            job.state().json_name()
        ))),
        v1::job::State::Running | v1::job::State::Cancelled | v1::job::State::Unspecified => Ok(job),
    }
}

/// The job that an upload begins. The upload fails once `stop` is set, which Ctrl-C does; `undone` tells the user what
/// was not done then.
pub(crate) async fn begun_by(
    upload: impl Future<Output = Result<v1::Job, Error>>,
    stop: &watch::Sender<bool>,
    client: &Client,
    undone: &str,
) -> Result<v1::Job, Failure> {
    let mut upload = pin!(upload);
    tokio::select! {
        job = &mut upload => Ok(job?),
        interrupt = tokio::signal::ctrl_c() => {
            interrupt.map_err(Failure::Runtime)?;
            stop.send_replace(true);
            if let Ok(Ok(job)) = timeout(STOPPING_TIMEOUT, upload).await {
                // It was complete already.
                client.cancel_job(&job.name).await?;
            }
            Err(Failure::Interrupted(format!("upload stopped; {undone}")))
        }
    }
}

pub(crate) fn show(job: &v1::Job, output: Output) -> Result<(), Failure> {
    output.result(job, |out| {
        writeln!(out, "{} {} {}", job.name, job.kind().json_name(), job.state().json_name())?;
        match (&job.error, &job.result) {
            (Some(error), _) => writeln!(out, "  error   {}", error.message),
            (None, Some(result)) => writeln!(out, "  result  {result}"),
            (None, None) => writeln!(out, "  stage   {}, {:.0}%", job.stage, job.fraction * 100.0),
        }
    })
}

fn list(jobs: &[v1::Job], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "jobs": jobs }), |out| {
        let rows = jobs.iter().map(|job| {
            let detail = match (&job.result, &job.error) {
                (Some(result), _) => result.clone(),
                (None, Some(error)) => error.message.clone(),
                (None, None) => format!("{}, {:.0}%", job.stage, job.fraction * 100.0),
            };
            [job.name.clone(), job.kind().json_name().to_owned(), job.state().json_name().to_owned(), detail]
        });
        table(out, ["JOB", "KIND", "STATE", "RESULT"], rows)
    })
}

/// The result of a job that succeeded, as in `maps/office`.
pub(crate) fn result(job: v1::Job) -> Result<String, Failure> {
    job.result.ok_or_else(|| Failure::JobFailed(format!("{} succeeded without a result", job.name)))
}

/// Shows a job's progress until it has succeeded.
pub(crate) async fn follow(client: &Client, name: &str, output: Output) -> Result<v1::Job, Failure> {
    let mut steps = Steps::watch(client, name).await?;
    let bar = progress::percentage(output);
    let mut cancelled_here = false;
    loop {
        let step = tokio::select! {
            step = steps.next() => step?,
            interrupt = tokio::signal::ctrl_c(), if !cancelled_here => {
                interrupt.map_err(Failure::Runtime)?;
                bar.set_message("cancelling");
                cancelled_here = true;
                cancel(client, name).await?;
                continue;
            }
        };
        let Some(job) = step else {
            return Err(Failure::JobFailed(format!("the server stopped telling about {name}; ask again")));
        };
        match job.state() {
            v1::job::State::Running | v1::job::State::Unspecified => {
                bar.set_message(job.stage);
                bar.set_position((job.fraction * 100.0) as u64);
            }
            v1::job::State::Succeeded => {
                bar.finish_and_clear();
                return Ok(job);
            }
            v1::job::State::Failed => return Err(Failure::JobFailed(job.error.unwrap_or_default().message)),
            v1::job::State::Cancelled => {
                return Err(Failure::Interrupted(format!("{name} was cancelled; nothing was changed")));
            }
        }
    }
}

/// Cancels a job that is followed.
async fn cancel(client: &Client, name: &str) -> Result<(), Failure> {
    match client.cancel_job(name).await {
        Err(error) if is_away(&error) => Err(Failure::Interrupted(format!(
            "the server is away; {name} goes on when it is back: cancel it then by `waypost job cancel {name}`"
        ))),
        cancelled => Ok(cancelled.map(drop)?),
    }
}

/// The progress of a job, also of one with which another server goes on meanwhile.
struct Steps<'a> {
    client: &'a Client,
    name: &'a str,
    /// None while the server is away.
    progress: Option<JobProgress>,
    away_since: Option<Instant>,
}

impl<'a> Steps<'a> {
    async fn watch(client: &'a Client, name: &'a str) -> Result<Self, Error> {
        let progress = Some(client.watch_job(name).await?);
        Ok(Self { client, name, progress, away_since: None })
    }

    async fn next(&mut self) -> Result<Option<v1::Job>, Error> {
        loop {
            match self.step().await {
                Err(error) if is_away(&error) => {
                    self.progress = None;
                    if self.away_since.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
                        return Err(error);
                    }
                    sleep(AGAIN).await;
                }
                step => {
                    self.away_since = None;
                    return step;
                }
            }
        }
    }

    async fn step(&mut self) -> Result<Option<v1::Job>, Error> {
        let progress = match &mut self.progress {
            Some(progress) => progress,
            progress @ None => progress.insert(self.client.watch_job(self.name).await?),
        };
        progress.next().await
    }
}

/// Whether the server may be back in a moment. UNKNOWN stands for a stream that was cut off without a status.
fn is_away(error: &Error) -> bool {
    matches!(error, Error::Connection { .. } | Error::Status { code: Code::Unavailable | Code::Unknown, .. })
}
