//! What an answer says, with the bits of every number: of an event of the model, and as the server tells it.

use topomap::evidence::Match;
use topomap::log::{FrameEvent, Reason};
use topomap::mapper::Queried;
use waypost_client::v1;

use super::map::PlainMap;

/// What is told of a frame, in one line.
pub(in super::super) type Told = String;

/// Places that an answer names.
const ANSWERED_PLACES: usize = 10;

/// What the model has decided of a frame of the map of that name, or of one of a robot that only looks at it.
pub(in super::super) fn of_event(map: &str, known: &PlainMap, event: &FrameEvent) -> Told {
    let decision = &event.decision;
    let reason = match decision.reason {
        Reason::NewPlace => v1::Reason::NewPlace,
        Reason::SamePlace => v1::Reason::SamePlace,
        Reason::LoopClosure => v1::Reason::LoopClosure,
        Reason::BelowThreshold => v1::Reason::BelowThreshold,
        Reason::TooFewWords => v1::Reason::TooFewWords,
        Reason::GeometryRefused => v1::Reason::GeometryRefused,
    };
    let created = match decision.reason {
        Reason::NewPlace | Reason::BelowThreshold | Reason::GeometryRefused => decision.place,
        Reason::SamePlace | Reason::LoopClosure | Reason::TooFewWords => None,
    };
    let mut places: Vec<(u32, f64)> = event
        .belief
        .places
        .iter()
        .filter(|(place, _)| Some(*place) != created)
        .map(|&(place, probability)| (place.number(), probability))
        .collect();
    places.sort_by(|a, b| b.1.total_cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
    places.truncate(ANSWERED_PLACES);
    line(
        event.sequence,
        &format!("{reason:?} {:?}", decision.place.map(fabmap::PlaceId::number)),
        (decision.posterior, event.new_place_posterior),
        &places,
        &[decision.closure, event.proposal].map(|found| found.map(|found| of_match(map, known, found))),
        event.observation.len() as u64,
    )
}

fn of_match(map: &str, known: &PlainMap, found: Match) -> String {
    let Match { place, posterior, log_odds, frame } = found;
    let matched = known.frames().find(|event| event.frame == frame).expect("matches are frames");
    let session = &known.sessions[matched.session as usize].name;
    match_line(
        place.number(),
        (posterior, log_odds),
        &format!("maps/{map}/sessions/{session}"),
        (matched.sequence, matched.stamp_ns),
        known.notes.get(&frame).map_or("", String::as_str),
    )
}

/// What the server answered.
pub(in super::super) fn of_answer(answer: &v1::FrameAnswer) -> Told {
    let places: Vec<(u32, f64)> =
        answer.places.iter().map(|place| (place.place_number, place.posterior)).collect();
    let matches = [&answer.r#match, &answer.best_candidate].map(|found| found.as_ref().map(answered_match));
    line(
        answer.sequence,
        &format!("{:?} {:?}", answer.reason(), answer.place_number),
        (answer.posterior, answer.new_place_posterior),
        &places,
        &matches,
        answer.words.into(),
    )
}

fn answered_match(found: &v1::Match) -> String {
    let v1::Match { place_number, posterior, frame, log_odds, geometry } = found;
    let frame = frame.as_ref().expect("a match is a frame");
    let of = (frame.sequence, frame.stamp_ns);
    let line = match_line(*place_number, (*posterior, *log_odds), &frame.session, of, &frame.note);
    if geometry.is_some() { format!("{line} by geometry") } else { line }
}

/// What the model finds for a view.
pub(in super::super) fn of_query(map: &str, known: &PlainMap, queried: &Queried, words: u64) -> Told {
    let posterior = &queried.recognition.posterior;
    let places: Vec<(u32, f64)> =
        posterior.top(ANSWERED_PLACES).into_iter().map(|(place, p)| (place.number(), p)).collect();
    let found = queried.matched.map(|found| of_match(map, known, found));
    line(0, &format!("{}", queried.accepted), (0.0, posterior.new_place), &places, &[found, None], words)
}

/// What the server found for one.
pub(in super::super) fn of_response(response: &v1::QueryResponse) -> Told {
    let places: Vec<(u32, f64)> =
        response.places.iter().map(|place| (place.place_number, place.posterior)).collect();
    let found = response.r#match.as_ref().map(answered_match);
    let posteriors = (0.0, response.new_place_posterior);
    line(0, &format!("{}", response.accepted), posteriors, &places, &[found, None], response.words.into())
}

fn line(
    sequence: u64,
    decision: &str,
    (posterior, new_place): (f64, f64),
    places: &[(u32, f64)],
    matches: &[Option<String>; 2],
    words: u64,
) -> Told {
    let bits = |number: f64| format!("{:016x}", number.to_bits());
    let places: Vec<String> =
        places.iter().map(|&(place, posterior)| format!("{place}:{}", bits(posterior))).collect();
    format!(
        "{sequence} {decision} {} {} [{}] {matches:?} {words} words",
        bits(posterior),
        bits(new_place),
        places.join(" ")
    )
}

fn match_line(
    place: u32,
    (posterior, log_odds): (f64, f64),
    session: &str,
    (sequence, stamp_ns): (u64, i64),
    note: &str,
) -> String {
    let (posterior, log_odds) = (posterior.to_bits(), log_odds.to_bits());
    format!("{place}:{posterior:016x}/{log_odds:016x} {session} {sequence} {stamp_ns} {note}")
}
