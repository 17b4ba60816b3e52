//! Points that two views may have in common.

use nalgebra::Complex;

use crate::matching::Match;

/// A point of the earlier view with that of the current one: x + iy, to the right and down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Correspondence {
    pub(super) earlier: Complex<f64>,
    pub(super) current: Complex<f64>,
    /// The features that lie there.
    pub(super) of: Match,
}

/// Twice the weight of a match, everywhere: a match whose feature looks like others counts half.
pub(super) fn weight(pair: &Correspondence) -> u32 {
    1 + u32::from(pair.of.distinct)
}

/// The weights of all of them.
pub(super) fn total(pairs: &[Correspondence]) -> u32 {
    pairs.iter().map(weight).sum()
}
