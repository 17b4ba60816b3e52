//! The order of places along the sides of a matrix, and what the map has joined of them.

use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use topomap::ids::{FrameId, SessionId};

use super::cells::TILE_CELLS;
use crate::names::session_name;
use crate::open_map::PlaceGraph;
use crate::storage::SessionRow;

/// Places by session, and within it by time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    places: Vec<PlaceId>,
    /// Each session's first position; none for places without a frame, which come last.
    sessions: Vec<(Option<SessionId>, usize)>,
}

/// An axis as users name what is on it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct AxisView {
    pub(crate) places: Vec<PlaceId>,
    pub(crate) sessions: Vec<SessionView>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SessionView {
    /// `maps/{map}/sessions/{session}`; empty if there is none.
    pub(crate) session: String,
    pub(crate) first: usize,
    pub(crate) places: usize,
}

/// Two places that the map has joined, by their positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MarkView {
    pub(crate) row: usize,
    pub(crate) column: usize,
    pub(crate) kind: Mark,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Mark {
    Link,
    LoopClosure,
}

impl Axis {
    /// Of the first frame that each place learnt from.
    pub(super) fn of(firsts: &[Option<(SessionId, FrameId)>]) -> Self {
        let mut order: Vec<_> = PlaceId::all().zip(firsts).collect();
        order.sort_by_key(|&(place, first)| (first.is_none(), *first, place));
        let mut sessions = Vec::new();
        for (position, (_, first)) in order.iter().enumerate() {
            let session = first.map(|(session, _)| session);
            if sessions.last().is_none_or(|&(last, _)| last != session) {
                sessions.push((session, position));
            }
        }
        Self { places: order.into_iter().map(|(place, _)| place).collect(), sessions }
    }

    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    /// The places of a tile; none beyond the last.
    pub(super) fn tile(&self, level: u32, tile: u32) -> Option<&[PlaceId]> {
        self.places.chunks(TILE_CELLS << level).nth(tile as usize)
    }

    pub(super) fn view(self, map: &str, named: &[SessionRow]) -> AxisView {
        let name = |session: Option<SessionId>| {
            let row = named.iter().find(|row| Some(row.number) == session);
            row.map_or_else(String::new, |row| session_name(map, &row.name))
        };
        let ends = self.sessions.iter().skip(1).map(|&(_, first)| first).chain([self.places.len()]);
        let view = |(&(session, first), end): (&(Option<SessionId>, usize), usize)| SessionView {
            session: name(session),
            first,
            places: end - first,
        };
        AxisView { sessions: self.sessions.iter().zip(ends).map(view).collect(), places: self.places }
    }
}

/// What is joined: closures from where their robot came from, and links but for those between neighbours on the axis.
pub(super) fn marks(
    axis: &Axis,
    graph: PlaceGraph,
    closures: &[(SessionId, FrameId, PlaceId)],
) -> Vec<MarkView> {
    let mut position = vec![0; axis.len()];
    for (at, place) in axis.places.iter().enumerate() {
        position[place.index()] = at;
    }
    let between = |one: PlaceId, other: PlaceId| {
        let (one, other) = (position.get(one.index())?, position.get(other.index())?);
        Some((*one.min(other), *one.max(other)))
    };
    let PlaceGraph { mut looks, links } = graph;
    looks.sort_unstable();
    let mut marks = BTreeMap::new();
    for (from, to) in links {
        if let Some((row, column)) = between(from, to)
            && column - row > 1
        {
            marks.insert((row, column), Mark::Link);
        }
    }
    for &(session, frame, place) in closures {
        let before = looks.partition_point(|&(of, look, _)| (of, look) < (session, frame)).checked_sub(1);
        let came_from = before.map(|at| looks[at]).filter(|&(of, ..)| of == session);
        let Some((_, _, from)) = came_from else { continue };
        if let Some((row, column)) = between(from, place)
            && row != column
        {
            marks.insert((row, column), Mark::LoopClosure);
        }
    }
    marks.into_iter().map(|((row, column), kind)| MarkView { row, column, kind }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(number: u32) -> PlaceId {
        PlaceId::new(number)
    }

    /// Two robots drive at once; place 4 has no frame any more.
    fn axis() -> Axis {
        Axis::of(&[Some((0, 1)), Some((1, 2)), Some((0, 5)), Some((1, 7)), None, Some((0, 9))])
    }

    #[test]
    fn places_are_by_session_and_time() {
        let order: Vec<u32> = axis().places.iter().map(|place| place.number()).collect();
        assert_eq!(order, [0, 2, 5, 1, 3, 4]);
        let row = |number, name: &str| SessionRow { number, name: name.to_owned(), owner: None };
        let view = axis().view("hall", &[row(0, "monday"), row(1, "tuesday")]);
        let sessions: Vec<_> =
            view.sessions.iter().map(|of| (of.session.as_str(), of.first, of.places)).collect();
        let expected =
            [("maps/hall/sessions/monday", 0, 3), ("maps/hall/sessions/tuesday", 3, 2), ("", 5, 1)];
        assert_eq!(sessions, expected);
        assert_eq!(axis().tile(0, 0).map(<[PlaceId]>::len), Some(6));
        assert_eq!((axis().tile(0, 1), Axis::of(&[]).tile(0, 0)), (None, None));
    }

    #[test]
    fn closures_are_marked_where_the_robot_came_from() {
        let looks = vec![
            (0, 1, place(0)),
            (0, 5, place(2)),
            (0, 9, place(5)),
            (1, 2, place(1)),
            (1, 7, place(3)),
            (1, 8, place(0)),
        ];
        let links = vec![(place(0), place(2)), (place(5), place(0)), (place(3), place(0))];
        let marked = marks(&axis(), PlaceGraph { looks, links }, &[(1, 8, place(0)), (1, 1, place(5))]);
        let mark = |row, column, kind| MarkView { row, column, kind };
        assert_eq!(marked, [mark(0, 2, Mark::Link), mark(0, 4, Mark::LoopClosure)]);
    }
}
