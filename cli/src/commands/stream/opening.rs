//! What is streamed: a folder's images, a video or a bag, and the camera that took them.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use tempfile::TempDir;
use waypost_bags::Bag;
use waypost_bags::rtabmap::RtabMap;
use waypost_client::{Client, v1};

use super::Seeing;
use crate::camera_file::described_camera;
use crate::conventions;
use crate::drive::{Drive, Topics, camera_message};
use crate::failure::Failure;
use crate::files::Asking;
use crate::images::{
    DEFAULT_RATE_HZ as VIDEO_RATE_HZ, ImageFile, Video, images_of, images_of_video, is_video, told_of_others,
};
use crate::moments::{Moments, moments};
use crate::names::short_map;
use crate::odometry::{self, StampedPose};
use crate::output::Output;
use crate::panorama::{mirror_camera, panorama_camera, size_px};
use crate::progress;
use crate::replay::{Recording, Replay, note, told_of_no_notes};
use crate::units;

/// Rate of generated stamps.
const DEFAULT_RATE_HZ: f64 = 1.0;

/// What is streamed.
pub(super) struct Opened {
    pub(super) recording: Recording,
    /// Of a video's images, which are gone with it.
    pub(super) folder: Option<TempDir>,
}

/// What to read beside the images, and how.
pub(super) struct Reading<'a> {
    pub(super) odometry: Option<&'a Path>,
    /// Images a second, of those without stamps.
    pub(super) rate_hz: Option<f64>,
    /// Images a second that are taken of a video.
    pub(super) video_rate_hz: Option<f64>,
    pub(super) topics: Topics,
}

/// The images of a folder, of a video, or of a bag.
pub(super) async fn recording(
    path: &Path,
    reading: Reading<'_>,
    asking: Asking,
    output: Output,
) -> Result<Opened, Failure> {
    let Reading { odometry, rate_hz, video_rate_hz, topics } = reading;
    if path.is_file() && RtabMap::is_database(path) {
        return Err(Failure::Unfit(format!(
            "{} is a database, as RTAB-Map writes; `waypost import` takes it",
            path.display()
        )));
    }
    let is_video = is_video(path);
    if video_rate_hz.is_some() && !is_video {
        return Err(Failure::Unfit(format!(
            "--video-rate is for videos, and {} is none; leave it out",
            path.display()
        )));
    }
    // A folder of images stays one, whatever else lies in it.
    if Bag::is_bag(path) && (!path.is_dir() || images_of(path).is_err()) {
        if odometry.is_some() {
            return Err(Failure::Unfit(
                "a bag brings its own odometry; leave out --odometry, or choose with --odometry-topic"
                    .to_owned(),
            ));
        }
        let drive = Drive::open(path, topics, output).await?;
        drive.tell();
        return Ok(Opened { recording: Recording::Bag(Arc::new(drive)), folder: None });
    }
    if let Some(flag) = topics.first_flag() {
        return Err(Failure::Unfit(format!(
            "{flag} is for bags, and {} is none; leave it out",
            path.display()
        )));
    }
    let (images, folder) = if is_video {
        let rate_hz = video_rate_hz.unwrap_or(VIDEO_RATE_HZ);
        let bar = progress::spinner(output, "reading the video");
        let Video { images, folder, trouble } = images_of_video(path, rate_hz).await?;
        bar.finish_and_clear();
        if let Some(trouble) = trouble {
            // If stderr is closed, the message is lost.
            let _ = writeln!(std::io::stderr(), "{trouble}");
        }
        (images, Some(folder))
    } else {
        (images_of(path)?, None)
    };
    let poses = odometry.map(poses_of).transpose()?;
    if let Some(poses) = &poses {
        check_units(poses, asking)?;
    }
    let with_file = odometry.zip(poses.as_deref());
    let of_sizes = several_sizes(&images);
    let Moments { moments, told } = moments(&images, with_file, rate_hz.unwrap_or(DEFAULT_RATE_HZ))?;
    let of_names = told_of_no_notes(&images);
    for line in told.into_iter().chain(of_sizes).chain(told_of_others(&images)).chain(of_names) {
        // If stderr is closed, the message is lost.
        let _ = writeln!(std::io::stderr(), "{line}");
    }
    Ok(Opened { recording: Recording::Folder { images, moments }, folder })
}

/// That images are of several sizes: of several cameras, perhaps, or some were cut. What cannot be read is refused later.
fn several_sizes(images: &[ImageFile]) -> Option<String> {
    let sizes: BTreeSet<(u32, u32)> = images.iter().filter_map(|image| size_px(image).ok()).collect();
    let mut of = sizes.iter().map(|(width, height)| format!("{width} x {height}"));
    let (first, second) = (of.next()?, of.next()?);
    Some(format!(
        "the images are of {} sizes, {first} and {second} pixels among them: views of one camera are recognised best",
        sizes.len()
    ))
}

fn poses_of(path: &Path) -> Result<Vec<StampedPose>, Failure> {
    let text = std::fs::read_to_string(path).map_err(Failure::file("read", path))?;
    odometry::parse(&text).map_err(|source| Failure::Odometry { path: path.to_owned(), source })
}

/// Asks about odometry that seems to be in other units, axes or conventions.
fn check_units(poses: &[StampedPose], asking: Asking) -> Result<(), Failure> {
    match [units::doubts(poses), conventions::doubts(poses)].concat().join("\n").as_str() {
        "" => Ok(()),
        doubts => asking.confirm_doubt(doubts),
    }
}

/// The camera that took the images, as far as flags or the bag describe it.
pub(super) fn declared_camera(seeing: Seeing, recording: &Recording) -> Result<Option<v1::Camera>, Failure> {
    let Seeing { panorama, mirror, camera } = seeing;
    if let Some(projection) = panorama {
        return panorama_camera(projection, first_size_px(recording)?).map(Some);
    }
    if let Some(file) = mirror {
        return Ok(Some(mirror_camera(&file, first_size_px(recording)?)?));
    }
    if let Some(described) = camera {
        let camera = described_camera(&described, first_size_px(recording)?)?;
        return Ok(Some(camera_message(&camera)));
    }
    Ok(match recording {
        Recording::Folder { images: _, moments: _ } => None,
        Recording::Bag(drive) => drive.camera(),
        Recording::Database(drive) => drive.camera.clone(),
    })
}

/// What is said of panoramas for a map that is navigated by metres: they are recognised in it, but nobody goes by them.
pub(super) async fn panoramas_for_metres(
    client: &Client,
    map: &str,
    camera: Option<&v1::Camera>,
) -> Option<String> {
    use v1::camera::Model;
    use v1::map_settings::NavigationStrategy;
    let is_panoramic = matches!(camera?.model.as_ref()?, Model::Panorama(_) | Model::HyperbolicMirror(_));
    // A map that is not there is named when the session is opened.
    let settings = client.map(map, v1::MapView::Basic).await.ok()?.settings.unwrap_or_default();
    match settings.navigation_strategy() {
        NavigationStrategy::Appearance => None,
        NavigationStrategy::Unspecified | NavigationStrategy::TopoMetric => is_panoramic.then(|| {
            format!(
                "the map {map} is navigated by metres: its places are recognised in panoramas, but no robot is led by how they \
                 look; for that, stream into a map that was created with --navigation-strategy appearance"
            )
        }),
    }
}

/// What is said of images that are much smaller than those that the map's model was made of: what look-alikes show in these
/// is not known then, and wrong places are taken for right ones.
pub(super) async fn smaller_than_the_models(
    client: &Client,
    map: &str,
    recording: &Recording,
) -> Option<String> {
    let (width_px, _) = first_size_px(recording).ok()?;
    let map = client.map(map, v1::MapView::Basic).await.ok()?;
    let extractor = client.model(&map.model).await.ok()?.extractor;
    let (_, model_width_px) = extractor.split_once(" width=")?;
    let model_width_px: u32 = model_width_px.parse().ok()?;
    (2 * width_px < model_width_px).then(|| {
        let fitting = extractor.replace(&format!(" width={model_width_px}"), &format!(" width={width_px}"));
        format!(
            "the images are {width_px} pixels wide, and the map's model is made for {model_width_px}: wrong places may be taken for \
             right ones; train a model of such images (`waypost model train --extractor \"{fitting}\"`), and make the map with it"
        )
    })
}

/// What is said of images without odometry that are to begin a session of a map with metres.
pub(super) async fn metres_left_out(client: &Client, map: &str, session: &str) -> Option<String> {
    let map = short_map(map);
    // One that goes on is asked about by what it had.
    if !session.is_empty() && client.session(&format!("maps/{map}/sessions/{session}")).await.is_ok() {
        return None;
    }
    // A map that has metres begins with some, as a rule.
    let first = client.place(&format!("maps/{map}/places/0")).await.ok()?;
    first.pose.is_some().then(|| {
        format!(
            "the map {map} has metres, and these images bring no odometry: was --odometry left out? no way to the places that \
             they add is measured, and no robot is led there"
        )
    })
}

fn first_size_px(recording: &Recording) -> Result<(u32, u32), Failure> {
    let unknown = || Failure::Unfit("the first image cannot be read; send JPEG or PNG".to_owned());
    match recording {
        Recording::Folder { images, moments: _ } => size_px(images.first().ok_or_else(unknown)?),
        Recording::Bag(drive) => drive.size_px().ok_or_else(unknown),
        Recording::Database(drive) => drive.size_px().ok_or_else(unknown),
    }
}

/// Positions that are further apart are not the same, in metres.
const SAME_POSITION_M: f64 = 1e-3;

/// Refuses a camera that the session does not have: it keeps what it was begun with.
async fn check_camera(client: &Client, session: &str, camera: Option<&v1::Camera>) -> Result<(), Failure> {
    let Some(camera) = camera else { return Ok(()) };
    match client.session(session).await?.camera {
        None => Err(keeps(session, "without a camera")),
        Some(there) if there.model != camera.model => Err(keeps(session, "with another camera")),
        Some(_) => Ok(()),
    }
}

fn keeps(session: &str, how: &str) -> Failure {
    Failure::Unfit(format!(
        "{session} was begun {how}, and stays so; give what it was begun with, or another --session; or take it out with \
         `waypost session rm`, and stream all of it again"
    ))
}

fn apart_m(one: &v1::Odometry, other: &v1::Odometry) -> f64 {
    let position =
        |odometry: &v1::Odometry| odometry.pose.as_ref().and_then(|pose| pose.position_m).unwrap_or_default();
    let (one, other) = (position(one), position(other));
    (one.x - other.x).hypot(one.y - other.y).hypot(one.z - other.z)
}

/// That closures measure no metres, where they could.
pub(super) fn camera_left_out(replay: &Replay, camera: Option<&v1::Camera>) -> Option<String> {
    let Recording::Folder { images: _, moments } = &replay.recording else { return None };
    let lacks_camera = camera.is_none() && moments.iter().any(|moment| moment.odometry.is_some());
    lacks_camera.then(|| {
        "no --camera: closures say which place it is, and do not measure where the robot is at it; --camera fov:DEGREES is a \
         beginning"
            .to_owned()
    })
}

/// Refuses to go on in a session that was begun with other images: what is at its last frame here must be what was there.
/// Doubts that it goes on without odometry if it had some.
///
/// # Errors
/// [`Failure::Unfit`] if the names differ, or what the images show, or if odometry was left out and nobody says that this is
/// meant.
pub(super) async fn check_resumed(
    client: &Client,
    (map, session): (&str, &str),
    (replay, camera): (&Replay, Option<&v1::Camera>),
    committed: u64,
    asking: Asking,
) -> Result<(), Failure> {
    check_camera(client, session, camera).await?;
    let Recording::Folder { images, moments } = &replay.recording else { return Ok(()) };
    let index = committed.checked_sub(1).and_then(|index| usize::try_from(index).ok());
    let Some(ImageFile { name, path, .. }) = index.and_then(|index| images.get(index)) else { return Ok(()) };
    let record = client.frame(&format!("{session}/frames/{committed}")).await?;
    let other = |there: &str| {
        Failure::Unfit(format!(
            "{session} was begun with other images: its frame {committed} is {there}, and here it is {name}; give the folder that it \
             was begun with, or another --session"
        ))
    };
    let here = note(name);
    if !record.note.is_empty() && !here.is_empty() && record.note != here {
        return Err(other(&record.note));
    }
    // Cameras count from 1 in every folder: what the image shows says more than its name.
    let image = tokio::fs::read(path).await.map_err(Failure::file("read", path))?;
    let content = replay.contents.content(image).await;
    let Ok(seen) = client.query(map, content, &replay.contents.words_hash(), None).await else {
        return Ok(());
    };
    let words = record.answer.as_ref().map_or(0, |answer| answer.words);
    if seen.words != words {
        return Err(other("an image of other content"));
    }
    let moment = index.and_then(|index| moments.get(index)).and_then(|moment| moment.odometry.as_ref());
    match (&record.odometry, moment) {
        (None, Some(_)) => return Err(keeps(session, "without odometry")),
        (Some(there), Some(here)) if apart_m(there, here) > SAME_POSITION_M => {
            return Err(keeps(session, "with other odometry"));
        }
        (None, None) | (Some(_), None | Some(_)) => {}
    }
    let is_over = committed >= images.len() as u64;
    if !is_over && record.odometry.is_some() && moments.iter().all(|moment| moment.odometry.is_none()) {
        return asking.confirm_doubt(&format!(
            "{session} has odometry up to its frame {committed}, and here is none: was --odometry left out? without it no way \
             to further places is measured, and the map falls into parts"
        ));
    }
    Ok(())
}
