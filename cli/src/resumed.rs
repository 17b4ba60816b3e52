//! Whether a session that goes on was begun with the recording that is streamed into it.

use std::collections::BTreeMap;
use std::io::Cursor;

use waypost_client::{Client, v1};

use crate::drive::Shot;
use crate::failure::Failure;
use crate::replay::{Recording, Replay};
use crate::shrinking::upright_size_px;

/// Frames that are in the recording and not in the session, of which the images are looked at.
const MOST_ABSENT: usize = 8;
/// Below this speed, and a step of so much, no map refuses odometry for having jumped.
const SLOW_M_PER_S: f64 = 1.0;
const SLACK_M: f64 = 0.5;

/// Refuses to go on in a session of another recording. All frames that the session has are frames here, with the same stamps and
/// notes. Those that it lacks were refused: the server takes no image like them, or has a reason in their odometry. The last
/// frame shows what it shows here, unless `content` says that it cannot be compared.
///
/// # Errors
/// [`Failure::Unfit`] with the first frame that differs.
pub(crate) async fn check_begun_with(
    client: &Client,
    (map, session): (&str, &str),
    replay: &Replay,
    committed: u64,
    content: Compared,
) -> Result<(), Failure> {
    let recording = &replay.recording;
    let words_hash = replay.contents.words_hash();
    let kind = match recording {
        Recording::Folder { images: _, moments: _ } => return Ok(()),
        Recording::Bag(_) => "bag",
        Recording::Database(_) => "database",
    };
    let other = |told: &str| {
        Failure::Unfit(format!(
            "{session} was begun with another {kind}: {told}; give the {kind} that it was begun with, or another --session"
        ))
    };
    let records: BTreeMap<u64, v1::FrameRecord> = client
        .frames(session)
        .await?
        .into_iter()
        .filter_map(|record| Some((sequence_of(&record)?, record)))
        .collect();
    for (&sequence, record) in &records {
        let there = told(&record.note, record.stamp_ns);
        let Some((stamp_ns, note)) = recording.named(sequence) else {
            return Err(other(&format!("its frame {sequence} is {there}, and here is none of that number")));
        };
        if (stamp_ns, note.as_str()) != (record.stamp_ns, record.note.as_str()) {
            let here = told(&note, stamp_ns);
            return Err(other(&format!("its frame {sequence} is {there}, and here it is {here}")));
        }
    }
    let absent = (1..=committed)
        .filter(|sequence| !records.contains_key(sequence) && recording.named(*sequence).is_some());
    let mut wanted: Vec<u64> = absent.take(MOST_ABSENT).collect();
    if content == Compared::Images {
        wanted.extend(records.last_key_value().map(|(sequence, _)| *sequence));
    }
    for shot in recording.shots(&wanted).await {
        let Shot { sequence, stamp_ns, image, odometry, note } = shot;
        let is_of_size =
            upright_size_px(Cursor::new(&image)).is_ok_and(|size_px| recording.size_px() == Some(size_px));
        let content = replay.contents.content(image).await;
        let Ok(seen) = client.query(map, content, &words_hash, None).await else { continue };
        match records.get(&sequence) {
            Some(record) => {
                if record.answer.as_ref().is_some_and(|answer| answer.words != seen.words) {
                    return Err(other(&format!("its frame {sequence} shows something else")));
                }
            }
            None => {
                let before = records.range(..sequence).next_back().map(|(_, record)| record);
                if is_of_size && is_gentle(before, stamp_ns, odometry.as_ref()) {
                    let here = told(&note, stamp_ns);
                    return Err(other(&format!("it has no frame {sequence}, which is {here} here")));
                }
            }
        }
    }
    Ok(())
}

/// Whether images can be compared by what they show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    /// By how many words they give.
    Images,
    /// By stamps and notes alone: the session's camera changes how images are looked at.
    Stamps,
}

impl Compared {
    pub(crate) fn of(camera: Option<&v1::Camera>) -> Self {
        use v1::camera::Model;
        match camera.and_then(|camera| camera.model.as_ref()) {
            None | Some(Model::Pinhole(_) | Model::FieldOfView(_) | Model::Fisheye(_)) => Compared::Images,
            Some(Model::Panorama(_) | Model::HyperbolicMirror(_)) => Compared::Stamps,
        }
    }
}

fn sequence_of(record: &v1::FrameRecord) -> Option<u64> {
    record.name.rsplit('/').next()?.parse().ok()
}

fn told(note: &str, stamp_ns: i64) -> String {
    if note.is_empty() { format!("of {stamp_ns} ns") } else { format!("{note} at {stamp_ns} ns") }
}

/// Whether no map refuses a frame for its odometry, after one that it has.
fn is_gentle(before: Option<&v1::FrameRecord>, stamp_ns: i64, odometry: Option<&v1::Odometry>) -> bool {
    let position = |odometry: &v1::Odometry| odometry.pose.as_ref()?.position_m;
    let Some(here) = odometry.and_then(position) else { return true };
    let Some(before) = before else { return true };
    let Some(there) = before.odometry.as_ref().and_then(position) else { return true };
    let distance_m = (here.x - there.x).hypot(here.y - there.y).hypot(here.z - there.z);
    let elapsed_s = stamp_ns.saturating_sub(before.stamp_ns) as f64 / 1e9;
    // One that stands still may be refused, too.
    distance_m > 1e-6 && distance_m < SLACK_M + SLOW_M_PER_S * elapsed_s
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x: f64) -> v1::Odometry {
        let pose = v1::Pose { position_m: Some(v1::Vector3 { x, y: 0.0, z: 0.0 }), orientation: None };
        v1::Odometry { pose: Some(pose), covariance: Vec::new() }
    }

    #[test]
    fn odometry_that_stands_or_jumps_may_have_been_refused() {
        let before = v1::FrameRecord { odometry: Some(at(1.0)), ..v1::FrameRecord::default() };
        let is_gentle = |x| is_gentle(Some(&before), 1_000_000_000, Some(&at(x)));
        assert!(is_gentle(1.3) && is_gentle(0.2));
        assert!(!is_gentle(1.0) && !is_gentle(4.0));
    }
}
