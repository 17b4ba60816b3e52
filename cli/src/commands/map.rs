//! `waypost map`: places joined by links.

mod creation;
mod exports;
mod labels;
mod listing;
mod matrix;
mod rebuilding;
mod recording;
mod trimming;
mod watching;

use std::io::Write;
use std::path::PathBuf;

use clap::Subcommand;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use super::{job, merge, snapshot};
use crate::failure::Failure;
use crate::files::{Asking, Replacing};
use crate::output::Output;

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Create a map
    Create(creation::Creation),
    /// List maps by name
    #[command(visible_alias = "list")]
    Ls,
    /// Show a map with its settings, its size on the disk and the hash of its state
    #[command(visible_alias = "get")]
    Show {
        /// Name of the map
        name: String,
    },
    /// Continue a map with another model of the same words, for example a recalibrated one
    Rebind {
        /// Name of the map
        name: String,
        /// Hash of the model, its beginning, or a display name that only one model has
        #[arg(long)]
        model: String,
    },
    /// List the loop closures of a map, oldest first
    LoopClosures {
        /// Name of the map
        name: String,
    },
    /// List the places of a map, oldest first
    Places {
        /// Name of the map
        name: String,
    },
    Matrix(matrix::Matrix),
    Label(labels::Labelling),
    /// List the labels of places
    Labels {
        /// Name of the map
        name: String,
    },
    Trajectory(exports::Trajectory),
    Graph(exports::Graph),
    Recording(recording::ToRecord),
    /// Copy a map with its model to a file, even while robots stream into it
    Export {
        /// Name of the map
        name: String,
        /// File to write
        file: PathBuf,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
    /// Create a map from such a file; Ctrl-C cancels
    Import {
        /// File to read
        file: PathBuf,
        /// Name of the new map, if not the one that it had
        #[arg(long, default_value = "", hide_default_value = true)]
        name: String,
    },
    /// Merge maps: places that they have in common become one; Ctrl-C cancels
    Merge(merge::Merging),
    /// Rebuild a map with a model of other words, from the images or descriptors that it keeps, and
    /// count why its frames were decided as they were; Ctrl-C cancels, and the same command continues
    Rebuild {
        /// Name of the map; it stays as it is
        name: String,
        /// Hash of the model, its beginning, or a display name that only one model has
        #[arg(long)]
        model: String,
        /// Name of the new map
        #[arg(long, value_name = "MAP")]
        into: String,
    },
    /// Make a new map from what is left of a damaged one, and say what is lost; Ctrl-C cancels, and the
    /// same command continues
    Repair {
        /// Name of the damaged map; it stays as it is
        name: String,
        /// Name of the new map
        #[arg(long, value_name = "MAP")]
        into: String,
        /// An earlier copy of the map, imported from a snapshot: what is damaged is taken from it
        #[arg(long, value_name = "MAP")]
        copy: Option<String>,
    },
    /// Forget how a map came to be what it is: merges into it can no longer be undone, and deleted
    /// data of all maps is wiped from the disk
    Compact {
        /// Name of the map
        name: String,
        /// Do not ask: needed where nobody can answer, as in a script
        #[arg(long)]
        yes: bool,
    },
    Trim(trimming::Trimming),
    Watch(watching::Watching),
    /// Show what each of two maps has that the other lacks
    Diff {
        /// Name of a map
        first: String,
        /// Name of the other
        second: String,
    },
    /// Delete a map with all its sessions
    #[command(visible_alias = "delete")]
    Rm {
        /// Name of the map
        name: String,
        /// Do not ask: needed where nobody can answer, as in a script
        #[arg(long)]
        yes: bool,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Create(creation) => {
            let map = client.create_map(creation.request()).await?;
            if let Some(hint) = creation::hint(&client, &map).await? {
                // If stderr is closed, the hint is lost.
                let _ = writeln!(std::io::stderr(), "{hint}");
            }
            listing::show(&map, output)
        }
        Command::Ls => listing::list(&client.maps().await?, output),
        Command::Show { name } => listing::show(&client.map(&name, v1::MapView::Full).await?, output),
        Command::Rebind { name, model } => listing::show(&client.rebind_map(&name, &model).await?, output),
        Command::LoopClosures { name } => listing::loop_closures(&client.loop_closures(&name).await?, output),
        Command::Places { name } => listing::places(&client.places(&name).await?, output),
        Command::Matrix(asked) => matrix::matrix(&client, asked, output).await,
        Command::Label(labelling) => labels::label(&client, labelling, output).await,
        Command::Labels { name } => labels::list(&client, &name, output).await,
        Command::Export { name, file, force } => {
            snapshot::export(&client, &name, &file, Replacing::of(force), output).await
        }
        Command::Trajectory(asked) => exports::trajectory(&client, asked, output).await,
        Command::Graph(asked) => exports::graph(&client, asked, output).await,
        Command::Recording(asked) => recording::record(&client, asked, output).await,
        Command::Import { file, name } => {
            listing::show(&snapshot::import(&client, &file, &name, output).await?, output)
        }
        Command::Merge(merging) => merge::merge(&client, merging, output).await,
        Command::Rebuild { name, model, into } => {
            rebuilding::rebuild(&client, [&name, &model, &into], output).await
        }
        Command::Repair { name, into, copy } => {
            let job = client.repair_map(&name, &into, copy.as_deref()).await?;
            let job = job::follow(&client, &job.name, output).await?;
            let lost = job.stage.clone();
            let made = job::result(job)?;
            output.result(&json!({ "repaired": made, "lost": lost }), |out| writeln!(out, "{made}: {lost}"))
        }
        Command::Compact { name, yes } => {
            Asking::unless(yes).confirm_loss(&format!(
                "wipe from the disk what was removed from {name}, so that no merge can be undone?"
            ))?;
            let job = client.compact_map(&name).await?;
            job::follow(&client, &job.name, output).await?;
            output.result(&json!({ "compacted": name }), |out| writeln!(out, "compacted {name}"))
        }
        Command::Trim(trimming) => trimming::trim(&client, trimming, output).await,
        Command::Watch(watching) => watching::watch(&client, watching, output).await,
        Command::Diff { first, second } => merge::diff(&client, [&first, &second], output).await,
        Command::Rm { name, yes } => {
            Asking::unless(yes).confirm_loss(&format!("delete the map {name} with all its sessions?"))?;
            client.delete_map(&name).await?;
            output.result(&json!({ "deleted": name }), |out| writeln!(out, "deleted {name}"))
        }
    }
}
