//! `waypost closure`: what people say of loop closures.

use clap::Subcommand;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use crate::corrections::{frame_words, told};
use crate::failure::Failure;
use crate::names::{frame_name, short_map};
use crate::output::{Output, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List what people said of the loop closures of a map, oldest first
    #[command(visible_alias = "list")]
    Ls {
        /// Name of the map
        map: String,
    },
    /// Withdraw a loop closure: the robot was not there, and links that rested on it are taken out
    Withdraw {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
        /// Frame that closed the loop: its sequence number, or the note that it was sent with
        frame: String,
    },
    /// Say that two frames were taken at the same place, which the map has as two
    ///
    /// Where the map has metres, their features measure how they lie to each other.
    Confirm {
        /// Name of the map
        map: String,
        /// Name of the session of the later frame
        session: String,
        /// Frame that came in last: its sequence number, or the note that it was sent with
        frame: String,
        /// Name of the session of the earlier frame
        matched_session: String,
        /// Earlier frame
        matched_frame: String,
    },
    /// Undo a withdrawal or confirmation: the map is as if it had not been made
    Undo {
        /// Name of the map
        map: String,
        /// Number of the correction, as `waypost closure ls` lists it
        correction: u64,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    let correction = match command {
        Command::Ls { map } => return list(&client.corrections(short_map(&map)).await?, output),
        Command::Withdraw { map, session, frame } => {
            let frame = frame_name(&client, short_map(&map), &session, &frame).await?;
            client.withdraw_loop_closure(&frame).await?
        }
        Command::Confirm { map, session, frame, matched_session, matched_frame } => {
            let frame = frame_name(&client, short_map(&map), &session, &frame).await?;
            let matched = frame_name(&client, short_map(&map), &matched_session, &matched_frame).await?;
            client.confirm_loop_closure(&frame, &matched).await?
        }
        Command::Undo { map, correction } => {
            client.undo_correction(&format!("maps/{}/corrections/{correction}", short_map(&map))).await?
        }
    };
    show(&correction, output)
}

fn list(corrections: &[v1::Correction], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "corrections": corrections }), |out| {
        let rows = corrections.iter().map(|correction| {
            [
                number(correction).to_owned(),
                frame_words(correction.frame.as_ref()),
                frame_words(correction.matched_frame.as_ref()),
                correction.place_number.map_or_else(|| "-".to_owned(), |place| place.to_string()),
                told(correction),
            ]
        });
        table(out, ["CORRECTION", "FRAME", "MATCHED FRAME", "PLACE", "SAID"], rows)
    })
}

fn show(correction: &v1::Correction, output: Output) -> Result<(), Failure> {
    output.result(correction, |out| {
        let frame = frame_words(correction.frame.as_ref());
        writeln!(out, "correction {}: {frame} {}", number(correction), told(correction))?;
        if correction.frames > 1 {
            writeln!(out, "  {} frames are at no place by it", correction.frames)?;
        }
        Ok(())
    })
}

fn number(correction: &v1::Correction) -> &str {
    correction.name.rsplit('/').next().unwrap_or(&correction.name)
}
