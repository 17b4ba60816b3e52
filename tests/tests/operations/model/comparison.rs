//! All that a server tells, one line for each thing, and the same of the model: what is not alike is named.

use std::collections::BTreeMap;

use fabmap::PlaceId;
use topomap::log::{FrameEvent, MapEvent, Reason};
use waypost_client::{Client, Error, v1};

use super::now_ns;
use super::plain::{PlainMap, World, of_answer, of_event, token_line};

/// Things by their names.
pub(super) type Lines = BTreeMap<String, String>;

/// Lines that a failure shows.
const SHOWN: usize = 8;

/// What the model has.
pub(super) fn expected(world: &World) -> Lines {
    let mut lines = Lines::new();
    for (name, map) in &world.maps {
        expected_map(&mut lines, name, map);
    }
    for (token, known) in &world.tokens {
        let name = format!("tokens/{token}");
        let limits = (known.expires_ns.is_some(), known.former.is_some());
        let used = world.used_by(token);
        lines.insert(
            name.clone(),
            has_line(&known.line(&name), limits, used, (known.max_maps, known.max_sessions)),
        );
    }
    for (number, merge) in (1..).zip(&world.merges) {
        lines.insert(format!("merges/{number}"), format!("{:?} into maps/{}", merge.state, merge.target));
    }
    lines
}

/// What is told of a map as a whole.
pub(super) fn map_line(map: &PlainMap) -> String {
    let frames = map.frames().count();
    let links = map.mapper.map().standing_links().count();
    let is_closure = |frame: &&FrameEvent| frame.decision.reason == Reason::LoopClosure;
    let closures = map.frames().filter(is_closure).count();
    let places = map.mapper.map().places().len();
    let counts = counts(frames as u64, map.sessions.len() as u64, places as u64, links as u64);
    format!("{} {counts}, {closures} closures", map.mapper.state_hash())
}

/// The same as the server tells it.
pub(super) fn told_map_line(map: &v1::Map) -> String {
    let counts = counts(map.frames, map.sessions, map.places, map.links);
    format!("{} {counts}, {} closures", map.state_hash(), map.loop_closures)
}

fn counts(frames: u64, sessions: u64, places: u64, links: u64) -> String {
    format!("{frames} frames, {sessions} sessions, {places} places, {links} links")
}

fn expected_map(lines: &mut Lines, map: &str, known: &PlainMap) {
    lines.insert(format!("maps/{map}"), map_line(known));
    for (place, label) in &known.labels {
        lines.insert(format!("maps/{map}/places/{place} label"), label.clone());
    }
    for (position, verdict, undone) in known.said() {
        lines.insert(format!("maps/{map}/corrections/{position}"), format!("{verdict}, undone {undone}"));
    }
    let session_name = |number: u32| format!("maps/{map}/sessions/{}", known.sessions[number as usize].name);
    for (number, session) in (0..).zip(&known.sessions) {
        let owner = session.owner.as_ref().map_or_else(String::new, |owner| format!("tokens/{owner}"));
        let mut sequences = known.frames_of(number).map(|frame| frame.sequence);
        let frames = known.frames_of(number).count() as u64;
        let (first, last) = (sequences.next(), sequences.last());
        lines.insert(session_name(number), session_line(&owner, frames, first, last.or(first)));
    }
    for frame in known.frames() {
        let name = format!("{}/frames/{}", session_name(frame.session), frame.sequence);
        let note = known.notes.get(&frame.frame).map_or("", String::as_str);
        let told = of_event(map, known, frame);
        lines.insert(name, frame_line(&told, frame.stamp_ns, frame.learnt, frame.odometry.is_some(), note));
    }
    let mapper = &known.mapper;
    for (number, place) in (0..).zip(mapper.map().places()) {
        let place_id = PlaceId::new(number);
        let looks = mapper.recognizer().index().appearance(place_id).map_or(0, |place| place.looks());
        let linked: Vec<u32> = mapper.map().linked(place_id).iter().map(|place| place.number()).collect();
        let frames = place.frames.iter().map(|frame| match &known.log[frame.frame as usize] {
            MapEvent::Frame(event) => format!("{}/{}", session_name(event.session), event.sequence),
            other => format!("{other:?}"),
        });
        let frames: Vec<String> = frames.collect();
        lines.insert(format!("maps/{map}/places/{number}"), place_line(looks.into(), &linked, &frames));
    }
}

fn session_line(owner: &str, frames: u64, first: Option<u64>, last: Option<u64>) -> String {
    format!("of {owner:?}, {frames} frames from {first:?} to {last:?}")
}

fn frame_line(told: &str, stamp_ns: i64, learnt: bool, wheels: bool, note: &str) -> String {
    format!("{told} at {stamp_ns}, learnt {learnt}, wheels {wheels}, note {note:?}")
}

fn place_line(looks: u32, linked: &[u32], frames: &[String]) -> String {
    format!("{looks} looks, linked with {linked:?}, of {frames:?}")
}

/// A token with what it has.
fn has_line(
    line: &str,
    (expires, overlaps): (bool, bool),
    (maps, sessions): (u64, u64),
    (most_maps, most_sessions): (Option<u32>, Option<u32>),
) -> String {
    let limits = format!("expires {expires}, former secret {overlaps}");
    format!("{line} {limits}, {maps} maps of {most_maps:?}, {sessions} sessions of {most_sessions:?}")
}

/// What the server tells.
pub(super) async fn observed(client: &Client) -> Result<Lines, Error> {
    let mut lines = Lines::new();
    let mut kept = BTreeMap::new();
    for map in client.maps().await? {
        observed_map(client, &mut lines, &mut kept, &map.name).await?;
    }
    for token in client.tokens().await? {
        let abilities: Vec<_> = token.abilities().collect();
        let line = token_line(&token.name, token.role(), &abilities, &token.maps);
        // A secret that was replaced at once has an end, too.
        let overlaps = token.overlap_end_time_ns.is_some_and(|at| at > now_ns());
        let used = token.used.unwrap_or_default();
        let quotas = token.quotas.unwrap_or_default();
        let limits = (token.expire_time_ns.is_some(), overlaps);
        let most = (quotas.max_maps, quotas.max_sessions);
        let has = has_line(&line, limits, (used.maps, used.sessions), most);
        let keeps = kept.remove(&token.name).unwrap_or_default();
        if keeps != used.kept_bytes {
            let counted = format!("{} bytes counted, {keeps} kept by its sessions", used.kept_bytes);
            lines.insert(format!("{} keeps", token.name), counted);
        }
        lines.insert(token.name, has);
    }
    for merge in client.merges().await? {
        let line = format!("{:?} into {}", merge.state(), merge.target);
        lines.insert(merge.name, line);
    }
    Ok(lines)
}

async fn observed_map(
    client: &Client,
    lines: &mut Lines,
    kept: &mut BTreeMap<String, u64>,
    name: &str,
) -> Result<(), Error> {
    let map = client.map(name, v1::MapView::Full).await?;
    lines.insert(name.to_owned(), told_map_line(&map));
    for label in client.labels(name).await? {
        lines.insert(format!("{} label", label.place), label.label);
    }
    for said in client.corrections(name).await? {
        let line = format!("{:?}, undone {}", said.verdict(), said.undone.is_some());
        lines.insert(said.name, line);
    }
    for session in client.sessions(name).await? {
        let v1::Session { name, owner, frames, first_sequence, last_sequence, kept_bytes, .. } = session;
        *kept.entry(owner.clone()).or_default() += kept_bytes;
        lines.insert(name.clone(), session_line(&owner, frames, first_sequence, last_sequence));
        for frame in client.frames(&name).await? {
            let told = frame.answer.as_ref().map(of_answer).unwrap_or_default();
            let wheels = frame.odometry.is_some();
            lines.insert(frame.name, frame_line(&told, frame.stamp_ns, frame.learnt, wheels, &frame.note));
        }
    }
    for place in client.places(name).await? {
        let frames = place.frames.iter().map(|frame| format!("{}/{}", frame.session, frame.sequence));
        let frames: Vec<String> = frames.collect();
        lines.insert(place.name, place_line(place.looks, &place.linked_place_numbers, &frames));
    }
    Ok(())
}

/// What is not alike; empty if all is.
pub(super) fn differences(told: &Lines, expected: &Lines) -> String {
    let mut names: Vec<&String> = told.keys().chain(expected.keys()).collect();
    names.sort();
    names.dedup();
    let differ: Vec<String> = names
        .into_iter()
        .filter(|name| told.get(*name) != expected.get(*name))
        .map(|name| {
            let of = |lines: &Lines| lines.get(name).map_or("nothing", String::as_str).to_owned();
            format!("{name}: the server tells {:.600}; it should be {:.600}", of(told), of(expected))
        })
        .collect();
    let more = differ.len().saturating_sub(SHOWN);
    let shown = differ.iter().take(SHOWN).cloned().collect::<Vec<_>>().join("\n  ");
    if more > 0 { format!("{shown}\n  and {more} more") } else { shown }
}
