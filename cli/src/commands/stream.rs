//! `waypost stream`: streams a folder of images or a bag, as a robot would.

mod agreement;
mod opening;
mod summary;
mod telling;

use std::fs::File;
use std::hash::{BuildHasher, RandomState};
use std::io::Write;
use std::path::{Path, PathBuf};

use tokio::sync::oneshot;
use waypost_client::{Client, ClientOptions, SessionOptions, v1};

use self::agreement::{FRAMES_AT_FIRST, Found, Streamed, has_odometry};
use self::opening::{
    Opened, Reading, camera_left_out, check_resumed, declared_camera, metres_left_out, panoramas_for_metres,
    recording, smaller_than_the_models,
};
use self::summary::{Hints, conclude};
pub(crate) use self::telling::closure_line;
use self::telling::{short_sequence_hint, tell};
use crate::drive::Topics;
use crate::failure::{EXIT_CODES, Failure};
use crate::files::{Asking, Replacing};
use crate::frame_row::FrameRow;
use crate::names::new_session;
use crate::output::Output;
use crate::panorama::Projection;
use crate::progress;
use crate::replay::Replay;
use crate::resumed::{Compared, check_begun_with};
use crate::robot_words::{ContentMaker, Words};
use crate::{camera_file, images, odometry};

/// Stream a folder of images, a video, or a robot's bag into a map and print the loop closures
///
/// Streams DIR/images, or DIR, by file names, numbers in them by their value (frame2 before
/// frame10): frame 1 is the first image. Each frame keeps the file's name as its note. Folders of
/// TUM RGB-D, EuRoC and KITTI odometry are streamed by their tables. A bag is an MCAP file, a database of rosbag2 (.db3) or its
/// folder, or a ROS 1 bag; it brings stamps, odometry and camera, and `waypost inspect` shows what
/// is in it. Of a video (.mp4, .mkv and others), ffmpeg takes --video-rate images a second; their
/// stamps count from the video's begin. With the --session of an earlier run it continues where
/// that run stopped; with --csv or --json it also fetches the answers of the earlier frames, so
/// that the rows are complete. With --localize every run starts from the beginning.
#[derive(clap::Args)]
#[command(
    after_help = EXIT_CODES,
    after_long_help = format!(
        "{}\n\n{}\n\n{}\n\n{EXIT_CODES}",
        images::LAYOUTS, odometry::FORMATS, camera_file::FORMATS
    )
)]
pub(crate) struct Arguments {
    /// Folder of JPEG or PNG images, a video, or a bag
    dir: PathBuf,
    /// Map to stream into
    #[arg(long)]
    map: String,
    /// Name of the session: 1 to 63 of a-z, 0-9, - and _; if left out, the server chooses one
    #[arg(long, value_name = "ID", default_value = "", hide_default_value = true, value_parser = new_session)]
    session: String,
    /// Odometry, joined to the images by time, or one row per image; --help describes the formats
    #[arg(long, value_name = "FILE")]
    odometry: Option<PathBuf>,
    /// Images per second; if left out, as fast as they are answered. Images without stamps and
    /// odometry get stamps at this rate, or else at 1 Hz
    #[arg(long, value_name = "HZ", value_parser = rate_hz)]
    rate: Option<f64>,
    /// Images a second that are taken of a video [default: 2]
    #[arg(long, value_name = "HZ", value_parser = rate_hz)]
    video_rate: Option<f64>,
    #[command(flatten)]
    topics: Topics,
    #[command(flatten)]
    words: Words,
    #[command(flatten)]
    seeing: Seeing,
    /// Only localize the robot: the map does not change
    #[arg(long)]
    localize: bool,
    /// Write a row per frame
    #[arg(long, value_name = "OUT")]
    csv: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "csv")]
    force: bool,
    /// Do not ask about odometry that seems to be wrong or missing
    #[arg(long)]
    yes: bool,
}

/// What is known of the camera.
#[derive(clap::Args)]
struct Seeing {
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
    /// How the camera sees, so that closures measure metres: a calibration of ROS or Kalibr,
    /// fx,fy,cx,cy and distortion, or fov:DEGREES; --help describes the formats
    #[arg(long, value_name = "FILE_OR_NUMBERS", conflicts_with_all = ["panorama", "mirror"])]
    camera: Option<String>,
}

impl Arguments {
    /// All of a bag.
    pub(crate) fn of_bag(
        dir: PathBuf,
        map: String,
        session: String,
        camera: Option<String>,
        topics: Topics,
    ) -> Self {
        Self {
            dir,
            map,
            session,
            odometry: None,
            rate: None,
            video_rate: None,
            topics,
            words: Words::default(),
            seeing: Seeing { panorama: None, mirror: None, camera },
            localize: false,
            csv: None,
            force: false,
            yes: false,
        }
    }
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments {
        dir,
        map,
        session,
        odometry,
        rate,
        video_rate,
        topics,
        words,
        seeing,
        localize,
        csv,
        force,
        yes,
    } = arguments;
    Replacing::of(force).check_wanted(csv.as_deref())?;
    let reading = Reading { odometry: odometry.as_deref(), rate_hz: rate, video_rate_hz: video_rate, topics };
    // The folder of a video's images stays until all is sent.
    let Opened { recording, folder: _folder } = recording(&dir, reading, Asking::unless(yes), output).await?;
    let camera = declared_camera(seeing, &recording)?;
    let client = Client::connect(server).await?;
    let of_panoramas = panoramas_for_metres(&client, &map, camera.as_ref()).await;
    let of_size = smaller_than_the_models(&client, &map, &recording).await;
    for line in of_panoramas.into_iter().chain(of_size) {
        // If stderr is closed, the hint is lost.
        let _ = writeln!(std::io::stderr(), "{line}");
    }
    let contents = ContentMaker::new(&client, &map, words.words).await?;
    let mode = if localize { v1::SessionMode::Localize } else { v1::SessionMode::Map };
    let words_hash = contents.words_hash();
    let compared = Compared::of(camera.as_ref());
    let run_id = format!("{:016x}", RandomState::new().hash_one(()));
    let options = SessionOptions {
        session_id: session,
        mode,
        words_hash,
        run_id,
        camera: camera.clone(),
        ..SessionOptions::new(&map)
    };
    let replay = Replay { recording, pace_hz: rate, contents };
    if let Some(hint) = camera_left_out(&replay, camera.as_ref()).filter(|_| mode == v1::SessionMode::Map) {
        // If stderr is closed, the hint is lost.
        let _ = writeln!(std::io::stderr(), "{hint}");
    }
    if let (v1::SessionMode::Map, false) = (mode, has_odometry(&replay))
        && let Some(doubt) = metres_left_out(&client, &map, &options.session_id).await
    {
        Asking::unless(yes).confirm_going_on(&doubt)?;
    }
    let session = client.open_session(options).await?;
    let mut table = csv.as_deref().map(Table::create).transpose()?;
    let opened = session.opened().clone();
    let committed = opened.last_committed_sequence;
    let wants_all_rows = table.is_some() || output == Output::Json;
    let after_sequence = if wants_all_rows { 0 } else { committed.unwrap_or(0) };
    let to_stream = unstreamed(&replay, committed, after_sequence, &opened.session)?;
    if let (Some(committed), v1::SessionMode::Map) = (committed, mode) {
        let asking = Asking::unless(yes);
        let what = (&replay, camera.as_ref());
        check_resumed(&client, (&map, &opened.session), what, committed, asking).await?;
        check_begun_with(&client, (&map, &opened.session), &replay, committed, compared).await?;
    }
    match committed {
        Some(sequence) if to_stream == 0 => {
            output.line(format_args!("{}: all {sequence} frames were sent before", opened.session))?;
        }
        Some(sequence) => output.line(format_args!("{} resumed after frame {sequence}", opened.session))?,
        None => output.line(format_args!("{} begun", opened.session))?,
    }

    let bar = progress::counter(output, "frames answered", to_stream);
    let mut rows = Vec::new();
    // Nothing is kept of a robot that only localizes.
    let is_agreement_told = mode == v1::SessionMode::Map && has_odometry(&replay);
    let streamed = Streamed { client: &client, map: &map, session: &opened.session };
    let (first, first_frames) = oneshot::channel();
    let mut first = Some(first).filter(|_| is_agreement_told);
    let streaming = replay.stream(session, after_sequence, |row| {
        bar.inc(1);
        bar.suspend(|| tell(&row, &replay, mode, &opened.session, output))?;
        if let Some(table) = &mut table {
            table.write(&row)?;
        }
        if let Some(first) = first.take_if(|_| rows.len() + 1 == FRAMES_AT_FIRST) {
            // Whom it is told to may be gone.
            let _ = first.send(row.sequence);
        }
        rows.push(row);
        Ok(())
    });
    let sent = tokio::select! {
        streamed = streaming => streamed?,
        doubted = streamed.doubt(first_frames, Asking::unless(yes)) => {
            bar.abandon();
            return Err(doubted);
        }
        interrupt = tokio::signal::ctrl_c() => {
            interrupt.map_err(Failure::Runtime)?;
            bar.abandon();
            let id = opened.session.rsplit('/').next().unwrap_or_default();
            let told = if localize { "stopped".to_owned() } else { format!("stopped; go on with --session {id}") };
            return Err(Failure::Interrupted(told));
        }
    };
    bar.finish_and_clear();
    let short_sequence = match mode {
        v1::SessionMode::Localize => None,
        v1::SessionMode::Map | v1::SessionMode::Unspecified => {
            short_sequence_hint(&client, &map, &rows).await?
        }
    };
    let last = rows.iter().filter(|row| row.reason.is_some()).map(|row| row.sequence).max();
    let found = match last.filter(|_| is_agreement_told) {
        Some(last) => streamed.found(last).await,
        None => None,
    };
    // A panorama has none.
    let has_field_of_view = camera.is_some() && compared == Compared::Images;
    let unchecked = found.as_ref().filter(|_| has_field_of_view).and_then(Found::unchecked);
    let odometry_finding = found.and_then(|found| found.finding);
    conclude(opened, rows, sent, mode, Hints { short_sequence, unchecked, odometry_finding }, output)
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
