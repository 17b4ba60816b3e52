//! Prints what people said of loop closures.

use waypost_client::v1;

use crate::output::in_words;

/// Who said it, and when, as in `withdrawn by anna, 2026-02-28 13:05:09 UTC`.
pub(crate) fn told(correction: &v1::Correction) -> String {
    use v1::correction::Verdict;
    let v1::Correction { matched_frame, token, create_time_ns, undone, .. } = correction;
    let said = match correction.verdict() {
        Verdict::Withdrawn => "withdrawn".to_owned(),
        Verdict::Confirmed => format!("said to be of one place with {}", frame_words(matched_frame.as_ref())),
        Verdict::Unspecified => "corrected".to_owned(),
    };
    let undone = undone.as_ref().map_or_else(String::new, |v1::Undoing { token, create_time_ns }| {
        format!("; undone {}", by(token, *create_time_ns))
    });
    format!("{said} {}{undone}", by(token, *create_time_ns))
}

fn by(token: &str, time_ns: i64) -> String {
    let who = if token.is_empty() { "without a token" } else { token };
    let by = if token.is_empty() { "" } else { "by " };
    format!("{by}{who}, {}", in_words(time_ns))
}

/// A frame in a table, as in `monday#212`.
pub(crate) fn frame_words(frame: Option<&v1::FrameReference>) -> String {
    match frame {
        Some(v1::FrameReference { session, sequence, stamp_ns: _, note }) => {
            let session = session.rsplit('/').next().unwrap_or(session);
            if note.is_empty() {
                format!("{session}#{sequence}")
            } else {
                format!("{session}#{sequence} {note}")
            }
        }
        None => "-".to_owned(),
    }
}
