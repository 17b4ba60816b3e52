//! `waypost map watch`: what happens in a map, while it happens.

use std::io::{self, Write};

use waypost_client::v1::map_event::Event;
use waypost_client::{Client, Watched, v1};

use crate::failure::Failure;
use crate::output::Output;

/// Tell what happens in a map until interrupted: frames and robots that navigate
///
/// A line each; with --json, one JSON object each.
#[derive(clap::Args)]
pub(crate) struct Watching {
    /// Name of the map
    name: String,
    /// Begin with the frames from this position of the map's log on, 0 for all; if left out, with
    /// the next one that comes
    #[arg(long, value_name = "POSITION")]
    from: Option<u64>,
}

pub(super) async fn watch(client: &Client, watching: Watching, output: Output) -> Result<(), Failure> {
    let Watching { name, from } = watching;
    let mut events = client.watch_map(&name, from).await?;
    loop {
        let watched = tokio::select! {
            watched = events.next_or_break() => watched?,
            interrupt = tokio::signal::ctrl_c() => {
                return interrupt.map_err(Failure::Runtime);
            }
        };
        // If stderr is closed, what is said of the connection is lost.
        match watched {
            Watched::Event(event) => output.result(&event, |out| write(&event, out))?,
            Watched::Disconnected { reason } => {
                let _ = writeln!(io::stderr(), "no connection: {reason}; trying again");
            }
            Watched::Reconnected => {
                let _ = writeln!(io::stderr(), "connected again; nothing was missed");
            }
        }
    }
}

fn write(event: &v1::MapEvent, out: &mut dyn Write) -> io::Result<()> {
    match &event.event {
        Some(Event::Frame(v1::DecidedFrame { position, frame: Some(frame) })) => {
            writeln!(out, "{position:6}  {}", frame_words(frame))
        }
        Some(Event::Navigation(navigation)) => writeln!(out, "        {}", navigation_words(navigation)),
        Some(Event::Frame(_) | Event::Started(_)) | None => Ok(()),
    }
}

fn frame_words(frame: &v1::FrameRecord) -> String {
    let answer = frame.answer.clone().unwrap_or_default();
    let mut words = short(&frame.name);
    if !frame.note.is_empty() {
        words += &format!(" ({})", frame.note);
    }
    words += &format!("  {}", answer.reason().json_name());
    if let Some(place) = answer.place_number {
        words += &format!("  place {place}");
    }
    if let Some(frame) = answer.r#match.as_ref().and_then(|found| found.frame.as_ref()) {
        words += &format!("  as {}/frames/{}", short(&frame.session), frame.sequence);
    }
    let position = answer.map_pose.as_ref().and_then(|pose| pose.robot.as_ref()?.position_m);
    if let Some(v1::Vector3 { x, y, z: _ }) = position {
        words += &format!("  ({x:.2}, {y:.2}) m");
    }
    words
}

fn navigation_words(navigation: &v1::Navigation) -> String {
    let guidance = navigation.guidance.clone().unwrap_or_default();
    let state = if navigation.connected { guidance.status().json_name() } else { "disconnected" };
    let why = guidance.detail.map_or_else(String::new, |detail| format!(": {detail}"));
    format!("{}  {state}{why}", short(&navigation.name))
}

/// A name without its map.
fn short(name: &str) -> String {
    name.split('/').skip(2).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_is_a_line() {
        let frame = v1::FrameRecord {
            name: "maps/hall/sessions/monday/frames/7".to_owned(),
            note: "7.jpg".to_owned(),
            answer: Some(v1::FrameAnswer {
                reason: v1::Reason::SamePlace.into(),
                place_number: Some(3),
                ..v1::FrameAnswer::default()
            }),
            ..v1::FrameRecord::default()
        };
        assert_eq!(frame_words(&frame), "sessions/monday/frames/7 (7.jpg)  same_place  place 3");
        let navigation =
            v1::Navigation { name: "maps/hall/navigations/robot".to_owned(), ..v1::Navigation::default() };
        assert_eq!(navigation_words(&navigation), "navigations/robot  disconnected");
    }
}
