//! `waypost explain`: the reasons of a frame's decision.

use std::io::{self, Write};
use std::path::PathBuf;

use waypost_client::{Client, ClientOptions, v1};

use crate::corrections::told;
use crate::explanations::show_place;
use crate::failure::{EXIT_CODES, Failure};
use crate::files::{Replacing, check_drawn};
use crate::names::{frame_name, short_map};
use crate::output::Output;

/// Show why a frame did, or did not, close a loop
///
/// The server replays the map up to the frame and decides it again, which takes a while for a late
/// frame of a long map.
#[derive(clap::Args)]
#[command(after_help = EXIT_CODES)]
pub(crate) struct Arguments {
    /// Name of the map
    map: String,
    /// Name of the session
    session: String,
    /// Sequence number of the frame, or the note that it was sent with: the image's file name, if
    /// `waypost stream` sent it
    frame: String,
    /// Place to explain; if left out, the matched one or the best candidate
    #[arg(long)]
    place: Option<u32>,
    /// Number of words listed for the place, and against it, at most 100
    #[arg(long, value_name = "N", default_value_t = 10)]
    words: u32,
    /// Write the frame and one of the place as SVG, with common features in green
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Show that frame beside it in the picture, in place of one of the place:
    /// maps/MAP/sessions/SESSION/frames/NUMBER, of any map with the same model
    #[arg(long, value_name = "FRAME", requires = "picture")]
    beside: Option<String>,
    /// Replace a file that is there
    #[arg(long, requires = "picture")]
    force: bool,
}

pub(crate) async fn run(arguments: Arguments, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let Arguments { map, session, frame, place, words, picture: file, beside, force } = arguments;
    let replacing = Replacing::of(force);
    replacing.check_wanted(file.as_deref())?;
    check_drawn(file.as_deref())?;
    let client = Client::connect(server).await?;
    let name = frame_name(&client, short_map(&map), &session, &frame).await?;
    let explained = client.explain_frame(&name, place, Some(words)).await?;
    if let Some(file) = &file {
        let drawn = client.frame_pair_picture(pictured(&explained, beside)).await?;
        replacing.write(file, &drawn)?;
    }
    // People know frames by the names of their images.
    let note = client.frame(&name).await.map(|record| record.note).unwrap_or_default();
    output.result(&explained, |out| {
        let noted = if note.is_empty() { String::new() } else { format!(" ({note})") };
        writeln!(out, "{}{noted}: {}", explained.name, explained.reason().json_name())?;
        for correction in &explained.corrections {
            writeln!(out, "  {}", told(correction))?;
        }
        for gate in &explained.gates {
            writeln!(out, "  {} {}", if gate.passed { "+" } else { "-" }, gate.description)?;
        }
        match &explained.place_explanation {
            Some(place) => show_place(place, out)?,
            None => writeln!(out, "the map had no place yet")?,
        }
        if let Some(odometry) = &explained.odometry_agreement {
            show_odometry(odometry, out)?;
        }
        if !explained.reproduced {
            writeln!(out, "this build decides the frame otherwise to the last bit; what was logged holds")?;
        }
        if let Some(file) = &file {
            writeln!(out, "picture in {}", file.display())?;
        }
        Ok(())
    })
}

/// The frame beside one of the place that is explained, with what was expected and not seen; or beside the one that is
/// asked for, of which nothing was expected.
fn pictured(explained: &v1::FrameExplanation, beside: Option<String>) -> v1::GetFramePictureRequest {
    let place = explained.place_explanation.as_ref().filter(|_| beside.is_none());
    let against = place.into_iter().flat_map(|place| &place.words_against);
    v1::GetFramePictureRequest {
        name: explained.name.clone(),
        place_number: place.map(|place| place.place_number),
        beside_frame: beside.unwrap_or_default(),
        expected_words: against.filter(|evidence| !evidence.seen).map(|evidence| evidence.word).collect(),
    }
}

fn show_odometry(odometry: &v1::OdometryAgreement, out: &mut dyn Write) -> io::Result<()> {
    let mut show = |what: &str, ratio: &Option<v1::OdometryRatio>| match ratio {
        Some(v1::OdometryRatio { compared, ratio, spread }) => {
            writeln!(out, "  {what} {ratio:.2} times what odometry says (+-{spread:.2}, {compared} compared)")
        }
        None => Ok(()),
    };
    show("by its images the robot turned", &odometry.turns)?;
    show("the same ways took, when driven before,", &odometry.ways)?;
    if odometry.finding.is_empty() { Ok(()) } else { writeln!(out, "  - {}", odometry.finding) }
}
