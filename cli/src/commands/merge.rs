//! `waypost merge`: merges of maps. `waypost map merge` starts one.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use clap::Subcommand;
use serde_json::json;
use waypost_client::v1::merge_source::Outcome;
use waypost_client::{Client, ClientOptions, v1};

use super::job;
use crate::failure::Failure;
use crate::files::{Replacing, check_drawn};
use crate::names::{numbered, short_map as short};
use crate::output::{Output, rounded, table};

#[derive(Subcommand)]
pub(crate) enum Command {
    /// List merges, newest first
    #[command(visible_alias = "list")]
    Ls,
    /// Show a merge: its state, and where the maps overlap
    #[command(visible_alias = "get")]
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
    /// Merge the maps as proposed
    Commit {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
    /// Drop the proposal; the maps stay as they are
    Discard {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
    /// Remove from a map what a merge has added; places may get other numbers
    Undo {
        /// As printed when it was asked for, as in `merges/1`
        name: String,
    },
}

/// Arguments of `waypost map merge`.
#[derive(clap::Args)]
pub(crate) struct Merging {
    /// Maps to merge; they stay as they are
    #[arg(required = true)]
    maps: Vec<String>,
    /// Map to merge them into; it is created if it does not exist
    #[arg(long, value_name = "MAP")]
    into: String,
    /// Only show what would change; `waypost merge commit` or `discard` decides later
    #[arg(long)]
    preview: bool,
    /// Fewest matches that must agree with each other, at least 3; 5 by default
    #[arg(long, value_name = "N")]
    min_support: Option<u32>,
    /// Write the maps before and after to this file, as SVG
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Replace a file that is there
    #[arg(long, requires = "picture")]
    force: bool,
}

pub(crate) async fn run(command: Command, server: &ClientOptions, output: Output) -> Result<(), Failure> {
    if let Command::Show { picture, force, .. } = &command {
        Replacing::of(*force).check_wanted(picture.as_deref())?;
        check_drawn(picture.as_deref())?;
    }
    let client = Client::connect(server).await?;
    let full = |name: &str| numbered("merges", name);
    let merge = match command {
        Command::Ls => return list(&client.merges().await?, output),
        Command::Show { name, picture, force } => {
            let name = full(&name);
            write_picture(&client, &name, picture.as_deref(), Replacing::of(force)).await?;
            client.merge(&name).await?
        }
        Command::Commit { name } => {
            finished(&client, client.commit_merge(&full(&name)).await?, output).await?
        }
        Command::Discard { name } => client.discard_merge(&full(&name)).await?,
        Command::Undo { name } => finished(&client, client.undo_merge(&full(&name)).await?, output).await?,
    };
    show(&merge, output)
}

/// `waypost map merge`
pub(crate) async fn merge(client: &Client, merging: Merging, output: Output) -> Result<(), Failure> {
    let Merging { maps, into, preview, min_support, picture, force } = merging;
    Replacing::of(force).check_wanted(picture.as_deref())?;
    check_drawn(picture.as_deref())?;
    let request = v1::MergeMapsRequest {
        sources: maps.iter().map(String::as_str).map(named).collect(),
        target: named(&into),
        auto_commit: !preview,
        min_support,
    };
    let found = finished(client, client.merge_maps(request).await?, output).await?;
    write_picture(client, &found.name, picture.as_deref(), Replacing::of(force)).await?;
    let state = found.state();
    let name = found.name.clone();
    show(&found, output)?;
    match state {
        v1::merge::State::Proposed => output.line(format_args!(
            "nothing is changed yet: `waypost merge commit {name}` makes the maps one, `waypost merge discard {name}` \
             leaves them"
        )),
        // With --preview this is a result, not an error.
        v1::merge::State::NoOverlap if !preview => {
            Err(Failure::JobFailed("the maps do not overlap, and nothing was changed".to_owned()))
        }
        _ => Ok(()),
    }
}

/// `waypost map diff`: what each of two maps has that the other lacks.
pub(crate) async fn diff(client: &Client, [first, second]: [&str; 2], output: Output) -> Result<(), Failure> {
    let maps = [
        client.map(short(first), v1::MapView::Full).await?,
        client.map(short(second), v1::MapView::Full).await?,
    ];
    let names = [short(first), short(second)];
    if maps[0].state_hash.is_some() && maps[0].state_hash == maps[1].state_hash {
        let object = json!({ "maps": names, "same_state": true });
        return output.result(&object, |out| {
            writeln!(out, "{} and {} hold the same: their state hashes are one", names[0], names[1])
        });
    }
    let request = v1::MergeMapsRequest {
        sources: vec![named(second)],
        target: named(first),
        auto_commit: false,
        min_support: None,
    };
    let found = finished(client, client.merge_maps(request).await?, output).await?;
    if found.state() == v1::merge::State::Proposed {
        client.discard_merge(&found.name).await?;
    }
    let same_model = maps[0].model == maps[1].model;
    let same_settings = maps[0].settings == maps[1].settings;
    let places = maps.each_ref().map(|map| map.places);
    let outcome = found.sources.into_iter().next().and_then(|source| source.outcome);
    let (overlap, no_overlap_reason) = match outcome {
        Some(Outcome::Overlap(overlap)) => (Some(overlap), None),
        Some(Outcome::NoOverlapReason(reason)) => (None, Some(reason)),
        None => (None, None),
    };
    let both = overlap.as_ref().map_or(0, |overlap| overlap.fused_places);
    let object = json!({
        "maps": names, "places": places, "places_of_second_in_first": both,
        "places_of_second_alone": places[1].saturating_sub(both),
        "same_model": same_model, "same_settings": same_settings, "same_state": false, "overlap": overlap,
        "no_overlap_reason": no_overlap_reason,
    });
    output.result(&object, |out| {
        let or_differ = |same: bool| if same { "the same" } else { "different" };
        writeln!(out, "{} has {} places, {} has {}", names[0], places[0], names[1], places[1])?;
        writeln!(out, "  models               {}", or_differ(same_model))?;
        writeln!(out, "  settings             {}", or_differ(same_settings))?;
        match (&overlap, &no_overlap_reason) {
            (Some(overlap), _) => {
                let alone = places[1].saturating_sub(both);
                writeln!(out, "  in both              {both} places of {}", names[1])?;
                writeln!(out, "  in {} alone  {alone} places", names[1])?;
                show_overlap(overlap, out)
            }
            (None, Some(reason)) => writeln!(out, "  no overlap           {reason}"),
            (None, None) => Ok(()),
        }
    })
}

/// Follows the job of a merge to its end; returns the merge as it is then.
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

fn list(merges: &[v1::Merge], output: Output) -> Result<(), Failure> {
    output.result(&json!({ "merges": merges }), |out| {
        let rows = merges.iter().map(|merge| {
            let sources = merge.base.iter().chain(&merge.sources);
            let sources: Vec<&str> = sources.map(|source| short(&source.map)).collect();
            [
                merge.name.clone(),
                merge.state().json_name().to_owned(),
                sources.join(", "),
                short(&merge.target).to_owned(),
                why(merge),
            ]
        });
        table(out, ["MERGE", "STATE", "MAPS", "INTO", "WHY"], rows)
    })
}

/// Why the maps did not become one: what failed, or why none of them overlaps.
fn why(merge: &v1::Merge) -> String {
    if let Some(error) = &merge.error {
        return error.message.clone();
    }
    let reason = |source: &v1::MergeSource| match &source.outcome {
        Some(Outcome::NoOverlapReason(reason)) => Some(format!("{}: {reason}", short(&source.map))),
        Some(Outcome::Overlap(_)) | None => None,
    };
    merge.sources.iter().filter_map(reason).collect::<Vec<_>>().join("; ")
}

fn show(merge: &v1::Merge, output: Output) -> Result<(), Failure> {
    output.result(merge, |out| {
        writeln!(out, "{} into {}: {}", merge.name, merge.target, merge.state().json_name())?;
        if let Some(error) = &merge.error {
            writeln!(out, "  error                {}", error.message)?;
        }
        if let Some(base) = &merge.base {
            writeln!(out, "{}, {} places", base.map, base.places)?;
            match merge.state() {
                v1::merge::State::Committed => {
                    writeln!(out, "  {} is a copy of it, with the others on it", merge.target)?;
                }
                v1::merge::State::Undone => {
                    writeln!(out, "  {}, which was a copy of it, is gone", merge.target)?;
                }
                _ => {}
            }
            show_sessions(base, out)?;
        }
        for source in &merge.sources {
            writeln!(out, "{}, {} places", source.map, source.places)?;
            match &source.outcome {
                Some(Outcome::Overlap(overlap)) => show_overlap(overlap, out)?,
                Some(Outcome::NoOverlapReason(reason)) => writeln!(out, "  no overlap           {reason}")?,
                None => writeln!(out, "  not searched yet")?,
            }
            show_sessions(source, out)?;
        }
        Ok(())
    })
}

/// By the names that they have in the target; none before the merge is committed.
fn show_sessions(source: &v1::MergeSource, out: &mut dyn Write) -> io::Result<()> {
    match source.sessions.join(", ").as_str() {
        "" => Ok(()),
        sessions => writeln!(out, "  sessions             {sessions}"),
    }
}

fn show_overlap(overlap: &v1::MapOverlap, out: &mut dyn Write) -> io::Result<()> {
    let v1::MapOverlap {
        transformation,
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
    match transformation {
        Some(v1::Pose { position_m, orientation }) => {
            let position = position_m.unwrap_or_default();
            let orientation = orientation.unwrap_or_default();
            let degrees = rounded((2.0 * orientation.z.atan2(orientation.w)).to_degrees(), 1);
            let [x_m, y_m] = [position.x, position.y].map(|metres| rounded(metres, 2));
            writeln!(out, "  lies at              x {x_m} m, y {y_m} m, turned by {degrees} degrees")?;
        }
        None => writeln!(out, "  lies at              not known: not both maps have odometry")?,
    }
    writeln!(out, "  matches              {agreeing_matches} agree, {rejected_matches} do not")?;
    writeln!(out, "  next best way        {rival_matches} matches")?;
    writeln!(out, "  fused places         {fused_places}")?;
    writeln!(out, "  overlap              {confirmed_places} of {overlapping_places} places match")?;
    writeln!(out, "  cost                 {cost_before:.1} apart, {cost_after:.1} together")?;
    for matched in strongest_matches.iter().take(5) {
        let v1::PlaceMatch {
            source_frame,
            target_frame,
            source_note,
            target_note,
            posterior,
            evidence_inliers,
            source_place_number: _,
            target_place_number: _,
        } = matched;
        let evidence = evidence_inliers
            .map_or_else(|| "by words alone".to_owned(), |inliers| format!("evidence {inliers:.0} inliers"));
        writeln!(
            out,
            "    {} is {}: posterior {posterior:.4}, {evidence}",
            frame(source_frame, source_note),
            frame(target_frame, target_note)
        )?;
    }
    Ok(())
}

/// `maps/a/sessions/b/frames/7` as `a b 7`, or `a b 000147.jpg` where its robot calls it so.
fn frame(name: &str, note: &str) -> String {
    let mut parts: Vec<&str> = name.split('/').skip(1).step_by(2).collect();
    if let (Some(number), false) = (parts.last_mut(), note.is_empty()) {
        *number = note;
    }
    parts.join(" ")
}

fn named(map: &str) -> String {
    format!("maps/{}", short(map))
}
