//! Maps without metres: matches that run along both maps in step.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};

use fabmap::appearance::PlaceId;
use rayon::prelude::*;

use super::cliques::Agreements;
use super::layout::Layout;
use super::{Apart, FusedPlace, MergePlan, MergeSettings, Overlap, PlaceMatch};
use crate::evidence::ClosureNoise;
use crate::map::PlacePoses;
use posegraph::{PlanarPose, Pose};

/// Matches that are compared by pairs, the strongest of those that conflict by whatever chain.
const MAX_COMPARED: usize = 2_000;

/// Links within which two matches have to be in step; what is further off in both maps may be
/// anywhere, for a session may have come a way that the other map does not know.
const REACH_STEPS: u32 = 16;

/// One map may have so many times the places that the other has of a way, and a match may be so
/// many places off.
const MOST_STRETCH: u32 = 2;
const SLACK_STEPS: u32 = 2;

/// Links between matches that speak for each other, like the frames of a closure.
const STEPS_IN_A_ROW: u32 = 8;

/// Links from a match within which the maps are held to overlap.
const LAID_WITHIN_STEPS: u32 = 2;

/// Matches by words alone that count as much as the least evidence of a merge: twice what frames
/// with keypoints take.
const ENOUGH_BY_WORDS: f64 = 10.0;

/// What becomes of two maps of which one at least knows no metres.
///
/// There is no transformation that all matches would have to agree on. But a way that is seen again
/// is seen in its order: two matches near each other on one map are about as many links from each
/// other on the other. The largest set that is in step falls into ways, and each has to show by
/// itself what a merge has to show.
pub(super) fn in_step(
    source: Layout<'_>,
    target: Layout<'_>,
    matches: &[PlaceMatch],
    settings: &MergeSettings,
) -> Result<MergePlan, Apart> {
    if matches.is_empty() {
        return Err(Apart::NoMatches);
    }
    let mut strongest = matches.to_vec();
    let by_strength =
        |a: &PlaceMatch, b: &PlaceMatch| strength(b, settings).total_cmp(&strength(a, settings));
    strongest.sort_by(|a, b| by_strength(a, b).then(b.posterior.total_cmp(&a.posterior)));
    let steps = BothSteps::of(source.poses, target.poses, strongest);
    let mut refused = None;
    let mut kept = BTreeSet::new();
    let mut rival_support = 0;
    for way in steps.ways(steps.largest_in_step()) {
        match steps.rivals_of_shown(&way, settings) {
            Ok(rivals) => {
                rival_support = rival_support.max(rivals);
                kept.extend(way);
            }
            // The first is that of the longest way.
            Err(apart) => refused = refused.or(Some(apart)),
        }
    }
    if let Some(refused) = refused.filter(|_| kept.is_empty()) {
        return Err(refused);
    }
    let agreeing: Vec<PlaceMatch> = kept.iter().map(|&index| steps.matches[index]).collect();
    let others = (0..steps.matches.len()).filter(|index| !kept.contains(index));
    let first = agreeing.first().map(|matched| (matched.source, matched.target)).unwrap_or_default();
    let cost = source.poses.cost() + target.poses.cost();
    Ok(MergePlan {
        transformation: PlanarPose::identity(),
        parts: (
            source.poses.part(first.0).unwrap_or_default(),
            target.poses.part(first.1).unwrap_or_default(),
        ),
        fused: fused(&agreeing, target, settings),
        rejected: others.map(|index| steps.matches[index]).collect(),
        overlap: steps.overlap(&agreeing.iter().map(|matched| matched.source).collect()),
        matches: agreeing,
        rival_support,
        cost_before: cost,
        cost_after: cost,
    })
}

fn strength(matched: &PlaceMatch, settings: &MergeSettings) -> f64 {
    matched.view.map_or(settings.min_total_evidence / ENOUGH_BY_WORDS, |_| matched.evidence())
}

/// Each place of the source that has matches, with the one that it looks most like.
fn fused(agreeing: &[PlaceMatch], target: Layout<'_>, settings: &MergeSettings) -> Vec<FusedPlace> {
    let at = ClosureNoise::of_spacing(target.spacing.distance_m).somewhere();
    let mut best: BTreeMap<PlaceId, &PlaceMatch> = BTreeMap::new();
    for matched in agreeing {
        let known = best.entry(matched.source).or_insert(matched);
        if strength(matched, settings) > strength(known, settings) {
            *known = matched;
        }
    }
    best.into_values().map(|&matched| FusedPlace { matched, at }).collect()
}

/// Links of a map.
struct Steps {
    neighbours: Vec<Vec<PlaceId>>,
}

impl Steps {
    fn of(poses: &PlacePoses) -> Self {
        let mut neighbours = vec![Vec::new(); poses.poses().len()];
        for (from, to) in poses.linked() {
            neighbours[from.index()].push(to);
            neighbours[to.index()].push(from);
        }
        Self { neighbours }
    }

    /// Places within so many links of some, and of how many.
    fn within(&self, places: impl IntoIterator<Item = PlaceId>, steps: u32) -> HashMap<PlaceId, u32> {
        let mut reached: HashMap<PlaceId, u32> = places.into_iter().map(|place| (place, 0)).collect();
        let mut first: Vec<PlaceId> = reached.keys().copied().collect();
        first.sort_unstable();
        let mut waiting: VecDeque<(PlaceId, u32)> = first.into_iter().map(|place| (place, 0)).collect();
        while let Some((place, far)) = waiting.pop_front() {
            if far == steps {
                continue;
            }
            for &next in &self.neighbours[place.index()] {
                if let Entry::Vacant(unreached) = reached.entry(next) {
                    unreached.insert(far + 1);
                    waiting.push_back((next, far + 1));
                }
            }
        }
        reached
    }
}

/// Matches, strongest first, and the links between them on both maps.
struct BothSteps {
    matches: Vec<PlaceMatch>,
    of_source: Steps,
    source: Around,
    target: Around,
    /// Of each match: those that cannot be true with it, ascending.
    conflicts: Vec<Vec<usize>>,
}

/// The neighbourhoods of the places of one map that matched.
struct Around {
    /// Places within [`REACH_STEPS`] of each, and how many links they are off.
    places: HashMap<PlaceId, HashMap<PlaceId, u32>>,
    /// Matches of each.
    matches: HashMap<PlaceId, Vec<usize>>,
}

impl Around {
    fn of(steps: &Steps, places: impl Iterator<Item = PlaceId>) -> Self {
        let mut matches: HashMap<PlaceId, Vec<usize>> = HashMap::new();
        places.enumerate().for_each(|(index, place)| matches.entry(place).or_default().push(index));
        let around = |&place: &PlaceId| (place, steps.within([place], REACH_STEPS));
        Self { places: matches.par_iter().map(|(place, _)| around(place)).collect(), matches }
    }

    /// One more than [`REACH_STEPS`] where it is further.
    fn between(&self, one: PlaceId, other: PlaceId) -> u32 {
        self.places[&one].get(&other).copied().unwrap_or(REACH_STEPS + 1)
    }

    /// Matches of places within so many links of one, in no order.
    fn near(&self, place: PlaceId, steps: u32) -> impl Iterator<Item = usize> + '_ {
        let near = self.places[&place].iter().filter(move |(_, far)| **far <= steps);
        near.filter_map(|(place, _)| self.matches.get(place)).flatten().copied()
    }
}

impl BothSteps {
    fn of(source: &PlacePoses, target: &PlacePoses, matches: Vec<PlaceMatch>) -> Self {
        let of_source = Steps::of(source);
        let mut both = Self {
            source: Around::of(&of_source, matches.iter().map(|matched| matched.source)),
            target: Around::of(&Steps::of(target), matches.iter().map(|matched| matched.target)),
            of_source,
            conflicts: Vec::new(),
            matches,
        };
        both.conflicts =
            (0..both.matches.len()).into_par_iter().map(|index| both.conflicts_of(index)).collect();
        both
    }

    fn conflicts_of(&self, one: usize) -> Vec<usize> {
        let PlaceMatch { source, target, .. } = self.matches[one];
        // What is far off on both maps contradicts nothing.
        let near = self.source.near(source, REACH_STEPS).chain(self.target.near(target, REACH_STEPS));
        let mut conflicts: Vec<usize> = near.filter(|&other| !self.agree(one, other)).collect();
        conflicts.sort_unstable();
        conflicts.dedup();
        conflicts
    }

    fn agree(&self, one: usize, other: usize) -> bool {
        let one = &self.matches[one];
        let other = &self.matches[other];
        let source = self.source.between(one.source, other.source);
        let target = self.target.between(one.target, other.target);
        source <= MOST_STRETCH * target + SLACK_STEPS && target <= MOST_STRETCH * source + SLACK_STEPS
    }

    /// A large set of matches that are all in step with each other. Those that conflict, by
    /// whatever chain, are chosen from together; what conflicts with nothing is in it.
    fn largest_in_step(&self) -> Vec<usize> {
        let mut seen = vec![false; self.matches.len()];
        let mut set = Vec::new();
        for first in 0..self.matches.len() {
            if std::mem::replace(&mut seen[first], true) {
                continue;
            }
            let mut chained = vec![first];
            let mut next = 0;
            while next < chained.len() {
                let reached = self.conflicts[chained[next]].iter().copied();
                let reached = reached.filter(|&other| !std::mem::replace(&mut seen[other], true));
                chained.extend(reached.collect::<Vec<_>>());
                next += 1;
            }
            chained.sort_unstable();
            set.extend(self.large_set(&chained));
        }
        set
    }

    /// A large set in step among some matches, ascending: of the strongest of them, and of those
    /// that conflict with none of it.
    fn large_set(&self, among: &[usize]) -> Vec<usize> {
        let (compared, others) = among.split_at(among.len().min(MAX_COMPARED));
        let numbers: HashMap<usize, usize> =
            (0..).zip(compared).map(|(number, &index)| (index, number)).collect();
        let row = |(number, index): (usize, &usize)| {
            let mut row = vec![u64::MAX; Agreements::words(compared.len())];
            let conflicts = self.conflicts[*index].iter().filter_map(|other| numbers.get(other));
            let beyond = compared.len()..64 * row.len();
            conflicts
                .copied()
                .chain([number])
                .chain(beyond)
                .for_each(|other| row[other / 64] &= !(1 << (other % 64)));
            row
        };
        let agreements = Agreements::new(compared.iter().enumerate().map(row).collect());
        let all: Vec<usize> = (0..compared.len()).collect();
        let mut set: BTreeSet<usize> =
            agreements.large_set(&all).into_iter().map(|number| compared[number]).collect();
        for &other in others {
            if self.conflicts[other].iter().all(|conflict| !set.contains(conflict)) {
                set.insert(other);
            }
        }
        set.into_iter().collect()
    }

    /// The ways that a set of matches falls into, those with most matches first; of equal ones that
    /// with the strongest.
    fn ways(&self, set: Vec<usize>) -> Vec<Vec<usize>> {
        let mut left: BTreeSet<usize> = set.into_iter().collect();
        let mut ways = Vec::new();
        while let Some(first) = left.pop_first() {
            let mut way = vec![first];
            let mut next = 0;
            while next < way.len() {
                let PlaceMatch { source, target, .. } = self.matches[way[next]];
                let near = self.source.near(source, STEPS_IN_A_ROW);
                let follows = |other: &usize| {
                    self.target.between(target, self.matches[*other].target) <= REACH_STEPS
                        && left.remove(other)
                };
                let mut reached: Vec<usize> = near.filter(follows).collect();
                reached.sort_unstable();
                way.extend(reached);
                next += 1;
            }
            way.sort_unstable();
            ways.push(way);
        }
        ways.sort_by(|a, b| b.len().cmp(&a.len()).then(a.cmp(b)));
        ways
    }

    /// Whether a way shows what a merge has to; then the matches of the longest way that
    /// contradicts it.
    fn rivals_of_shown(&self, way: &[usize], settings: &MergeSettings) -> Result<usize, Apart> {
        let mut of_place: BTreeMap<PlaceId, f64> = BTreeMap::new();
        for &member in way {
            let most = of_place.entry(self.matches[member].source).or_insert(0.0);
            *most = most.max(strength(&self.matches[member], settings));
        }
        let support = of_place.len();
        if support < settings.min_support {
            let matches = self.matches.len();
            let required = settings.min_support;
            return Err(Apart::TooLittleSupport { matches, support, required });
        }
        let evidence = self.most_in_a_row(&of_place);
        let required = settings.min_total_evidence;
        if evidence < required {
            return Err(Apart::TooLittleEvidence { support, evidence, required });
        }
        let overlap = self.overlap(&of_place.keys().copied().collect());
        if overlap.confirmed_share() < settings.min_confirmed_share {
            return Err(Apart::Contradicted(overlap));
        }
        let rivals: BTreeSet<usize> =
            way.iter().flat_map(|&member| &self.conflicts[member]).copied().collect();
        let rivals = self.large_set(&rivals.into_iter().collect::<Vec<_>>());
        let rival = self.ways(rivals).first().map_or(0, Vec::len);
        if rival as f64 > settings.max_rival_share * way.len() as f64 {
            return Err(Apart::Ambiguous { support: way.len(), rival });
        }
        Ok(rival)
    }

    /// Places of the source around some that matched, and those.
    fn overlap(&self, matched: &BTreeSet<PlaceId>) -> Overlap {
        let near = self.of_source.within(matched.iter().copied(), LAID_WITHIN_STEPS);
        Overlap { places: near.len(), confirmed: matched.len() }
    }

    /// The most strength that places within a few links of one have together.
    fn most_in_a_row(&self, of_place: &BTreeMap<PlaceId, f64>) -> f64 {
        let around = |place: &PlaceId| {
            let near = self.source.places[place].iter().filter(|(_, steps)| **steps <= STEPS_IN_A_ROW);
            // In the order of places, so that the sum is the same always.
            let near: BTreeSet<PlaceId> = near.map(|(near, _)| *near).collect();
            near.iter().filter_map(|near| of_place.get(near)).sum::<f64>()
        };
        of_place.keys().map(around).fold(0.0, f64::max)
    }
}
