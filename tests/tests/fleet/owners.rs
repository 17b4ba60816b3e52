//! Servers on one database: one owns it, others are in reserve, and nothing that was acknowledged depends on which it was.

use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use tokio::task::JoinHandle;
use waypost_client::{Client, v1};
use waypost_proto::v1::stream_request::Content as Request;

use crate::harness::{
    Built, Cluster, Proxy, RawStream, ServerProcess, TestDatabase, answers, frame, frame_count, import_model,
    in_time, map_request, mapped, open, reference, run_to_its_end, session_options, stream_through, told,
    wire,
};

pub(super) const FRAMES: u64 = 40;

/// Longer than who is gone is waited for.
const LEASE: Duration = Duration::from_secs(6);

/// A server on a database that others may own.
pub(super) fn beside_others(url: &str) -> (ServerProcess, tempfile::TempDir) {
    beside_others_with(url, &[])
}

/// The same, with further options.
pub(super) fn beside_others_with(url: &str, options: &[&str]) -> (ServerProcess, tempfile::TempDir) {
    let directory = tempfile::tempdir().unwrap();
    let options = [&["--storage", url], options].concat();
    (ServerProcess::start_with(directory.path(), &options), directory)
}

pub(super) fn until_it_owns(server: &ServerProcess) {
    let since = Instant::now();
    while !server.log().contains("serving") {
        assert!(since.elapsed() < 4 * LEASE, "{}", server.log());
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Starts a server, and waits in the background until it owns the database.
fn in_reserve(url: &str) -> JoinHandle<(ServerProcess, tempfile::TempDir)> {
    let url = url.to_owned();
    tokio::task::spawn_blocking(move || {
        let (server, directory) = beside_others(&url);
        until_it_owns(&server);
        (server, directory)
    })
}

pub(super) async fn owner(url: &str) -> (ServerProcess, tempfile::TempDir) {
    in_reserve(url).await.unwrap()
}

/// A database with the map `drive`, whose server was stopped.
pub(super) async fn prepared(cluster: &Cluster, name: &str) -> TestDatabase {
    let database = cluster.database(name).await;
    let (server, _directory) = owner(&database.url()).await;
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    tokio::task::spawn_blocking(|| server.stop()).await.unwrap();
    database
}

/// The map holds the first `frames` of the drive, each once, and is what they make of it anywhere.
pub(super) async fn is_whole(client: &Client, frames: u64) {
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.frames, frames);
    assert_eq!(map.state_hash, Some(reference().maps[frames as usize].state_hash.clone()));
}

/// Epochs in the order of owners, from the first on.
pub(super) async fn epoch(database: &TestDatabase) -> i64 {
    let mut connection = database.connect().await;
    sqlx::query_scalar("SELECT epoch FROM lease").fetch_one(&mut connection).await.unwrap()
}

/// One drive through four servers, each killed: the robot's session goes on, as with one.
#[tokio::test(flavor = "multi_thread")]
async fn owners_that_are_killed_are_followed() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "killed_owners").await;
    let proxy = Proxy::start().await;
    let (first, _directory) = owner(&database.url()).await;
    proxy.forward_to(Some(first.grpc()));
    let client = Client::connect(&proxy.endpoint()).await.unwrap();
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let url = database.url();
    let kept = std::sync::Mutex::new(Vec::new());
    let last = stream_through(session, FRAMES, frame, first, |answered, server| {
        if ![0, 13, 29].contains(&answered) {
            return server;
        }
        let reserve = in_reserve(&url);
        proxy.forward_to(None);
        let killed = Instant::now();
        server.kill();
        let next = tokio::task::block_in_place(|| tokio::runtime::Handle::current().block_on(reserve));
        let (next, directory) = next.unwrap();
        assert!(killed.elapsed() < LEASE, "{:?} without an owner", killed.elapsed());
        kept.lock().unwrap().push(directory);
        proxy.forward_to(Some(next.grpc()));
        next
    })
    .await;
    is_whole(&last.client().await, FRAMES).await;
    // Who prepared it, the first, and one for each that was killed.
    assert_eq!(epoch(&database).await, 5);
}

/// An owner that sleeps for longer than it is waited for wakes up to find another in its place. What it is sent then it
/// does not store; it asks the other, and is the next one in turn.
#[tokio::test(flavor = "multi_thread")]
async fn an_owner_that_slept_writes_nothing_more() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "sleeping_owner").await;
    let (mut first, _directory) = owner(&database.url()).await;
    let (mut raw, _) = RawStream::open(&first.endpoint(), open("drive", "robot")).await.unwrap();
    for sequence in 1..=5 {
        raw.answered(wire(frame(sequence))).await;
    }
    let reserve = in_reserve(&database.url());
    let asleep = Pid::from_child(first.child());
    kill_process(asleep, Signal::STOP).unwrap();
    let (second, _second_directory) = reserve.await.unwrap();
    let client = second.client().await;
    let through_second = answers(&client, "drive", "robot", (1..=10).map(frame)).await;
    assert!(through_second[..5].iter().all(|answer| answer.resent), "what the first acknowledged is there");
    assert!(through_second[5..].iter().all(|answer| !answer.resent));

    // It wakes up with a frame in its hands.
    raw.send(Request::Frame(wire(frame(6)))).await;
    kill_process(asleep, Signal::CONT).unwrap();
    let status = in_time(raw.next()).await.unwrap_err();
    assert_eq!(status.code(), tonic::Code::Unavailable, "{status:?}");
    is_whole(&through(&first).await, 10).await;
    answers(&client, "drive", "robot", (11..=20).map(frame)).await;
    is_whole(&through(&first).await, 20).await;
    // By its clock, or by the database: whichever it looks at first.
    let gave_up =
        ["the database was out of reach for too long", "another server has taken the database over"];
    assert!(gave_up.iter().any(|said| first.log().contains(said)), "{}", first.log());
    second.kill();
    is_whole(&through(&first).await, 20).await;
    assert!(first.is_running());
    assert_eq!(epoch(&database).await, 4);
}

/// A client of a server that may be changing its part.
async fn through(server: &ServerProcess) -> Client {
    let client = server.client().await;
    in_time(async {
        while client.maps().await.is_err() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    client
}

/// The way to the database is cut for a while that is shorter than the owner is waited for: frames wait.
#[tokio::test(flavor = "multi_thread")]
async fn a_database_out_of_reach_is_waited_for() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "short_cut").await;
    let way = Proxy::start().await;
    way.forward_to(Some(cluster.socket()));
    let (server, _directory) = owner(&database.url_through(way.address())).await;
    let client = server.client().await;
    let session = client.open_session(session_options("drive", "robot")).await.unwrap();
    let server = stream_through(session, FRAMES, frame, server, |answered, server| {
        if answered % 10 == 5 {
            way.forward_to(None);
            way.cut();
            std::thread::sleep(Duration::from_millis(700));
            way.forward_to(Some(cluster.socket()));
        }
        server
    })
    .await;
    is_whole(&server.client().await, FRAMES).await;
    assert_eq!(epoch(&database).await, 2);
}

/// The way is cut for longer: another has the database by then. The one that was cut off serves nothing meanwhile, and asks
/// the other when the way is there again.
#[tokio::test(flavor = "multi_thread")]
async fn an_owner_that_is_cut_off_is_followed_and_comes_back() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "long_cut").await;
    let way = Proxy::start().await;
    way.forward_to(Some(cluster.socket()));
    let (mut first, _directory) = owner(&database.url_through(way.address())).await;
    let acknowledged =
        answers(&first.client().await, "drive", "robot", (1..=8).map(frame)).await.len() as u64;
    let reserve = in_reserve(&database.url());
    way.forward_to(None);
    way.cut();
    let (second, _second_directory) = reserve.await.unwrap();
    is_whole(&second.client().await, acknowledged).await;
    in_time(async {
        while !first.log().contains("cannot be opened again yet") {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    })
    .await;
    assert!(first.log().contains("out of reach"), "{}", first.log());
    assert!(first.client().await.maps().await.is_err());
    way.forward_to(Some(cluster.socket()));
    is_whole(&through(&first).await, acknowledged).await;
    assert!(first.is_running(), "{}", first.log());
    assert_eq!(epoch(&database).await, 3);
}

/// A server that is told to stop need not be waited for.
#[tokio::test(flavor = "multi_thread")]
async fn an_owner_that_stops_hands_over() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "handed_over").await;
    let (first, _directory) = owner(&database.url()).await;
    mapped(&first.client().await, "monday", 1..=10).await;
    let reserve = in_reserve(&database.url());
    // It has come to wait by then.
    while !somebody_waits(&database).await {
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let stopped = Instant::now();
    tokio::task::spawn_blocking(|| first.stop()).await.unwrap();
    let after_stop = Instant::now();
    let (second, _second_directory) = reserve.await.unwrap();
    assert!(
        after_stop.elapsed() < Duration::from_secs(3),
        "{:?}, {:?}",
        after_stop.elapsed(),
        stopped.elapsed()
    );
    assert_eq!(second.client().await.sessions("drive").await.unwrap().len(), 1);
}

/// The owner has died, and the database's clock says that it may own it for an hour: that clock was set back, or belongs to a
/// machine that took over. It is followed all the same.
#[tokio::test(flavor = "multi_thread")]
async fn clocks_that_are_set_back_keep_nobody_out() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "clock_set_back").await;
    let (first, _directory) = owner(&database.url()).await;
    first.kill();
    let later = "UPDATE lease SET expires = now() + interval '1 hour'";
    sqlx::raw_sql(later).execute(&mut database.connect().await).await.unwrap();
    let since = Instant::now();
    let (second, _second_directory) = owner(&database.url()).await;
    assert!(since.elapsed() < 2 * LEASE, "{:?}", since.elapsed());
    let client = second.client().await;
    answers(&client, "drive", "robot", (1..=5).map(frame)).await;
    is_whole(&client, 5).await;
    assert_eq!(epoch(&database).await, 3);
}

/// Whether a server asks who the owner is, or was the last to ask.
async fn somebody_waits(database: &TestDatabase) -> bool {
    let mut connection = database.connect().await;
    let asking = sqlx::query(
        "SELECT 1 FROM pg_stat_activity WHERE datname = $1 AND query LIKE 'SELECT epoch, holder%'",
    );
    asking.bind(&database.name).fetch_optional(&mut connection).await.unwrap().is_some()
}

/// The same drive, by SQLite and by PostgreSQL: the same answers, and the same state.
#[tokio::test(flavor = "multi_thread")]
async fn both_databases_make_the_same_map() {
    let Some(cluster) = Cluster::running() else { return };
    let database = prepared(&cluster, "same_map").await;
    let (on_postgres, _directory) = owner(&database.url()).await;
    let directory = tempfile::tempdir().unwrap();
    let on_sqlite = ServerProcess::start(directory.path());
    let client = on_sqlite.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    let count = frame_count();
    let mut by_both = Vec::new();
    for server in [&on_postgres, &on_sqlite] {
        let client = server.client().await;
        let answers = answers(&client, "drive", "robot", (1..=count).map(frame)).await;
        is_whole(&client, count).await;
        by_both.push(answers.iter().map(told).collect::<Vec<_>>());
    }
    assert_eq!(by_both[0], by_both[1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_used_is_said_with_what_to_do() {
    let Some(cluster) = Cluster::running() else { return };
    let free = cluster.database("refusals").await;
    let latin = cluster.database_with("refusals_latin", "ENCODING LATIN1 TEMPLATE template0").await;
    let newer = prepared(&cluster, "refusals_newer").await;
    let later = "INSERT INTO _sqlx_migrations VALUES (999, 'later', now(), true, '\\x00', 1)";
    sqlx::raw_sql(later).execute(&mut newer.connect().await).await.unwrap();
    let nowhere = free.url_through("127.0.0.1:1".parse().unwrap());
    let missing = free.url().replace("/refusals", "/not_there");
    for (url, says) in [
        ("mysql://db/maps", "neither sqlite nor the URL of a database of PostgreSQL"),
        (nowhere.as_str(), "see that PostgreSQL runs there"),
        (missing.as_str(), "that the database exists"),
        (latin.url().as_str(), "make one with UTF8"),
        (newer.url().as_str(), "written by a newer Waypost (schema 999)"),
    ] {
        for more in [&["--check"][..], &[]] {
            let said = ends(url, more).await;
            assert!(said.contains(says), "{url} {more:?}:\n{said}");
        }
    }
    let url = free.url();
    for (command, says) in [
        (&["backup", "copy"][..], "pg_dump"),
        (&["restore", "copy"], "pg_dump"),
        (&["check", "--deep"], "pg_dump"),
    ] {
        let said = ends(&url, command).await;
        assert!(said.contains(says), "{command:?}:\n{said}");
    }
    let (server, _directory) = owner(&url).await;
    let said = ends(&url, &["token", "ls"]).await;
    assert!(said.contains("a server owns the database") && said.contains("waypost token"), "{said}");
    assert!(said.contains(&format!("process {}", server.child().id())), "{said}");
}

/// What a server says that does not come to serve.
pub(super) async fn ends(url: &str, arguments: &[&str]) -> String {
    let directory = tempfile::tempdir().unwrap();
    let mut command = Built::command("waypost-server");
    command.arg("--storage").arg(url).arg("--data-dir").arg(directory.path()).args(arguments);
    command.args(["--grpc-address", "127.0.0.1:0"].iter().filter(|_| !has_command(arguments)));
    command.args(["--http-address", "127.0.0.1:0"].iter().filter(|_| !has_command(arguments)));
    let output = tokio::task::spawn_blocking(|| run_to_its_end(command)).await.unwrap();
    assert!(!output.status.success(), "{url} {arguments:?}");
    let said = [output.stdout, output.stderr].concat();
    String::from_utf8_lossy(&said).into_owned()
}

fn has_command(arguments: &[&str]) -> bool {
    arguments.first().is_some_and(|first| !first.starts_with('-'))
}

/// A password that is part of an address is in no message.
#[tokio::test(flavor = "multi_thread")]
async fn a_password_is_not_told() {
    let Some(cluster) = Cluster::running() else { return };
    let database = cluster.database("password").await;
    let url = database.url().replacen("waypost@", "waypost:s3cret@", 1);
    let (server, _directory) = owner(&url).await;
    assert!(server.log().contains("serving"), "{}", server.log());
    assert!(!server.log().contains("s3cret"), "{}", server.log());
    let said = ends(&url.replace("/password", "/not_there"), &[]).await;
    assert!(!said.contains("s3cret"), "{said}");
}
