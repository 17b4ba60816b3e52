//! What a map keeps of sessions and frames, and what it weighs.

use std::io::Cursor;

use fabmap::observation::Observation;
use sqlx::Row;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use waypost_client::v1::get_frame_image_request::Size;
use waypost_client::v1::map_settings::Keep;
use waypost_client::{Client, Code, FrameContent, FrameInput, SessionOptions, v1};
use waypost_proto::v1::session_service_client::SessionServiceClient;
use waypost_vision::feature_record::FeatureRecord;

use crate::harness::{
    CommandLine, SECOND_NS, Server, answers, answers_of, as_histogram, as_words, assert_status, channel,
    first_return, folder, frame, images, map_request, mapped, path, reference, refused, told, words_options,
};

async fn map_that_keeps(client: &Client, map: &str, keep: Keep) {
    let settings = v1::MapSettings { keep: keep.into(), ..v1::MapSettings::default() };
    let request = v1::CreateMapRequest { settings: Some(settings), ..map_request(map, "shipped") };
    client.create_map(request).await.unwrap();
}

fn frame_name(map: &str, session: &str, sequence: u64) -> String {
    format!("maps/{map}/sessions/{session}/frames/{sequence}")
}

fn camera() -> v1::Camera {
    let model = v1::camera::Model::FieldOfView(v1::FieldOfView { horizontal_rad: 1.2 });
    v1::Camera {
        model: Some(model),
        image_width_px: Some(640),
        image_height_px: Some(360),
        base_to_camera: None,
    }
}

fn with_odometry(sequence: u64) -> FrameInput {
    let covariance: Vec<f64> = (0..36).map(|index| if index % 7 == 0 { 0.25 } else { 0.0 }).collect();
    let odometry = v1::Odometry {
        pose: Some(v1::Pose {
            position_m: Some(v1::Vector3 { x: 0.5 * sequence as f64, y: -1.25, z: 0.0 }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }),
        }),
        covariance,
    };
    FrameInput { odometry: Some(odometry), ..as_histogram(sequence) }
}

#[tokio::test(flavor = "multi_thread")]
async fn sessions_are_listed_page_by_page() {
    let (server, client) = Server::with_map_of_words().await;
    assert_eq!(client.sessions("drive").await.unwrap(), []);
    let with_camera = SessionOptions { camera: Some(camera()), ..words_options("drive", "second") };
    mapped(&client, "first", 1..=25).await;
    let again = first_return();
    let answers = answers_of(&client, with_camera, (again..again + 6).map(as_histogram)).await;
    drop(client.open_session(words_options("drive", "third")).await.unwrap());

    let all = client.sessions("drive").await.unwrap();
    let names: Vec<&str> = all.iter().map(|session| session.name.as_str()).collect();
    assert_eq!(names, ["first", "second", "third"].map(|id| format!("maps/drive/sessions/{id}")));
    let closures = answers.iter().filter(|answer| answer.reason() == v1::Reason::LoopClosure).count();
    assert!(closures > 0, "no loop was closed");
    let second = &all[1];
    assert_eq!((second.frames, second.loop_closures), (6, closures as u64));
    assert_eq!((second.first_sequence, second.last_sequence), (Some(again), Some(again + 5)));
    let stamp_ns = |sequence: u64| Some(SECOND_NS * sequence as i64);
    assert_eq!((second.first_stamp_ns, second.last_stamp_ns), (stamp_ns(again), stamp_ns(again + 5)));
    assert_eq!(second.camera, Some(camera()));
    let third = &all[2];
    assert_eq!((third.frames, third.first_sequence, third.last_stamp_ns), (0, None, None));
    assert_eq!((&third.camera, third.create_time_ns >= second.create_time_ns), (&None, true));
    for session in &all {
        assert_eq!(&client.session(&session.name).await.unwrap(), session);
    }

    let mut service = SessionServiceClient::new(channel(&server.endpoint()).await);
    let mut paged = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListSessionsRequest { map: "maps/drive".to_owned(), page_size: 2, page_token };
        let page = service.list_sessions(request).await.unwrap().into_inner();
        assert!(!page.sessions.is_empty() && page.sessions.len() <= 2);
        paged.extend(page.sessions);
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(paged, all);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_is_kept_as_its_robot_was_told() {
    let (server, client) = Server::with_map().await;
    // Gaps between numbers, and odometry.
    let sequences: Vec<u64> = (1..=24).filter(|sequence| sequence % 5 != 0).collect();
    let frames = sequences.iter().copied().map(with_odometry);
    let answers = answers_of(&client, words_options("drive", "robot"), frames).await;
    let listed = client.frames("maps/drive/sessions/robot").await.unwrap();
    assert_eq!(listed.len(), sequences.len());
    for ((answer, record), &sequence) in answers.iter().zip(&listed).zip(&sequences) {
        let name = frame_name("drive", "robot", sequence);
        let whole = client.frame(&name).await.unwrap();
        assert_eq!(whole, v1::FrameRecord { histogram: whole.histogram.clone(), ..record.clone() });
        let v1::FrameRecord {
            name: named,
            stamp_ns,
            answer: kept,
            odometry,
            learnt,
            storage,
            histogram,
            note: _,
            corrections,
        } = whole;
        assert_eq!(corrections, []);
        assert_eq!((named, stamp_ns), (name, SECOND_NS * sequence as i64));
        let told = v1::FrameAnswer {
            timings: None,
            map_pose: None,
            last_committed_sequence: sequence,
            ..answer.clone()
        };
        assert_eq!(kept, Some(told));
        assert_eq!(odometry, with_odometry(sequence).odometry);
        assert_eq!(histogram, Some(crate::harness::histogram(sequence)));
        assert_eq!(record.histogram, None, "lists come without words");
        assert!(learnt || answer.reason() != v1::Reason::NewPlace, "a new place learnt nothing");
        assert!(storage.unwrap().log_bytes > 0);
    }

    let mut service = SessionServiceClient::new(channel(&server.endpoint()).await);
    let session = || "maps/drive/sessions/robot".to_owned();
    let (mut paged, mut page_token) = (Vec::new(), String::new());
    loop {
        let request =
            v1::ListFramesRequest { session: session(), page_size: 7, page_token, ..Default::default() };
        let page = service.list_frames(request).await.unwrap().into_inner();
        assert!(!page.frames.is_empty() && page.frames.len() <= 7);
        paged.extend(page.frames);
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(paged, listed);
    server.stop().await;
}

fn png(width: u32, height: u32) -> Vec<u8> {
    let shrunk = image::load_from_memory(&images()[0]).unwrap().resize_exact(
        width,
        height,
        image::imageops::FilterType::Triangle,
    );
    let mut png = Cursor::new(Vec::new());
    shrunk.to_luma8().write_to(&mut png, image::ImageFormat::Png).unwrap();
    png.into_inner()
}

async fn image_of(
    client: &Client,
    map: &str,
    sequence: u64,
    size: Size,
) -> Option<v1::GetFrameImageResponse> {
    let name = frame_name(map, "robot", sequence);
    match client.frame_image(&name, size).await {
        Ok(image) => Some(image),
        Err(error) => {
            let (code, message) = refused::<()>(Err(error));
            assert_status(&name, (code, &message), Code::NotFound, "a map that keeps");
            None
        }
    }
}

/// The sides of a JPEG.
fn jpeg_size_px(response: &v1::GetFrameImageResponse) -> (u32, u32) {
    assert_eq!(response.content_type, "image/jpeg");
    let image = image::load_from_memory_with_format(&response.image, image::ImageFormat::Jpeg).unwrap();
    (image.width(), image.height())
}

#[tokio::test(flavor = "multi_thread")]
async fn images_are_kept_as_the_map_says() {
    let (server, client) = Server::with_map().await;
    let original = image::load_from_memory(&images()[0]).unwrap();
    let small = png(100, 60);
    let seen = [images()[0].clone(), png(320, 180), small.clone()];
    for (map, keep) in [("words", Keep::Words), ("features", Keep::Features), ("images", Keep::Images)] {
        map_that_keeps(&client, map, keep).await;
        let images = seen.iter().cloned().map(FrameContent::Image);
        let frames = (1..).zip(images).map(|(sequence, content)| FrameInput { content, ..frame(sequence) });
        let frames = frames.chain([as_words(4), as_histogram(5)]);
        answers_of(&client, words_options(map, "robot"), frames.collect::<Vec<_>>()).await;
        for sequence in 1..=5_u64 {
            let best = image_of(&client, map, sequence, Size::Unspecified).await;
            let whole = image_of(&client, map, sequence, Size::Original).await;
            let thumbnail = image_of(&client, map, sequence, Size::Thumbnail).await;
            let record = client.frame(&frame_name(map, "robot", sequence)).await.unwrap();
            let storage = record.storage.unwrap();
            let length = |image: &Option<v1::GetFrameImageResponse>| {
                image.as_ref().map_or(0, |i| i.image.len() as u64)
            };
            assert_eq!((storage.thumbnail_bytes, storage.image_bytes), (length(&thumbnail), length(&whole)));
            let sent_image = sequence <= 3;
            assert_eq!(thumbnail.is_some(), sent_image && keep != Keep::Words, "{map} {sequence}");
            assert_eq!(whole.is_some(), sent_image && keep == Keep::Images, "{map} {sequence}");
            // A histogram has no keypoints.
            assert_eq!(storage.features_bytes > 0, sequence != 5 && keep != Keep::Words, "{map} {sequence}");
            if let Some(whole) = &whole {
                assert!(whole.image == seen[sequence as usize - 1], "frame {sequence} came back otherwise");
                assert_eq!(whole.content_type, if sequence == 1 { "image/jpeg" } else { "image/png" });
            }
            assert!(best == whole.or(thumbnail.clone()), "{map} {sequence}");
            if let Some(thumbnail) = &thumbnail {
                let height = (160 * original.height() + original.width() / 2) / original.width();
                let expected = [(160, height), (160, 90), (100, 60)][sequence as usize - 1];
                assert_eq!(jpeg_size_px(thumbnail), expected);
            }
        }
    }
    // An image that a thumbnail cannot be made of is the sender's affair, not a fault of the server.
    let ribbon = image::GrayImage::new(16, 70_000);
    let mut bytes = Cursor::new(Vec::new());
    ribbon.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    let ribbon = FrameContent::Image(bytes.into_inner());
    let (code, message) = refused(client.query("features", ribbon, "", Some(0)).await);
    assert_status("ribbon", (code, &message), Code::InvalidArgument, "no side may have more than 65535");
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn kept_features_give_the_words_again() {
    let (server, client) = Server::with_map().await;
    let frames = [frame(1), as_words(2), frame(3)];
    answers_of(&client, words_options("drive", "robot"), frames).await;
    let file = server.directory().join("waypost.sqlite");
    let mut database = SqliteConnectOptions::new().filename(file).read_only(true).connect().await.unwrap();
    let rows = sqlx::query("SELECT content FROM frame_media WHERE kind = 'features' ORDER BY position")
        .fetch_all(&mut database)
        .await
        .unwrap();
    database.close().await.unwrap();
    assert_eq!(rows.len(), 3);
    let (width, height) =
        image::load_from_memory(&images()[0]).map(|image| (image.width(), image.height())).unwrap();
    for (sequence, row) in (1..).zip(rows) {
        let content: Vec<u8> = row.get(0);
        let record = FeatureRecord::from_bytes(&content).unwrap();
        assert_eq!(record.image_size_px(), (width, height));
        let words = reference().model().vocabulary();
        let observation = Observation::from_words(record.words().iter().copied(), words.len()).unwrap();
        assert_eq!(&observation, reference().observation(sequence), "frame {sequence}");
        assert_eq!(record.keypoints().len(), record.words().len());
        let inside = |x: f32, side: u32| (-1.0..=side as f32).contains(&x);
        assert!(
            record.keypoints().iter().all(|point| inside(point.x_px, width) && inside(point.y_px, height))
        );
        // A robot that sends words keeps its descriptors.
        assert_eq!(record.descriptors().is_some(), sequence != 2, "frame {sequence}");
        if let Some(descriptors) = record.descriptors() {
            assert_eq!(&words.observe(descriptors).unwrap(), reference().observation(sequence));
        }
    }
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_map_weighs_is_what_its_frames_weigh() {
    let directory = tempfile::tempdir().unwrap();
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    crate::harness::import_model(&client).await;
    map_that_keeps(&client, "drive", Keep::Images).await;
    let empty = client.map("drive", v1::MapView::Full).await.unwrap().storage.unwrap();
    assert_eq!(empty, v1::MapStorage::default());
    answers(&client, "drive", "robot", (1..=5).map(frame)).await;
    answers_of(&client, words_options("drive", "words"), (6..=9).map(as_words)).await;
    assert_eq!(client.map("drive", v1::MapView::Unspecified).await.unwrap().storage, None);
    let weight = client.map("drive", v1::MapView::Full).await.unwrap().storage.unwrap();
    let mut frames = client.frames("maps/drive/sessions/robot").await.unwrap();
    frames.extend(client.frames("maps/drive/sessions/words").await.unwrap());
    let sum = |part: fn(&v1::FrameStorage) -> u64| -> u64 {
        frames.iter().map(|frame| part(frame.storage.as_ref().unwrap())).sum()
    };
    assert_eq!(weight.features_bytes, sum(|storage| storage.features_bytes));
    assert_eq!(weight.thumbnail_bytes, sum(|storage| storage.thumbnail_bytes));
    assert_eq!(weight.image_bytes, sum(|storage| storage.image_bytes));
    assert_eq!(weight.image_bytes, images()[..5].iter().map(|image| image.len() as u64).sum::<u64>());
    // The openings of the sessions are in the log beside the frames.
    let openings = weight.log_bytes - sum(|storage| storage.log_bytes);
    assert!((2..=32).contains(&openings), "{openings} bytes for two openings");
    assert_eq!(weight.checkpoint_bytes, 0, "nothing was closed yet");
    assert_per_frame(&weight, 9.0);
    server.stop().await;

    // Closing writes a checkpoint; it weighs as well.
    let server = Server::start_on(directory.path()).await;
    let client = server.client().await;
    let after = client.map("drive", v1::MapView::Full).await.unwrap().storage.unwrap();
    assert!(after.checkpoint_bytes > 0);
    let v1::MapStorage { checkpoint_bytes, bytes_per_frame, .. } = after;
    assert_eq!(after, v1::MapStorage { checkpoint_bytes, bytes_per_frame, ..weight });
    assert_per_frame(&after, 9.0);
    server.stop().await;
}

#[track_caller]
fn assert_per_frame(storage: &v1::MapStorage, frames: f64) {
    let v1::MapStorage {
        log_bytes,
        checkpoint_bytes,
        features_bytes,
        thumbnail_bytes,
        image_bytes,
        bytes_per_frame,
    } = storage;
    let all = log_bytes + checkpoint_bytes + features_bytes + thumbnail_bytes + image_bytes;
    assert_eq!(*bytes_per_frame, all as f64 / frames);
}

#[test]
fn the_command_line_lists_sessions_frames_and_weights() {
    let waypost = CommandLine::new();
    waypost.prepare();
    waypost.text(&["map", "create", "album", "--model", "shipped", "--keep", "images"]);
    let folder = folder(4);
    waypost.json(&["stream", path(folder.path()), "--map", "album", "--session", "robot"]);
    let sessions = waypost.json(&["session", "ls", "album"]);
    assert_eq!(sessions["sessions"][0]["name"], "maps/album/sessions/robot");
    assert_eq!(sessions["sessions"][0]["frames"], 4);
    let frames = waypost.json(&["session", "frames", "album", "robot"]);
    let frames = frames["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 4);
    let map = waypost.json(&["map", "show", "album"]);
    assert_eq!(map["settings"]["keep"], "images");
    for part in ["features_bytes", "thumbnail_bytes", "image_bytes"] {
        let sum: u64 = frames.iter().map(|frame| frame["storage"][part].as_u64().unwrap()).sum();
        assert!(sum > 0);
        assert_eq!(map["storage"][part].as_u64(), Some(sum), "{part}");
    }
    let text = waypost.text(&["session", "frames", "album", "robot"]);
    assert!(text.starts_with("FRAME") && text.contains("new_place"), "{text}");
    assert!(waypost.text(&["session", "ls", "album"]).contains("robot"));
}

/// What the list of frames says is what the stream was told, also of frames that were matched.
#[tokio::test(flavor = "multi_thread")]
async fn listed_frames_name_what_they_matched() {
    let (server, client) = Server::with_map().await;
    mapped(&client, "first", 1..=25).await;
    let again = first_return();
    let answers = mapped(&client, "second", again..again + 8).await;
    let listed = client.frames("maps/drive/sessions/second").await.unwrap();
    for (answer, record) in answers.iter().zip(&listed) {
        let kept = record.answer.as_ref().unwrap();
        assert_eq!(told(kept), told(answer));
        let session =
            |answer: &v1::FrameAnswer| answer.best_candidate.as_ref().map(|found| found.frame.clone());
        assert_eq!(session(kept), session(answer));
    }
    let matched = |record: &v1::FrameRecord| record.answer.as_ref().and_then(|answer| answer.r#match.clone());
    let closures: Vec<v1::Match> = listed.iter().filter_map(matched).collect();
    assert!(!closures.is_empty(), "no loop was closed");
    for closure in closures {
        assert_eq!(closure.frame.unwrap().session, "maps/drive/sessions/first");
    }
    server.stop().await;
}
