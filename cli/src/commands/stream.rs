//! `waypost stream`: streams a folder of images or a bag, as a robot would.

use std::borrow::Cow;
use std::fs::File;
use std::hash::{BuildHasher, RandomState};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;
use waypost_bags::Bag;
use waypost_client::{Client, ClientOptions, SessionOptions, v1};

use crate::drive::{Drive, Topics};
use crate::failure::{EXIT_CODES, Failure};
use crate::files::Replacing;
use crate::frame_row::FrameRow;
use crate::images::{ImageFile, images_of};
use crate::odometry;
use crate::output::Output;
use crate::panorama::{Projection, camera_of, mirror_camera, size_px};
use crate::progress;
use crate::replay::{Recording, Replay, Sent, Stamps};
use crate::robot_words::{ContentMaker, Words};

/// Rate of generated stamps.
const DEFAULT_RATE_HZ: f64 = 1.0;

/// Stream a folder of images, or a robot's bag, into a map and print the loop closures
///
/// Streams DIR/images, or DIR, by file names, numbers in them by their value (frame2 before
/// frame10): frame 1 is the first image. A bag is an MCAP file, a database of rosbag2 (.db3) or its
/// folder, or a ROS 1 bag; it brings stamps, odometry and camera, and `waypost inspect` shows what
/// is in it. With the --session of an earlier run it continues where
/// that run stopped; with --csv or --json it also fetches the answers of the earlier frames, so
/// that the rows are complete. With --localize every run starts from the beginning.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES, after_long_help = format!("{}\n\n{EXIT_CODES}", odometry::FORMATS))]
pub(crate) struct Arguments {
    /// Folder of JPEG or PNG images, or a bag
    dir: PathBuf,
    /// Map to stream into
    #[arg(long)]
    map: String,
    /// Name of the session: 1 to 63 of a-z, 0-9, - and _; if left out, the server chooses one
    #[arg(long, value_name = "ID", default_value = "", hide_default_value = true)]
    session: String,
    /// Odometry, one row per image; --help describes the formats
    #[arg(long, value_name = "FILE")]
    odometry: Option<PathBuf>,
    /// Images per second; if left out, as fast as they are answered. Without odometry, stamps are
    /// then generated at 1 Hz
    #[arg(long, value_name = "HZ", value_parser = rate_hz)]
    rate: Option<f64>,
    #[command(flatten)]
    topics: Topics,
    #[command(flatten)]
    words: Words,
    /// The images are panoramas of 360 degrees with the robot's front in the middle. Maps with the
    /// navigation strategy appearance take these, or those of a --mirror
    #[arg(long, value_enum, value_name = "PROJECTION", conflicts_with = "words")]
    panorama: Option<Projection>,
    /// The images are of a camera that looks up into a hyperbolic mirror, described by a JSON file
    /// with center_x_px, center_y_px, inner_radius_px, outer_radius_px, eccentricity (above 1),
    /// horizon_radius_px and, if the robot's front is not on the right of the image, ahead_rad
    /// (counter-clockwise from the right)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["words", "panorama"])]
    mirror: Option<PathBuf>,
    /// Only localize the robot: the map does not change
    #[arg(long)]
    localize: bool,
    /// Write a row per frame
    #[arg(long, value_name = "OUT")]
    csv: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "csv")]
    force: bool,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    session: String,
    map: String,
    model: String,
    /// Null in a new session.
    resumed_after_sequence: Option<u64>,
    frame_count: usize,
    refused: usize,
    places_created: usize,
    loop_closures: usize,
    /// Mean length of an image or its words, in bytes; null if nothing was sent.
    bytes_per_frame: Option<f64>,
    /// Median time of a frame at the server; null if all answers were stored ones.
    ms_p50: Option<f64>,
    frames: Vec<FrameRow>,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments {
        dir,
        map,
        session,
        odometry,
        rate,
        topics,
        words,
        panorama,
        mirror,
        localize,
        csv,
        force,
    } = arguments;
    Replacing::of(force).check_wanted(csv.as_deref())?;
    let recording = recording(&dir, odometry.as_deref(), rate, topics, output).await?;
    let camera = match (panorama, mirror) {
        (Some(projection), _) => Some(camera_of(projection, first_size_px(&recording)?)),
        (None, Some(file)) => Some(mirror_camera(&file, first_size_px(&recording)?)?),
        (None, None) => declared_camera(&recording),
    };
    let client = Client::connect(server).await?;
    let contents = ContentMaker::new(&client, &map, words.words).await?;
    let mode = if localize { v1::SessionMode::Localize } else { v1::SessionMode::Map };
    let words_hash = contents.words_hash();
    let run_id = format!("{:016x}", RandomState::new().hash_one(()));
    let options =
        SessionOptions { session_id: session, mode, words_hash, run_id, camera, ..SessionOptions::new(&map) };
    let replay = Replay { recording, pace_hz: rate, contents };
    let session = client.open_session(options).await?;
    let mut table = csv.as_deref().map(Table::create).transpose()?;
    let opened = session.opened().clone();
    let committed = opened.last_committed_sequence;
    let wants_all_rows = table.is_some() || output == Output::Json;
    let after_sequence = if wants_all_rows { 0 } else { committed.unwrap_or(0) };
    let to_stream = unstreamed(&replay, committed, after_sequence, &opened.session)?;
    match committed {
        Some(sequence) => output.line(format_args!("{} resumed after frame {sequence}", opened.session))?,
        None => output.line(format_args!("{} begun", opened.session))?,
    }

    let bar = progress::counter(output, "frames answered", to_stream);
    let mut rows = Vec::new();
    let streaming = replay.stream(session, after_sequence, |row| {
        bar.inc(1);
        bar.suspend(|| tell(&row, &replay, &opened.session, output))?;
        if let Some(table) = &mut table {
            table.write(&row)?;
        }
        rows.push(row);
        Ok(())
    });
    let sent = tokio::select! {
        streamed = streaming => streamed?,
        interrupt = tokio::signal::ctrl_c() => {
            interrupt.map_err(Failure::Runtime)?;
            bar.abandon();
            let id = opened.session.rsplit('/').next().unwrap_or_default();
            let told = if localize { "stopped".to_owned() } else { format!("stopped; go on with --session {id}") };
            return Err(Failure::Interrupted(told));
        }
    };
    bar.finish_and_clear();
    conclude(opened, rows, sent, output)
}

/// Returns the number of frames to stream.
fn unstreamed(
    replay: &Replay,
    committed: Option<u64>,
    after_sequence: u64,
    session: &str,
) -> Result<usize, Failure> {
    let frames = replay.recording.last_sequence();
    match committed {
        Some(sequence) if sequence > frames => Err(Failure::Unfit(format!(
            "{session} is at frame {sequence} already, but there are only {frames} images; \
             give what it was begun with, or another --session"
        ))),
        Some(_) | None => Ok(replay.recording.count_after(after_sequence)),
    }
}

/// The images of a folder, or of a bag.
async fn recording(
    path: &Path,
    odometry: Option<&Path>,
    rate: Option<f64>,
    topics: Topics,
    output: Output,
) -> Result<Recording, Failure> {
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
        return Ok(Recording::Bag(Arc::new(drive)));
    }
    if let Some(flag) = topics.first_flag() {
        return Err(Failure::Unfit(format!(
            "{flag} is for bags, and {} is none; leave it out",
            path.display()
        )));
    }
    let images = images_of(path)?;
    let stamps = stamps(&images, odometry, rate)?;
    Ok(Recording::Folder { images, stamps })
}

fn first_size_px(recording: &Recording) -> Result<(u32, u32), Failure> {
    let unknown = || Failure::Unfit("the first image cannot be read; send JPEG or PNG".to_owned());
    match recording {
        Recording::Folder { images, stamps: _ } => size_px(images.first().ok_or_else(unknown)?),
        Recording::Bag(drive) => drive.size_px().ok_or_else(unknown),
    }
}

/// The camera that a bag describes.
fn declared_camera(recording: &Recording) -> Option<v1::Camera> {
    match recording {
        Recording::Folder { images: _, stamps: _ } => None,
        Recording::Bag(drive) => drive.camera(),
    }
}

fn stamps(images: &[ImageFile], odometry: Option<&Path>, rate: Option<f64>) -> Result<Stamps, Failure> {
    let Some(path) = odometry else {
        return Ok(Stamps::Even { rate_hz: rate.unwrap_or(DEFAULT_RATE_HZ) });
    };
    let text = std::fs::read_to_string(path).map_err(Failure::file("read", path))?;
    let poses =
        odometry::parse(&text).map_err(|source| Failure::Odometry { path: path.to_owned(), source })?;
    if poses.len() != images.len() {
        return Err(Failure::Unfit(format!(
            "{} has {} poses for {} images; write one row per image, in the order of the images",
            path.display(),
            poses.len(),
            images.len()
        )));
    }
    Ok(Stamps::Odometry(poses))
}

/// Loop closures go to stdout, refusals to stderr.
fn tell(row: &FrameRow, replay: &Replay, session: &str, output: Output) -> Result<(), Failure> {
    if let Some(message) = &row.refusal_message {
        let code = row.refusal_code.unwrap_or_default();
        // If stderr is closed, the message is lost.
        let _ = writeln!(std::io::stderr(), "{}: refused, {code}: {message}", row.image);
    }
    if row.reason == Some("loop_closure") {
        output.line(closure_line(row, replay, session))?;
    }
    Ok(())
}

/// A loop closure as a line of text. A matched frame of this session is named by its image.
pub(crate) fn closure_line(row: &FrameRow, replay: &Replay, session: &str) -> String {
    let matched = match (&row.match_session, row.match_sequence) {
        (Some(matched), Some(sequence)) if matched == session => {
            replay.image_name(sequence).map_or_else(|| format!("frame {sequence}"), Cow::into_owned)
        }
        (Some(matched), Some(sequence)) => format!("frame {sequence} of {matched}"),
        (_, _) => "no frame".to_owned(),
    };
    let place = row.match_place_number.unwrap_or_default();
    let posterior = row.match_posterior.unwrap_or_default();
    let how_sure = match (row.match_probability, row.match_inliers) {
        (Some(probability), Some(inliers)) => {
            format!("probability {probability:.3}, {inliers} features agree")
        }
        (_, _) => format!("posterior {posterior:.4}"),
    };
    format!("{} closes a loop with {matched}  place {place}  {how_sure}", row.image)
}

fn conclude(
    opened: v1::SessionOpened,
    frames: Vec<FrameRow>,
    sent: Sent,
    output: Output,
) -> Result<(), Failure> {
    let v1::SessionOpened { session, last_committed_sequence, model, words_hash: _ } = opened;
    let summary = Summary {
        map: session.split("/sessions/").next().unwrap_or_default().to_owned(),
        session,
        model,
        resumed_after_sequence: last_committed_sequence,
        frame_count: frames.len(),
        refused: frames.iter().filter(|row| row.refusal_code.is_some()).count(),
        // A localizing session has no place for frames with these reasons.
        places_created: frames
            .iter()
            .filter(|row| {
                row.place_number.is_some()
                    && matches!(row.reason, Some("new_place" | "below_threshold" | "geometry_refused"))
            })
            .count(),
        loop_closures: frames.iter().filter(|row| row.reason == Some("loop_closure")).count(),
        bytes_per_frame: sent.bytes_per_frame(),
        ms_p50: median(frames.iter().filter_map(|row| row.total_ms).collect()),
        frames,
    };
    output.result(&summary, |out| {
        writeln!(out, "frames         {}", summary.frame_count)?;
        writeln!(out, "new places     {}", summary.places_created)?;
        writeln!(out, "loop closures  {}", summary.loop_closures)?;
        writeln!(out, "refused        {}", summary.refused)?;
        if let Some(bytes) = summary.bytes_per_frame {
            writeln!(out, "bytes a frame  {bytes:.0} (mean, sent)")?;
        }
        match summary.ms_p50 {
            Some(ms_p50) => writeln!(out, "ms per frame   {ms_p50:.1} (median, at the server)"),
            None => Ok(()),
        }
    })?;
    match summary.refused {
        0 => Ok(()),
        refused => Err(Failure::FramesRefused { refused, frames: summary.frame_count }),
    }
}

/// The median of the values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied()
}

/// The CSV file. It has all rows so far, even if the stream is interrupted.
struct Table<'a> {
    path: &'a Path,
    rows: csv::Writer<File>,
}

impl<'a> Table<'a> {
    fn create(path: &'a Path) -> Result<Self, Failure> {
        let file = File::create(path).map_err(Failure::file("write", path))?;
        Ok(Self { path, rows: csv::Writer::from_writer(file) })
    }

    fn write(&mut self, row: &FrameRow) -> Result<(), Failure> {
        let written = self.rows.serialize(row).map_err(std::io::Error::from);
        written.and_then(|()| self.rows.flush()).map_err(Failure::file("write", self.path))
    }
}

fn rate_hz(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(rate_hz) if (1e-3..=1e3).contains(&rate_hz) => Ok(rate_hz),
        Ok(_) | Err(_) => Err("it has to be a number from 0.001 to 1000".to_owned()),
    }
}
