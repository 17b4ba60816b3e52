//! `waypost import`: the drives of an RTAB-Map database as sessions of a map, and how both maps compare; or a bag's drive.

mod closures;
mod report;
mod sessions;
mod trajectory;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use waypost_bags::Bag;
use waypost_bags::rtabmap::RtabMap;
use waypost_client::{Client, ClientOptions, v1};

use self::report::Report;
use self::sessions::{Importing, drives};
use super::stream;
use crate::drive::Topics;
use crate::failure::{EXIT_CODES, Failure};
use crate::images::images_of;
use crate::output::Output;
use crate::rtab_drive::{open_database, remarks, tell};

/// Stream the drives of an RTAB-Map database into a map, and compare both maps; or a robot's bag
///
/// A bag is streamed as `waypost stream` does, into a session that is named after the file. Each
/// map_id of a database becomes a session: images, stamps, odometry as it was before any
/// optimisation, and the camera. Places and loop closures are recognised anew; those of RTAB-Map
/// are held against them at the end. A frame's note is its node, as `node 17`. Called again, it
/// goes on where it stopped; `waypost session rm` takes a session out again. Databases of
/// RTAB-Map 0.17 to 0.23 are read; `waypost inspect` shows what is in one, without a server.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// RTAB-Map's database, as ~/.ros/rtabmap.db, or a bag
    database: PathBuf,
    /// Map to stream into
    #[arg(long)]
    map: String,
    /// Begin of the sessions' names, before `-` and their map_id, or the name of a bag's session; if
    /// left out, by the file's name
    #[arg(long, value_name = "NAME")]
    session: Option<String>,
    /// How the camera sees, in place of RTAB-Map's calibration: as for `waypost stream`, or `none`
    /// for a map without measured closures
    #[arg(long, value_name = "FILE_OR_NUMBERS")]
    camera: Option<String>,
    /// Two closures are the same if both their ends are at most so many nodes apart
    #[arg(long, value_name = "NODES", default_value_t = 5)]
    within: u64,
    #[command(flatten)]
    topics: Topics,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { database, map, session, camera, within, topics } = arguments;
    let prefix = session.map_or_else(|| prefix_of(&database), Ok)?;
    if is_bag(&database) {
        let arguments = stream::Arguments::of_bag(database, map, prefix, camera, topics);
        return stream::run(arguments, server, output).await;
    }
    if let Some(flag) = topics.first_flag() {
        return Err(Failure::Unfit(format!("{flag} is about bags, and {} is none", database.display())));
    }
    check_database(&database, &map)?;
    let rtabmap = Arc::new(open_database(&database, output).await?);
    tell(&database, &remarks(&rtabmap));
    let drives = drives(&rtabmap, camera.as_deref())?;
    let client = Client::connect(server).await?;
    let importing = Importing { client: &client, map: &map, prefix: &prefix, output };
    let mut imported = Vec::new();
    for drive in drives {
        imported.push(importing.session(drive).await?);
    }
    let guard_frames = guard_frames(&client, &map).await?;
    let report =
        Report::of(&client, &rtabmap, &map, imported, closures::Rule { within, guard_frames }).await?;
    output.result(&report, |out| report.write(out))?;
    match report.refused() {
        0 => Ok(()),
        refused => Err(Failure::FramesRefused { refused, frames: frames_of(&rtabmap) }),
    }
}

/// Whether it is a bag and no folder of images.
fn is_bag(path: &Path) -> bool {
    Bag::is_bag(path) && (!path.is_dir() || images_of(path).is_err())
}

/// Says which command takes a folder of images.
fn check_database(path: &Path, map: &str) -> Result<(), Failure> {
    if !path.is_dir() {
        return Ok(());
    }
    let shown = path.display();
    Err(Failure::Unfit(format!(
        "{shown} is a folder; give RTAB-Map's database, a file as ~/.ros/rtabmap.db, or a bag. Folders of images are streamed: \
         `waypost stream {shown} --map {map}`"
    )))
}

fn frames_of(rtabmap: &RtabMap) -> usize {
    rtabmap.sessions().iter().map(|session| session.frames().count()).sum()
}

async fn guard_frames(client: &Client, map: &str) -> Result<u64, Failure> {
    let settings = client.map(map, v1::MapView::Basic).await?.settings.unwrap_or_default();
    Ok(settings.guard_frames.unwrap_or_default().into())
}

/// The file's name as the begin of a session's: what it cannot have becomes a hyphen.
fn prefix_of(path: &Path) -> Result<String, Failure> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    let kept = stem.chars().map(|letter| match letter {
        'a'..='z' | '0'..='9' | '-' | '_' => letter,
        _ => '-',
    });
    // A session's name begins with a letter or digit.
    let kept = kept.skip_while(|letter| !letter.is_ascii_alphanumeric());
    let prefix: String = kept.take(MOST_PREFIX_LETTERS).collect();
    if prefix.is_empty() {
        return Err(Failure::Unfit(format!(
            "the name of {} makes no name of a session; give one with --session",
            path.display()
        )));
    }
    Ok(prefix)
}

/// A session's name has at most 63, and the map_id needs some.
const MOST_PREFIX_LETTERS: usize = 40;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_images_is_sent_to_the_command_that_takes_it_and_a_bag_is_one() {
        let folder = tempfile::tempdir().unwrap();
        let told = |path: &Path| check_database(path, "hall").map_err(|failure| failure.to_string());
        let plain = told(folder.path()).unwrap_err();
        let stream = format!("`waypost stream {} --map hall`", folder.path().display());
        assert!(
            plain.contains("is a folder; give RTAB-Map's database") && plain.contains(&stream),
            "{plain}"
        );
        assert!(!is_bag(folder.path()));
        for name in ["drive.mcap", "drive.bag", "drive.db3", "drive.mcap.zstd"] {
            let bag = folder.path().join(name);
            std::fs::write(&bag, b"").unwrap();
            assert!(is_bag(&bag), "{name}");
        }
        assert!(is_bag(folder.path()));
        let database = folder.path().join("rtabmap.db");
        assert!(!is_bag(&database) && told(&database).is_ok());
    }

    #[test]
    fn sessions_are_called_by_the_file() {
        let prefix = |path: &str| prefix_of(Path::new(path));
        assert_eq!(prefix("/home/a/.ros/rtabmap.db").unwrap(), "rtabmap");
        assert_eq!(prefix("Third Floor (2).db").unwrap(), "third-floor--2-");
        assert_eq!(prefix("_(old) map.db").unwrap(), "old--map");
        assert_eq!(prefix(&format!("{}.db", "x".repeat(90))).unwrap().len(), MOST_PREFIX_LETTERS);
        assert!(prefix("走廊.db").unwrap_err().to_string().contains("--session"));
    }
}
