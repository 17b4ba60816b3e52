//! Loop closures of RTAB-Map and of the map, held against each other.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde::Serialize;
use waypost_bags::rtabmap::{ClosureKind, RtabMap};
use waypost_client::v1;

/// When two closures are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rule {
    /// Nodes that both ends may be apart, each within its drive.
    pub(super) within: u64,
    /// Frames that the map does not look back.
    pub(super) guard_frames: u64,
}

/// A node by its place in the import: its session's index, and its number there.
type Position = (usize, u64);

/// Two nodes, the later one first.
type Pair = (Position, Position);

/// How RTAB-Map found a closure; none of one of the map.
type Kind = Option<&'static str>;

type Closed = BTreeMap<Pair, Kind>;

type PairAndKind = (Pair, Kind);

/// A closure by the ids of its nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Nodes {
    pub(super) node: i64,
    pub(super) matched_node: i64,
    /// How RTAB-Map found it; null of one of the map.
    pub(super) kind: Kind,
}

/// What `--json` prints of both.
#[derive(Debug, Serialize)]
pub(super) struct Closures {
    /// Both ends may be so many nodes apart.
    pub(super) within_nodes: u64,
    /// RTAB-Map's that the map has too.
    pub(super) theirs_found: Vec<Nodes>,
    /// RTAB-Map's that the map does not have.
    pub(super) theirs_only: Vec<Nodes>,
    /// Of those, how many are of nodes so near in one drive that the map does not look for them.
    pub(super) theirs_only_within_guard: usize,
    /// RTAB-Map's with a node that is no frame; they are not compared.
    pub(super) theirs_without_frames: usize,
    /// The map's that RTAB-Map has too.
    pub(super) ours_found: Vec<Nodes>,
    /// The map's that RTAB-Map does not have.
    pub(super) ours_only: Vec<Nodes>,
}

/// Nodes of a database by what the map calls them, and back.
pub(super) struct Index {
    ids: BTreeMap<Position, i64>,
    positions: HashMap<i64, Position>,
    frames: BTreeSet<Position>,
    sessions: HashMap<String, usize>,
}

impl Index {
    /// `sessions` are names of the map's sessions, each with the index of the database's.
    pub(super) fn new(map: &RtabMap, sessions: impl IntoIterator<Item = (String, usize)>) -> Self {
        let numbered = map.sessions().iter().enumerate().flat_map(|(index, session)| {
            (1..).zip(&session.nodes).map(move |(number, node)| ((index, number), node))
        });
        let nodes: Vec<_> = numbered.collect();
        Self {
            ids: nodes.iter().map(|(position, node)| (*position, node.id)).collect(),
            positions: nodes.iter().map(|(position, node)| (node.id, *position)).collect(),
            frames: nodes
                .iter()
                .filter(|(_, node)| node.image.is_ok())
                .map(|(position, _)| *position)
                .collect(),
            sessions: sessions.into_iter().collect(),
        }
    }

    fn nodes(&self, (later, earlier): Pair, kind: Kind) -> Nodes {
        let id = |position| self.ids.get(&position).copied().unwrap_or_default();
        Nodes { node: id(later), matched_node: id(earlier), kind }
    }

    fn position(&self, frame: Option<&v1::FrameReference>) -> Option<Position> {
        let frame = frame?;
        Some((*self.sessions.get(&frame.session)?, frame.sequence))
    }
}

/// Holds both against each other. Closures of the map with frames of other sessions do not count.
pub(super) fn compare(map: &RtabMap, index: &Index, ours: &[v1::LoopClosure], rule: Rule) -> Closures {
    let ours = ours.iter().filter(|closure| stands(closure)).filter_map(|closure| {
        Some(ordered(
            index.position(closure.frame.as_ref())?,
            index.position(closure.matched_frame.as_ref())?,
        ))
    });
    let ours: Closed = ours.map(|pair| (pair, None)).collect();
    let mut theirs = Closed::new();
    let mut without_frames = 0;
    for closure in map.closures() {
        let ends = [closure.later, closure.earlier].map(|id| index.positions.get(&id).copied());
        match ends {
            [Some(one), Some(other)] if index.frames.contains(&one) && index.frames.contains(&other) => {
                theirs.insert(ordered(one, other), Some(named(closure.kind)));
            }
            [_, _] => without_frames += 1,
        }
    }
    let (theirs_found, theirs_only) = split(&theirs, &ours, rule.within);
    let (ours_found, ours_only) = split(&ours, &theirs, rule.within);
    let is_within_guard = |only: &&PairAndKind| {
        let ((later, earlier), _) = only;
        later.0 == earlier.0 && later.1 - earlier.1 <= rule.guard_frames
    };
    let told = |pairs: Vec<PairAndKind>| -> Vec<Nodes> {
        pairs.into_iter().map(|(pair, kind)| index.nodes(pair, kind)).collect()
    };
    Closures {
        within_nodes: rule.within,
        theirs_only_within_guard: theirs_only.iter().filter(is_within_guard).count(),
        theirs_found: told(theirs_found),
        theirs_only: told(theirs_only),
        theirs_without_frames: without_frames,
        ours_found: told(ours_found),
        ours_only: told(ours_only),
    }
}

/// Those of `these` that are among `those`, and the rest.
fn split(these: &Closed, those: &Closed, within: u64) -> (Vec<PairAndKind>, Vec<PairAndKind>) {
    these.iter().map(|(pair, kind)| (*pair, *kind)).partition(|(pair, _)| has_near(those, *pair, within))
}

fn named(kind: ClosureKind) -> &'static str {
    match kind {
        ClosureKind::Global => "global",
        ClosureKind::Nearby => "nearby",
        ClosureKind::User => "user",
    }
}

/// Whether nobody withdrew it.
fn stands(closure: &v1::LoopClosure) -> bool {
    closure.correction.as_ref().is_none_or(|correction| correction.undone.is_some())
}

fn ordered(one: Position, other: Position) -> Pair {
    (one.max(other), one.min(other))
}

/// Whether there is one whose ends are near those of `pair`.
fn has_near<T>(closures: &BTreeMap<Pair, T>, (later, earlier): Pair, within: u64) -> bool {
    let lowest = ((later.0, later.1.saturating_sub(within)), (0, 0));
    let highest = ((later.0, later.1.saturating_add(within)), (usize::MAX, u64::MAX));
    closures
        .range(lowest..=highest)
        .any(|((_, other), _)| other.0 == earlier.0 && other.1.abs_diff(earlier.1) <= within)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(ours: &[Pair], theirs: Pair, within: u64) -> bool {
        has_near(&ours.iter().map(|pair| (*pair, ())).collect(), theirs, within)
    }

    #[test]
    fn closures_are_the_same_where_both_ends_are_near() {
        let ours = [((0, 100), (0, 10)), ((1, 7), (0, 50))];
        assert!(near(&ours, ((0, 100), (0, 10)), 0));
        assert!(near(&ours, ((0, 103), (0, 7)), 3) && near(&ours, ((0, 97), (0, 13)), 3));
        assert!(!near(&ours, ((0, 104), (0, 10)), 3) && !near(&ours, ((0, 100), (0, 14)), 3));
        // The same numbers in other drives.
        assert!(!near(&ours, ((1, 100), (0, 10)), 3) && !near(&ours, ((1, 7), (1, 5)), 50));
        assert!(near(&ours, ((1, 1), (0, 56)), 6));
        assert!(!near(&[], ((0, 1), (0, 0)), u64::MAX));
    }
}
