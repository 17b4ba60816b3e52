//! Large maps go piece by piece, out of everybody's way.

use super::*;

/// Rows as of a map of many frames.
async fn enlarge(directory: &Path, rows: u32) {
    let many = format!(
        "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < {rows}) \
         INSERT INTO frame_media (map_id, position, kind, content) SELECT maps.id, 1000 + i, 'thumbnail', randomblob(2000) FROM n, maps WHERE maps.name = 'drive'"
    );
    sql(directory, &many).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_maps_name_is_free_at_once_and_others_go_on() {
    const ROWS: u32 = 20_000;
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=6).map(frame)).await;
    client.create_map(map_request("other", "shipped")).await.unwrap();
    let (mut raw, _) = RawStream::open(&server.endpoint(), open("drive", "robot")).await.unwrap();
    enlarge(server.directory(), ROWS).await;

    client.delete_map("drive").await.unwrap();
    let left = rows(server.directory()).await.into_iter().find(|(table, _)| *table == "frame_media");
    assert!(left.is_some_and(|(_, left)| left > 0), "it was deleted in one piece: {left:?}");
    let status = raw.next().await.unwrap_err();
    assert_status(
        "a stream into it",
        (status.code(), status.message()),
        Code::NotFound,
        "there is no map drive",
    );
    let names = async || {
        let maps = client.maps().await.unwrap().into_iter();
        maps.map(|map| map.name).collect::<Vec<_>>()
    };
    assert_eq!(names().await, ["maps/other"]);
    let (code, _) = refused(client.delete_map("drive").await);
    assert_eq!(code, Code::NotFound);
    client.create_map(map_request("drive", "shipped")).await.unwrap();
    assert_eq!(names().await, ["maps/drive", "maps/other"]);
    for map in ["other", "drive"] {
        let answers = answers(&client, map, "robot", (1..=6).map(frame)).await;
        assert_eq!(answers.len(), 6);
        assert_eq!(state_hash(&client, map).await, reference().maps[6].state_hash);
    }
    for map in ["other", "drive"] {
        client.delete_map(map).await.unwrap();
    }
    // It waits for the last rows to go, or says that they have not yet.
    let deadline = Instant::now() + Duration::from_secs(60);
    while let Err(error) = client.delete_model("shipped").await {
        assert!(error.to_string().contains("still being deleted; try again in a moment"), "{error}");
        assert!(Instant::now() < deadline);
    }
    assert!(
        rows(server.directory()).await.iter().all(|&(_, rows)| rows == 0),
        "{:?}",
        rows(server.directory()).await
    );
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deletion_that_was_cut_off_goes_on() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    let model = import_model(&client).await;
    let before = rows(directory.path()).await;
    client.create_map(map_request("drive", &model.name)).await.unwrap();
    answers(&client, "drive", "robot", (1..=6).map(frame)).await;
    enlarge(directory.path(), 20_000).await;
    client.delete_map("drive").await.unwrap();
    server.kill();
    let left = rows(directory.path()).await;
    assert_ne!(left, before, "it was deleted before the kill: the test shows nothing");
    let server = ServerProcess::start(directory.path());
    let client = server.client().await;
    assert!(client.maps().await.unwrap().is_empty());
    rows_become(directory.path(), &before).await;
    server.stop();
}
