//! `waypost explain`: why a frame was decided as it was.

use std::path::PathBuf;

use serde::Serialize;
use waypost_client::{Client, ClientOptions, v1};

use crate::explanations::{PlaceExplanationView, show_place};
use crate::failure::{EXIT_CODES, Failure};
use crate::output::Output;
use crate::views::reason_name;

/// Tell why a frame did, or did not, close a loop
///
/// The server replays the map up to the frame and decides it again, so a late frame of a long map takes a
/// while.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// Name of the map
    map: String,
    /// Name of the session
    session: String,
    /// Sequence number of the frame
    sequence: u64,
    /// Place to explain; if left out, the one that was, or could have been, matched
    #[arg(long)]
    place: Option<u32>,
    /// Words for and as many against that are listed, at most 100
    #[arg(long, value_name = "N", default_value_t = 10)]
    words: u32,
    /// Write the frame beside one of the place as SVG: what they have in common is green
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

#[derive(Serialize)]
struct Explanation {
    name: String,
    reason: &'static str,
    gates: Vec<Gate>,
    place: Option<PlaceExplanationView>,
    reproduced: bool,
    /// Its path at the REST port; null if there was no place yet.
    picture: Option<String>,
}

#[derive(Serialize)]
struct Gate {
    name: String,
    passed: bool,
    value: f64,
    required: f64,
    description: String,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, session, sequence, place, words, picture: file } = arguments;
    let map = map.strip_prefix("maps/").unwrap_or(&map);
    let name = format!("maps/{map}/sessions/{session}/frames/{sequence}");
    let client = Client::connect(server).await?;
    let explained = client.explain_frame(&name, place, words).await?;
    let reason = reason_name(explained.reason());
    let v1::FrameExplanation { name, reason: _, gates, place, reproduced, picture } = explained;
    if let Some(file) = &file {
        let place = place.as_ref().map(|explained| explained.place);
        let drawn = client.frame_picture(&name, place).await?;
        std::fs::write(file, drawn).map_err(Failure::file("write", file))?;
    }
    let gates = gates.into_iter().map(|gate| {
        let v1::Gate { name, passed, value, required, description } = gate;
        Gate { name, passed, value, required, description }
    });
    let place = place.map(PlaceExplanationView::from);
    let explanation = Explanation { name, reason, gates: gates.collect(), place, reproduced, picture };
    output.result(&explanation, |out| {
        writeln!(out, "{}: {reason}", explanation.name)?;
        for gate in &explanation.gates {
            writeln!(out, "  {} {}", if gate.passed { "+" } else { "-" }, gate.description)?;
        }
        match &explanation.place {
            Some(place) => show_place(place, out)?,
            None => writeln!(out, "the map had no place yet")?,
        }
        if !explanation.reproduced {
            writeln!(out, "this build decides the frame otherwise to the last bit; what was logged holds")?;
        }
        if let Some(file) = &file {
            writeln!(out, "picture in {}", file.display())?;
        }
        Ok(())
    })
}
