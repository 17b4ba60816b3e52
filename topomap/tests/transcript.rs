//! What was decided, to the bit: a line a frame, to be compared with a file that was written before
//! a change.

use std::fmt::Write;
use std::path::Path;

use fabmap::model::Model;
use sha2::{Digest, Sha256};
use topomap::evidence::Match;
use topomap::log::{FrameEvent, MapEvent};
use topomap::mapper::{Mapper, Queried};
use topomap::settings::MapperSettings;

/// What each event of a log says, with hashes of its bytes and of the map's state after it.
pub(crate) fn of_log(model: &Model, settings: MapperSettings, log: &[MapEvent]) -> String {
    let mut mapper = Mapper::new(model, settings).unwrap();
    let mut text = String::new();
    for event in log {
        mapper.apply(event).unwrap();
        let state_hash = mapper.state_hash().to_string();
        writeln!(text, "{} state {}", line(event), &state_hash[..16]).unwrap();
    }
    text
}

/// The same of frames that no log has.
pub(crate) fn of_frames<'a>(events: impl IntoIterator<Item = &'a FrameEvent>) -> String {
    events.into_iter().map(|event| line(&MapEvent::Frame(Box::new(event.clone()))) + "\n").collect()
}

/// What a query found.
pub(crate) fn of_query(queried: &Queried) -> String {
    let Queried { recognition, candidates, matched, accepted } = queried;
    let mut numbers = vec![recognition.posterior.new_place];
    numbers.extend(&recognition.posterior.places);
    for candidate in candidates {
        let Match { place, posterior, log_odds, frame } = candidate.matched;
        let inliers = candidate.view.map_or(-1.0, |view| f64::from(view.inliers));
        numbers.extend([f64::from(place.number()), posterior, log_odds, frame as f64]);
        numbers.extend([inliers, candidate.own_evidence(), candidate.support]);
    }
    let bytes: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
    let matched = matched_text(matched.as_ref());
    format!("query accepted {accepted} matched {matched} numbers {}\n", short_hash(&bytes))
}

/// Compares with the golden file.
pub(crate) fn check(file: &Path, text: &str) {
    let golden = std::fs::read_to_string(file).unwrap();
    for (number, (expected, found)) in (1..).zip(golden.lines().zip(text.lines())) {
        assert_eq!(found, expected, "line {number} of {}", file.display());
    }
    assert_eq!(text.lines().count(), golden.lines().count(), "lines of {}", file.display());
}

fn line(event: &MapEvent) -> String {
    let hash = short_hash(&event.to_bytes());
    match event {
        MapEvent::SessionOpened { session } => format!("session {session} opened, event {hash}"),
        MapEvent::Measured(measured) => {
            let (frame, earlier) = (measured.frame, measured.earlier);
            format!("{} frame {frame} measured from {earlier}, event {hash}", measured.position)
        }
        MapEvent::Corrected(corrected) => format!("{} corrected, event {hash}", corrected.position),
        MapEvent::Frame(frame) => {
            let FrameEvent { session, sequence, decision, learnt, link, at, .. } = frame.as_ref();
            let place = decision.place.map_or("-".to_owned(), |place| place.to_string());
            let link = link.map_or("-".to_owned(), |link| format!("{}-{}", link.from, link.to));
            let evidence: u64 = frame
                .candidates
                .iter()
                .map(|candidate| candidate.evidence().to_bits())
                .fold(0, |all, bits| all.rotate_left(7) ^ bits);
            format!(
                "{} session {session} sequence {sequence} {:?} place {place} posterior {:016x} new {:016x} \
                 closure {} proposal {} candidates {} evidence {evidence:016x} learnt {learnt} link {link} at {} \
                 event {hash}",
                frame.frame,
                decision.reason,
                decision.posterior.to_bits(),
                frame.new_place_posterior.to_bits(),
                matched_text(decision.closure.as_ref()),
                matched_text(frame.proposal.as_ref()),
                frame.candidates.len(),
                at.map_or("-".to_owned(), |at| format!("{:016x}", at.pose().x_m().to_bits())),
            )
        }
    }
}

fn matched_text(matched: Option<&Match>) -> String {
    matched.map_or("-".to_owned(), |matched| format!("{}@{}", matched.place, matched.frame))
}

fn short_hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes)[..8].iter().map(|byte| format!("{byte:02x}")).collect()
}
