//! Snapshots of all versions of the format open.

use super::*;

/// A keypoint of word 3 in an image of 64x48, without a descriptor: real ones would make files of 100 kB.
const ONE_FEATURE: &str = "x'01403001000020410000a041000000410000003f0000803f0300'";

/// Snapshots are kept for years.
#[tokio::test(flavor = "multi_thread")]
async fn snapshots_of_all_versions_open() {
    for (version, state, labels) in [
        (VERSION_1, VERSION_1_STATE, &[][..]),
        (VERSION_2, VERSION_2_STATE, &LABELS[..]),
        (VERSION_3, VERSION_3_STATE, &LABELS[..]),
    ] {
        let server = Server::start().await;
        let client = server.client().await;
        imported(&client, "", std::fs::read(workspace().join(version)).unwrap()).await;
        let map = client.map("fixture", v1::MapView::Full).await.unwrap();
        assert_eq!(map.state_hash.as_deref(), Some(state), "{version}");
        assert_eq!((map.frames, map.sessions), (14, 2));
        assert!(map.places > 1 && map.links > 0, "{map:?}");
        let media = rows(server.directory()).await.into_iter().find(|(table, _)| *table == "frame_media");
        assert_eq!(media, Some(("frame_media", 28)));
        let frames = client.frames("maps/fixture/sessions/first").await.unwrap();
        assert!(frames.iter().all(|frame| frame.note.is_empty()), "{version}: {frames:?}");
        let found = client.labels("fixture").await.unwrap();
        let found: Vec<_> = found.iter().map(|row| (row.place.as_str(), row.label.as_str())).collect();
        assert_eq!(found, labels, "{version}");
        let (mut raw, opened) = RawStream::open(&server.endpoint(), open("fixture", "first")).await.unwrap();
        assert_eq!(opened.last_committed_sequence, Some(10));
        assert!(raw.answered(wire(frame(10))).await.resent);
        assert!(!raw.answered(wire(frame(11))).await.resent);
        server.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "writes the fixture of a new format version"]
async fn write_fixture() {
    let server = Server::start().await;
    let client = server.client().await;
    let settings = v1::TrainModelSettings {
        display_name: "fixture".to_owned(),
        extractor: Some("orb features=150 width=320".to_owned()),
        words: 120,
        seed: 1,
        image_count: Some(30),
    };
    let training = futures::stream::iter(images().iter().take(30).cloned().map(Ok));
    let job = in_time(client.train_model(settings, training)).await.unwrap();
    let model = followed(&client, &job).await.pop().unwrap().result.unwrap();
    client.create_map(map_request("fixture", &model)).await.unwrap();
    answers(&client, "fixture", "first", (1..=10).map(frame)).await;
    answers(&client, "fixture", "second", (3..=6).map(frame)).await;
    for (kind, content) in [("features", ONE_FEATURE), ("thumbnail", "randomblob(40)")] {
        let insert = format!(
            "INSERT OR REPLACE INTO frame_media (map_id, position, kind, content) SELECT map_id, position, '{kind}', {content} FROM log WHERE sequence IS NOT NULL"
        );
        sql(server.directory(), &insert).await;
    }
    sql(server.directory(), "INSERT INTO map_models SELECT id, 2, model FROM maps").await;
    for (place, label) in LABELS {
        client.set_label(place, label, v1::LabelScope::Place).await.unwrap();
    }
    let file: PathBuf = workspace().join("tests/tests/fixtures/map-v4.snapshot");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(&file, export(&client, "fixture").await).unwrap();
    std::fs::write(file.with_extension("state-hash"), state_hash(&client, "fixture").await + "\n").unwrap();
    server.stop().await;
}
