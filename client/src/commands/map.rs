//! `waypost map`: places joined by links.

mod labels;

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::{Subcommand, ValueEnum};
use serde_json::json;
use waypost_client::{Client, ClientOptions, v1};

use super::model::short;
use super::snapshot::{self, Replacing};
use super::{job, merge};
use crate::failure::Failure;
use crate::output::{Output, table};
use crate::views::{ClosureView, FrameView, MapSummary, PlacePoseView, PlaceView, SettingsView, StorageView};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// Create a map
    Create(Creation),
    /// List maps by name
    #[command(visible_alias = "list")]
    Ls,
    /// Show a map, its settings, what it weighs, and the hash over all that was decided
    Show {
        /// Name of the map
        name: String,
    },
    /// Go on with another model over the same words, one that was calibrated anew
    Rebind {
        /// Name of the map
        name: String,
        /// Hash of the model, its beginning, or a display name that only one model has
        #[arg(long)]
        model: String,
    },
    /// List the loop closures of a map, oldest first
    Matches {
        /// Name of the map
        name: String,
    },
    /// List the places of a map, oldest first
    Places {
        /// Name of the map
        name: String,
    },
    Label(labels::Labelling),
    /// List what places are called
    Labels {
        /// Name of the map
        name: String,
    },
    /// Write where a session's robot was, frame by frame, for tools that compare trajectories
    Trajectory {
        /// Name of the map
        name: String,
        /// Name of the session
        session: String,
        #[arg(long, value_enum, default_value = "tum")]
        format: Format,
        /// Whose coordinates
        #[arg(long, value_enum, default_value = "map")]
        frame: Frame,
        /// Whose pose
        #[arg(long, value_enum, default_value = "base")]
        body: Body,
        /// File to write
        #[arg(long)]
        out: PathBuf,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
    /// Write the map's pose graph as g2o: a vertex per place, an edge per way that was measured
    Graph {
        /// Name of the map
        name: String,
        /// File to write
        #[arg(long)]
        out: PathBuf,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
    /// Copy a map with its model to a file, as it is now; robots may go on streaming into it
    Export {
        /// Name of the map
        name: String,
        /// File to write
        file: PathBuf,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
    /// Make a map from such a file; Ctrl-C cancels
    Import {
        /// File to read
        file: PathBuf,
        /// Name of the new map, if not the one that it had
        #[arg(long, default_value = "", hide_default_value = true)]
        name: String,
    },
    /// Make maps one: what both have seen becomes the same places; Ctrl-C cancels
    Merge(merge::Merging),
    /// Make a map anew with a model of other words, from the images or descriptors that it keeps; Ctrl-C cancels, and the
    /// same command goes on
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
    /// Make what a map holds now its new beginning: merges into it can no longer be undone, and what was removed, from any
    /// map, is wiped from the disk
    Compact {
        /// Name of the map
        name: String,
    },
    /// Say which places a map can do without to have no more than so many, and why
    Trim {
        /// Name of the map
        name: String,
        /// Most places that it is to have
        #[arg(long, value_name = "N")]
        places: u32,
        /// Drop them: frames there stay, at no place, and other places may have other numbers. It cannot be undone
        #[arg(long)]
        apply: bool,
    },
    /// Tell what each of two maps has that the other has not; changes nothing
    Diff {
        /// Name of a map
        first: String,
        /// Name of the other
        second: String,
    },
    /// Delete a map with all its sessions
    Rm {
        /// Name of the map
        name: String,
    },
}

/// What is left out has the server's default; `waypost map show` shows what is in force.
#[derive(clap::Args)]
pub(crate) struct Creation {
    /// 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit
    name: String,
    /// Hash of the model, its beginning, or a display name that only one model has
    #[arg(long)]
    model: String,
    /// Whether words depend on each other
    #[arg(long, value_enum)]
    dependence: Option<Dependence>,
    /// How being somewhere new is judged
    #[arg(long, value_enum)]
    new_place: Option<NewPlace>,
    /// Posterior from which a loop closure is accepted, above 0 and at most 1
    #[arg(long, value_name = "P")]
    closure_threshold: Option<f64>,
    /// A place that the session left fewer frames ago is not a loop closure
    #[arg(long, value_name = "N")]
    guard_frames: Option<u32>,
    /// Prior probability of being somewhere new, between 0 and 1
    #[arg(long, value_name = "P")]
    new_place_prior: Option<f64>,
    /// How probably a word that is there is seen, in place of the model's
    #[arg(long, value_name = "P", requires = "false_positive_rate")]
    true_positive_rate: Option<f64>,
    /// How probably a word that is not there is seen, in place of the model's
    #[arg(long, value_name = "P", requires = "true_positive_rate")]
    false_positive_rate: Option<f64>,
    /// What is kept of each frame beside its words
    #[arg(long, value_enum)]
    keep: Option<Keep>,
    /// How loop closures are verified by where features are; it takes a map that keeps features
    #[arg(long, value_enum)]
    verification: Option<Verification>,
    /// Where frames carry odometry: metres that a robot goes before it is at another place
    #[arg(long, value_name = "M")]
    place_spacing_m: Option<f64>,
    /// The same for how far it turns, in radians
    #[arg(long, value_name = "RAD")]
    place_spacing_rad: Option<f64>,
    /// How robots are led along the map; appearance takes panoramas, and a map that keeps features
    #[arg(long, value_enum)]
    strategy: Option<Strategy>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Strategy {
    /// Along places that wheels measured, by a camera that looks ahead; the server's default
    TopoMetric,
    /// By looks alone: panoramas, no odometry
    Appearance,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Format {
    /// A line of stamp in seconds, position and quaternion per frame
    Tum,
    /// A line of the upper three rows of the pose's matrix per frame
    Kitti,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Frame {
    /// The map's, corrected by loop closures; frames that it does not know where to put are left out
    Map,
    /// The session's own odometry, as the robot sent it
    Odom,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Body {
    /// The robot's base_link
    Base,
    /// Its camera, where the session declared how it is mounted
    Camera,
}

#[derive(Clone, Copy, ValueEnum)]
enum Verification {
    /// Not at all: the posterior decides alone
    None,
    /// By a motion in the image plane: the camera is back very close; the server's default
    Similarity,
    /// By epipolar geometry: the camera may have moved sideways
    Epipolar,
}

#[derive(Clone, Copy, ValueEnum)]
enum Keep {
    /// Nothing
    Words,
    /// Keypoints, descriptors, a thumbnail; the server's default
    Features,
    /// All of that and the image as it came
    Images,
}

#[derive(Clone, Copy, ValueEnum)]
enum Dependence {
    /// Each word on its parent in the Chow-Liu tree
    ChowLiu,
    /// No word on any other
    NaiveBayes,
}

#[derive(Clone, Copy, ValueEnum)]
enum NewPlace {
    /// By the average place
    MeanField,
    /// By the mean over the model's sampling set
    Sampled,
    /// By what the best of many unrelated places would reach, from the tail of the sampling set
    Tail,
    /// By the same tail, with likelihood ratios tempered to it; use with a lower --closure-threshold
    TemperedTail,
}

impl Creation {
    fn request(self) -> v1::CreateMapRequest {
        let Creation {
            name,
            model,
            dependence,
            new_place,
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate,
            false_positive_rate,
            keep,
            verification,
            place_spacing_m,
            place_spacing_rad,
            strategy,
        } = self;
        let dependence = match dependence {
            None => v1::map_settings::Dependence::Unspecified,
            Some(Dependence::ChowLiu) => v1::map_settings::Dependence::ChowLiu,
            Some(Dependence::NaiveBayes) => v1::map_settings::Dependence::NaiveBayes,
        };
        let new_place = match new_place {
            None => v1::map_settings::NewPlace::Unspecified,
            Some(NewPlace::MeanField) => v1::map_settings::NewPlace::MeanField,
            Some(NewPlace::Sampled) => v1::map_settings::NewPlace::Sampled,
            Some(NewPlace::Tail) => v1::map_settings::NewPlace::Tail,
            Some(NewPlace::TemperedTail) => v1::map_settings::NewPlace::TemperedTail,
        };
        let settings = v1::MapSettings {
            dependence: dependence.into(),
            new_place: new_place.into(),
            closure_threshold,
            guard_frames,
            new_place_prior,
            true_positive_rate,
            false_positive_rate,
            keep: match keep {
                None => v1::map_settings::Keep::Unspecified,
                Some(Keep::Words) => v1::map_settings::Keep::Words,
                Some(Keep::Features) => v1::map_settings::Keep::Features,
                Some(Keep::Images) => v1::map_settings::Keep::Images,
            }
            .into(),
            verification: match verification {
                None => v1::map_settings::Verification::Unspecified,
                Some(Verification::None) => v1::map_settings::Verification::None,
                Some(Verification::Similarity) => v1::map_settings::Verification::Similarity,
                Some(Verification::Epipolar) => v1::map_settings::Verification::Epipolar,
            }
            .into(),
            place_spacing_m,
            place_spacing_rad,
            navigation_strategy: match strategy {
                None => v1::map_settings::NavigationStrategy::Unspecified,
                Some(Strategy::TopoMetric) => v1::map_settings::NavigationStrategy::TopoMetric,
                Some(Strategy::Appearance) => v1::map_settings::NavigationStrategy::Appearance,
            }
            .into(),
        };
        let map_id = name.strip_prefix("maps/").unwrap_or(&name).to_owned();
        v1::CreateMapRequest { map_id, model, settings: Some(settings) }
    }
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    match command {
        Command::Create(creation) => show(client.create_map(creation.request()).await?, output),
        Command::Ls => list(client.maps().await?, output),
        Command::Show { name } => show(client.map(&name, v1::MapView::Full).await?, output),
        Command::Rebind { name, model } => show(client.rebind_map(&name, &model).await?, output),
        Command::Matches { name } => matches(client.matches(&name).await?, output),
        Command::Places { name } => places(client.places(&name).await?, output),
        Command::Label(labelling) => labels::label(&client, labelling, output).await,
        Command::Labels { name } => labels::list(&client, &name, output).await,
        Command::Export { name, file, force } => {
            snapshot::export(&client, &name, &file, Replacing::of(force), output).await
        }
        Command::Trajectory { name, session, format, frame, body, out, force } => {
            let format = match format {
                Format::Tum => v1::export_poses_request::Format::Tum,
                Format::Kitti => v1::export_poses_request::Format::Kitti,
            };
            let frame = match frame {
                Frame::Map => v1::export_poses_request::Frame::Map,
                Frame::Odom => v1::export_poses_request::Frame::Odom,
            };
            let body = match body {
                Body::Base => v1::export_poses_request::Body::Base,
                Body::Camera => v1::export_poses_request::Body::Camera,
            };
            let name = format!("maps/{}/sessions/{session}", short_map(&name));
            let request = v1::ExportPosesRequest {
                name,
                format: format.into(),
                frame: frame.into(),
                body: body.into(),
            };
            poses(&client, request, &out, Replacing::of(force), output).await
        }
        Command::Graph { name, out, force } => {
            let request = v1::ExportPosesRequest {
                name: format!("maps/{}", short_map(&name)),
                format: v1::export_poses_request::Format::G2o.into(),
                ..v1::ExportPosesRequest::default()
            };
            poses(&client, request, &out, Replacing::of(force), output).await
        }
        Command::Import { file, name } => {
            show(snapshot::import(&client, &file, &name, output).await?, output)
        }
        Command::Merge(merging) => merge::merge(&client, merging, output).await,
        Command::Rebuild { name, model, into } => {
            let job = client.rebuild_map(&name, &model, &into).await?;
            let job = job::follow(&client, &job.name, output).await?;
            show(client.map(&job.result, v1::MapView::Unspecified).await?, output)
        }
        Command::Compact { name } => {
            let job = client.compact_map(&name).await?;
            job::follow(&client, &job.name, output).await?;
            output.result(&json!({ "compacted": name }), |out| writeln!(out, "compacted {name}"))
        }
        Command::Trim { name, places, apply } => {
            use v1::trim_map_request::Mode;
            let mode = if apply { Mode::Apply } else { Mode::Preview };
            let name = format!("maps/{}", short_map(&name));
            let request = v1::TrimMapRequest { name, max_places: places, mode: mode.into() };
            trimmed(client.trim_map(request).await?, mode, output)
        }
        Command::Diff { first, second } => merge::diff(&client, [&first, &second], output).await,
        Command::Rm { name } => {
            client.delete_map(&name).await?;
            output.result(&json!({ "deleted": name }), |out| writeln!(out, "deleted {name}"))
        }
    }
}

fn trimmed(
    response: v1::TrimMapResponse,
    mode: v1::trim_map_request::Mode,
    output: Output,
) -> Result<(), Failure> {
    use v1::dropped_place::Why;
    let applied = mode == v1::trim_map_request::Mode::Apply;
    let v1::TrimMapResponse { dropped, places_left, over } = response;
    let why = |place: &v1::DroppedPlace| match &place.why {
        Some(Why::Redundant(v1::RedundantPlace { of_place, alike })) => {
            format!("place {of_place} stands there, too, and shows {:.0}% of the same words", alike * 100.0)
        }
        Some(Why::LeastSeen(v1::LeastSeenPlace { looks, apart })) => {
            format!("looked at {looks} times, and the next place is {apart:.2} away")
        }
        None => String::new(),
    };
    let rows: Vec<(u32, String)> = dropped.iter().map(|place| (place.place, why(place))).collect();
    let objects: Vec<_> = rows.iter().map(|(place, why)| json!({ "place": place, "why": why })).collect();
    let object = json!({ "dropped": objects, "places_left": places_left, "over": over, "applied": applied });
    output.result(&object, |out| {
        table(
            out,
            ["PLACE", "WHY IT GOES"],
            rows.iter().map(|(place, why)| [place.to_string(), why.clone()]),
        )?;
        let tense = if applied { "are" } else { "would be" };
        writeln!(out, "{places_left} places {tense} left")?;
        if over > 0 {
            writeln!(out, "{over} more than asked for: the map would fall apart without any of them")?;
        }
        Ok(())
    })
}

fn list(maps: Vec<v1::Map>, output: Output) -> Result<(), Failure> {
    let maps: Vec<MapSummary> = maps.into_iter().map(MapSummary::from).collect();
    output.result(&json!({ "maps": maps }), |out| {
        let rows = maps.iter().map(|map| {
            [
                short_map(&map.name).to_owned(),
                short(&map.model).to_owned(),
                map.places.to_string(),
                map.links.to_string(),
                map.sessions.to_string(),
                map.frames.to_string(),
                map.loop_closures.to_string(),
            ]
        });
        table(out, ["MAP", "MODEL", "PLACES", "LINKS", "SESSIONS", "FRAMES", "CLOSURES"], rows)
    })
}

fn show(map: v1::Map, output: Output) -> Result<(), Failure> {
    let map = MapSummary::from(map);
    output.result(&map, |out| {
        writeln!(out, "{}", map.name)?;
        writeln!(out, "  model                {}", map.model)?;
        writeln!(out, "  places               {}", map.places)?;
        writeln!(out, "  links                {}", map.links)?;
        writeln!(out, "  sessions             {}", map.sessions)?;
        writeln!(out, "  frames               {}", map.frames)?;
        writeln!(out, "  loop closures        {}", map.loop_closures)?;
        show_settings(&map.settings, out)?;
        if let Some(storage) = &map.storage {
            show_storage(storage, out)?;
        }
        map.state_hash.as_ref().map_or(Ok(()), |hash| writeln!(out, "  state hash           {hash}"))
    })
}

fn show_storage(storage: &StorageView, out: &mut dyn Write) -> io::Result<()> {
    let StorageView {
        log_bytes,
        checkpoint_bytes,
        features_bytes,
        thumbnail_bytes,
        image_bytes,
        bytes_per_frame,
    } = storage;
    let parts = [
        ("words and decisions", log_bytes),
        ("checkpoint", checkpoint_bytes),
        ("features", features_bytes),
        ("thumbnails", thumbnail_bytes),
        ("images", image_bytes),
    ];
    for (part, bytes) in parts {
        writeln!(out, "  {part:<20} {bytes} bytes")?;
    }
    writeln!(out, "  per frame            {bytes_per_frame:.0} bytes")
}

fn show_settings(settings: &SettingsView, out: &mut dyn Write) -> io::Result<()> {
    let SettingsView {
        dependence,
        new_place,
        closure_threshold,
        guard_frames,
        new_place_prior,
        true_positive_rate,
        false_positive_rate,
        keep,
        verification,
        place_spacing_m,
        place_spacing_rad,
        navigation_strategy,
    } = settings;
    let or_default = |value: &Option<f64>| value.map_or("the model's".to_owned(), |value| value.to_string());
    writeln!(out, "  dependence           {dependence}")?;
    writeln!(out, "  new place            {new_place}")?;
    writeln!(out, "  new place prior      {}", or_default(new_place_prior))?;
    writeln!(out, "  closure threshold    {}", or_default(closure_threshold))?;
    writeln!(out, "  guard                {} frames", guard_frames.unwrap_or_default())?;
    writeln!(out, "  true positive rate   {}", or_default(true_positive_rate))?;
    writeln!(out, "  false positive rate  {}", or_default(false_positive_rate))?;
    writeln!(out, "  verification         {verification}")?;
    let (distance_m, angle_rad) =
        (place_spacing_m.unwrap_or_default(), place_spacing_rad.unwrap_or_default());
    writeln!(out, "  place spacing        {distance_m} m, {:.1} degrees", angle_rad.to_degrees())?;
    writeln!(out, "  navigation           {navigation_strategy}")?;
    writeln!(out, "  keeps                {keep}")
}

fn matches(closures: Vec<v1::LoopClosure>, output: Output) -> Result<(), Failure> {
    let closures: Vec<ClosureView> = closures.into_iter().map(ClosureView::from).collect();
    output.result(&json!({ "matches": closures }), |out| {
        let rows = closures.iter().map(|closure| {
            let ClosureView { frame, matched_frame, place, posterior, probability } = closure;
            [
                frame_words(frame),
                frame_words(matched_frame),
                place.to_string(),
                format!("{posterior:.4}"),
                probability.map_or("not verified".to_owned(), |probability| format!("{probability:.4}")),
            ]
        });
        table(out, ["FRAME", "MATCHED FRAME", "PLACE", "BY WORDS", "WITH GEOMETRY"], rows)
    })
}

/// Writes poses to a file, which appears only when it is complete.
async fn poses(
    client: &Client,
    request: v1::ExportPosesRequest,
    path: &Path,
    replacing: Replacing,
    output: Output,
) -> Result<(), Failure> {
    replacing.check(path)?;
    let mut text = Vec::new();
    client.export_poses(request, &mut text).await?;
    replacing.write(path, &text)?;
    let lines = text.iter().filter(|&&byte| byte == b'\n').count();
    output.result(&json!({ "file": path, "lines": lines }), |out| {
        writeln!(out, "{lines} lines in {}", path.display())
    })
}

fn places(places: Vec<v1::Place>, output: Output) -> Result<(), Failure> {
    let places: Vec<PlaceView> = places.into_iter().map(PlaceView::from).collect();
    output.result(&json!({ "places": places }), |out| {
        let rows = places.iter().map(|place| {
            let PlaceView { name, looks, words, frames, linked, pose } = place;
            let pose = pose.map_or("-".to_owned(), |PlacePoseView { part, x_m, y_m, heading_rad }| {
                let of_part = if part == 0 { String::new() } else { format!(" from place {part}") };
                format!("{x_m:.2} {y_m:.2} m {:.0}°{of_part}", heading_rad.to_degrees())
            });
            let linked: Vec<String> = linked.iter().map(u32::to_string).collect();
            [
                name.rsplit('/').next().unwrap_or(name).to_owned(),
                looks.to_string(),
                words.to_string(),
                frames.len().to_string(),
                linked.join(" "),
                pose,
            ]
        });
        table(out, ["PLACE", "LOOKS", "WORDS", "FRAMES", "LINKED WITH", "WHERE"], rows)
    })
}

fn frame_words(frame: &Option<FrameView>) -> String {
    match frame {
        Some(FrameView { session, sequence, stamp_ns: _ }) => {
            format!("{}#{sequence}", session.rsplit('/').next().unwrap_or(session))
        }
        None => "-".to_owned(),
    }
}

pub(crate) fn short_map(name: &str) -> &str {
    name.strip_prefix("maps/").unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        creation: Creation,
    }

    fn request(arguments: &str) -> v1::CreateMapRequest {
        Line::parse_from(format!("create {arguments}").split(' ')).creation.request()
    }

    #[test]
    fn what_is_left_out_is_left_to_the_server() {
        let request = request("maps/office --model abcdef");
        assert_eq!((request.map_id.as_str(), request.model.as_str()), ("office", "abcdef"));
        assert_eq!(request.settings, Some(v1::MapSettings::default()));
    }

    #[test]
    fn what_is_given_is_passed_on() {
        let settings = request(
            "a --model m --dependence naive-bayes --new-place mean-field --closure-threshold 0.9 \
             --guard-frames 0 --true-positive-rate 0.4 --false-positive-rate 0.01 --strategy appearance",
        )
        .settings
        .unwrap();
        assert_eq!(settings.dependence(), v1::map_settings::Dependence::NaiveBayes);
        assert_eq!(settings.navigation_strategy(), v1::map_settings::NavigationStrategy::Appearance);
        assert_eq!(settings.new_place(), v1::map_settings::NewPlace::MeanField);
        assert_eq!((settings.closure_threshold, settings.guard_frames), (Some(0.9), Some(0)));
        assert_eq!((settings.true_positive_rate, settings.false_positive_rate), (Some(0.4), Some(0.01)));
    }

    #[test]
    fn one_rate_without_the_other_is_wrong_usage() {
        assert!(
            Line::try_parse_from(["create", "a", "--model", "m", "--true-positive-rate", "0.4"]).is_err()
        );
    }
}
