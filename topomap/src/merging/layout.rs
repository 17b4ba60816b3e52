//! Where the places of a map are, for a judge of matches.

use crate::map::PlacePoses;
use crate::metric::{OdometryNoise, PlaceSpacing};

/// Where the places of a map are.
#[derive(Clone, Copy, Debug)]
pub struct Layout<'a> {
    /// Poses of its places.
    pub poses: &'a PlacePoses,
    /// How far its wheels can be trusted.
    pub noise: OdometryNoise,
    /// How far apart its places are.
    pub spacing: PlaceSpacing,
}
