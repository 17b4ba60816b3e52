//! `waypost job`: work at the server that takes long.

use clap::Subcommand;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use crate::failure::Failure;
use crate::output::{Output, table};
use crate::progress;
use crate::views::JobView;

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List jobs, newest first
    #[command(visible_alias = "list")]
    Ls,
    /// Show how far a job is
    Show {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
    /// Follow a job until it is done; Ctrl-C cancels it
    Watch {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
    /// Ask a job to stop
    Cancel {
        /// As printed when it was started, as in `jobs/1`
        name: String,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    let job = match command {
        Command::Ls => return list(client.jobs().await?, output),
        Command::Show { name } => client.job(&name).await?,
        Command::Watch { name } => follow(&client, &name, output).await?,
        Command::Cancel { name } => client.cancel_job(&name).await?,
    };
    show(job, output)
}

pub(crate) fn show(job: v1::Job, output: Output) -> Result<(), Failure> {
    let view = JobView::from(job);
    output.result(&view, |out| {
        let JobView { name, kind, state, stage, fraction, error, result, .. } = &view;
        writeln!(out, "{name} {kind} {state}")?;
        match (error.as_str(), result) {
            ("", Some(result)) => writeln!(out, "  result  {result}"),
            ("", None) => writeln!(out, "  stage   {stage}, {:.0}%", fraction * 100.0),
            (error, _) => writeln!(out, "  error   {error}"),
        }
    })
}

fn list(jobs: Vec<v1::Job>, output: Output) -> Result<(), Failure> {
    let jobs: Vec<JobView> = jobs.into_iter().map(JobView::from).collect();
    output.result(&json!({ "jobs": jobs }), |out| {
        let rows = jobs.iter().map(|job| {
            let detail = match (&job.result, job.error.as_str()) {
                (Some(result), _) => result.clone(),
                (None, "") => format!("{}, {:.0}%", job.stage, job.fraction * 100.0),
                (None, error) => error.to_owned(),
            };
            [job.name.clone(), job.kind.to_owned(), job.state.to_owned(), detail]
        });
        table(out, ["JOB", "KIND", "STATE", "RESULT"], rows)
    })
}

/// Shows a job's progress until it has succeeded.
pub(crate) async fn follow(client: &Client, name: &str, output: Output) -> Result<v1::Job, Failure> {
    let mut steps = client.watch_job(name).await?;
    let bar = progress::percentage(output);
    let mut cancelled_here = false;
    loop {
        let step = tokio::select! {
            step = steps.next() => step?,
            interrupt = tokio::signal::ctrl_c(), if !cancelled_here => {
                interrupt.map_err(Failure::Runtime)?;
                bar.set_message("cancelling");
                cancelled_here = true;
                client.cancel_job(name).await?;
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
            v1::job::State::Failed => return Err(Failure::JobFailed(job.error)),
            v1::job::State::Cancelled => {
                return Err(Failure::Interrupted(format!("{name} was cancelled; nothing was changed")));
            }
        }
    }
}
