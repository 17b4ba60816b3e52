//! Where places are: the links that measured something as a pose graph, relaxed when a loop closes.

use std::collections::{BTreeMap, HashMap};

use fabmap::appearance::PlaceId;

use super::ways::Ways;
use crate::ids::SessionId;
use crate::log::{Link, LinkKind};
use crate::metric::OdometryNoise;
use crate::metric::wheel_drift::{Way, drifts, without_drift};
use posegraph::{Edge, EdgeKind, PlanarGraph, PlanarPose, Pose, RelaxationSettings, Relaxed, Start, relax};

/// Poses of places, seen from above, in metres and radians.
///
/// They are derived from the links and never logged. Places that links with measurements join are a
/// part, and each part has a frame of its own: that of its lowest place, where it was when it was
/// first seen. What wheels of a session drift by is learnt from the loops that it closed, and taken
/// off its ways.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacePoses {
    graph: PlanarGraph,
    relaxed: Relaxed<PlanarPose>,
    poses: Vec<PlanarPose>,
    /// The lowest place of each place's part.
    parts: Vec<PlaceId>,
    /// The places of each part by its lowest one, where they are more than one.
    members: HashMap<PlaceId, Vec<PlaceId>>,
    /// Position in the map's links, by edge.
    links: Vec<usize>,
    /// What the edges were measured as.
    ways: Ways,
    /// Ends of the links that measured nothing.
    unmeasured: Vec<(PlaceId, PlaceId)>,
    /// Turn that the wheels of sessions see where there is none, in radians per metre.
    drifts: BTreeMap<SessionId, f64>,
    by_position: HashMap<Cell, Vec<PlaceId>>,
    settled: Settled,
    /// Closures that contradicted others when they were last judged past all of them; they are again
    /// when that many have become twice as many.
    judged_with: usize,
}

/// Whether a loop was closed since the last relaxation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Settled {
    Yes,
    LoopClosed,
}

type Cell = (PlaceId, i64, i64);

/// A drift that has changed by less leaves the poses as they are: relaxation makes up for it.
const NEWS_RAD_PER_M: f64 = 1e-3;

/// Side of the cells that places are looked up by.
const CELL_M: f64 = 1.0;

impl Default for PlacePoses {
    fn default() -> Self {
        Self {
            graph: PlanarGraph::new(0),
            relaxed: nothing_relaxed(),
            poses: Vec::new(),
            parts: Vec::new(),
            members: HashMap::new(),
            links: Vec::new(),
            ways: Ways::default(),
            unmeasured: Vec::new(),
            drifts: BTreeMap::new(),
            by_position: HashMap::new(),
            settled: Settled::Yes,
            judged_with: 0,
        }
    }
}

impl PlacePoses {
    /// Of a map with these links, relaxed. `makers` says of each place which session made it.
    #[must_use]
    pub fn new(makers: impl IntoIterator<Item = SessionId>, links: &[Link], noise: &OdometryNoise) -> Self {
        Self::over(makers, links.iter().enumerate(), noise)
    }

    /// The same of links with the numbers that they have among all of the map's.
    #[must_use]
    pub fn over<'a>(
        makers: impl IntoIterator<Item = SessionId>,
        links: impl IntoIterator<Item = (usize, &'a Link)>,
        noise: &OdometryNoise,
    ) -> Self {
        let mut poses = Self::default();
        makers.into_iter().for_each(|session| poses.add_place(session));
        for (number, link) in links {
            poses.add_link(number, link, noise);
        }
        poses.relax(noise);
        poses
    }

    /// The turn to the left that a session's wheels see where there is none, in radians per metre:
    /// 0 unless a loop that it closed has shown it.
    #[must_use]
    pub fn drift_rad_per_m(&self, session: SessionId) -> f64 {
        self.drifts.get(&session).copied().unwrap_or(0.0)
    }

    /// Where a place is in the frame of its part; `None` if there is no such place.
    #[must_use]
    pub fn pose(&self, place: PlaceId) -> Option<&PlanarPose> {
        self.poses.get(place.index())
    }

    /// The lowest place of the part that a place is of, whose frame its pose is in; `None` if there
    /// is no such place.
    #[must_use]
    pub fn part(&self, place: PlaceId) -> Option<PlaceId> {
        self.parts.get(place.index()).copied()
    }

    pub(crate) fn ways(&self) -> &Ways {
        &self.ways
    }

    /// The session that made a place; `None` if there is no such place.
    #[must_use]
    pub fn maker(&self, place: PlaceId) -> Option<SessionId> {
        self.ways.makers().get(place.index()).copied()
    }

    /// The sessions that made the places, in the order of places.
    pub(crate) fn makers(&self) -> &[SessionId] {
        self.ways.makers()
    }

    /// The links that measured something, as they did.
    pub fn measured_links(&self) -> impl Iterator<Item = Link> + '_ {
        self.ways.links()
    }

    /// Ends of all links, measured or not: a session went from the one to the other.
    pub fn linked(&self) -> impl Iterator<Item = (PlaceId, PlaceId)> + '_ {
        self.measured_links().map(|link| (link.from, link.to)).chain(self.unmeasured.iter().copied())
    }

    /// Whether a measured way joins any two places.
    #[must_use]
    pub fn has_metres(&self) -> bool {
        !self.members.is_empty()
    }

    /// Edges of the graph that are not contradicted.
    pub(crate) fn trusted_edges(&self) -> impl Iterator<Item = &Edge<PlanarPose, 3>> {
        let weights = self.relaxed.weights.iter().copied().chain(std::iter::repeat(1.0));
        self.graph.edges().iter().zip(weights).filter(|(_, weight)| *weight > 0.0).map(|(edge, _)| edge)
    }

    /// Whether a measured way joins a place with another.
    #[must_use]
    pub fn is_joined(&self, place: PlaceId) -> bool {
        self.part(place).is_some_and(|part| self.members.contains_key(&part))
    }

    /// Places of a part within `distance_m` of a position, in no order, each with its pose.
    pub fn near(
        &self,
        part: PlaceId,
        [x_m, y_m]: [f64; 2],
        distance_m: f64,
    ) -> impl Iterator<Item = (PlaceId, &PlanarPose)> {
        let range = move |centre: f64| cell(centre - distance_m)..=cell(centre + distance_m);
        // A robot that does not know where it is may be anywhere: its reach is not walked cell by
        // cell.
        let alone = self.parts.get(part.index()).map_or(&[][..], std::slice::from_ref);
        let members = self.members.get(&part).map_or(alone, Vec::as_slice);
        let reaches_far = (2.0 * distance_m / CELL_M).powi(2) > members.len() as f64;
        let (columns, of_part) = if reaches_far { (None, members) } else { (Some(range(x_m)), &[][..]) };
        let cells = columns
            .into_iter()
            .flatten()
            .flat_map(move |column| range(y_m).map(move |row| (part, column, row)));
        let places = cells.filter_map(|cell| self.by_position.get(&cell)).flatten().chain(of_part);
        places.filter_map(move |&place| {
            let pose = self.poses.get(place.index())?;
            let near = (pose.x_m() - x_m).hypot(pose.y_m() - y_m) <= distance_m;
            near.then_some((place, pose))
        })
    }

    /// Positions among the map's links of closures that contradict what most agree on, and of what was
    /// driven from the places that those took for known.
    pub fn contradicted(&self) -> impl Iterator<Item = usize> {
        let led_past = self.ways.led_past().map(|(edge, _)| edge);
        self.contradicted_edges().chain(led_past).map(|edge| self.links[edge])
    }

    /// Ends of what was driven past closures that are contradicted.
    pub fn past_contradicted(&self) -> impl Iterator<Item = (PlaceId, PlaceId)> {
        self.ways.led_past().map(|(_, ends)| ends)
    }

    fn is_contradicted(&self, edge: usize) -> bool {
        self.relaxed.weights.get(edge) == Some(&0.0)
    }

    /// Sum of eᵀΩe over the links, without those that are contradicted.
    #[must_use]
    pub fn cost(&self) -> f64 {
        self.relaxed.cost
    }

    /// The graph behind the poses: a pose per place, an edge per link that measured.
    #[must_use]
    pub fn graph(&self) -> &PlanarGraph {
        &self.graph
    }

    /// Poses of all places, each in the frame of its part.
    #[must_use]
    pub fn poses(&self) -> &[PlanarPose] {
        &self.poses
    }

    /// Adds the next place, which a session has made, a part of its own until a link leads to it.
    pub(crate) fn add_place(&mut self, session: SessionId) {
        let place = PlaceId::from_index(self.graph.add_pose());
        self.ways.add_place(session);
        self.poses.push(PlanarPose::identity());
        self.parts.push(place);
        self.index(place);
    }

    /// Adds what the map's link of that number measured, if it did. A link between places that
    /// belong together already closes a loop: poses are then to be relaxed.
    pub(crate) fn add_link(&mut self, number: usize, link: &Link, noise: &OdometryNoise) {
        let Link { from, to, kind } = *link;
        let (measured, kind) = match kind {
            LinkKind::Session => {
                self.unmeasured.push((from, to));
                return;
            }
            LinkKind::Odometry(relative) => (noise.from_above(&relative), EdgeKind::Odometry),
            LinkKind::Driven(measured) => (measured, EdgeKind::Odometry),
            LinkKind::Closed(measured) => (measured, EdgeKind::Closure),
        };
        let way = Way { from: from.index(), to: to.index(), measured };
        let Some(edge) = self.edge(&way, kind) else { return };
        let start = way.from;
        let end = way.to;
        let measured = *edge.measurement();
        let mine = self.parts[start];
        let other = self.parts[end];
        if mine == other {
            self.settled = Settled::LoopClosed;
        } else if mine < other {
            let at = self.poses[start].compose(&measured);
            self.join(mine, other, &at.compose(&self.poses[end].inverse()));
        } else {
            let at = self.poses[end].compose(&measured.inverse());
            self.join(other, mine, &at.compose(&self.poses[start].inverse()));
        }
        if self.graph.add_edge(edge).is_ok() {
            self.links.push(number);
            self.ways.push(way, kind);
        }
    }

    /// What a way is in the pose graph: the wheels' drift, as far as it is known, is taken off.
    fn edge(&self, way: &Way, kind: EdgeKind) -> Option<Edge<PlanarPose, 3>> {
        let Way { from, to, measured } = way;
        let pose = match kind {
            EdgeKind::Odometry => {
                without_drift(measured.pose(), self.drift_rad_per_m(self.ways.makers()[*to]))
            }
            EdgeKind::Closure => *measured.pose(),
        };
        Edge::new(*from, *to, pose, measured.information(), kind).ok()
    }

    /// Makes the poses agree with all links as well as they can, if a loop was closed.
    pub(crate) fn relax(&mut self, noise: &OdometryNoise) {
        if self.settled == Settled::Yes {
            return;
        }
        if self.learn_drifts(noise.heading_rad_per_m) {
            // With other wheels all closures look different: as if nothing had been relaxed before.
            self.relaxed = nothing_relaxed();
        } else {
            self.relaxed.poses.clone_from(&self.poses);
        }
        self.relaxed = relax(&self.graph, Start::Earlier(&self.relaxed), &RelaxationSettings::default());
        // It takes as long as to relax a map that was not relaxed before.
        if self.contradicted_edges().count() >= (2 * self.judged_with).max(1) {
            self.judge_past_closures(noise);
            self.judged_with = self.contradicted_edges().count();
        }
        self.poses.clone_from(&self.relaxed.poses);
        self.by_position.clear();
        PlaceId::first(self.poses.len()).for_each(|place| self.index(place));
        self.settled = Settled::Yes;
    }

    /// Closures contradict each other: they are judged again, by wheels that lead past all of them. What
    /// was driven after one that is wrong then leads past it, if all in all that fits better.
    fn judge_past_closures(&mut self, noise: &OdometryNoise) {
        let mut judged = self.clone();
        if !judged.ways.lead_past(|_closure| true) {
            return;
        }
        judged.relax_all(noise);
        let mut other = judged.clone();
        other.ways.lead_past(|closure| judged.is_contradicted(closure));
        other.relax_all(noise);
        if other.misfit() < self.misfit() {
            *self = other;
        }
    }

    /// As if nothing was known of drifts or poses.
    fn relax_all(&mut self, noise: &OdometryNoise) {
        let (driven, closed) = (self.ways.driven(), self.ways.closed());
        self.drifts = drifts(self.poses.len(), driven, closed, noise.heading_rad_per_m);
        self.build_graph();
        self.relaxed = relax(&self.graph, Start::Odometry, &RelaxationSettings::default());
    }

    /// How badly all fits, where a closure that is left out costs as much as one may that is kept.
    fn misfit(&self) -> f64 {
        let left_out = self.contradicted_edges().count();
        self.relaxed.cost + PlanarPose::CHI_SQUARED_MILLION * left_out as f64
    }

    fn contradicted_edges(&self) -> impl Iterator<Item = usize> {
        (0..self.links.len()).filter(|&edge| self.is_contradicted(edge))
    }

    /// Learns what wheels drift by. If the drift has changed, the graph is built again.
    fn learn_drifts(&mut self, expected_rad_per_m: f64) -> bool {
        let learnt = drifts(self.poses.len(), self.ways.driven(), self.ways.closed(), expected_rad_per_m);
        let known = |session| self.drift_rad_per_m(session);
        let sessions = self.drifts.keys().chain(learnt.keys());
        let mut changed =
            sessions.map(|&session| (learnt.get(&session).copied().unwrap_or(0.0) - known(session)).abs());
        if !changed.any(|change_rad_per_m| change_rad_per_m > NEWS_RAD_PER_M) {
            return false;
        }
        self.drifts = learnt;
        self.build_graph();
        true
    }

    fn build_graph(&mut self) {
        let mut graph = PlanarGraph::new(self.poses.len());
        for (way, kind) in self.ways.of_edges() {
            // Each was an edge before.
            if let Some(edge) = self.edge(way, kind) {
                let _ = graph.add_edge(edge);
            }
        }
        self.graph = graph;
    }

    /// Moves the places of one part into the frame of another.
    fn join(&mut self, part: PlaceId, joining: PlaceId, moved_by: &PlanarPose) {
        let places = self.members.remove(&joining).unwrap_or_else(|| vec![joining]);
        for &place in &places {
            let pose = &self.poses[place.index()];
            if let Some(places) = self.by_position.get_mut(&cell_of(joining, pose)) {
                places.retain(|&other| other != place);
            }
            self.poses[place.index()] = moved_by.compose(pose);
            self.parts[place.index()] = part;
            self.index(place);
        }
        self.members.entry(part).or_insert_with(|| vec![part]).extend(places);
    }

    fn index(&mut self, place: PlaceId) {
        let cell = cell_of(self.parts[place.index()], &self.poses[place.index()]);
        self.by_position.entry(cell).or_default().push(place);
    }
}

fn nothing_relaxed() -> Relaxed<PlanarPose> {
    Relaxed { poses: Vec::new(), cost: 0.0, iterations: 0, weights: Vec::new() }
}

fn cell(position_m: f64) -> i64 {
    (position_m / CELL_M).floor() as i64
}

fn cell_of(part: PlaceId, pose: &PlanarPose) -> Cell {
    (part, cell(pose.x_m()), cell(pose.y_m()))
}
