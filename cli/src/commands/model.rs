//! `waypost model`: models of what a kind of surroundings looks like.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::Subcommand;
use futures::{Stream, StreamExt};
use indicatif::ProgressBar;
use serde_json::json;
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio::sync::watch;
use waypost_client::{Client, ClientOptions, v1};

use super::job;
use crate::failure::Failure;
use crate::files::{Asking, Replacing};
use crate::images::{ImageFile, images_of, told_of_others};
use crate::names::short;
use crate::output::{Output, mebibytes, table};
use crate::progress;
use crate::shrinking::fitting;

const MODEL_HELP: &str = "Hash, its beginning (6 digits or more), or a display name that only one model has";

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Train a model from images of similar surroundings; Ctrl-C cancels
    Train(Training),
    /// List models, newest first
    #[command(visible_alias = "list")]
    Ls,
    /// Show a model
    #[command(visible_alias = "get")]
    Show {
        #[arg(help = MODEL_HELP)]
        name: String,
    },
    /// Copy a model from the server to a file
    Export {
        #[arg(help = MODEL_HELP)]
        name: String,
        /// File to write
        file: PathBuf,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
    /// Copy a model from a file to the server
    Import {
        /// File to read
        file: PathBuf,
        /// Name for people
        #[arg(long, default_value = "")]
        name: String,
    },
    /// Give a model another display name
    Rename {
        #[arg(help = MODEL_HELP)]
        name: String,
        /// Name for people: at most 100 characters, without slashes
        display_name: String,
    },
    /// Delete a model that no map uses
    #[command(visible_alias = "delete")]
    Rm {
        #[arg(help = MODEL_HELP)]
        name: String,
        /// Do not ask: needed where nobody can answer, as in a script
        #[arg(long)]
        yes: bool,
    },
}

#[derive(clap::Args)]
pub(crate) struct Training {
    /// Folders of JPEG or PNG images (DIR, or DIR/images if there is one), taken by name
    #[arg(long, value_name = "DIR", required = true, num_args = 1..)]
    images: Vec<PathBuf>,
    /// Number of words in the vocabulary
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    words: u32,
    /// Seed of the training: the same images, settings and seed give the same model
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Feature extractor: rootsift, upright-rootsift, sift, orb or akaze, with its settings; "rootsift
    /// features=500 width=640" by default
    #[arg(long)]
    extractor: Option<String>,
    /// Name for people
    #[arg(long, default_value = "", hide_default_value = true)]
    name: String,
    /// Do not wait for the end of the training; `waypost job watch` follows it
    #[arg(long)]
    detach: bool,
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    match command {
        Command::Train(training) => train(training, server, output).await,
        Command::Ls => list(server, output).await,
        Command::Show { name } => show(&Client::connect(server).await?.model(&name).await?, output),
        Command::Export { name, file, force } => {
            Replacing::of(force).check_wanted(Some(&file))?;
            export(&name, &file, server, output).await
        }
        Command::Import { file, name } => {
            let client = Client::connect(server).await?;
            let model = import(&client, &file, &name, output).await?;
            tell_of_another_name(&model, &name);
            show(&model, output)
        }
        Command::Rename { name, display_name } => {
            show(&Client::connect(server).await?.rename_model(&name, &display_name).await?, output)
        }
        Command::Rm { name, yes } => {
            let client = Client::connect(server).await?;
            let model = client.model(&name).await?;
            let called = match model.display_name.as_str() {
                "" => short(&model.name),
                name => name,
            };
            Asking::unless(yes)
                .confirm_loss(&format!("delete the model {called}? `waypost model export` keeps a copy"))?;
            client.delete_model(&model.name).await?;
            output.result(&json!({ "deleted": name }), |out| writeln!(out, "deleted {name}"))
        }
    }
}

async fn train(training: Training, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Training { images: folders, words, seed, extractor, name, detach } = training;
    let mut images = Vec::new();
    for folder in &folders {
        let mut found = images_of(folder)?;
        if let Some(others) = told_of_others(&found) {
            // If stderr is closed, the message is lost.
            let _ = writeln!(io::stderr(), "{others}");
        }
        images.append(&mut found);
    }
    let client = Client::connect(server).await?;
    let image_count = u32::try_from(images.len()).ok();
    let settings = v1::TrainModelSettings { display_name: name.clone(), extractor, words, seed, image_count };
    let bar = progress::counter(output, "uploading images", images.len());
    let (stop, stopped) = watch::channel(false);
    let upload = client.train_model(settings, read_each(images, bar.clone(), stopped));
    let job = job::begun_by(upload, &stop, &client, "nothing was trained").await?;
    bar.finish_and_clear();
    if detach {
        return job::show(&job, output);
    }
    let job = job::follow(&client, &job.name, output).await?;
    let model = client.model(&job::result(job)?).await?;
    tell_of_another_name(&model, &name);
    show(&model, output)
}

/// That a model was there already, and is not called as it was asked for.
fn tell_of_another_name(model: &v1::Model, asked: &str) {
    if !asked.is_empty() && model.display_name != asked {
        // If stderr is closed, the hint is lost.
        let _ = writeln!(
            io::stderr(),
            "the server has this model already, as {:?}; `waypost model rename {} {asked:?}` changes that",
            model.display_name,
            short(&model.name)
        );
    }
}

/// The bytes of each image, or an error once `stopped` is set.
fn read_each(
    images: Vec<ImageFile>,
    bar: ProgressBar,
    stopped: watch::Receiver<bool>,
) -> impl Stream<Item = io::Result<Vec<u8>>> {
    futures::stream::iter(images).then(move |image| {
        bar.inc(1);
        let stopped = *stopped.borrow();
        async move {
            if stopped {
                return Err(io::ErrorKind::Interrupted.into());
            }
            let bytes = tokio::fs::read(&image.path).await.map_err(|error| {
                io::Error::new(error.kind(), format!("{}: {error}", image.path.display()))
            })?;
            Ok(tokio::task::block_in_place(|| fitting(bytes)))
        }
    })
}

async fn list(server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let models = Client::connect(server).await?.models().await?;
    output.result(&json!({ "models": models }), |out| {
        let rows = models.iter().map(|model| {
            [
                short(&model.name).to_owned(),
                model.display_name.clone(),
                model.words.to_string(),
                model.extractor.clone(),
                mebibytes(model.size_bytes),
            ]
        });
        table(out, ["MODEL", "NAME", "WORDS", "EXTRACTOR", "SIZE"], rows)
    })
}

/// Training images that are too few: see the guide's page on models.
const FEW_SAMPLES: u32 = 100;

fn show(model: &v1::Model, output: Output) -> Result<(), Failure> {
    output.result(model, |out| {
        writeln!(out, "{}", model.name)?;
        writeln!(out, "  name        {}", model.display_name)?;
        writeln!(out, "  extractor   {}", model.extractor)?;
        writeln!(out, "  words       {}", model.words)?;
        writeln!(out, "  words hash  {}", model.words_hash)?;
        writeln!(out, "  samples     {}", model.samples)?;
        writeln!(out, "  size        {}", mebibytes(model.size_bytes))?;
        if model.samples < FEW_SAMPLES {
            writeln!(
                out,
                "  note        it was trained on {} images: that tells little about what is new, and nothing about look-alikes; \
                 {FEW_SAMPLES} and more, in the order of a drive, tell both",
                model.samples
            )?;
        }
        Ok(())
    })
}

/// The file appears under its name only when it is complete.
async fn export(name: &str, path: &Path, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    let model = client.model(name).await?;
    let mut unfinished = path.as_os_str().to_owned();
    unfinished.push(".part");
    let unfinished = PathBuf::from(unfinished);
    let mut file = File::create(&unfinished).await.map_err(Failure::file("write", &unfinished))?;
    let spinner = progress::spinner(output, format!("exporting to {}", path.display()));
    let exported = client.export_model(&model.name, &mut file).await;
    spinner.finish_and_clear();
    drop(file);
    let size_bytes = match exported {
        Ok(size_bytes) => size_bytes,
        Err(error) => {
            tokio::fs::remove_file(&unfinished).await.map_err(Failure::file("remove", &unfinished))?;
            return Err(error.into());
        }
    };
    tokio::fs::rename(&unfinished, path).await.map_err(Failure::file("write", path))?;
    let object = json!({ "name": model.name, "file": path.to_string_lossy(), "size_bytes": size_bytes });
    output.result(&object, |out| {
        writeln!(out, "{} in {} ({})", short(&model.name), path.display(), mebibytes(size_bytes))
    })
}

/// Enough to know a vocabulary by.
const HEAD_BYTES: u64 = 256;

/// Whether a file is a vocabulary of DBoW2 (a line of four numbers), DBoW3 (YAML) or FBoW, packed or not.
fn is_vocabulary(path: &Path, head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let first = text.lines().next().unwrap_or_default();
    let is_orb_text = first.split_whitespace().count() == 4
        && first.split_whitespace().all(|number| number.parse::<u32>().is_ok());
    let is_yaml = text.starts_with("%YAML") && text.contains("vocabulary:");
    let name = path.to_string_lossy().to_lowercase();
    let is_named_so =
        [".yml.gz", ".yaml.gz", ".txt.gz", ".tar.gz", ".fbow"].iter().any(|ending| name.ends_with(ending));
    !head.starts_with(b"WPMODEL") && (is_orb_text || is_yaml || is_named_so)
}

/// Uploads a model file.
pub(crate) async fn import(
    client: &Client,
    path: &Path,
    display_name: &str,
    output: Output,
) -> Result<v1::Model, Failure> {
    let mut file = File::open(path).await.map_err(Failure::file("read", path))?;
    let mut head = Vec::new();
    let read = (&mut file).take(HEAD_BYTES).read_to_end(&mut head).await;
    read.map_err(Failure::file("read", path))?;
    if is_vocabulary(path, &head) {
        let path = path.display();
        return Err(Failure::Unfit(format!(
            "{path} is a vocabulary, and no model: train one with it, by `waypost-eval train --images DIR --feature orb \
             --orb-vocabulary {path} --out orb.waypost`, and import that"
        )));
    }
    file.rewind().await.map_err(Failure::file("read", path))?;
    let spinner = progress::spinner(output, format!("importing {}", path.display()));
    let model = client.import_model(display_name, file).await?;
    spinner.finish_and_clear();
    Ok(model)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vocabularies_are_known_by_their_heads_and_names() {
        let is = |name: &str, head: &[u8]| is_vocabulary(Path::new(name), head);
        assert!(is("ORBvoc.txt", b"10 6 0 0\n0 0 252 188 188 242 169 109"));
        assert!(is("orb", b"%YAML:1.0\nvocabulary:\n   k: 10\n"));
        assert!(is("orb.yml.gz", b"\x1f\x8b\x08") && is("ORB.fbow", b"\x8a\xb8"));
        assert!(!is("shipped.waypost", b"WPMODEL\0") && !is("orb.fbow", b"WPMODEL\0"));
        assert!(!is("notes.txt", b"10 6 0 zero\n") && !is("camera.yaml", b"%YAML:1.0\ncamera_name: x\n"));
    }
}
