//! Media outside the database: in a bucket of S3.

use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use s3s_fs::FileSystem;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use waypost_client::{Client, Code, Error, v1};

use super::migrating::{contents, run, said};
use crate::harness::{
    Built, Cluster, ServerProcess, TestDatabase, answers, followed, frame, import_model, in_time,
    map_request, reference, run_to_its_end,
};

/// A server that speaks the protocol of S3, with one bucket, `waypost`.
struct Bucket {
    folder: TempDir,
    port: u16,
    serving: JoinSet<()>,
}

const KEY: &str = "robot";
const SECRET: &str = "not known to strangers";

impl Bucket {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("waypost")).unwrap();
        let mut bucket = Self { folder, port: 0, serving: JoinSet::new() };
        bucket.serve().await;
        bucket
    }

    /// At the port that it had before, if it had one.
    async fn serve(&mut self) {
        let listener = TcpListener::bind(("127.0.0.1", self.port)).await.unwrap();
        self.port = listener.local_addr().unwrap().port();
        let mut service = S3ServiceBuilder::new(FileSystem::new(self.folder.path()).unwrap());
        service.set_auth(SimpleAuth::from_single(KEY, SECRET));
        let service = service.build();
        self.serving.spawn(async move {
            let mut connections = JoinSet::new();
            loop {
                let (connection, _) = listener.accept().await.unwrap();
                let service = service.clone();
                connections.spawn(async move {
                    let server = Builder::new(TokioExecutor::new());
                    let _ended = server.serve_connection(TokioIo::new(connection), service).await;
                });
            }
        });
    }

    async fn stop(&mut self) {
        self.serving.shutdown().await;
    }

    /// Files of objects, below a folder of the bucket.
    fn objects(&self, folder: &str) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.folder.path().join("waypost").join(folder)];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).into_iter().flatten() {
                let path = entry.unwrap().path();
                if path.is_dir() { folders.push(path) } else { found.push(path) }
            }
        }
        found
    }

    fn command(&self, options: &[&str]) -> std::process::Command {
        let mut command = Built::command("waypost-server");
        command.args(options).envs([
            ("AWS_ENDPOINT_URL", format!("http://127.0.0.1:{}", self.port).as_str()),
            ("AWS_ACCESS_KEY_ID", KEY),
            ("AWS_SECRET_ACCESS_KEY", SECRET),
            ("AWS_REGION", "us-east-1"),
        ]);
        command
    }

    fn server(&self, database: &TestDatabase, media: &str, files: &Path) -> Result<ServerProcess, String> {
        let command = self.command(&["--storage", &database.url(), "--media", media]);
        ServerProcess::start_command(command, files)
    }
}

const MEDIA: &str = "s3://waypost/halls";

/// A client of a server, once it owns its database: until then connections end.
async fn owner(server: &ServerProcess) -> Client {
    in_time(async {
        loop {
            let client = server.client().await;
            if client.maps().await.is_ok() {
                return client;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
}

#[tokio::test(flavor = "multi_thread")]
async fn media_in_a_bucket_are_as_good_as_in_the_database() {
    let Some(cluster) = Cluster::running() else { return };
    let database = cluster.database("in_a_bucket").await;
    let files = tempfile::tempdir().unwrap();
    let mut bucket = Bucket::start().await;
    let server = bucket.server(&database, MEDIA, files.path()).unwrap();
    let client = owner(&server).await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    answers(&client, "drive", "robot", (1..=20).map(frame)).await;
    let mut connection = database.connect().await;
    let in_rows: i32 = sqlx::query_scalar("SELECT max(length(content)) FROM frame_media")
        .fetch_one(&mut connection)
        .await
        .unwrap();
    assert!(in_rows <= 4096, "{in_rows} bytes are in a row");
    let outside: i64 = sqlx::query_scalar("SELECT count(*) FROM frame_media WHERE object IS NOT NULL")
        .fetch_one(&mut connection)
        .await
        .unwrap();
    assert!(outside > 0 && bucket.objects("halls/maps").len() as i64 == outside, "{outside}");
    let told = contents(&client).await;
    server.stop();

    // What it decides with what it reads from there is what it would decide with all in memory.
    let server = bucket.server(&database, MEDIA, files.path()).unwrap();
    let client = owner(&server).await;
    assert_eq!(contents(&client).await, told);
    answers(&client, "drive", "robot", (21..=30).map(frame)).await;
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.state_hash, Some(reference().maps[30].state_hash.clone()));

    // While the bucket is away, frames wait, and nothing is acknowledged that it has not got.
    bucket.stop().await;
    let before = bucket.objects("halls/maps").len();
    let streaming = tokio::spawn({
        let client = client.clone();
        async move { answers(&client, "drive", "robot", (31..=40).map(frame)).await.len() }
    });
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert!(!streaming.is_finished());
    assert_eq!(bucket.objects("halls/maps").len(), before);
    bucket.serve().await;
    assert_eq!(in_time(streaming).await.unwrap(), 10);
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.state_hash, Some(reference().maps[40].state_hash.clone()));
    let told = contents(&client).await;
    server.stop();

    // All of it is brought into a file of SQLite, which has the media, too.
    let whole = tempfile::tempdir().unwrap();
    let arguments = ["migrate", "--from", &database.url(), "--to", whole.path().to_str().unwrap()];
    let without = run(&arguments).await;
    assert!(!without.status.success() && said(&without).contains("--media"), "{}", said(&without));
    let moved = run_to_its_end(bucket.command(&[&arguments[..], &["--media", MEDIA]].concat()));
    assert!(moved.status.success(), "{}", said(&moved));
    let back = ServerProcess::start(whole.path());
    assert_eq!(contents(&back.client().await).await, told);
    back.stop();
    let checked = run(&["check", "--deep", "--data-dir", whole.path().to_str().unwrap()]).await;
    assert!(checked.status.success(), "{}", said(&checked));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_is_known_again_and_what_nobody_needs_goes() {
    let Some(cluster) = Cluster::running() else { return };
    let (database, other) = (cluster.database("its_bucket").await, cluster.database("anothers_bucket").await);
    let files = tempfile::tempdir().unwrap();
    let bucket = Bucket::start().await;
    let server = bucket.server(&database, MEDIA, files.path()).unwrap();
    let client = owner(&server).await;
    let model = import_model(&client).await;
    for map in ["drive", "gone"] {
        client.create_map(map_request(map, &model.name)).await.unwrap();
        answers(&client, map, "robot", (1..=5).map(frame)).await;
    }

    // What nobody needs is deleted once it is old enough.
    let all = bucket.objects("halls/maps").len();
    client.delete_map("gone").await.unwrap();
    let compacted = client.compact_map("drive").await.unwrap();
    followed(&client, &compacted).await;
    assert_eq!(bucket.objects("halls/maps").len(), all, "too new to be deleted");
    for object in bucket.objects("halls/maps") {
        let file = std::fs::File::options().append(true).open(object).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(2 * 3600)).unwrap();
    }
    in_time(async {
        while bucket.objects("halls/maps").len() * 2 > all {
            let compacted = client.compact_map("drive").await.unwrap();
            followed(&client, &compacted).await;
        }
    })
    .await;
    assert_eq!(bucket.objects("halls/maps").len() * 2, all);

    // An object that is gone is damage, told by the frame's name.
    for object in bucket.objects("halls/maps") {
        std::fs::remove_file(object).unwrap();
    }
    server.stop();
    let server = bucket.server(&database, MEDIA, files.path()).unwrap();
    let client = owner(&server).await;
    let mut snapshot = Vec::new();
    match client.export_map("drive", &mut snapshot).await {
        Err(Error::Status { code: Code::DataLoss, message, .. }) => {
            assert!(
                message.contains("drive, session robot, frame ") && message.contains("is gone"),
                "{message}"
            );
        }
        other => panic!("{other:?}"),
    }
    server.stop();

    for (storage, media, says) in [
        (database.url(), "database", "media of this database are in s3://waypost/halls"),
        (database.url(), "s3://waypost/elsewhere", "is not where the media of this database are"),
        (other.url(), MEDIA, "has the media of another database"),
        (other.url(), "/not/there", "media cannot be put to file:///not/there"),
        ("sqlite".to_owned(), MEDIA, "beside a storage of postgres://… alone"),
    ] {
        let files = tempfile::tempdir().unwrap();
        let options = [
            ["--storage", &storage, "--media", media],
            ["--grpc-address", "127.0.0.1:0", "--http-address", "127.0.0.1:0"],
        ];
        let mut refused = bucket.command(&options.concat());
        refused.arg("--data-dir").arg(files.path());
        let refused = run_to_its_end(refused);
        assert!(!refused.status.success() && said(&refused).contains(says), "{media}: {}", said(&refused));
    }
}
