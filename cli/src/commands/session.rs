//! `waypost session`: sessions that robots streamed into a map.

use clap::Subcommand;
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use super::job;
use crate::failure::Failure;
use crate::files::Asking;
use crate::names::session_name;
use crate::output::{Output, in_words, mebibytes, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List the sessions of a map, oldest first
    #[command(visible_alias = "list")]
    Ls {
        /// Name of the map
        map: String,
    },
    /// Show a session: its frames, its camera, what it keeps
    #[command(visible_alias = "get")]
    Show {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
    },
    /// List the streams that robots have open now, with how fast their frames are decided
    Streams {
        /// Name of the map; if left out, those of all maps
        map: Option<String>,
    },
    /// List the frames of a session with the decisions about them
    Frames {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
    },
    /// Delete a session from its map, with its images and everything that only this session has
    /// shown; it cannot be undone
    #[command(visible_alias = "delete")]
    Rm {
        /// Name of the map
        map: String,
        /// Name of the session
        session: String,
        /// Do not ask: needed where nobody can answer, as in a script
        #[arg(long)]
        yes: bool,
    },
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Ls { map } => list(&client.sessions(&map).await?, output),
        Command::Show { map, session } => show(&client.session(&session_name(&map, &session)).await?, output),
        Command::Streams { map } => streams(&client.open_streams(map.as_deref()).await?, output),
        Command::Frames { map, session } => {
            frames(&client.frames(&session_name(&map, &session)).await?, output)
        }
        Command::Rm { map, session, yes } => {
            Asking::unless(yes)
                .confirm_loss(&format!("delete {session} from the map {map}? it cannot be undone"))?;
            let name = session_name(&map, &session);
            let job = client.delete_session(&name).await?;
            job::follow(&client, &job.name, output).await?;
            output.result(&json!({ "deleted": name }), |out| writeln!(out, "deleted {name}"))
        }
    }
}

fn list(sessions: &[v1::Session], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "sessions": sessions }), |out| {
        let or_none = |number: Option<u64>| number.map_or("-".to_owned(), |number| number.to_string());
        let rows = sessions.iter().map(|session| {
            [
                session.name.rsplit('/').next().unwrap_or_default().to_owned(),
                session.frames.to_string(),
                session.loop_closures.to_string(),
                or_none(session.first_sequence),
                or_none(session.last_sequence),
            ]
        });
        table(out, ["SESSION", "FRAMES", "CLOSURES", "FIRST", "LAST"], rows)
    })
}

fn show(session: &v1::Session, output: Output) -> Result<(), Failure> {
    output.result(session, |out| {
        let v1::Session {
            name,
            create_time_ns,
            camera,
            frames,
            loop_closures,
            first_sequence,
            last_sequence,
            first_stamp_ns,
            last_stamp_ns,
            owner,
            kept_bytes,
        } = session;
        writeln!(out, "{name}")?;
        writeln!(out, "begun           {}", in_words(*create_time_ns))?;
        writeln!(out, "owner           {}", if owner.is_empty() { "nobody" } else { owner })?;
        writeln!(out, "camera          {}", camera.as_ref().map_or("not declared".to_owned(), in_short))?;
        writeln!(out, "frames          {frames}")?;
        if let (Some(first), Some(last)) = (first_sequence, last_sequence) {
            writeln!(out, "numbers         {first} to {last}")?;
        }
        if let (Some(first), Some(last)) = (first_stamp_ns, last_stamp_ns) {
            // As stamps are compared: the robot's clock may have begun anywhere.
            writeln!(out, "stamps          {first} to {last} ns")?;
        }
        writeln!(out, "loop closures   {loop_closures}")?;
        writeln!(out, "kept            {}", mebibytes(*kept_bytes))
    })
}

/// What kind of camera it is, and of what size its images are.
fn in_short(camera: &v1::Camera) -> String {
    use v1::camera::Model;
    let kind = match &camera.model {
        Some(Model::Pinhole(_)) => "pinhole",
        Some(Model::FieldOfView(_)) => "pinhole by its field of view",
        Some(Model::Fisheye(_)) => "fisheye",
        Some(Model::Panorama(_)) => "panorama",
        Some(Model::HyperbolicMirror(_)) => "hyperbolic mirror",
        None => "of unknown optics",
    };
    match (camera.image_width_px, camera.image_height_px) {
        (Some(width), Some(height)) => format!("{kind}, {width} x {height} px"),
        (Some(_), None) | (None, _) => format!("{kind}, of images of any size"),
    }
}

fn streams(streams: &[v1::OpenStream], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "streams": streams }), |out| {
        let rows = streams.iter().map(|stream| {
            let delay =
                stream.last_delay_ns.map_or("-".to_owned(), |delay| format!("{:.1} ms", delay as f64 / 1e6));
            [
                stream.session.clone(),
                stream.mode().json_name().to_owned(),
                in_words(stream.open_time_ns),
                stream.answered_frames.to_string(),
                stream.refused_frames.to_string(),
                stream.last_frame_time_ns.map_or("-".to_owned(), in_words),
                delay,
            ]
        });
        table(out, ["SESSION", "MODE", "SINCE", "ANSWERED", "REFUSED", "LAST FRAME", "TOOK"], rows)
    })
}

fn frames(frames: &[v1::FrameRecord], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "frames": frames }), |out| {
        let rows = frames.iter().map(|frame| {
            let v1::FrameStorage { log_bytes, features_bytes, thumbnail_bytes, image_bytes } =
                frame.storage.unwrap_or_default();
            let (sequence, reason, place, posterior, probability) = match &frame.answer {
                Some(answer) => (
                    answer.sequence.to_string(),
                    answer.reason().json_name().to_owned(),
                    answer.place_number.map_or("-".to_owned(), |place| place.to_string()),
                    format!("{:.6}", answer.posterior),
                    answer
                        .r#match
                        .as_ref()
                        .and_then(|matched| matched.geometry.as_ref())
                        .map_or_else(|| "-".to_owned(), |geometry| format!("{:.3}", geometry.probability)),
                ),
                None => Default::default(),
            };
            let bytes = log_bytes + features_bytes + thumbnail_bytes + image_bytes;
            [sequence, reason, place, probability, posterior, bytes.to_string(), frame.note.clone()]
        });
        table(out, ["FRAME", "REASON", "PLACE", "PROBABILITY", "POSTERIOR", "BYTES", "NOTE"], rows)
    })
}
