//! What is told of frames while they are answered.

use std::borrow::Cow;
use std::io::Write;

use waypost_client::{Client, v1};

use crate::failure::Failure;
use crate::frame_row::FrameRow;
use crate::output::{Output, rounded};
use crate::replay::Replay;

/// Sequences of so many guards or fewer that close no loop are told of the guard.
const FEW_GUARDS: u32 = 5;

/// Loop closures, and where a robot that localizes is, go to stdout, refusals to stderr.
pub(super) fn tell(
    row: &FrameRow,
    replay: &Replay,
    mode: v1::SessionMode,
    session: &str,
    output: Output,
) -> Result<(), Failure> {
    if let Some(message) = &row.refusal_message {
        let code = row.refusal_code.unwrap_or_default();
        // If stderr is closed, the message is lost.
        let _ = writeln!(std::io::stderr(), "{}: refused, {code}: {message}", row.image);
    }
    match mode {
        v1::SessionMode::Localize => match where_line(row) {
            Some(line) => output.line(line),
            None => Ok(()),
        },
        v1::SessionMode::Map | v1::SessionMode::Unspecified if row.reason == Some("loop_closure") => {
            output.line(closure_line(row, replay, session))
        }
        v1::SessionMode::Map | v1::SessionMode::Unspecified => Ok(()),
    }
}

/// A loop closure as a line of text. A matched frame of this session is named by its image.
pub(crate) fn closure_line(row: &FrameRow, replay: &Replay, session: &str) -> String {
    let matched = match (&row.match_session, row.match_sequence) {
        (Some(matched), Some(sequence)) if matched == session => {
            replay.image_name(sequence).map_or_else(|| format!("frame {sequence}"), Cow::into_owned)
        }
        (_, _) => matched_frame(row).unwrap_or_else(|| "no frame".to_owned()),
    };
    let place = row.match_place_number.unwrap_or_default();
    format!("{} closes a loop with {matched}  place {place}  {}", row.image, how_sure(row))
}

/// The frame of a map that matched, if one did.
fn matched_frame(row: &FrameRow) -> Option<String> {
    let session = row.match_session.as_deref()?;
    Some(match row.match_note.as_deref() {
        None | Some("") => format!("frame {} of {session}", row.match_sequence?),
        Some(note) => format!("{note} of {session}"),
    })
}

/// How sure it is that the frame shows the place that it matched.
fn how_sure(row: &FrameRow) -> String {
    match (row.match_probability, row.match_inliers) {
        (Some(probability), Some(inliers)) => {
            format!("probability {probability:.3}, {inliers} features agree")
        }
        (_, _) => format!("posterior {:.4}", row.match_posterior.unwrap_or_default()),
    }
}

/// Where a robot is that localizes, or why that is not known; none for a frame that was refused.
fn where_line(row: &FrameRow) -> Option<String> {
    let reason = row.reason?;
    let image = &row.image;
    let pose = pose_words(row).map_or_else(String::new, |pose| format!("  {pose}"));
    Some(match (reason, row.place_number) {
        ("loop_closure", Some(place)) => {
            let seen = matched_frame(row).map_or_else(String::new, |frame| format!(", as in {frame}"));
            format!("{image} is at place {place}{pose}  {}{seen}", how_sure(row))
        }
        // By its wheels, or by words that are much the same all along.
        (_, Some(place)) => format!("{image} is at place {place} still{pose}"),
        (_, None) => format!("{image} is not recognised: {}{pose}", why_not(reason)),
    })
}

fn why_not(reason: &str) -> &'static str {
    match reason {
        "new_place" => "it looks like no place of the map",
        "below_threshold" => "a place of the map is likely, but below the threshold",
        "geometry_refused" => "features do not lie as they do at the place that it looks like",
        "too_few_words" => "it shows too little",
        _ => "no place was told",
    }
}

/// By wheels and recognised places, seen from above.
fn pose_words(row: &FrameRow) -> Option<String> {
    let (x_m, y_m, heading_rad) = (row.map_x_m?, row.map_y_m?, row.map_heading_rad?);
    let part = match row.map_part {
        None | Some(0) => String::new(),
        Some(part) => format!(" from place {part}"),
    };
    let [x_m, y_m] = [x_m, y_m].map(|metres| rounded(metres, 2));
    let heading_deg = rounded(heading_rad.to_degrees(), 0);
    Some(format!("({x_m}, {y_m}) m, {heading_deg}°{part}"))
}

/// What may help where a short sequence closes no loop: the latest places are not looked for.
pub(super) async fn short_sequence_hint(
    client: &Client,
    map: &str,
    rows: &[FrameRow],
) -> Result<Option<String>, Failure> {
    let closes = rows.iter().any(|row| row.reason == Some("loop_closure"));
    let longest = rows.iter().filter(|row| row.reason.is_some()).map(|row| row.sequence).max();
    let Some(last) = longest.filter(|_| !closes) else { return Ok(None) };
    let settings = client.map(map, v1::MapView::Basic).await?.settings.unwrap_or_default();
    let guard = settings.guard_frames.unwrap_or_default();
    Ok((guard > 0 && last <= u64::from(guard.saturating_mul(FEW_GUARDS))).then(|| {
        format!(
            "no loop was closed. Places that were left fewer than {guard} frames ago are not looked for: a loop \
             within a short sequence needs a map with a smaller guard, as by `waypost map create --guard-frames {}`",
            guard.div_ceil(4)
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(reason: &'static str, place_number: Option<u32>) -> FrameRow {
        FrameRow {
            image: "7.jpg".to_owned(),
            reason: Some(reason),
            place_number,
            posterior: Some(0.5),
            ..FrameRow::default()
        }
    }

    #[test]
    fn a_robot_that_localizes_is_told_where_it_is() {
        let found = FrameRow {
            match_session: Some("maps/hall/sessions/sunday".to_owned()),
            match_sequence: Some(3),
            match_probability: Some(0.97),
            match_inliers: Some(41),
            map_part: Some(0),
            map_x_m: Some(1.5),
            map_y_m: Some(-2.0),
            map_heading_rad: Some(-0.001),
            ..row("loop_closure", Some(12))
        };
        let line = "7.jpg is at place 12  (1.50, -2.00) m, 0°  probability 0.970, 41 features agree, as in ";
        let of = "of maps/hall/sessions/sunday";
        assert_eq!(where_line(&found).unwrap(), format!("{line}frame 3 {of}"));
        let noted = FrameRow { match_note: Some("a.jpg".to_owned()), ..found };
        assert_eq!(where_line(&noted).unwrap(), format!("{line}a.jpg {of}"));
        let same = where_line(&row("same_place", Some(12))).unwrap();
        assert_eq!(same, "7.jpg is at place 12 still");
    }

    #[test]
    fn what_is_not_recognised_is_told_why() {
        for reason in ["new_place", "below_threshold", "geometry_refused", "too_few_words"] {
            let line = where_line(&row(reason, None)).unwrap();
            assert!(
                line.starts_with("7.jpg is not recognised: ") && !line.contains("no place was"),
                "{line}"
            );
        }
        assert_eq!(where_line(&FrameRow::default()), None);
    }
}
