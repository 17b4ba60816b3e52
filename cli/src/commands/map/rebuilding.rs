//! `waypost map rebuild`: a map made anew with another model, and what came of it.

use std::io::{self, Write};

use serde_json::json;
use waypost_client::{Client, v1};

use crate::commands::job;
use crate::failure::Failure;
use crate::output::Output;
use crate::reasons::Reasons;

/// What came of a rebuild.
struct Rebuilt {
    map: v1::Map,
    /// For what reasons its frames were decided, and those of the map that it was made from.
    reasons: Reasons,
    reasons_before: Reasons,
    /// What the other map has and this one has not: it was said of other places.
    labels_left: usize,
    corrections_left: usize,
}

/// Rebuilds the map `from` with a model, and says for what reasons its frames were decided.
pub(super) async fn rebuild(
    client: &Client,
    [from, model, into]: [&str; 3],
    output: Output,
) -> Result<(), Failure> {
    let job = client.rebuild_map(from, model, into).await?;
    let job = job::follow(client, &job.name, output).await?;
    let map = client.map(&job::result(job)?, v1::MapView::Basic).await?;
    let rebuilt = Rebuilt {
        reasons: reasons(client, &map.name).await?,
        reasons_before: reasons(client, from).await?,
        labels_left: client.labels(from).await?.len(),
        corrections_left: client.corrections(from).await?.len(),
        map,
    };
    let Rebuilt { map, reasons, reasons_before, labels_left, corrections_left } = &rebuilt;
    let object = json!({
        "map": map,
        "reasons": reasons,
        "reasons_before": reasons_before,
        "labels_left": labels_left,
        "corrections_left": corrections_left,
    });
    output.result(&object, |out| write(&rebuilt, out))
}

async fn reasons(client: &Client, map: &str) -> Result<Reasons, Failure> {
    let mut names = Vec::new();
    for session in client.sessions(map).await? {
        let frames = client.frames(&session.name).await?;
        names.extend(frames.iter().filter_map(|frame| Some(frame.answer.as_ref()?.reason().json_name())));
    }
    Ok(Reasons::of(names.into_iter()))
}

fn write(rebuilt: &Rebuilt, out: &mut dyn Write) -> io::Result<()> {
    let Rebuilt { map, reasons, reasons_before, labels_left, corrections_left } = rebuilt;
    writeln!(out, "{}", map.name)?;
    writeln!(out, "  model                {}", map.model)?;
    writeln!(out, "  places               {}", map.places)?;
    writeln!(out, "  links                {}", map.links)?;
    writeln!(out, "{:<35}{:>6}{:>8}", "", "now", "before")?;
    let count = |reasons: &Reasons| reasons.rows("").iter().map(|(_, frames)| frames).sum::<usize>();
    writeln!(out, "{:<35}{:6}{:8}", "frames", count(reasons), count(reasons_before))?;
    for ((what, now), (_, before)) in
        reasons.rows("loop closures").into_iter().zip(reasons_before.rows("loop closures"))
    {
        writeln!(out, "  {what:<33}{now:6}{before:8}")?;
    }
    if labels_left + corrections_left > 0 {
        writeln!(
            out,
            "not carried over, since places have other numbers here: labels {labels_left}, corrections by people \
             {corrections_left}"
        )?;
    }
    Ok(())
}
