//! Videos, whose images an ffmpeg process writes into a folder that lasts as long as the command.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use tempfile::TempDir;
use tokio::process::Command;

use super::ImageFile;

/// Images a second that are taken of a video, unless told otherwise: a robot that walks sees each place a few times.
pub(crate) const DEFAULT_RATE_HZ: f64 = 2.0;

/// How files of videos end.
const ENDINGS: [&str; 9] = ["mp4", "m4v", "mov", "mkv", "webm", "avi", "mpg", "mpeg", "ts"];

/// The images of a video.
pub(crate) struct Video {
    /// With stamps that count from its begin, and called by them.
    pub(crate) images: Vec<ImageFile>,
    /// Where they are, until this is dropped.
    pub(crate) folder: TempDir,
    /// What is wrong with the video, for people; the images are what could be read.
    pub(crate) trouble: Option<String>,
}

/// Why a video has no usable images.
#[derive(Debug, thiserror::Error)]
pub(crate) enum VideoError {
    #[error(
        "{} is a video, and there is no ffmpeg on this machine to read it; install it (`apt-get install ffmpeg`), or give a \
         folder of the video's images",
        .0.display()
    )]
    NoFfmpeg(PathBuf),
    #[error(
        "{}: ffmpeg cannot read it: {why}; is it a whole video? one whose recording was cut off may have no end to open it by",
        path.display()
    )]
    Unread { path: PathBuf, why: String },
    #[error("{} shows nothing; is it a recording of sound?", .0.display())]
    NoImages(PathBuf),
    #[error("there is no video {}; check the path", .0.display())]
    Missing(PathBuf),
    #[error("cannot keep the images of {}: {source}; set TMPDIR to a folder with room", path.display())]
    NoRoom { path: PathBuf, source: std::io::Error },
}

/// Whether something is a video, by its name.
pub(crate) fn is_video(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    !path.is_dir() && ENDINGS.contains(&ending.as_str())
}

/// Takes so many images a second of a video, or all if it has fewer.
pub(crate) async fn images_of_video(path: &Path, rate_hz: f64) -> Result<Video, VideoError> {
    if !path.exists() {
        return Err(VideoError::Missing(path.to_owned()));
    }
    let rate_hz = own_rate_hz(path).await.map_or(rate_hz, |own_hz| rate_hz.min(own_hz));
    let no_room = |source| VideoError::NoRoom { path: path.to_owned(), source };
    let folder = TempDir::new().map_err(no_room)?;
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-nostdin", "-loglevel", "error", "-i"]).arg(input(path));
    // The one shown at each moment; as JPEG of the best quality that stays small.
    ffmpeg.args(["-map", "0:v:0", "-vf", &format!("fps={rate_hz}"), "-q:v", "2", "-f", "image2"]);
    ffmpeg.arg(folder.path().join("%d.jpg")).stdin(Stdio::null()).kill_on_drop(true);
    let ended = ffmpeg.output().await.map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => VideoError::NoFfmpeg(path.to_owned()),
        _ => VideoError::Unread { path: path.to_owned(), why: error.to_string() },
    })?;
    let said = String::from_utf8_lossy(&ended.stderr);
    let why = said.lines().map(without_part_of_ffmpeg).find(|line| !line.is_empty());
    if why.is_some_and(|why| why.contains("matches no streams")) {
        return Err(VideoError::NoImages(path.to_owned()));
    }
    if !ended.status.success() {
        let why = why.unwrap_or("it does not say why").to_owned();
        return Err(VideoError::Unread { path: path.to_owned(), why });
    }
    let trouble =
        why.map(|why| format!("{}: ffmpeg read it, as far as it goes, and says: {why}", path.display()));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Numbered from 1, without gaps.
    let files = (1..).map(|number: u64| (number, folder.path().join(format!("{number}.jpg"))));
    let images: Vec<ImageFile> = files
        .take_while(|(_, file)| file.is_file())
        .map(|(number, file)| {
            let seconds = (number - 1) as f64 / rate_hz;
            // No stamp may be 0.
            let stamp_ns = ((seconds * 1e9).round() as i64).max(1);
            ImageFile { name: format!("{name} {seconds:.3} s"), path: file, stamp_ns: Some(stamp_ns) }
        })
        .collect();
    if images.is_empty() {
        return Err(VideoError::NoImages(path.to_owned()));
    }
    Ok(Video { images, folder, trouble })
}

/// What ffmpeg says, without which of its parts says it: `[mov @ 0x5f] moov atom not found`.
fn without_part_of_ffmpeg(line: &str) -> &str {
    let line = line.trim();
    let rest = line.strip_prefix('[').and_then(|line| line.split_once("] "));
    rest.map_or(line, |(_, said)| said.trim())
}

/// A file as ffmpeg takes it, which would read what is before a colon in a name as a protocol.
fn input(path: &Path) -> OsString {
    let mut input = OsString::from("file:");
    input.push(path);
    input
}

/// Images a second that a video has, if ffmpeg's own tool is there and knows: more than that would be copies.
async fn own_rate_hz(path: &Path) -> Option<f64> {
    let mut ffprobe = Command::new("ffprobe");
    ffprobe.args(["-v", "error", "-select_streams", "v:0", "-show_entries", "stream=avg_frame_rate"]);
    ffprobe.args(["-of", "default=noprint_wrappers=1:nokey=1"]).arg(input(path)).stdin(Stdio::null());
    let told = ffprobe.kill_on_drop(true).output().await.ok()?.stdout;
    let (images, seconds) = std::str::from_utf8(&told).ok()?.trim().split_once('/')?;
    let rate_hz = images.parse::<f64>().ok()? / seconds.parse::<f64>().ok()?;
    (rate_hz.is_finite() && rate_hz > 0.0).then_some(rate_hz)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ffmpeg_is_quoted_without_its_parts() {
        for (line, said) in [
            ("[mov,mp4 @ 0x5f] moov atom not found", "moov atom not found"),
            (" drive.mp4: Invalid data ", "drive.mp4: Invalid data"),
            ("[it ends here", "[it ends here"),
        ] {
            assert_eq!(without_part_of_ffmpeg(line), said);
        }
    }

    #[test]
    fn a_video_is_known_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, expected) in [("drive.MP4", true), ("drive.mkv", true), ("drive.mcap", false)] {
            let file = folder.path().join(name);
            std::fs::write(&file, "x").unwrap();
            assert_eq!(is_video(&file), expected, "{name}");
        }
        assert!(!is_video(folder.path()));
    }
}
