//! `waypost demo`: starts a server, and shows what it can do.

mod repeat;
mod sequence;
mod world;

use std::path::{Path, PathBuf};

use waypost_client::launch::{self, ServerProcess};

use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;

/// Marks a folder that a demo made, which the next demo may replace.
const MARKER_FILE: &str = "made-by-waypost-demo";

/// Stream the recorded sequence of the repository into a new server, and compare with the truth
///
/// Starts a server on free ports with a data folder of its own, imports DATA/model.waypost, streams
/// DATA/sequence/images, and compares each loop closure with DATA/sequence/loops.csv
/// (query_index,match_index; frames count from 0) and ignore.csv, whose pairs do not count. Then a
/// simulated robot maps a route and drives it again, steered by the server; a picture of both
/// drives is written to the data folder.
///
/// With --world, a simulated robot maps a building by camera and odometry instead; a picture of the
/// truth, the odometry and the map is written to the data folder.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    #[command(flatten)]
    demo: Demo,
    #[command(flatten)]
    world: WorldArguments,
}

/// Arguments of both demos.
#[derive(clap::Args)]
struct Demo {
    /// Folder of the model and the sequence
    #[arg(long, value_name = "DIR", default_value = "demo")]
    data: PathBuf,
    /// Folder for the server's data; a folder of an earlier demo is replaced
    #[arg(long, value_name = "DIR", default_value = "demo-data")]
    keep_data: PathBuf,
    /// Server to start; if left out, the `waypost-server` beside this program
    #[arg(long, value_name = "FILE")]
    server_binary: Option<PathBuf>,
}

#[derive(clap::Args)]
struct WorldArguments {
    /// Drive through a simulated building: office, corridors, booij-office, loop, building-a,
    /// building-b or gallery
    #[arg(long, value_name = "NAME")]
    world: Option<String>,
    /// Route through the building; if left out, its first. An unknown name lists all
    #[arg(long, value_name = "NAME", requires = "world")]
    route: Option<String>,
    /// Seed of the building's textures, the wheel errors and the camera noise
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "world")]
    seed: u64,
}

pub(crate) async fn run(arguments: Arguments, output: Output) -> Result<(), Failure> {
    let Arguments { demo, world: WorldArguments { world, route, seed } } = arguments;
    match world {
        None => sequence::run(&demo, output).await,
        Some(world) => world::run(&demo, &world, route.as_deref(), seed, output).await,
    }
}

impl Demo {
    fn model_file(&self) -> PathBuf {
        self.data.join("model.waypost")
    }

    /// Starts a server for `work` and stops it afterwards.
    async fn with_server<T>(
        &self,
        output: Output,
        work: impl AsyncFnOnce(&ServerProcess) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let program = self.server_binary.clone().map_or_else(sibling_server, Ok)?;
        make_data_dir(&self.keep_data)?;
        output.line(format_args!("starting {} in {}", program.display(), self.keep_data.display()))?;
        let server = ServerProcess::start(launch::command(&program), &self.keep_data, &self.keep_data)?;
        let done = tokio::select! {
            done = work(&server) => done,
            interrupt = tokio::signal::ctrl_c() => {
                interrupt.map_err(Failure::Runtime)?;
                Err(Failure::Interrupted("stopped before the end of the demo".to_owned()))
            }
        };
        server.stop()?;
        done
    }
}

fn sibling_server() -> Result<PathBuf, Failure> {
    let this = std::env::current_exe().map_err(Failure::file("find", Path::new("the running program")))?;
    let sibling = this.with_file_name("waypost-server");
    if sibling.is_file() {
        Ok(sibling)
    } else {
        Err(Failure::Unfit(format!(
            "there is no {}; build it with `cargo build --release`, or name one with --server-binary",
            sibling.display()
        )))
    }
}

/// Makes the folder for data. Replaces only a folder that a demo made.
fn make_data_dir(data_dir: &Path) -> Result<(), Failure> {
    let marker = data_dir.join(MARKER_FILE);
    if marker.is_file() {
        std::fs::remove_dir_all(data_dir).map_err(Failure::file("replace", data_dir))?;
    } else if data_dir.exists() && !is_empty(data_dir)? {
        return Err(Failure::Unfit(format!(
            "{} exists and was not made by a demo; name another folder with --keep-data",
            data_dir.display()
        )));
    }
    std::fs::create_dir_all(data_dir).map_err(Failure::file("create", data_dir))?;
    std::fs::write(&marker, "Data of `waypost demo`; the next demo replaces this folder.\n")
        .map_err(Failure::file("write", &marker))
}

fn is_empty(folder: &Path) -> Result<bool, Failure> {
    let mut entries = std::fs::read_dir(folder).map_err(Failure::file("list", folder))?;
    Ok(entries.next().is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_folder_that_a_demo_made_is_replaced() {
        let parent = tempfile::tempdir().unwrap();
        let data_dir = parent.path().join("data");
        make_data_dir(&data_dir).unwrap();
        std::fs::write(data_dir.join("old"), b"x").unwrap();
        make_data_dir(&data_dir).unwrap();
        assert!(!data_dir.join("old").exists());

        let precious = parent.path().join("precious");
        std::fs::create_dir(&precious).unwrap();
        std::fs::write(precious.join("thesis"), b"x").unwrap();
        assert!(matches!(make_data_dir(&precious), Err(Failure::Unfit(_))));
        assert!(precious.join("thesis").exists());
    }
}
