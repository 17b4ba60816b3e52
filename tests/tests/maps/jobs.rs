//! Jobs outlive the server as far as their fate goes.

use std::io;
use std::time::Duration;

use futures::{Stream, stream};
use sqlx::{AssertSqlSafe, Connection};
use waypost_client::{Client, Code, v1};
use waypost_proto::v1::job_service_client::JobServiceClient;

use crate::harness::{
    Built, Server, ServerProcess, assert_status, by_words_request, channel, followed, images, import_model,
    in_time, refused, run_to_its_end, said, tables,
};

const TRAINING_IMAGES: usize = 40;

/// A training of a moment.
fn short() -> v1::TrainModelSettings {
    v1::TrainModelSettings {
        display_name: String::new(),
        extractor: Some("orb features=200 width=320".to_owned()),
        words: 50,
        seed: 7,
        image_count: Some(TRAINING_IMAGES as u32),
    }
}

/// A training of many seconds.
fn long() -> v1::TrainModelSettings {
    v1::TrainModelSettings { extractor: Some(String::new()), words: 4000, ..short() }
}

fn training_images() -> impl Stream<Item = io::Result<Vec<u8>>> + Send + 'static {
    stream::iter(images().iter().take(TRAINING_IMAGES).cloned().map(Ok))
}

async fn train(client: &Client, settings: v1::TrainModelSettings) -> v1::Job {
    in_time(client.train_model(settings, training_images())).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_listed_newest_first_page_by_page() {
    let server = Server::start().await;
    let client = server.client().await;
    assert!(client.jobs().await.unwrap().is_empty());
    for words in [50, 40, 30] {
        let job = train(&client, v1::TrainModelSettings { words, ..short() }).await;
        assert_eq!((job.kind(), job.end_time_ns), (v1::job::Kind::TrainModel, None));
        followed(&client, &job).await;
    }
    let jobs = client.jobs().await.unwrap();
    assert_eq!(jobs.iter().map(|job| job.name.as_str()).collect::<Vec<_>>(), ["jobs/3", "jobs/2", "jobs/1"]);
    for job in &jobs {
        assert_eq!(client.job(&job.name).await.unwrap(), *job);
        assert_eq!(job.state(), v1::job::State::Succeeded);
        assert_eq!(job.result, Some(client.model(job.result.as_ref().unwrap()).await.unwrap().name));
        assert!(0 < job.create_time_ns && Some(job.create_time_ns) <= job.end_time_ns, "{job:?}");
    }

    let mut raw = JobServiceClient::new(channel(&server.endpoint()).await);
    let mut paged = Vec::new();
    let mut page_token = String::new();
    for expected in [2, 1] {
        let request = v1::ListJobsRequest { page_size: 2, page_token: page_token.clone() };
        let page = raw.list_jobs(request).await.unwrap().into_inner();
        assert_eq!(page.jobs.len(), expected);
        paged.extend(page.jobs);
        page_token = page.next_page_token;
    }
    assert_eq!((&paged, page_token.as_str()), (&jobs, ""));
    for (page_size, page_token, fragment) in
        [(1001, "", "at most 1000"), (0, "x", "begin again"), (0, "-1", "begin again")]
    {
        let request = v1::ListJobsRequest { page_size, page_token: page_token.to_owned() };
        let status = raw.list_jobs(request).await.unwrap_err();
        assert_status(page_token, (status.code(), status.message()), Code::InvalidArgument, fragment);
    }

    // The job stays when its model goes.
    client.delete_model(jobs[0].result.as_ref().unwrap()).await.unwrap();
    let job = client.job("jobs/3").await.unwrap();
    assert_eq!(job.result, jobs[0].result);
    server.stop().await;
}

/// How a server goes down.
#[derive(Clone, Copy, Debug)]
enum Down {
    Killed,
    Stopped,
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_a_restart_cut_off_has_failed_and_says_so() {
    for down in [Down::Killed, Down::Stopped] {
        let directory = tempfile::tempdir().unwrap();
        let server = ServerProcess::start(directory.path());
        let client = server.client().await;
        let done = train(&client, short()).await;
        let done = followed(&client, &done).await.pop().unwrap();
        let models = client.models().await.unwrap();
        let running = train(&client, long()).await;
        let waiting = train(&client, short()).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(client.job(&running.name).await.unwrap().state(), v1::job::State::Running);
        match down {
            Down::Killed => server.kill(),
            Down::Stopped => server.stop(),
        }

        let server = ServerProcess::start(directory.path());
        let client = server.client().await;
        for job in [&running, &waiting] {
            let watched = followed(&client, job).await;
            let [cut_off] = watched.as_slice() else { panic!("{down:?}: {watched:?}") };
            assert_eq!(cut_off.state(), v1::job::State::Failed, "{down:?}");
            assert!(
                said(&cut_off.error).contains("restarted") && said(&cut_off.error).contains("start it again"),
                "{cut_off:?}"
            );
            assert!(
                cut_off.end_time_ns >= Some(cut_off.create_time_ns) && cut_off.result.is_none(),
                "{cut_off:?}"
            );
            assert_eq!(client.job(&job.name).await.unwrap(), *cut_off);
            assert_eq!(client.cancel_job(&job.name).await.unwrap(), *cut_off);
        }
        assert_eq!(client.job(&done.name).await.unwrap(), done, "{down:?}");
        assert_eq!(client.models().await.unwrap(), models, "{down:?}: a job that was cut off left a model");
        // Numbers go on.
        let next = train(&client, short()).await;
        assert_eq!(next.name, "jobs/4", "{down:?}");
        assert_eq!(followed(&client, &next).await.pop().unwrap().state(), v1::job::State::Succeeded);
        server.stop();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_that_ended_long_ago_are_forgotten() {
    const DAY_NS: i64 = 24 * 60 * 60 * 1_000_000_000;
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    for _ in 0..2 {
        let job = train(&client, short()).await;
        followed(&client, &job).await;
    }
    server.stop().await;
    let mut database = tables(directory.path()).await;
    for (number, days) in [(1, 31), (2, 29)] {
        let aged = format!("UPDATE jobs SET ended_ns = ended_ns - {days} * {DAY_NS} WHERE number = {number}");
        sqlx::query(AssertSqlSafe(aged)).execute(&mut database).await.unwrap();
    }
    database.close().await.unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let names: Vec<String> = client.jobs().await.unwrap().into_iter().map(|job| job.name).collect();
    assert_eq!(names, ["jobs/2"]);
    let (code, message) = refused(client.job("jobs/1").await);
    assert_status("forgotten", (code, &message), Code::NotFound, "more than 30 days ago are forgotten");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_listed_on_the_command_line() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let job = train(&client, short()).await;
    let last = followed(&client, &job).await.pop().unwrap();
    let run = |arguments: &[&str]| {
        let mut command = Built::command("waypost");
        command.args(arguments).args(["--server", &server.endpoint()]);
        let output = run_to_its_end(command);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let listed: serde_json::Value = serde_json::from_str(&run(&["job", "ls", "--json"])).unwrap();
    let listed = listed["jobs"].as_array().unwrap();
    assert_eq!(listed.len(), 1);
    assert_eq!(
        listed[0],
        serde_json::from_str::<serde_json::Value>(&run(&["job", "show", "jobs/1", "--json"])).unwrap()
    );
    assert_eq!(
        (&listed[0]["kind"], &listed[0]["result"]),
        (&"train_model".into(), &last.result.as_deref().into())
    );
    assert_eq!(listed[0]["end_time_ns"].as_i64(), last.end_time_ns);
    let text = run(&["job", "ls"]);
    assert!(
        text.contains("jobs/1") && text.contains("succeeded") && text.contains(last.result.as_ref().unwrap()),
        "{text}"
    );
    server.stop();
}

/// Callers who go away while a job is being started leave none behind that says it runs and never ends.
#[tokio::test(flavor = "multi_thread")]
async fn jobs_whose_callers_go_away_end() {
    const CALLERS: u32 = 150;
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(by_words_request("drive", &model.name)).await.unwrap();
    let mut gone = 0;
    for caller in 0..CALLERS {
        // Within and around the time that a commit takes.
        let patience = Duration::from_micros(u64::from(100 * (caller % 50)));
        gone += u32::from(tokio::time::timeout(patience, client.compact_map("drive")).await.is_err());
    }
    assert!(gone > CALLERS / 10, "{gone} of {CALLERS} callers went away");
    let running = async || {
        let jobs = client.jobs().await.unwrap();
        jobs.iter().filter(|job| job.state() == v1::job::State::Running).count()
    };
    let since = std::time::Instant::now();
    while running().await > 0 {
        assert!(since.elapsed() < Duration::from_secs(60), "{} jobs do not end", running().await);
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    assert!(client.jobs().await.unwrap().len() > 1);
}
