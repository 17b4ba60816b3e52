//! RTAB-Map's links between nodes, and which of them say that two nodes saw the same place.

use std::collections::{BTreeMap, BTreeSet};

use super::database::{Database, LinkRow};
use super::error::RtabError;

/// Two nodes that RTAB-Map took for the same place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Closure {
    /// The id of the later node.
    pub later: i64,
    /// The id of the earlier one.
    pub earlier: i64,
    /// How it was found.
    pub kind: ClosureKind,
}

/// How RTAB-Map found that two nodes saw the same place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ClosureKind {
    /// By how it looks, anywhere.
    Global,
    /// By how it looks or by a laser, among the nodes that are near by its map.
    Nearby,
    /// A person said so.
    User,
}

/// How many links there are, each pair of nodes once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// From a node to the next, by odometry.
    pub neighbors: u64,
    /// Closures found by looks.
    pub global: u64,
    /// Closures found nearby.
    pub nearby: u64,
    /// Closures that people made.
    pub user: u64,
    /// Neighbours that were measured better, within RTAB-Map's short-term memory.
    pub nearby_in_time: u64,
    /// Sightings of landmarks.
    pub landmarks: u64,
    /// Gravity, priors of poses, virtual links, and what newer versions have.
    pub other: u64,
}

pub(super) struct Links {
    pub(super) closures: Vec<Closure>,
    pub(super) counts: LinkCounts,
}

/// A link of the database as it is counted: RTAB-Map's numbers of types.
enum Kind {
    Neighbor,
    Closure(ClosureKind),
    NearbyInTime,
    Landmark,
    Other,
}

impl Kind {
    fn of(number: i64) -> Self {
        match number {
            // 6: neighbours of nodes that were merged away.
            0 | 6 => Kind::Neighbor,
            1 => Kind::Closure(ClosureKind::Global),
            2 => Kind::Closure(ClosureKind::Nearby),
            3 => Kind::NearbyInTime,
            4 => Kind::Closure(ClosureKind::User),
            8 => Kind::Landmark,
            _ => Kind::Other,
        }
    }
}

/// The links of a database, which has most of them twice: once from either end.
pub(super) fn closures_of(database: &Database) -> Result<Links, RtabError> {
    Ok(sorted(database.links()?))
}

fn sorted(rows: Vec<LinkRow>) -> Links {
    let pairs: BTreeSet<(i64, i64, i64)> =
        rows.into_iter().map(|LinkRow { from, to, kind }| (from.max(to), from.min(to), kind)).collect();
    let mut counts = LinkCounts::default();
    let mut closures: BTreeMap<(i64, i64), ClosureKind> = BTreeMap::new();
    for (later, earlier, kind) in pairs {
        let count = match Kind::of(kind) {
            Kind::Neighbor => &mut counts.neighbors,
            Kind::NearbyInTime => &mut counts.nearby_in_time,
            Kind::Landmark => &mut counts.landmarks,
            Kind::Closure(_) if later == earlier => &mut counts.other,
            Kind::Other => &mut counts.other,
            Kind::Closure(kind) => {
                // A pair that was found in several ways is one closure.
                closures.entry((later, earlier)).or_insert(kind);
                match kind {
                    ClosureKind::Global => &mut counts.global,
                    ClosureKind::Nearby => &mut counts.nearby,
                    ClosureKind::User => &mut counts.user,
                }
            }
        };
        *count += 1;
    }
    let closures =
        closures.into_iter().map(|((later, earlier), kind)| Closure { later, earlier, kind }).collect();
    Links { closures, counts }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_count_once_and_only_closures_are_some() {
        let row = |(from, to, kind)| LinkRow { from, to, kind };
        let rows = [
            (1, 2, 0),
            (2, 1, 0),
            (9, 2, 1),
            (2, 9, 1),
            (3, 9, 2),
            (9, 3, 1),
            (5, 4, 3),
            (8, 1, 4),
            (2, -7, 8),
            (3, 3, 9),
            (4, 4, 1),
        ];
        let Links { closures, counts } = sorted(rows.map(row).to_vec());
        let found: Vec<_> = closures.iter().map(|found| (found.later, found.earlier, found.kind)).collect();
        assert_eq!(
            found,
            [(8, 1, ClosureKind::User), (9, 2, ClosureKind::Global), (9, 3, ClosureKind::Global)]
        );
        let expected = LinkCounts {
            neighbors: 1,
            global: 2,
            nearby: 1,
            user: 1,
            nearby_in_time: 1,
            landmarks: 1,
            other: 2,
        };
        assert_eq!(counts, expected);
    }
}
