//! Long work that the owner of the database did not come to the end of: the next owner does.

use rustix::process::Signal;
use waypost_client::v1;

use super::owners::prepared;
use super::standbys::Fleet;
use crate::harness::{
    Cluster, answers, followed, frame, in_time, recalibrated_model, state_hash, take_model,
};

const FRAMES: u64 = 60;

/// Asked of a server in reserve, which hears of the end, too.
#[tokio::test(flavor = "multi_thread")]
async fn a_job_goes_on_with_the_next_owner() {
    let Some(cluster) = Cluster::running() else { return };
    for (signal, name) in [(Signal::KILL, "killed"), (Signal::TERM, "drained")] {
        let database = prepared(&cluster, &format!("jobs_{name}")).await;
        let fleet = Fleet::start(&database.url(), 2);
        let owner = fleet.owner().await;
        let other = 1 - owner;
        let client = fleet.client_in_time(other).await;
        let second = take_model(&client, "second", &recalibrated_model(0.5)).await.name;
        answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
        let whole = client.rebuild_map("drive", &second, "whole").await.unwrap();
        followed(&client, &whole).await;
        let job = client.rebuild_map("drive", &second, "anew").await.unwrap();
        let frames = async || client.map("anew", v1::MapView::Basic).await.map_or(0, |map| map.frames);
        in_time(async {
            while frames().await < 3 {
                tokio::time::sleep(std::time::Duration::from_millis(2)).await;
            }
        })
        .await;
        let before = client.job(&job.name).await.unwrap();
        assert_eq!(before.state(), v1::job::State::Running, "{name}: it was over before the owner went");
        fleet.signal(owner, signal);
        let ended = in_time(async {
            loop {
                // The database has no owner for a moment.
                let last = async {
                    let mut steps = client.watch_job(&job.name).await.ok()?;
                    let mut last = None;
                    while let Ok(Some(step)) = steps.next().await {
                        last = Some(step);
                    }
                    last
                };
                match last.await {
                    Some(job) if job.state() != v1::job::State::Running => return job,
                    Some(_) | None => tokio::time::sleep(std::time::Duration::from_millis(50)).await,
                }
            }
        })
        .await;
        assert_eq!(fleet.owner().await, other, "{name}");
        assert_eq!(ended.state(), v1::job::State::Succeeded, "{name}: {ended:?}");
        let client = fleet.client_in_time(other).await;
        assert_eq!(state_hash(&client, "anew").await, state_hash(&client, "whole").await, "{name}");
    }
}
