//! Which matches may all be true at once.

use std::collections::HashMap;

use fabmap::appearance::PlaceId;
use rayon::prelude::*;

use super::cliques::Agreements;
use super::ways::Ways;
use crate::metric::RelativePose;
use posegraph::{PlanarPose, Pose};

/// A match between places of two parts that measured how they lie to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) source: PlaceId,
    pub(super) target: PlaceId,
    /// Pose of the source's place in the frame of the target's.
    pub(super) pose: RelativePose,
}

/// Compares matches by pairs: from one place of the target over the source to another, and
/// directly.
pub(super) struct Consistency<'a> {
    source: Ways<'a>,
    target: Ways<'a>,
    source_m: Lengths,
    target_m: Lengths,
}

/// Metres along links between places that matched.
struct Lengths {
    numbers: HashMap<PlaceId, usize>,
    lengths_m: Vec<Vec<f64>>,
}

impl Lengths {
    fn of(ways: &Ways<'_>, places: impl Iterator<Item = PlaceId>) -> Self {
        let mut places: Vec<PlaceId> = places.collect();
        places.sort_unstable();
        places.dedup();
        let lengths = |&from: &PlaceId| {
            let all = ways.lengths_m(from);
            places.iter().map(|&place| all[place.index()]).collect()
        };
        let lengths_m = places.par_iter().map(lengths).collect();
        Self { numbers: (0..).zip(&places).map(|(number, &place)| (place, number)).collect(), lengths_m }
    }

    fn between_m(&self, from: PlaceId, to: PlaceId) -> Option<f64> {
        let length_m = self.lengths_m[*self.numbers.get(&from)?][*self.numbers.get(&to)?];
        Some(length_m).filter(|length_m| length_m.is_finite())
    }
}

impl<'a> Consistency<'a> {
    pub(super) fn of(source: Ways<'a>, target: Ways<'a>, matches: &[Measured]) -> Self {
        let source_m = Lengths::of(&source, matches.iter().map(|matched| matched.source));
        let target_m = Lengths::of(&target, matches.iter().map(|matched| matched.target));
        Self { source, target, source_m, target_m }
    }

    /// All pairs.
    pub(super) fn agreements(&self, matches: &[Measured]) -> Agreements {
        let row = |one: usize| {
            let mut row = vec![0; Agreements::words(matches.len())];
            for other in (0..matches.len()).filter(|&other| other != one) {
                // Both ways alike, to the bit.
                let first = one.min(other);
                let second = one.max(other);
                if self.agree(&matches[first], &matches[second]) {
                    row[other / 64] |= 1 << (other % 64);
                }
            }
            row
        };
        Agreements::new((0..matches.len()).into_par_iter().map(row).collect())
    }

    /// Whether both may be true: the loop over both maps closes as well as its covariance says. A
    /// place of the source is at one place of the target only, and may look like its neighbours.
    pub(super) fn agree(&self, one: &Measured, other: &Measured) -> bool {
        let Some((over_source, over_target)) = self.ways(one, other) else { return false };
        let over_source = one.pose.then(&over_source).then(&other.pose.back());
        let error = PlanarPose::error(over_target.pose(), &PlanarPose::identity(), over_source.pose());
        let covariance = over_source.covariance() + over_target.covariance();
        let Some(factor) = covariance.cholesky() else { return false };
        error.dot(&factor.solve(&error)) <= PlanarPose::CHI_SQUARED_HUNDRED
    }

    fn ways(&self, one: &Measured, other: &Measured) -> Option<(RelativePose, RelativePose)> {
        let source_m = self.source_m.between_m(one.source, other.source)?;
        let target_m = self.target_m.between_m(one.target, other.target)?;
        let over_source = self.source.between(one.source, other.source, source_m)?;
        Some((over_source, self.target.between(one.target, other.target, target_m)?))
    }
}
