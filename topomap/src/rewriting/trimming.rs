//! Which places a map can do without, where it may have so many only.
//!
//! First those that another place stands for, then those that were looked at least and have others
//! near. A place that holds the map together stays: a session's places before and after one that is
//! dropped are linked ([`super::without_places`]), and those have to hang together without it.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use fabmap::appearance::{Appearance, PlaceId};
use fabmap::observation::WordId;

use crate::ids::SessionId;
use crate::log::MapEvent;
use crate::mapper::Mapper;
use posegraph::Pose;

/// A place to drop, and why.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dispensable {
    /// The place.
    pub place: PlaceId,
    /// Why.
    pub why: Why,
}

/// Why a map can do without a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Why {
    /// Another place stands where it does, and looks much the same.
    Redundant {
        /// That place.
        of: PlaceId,
        /// Share of their words that both show, in [0, 1].
        alike: f64,
    },
    /// It was looked at least, and others are near.
    LeastSeen {
        /// How often it was looked at.
        looks: u8,
        /// How far the nearest place on a way through it is.
        nearest: Distance,
    },
}

/// How far one place is from another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distance {
    /// In metres, where the way was measured.
    Metres(f64),
    /// In links, where it was not.
    Links(u32),
}

impl Distance {
    /// For comparisons: a link counts as a metre.
    fn value(self) -> f64 {
        match self {
            Self::Metres(distance_m) => distance_m,
            Self::Links(links) => f64::from(links),
        }
    }
}

/// What to drop, in this order, and what is left above the budget.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Budgeted {
    /// Places to drop.
    pub dropped: Vec<Dispensable>,
    /// Places more than the budget that stay, because the map would fall apart without any of those
    /// left.
    pub over: usize,
}

/// Share of words, each by how often it was seen, from which a place stands for another.
const ALIKE: f64 = 0.4;

/// What to drop for a map to have no more than `most_places`. `log` is the map's own. The same map
/// and budget, the same answer.
#[must_use]
pub fn over_budget<'a>(
    mapper: &Mapper,
    log: impl IntoIterator<Item = &'a MapEvent>,
    most_places: usize,
) -> Budgeted {
    let appearances: Vec<Appearance> = mapper.recognizer().index().appearances().collect();
    let mut budgeted = Budgeted { dropped: Vec::new(), over: appearances.len().saturating_sub(most_places) };
    if budgeted.over == 0 {
        return budgeted;
    }
    let is_there = |event: &&MapEvent| match event {
        MapEvent::Frame(frame) => mapper.map().withdrawal_of(frame.frame).is_none(),
        MapEvent::SessionOpened { .. } | MapEvent::Measured(_) | MapEvent::Corrected(_) => false,
    };
    let mut visits = Visits::of(log.into_iter().filter(is_there), appearances.len());
    for (place, of, alike) in redundant(mapper, &appearances) {
        if budgeted.over > 0 && !visits.is_dropped(of) && visits.drop_if_dispensable(place) {
            budgeted.take(place, Why::Redundant { of, alike });
        }
    }
    let key = |visits: &Visits, place: PlaceId| {
        let distance = visits.nearest(mapper, place).map_or(f64::INFINITY, Distance::value);
        (appearances[place.index()].looks(), distance.to_bits(), place)
    };
    let left = PlaceId::first(appearances.len()).filter(|&place| !visits.is_dropped(place));
    let mut waiting: BinaryHeap<Reverse<(u8, u64, PlaceId)>> =
        left.map(|place| Reverse(key(&visits, place))).collect();
    while let Some(Reverse(first)) = waiting.pop().filter(|_| budgeted.over > 0) {
        let (looks, distance, place) = key(&visits, first.2);
        // The nearest place may have been dropped since.
        if (looks, distance, place) > first {
            waiting.push(Reverse((looks, distance, place)));
        } else if let Some(nearest) = visits.nearest(mapper, place)
            && visits.drop_if_dispensable(place)
        {
            budgeted.take(place, Why::LeastSeen { looks, nearest });
        }
    }
    budgeted
}

impl Budgeted {
    fn take(&mut self, place: PlaceId, why: Why) {
        self.dropped.push(Dispensable { place, why });
        self.over -= 1;
    }
}

/// Places that another one stands for, those that are most alike first: the one of a pair that was
/// looked at less, or later.
fn redundant(mapper: &Mapper, appearances: &[Appearance]) -> Vec<(PlaceId, PlaceId, f64)> {
    let poses = mapper.poses();
    let spacing = mapper.settings().place_spacing;
    let mut pairs = Vec::new();
    for place in PlaceId::first(appearances.len()) {
        let near: BTreeSet<PlaceId> = match (poses.part(place), poses.pose(place)) {
            (Some(part), Some(pose)) if poses.is_joined(place) => {
                let near = poses.near(part, [pose.x_m(), pose.y_m()], spacing.distance_m);
                near.filter(|(_, other)| spacing.holds(&pose.inverse().compose(other)))
                    .map(|(other, _)| other)
                    .collect()
            }
            _ => mapper.map().linked(place).iter().copied().collect(),
        };
        for other in near.into_iter().filter(|&other| other > place) {
            let alike = alike(&appearances[place.index()], &appearances[other.index()]);
            let looks = |place: PlaceId| appearances[place.index()].looks();
            let (less, more) = if looks(place) < looks(other) { (place, other) } else { (other, place) };
            pairs.extend((alike >= ALIKE).then_some((less, more, alike)));
        }
    }
    pairs.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.0, a.1).cmp(&(b.0, b.1))));
    pairs
}

/// Σ min / Σ max over the words, each by its share of looks.
fn alike(one: &Appearance, other: &Appearance) -> f64 {
    let share = |appearance: &Appearance, hits: u8| f64::from(hits) / f64::from(appearance.looks().max(1));
    let mut words: BTreeMap<WordId, [f64; 2]> = BTreeMap::new();
    for (word, hits) in one.word_hits() {
        words.entry(word).or_default()[0] = share(one, hits);
    }
    for (word, hits) in other.word_hits() {
        words.entry(word).or_default()[1] = share(other, hits);
    }
    let sum = |of: fn(f64, f64) -> f64| words.values().map(|[a, b]| of(*a, *b)).sum::<f64>();
    sum(f64::min) / sum(f64::max).max(f64::MIN_POSITIVE)
}

/// The places that sessions were at, one after the other, without those that are dropped.
struct Visits {
    places: Vec<PlaceId>,
    before: Vec<Option<usize>>,
    after: Vec<Option<usize>>,
    /// Of each place; empty once it is dropped.
    of_place: Vec<Vec<usize>>,
}

impl Visits {
    fn of<'a>(log: impl IntoIterator<Item = &'a MapEvent>, places: usize) -> Self {
        let mut last: BTreeMap<SessionId, usize> = BTreeMap::new();
        let before = Vec::new();
        let after = Vec::new();
        let mut visits = Self { places: Vec::new(), before, after, of_place: vec![Vec::new(); places] };
        for event in log {
            let MapEvent::Frame(event) = event else { continue };
            let Some(place) = event.decision.place.filter(|&place| (place.index()) < places) else {
                continue;
            };
            let was = last.get(&event.session).copied();
            if was.is_some_and(|was| visits.places[was] == place) {
                continue;
            }
            let now = visits.places.len();
            if let Some(was) = was {
                visits.after[was] = Some(now);
            }
            visits.places.push(place);
            visits.before.push(was);
            visits.after.push(None);
            visits.of_place[place.index()].push(now);
            last.insert(event.session, now);
        }
        visits
    }

    fn is_dropped(&self, place: PlaceId) -> bool {
        self.of_place[place.index()].is_empty()
    }

    /// Places that sessions came from or went to.
    fn neighbours(&self, place: PlaceId) -> impl Iterator<Item = PlaceId> + '_ {
        let around =
            self.of_place[place.index()].iter().flat_map(|&visit| [self.before[visit], self.after[visit]]);
        around.flatten().map(|visit| self.places[visit]).filter(move |&other| other != place)
    }

    /// How near the nearest of them is; `None` if there is none.
    fn nearest(&self, mapper: &Mapper, place: PlaceId) -> Option<Distance> {
        let poses = mapper.poses();
        let distance = |other: PlaceId| match (poses.pose(place), poses.pose(other)) {
            (Some(a), Some(b)) if poses.is_joined(place) && poses.part(place) == poses.part(other) => {
                Distance::Metres((a.x_m() - b.x_m()).hypot(a.y_m() - b.y_m()))
            }
            _ => Distance::Links(1),
        };
        self.neighbours(place).map(distance).min_by(|a, b| a.value().total_cmp(&b.value()))
    }

    /// Drops a place that others are around, if those hang together without it.
    fn drop_if_dispensable(&mut self, place: PlaceId) -> bool {
        let around: BTreeSet<PlaceId> = self.neighbours(place).collect();
        let Some(&first) = around.first() else { return false };
        if !self.hang_together(first, around, place) {
            return false;
        }
        for visit in std::mem::take(&mut self.of_place[place.index()]) {
            let before = self.before[visit];
            let after = self.after[visit];
            if let Some(before) = before {
                self.after[before] = after;
            }
            if let Some(after) = after {
                self.before[after] = before;
            }
        }
        true
    }

    /// Whether ways lead from one place to all others without one that is dropped, those past it
    /// included.
    fn hang_together(&self, first: PlaceId, mut others: BTreeSet<PlaceId>, without: PlaceId) -> bool {
        let past = |from: Option<usize>, step: &[Option<usize>]| {
            let mut visit = from;
            while let Some(next) = visit.filter(|&next| self.places[next] == without) {
                visit = step[next];
            }
            visit.map(|visit| self.places[visit])
        };
        let mut seen = BTreeSet::from([first]);
        let mut waiting = vec![first];
        while let Some(place) = waiting.pop() {
            others.remove(&place);
            if others.is_empty() {
                return true;
            }
            for &visit in &self.of_place[place.index()] {
                let next = [past(self.before[visit], &self.before), past(self.after[visit], &self.after)];
                waiting.extend(next.into_iter().flatten().filter(|&next| seen.insert(next)));
            }
        }
        false
    }
}
