//! `waypost demo`: starts a server, and shows what it can do.

mod folders;
mod repeat;
mod sequence;
mod world;

use std::io;
use std::path::{Path, PathBuf};

use waypost_client::launch::{self, ServerProcess};
use waypost_client::{Client, v1};
use waypost_sim::worlds::NamedWorld;

use self::folders::{beside_program, make_data_dir};
use super::model;
use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;
use crate::simulated::worlds;

/// Where a demo keeps its data; later demos that find a folder there take the next number.
const DATA_DIR: &str = "demo-data";

/// Stream the recorded sequence that ships into a new server, and compare with the truth
///
/// Starts a server on free ports with a data folder of its own, streams DATA/sequence/images, and
/// compares each loop closure with DATA/sequence/loops.csv (query_index,match_index; frames count
/// from 0) and ignore.csv, whose pairs do not count. Then a simulated robot maps a route and drives
/// it again, steered by the server; a picture of both drives is written to the data folder. Runs in
/// any folder: DATA is looked for there, beside the program, and where packages put it.
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
    /// Folder of a sequence and a model (sequence/, model.waypost); if left out, the sequence that
    /// ships, and the model that the server ships with
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
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
    /// Drive through a simulated building
    #[arg(long, value_name = "NAME", value_parser = worlds())]
    world: Option<NamedWorld>,
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
        Some(world) => world::run(&demo, world, route.as_deref(), seed, output).await,
    }
}

/// What a demo leaves.
struct Kept {
    data_dir: PathBuf,
    /// The server that it was made with.
    server: PathBuf,
}

impl Demo {
    fn check_model(&self) -> Result<(), Failure> {
        match self.data.as_deref().map(model_file) {
            Some(file) if !file.is_file() => Err(Failure::Unfit(format!(
                "there is no model {}; name the folder of a model and a sequence with --data, or leave that out",
                file.display()
            ))),
            Some(_) | None => Ok(()),
        }
    }

    /// The model of the folder that was named, else the one that the server ships with.
    async fn model(&self, client: &Client, output: Output) -> Result<v1::Model, Failure> {
        if let Some(folder) = &self.data {
            return model::import(client, &model_file(folder), "demo", output).await;
        }
        client.models().await?.pop().ok_or_else(|| {
            Failure::Unfit(
                "this server ships with no model; name the folder of one and of a sequence with --data"
                    .to_owned(),
            )
        })
    }

    /// Starts a server in a new folder for `work` and stops it afterwards.
    async fn with_server<T>(
        &self,
        output: Output,
        work: impl AsyncFnOnce(&ServerProcess, &Path) -> Result<T, Failure>,
    ) -> Result<(T, Kept), Failure> {
        let program = match &self.server_binary {
            Some(named) if named.is_file() => named.clone(),
            Some(named) => {
                return Err(Failure::Unfit(format!(
                    "there is no server {}; name the program with --server-binary, or leave that out",
                    named.display()
                )));
            }
            None => sibling_server()?,
        };
        self.check_model()?;
        let data_dir = make_data_dir(self.keep_data.as_deref(), Path::new(DATA_DIR))?;
        output.line(format_args!("starting {} in {}", program.display(), data_dir.display()))?;
        let server = ServerProcess::start(launch::command(&program), &data_dir, &data_dir)?;
        output.line(format_args!("meanwhile it shows its maps at http://{}/", server.http()))?;
        let done = tokio::select! {
            done = work(&server, &data_dir) => done,
            interrupt = tokio::signal::ctrl_c() => {
                interrupt.map_err(Failure::Runtime)?;
                Err(Failure::Interrupted("stopped before the end of the demo".to_owned()))
            }
        };
        server.stop()?;
        Ok((done?, Kept { data_dir, server: program }))
    }
}

fn model_file(folder: &Path) -> PathBuf {
    folder.join("model.waypost")
}

fn sibling_server() -> Result<PathBuf, Failure> {
    let sibling = beside_program("waypost-server")?;
    if sibling.is_file() {
        Ok(sibling)
    } else {
        Err(Failure::Unfit(format!(
            "there is no {}; install the server (the package waypost-server, or `cargo build --release`), or name one \
             with --server-binary",
            sibling.display()
        )))
    }
}

impl Kept {
    /// Says how to look at a map of the demo.
    fn tell(&self, out: &mut dyn io::Write, map: &str) -> io::Result<()> {
        let Self { data_dir, server } = self;
        let (data_dir, server) = (data_dir.display(), server.display());
        let (ports, http) = if is_free(7600) && is_free(7601) {
            ("", 7601)
        } else {
            // A server runs here already.
            (" --grpc-address 127.0.0.1:7610 --http-address 127.0.0.1:7611", 7611)
        };
        writeln!(
            out,
            "The map is kept in {data_dir}. To look at it: `{server} --data-dir {data_dir}{ports}`, then"
        )?;
        writeln!(out, "  http://127.0.0.1:{http}/#/maps/{map}")?;
        writeln!(out, "No demo removes {data_dir}: remove it when you do not need it any more.")
    }
}

fn is_free(port: u16) -> bool {
    std::net::TcpListener::bind(("127.0.0.1", port)).is_ok()
}
