//! Whether the matches of two maps make them one.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use fabmap::appearance::PlaceId;

use super::consistency::{Consistency, Measured};
use super::layout::Layout;
use super::steps::in_step;
use super::ways::Ways;
use super::{Apart, FusedPlace, MergePlan, MergeSettings, Overlap, PlaceMatch, Verdict};
use crate::evidence::TwoView;
use crate::ids::SessionId;
use crate::log::{Link, LinkKind};
use crate::map::PlacePoses;
use crate::metric::{PlaceSpacing, RelativePose};
use posegraph::{PlanarPose, Pose};

/// Matches that are compared by pairs, the strongest; all others are held against what those come
/// to.
const MAX_COMPARED: usize = 2_000;

/// Turn of a match, in angles between places: one that it is most for a place in between, and half
/// a one to spare.
const MOST_TURN: f64 = 1.5;

/// Places apart that matches speak for each other: as many as a closure's frames.
const FRAMES_IN_A_ROW: f64 = 8.0;

/// How often both maps are laid over each other again.
const MAX_SETTLING: usize = 4;

/// Metres along the source's links within which a match says where a place of the source lies on
/// the target.
const LAID_WITHIN_M: f64 = 3.0;

/// Whether two maps are of the same places, by matches between them.
///
/// Of the pairs of parts with matches, the one with most of them is judged.
#[must_use]
pub fn judge(
    source: Layout<'_>,
    target: Layout<'_>,
    matches: &[PlaceMatch],
    settings: &MergeSettings,
) -> Verdict {
    match agreed(source, target, matches, settings) {
        Ok(plan) => Verdict::Overlap(plan),
        Err(apart) => Verdict::Apart(apart),
    }
}

fn agreed(
    source: Layout<'_>,
    target: Layout<'_>,
    matches: &[PlaceMatch],
    settings: &MergeSettings,
) -> Result<MergePlan, Apart> {
    if source.poses.linked().next().is_none() {
        return Err(Apart::NothingMeasured);
    }
    if target.poses.linked().next().is_none() {
        return Err(Apart::NothingToGoInto);
    }
    if !source.poses.has_metres() || !target.poses.has_metres() {
        return in_step(source, target, matches, settings);
    }
    let (parts, strongest) = strongest_of_one_pair_of_parts(source, target, matches)?;
    let compared: Vec<Measured> = strongest.iter().take(MAX_COMPARED).filter_map(measured).collect();
    let [from_source, from_target] = [source, target].map(|map| Ways::of(map.poses, map.noise));
    let consistency = Consistency::of(from_source, from_target, &compared);
    let agreements = consistency.agreements(&compared);
    let all: Vec<usize> = (0..compared.len()).collect();
    let set = agreements.large_set(&all);

    let members: Vec<PlaceMatch> = set.iter().map(|&member| strongest[member]).collect();
    let members = supported(source, &members, settings);
    enough(strongest.len(), &members, settings)?;
    let chosen: Vec<Measured> = members.iter().filter_map(measured).collect();
    let overlap = overlap(source, target, &chosen);
    if overlap.confirmed_share() < settings.min_confirmed_share {
        return Err(Apart::Contradicted(overlap));
    }
    let joined = settled(source, target, &strongest, &members, settings);
    let first_of_source = PlaceId::from_index(target.poses.poses().len());
    let at_root = joined
        .pose(parts.0.counted_from(first_of_source))
        .filter(|_| joined.part(parts.0.counted_from(first_of_source)) == joined.part(parts.1));
    let (Some(at_root), Some(root)) = (at_root, source.poses.pose(parts.0)) else {
        let required = settings.min_support;
        return Err(Apart::TooLittleSupport { matches: strongest.len(), support: 0, required });
    };
    let misfit = |matched: &PlaceMatch| misfit(matched, &joined, first_of_source);
    let fits = |matched: &PlaceMatch| misfit(matched) <= PlanarPose::CHI_SQUARED_HUNDRED;
    let contradicts = |&member: &usize| misfit(&strongest[member]) > PlanarPose::CHI_SQUARED_MILLION;
    let rivals: Vec<usize> = all.into_iter().filter(contradicts).collect();
    let rival_support = agreements.large_set(&rivals).len();
    let matched = strongest.len();
    let fitting: Vec<PlaceMatch> = strongest.iter().filter(|matched| fits(matched)).copied().collect();
    let supported: HashSet<PlaceId> =
        supported(source, &fitting, settings).iter().map(|matched| matched.source).collect();
    let keeps = |matched: &PlaceMatch| fits(matched) && supported.contains(&matched.source);
    let (kept, left): (Vec<PlaceMatch>, Vec<PlaceMatch>) = strongest.into_iter().partition(keeps);
    enough(matched, &kept, settings)?;
    if rival_support as f64 > settings.max_rival_share * kept.len() as f64 {
        return Err(Apart::Ambiguous { support: kept.len(), rival: rival_support });
    }
    let elsewhere = |matched: &&PlaceMatch| {
        !looks_the_same_way(matched, target.spacing) || parts_of(source, target, matched) != Some(parts)
    };
    let rejected = left.into_iter().chain(matches.iter().filter(elsewhere).copied()).collect();
    Ok(MergePlan {
        transformation: at_root.compose(&root.inverse()),
        parts,
        fused: fused(&kept, &joined, first_of_source),
        matches: kept,
        rejected,
        rival_support,
        overlap,
        cost_before: source.poses.cost() + target.poses.cost(),
        cost_after: joined.cost(),
    })
}

/// Both maps as one by matches that agree, and then by all that fit that: a few wrong ones that
/// agree by pairs, for nobody knows how wheels have drifted, bend the map until all right ones have
/// their say. As long as that makes more fit.
fn settled(
    source: Layout<'_>,
    target: Layout<'_>,
    strongest: &[PlaceMatch],
    agreeing: &[PlaceMatch],
    settings: &MergeSettings,
) -> PlacePoses {
    let first_of_source = PlaceId::from_index(target.poses.poses().len());
    let fitting = |joined: &PlacePoses| {
        let fits = |matched: &&PlaceMatch| {
            misfit(matched, joined, first_of_source) <= PlanarPose::CHI_SQUARED_HUNDRED
        };
        let fitting: Vec<PlaceMatch> = strongest.iter().filter(fits).copied().collect();
        supported(source, &fitting, settings)
    };
    let mut joined = joined_poses(source, target, &nearest_views(agreeing));
    let mut kept = fitting(&joined);
    for _ in 0..MAX_SETTLING {
        let again = joined_poses(source, target, &nearest_views(&kept));
        let more = fitting(&again);
        if more.len() <= kept.len() {
            break;
        }
        (joined, kept) = (again, more);
    }
    joined
}

fn measured(matched: &PlaceMatch) -> Option<Measured> {
    let PlaceMatch { source, target, measured, .. } = *matched;
    Some(Measured { source, target, pose: measured? })
}

/// Views that are turned further show little of each other, and where from is hard to tell; where
/// both maps were made by robots that looked the same way, there is a place that is turned less.
fn looks_the_same_way(matched: &PlaceMatch, spacing: PlaceSpacing) -> bool {
    let within_rad = MOST_TURN * spacing.angle_rad;
    matched.measured.is_some_and(|measured| measured.pose().heading_rad().abs() <= within_rad)
}

fn parts_of(source: Layout<'_>, target: Layout<'_>, matched: &PlaceMatch) -> Option<(PlaceId, PlaceId)> {
    source.poses.part(matched.source).zip(target.poses.part(matched.target))
}

/// The pair of parts with most matches, and those that measured something, strongest first.
fn strongest_of_one_pair_of_parts(
    source: Layout<'_>,
    target: Layout<'_>,
    matches: &[PlaceMatch],
) -> Result<((PlaceId, PlaceId), Vec<PlaceMatch>), Apart> {
    let mut by_parts: BTreeMap<(PlaceId, PlaceId), Vec<PlaceMatch>> = BTreeMap::new();
    for matched in matches.iter().filter(|matched| looks_the_same_way(matched, target.spacing)) {
        if let Some(parts) = parts_of(source, target, matched) {
            by_parts.entry(parts).or_default().push(*matched);
        }
    }
    let most = by_parts.into_iter().max_by(|a, b| a.1.len().cmp(&b.1.len()).then(b.0.cmp(&a.0)));
    let (parts, mut strongest) = most.ok_or(Apart::NoMatches)?;
    // Stable: those that are as strong stay in the order of places.
    strongest.sort_by(|a, b| b.evidence().total_cmp(&a.evidence()).then(b.posterior.total_cmp(&a.posterior)));
    Ok((parts, strongest))
}

/// Of matches that agree those that others near them speak for, too: like a loop closure's, whose
/// frames in a row add their evidence up. What agrees from afar may do so because nobody knows how
/// wheels have drifted.
fn supported(source: Layout<'_>, agreeing: &[PlaceMatch], settings: &MergeSettings) -> Vec<PlaceMatch> {
    let mut strongest: BTreeMap<PlaceId, f64> = BTreeMap::new();
    for matched in agreeing {
        let most = strongest.entry(matched.source).or_insert(0.0);
        *most = most.max(matched.evidence());
    }
    let within_m = FRAMES_IN_A_ROW * source.spacing.distance_m;
    let is_supported = |matched: &&PlaceMatch| {
        let at = source.poses.part(matched.source).zip(source.poses.pose(matched.source));
        let Some((part, pose)) = at else { return false };
        let near = source.poses.near(part, [pose.x_m(), pose.y_m()], within_m);
        // In the order of places, so that the sum is the same always.
        let near: BTreeSet<PlaceId> = near.map(|(place, _)| place).collect();
        near.iter().filter_map(|place| strongest.get(place)).sum::<f64>() >= settings.min_total_evidence
    };
    agreeing.iter().filter(is_supported).copied().collect()
}

/// Whether matches that agree are enough: one place that looks like several neighbours counts once.
fn enough(matches: usize, agreeing: &[PlaceMatch], settings: &MergeSettings) -> Result<(), Apart> {
    let mut of_place: BTreeMap<PlaceId, f64> = BTreeMap::new();
    for matched in agreeing {
        let most = of_place.entry(matched.source).or_insert(0.0);
        *most = most.max(matched.evidence());
    }
    let support = of_place.len();
    let evidence = of_place.values().sum::<f64>();
    if support < settings.min_support {
        return Err(Apart::TooLittleSupport { matches, support, required: settings.min_support });
    }
    if evidence < settings.min_total_evidence {
        return Err(Apart::TooLittleEvidence { support, evidence, required: settings.min_total_evidence });
    }
    Ok(())
}

/// Where places of the source lie on the target, as the nearest of the chosen matches says, and
/// whether they match.
fn overlap(source: Layout<'_>, target: Layout<'_>, chosen: &[Measured]) -> Overlap {
    let by_place: HashMap<PlaceId, &Measured> =
        chosen.iter().map(|matched| (matched.source, matched)).collect();
    let nearest = Ways::of(source.poses, source.noise).nearest(by_place.keys().copied());
    let mut overlap = Overlap::default();
    for (place, &(length_m, origin)) in PlaceId::all().zip(&nearest) {
        if length_m > LAID_WITHIN_M {
            continue;
        }
        let Some(at) = laid(source, target, by_place[&origin], place) else { continue };
        let Some(part) = target.poses.part(by_place[&origin].target) else { continue };
        let reach_m = target.spacing.distance_m;
        let mut near = target.poses.near(part, [at.x_m(), at.y_m()], reach_m);
        if near.any(|(_, pose)| target.spacing.holds(&pose.inverse().compose(&at))) {
            overlap.places += 1;
            overlap.confirmed += usize::from(by_place.contains_key(&place));
        }
    }
    overlap
}

/// A place of the source in the frame of the target's part, by one match.
fn laid(source: Layout<'_>, target: Layout<'_>, by: &Measured, place: PlaceId) -> Option<PlanarPose> {
    let from = source.poses.pose(by.source)?.inverse();
    let matched = target.poses.pose(by.target)?.compose(by.pose.pose());
    Some(matched.compose(&from.compose(source.poses.pose(place)?)))
}

/// Both maps as one, the target's places first, each match a closure between them. What wheels
/// drift by is learnt from the loops that close over both.
#[must_use]
pub fn joined_poses(source: Layout<'_>, target: Layout<'_>, matches: &[PlaceMatch]) -> PlacePoses {
    let first = PlaceId::from_index(target.poses.poses().len());
    let makers = |map: Layout<'_>| {
        let places = PlaceId::first(map.poses.poses().len());
        places.filter_map(|place| map.poses.maker(place)).collect::<Vec<SessionId>>()
    };
    let sessions = makers(target).iter().max().map_or(0, |last| last + 1);
    let makers =
        makers(target).into_iter().chain(makers(source).into_iter().map(|session| session + sessions));
    let mut links: Vec<Link> = target.poses.measured_links().collect();
    links.extend(source.poses.measured_links().map(|link| Link {
        from: link.from.counted_from(first),
        to: link.to.counted_from(first),
        kind: link.kind,
    }));
    links.extend(matches.iter().filter_map(measured).map(|matched| Link {
        from: matched.target,
        to: matched.source.counted_from(first),
        kind: LinkKind::Closed(matched.pose),
    }));
    PlacePoses::new(makers, &links, &target.noise)
}

/// Of each place of the source the match whose view moves least: neighbours that are as alike lie
/// half a metre off.
fn nearest_views(matches: &[PlaceMatch]) -> Vec<PlaceMatch> {
    let mut nearest: BTreeMap<PlaceId, PlaceMatch> = BTreeMap::new();
    let distance = |matched: &PlaceMatch| matched.view.as_ref().map_or(0.0, TwoView::distance_widths);
    for matched in matches {
        let best = nearest.entry(matched.source).or_insert(*matched);
        if distance(matched) < distance(best) {
            *best = *matched;
        }
    }
    nearest.into_values().collect()
}

/// Each place of the source that has matches, with the nearest of the places that it matches.
fn fused(matches: &[PlaceMatch], joined: &PlacePoses, first_of_source: PlaceId) -> Vec<FusedPlace> {
    let mut nearest: BTreeMap<PlaceId, (f64, FusedPlace)> = BTreeMap::new();
    for matched in matches {
        let ends = joined.pose(matched.target).zip(joined.pose(matched.source.counted_from(first_of_source)));
        let (Some((target, source)), Some(measured)) = (ends, matched.measured) else { continue };
        let apart = target.inverse().compose(source);
        let distance_m = apart.x_m().hypot(apart.y_m());
        let Ok(at) = RelativePose::new(apart, *measured.covariance()) else { continue };
        let found = (distance_m, FusedPlace { matched: *matched, at });
        let best = nearest.entry(matched.source).or_insert(found);
        if distance_m < best.0 {
            *best = found;
        }
    }
    nearest.into_values().map(|(_, fused)| fused).collect()
}

/// How badly a match agrees with both maps as one, in squared standard deviations.
fn misfit(matched: &PlaceMatch, joined: &PlacePoses, first_of_source: PlaceId) -> f64 {
    let ends = joined.pose(matched.target).zip(joined.pose(matched.source.counted_from(first_of_source)));
    let (Some(measured), Some((target, source))) = (matched.measured, ends) else { return f64::INFINITY };
    let error = PlanarPose::error(measured.pose(), target, source);
    error.dot(&(measured.information() * error))
}
