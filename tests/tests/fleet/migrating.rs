//! All that one database holds, brought into another and back.

use std::path::Path;
use std::process::Output;

use waypost_client::{Client, v1};

use crate::harness::{
    Built, Cluster, ServerProcess, answers, frame, import_model, map_request, reference, run_to_its_end,
};

/// From SQLite to PostgreSQL and from there to SQLite: every map is what it was, and goes on.
#[tokio::test(flavor = "multi_thread")]
async fn a_database_goes_there_and_comes_back() {
    let Some(cluster) = Cluster::running() else { return };
    let database = cluster.database("there").await;
    let (before, after) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let source = filled(before.path()).await;
    let told = contents(&source.client().await).await;

    // The source is served meanwhile.
    let moved = migrate(before.path().to_str().unwrap(), &database.url()).await;
    assert!(moved.status.success(), "{}", said(&moved));
    let hash = reference().maps[30].state_hash.clone();
    assert!(said(&moved).contains(&format!("drive has the state hash {hash}")), "{}", said(&moved));
    source.stop();
    let moved = migrate(&database.url(), after.path().to_str().unwrap()).await;
    assert!(moved.status.success(), "{}", said(&moved));

    let back = ServerProcess::start(after.path());
    let client = back.client().await;
    assert_eq!(contents(&client).await, told);
    // It goes on, and a number that was given is not given again.
    answers(&client, "drive", "robot", (31..=40).map(frame)).await;
    let map = client.map("drive", v1::MapView::Full).await.unwrap();
    assert_eq!(map.state_hash, Some(reference().maps[40].state_hash.clone()));
    back.stop();
    let checked = run(&["check", "--deep", "--data-dir", after.path().to_str().unwrap()]).await;
    assert!(checked.status.success(), "{}", said(&checked));
}

/// A run that is cut off goes on; what is there of something else is left alone.
#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_is_cut_off_goes_on() {
    let Some(cluster) = Cluster::running() else { return };
    let database = cluster.database("cut_off").await;
    let (ours, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    filled(ours.path()).await.stop();
    filled(other.path()).await.stop();
    let source = ours.path().to_str().unwrap();
    assert!(migrate(source, &database.url()).await.status.success());
    // As if it had been cut off in the middle of the log.
    let mut connection = database.connect().await;
    for lost in [
        "UPDATE maps SET state = 'importing'",
        "DELETE FROM log WHERE position >= 17",
        "DELETE FROM frame_media WHERE position >= 5",
        "DELETE FROM sessions WHERE number > 0",
    ] {
        sqlx::query(lost).execute(&mut connection).await.unwrap();
    }
    let again = migrate(source, &database.url()).await;
    assert!(again.status.success(), "{}", said(&again));
    let hash = reference().maps[30].state_hash.clone();
    assert!(said(&again).contains(&hash), "{}", said(&again));

    // A row that is another is found.
    sqlx::query("UPDATE labels SET label = 'elsewhere'").execute(&mut connection).await.unwrap();
    let refused = migrate(source, &database.url()).await;
    assert!(!refused.status.success());
    assert!(
        said(&refused).contains("the table labels is not in the target as it is in the source"),
        "{}",
        said(&refused)
    );
    let refused = migrate(other.path().to_str().unwrap(), &database.url()).await;
    assert!(!refused.status.success());
    assert!(said(&refused).contains("of its own; name a database that holds nothing"), "{}", said(&refused));
    let refused = migrate(source, source).await;
    assert!(said(&refused).contains("the source and the target are the same"), "{}", said(&refused));
    let refused = migrate("/not/there", &database.url()).await;
    assert!(said(&refused).contains("/not/there"), "{}", said(&refused));
}

/// A server with a map and a label, and the number of a map that is gone.
async fn filled(directory: &Path) -> ServerProcess {
    let server = ServerProcess::start(directory);
    let client = server.client().await;
    let model = import_model(&client).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    answers(&client, "drive", "robot", (1..=30).map(frame)).await;
    client.set_label("maps/drive/places/3", "kitchen", v1::LabelScope::Place).await.unwrap();
    client.create_map(map_request("gone", &model.name)).await.unwrap();
    client.delete_map("gone").await.unwrap();
    server
}

/// What clients are told of all maps, but for what each server counts by itself.
pub(super) async fn contents(client: &Client) -> Vec<String> {
    let mut told = Vec::new();
    for map in client.maps().await.unwrap() {
        let name = map.name.trim_start_matches("maps/").to_owned();
        let map = client.map(&name, v1::MapView::Full).await.unwrap();
        told.push(format!("{:?} {:?} {} {}", map.name, map.state_hash, map.frames, map.loop_closures));
        for session in client.sessions(&name).await.unwrap() {
            told.push(format!("{session:?}"));
            told.extend(client.frames(&session.name).await.unwrap().iter().map(|frame| format!("{frame:?}")));
        }
        told.push(format!("{:?}", client.labels(&name).await.unwrap()));
    }
    told.push(format!("{:?}", client.models().await.unwrap()));
    told
}

async fn migrate(from: &str, to: &str) -> Output {
    run(&["migrate", "--from", from, "--to", to]).await
}

pub(super) async fn run(arguments: &[&str]) -> Output {
    let mut command = Built::command("waypost-server");
    command.args(arguments);
    tokio::task::spawn_blocking(|| run_to_its_end(command)).await.unwrap()
}

pub(super) fn said(output: &Output) -> String {
    String::from_utf8_lossy(&[output.stdout.as_slice(), output.stderr.as_slice()].concat()).into_owned()
}
