//! `waypost merge`: maps that become one. `waypost map merge` asks for it.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde::Serialize;
use serde_json::json;
use waypost_client::v1::merge_source::Outcome;
use waypost_client::{Client, ClientOptions, v1};

use super::job;
use super::snapshot::Replacing;
use crate::failure::Failure;
use crate::output::{Output, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List merges, newest first
    #[command(visible_alias = "list")]
    Ls,
    /// Show what was found, and what became of it
    Show {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
        /// Write the maps before and after to this file, as SVG
        #[arg(long, value_name = "FILE")]
        picture: Option<PathBuf>,
        /// Replace a file that is there
        #[arg(long, requires = "picture")]
        force: bool,
    },
    /// Make the maps one as was proposed
    Commit {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
    /// Leave the maps as they are
    Discard {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
    /// Take out of a map what a merge has brought; places may have other numbers afterwards
    Undo {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
}

/// What `waypost map merge` takes.
#[derive(clap::Args)]
pub(crate) struct Merging {
    /// The maps
    #[arg(required = true)]
    maps: Vec<String>,
    /// Map that they go into; one that is not there yet is made of them. They themselves stay as they are
    #[arg(long, value_name = "MAP")]
    into: String,
    /// Change nothing, and show what would come of it; `waypost merge commit` or `discard` decides
    #[arg(long)]
    preview: bool,
    /// Least matches that agree with each other, at least 3
    #[arg(long, value_name = "N")]
    min_support: Option<u32>,
    /// Write the maps before and after to this file, as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "picture")]
    force: bool,
}

/// A merge as scripts see it.
#[derive(Serialize)]
struct MergeView {
    name: String,
    state: &'static str,
    target: String,
    sources: Vec<SourceView>,
    job: String,
    error: String,
    create_time_ns: i64,
}

#[derive(Serialize)]
struct SourceView {
    map: String,
    events: u64,
    places: u64,
    /// Null if it does not overlap.
    overlap: Option<OverlapView>,
    /// Why it overlaps with nothing.
    apart: Option<String>,
    sessions: Vec<String>,
}

#[derive(Serialize)]
struct OverlapView {
    /// Null where one of the maps knows no metres.
    lies_at: Option<LiesAt>,
    source_part: u32,
    target_part: u32,
    agreeing_matches: u64,
    rejected_matches: u64,
    rival_matches: u64,
    fused_places: u64,
    overlapping_places: u64,
    confirmed_places: u64,
    cost_before: f64,
    cost_after: f64,
    strongest_matches: Vec<MatchView>,
}

#[derive(Serialize)]
struct LiesAt {
    x_m: f64,
    y_m: f64,
    heading_rad: f64,
}

#[derive(Serialize)]
struct MatchView {
    source_place: u32,
    target_place: u32,
    source_frame: String,
    target_frame: String,
    posterior: f64,
    evidence_nats: f64,
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    let client = Client::connect(server).await?;
    let merge = match command {
        Command::Ls => return list(client.merges().await?, output),
        Command::Show { name, picture, force } => {
            write_picture(&client, &name, picture.as_deref(), Replacing::of(force)).await?;
            client.merge(&name).await?
        }
        Command::Commit { name } => finished(&client, client.commit_merge(&name).await?, output).await?,
        Command::Discard { name } => client.discard_merge(&name).await?,
        Command::Undo { name } => finished(&client, client.undo_merge(&name).await?, output).await?,
    };
    show(merge, output)
}

/// `waypost map merge`
pub(crate) async fn merge(client: &Client, merging: Merging, output: Output) -> Result<(), Failure> {
    use v1::merge_maps_request::OnceFound;
    let Merging { maps, into, preview, min_support, picture, force } = merging;
    let once_found = if preview { OnceFound::Propose } else { OnceFound::Commit };
    let request = v1::MergeMapsRequest {
        sources: maps.iter().map(String::as_str).map(named).collect(),
        target: named(&into),
        once_found: once_found.into(),
        min_support,
    };
    let found = finished(client, client.merge_maps(request).await?, output).await?;
    write_picture(client, &found.name, picture.as_deref(), Replacing::of(force)).await?;
    let (state, name) = (found.state(), found.name.clone());
    show(found, output)?;
    match state {
        v1::merge::State::Proposed => output.line(format_args!(
            "nothing is changed yet: `waypost merge commit {name}` makes the maps one, `waypost merge discard {name}` \
             leaves them"
        )),
        // Asked for a look alone, that is an answer.
        v1::merge::State::Apart if !preview => {
            Err(Failure::JobFailed("the maps stay apart, and nothing was changed".to_owned()))
        }
        _ => Ok(()),
    }
}

/// `waypost map diff`: what each of two maps shows that the other does not.
pub(crate) async fn diff(client: &Client, [first, second]: [&str; 2], output: Output) -> Result<(), Failure> {
    let maps = [
        client.map(short(first), v1::MapView::Unspecified).await?,
        client.map(short(second), v1::MapView::Unspecified).await?,
    ];
    let request = v1::MergeMapsRequest {
        sources: vec![named(second)],
        target: named(first),
        once_found: v1::merge_maps_request::OnceFound::Propose.into(),
        min_support: None,
    };
    let found = finished(client, client.merge_maps(request).await?, output).await?;
    if found.state() == v1::merge::State::Proposed {
        client.discard_merge(&found.name).await?;
    }
    let same_model = maps[0].model == maps[1].model;
    let same_settings = maps[0].settings == maps[1].settings;
    let places = maps.each_ref().map(|map| map.places);
    let source = found.sources.into_iter().next().map(SourceView::from);
    let (overlap, apart) = source.map_or((None, None), |source| (source.overlap, source.apart));
    let both = overlap.as_ref().map_or(0, |overlap| overlap.fused_places);
    let names = [short(first), short(second)];
    let object = json!({
        "maps": names, "places": places, "places_of_second_in_first": both,
        "places_of_second_alone": places[1].saturating_sub(both),
        "same_model": same_model, "same_settings": same_settings, "overlap": overlap, "apart": apart,
    });
    output.result(&object, |out| {
        let or_differ = |same: bool| if same { "the same" } else { "different" };
        writeln!(out, "{} has {} places, {} has {}", names[0], places[0], names[1], places[1])?;
        writeln!(out, "  models               {}", or_differ(same_model))?;
        writeln!(out, "  settings             {}", or_differ(same_settings))?;
        match (&overlap, &apart) {
            (Some(overlap), _) => {
                let alone = places[1].saturating_sub(both);
                writeln!(out, "  in both              {both} places of {}", names[1])?;
                writeln!(out, "  in {} alone  {alone} places", names[1])?;
                show_overlap(overlap, out)
            }
            (None, Some(apart)) => writeln!(out, "  no overlap           {apart}"),
            (None, None) => Ok(()),
        }
    })
}

/// Follows the job of a merge to its end; the merge then.
async fn finished(client: &Client, merge: v1::Merge, output: Output) -> Result<v1::Merge, Failure> {
    job::follow(client, &merge.job, output).await?;
    Ok(client.merge(&merge.name).await?)
}

async fn write_picture(
    client: &Client,
    name: &str,
    path: Option<&Path>,
    replacing: Replacing,
) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    let svg = client.merge_picture(name).await?;
    replacing.write(path, &svg)
}

fn list(merges: Vec<v1::Merge>, output: Output) -> Result<(), Failure> {
    let merges: Vec<MergeView> = merges.into_iter().map(MergeView::from).collect();
    output.result(&json!({ "merges": merges }), |out| {
        let rows = merges.iter().map(|merge| {
            let sources: Vec<&str> = merge.sources.iter().map(|source| short(&source.map)).collect();
            [
                merge.name.clone(),
                merge.state.to_owned(),
                sources.join(", "),
                short(&merge.target).to_owned(),
                merge.error.clone(),
            ]
        });
        table(out, ["MERGE", "STATE", "MAPS", "INTO", "ERROR"], rows)
    })
}

fn show(merge: v1::Merge, output: Output) -> Result<(), Failure> {
    let merge = MergeView::from(merge);
    output.result(&merge, |out| {
        writeln!(out, "{} into {}: {}", merge.name, merge.target, merge.state)?;
        if !merge.error.is_empty() {
            writeln!(out, "  error                {}", merge.error)?;
        }
        for source in &merge.sources {
            writeln!(out, "{}, {} places", source.map, source.places)?;
            match (&source.overlap, &source.apart) {
                (Some(overlap), _) => show_overlap(overlap, out)?,
                (None, Some(apart)) => writeln!(out, "  stays apart          {apart}")?,
                (None, None) => writeln!(out, "  not looked for yet")?,
            }
            if !source.sessions.is_empty() {
                writeln!(out, "  sessions             {}", source.sessions.join(", "))?;
            }
        }
        Ok(())
    })
}

fn show_overlap(overlap: &OverlapView, out: &mut dyn Write) -> io::Result<()> {
    let OverlapView {
        lies_at,
        source_part: _,
        target_part: _,
        agreeing_matches,
        rejected_matches,
        rival_matches,
        fused_places,
        overlapping_places,
        confirmed_places,
        cost_before,
        cost_after,
        strongest_matches,
    } = overlap;
    match lies_at {
        Some(LiesAt { x_m, y_m, heading_rad }) => {
            let degrees = heading_rad.to_degrees();
            writeln!(
                out,
                "  lies at              x {x_m:.2} m, y {y_m:.2} m, turned by {degrees:.1} degrees"
            )?;
        }
        None => writeln!(out, "  lies at              not known: one of the maps has no odometry")?,
    }
    writeln!(out, "  matches              {agreeing_matches} agree, {rejected_matches} do not")?;
    writeln!(out, "  next best way        {rival_matches} matches")?;
    writeln!(out, "  fused places         {fused_places}")?;
    writeln!(out, "  overlap              {confirmed_places} of {overlapping_places} places match")?;
    writeln!(out, "  cost                 {cost_before:.1} apart, {cost_after:.1} together")?;
    for matched in strongest_matches.iter().take(5) {
        let MatchView { source_frame, target_frame, posterior, evidence_nats, .. } = matched;
        writeln!(
            out,
            "    {} is {}: posterior {posterior:.4}, evidence {evidence_nats:.0} nats",
            frame(source_frame),
            frame(target_frame)
        )?;
    }
    Ok(())
}

/// `maps/a/sessions/b/frames/7` as `a b 7`.
fn frame(name: &str) -> String {
    name.split('/').skip(1).step_by(2).collect::<Vec<_>>().join(" ")
}

fn named(map: &str) -> String {
    format!("maps/{}", short(map))
}

fn short(map: &str) -> &str {
    map.strip_prefix("maps/").unwrap_or(map)
}

impl From<v1::Merge> for MergeView {
    fn from(merge: v1::Merge) -> Self {
        use v1::merge::State;
        let state = match merge.state() {
            State::Unspecified => "unspecified",
            State::Searching => "searching",
            State::Proposed => "proposed",
            State::Apart => "apart",
            State::Committed => "committed",
            State::Discarded => "discarded",
            State::Undone => "undone",
            State::Failed => "failed",
        };
        let v1::Merge { name, state: _, target, sources, job, error, create_time_ns } = merge;
        let sources = sources.into_iter().map(SourceView::from).collect();
        Self { name, state, target, sources, job, error, create_time_ns }
    }
}

impl From<v1::MergeSource> for SourceView {
    fn from(source: v1::MergeSource) -> Self {
        let v1::MergeSource { map, events, places, outcome, sessions } = source;
        let (overlap, apart) = match outcome {
            Some(Outcome::Overlap(overlap)) => (Some(OverlapView::from(overlap)), None),
            Some(Outcome::Apart(why)) => (None, Some(why)),
            None => (None, None),
        };
        Self { map, events, places, overlap, apart, sessions }
    }
}

impl From<v1::MapOverlap> for OverlapView {
    fn from(overlap: v1::MapOverlap) -> Self {
        let v1::MapOverlap {
            transformation,
            source_part,
            target_part,
            agreeing_matches,
            rejected_matches,
            rival_matches,
            fused_places,
            overlapping_places,
            confirmed_places,
            cost_before,
            cost_after,
            strongest_matches,
        } = overlap;
        let lies_at = transformation.map(|v1::Pose { position_m, orientation }| {
            let (position, orientation) = (position_m.unwrap_or_default(), orientation.unwrap_or_default());
            LiesAt { x_m: position.x, y_m: position.y, heading_rad: 2.0 * orientation.z.atan2(orientation.w) }
        });
        let matched = |matched: v1::PlaceMatch| {
            let v1::PlaceMatch {
                source_place,
                target_place,
                source_frame,
                target_frame,
                posterior,
                evidence_nats,
            } = matched;
            MatchView { source_place, target_place, source_frame, target_frame, posterior, evidence_nats }
        };
        Self {
            lies_at,
            source_part,
            target_part,
            agreeing_matches,
            rejected_matches,
            rival_matches,
            fused_places,
            overlapping_places,
            confirmed_places,
            cost_before,
            cost_after,
            strongest_matches: strongest_matches.into_iter().map(matched).collect(),
        }
    }
}
