//! `waypost-server completions` and `waypost-server man`: what a shell and `man` know of this program.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap_complete::Shell;

/// What is about the program alone, whatever its settings are.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Print completions for a shell
    ///
    /// For bash: waypost-server completions bash > ~/.local/share/bash-completion/completions/waypost-server
    Completions {
        /// Which shell
        shell: Shell,
    },
    /// Write manual pages, one for each command
    Man {
        /// Folder to write them to, as in ~/.local/share/man/man8; created if it does not exist
        folder: PathBuf,
        /// Replace pages that are there
        #[arg(long)]
        force: bool,
    },
}

/// Whether a page that is there may be replaced.
#[derive(Clone, Copy)]
enum Replacing {
    Allowed,
    Refused,
}

/// Where the pages belong: programs that administrators run.
const SECTION: &str = "8";

impl Command {
    /// Does what was asked for, of the whole program.
    pub(crate) fn run(self, whole: clap::Command) -> anyhow::Result<()> {
        match self {
            Command::Completions { shell } => completions(shell, whole),
            Command::Man { folder, force } => {
                manual(&folder, if force { Replacing::Allowed } else { Replacing::Refused }, whole)
            }
        }
    }
}

/// Writes what `shell` needs to complete commands and flags.
fn completions(shell: Shell, mut command: clap::Command) -> anyhow::Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, "waypost-server", &mut script);
    std::io::stdout().write_all(&script).context("cannot write to the standard output")
}

/// Writes a manual page for the program and one for each of its commands.
fn manual(folder: &Path, replacing: Replacing, command: clap::Command) -> anyhow::Result<()> {
    let mut command = command.disable_help_subcommand(true);
    command.build();
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    write_pages(&command, "waypost-server", folder, replacing)
}

fn write_pages(
    command: &clap::Command,
    name: &str,
    folder: &Path,
    replacing: Replacing,
) -> anyhow::Result<()> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone()).title(name).section(SECTION).render(&mut page)?;
    let file = folder.join(format!("{name}.{SECTION}"));
    match replacing {
        Replacing::Allowed => {
            std::fs::write(&file, &page).with_context(|| format!("cannot write {}", file.display()))?;
        }
        Replacing::Refused => write_new(&file, &page)?,
    }
    let mut within = command.get_subcommands().filter(|command| !command.is_hide_set());
    within.try_for_each(|within| {
        write_pages(within, &format!("{name}-{}", within.get_name()), folder, replacing)
    })
}

/// A file that is there stays as it is.
fn write_new(file: &Path, content: &[u8]) -> anyhow::Result<()> {
    let opened = OpenOptions::new().write(true).create_new(true).open(file);
    opened.and_then(|mut opened| opened.write_all(content)).with_context(|| {
        format!(
            "cannot write {}; a page that is there already is not replaced: name another folder, or give --force",
            file.display()
        )
    })
}
