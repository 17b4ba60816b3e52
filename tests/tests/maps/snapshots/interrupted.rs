//! Imports and uploads that end before their time leave nothing behind.

use super::*;

#[tokio::test(flavor = "multi_thread")]
async fn an_import_that_is_cancelled_leaves_nothing() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=10).map(frame)).await;
    let file = export(&client, "drive").await;
    let before = rows(server.directory()).await;
    // One job at a time: this one keeps the import waiting.
    let settings =
        v1::TrainModelSettings { words: 4000, image_count: Some(40), ..v1::TrainModelSettings::default() };
    let training = futures::stream::iter(images().iter().take(40).cloned().map(Ok));
    let training = in_time(client.train_model(settings, training)).await.unwrap();
    let waiting = in_time(client.import_map("copy", Cursor::new(file.clone()))).await.unwrap();
    assert_eq!(client.maps().await.unwrap().len(), 1);
    let (code, _) = refused(client.map("copy", v1::MapView::Unspecified).await);
    assert_eq!(code, Code::NotFound);
    for job in [&waiting, &training] {
        client.cancel_job(&job.name).await.unwrap();
        let last = followed(&client, job).await.pop().unwrap();
        assert_eq!(last.state(), v1::job::State::Cancelled, "{last:?}");
        assert_eq!(client.job(&job.name).await.unwrap(), last);
    }
    rows_become(server.directory(), &before).await;
    imported(&client, "copy", file).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_import_that_is_cancelled_while_it_is_stored_leaves_nothing() {
    let server = Server::start().await;
    let client = server.client().await;
    let before = rows(server.directory()).await;
    let file = std::fs::read(workspace().join(VERSION_1)).unwrap();
    let mut database = tables(server.directory()).await;
    // Sixteen events in the log, six times joined with itself: a second or so.
    let slow = "CREATE TRIGGER slow BEFORE INSERT ON frame_media WHEN NEW.position = 1 AND NEW.kind = 'features' \
                BEGIN SELECT count(*) FROM log AS a, log AS b, log AS c, log AS d, log AS e, log AS f; END";
    sqlx::query(slow).execute(&mut database).await.unwrap();
    let job = in_time(client.import_map("", Cursor::new(file.clone()))).await.unwrap();
    let mut steps = client.watch_job(&job.name).await.unwrap();
    while in_time(steps.next()).await.unwrap().expect("the job is stored").stage != "storing the map" {}
    let (code, _) = refused(client.map("fixture", v1::MapView::Unspecified).await);
    assert_eq!(code, Code::NotFound, "half a map is seen");
    client.cancel_job(&job.name).await.unwrap();
    let last = followed(&client, &job).await.pop().unwrap();
    assert_eq!((last.state(), &last.result), (v1::job::State::Cancelled, &None), "{last:?}");
    rows_become(server.directory(), &before).await;
    sqlx::query("DROP TRIGGER slow").execute(&mut database).await.unwrap();
    database.close().await.unwrap();
    imported(&client, "", file).await;
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_import_that_fails_half_stored_leaves_nothing() {
    let server = Server::start().await;
    let client = server.client().await;
    let before = rows(server.directory()).await;
    let file = std::fs::read(workspace().join(VERSION_1)).unwrap();
    let mut database = tables(server.directory()).await;
    let broken = "CREATE TRIGGER broken BEFORE INSERT ON frame_media WHEN NEW.position > 5 \
                  BEGIN SELECT RAISE(ABORT, 'a broken disk'); END";
    sqlx::query(broken).execute(&mut database).await.unwrap();
    let job = import(&client, "", file.clone()).await.unwrap();
    assert_eq!((job.state(), job.stage.as_str()), (v1::job::State::Failed, "storing the map"), "{job:?}");
    assert!(said(&job.error).contains("its log says more") && job.result.is_none(), "{job:?}");
    assert_eq!(client.job(&job.name).await.unwrap(), job);
    assert!(client.maps().await.unwrap().is_empty());
    // The model that it brought goes too.
    rows_become(server.directory(), &before).await;
    sqlx::query("DROP TRIGGER broken").execute(&mut database).await.unwrap();
    database.close().await.unwrap();
    imported(&client, "", file).await;
    assert_eq!(state_hash(&client, "fixture").await, VERSION_1_STATE);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_crash_left_of_an_import_is_taken_away() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=10).map(frame)).await;
    let file = export(&client, "drive").await;
    server.stop().await;

    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let empty = rows(directory.path()).await;
    let client = server.client().await;
    let job = imported(&client, "drive", file.clone()).await;
    server.stop().await;
    // As it was before the import's last transaction.
    for statement in [
        "UPDATE maps SET state = 'importing'",
        "UPDATE jobs SET state = 'running', ended_ns = NULL, result = (SELECT 'models/' || hash FROM models)",
    ] {
        sql(directory.path(), statement).await;
    }
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    assert!(client.maps().await.unwrap().is_empty());
    let cut_off = client.job(&job.name).await.unwrap();
    assert_eq!((cut_off.state(), &cut_off.result), (v1::job::State::Failed, &None));
    assert!(said(&cut_off.error).contains("start it again: nothing will be there twice"), "{cut_off:?}");
    rows_become(directory.path(), &empty).await;
    imported(&client, "", file).await;
    assert_eq!(state_hash(&client, "drive").await, reference().maps[10].state_hash);
    server.stop().await;
}

/// Files that are being uploaded have no name, so that not even `kill -9` leaves one.
#[tokio::test(flavor = "multi_thread")]
async fn an_upload_that_is_cut_off_leaves_no_file() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let mut raw = MapServiceClient::new(channel(&server.endpoint()).await);
    let (uploading, receiver) = mpsc::channel(4);
    let first = v1::ImportMapRequest { map_id: Some("new".to_owned()), chunk: vec![1; 1 << 20] };
    uploading.send(first).await.unwrap();
    let call = tokio::spawn(async move { raw.import_map(ReceiverStream::new(receiver)).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(!call.is_finished());
    server.kill();
    assert!(in_time(call).await.unwrap().is_err());
    let left = std::fs::read_dir(directory.path()).unwrap().map(|file| file.unwrap().file_name());
    let mut left: Vec<String> = left.map(|name| name.into_string().unwrap()).collect();
    left.retain(|name| !name.starts_with("waypost.sqlite"));
    assert_eq!(left, ["waypost.lock"]);
}
