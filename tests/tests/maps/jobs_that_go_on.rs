//! Jobs that a server did not come to the end of: the next one does.

use std::path::Path;

use futures::stream;
use tempfile::TempDir;
use waypost_client::{Client, ClientOptions, v1};
use waypost_server::Role;
use waypost_server::offline::{TokenLimits, create_token};

use crate::harness::{
    Built, Proxy, Server, ServerProcess, Template, answers, followed, frame, images, import_model, in_time,
    map_request, recalibrated_model, run_to_its_end, said, state_hash, tables, take_model,
};

const FRAMES: u64 = 60;

/// The second model's name.
const SECOND: &str = "second";

/// How a server goes down.
#[derive(Clone, Copy, Debug)]
enum Down {
    Killed,
    Stopped,
}

impl Down {
    async fn happens(self, server: ServerProcess) {
        let end = move || match self {
            Self::Killed => server.kill(),
            Self::Stopped => server.stop(),
        };
        tokio::task::spawn_blocking(end).await.unwrap();
    }
}

/// Two maps that overlap, and a second model with their words.
static PREPARED: Template = Template::new();

/// A data directory with them.
struct Prepared {
    directory: TempDir,
}

impl Prepared {
    async fn new() -> Self {
        let make = async |directory: &Path| {
            let server = Server::start_on(directory).await;
            let client = server.client().await;
            let model = import_model(&client).await;
            take_model(&client, SECOND, &recalibrated_model(0.5)).await;
            for map in ["drive", "other"] {
                client.create_map(map_request(map, &model.name)).await.unwrap();
            }
            answers(&client, "drive", "robot", (1..=FRAMES).map(frame)).await;
            answers(&client, "drive", "second", (60..=64).map(frame)).await;
            answers(&client, "other", "robot", (1..=22).map(frame)).await;
            let whole = client.rebuild_map("drive", SECOND, "whole").await.unwrap();
            succeeded(&client, &whole).await;
            server.stop().await;
        };
        Self { directory: PREPARED.directory(make).await }
    }

    fn start(&self) -> ServerProcess {
        ServerProcess::start(self.directory.path())
    }
}

/// Waits for a job, which does what it was asked for.
async fn succeeded(client: &Client, job: &v1::Job) {
    let ended = followed(client, job).await.pop().unwrap();
    assert_eq!(ended.state(), v1::job::State::Succeeded, "{ended:?}");
    assert_eq!((&ended.name, ended.create_time_ns), (&job.name, job.create_time_ns));
}

/// A training of many seconds, behind which other jobs wait.
async fn long_training(client: &Client) -> v1::Job {
    let settings = v1::TrainModelSettings {
        display_name: String::new(),
        extractor: Some(String::new()),
        words: 4000,
        seed: 7,
        image_count: Some(40),
    };
    let images = stream::iter(images()[..40].iter().cloned().map(Ok));
    in_time(client.train_model(settings, images)).await.unwrap()
}

#[derive(Clone, Copy, PartialEq)]
enum OnceFound {
    Propose,
    Commit,
}

fn to_merge(target: &str, once_found: OnceFound) -> v1::MergeMapsRequest {
    v1::MergeMapsRequest {
        sources: vec!["maps/drive".to_owned(), "maps/other".to_owned()],
        target: format!("maps/{target}"),
        auto_commit: once_found == OnceFound::Commit,
        min_support: Some(3),
    }
}

/// Those that had not begun.
#[tokio::test(flavor = "multi_thread")]
async fn jobs_that_waited_for_their_turn_are_done_by_the_next_server() {
    for down in [Down::Killed, Down::Stopped] {
        let prepared = Prepared::new().await;
        let server = prepared.start();
        let client = server.client().await;
        let training = long_training(&client).await;
        let rebuilding = client.rebuild_map("drive", SECOND, "anew").await.unwrap();
        let merge = client.merge_maps(to_merge("both", OnceFound::Commit)).await.unwrap();
        let merging = client.job(&merge.job).await.unwrap();
        let looked_for = client.merge_maps(to_merge("perhaps", OnceFound::Propose)).await.unwrap();
        let searching = client.job(&looked_for.job).await.unwrap();
        let compacting = client.compact_map("drive").await.unwrap();
        let unwanted = client.compact_map("other").await.unwrap();
        let removing = client.delete_session("maps/drive/sessions/second").await.unwrap();
        assert_eq!(client.job(&training.name).await.unwrap().state(), v1::job::State::Running, "{down:?}");
        // Somebody thinks again, and the next server does not do it all the same.
        client.cancel_job(&unwanted.name).await.unwrap();
        down.happens(server).await;

        let server = prepared.start();
        let client = server.client().await;
        for job in [&rebuilding, &merging, &searching, &compacting] {
            succeeded(&client, job).await;
        }
        // A server that is killed may not have noted yet that it was cancelled.
        let state = client.job(&unwanted.name).await.unwrap().state();
        assert!(matches!(state, v1::job::State::Cancelled | v1::job::State::Failed), "{down:?}: {state:?}");
        // What came in a stream is gone, and with it what was to be made of it. What gives places other numbers is asked
        // for again by who knows that no robot is on its way to one of them.
        for job in [&training, &removing] {
            let cut_off = client.job(&job.name).await.unwrap();
            assert_eq!(cut_off.state(), v1::job::State::Failed, "{down:?}: {cut_off:?}");
            assert!(said(&cut_off.error).contains("start it again"), "{down:?}: {cut_off:?}");
        }
        assert_eq!(client.sessions("drive").await.unwrap().len(), 2, "{down:?}");
        assert_eq!(state_hash(&client, "anew").await, state_hash(&client, "whole").await, "{down:?}");
        let merge = client.merge(&merge.name).await.unwrap();
        assert_eq!(merge.state(), v1::merge::State::Committed, "{down:?}: {merge:?}");
        let both = client.map("both", v1::MapView::Full).await.unwrap();
        assert_eq!(both.frames, FRAMES + 5 + 22, "{down:?}");
        // A proposal of this server's, which can be committed.
        let committed = client.commit_merge(&looked_for.name).await.unwrap();
        succeeded(&client, &client.job(&committed.job).await.unwrap()).await;
        assert_eq!(state_hash(&client, "perhaps").await, state_hash(&client, "both").await, "{down:?}");
        server.stop();
    }
}

/// One that has begun goes on where it was; whoever follows it on the command line hears of its end.
#[tokio::test(flavor = "multi_thread")]
async fn a_job_in_the_middle_goes_on_and_is_followed() {
    for down in [Down::Killed, Down::Stopped] {
        let prepared = Prepared::new().await;
        let server = prepared.start();
        let proxy = Proxy::start().await;
        proxy.forward_to(Some(server.grpc()));
        let mut rebuild = Built::command("waypost");
        let arguments = ["map", "rebuild", "drive", "--model", "second", "--into", "anew", "--json"];
        rebuild.args(arguments).args(["--server", &proxy.endpoint()]);
        let rebuild = tokio::task::spawn_blocking(move || run_to_its_end(rebuild));
        let client = server.client().await;
        let frames = async || client.map("anew", v1::MapView::Basic).await.map_or(0, |map| map.frames);
        in_time(async {
            while frames().await < 3 {
                tokio::time::sleep(std::time::Duration::from_millis(2)).await;
            }
        })
        .await;
        let job = client.jobs().await.unwrap().remove(0);
        assert_eq!(job.state(), v1::job::State::Running, "{down:?}: it was over before the server went down");
        proxy.forward_to(None);
        proxy.cut();
        down.happens(server).await;

        let server = prepared.start();
        proxy.forward_to(Some(server.grpc()));
        let ended = in_time(rebuild).await.unwrap();
        assert!(ended.status.success(), "{down:?}: {}", String::from_utf8_lossy(&ended.stderr));
        let told: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
        assert_eq!(told["map"]["name"], "maps/anew", "{down:?}: {told}");
        let client = server.client().await;
        assert_eq!(client.jobs().await.unwrap().len(), 2, "{down:?}: it was started again by hand");
        assert_eq!(state_hash(&client, "anew").await, state_hash(&client, "whole").await, "{down:?}");
        server.stop();
    }
}

/// As if the server had ended in the middle of the last job.
async fn cut_off(directory: &Path, change: &str) {
    let mut database = tables(directory).await;
    let last = format!(
        "UPDATE jobs SET state = 'running', ended_ns = NULL, result = NULL{change} \
         WHERE number = (SELECT max(number) FROM jobs)"
    );
    sqlx::query(sqlx::AssertSqlSafe(last)).execute(&mut database).await.unwrap();
}

/// Those with which nobody can go on say why.
#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_cannot_go_on_has_failed_and_says_why() {
    let prepared = Prepared::new().await;
    let secrets = {
        let mut secrets = Vec::new();
        for name in ["operator", "fleet"] {
            let directory = prepared.directory.path().into();
            secrets.push(create_token(directory, name, Role::Admin, TokenLimits::default()).await.unwrap());
        }
        secrets
    };
    let started = async |secret: &str| {
        let server = Server::start_on(prepared.directory.path()).await;
        let options = ClientOptions::new(server.endpoint()).with_token(secret);
        let client = Client::connect(options).await.unwrap();
        (server, client)
    };
    let (server, client) = started(&secrets[1]).await;
    let job = client.rebuild_map("drive", SECOND, "anew").await.unwrap();
    succeeded(&client, &job).await;
    server.stop().await;
    for (change, why) in [
        (", begun = 5", "5 servers were killed, or crashed, while they worked on this job"),
        (", task = '{\"of_a_later_server\":{}}', begun = 0", "does not know what it was asked for"),
        (", task = NULL", "the server was stopped or restarted"),
    ] {
        cut_off(prepared.directory.path(), change).await;
        let (server, client) = started(&secrets[0]).await;
        let ended = followed(&client, &job).await.pop().unwrap();
        assert_eq!(ended.state(), v1::job::State::Failed, "{why}: {ended:?}");
        assert!(
            said(&ended.error).contains(why) && said(&ended.error).contains("start it again"),
            "{ended:?}"
        );
        server.stop().await;
    }

    // Who asked for it is gone, or what it is about.
    let (server, client) = started(&secrets[1]).await;
    let job = client.rebuild_map("drive", SECOND, "anew").await.unwrap();
    succeeded(&client, &job).await;
    drop(client);
    server.stop().await;
    let (server, client) = started(&secrets[0]).await;
    client.delete_token("fleet").await.unwrap();
    server.stop().await;
    cut_off(prepared.directory.path(), "").await;
    let (server, client) = started(&secrets[0]).await;
    let ended = followed(&client, &job).await.pop().unwrap();
    assert!(said(&ended.error).contains("the token by which this job was asked for is gone"), "{ended:?}");
    let job = client.compact_map("anew").await.unwrap();
    succeeded(&client, &job).await;
    client.delete_map("anew").await.unwrap();
    server.stop().await;
    cut_off(prepared.directory.path(), "").await;
    let (server, client) = started(&secrets[0]).await;
    let ended = followed(&client, &job).await.pop().unwrap();
    assert!(said(&ended.error).contains("there is no map anew"), "{ended:?}");
    server.stop().await;
}

/// A job that takes its servers with it does not do so for ever; one that only waits, or whose servers are stopped, is not
/// taken for such.
#[tokio::test(flavor = "multi_thread")]
async fn servers_that_are_killed_at_a_job_are_counted() {
    let prepared = Prepared::new().await;
    let beginnings = async || {
        let mut database = tables(prepared.directory.path()).await;
        sqlx::query_scalar::<_, i64>("SELECT begun FROM jobs ORDER BY number")
            .fetch_all(&mut database)
            .await
            .unwrap()
    };
    let server = prepared.start();
    let client = server.client().await;
    let rebuilding = client.rebuild_map("drive", SECOND, "anew").await.unwrap();
    let waiting = client.compact_map("other").await.unwrap();
    in_time(async {
        while client.map("anew", v1::MapView::Basic).await.map_or(0, |map| map.frames) < 3 {
            tokio::time::sleep(std::time::Duration::from_millis(2)).await;
        }
    })
    .await;
    assert_eq!(client.job(&rebuilding.name).await.unwrap().state(), v1::job::State::Running);
    Down::Stopped.happens(server).await;
    assert_eq!(beginnings().await[1..], [0, 0]);
    let server = prepared.start();
    in_time(async {
        while beginnings().await[1] == 0 {
            tokio::time::sleep(std::time::Duration::from_millis(2)).await;
        }
    })
    .await;
    Down::Killed.happens(server).await;
    assert_eq!(beginnings().await[1..], [1, 0]);
    let server = prepared.start();
    let client = server.client().await;
    for job in [&rebuilding, &waiting] {
        succeeded(&client, job).await;
    }
    server.stop();
}

/// A copy of a data directory is what there was then; nothing that was being done goes on in it.
#[tokio::test(flavor = "multi_thread")]
async fn jobs_do_not_go_on_in_a_backup() {
    let prepared = Prepared::new().await;
    let server = prepared.start();
    let client = server.client().await;
    long_training(&client).await;
    let compacting = client.compact_map("drive").await.unwrap();
    let copies = tempfile::tempdir().unwrap();
    let (copy, restored) = (copies.path().join("copy"), copies.path().join("restored"));
    for [verb, directory, data_dir] in [
        ["backup", copy.to_str().unwrap(), prepared.directory.path().to_str().unwrap()],
        ["restore", copy.to_str().unwrap(), restored.to_str().unwrap()],
    ] {
        let mut command = Built::command("waypost-server");
        command.args([verb, directory, "--data-dir", data_dir]);
        let ended = tokio::task::spawn_blocking(move || run_to_its_end(command)).await.unwrap();
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    }
    let other = ServerProcess::start(&restored);
    let ended = other.client().await.job(&compacting.name).await.unwrap();
    assert_eq!(ended.state(), v1::job::State::Failed, "{ended:?}");
    server.kill();
}
