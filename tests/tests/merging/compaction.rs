//! What was removed from a map leaves the disk when it is compacted.

use waypost_client::{Code, v1};

use crate::harness::{Server, answers, followed, frame, refused, state_hash};

/// What was removed is between the rows of the file until the map is compacted.
#[tokio::test(flavor = "multi_thread")]
async fn what_was_removed_is_wiped_from_the_disk() {
    let (server, client) = Server::with_map().await;
    answers(&client, "drive", "robot", (1..=5).map(frame)).await;
    answers(&client, "drive", "visitor", (60..=64).map(frame)).await;
    let seen = client
        .frame_image("maps/drive/sessions/visitor/frames/62", v1::get_frame_image_request::Size::Thumbnail)
        .await;
    let seen = seen.unwrap().image;
    let middle = &seen[seen.len() / 2..seen.len() / 2 + 48];
    let traces = || {
        let files = ["waypost.sqlite", "waypost.sqlite-wal"].map(|file| server.directory().join(file));
        let bytes: Vec<u8> = files.iter().flat_map(|file| std::fs::read(file).unwrap_or_default()).collect();
        bytes.windows(middle.len()).filter(|window| *window == middle).count()
    };
    assert!(traces() > 0);
    let job = client.delete_session("maps/drive/sessions/visitor").await.unwrap();
    followed(&client, &job).await;
    assert!(traces() > 0, "there is nothing to wipe");
    let hash = state_hash(&client, "drive").await;
    let job = client.compact_map("drive").await.unwrap();
    assert_eq!(followed(&client, &job).await.pop().unwrap().state(), v1::job::State::Succeeded);
    assert_eq!(traces(), 0);
    assert_eq!(state_hash(&client, "drive").await, hash);
    assert_eq!(refused(client.compact_map("nowhere").await).0, Code::NotFound);
    server.stop().await;
}
