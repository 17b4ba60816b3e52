//! `waypost completions` and `waypost man`: what a shell and `man` know of this program.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap_complete::Shell;

use crate::failure::Failure;
use crate::files::Replacing;

/// Print completions for a shell
///
/// For bash: waypost completions bash > ~/.local/share/bash-completion/completions/waypost
#[derive(clap::Args)]
pub(crate) struct Completions {
    /// Which shell
    shell: Shell,
}

/// Write manual pages, one for each command
#[derive(clap::Args)]
pub(crate) struct Manual {
    /// Folder to write them to, as in ~/.local/share/man/man1; created if it does not exist
    folder: PathBuf,
    /// Replace files that are there
    #[arg(long)]
    force: bool,
}

pub(crate) fn completions(asked: &Completions, mut command: clap::Command) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(asked.shell, &mut command, "waypost", &mut script);
    std::io::stdout().write_all(&script).map_err(Failure::Stdout)
}

pub(crate) fn manual(asked: &Manual, command: clap::Command) -> Result<(), Failure> {
    let Manual { folder, force } = asked;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut pages = Vec::new();
    render(&command, "waypost", &mut pages)?;
    let replacing = Replacing::of(*force);
    let pages: Vec<(PathBuf, Vec<u8>)> =
        pages.into_iter().map(|(name, page)| (folder.join(format!("{name}.1")), page)).collect();
    pages.iter().try_for_each(|(file, _)| replacing.check(file))?;
    std::fs::create_dir_all(folder).map_err(Failure::file("create", folder))?;
    pages.iter().try_for_each(|(file, page)| replacing.write(file, page))
}

/// A page for a command, and one for each command in it.
fn render(command: &clap::Command, name: &str, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), Failure> {
    let mut page = Vec::new();
    let manual = clap_mangen::Man::new(command.clone()).title(name);
    manual.render(&mut page).map_err(Failure::file("write", Path::new(name)))?;
    pages.push((name.to_owned(), page));
    let mut within = command.get_subcommands().filter(|command| !command.is_hide_set());
    within.try_for_each(|within| render(within, &format!("{name}-{}", within.get_name()), pages))
}
