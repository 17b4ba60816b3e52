//! What a server writes for, step by step: each step is acknowledged, and is whole or not at all.

use std::io::Cursor;
use std::time::Duration;

use waypost_client::v1::merge::State as MergeState;
use waypost_client::v1::trim_map_request::Mode;
use waypost_client::{Client, Code, Error, FrameOutcome, Reconnection, SessionOptions, v1};

use super::template::{BASE, OTHER, ROTTEN};
use crate::harness::{
    as_histogram, followed, frame, import_model, in_time, map_request, recalibrated_model, refused,
    session_options, words_options,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Operation {
    Frames,
    Images,
    Model,
    Maps,
    Import,
    Compact,
    MergeIntoNew,
    MergeIntoOne,
    Undo,
    Trim,
    RemoveSession,
    DeleteMap,
    Rebuild,
    Repair,
    Rebind,
    Labels,
    Tokens,
    Corrections,
    /// SIGTERM: maps are checkpointed and the log is folded in.
    Stop,
}

pub(super) const OPERATIONS: [Operation; 19] = [
    Operation::Frames,
    Operation::Images,
    Operation::Model,
    Operation::Maps,
    Operation::Import,
    Operation::Compact,
    Operation::MergeIntoNew,
    Operation::MergeIntoOne,
    Operation::Undo,
    Operation::Trim,
    Operation::RemoveSession,
    Operation::DeleteMap,
    Operation::Rebuild,
    Operation::Repair,
    Operation::Rebind,
    Operation::Labels,
    Operation::Tokens,
    Operation::Corrections,
    Operation::Stop,
];

/// What was made ready before anything may be killed.
#[derive(Debug, Default)]
pub(super) struct Prepared {
    snapshot: Vec<u8>,
    merge: String,
    correction: Option<String>,
    session: Option<(waypost_client::FrameSender, waypost_client::Outcomes)>,
    /// The job that the last step waits for.
    pub(super) job: Option<String>,
}

/// A step came to nothing: the server is gone, or refused it.
#[derive(Debug)]
pub(super) struct Broken(pub(super) String);

impl From<Error> for Broken {
    fn from(error: Error) -> Self {
        Self(error.to_string())
    }
}

impl Operation {
    pub(super) fn steps(self) -> u64 {
        match self {
            Self::Frames => 10,
            Self::Images => 5,
            Self::Maps | Self::Labels | Self::Tokens => 4,
            Self::Corrections => 2,
            Self::Stop => 0,
            Self::Model
            | Self::Import
            | Self::Compact
            | Self::MergeIntoNew
            | Self::MergeIntoOne
            | Self::Undo
            | Self::Trim
            | Self::RemoveSession
            | Self::DeleteMap
            | Self::Rebuild
            | Self::Repair
            | Self::Rebind => 1,
        }
    }

    /// What may be there without having been acknowledged as a whole: a map that was made for a job that nobody had noted yet.
    pub(super) fn partial_map(self) -> Option<&'static str> {
        match self {
            Self::Rebuild => Some("rebuilt"),
            Self::Repair => Some("repaired"),
            _ => None,
        }
    }

    pub(super) async fn prepare(self, client: &Client) -> Prepared {
        let mut prepared = Prepared::default();
        match self {
            Self::Frames => {
                prepared.session = Some(opened(client, words_options("drive", "killed")).await);
            }
            Self::Images => {
                prepared.session = Some(opened(client, session_options(BASE, "killed")).await);
            }
            Self::Import => {
                client.export_map(BASE, &mut prepared.snapshot).await.unwrap();
            }
            Self::MergeIntoNew => prepared.merge = proposed(client, &[BASE, OTHER], "joined").await,
            Self::MergeIntoOne => prepared.merge = proposed(client, &[OTHER], BASE).await,
            Self::Undo => {
                prepared.merge = proposed(client, &[OTHER], BASE).await;
                let merge = client.commit_merge(&prepared.merge).await.unwrap();
                let done = followed(client, &client.job(&merge.job).await.unwrap()).await;
                assert_eq!(done.last().unwrap().state(), v1::job::State::Succeeded, "{done:?}");
            }
            Self::Repair => {
                // Somebody meets the damage, and the server notes it.
                let looked = client.frame_picture(&format!("maps/{OTHER}/{ROTTEN}"), Some(0)).await;
                assert_eq!(refused(looked).0, Code::DataLoss);
            }
            Self::Model
            | Self::Maps
            | Self::Compact
            | Self::Trim
            | Self::RemoveSession
            | Self::DeleteMap
            | Self::Rebuild
            | Self::Rebind
            | Self::Labels
            | Self::Tokens
            | Self::Corrections
            | Self::Stop => {}
        }
        prepared
    }

    /// Does step number `step`, from 0, and waits until it is acknowledged.
    pub(super) async fn step(
        self,
        client: &Client,
        prepared: &mut Prepared,
        step: u64,
    ) -> Result<(), Broken> {
        match self {
            Self::Frames | Self::Images => {
                let (sender, outcomes) = prepared.session.as_mut().unwrap();
                let next = if self == Self::Frames { as_histogram(step + 1) } else { frame(50 + step) };
                sender.send(next).await?;
                match in_time(outcomes.next()).await? {
                    Some(FrameOutcome::Answer(_)) => Ok(()),
                    other => Err(Broken(format!("{other:?}"))),
                }
            }
            Self::Model => {
                let bytes = recalibrated_model(0.5).to_bytes();
                Ok(client.import_model("recalibrated", Cursor::new(bytes)).await.map(drop)?)
            }
            Self::Maps => {
                let model = import_model(client).await.name;
                Ok(client.create_map(map_request(&format!("made-{step}"), &model)).await.map(drop)?)
            }
            Self::Import => {
                let job = client.import_map("copy", Cursor::new(prepared.snapshot.clone())).await?;
                succeeded(client, prepared, &job.name).await
            }
            Self::Compact => {
                let job = client.compact_map(BASE).await?;
                succeeded(client, prepared, &job.name).await
            }
            Self::MergeIntoNew | Self::MergeIntoOne => {
                let merge = client.commit_merge(&prepared.merge).await?;
                succeeded(client, prepared, &merge.job).await
            }
            Self::Undo => {
                let merge = client.undo_merge(&prepared.merge).await?;
                succeeded(client, prepared, &merge.job).await
            }
            Self::Trim => {
                let name = format!("maps/{BASE}");
                let trim = v1::TrimMapRequest { name, max_places: 8, mode: Mode::Apply.into() };
                Ok(client.trim_map(trim).await.map(drop)?)
            }
            Self::RemoveSession => {
                let job = client.delete_session(&format!("maps/{BASE}/sessions/b")).await?;
                succeeded(client, prepared, &job.name).await
            }
            Self::DeleteMap => Ok(client.delete_map(OTHER).await?),
            Self::Rebuild => {
                let job = client.rebuild_map(OTHER, &model_named(client, "second").await?, "rebuilt").await?;
                succeeded(client, prepared, &job.name).await
            }
            Self::Repair => {
                let job = client.repair_map(OTHER, "repaired", None).await?;
                succeeded(client, prepared, &job.name).await
            }
            Self::Rebind => {
                let model = model_named(client, "second").await?;
                Ok(client.rebind_map(BASE, &model).await.map(drop)?)
            }
            Self::Labels if step == 3 => Ok(client.delete_label(&format!("maps/{BASE}/places/1")).await?),
            Self::Labels => {
                let (place, label) = (format!("maps/{BASE}/places/{step}"), format!("room {step}"));
                Ok(client.set_label(&place, &label, v1::LabelScope::Place).await.map(drop)?)
            }
            Self::Tokens => tokens(client, step).await,
            Self::Corrections if step == 0 => {
                let frame_of = |sequence: u64| format!("maps/{BASE}/sessions/a/frames/{sequence}");
                let said = client.confirm_loop_closure(&frame_of(9), &frame_of(2)).await?;
                prepared.correction = Some(said.name);
                Ok(())
            }
            Self::Corrections => {
                let said = prepared.correction.clone().unwrap();
                Ok(client.undo_correction(&said).await.map(drop)?)
            }
            Self::Stop => Ok(()),
        }
    }
}

/// A session that gives up soon: nobody starts its server again.
async fn opened(
    client: &Client,
    options: SessionOptions,
) -> (waypost_client::FrameSender, waypost_client::Outcomes) {
    let reconnection = Reconnection { give_up_after: Duration::from_millis(500), ..Reconnection::default() };
    client.open_session(SessionOptions { reconnection, ..options }).await.unwrap().split()
}

async fn tokens(client: &Client, step: u64) -> Result<(), Broken> {
    let name = "tokens/cart".to_owned();
    let quotas = Some(v1::Quotas { max_sessions: Some(3), ..Default::default() });
    match step {
        0 => client.create_token("cart", v1::token::Role::Robot).await.map(drop)?,
        1 => client
            .update_token(v1::UpdateTokenRequest { name, quotas, lifted: Vec::new() })
            .await
            .map(drop)?,
        2 => client.rotate_token(v1::RotateTokenRequest { name, ..Default::default() }).await.map(drop)?,
        _ => client.delete_token("cart").await?,
    }
    Ok(())
}

async fn model_named(client: &Client, display_name: &str) -> Result<String, Broken> {
    let models = client.models().await?;
    let named = models.into_iter().find(|model| model.display_name == display_name);
    Ok(named.expect("the template has it").name)
}

/// Waits for a job, which is to do what it was asked for.
async fn succeeded(client: &Client, prepared: &mut Prepared, job: &str) -> Result<(), Broken> {
    prepared.job = Some(job.to_owned());
    let mut steps = client.watch_job(job).await?;
    let mut last = None;
    while let Some(step) = in_time(steps.next()).await? {
        last = Some(step);
    }
    match last {
        Some(job) if job.state() == v1::job::State::Succeeded => Ok(()),
        other => Err(Broken(format!("{other:?}"))),
    }
}

/// The name of a merge that waits for somebody to decide.
async fn proposed(client: &Client, sources: &[&str], target: &str) -> String {
    let request = v1::MergeMapsRequest {
        sources: sources.iter().map(|map| format!("maps/{map}")).collect(),
        target: format!("maps/{target}"),
        auto_commit: false,
        min_support: Some(3),
    };
    let merge = client.merge_maps(request).await.unwrap();
    followed(client, &client.job(&merge.job).await.unwrap()).await;
    let merge = client.merge(&merge.name).await.unwrap();
    assert_eq!(merge.state(), MergeState::Proposed, "{merge:?}");
    merge.name
}
