//! One step as a call: made of what the model holds by then, and told to the model.

use waypost_client::{Code, v1};

use super::operations::{Operation, Step};
use super::plain::{Asked, NamedFrame, Outcome, Sent, Shown, World, token_name};

/// A step, with the names that its numbers stand for.
pub(super) struct Call<'a> {
    pub(super) operation: &'a Operation,
    pub(super) shown: Shown,
    pub(super) session: String,
    pub(super) frames: Vec<Sent>,
    pub(super) merge: u64,
    /// Frames that somebody says something of.
    pub(super) named: Vec<NamedFrame>,
    pub(super) correction: u64,
    /// The map of a correction.
    pub(super) corrected: String,
    /// The place of a label.
    pub(super) place: u32,
}

/// What is answered.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Answer {
    Done,
    Frames(Vec<Outcome>),
    Told(String),
    Names(Vec<String>),
    /// Places that were dropped.
    Places(Vec<u32>),
    Merge(v1::merge::State),
    Refused(Code),
}

/// What came of a call to the server.
#[derive(Debug)]
pub(super) enum Heard {
    Answer(Answer),
    /// The same, with a token and its new secret.
    Secret(v1::Token, String),
    /// What was said of a loop closure, with its time.
    Said(v1::Correction),
    /// The connection broke when so many steps of it were acknowledged: the opening of a session, and its frames.
    Broken(Vec<Outcome>, usize, String),
}

pub(super) fn map_name(map: u8) -> String {
    format!("m{map}")
}

impl<'a> Call<'a> {
    pub(super) fn of(step: &'a Step, world: &World) -> Self {
        let shown = world.shown(step.by);
        let mut call = Self {
            operation: &step.operation,
            shown,
            session: String::new(),
            frames: vec![],
            merge: 0,
            named: vec![],
            correction: 0,
            corrected: String::new(),
            place: 0,
        };
        match step.operation {
            Operation::Drive { map, session, from, start, frames, noise } => {
                let map = world.maps.get(&map_name(map));
                call.session =
                    map.map_or_else(|| format!("s{}", session % 4), |map| map.session_name(session));
                if let Some(map) = map {
                    call.frames = map.drive(&call.session, from, start, (frames, noise));
                }
            }
            Operation::Localize { start, frames, noise, .. } => {
                call.frames = Sent::looking(start, frames, noise);
            }
            Operation::DeleteSession { map, session } => {
                let map = world.maps.get(&map_name(map));
                call.session = map.map_or_else(|| "s0".to_owned(), |map| map.session_name(session));
            }
            Operation::DeleteLabel { map, place } => {
                let labels = world.maps.get(&map_name(map)).map(|map| &map.labels);
                let places: Vec<u32> = labels.into_iter().flat_map(|labels| labels.keys().copied()).collect();
                let any = (place as usize).checked_rem(places.len()).filter(|_| place % 2 == 0);
                call.place = any.map_or(place, |any| places[any]);
            }
            Operation::UndoMerge { back } => {
                call.merge = world.merge_before(back);
            }
            Operation::Withdraw { map, which } => {
                call.named = world
                    .maps
                    .get(&map_name(map))
                    .map_or_else(|| vec![("s0".to_owned(), 1)], |map| vec![map.named_closure(which)]);
            }
            Operation::Confirm { map, which, earlier } => {
                let nothing = || vec![("s0".to_owned(), 1), ("s0".to_owned(), 1)];
                let map = world.maps.get(&map_name(map));
                call.named =
                    map.map_or_else(nothing, |map| vec![map.named_frame(which), map.named_frame(earlier)]);
            }
            Operation::UndoCorrection { map, which } => {
                let said = |map: &String| world.maps.get(map).map(|map| map.said()).unwrap_or_default();
                let with_some = world.maps.keys().find(|map| !said(map).is_empty()).cloned();
                call.corrected = with_some.filter(|_| which % 4 > 0).unwrap_or_else(|| map_name(map));
                let said = said(&call.corrected);
                let any = (which as usize).checked_rem(said.len());
                call.correction = any.map_or(1_000_000, |any| said[any].0);
            }
            _ => {}
        }
        call
    }

    /// Maps that it may change.
    pub(super) fn changes(&self) -> Vec<String> {
        match self.operation {
            Operation::CreateMap { map, .. }
            | Operation::Drive { map, .. }
            | Operation::Localize { map, .. }
            | Operation::DeleteSession { map, .. }
            | Operation::Trim { map, .. }
            | Operation::Withdraw { map, .. }
            | Operation::Confirm { map, .. }
            | Operation::Compact { map } => vec![map_name(*map)],
            Operation::UndoCorrection { .. } => vec![self.corrected.clone()],
            Operation::Copy { from, to } => vec![map_name(*from), map_name(*to)],
            Operation::Merge { sources, target } => {
                sources.iter().chain([target]).map(|map| map_name(*map)).collect()
            }
            _ => vec![],
        }
    }

    /// Whether it asks for something, and changes nothing.
    pub(super) fn only_asks(&self) -> bool {
        matches!(
            self.operation,
            Operation::Localize { .. } | Operation::Query { .. } | Operation::ListMaps | Operation::WhoAmI
        )
    }

    /// A frame that something is said of.
    pub(super) fn frame(&self, map: u8, which: usize) -> String {
        let (session, sequence) = &self.named[which];
        format!("maps/{}/sessions/{session}/frames/{sequence}", map_name(map))
    }

    /// What the model makes of it.
    pub(super) fn predict(&self, world: &mut World, now_ns: i64, passed: &mut dyn FnMut(&World)) -> Answer {
        self.predicted(world, now_ns, passed).unwrap_or_else(Answer::Refused)
    }

    fn predicted(&self, world: &mut World, now: i64, passed: &mut dyn FnMut(&World)) -> Result<Answer, Code> {
        let shown = &self.shown;
        let done = |()| Answer::Done;
        match self.operation {
            Operation::CreateMap { map, careful } => {
                world.create_map(shown, &map_name(*map), *careful, now).map(done)
            }
            Operation::DeleteMap { map } => world.delete_map(shown, &map_name(*map), now).map(done),
            Operation::Drive { map, .. } => {
                let session = (map_name(*map), &self.session);
                let frames = world.drive(shown, (&session.0, session.1), &self.frames, now, passed)?;
                Ok(Answer::Frames(frames))
            }
            Operation::Localize { map, .. } => {
                Ok(Answer::Frames(world.localize(shown, &map_name(*map), &self.frames, now)?))
            }
            Operation::Query { map, place, noise } => {
                Ok(Answer::Told(world.query(shown, &map_name(*map), (*place, *noise), now)?))
            }
            Operation::SetLabel { map, place, label } => {
                world.set_label(shown, (&map_name(*map), *place), &label_text(*label), now).map(done)
            }
            Operation::DeleteLabel { map, .. } => {
                world.delete_label(shown, (&map_name(*map), self.place), now).map(done)
            }
            Operation::DeleteSession { map, .. } => {
                world.delete_session(shown, (&map_name(*map), &self.session), now).map(done)
            }
            Operation::Trim { map, places } => {
                Ok(Answer::Places(world.trim(shown, &map_name(*map), *places, now)?))
            }
            Operation::Compact { map } => world.compact(shown, &map_name(*map), now).map(done),
            Operation::Copy { from, to } => {
                let (from, to) = (map_name(*from), map_name(*to));
                world.export(shown, &from, now)?;
                world.import(shown, (&from, &to), now).map(done)
            }
            Operation::Merge { sources, target } => {
                let sources: Vec<String> = sources.iter().map(|map| map_name(*map)).collect();
                world.merge(shown, &sources, &map_name(*target), now, passed)?;
                Ok(Answer::Merge(world.merges.last().expect("it was asked for").state))
            }
            Operation::UndoMerge { .. } => world.undo_merge(shown, self.merge, now).map(done),
            Operation::Withdraw { map, .. } => {
                world.withdraw(shown, (&map_name(*map), &self.named[0]), now).map(done)
            }
            Operation::Confirm { map, .. } => {
                let pair = (&self.named[0], &self.named[1]);
                world.confirm(shown, &map_name(*map), pair, now).map(done)
            }
            Operation::UndoCorrection { .. } => {
                world.undo_correction(shown, (&self.corrected, self.correction), now).map(done)
            }
            Operation::CreateToken { token, role, reach, lifetime_s, limited } => {
                let asked = Asked::of(*role, *reach, *limited);
                world.create_token(shown, &token_name(*token), &asked, *lifetime_s, now).map(done)
            }
            Operation::DeleteToken { token } => world.delete_token(shown, &token_name(*token), now).map(done),
            Operation::RotateToken { token, overlap_s } => {
                world.rotate_token(shown, &token_name(*token), *overlap_s, now).map(done)
            }
            Operation::ListMaps => Ok(Answer::Names(world.list_maps(shown, now)?)),
            Operation::WhoAmI => Ok(Answer::Told(world.caller(shown, now)?)),
            Operation::Together { .. } | Operation::Restart { .. } => Ok(Answer::Done),
        }
    }
}

/// A label.
pub(super) fn label_text(label: u8) -> String {
    format!("room {label}")
}
