//! What the links of a map measured, and how wheels lead past the closures of their session.
//!
//! After a closure a session goes on from the place that it recognised. If the closure is wrong, all
//! that is driven from there hangs at the wrong place, and what comes later could not mend it: wheels
//! are trusted. So of the first way after a closure it is known as well how it leads on from the place
//! that was made before: there and back, the closure cancels out. Where closures contradict each other
//! they are judged by these, and where one is wrong they are what was driven.

use std::collections::{BTreeMap, HashMap};

use fabmap::appearance::PlaceId;
use posegraph::EdgeKind;

use crate::ids::SessionId;
use crate::log::{Link, LinkKind};
use crate::metric::RelativePose;
use crate::metric::wheel_drift::Way;

/// The links that measured something, as they did.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Ways {
    /// The session that made each place.
    makers: Vec<SessionId>,
    /// Of each place, the one that its session made before it.
    made_before: Vec<Option<usize>>,
    last_made: BTreeMap<SessionId, usize>,
    /// By wheels; past a closure where that is wrong.
    driven: Vec<(Way, SessionId)>,
    /// Of each place, which of them leads there.
    reached_by: Vec<Option<usize>>,
    closed: Vec<Way>,
    /// Of each place, the last closure that was driven to from there.
    closed_from: HashMap<usize, usize>,
    /// Of each edge, which of the two lists it is in, and where.
    of_edges: Vec<(EdgeKind, usize)>,
    /// By edge, those that could lead past a closure.
    past: BTreeMap<usize, Past>,
    /// Edges of closures.
    closed_edges: Vec<usize>,
}

/// A way that was driven after a closure.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Past {
    /// As it was told: from the place that was recognised.
    told: Way,
    /// From the place that was made before.
    past: Way,
    /// Which of the closed ways it was driven after.
    closure: usize,
    /// Its place among the driven ways.
    driven: usize,
}

/// Known places that are followed from where a session recognised one to where it left, at most:
/// their links say how it drove between. Who is right for longer is not wrong.
const MOST_FOLLOWED: usize = 4;

impl Ways {
    pub(super) fn add_place(&mut self, session: SessionId) {
        self.made_before.push(self.last_made.insert(session, self.makers.len()));
        self.makers.push(session);
        self.reached_by.push(None);
    }

    /// The sessions that made the places, in the order of places.
    pub(super) fn makers(&self) -> &[SessionId] {
        &self.makers
    }

    /// What wheels measured, with the session that drove.
    pub(super) fn driven(&self) -> &[(Way, SessionId)] {
        &self.driven
    }

    /// What wheels measured from place to place on the way of a session from one that it made to the
    /// last that it made, if it came to new places alone in between, over `longest_m` at most.
    pub(crate) fn on_new_ground(
        &self,
        session: SessionId,
        from: PlaceId,
        last: PlaceId,
        longest_m: f64,
    ) -> Option<Vec<RelativePose>> {
        let (from, last) = (from.index(), last.index());
        if self.last_made.get(&session) != Some(&last) {
            return None;
        }
        let mut steps = Vec::new();
        let mut place = last;
        let mut length_m = 0.0;
        while place > from {
            let (step, _) = &self.driven[self.reached_by[place]?];
            let before = self.made_before[place].filter(|&before| before == step.from)?;
            length_m += step.measured.pose().x_m().hypot(step.measured.pose().y_m());
            if length_m > longest_m {
                return None;
            }
            steps.push(step.measured);
            place = before;
        }
        steps.reverse();
        (place == from).then_some(steps)
    }

    /// What closures measured.
    pub(super) fn closed(&self) -> &[Way] {
        &self.closed
    }

    /// All ways in the order of edges.
    pub(super) fn of_edges(&self) -> impl Iterator<Item = (&Way, EdgeKind)> {
        self.of_edges.iter().map(|&(kind, index)| match kind {
            EdgeKind::Odometry => (&self.driven[index].0, kind),
            EdgeKind::Closure => (&self.closed[index], kind),
        })
    }

    /// The links as they were told.
    pub(super) fn links(&self) -> impl Iterator<Item = Link> + '_ {
        self.of_edges().enumerate().map(|(edge, (way, kind))| {
            let Way { from, to, measured } = *self.past.get(&edge).map_or(way, |after| &after.told);
            let kind = match kind {
                EdgeKind::Odometry => LinkKind::Driven(measured),
                EdgeKind::Closure => LinkKind::Closed(measured),
            };
            Link { from: PlaceId::from_index(from), to: PlaceId::from_index(to), kind }
        })
    }

    /// The next edge's way.
    pub(super) fn push(&mut self, way: Way, kind: EdgeKind) {
        let edge = self.of_edges.len();
        let index = match kind {
            EdgeKind::Odometry => {
                let driven = self.driven.len();
                if let Some((closure, past)) = self.past_closure(&way) {
                    self.past.insert(edge, Past { told: way, past, closure, driven });
                }
                if way.from < way.to {
                    self.reached_by[way.to] = Some(driven);
                }
                self.driven.push((way, self.makers[way.to]));
                driven
            }
            EdgeKind::Closure => {
                self.closed_from.insert(way.from, self.closed.len());
                self.closed_edges.push(edge);
                self.closed.push(way);
                self.closed.len() - 1
            }
        };
        self.of_edges.push((kind, index));
    }

    /// Has ways lead past the closures that are wrong, and from the places that the others recognised.
    /// Returns whether that is another than before.
    pub(super) fn lead_past(&mut self, is_wrong: impl Fn(usize) -> bool) -> bool {
        let mut changed = false;
        for after in self.past.values() {
            let way = if is_wrong(self.closed_edges[after.closure]) { after.past } else { after.told };
            let driven = &mut self.driven[after.driven].0;
            changed |= *driven != way;
            *driven = way;
        }
        changed
    }

    /// Of the ways that lead past a closure, the edges and their ends.
    pub(super) fn led_past(&self) -> impl Iterator<Item = (usize, (PlaceId, PlaceId))> {
        let past = self.past.iter().filter(|(_, after)| self.driven[after.driven].0 == after.past);
        past.map(|(&edge, after)| {
            (edge, (PlaceId::from_index(after.past.from), PlaceId::from_index(after.past.to)))
        })
    }

    /// The same way past the closure that it was driven after, and that closure, if there is one.
    fn past_closure(&self, told: &Way) -> Option<(usize, Way)> {
        let from = self.made_before[told.to].filter(|&before| before != told.from)?;
        let &closure = self.closed_from.get(&from)?;
        let closed = &self.closed[closure];
        let followed = self.followed(closed.to, told.from)?;
        let measured = closed.measured.then(&followed).then(&told.measured);
        Some((closure, Way { from, to: told.to, measured }))
    }

    /// From one place to another near it along what wheels measured: up from both ends to where they
    /// meet, since places come after those that they were reached from.
    fn followed(&self, from: usize, to: usize) -> Option<RelativePose> {
        let mut ends = [(from, RelativePose::none()), (to, RelativePose::none())];
        for _ in 0..=MOST_FOLLOWED {
            let [(one, of_from), (other, of_to)] = &mut ends;
            if one == other {
                return Some(of_from.back().then(of_to));
            }
            let (place, pose) = if one > other { (one, of_from) } else { (other, of_to) };
            let (step, _) = &self.driven[self.reached_by[*place]?];
            *pose = step.measured.then(pose);
            *place = step.from;
        }
        None
    }
}
