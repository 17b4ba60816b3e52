//! What came of a stream, in the end.

use std::io::{self, Write};

use serde::Serialize;
use waypost_client::v1;

use super::agreement;
use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::output::Output;
use crate::reasons::Reasons;
use crate::replay::Sent;

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    session: String,
    map: String,
    model: String,
    /// Null in a new session.
    resumed_after_sequence: Option<u64>,
    frame_count: usize,
    refused: usize,
    places_created: usize,
    /// Null where the robot only localizes: nothing is closed where nothing is added.
    loop_closures: Option<usize>,
    /// Frames that were recognised at another place than the one before, where the robot only localizes; else null.
    recognised: Option<usize>,
    /// Of the frames that were answered: each has one.
    reasons: Reasons,
    /// Mean length of an image or its words, in bytes; null if nothing was sent.
    bytes_per_frame: Option<f64>,
    /// Median time of a frame at the server; null if all answers were stored ones.
    ms_p50: Option<f64>,
    /// What seems to be wrong with the odometry, held against the last images; null if nothing does.
    odometry_finding: Option<String>,
    frames: Vec<FrameRow>,
}

/// What may help, in the end.
pub(super) struct Hints {
    pub(super) short_sequence: Option<String>,
    pub(super) unchecked: Option<String>,
    pub(super) odometry_finding: Option<String>,
}

/// Prints what came of a stream, and the hints to stderr. Fails if frames were refused.
pub(super) fn conclude(
    opened: v1::SessionOpened,
    frames: Vec<FrameRow>,
    sent: Sent,
    mode: v1::SessionMode,
    Hints { short_sequence, unchecked, odometry_finding }: Hints,
    output: Output,
) -> Result<(), Failure> {
    let v1::SessionOpened { session, last_committed_sequence, model, words_hash: _ } = opened;
    let localizes = mode == v1::SessionMode::Localize;
    let reasons = Reasons::of(frames.iter().filter_map(|row| row.reason));
    let summary = Summary {
        map: session.split("/sessions/").next().unwrap_or_default().to_owned(),
        session,
        model,
        resumed_after_sequence: last_committed_sequence,
        frame_count: frames.len(),
        refused: frames.iter().filter(|row| row.refusal_code.is_some()).count(),
        // A localizing session has no place for frames with these reasons.
        places_created: frames
            .iter()
            .filter(|row| {
                row.place_number.is_some()
                    && matches!(row.reason, Some("new_place" | "below_threshold" | "geometry_refused"))
            })
            .count(),
        loop_closures: (!localizes).then_some(reasons.loop_closure),
        recognised: localizes.then_some(reasons.loop_closure),
        reasons,
        bytes_per_frame: sent.bytes_per_frame(),
        ms_p50: median(frames.iter().filter_map(|row| row.total_ms).collect()),
        odometry_finding,
        frames,
    };
    output.result(&summary, |out| write(&summary, mode, out))?;
    let nothing_recognised =
        summary.recognised == Some(0) && summary.frame_count > 0 && reasons.same_place == 0;
    let elsewhere = nothing_recognised.then(|| {
        format!(
            "no frame was recognised: is {} the map of this place, and made with this camera? its model may be of other images: \
             `waypost explain` and the guide's troubleshooting tell more",
            summary.map
        )
    });
    for hint in
        [short_sequence, unchecked, elsewhere].into_iter().flatten().filter(|_| output == Output::Text)
    {
        // If stderr is closed, the hint is lost.
        let _ = writeln!(io::stderr(), "{hint}");
    }
    if let Some(finding) = &summary.odometry_finding {
        agreement::tell(finding);
    }
    match summary.refused {
        0 => Ok(()),
        refused => Err(Failure::FramesRefused { refused, frames: summary.frame_count }),
    }
}

fn write(summary: &Summary, mode: v1::SessionMode, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{:<35}{:6}", "frames", summary.frame_count)?;
    // Nothing is closed where nothing is added.
    let recognised = match mode {
        v1::SessionMode::Localize => "another place, recognised",
        v1::SessionMode::Map | v1::SessionMode::Unspecified => "loop closures",
    };
    summary.reasons.write(recognised, out)?;
    writeln!(out, "  {:<33}{:6}", "refused", summary.refused)?;
    if mode != v1::SessionMode::Localize {
        writeln!(out, "{:<35}{:6}", "new places", summary.places_created)?;
    }
    if let Some(bytes) = summary.bytes_per_frame {
        writeln!(out, "{:<35}{bytes:6.0} (mean, sent)", "bytes a frame")?;
    }
    match summary.ms_p50 {
        Some(ms_p50) => {
            writeln!(out, "{:<35}{ms_p50:6.1} (median, at the server, with waiting there)", "ms per frame")
        }
        None => Ok(()),
    }
}

/// The median of the values.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied()
}
