//! Stands for the simulated robot where there are no worlds to drive in.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;
use waypost_client::Client;

use crate::failure::Failure;
use crate::output::Output;

/// Nothing is.
#[derive(Serialize)]
pub(super) enum Repeated {}

pub(super) async fn run(_: &Client, _: &str, _: &Path, output: Output) -> Result<Option<Repeated>, Failure> {
    output.line(
        "\nno robot drives after that: this waypost was built without `--features waypost-client/demo`",
    )?;
    Ok(None)
}

pub(super) fn write(repeated: &Repeated, _: &mut dyn Write) -> io::Result<()> {
    match *repeated {}
}
