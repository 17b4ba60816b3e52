//! `waypost demo`: starts a server, and shows what it can do.

mod repeat;
mod sequence;
mod world;

use std::io;
use std::path::{Path, PathBuf};

use waypost_client::launch::{self, ServerProcess};

use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;

/// Where a demo keeps its data; later demos that find a folder there take the next number.
const DATA_DIR: &str = "demo-data";

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
    /// New folder for the server's data; if left out, demo-data, or the first of demo-data-2,
    /// demo-data-3, … that is not there. No demo removes what another one left
    #[arg(long, value_name = "DIR")]
    keep_data: Option<PathBuf>,
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

    fn check_model(&self) -> Result<(), Failure> {
        let file = self.model_file();
        if file.is_file() {
            return Ok(());
        }
        Err(Failure::Unfit(format!(
            "there is no model {}; call this in the folder of the repository, or name the folder of the model and the \
             sequence with --data",
            file.display()
        )))
    }

    /// Starts a server in a new folder for `work` and stops it afterwards.
    async fn with_server<T>(
        &self,
        output: Output,
        work: impl AsyncFnOnce(&ServerProcess, &Path) -> Result<T, Failure>,
    ) -> Result<T, Failure> {
        let program = self.server_binary.clone().map_or_else(sibling_server, Ok)?;
        self.check_model()?;
        let data_dir = make_data_dir(self.keep_data.as_deref(), Path::new(DATA_DIR))?;
        output.line(format_args!("starting {} in {}", program.display(), data_dir.display()))?;
        let server = ServerProcess::start(launch::command(&program), &data_dir, &data_dir)?;
        let done = tokio::select! {
            done = work(&server, &data_dir) => done,
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

/// How many folders of earlier demos are looked past.
const MOST_KEPT: u32 = 1000;

/// Makes the folder for data: the one that is `asked` for, or the first beside `usual` that is not there. What is
/// there stays: people go on with the server of a demo, and make maps of their own in its folder.
fn make_data_dir(asked: Option<&Path>, usual: &Path) -> Result<PathBuf, Failure> {
    let folder = match asked {
        Some(asked) if is_used(asked)? => {
            return Err(Failure::Unfit(format!(
                "{} is there already, and a demo removes nothing; name another folder with --keep-data, or leave that out",
                asked.display()
            )));
        }
        Some(asked) => asked.to_owned(),
        None => unused(usual)?,
    };
    std::fs::create_dir_all(&folder).map_err(Failure::file("create", &folder))?;
    Ok(folder)
}

fn unused(usual: &Path) -> Result<PathBuf, Failure> {
    let name = usual.to_string_lossy();
    let numbered = (2..=MOST_KEPT).map(|number| PathBuf::from(format!("{name}-{number}")));
    for folder in std::iter::once(usual.to_owned()).chain(numbered) {
        if !is_used(&folder)? {
            return Ok(folder);
        }
    }
    Err(Failure::Unfit(format!(
        "{name} to {name}-{MOST_KEPT} are there already; remove those that you do not need, or name a folder with \
         --keep-data"
    )))
}

fn is_used(path: &Path) -> Result<bool, Failure> {
    if !path.is_dir() {
        return Ok(path.exists());
    }
    let mut entries = std::fs::read_dir(path).map_err(Failure::file("list", path))?;
    Ok(entries.next().is_some())
}

/// Says how to look at a map that a demo left.
fn tell_where_it_is(out: &mut dyn io::Write, data_dir: &Path, map: &str) -> io::Result<()> {
    let data_dir = data_dir.display();
    writeln!(out, "The map is kept in {data_dir}. To look at it: `make serve DATA_DIR={data_dir}`, then")?;
    writeln!(out, "  http://127.0.0.1:7601/#/maps/{map}")?;
    writeln!(out, "No demo removes {data_dir}: remove it when you do not need it any more.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_earlier_demo_left_stays() {
        let parent = tempfile::tempdir().unwrap();
        let usual = parent.path().join("demo-data");
        let first = make_data_dir(None, &usual).unwrap();
        assert_eq!(first, usual);
        // Somebody goes on with the server of the demo.
        std::fs::write(first.join("mine"), b"x").unwrap();
        let second = make_data_dir(None, &usual).unwrap();
        assert_eq!(second, parent.path().join("demo-data-2"));
        std::fs::write(second.join("waypost.sqlite"), b"x").unwrap();
        assert_eq!(make_data_dir(None, &usual).unwrap(), parent.path().join("demo-data-3"));
        let refused = make_data_dir(Some(&first), &usual).unwrap_err().to_string();
        assert!(refused.contains("a demo removes nothing"), "{refused}");
        assert!(first.join("mine").exists());
    }

    #[test]
    fn a_file_is_no_folder_for_data() {
        let parent = tempfile::tempdir().unwrap();
        let file = parent.path().join("thesis");
        std::fs::write(&file, b"x").unwrap();
        assert!(matches!(make_data_dir(Some(&file), Path::new("demo-data")), Err(Failure::Unfit(_))));
        let empty = parent.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        assert_eq!(make_data_dir(Some(&empty), Path::new("demo-data")).unwrap(), empty);
    }
}
