//! How far a map reaches in metres.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use fabmap::appearance::PlaceId;
use posegraph::PlanarPose;
use topomap::map::PlacePoses;

/// How far a map reaches, seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MapExtent {
    /// Parts that measured ways join, each in a frame of its own.
    pub(crate) parts: u32,
    /// Their places.
    pub(crate) measured_places: u64,
    /// Of the part with the most places: along x and y of its frame, to the centimetre. Smaller differences come of the order in
    /// which a map was relaxed.
    pub(crate) sides_m: [f64; 2],
}

/// A part, as far as its places were looked at.
#[derive(Clone, Copy, Debug)]
struct Part {
    places: u64,
    least_m: [f64; 2],
    most_m: [f64; 2],
}

impl MapExtent {
    /// `None` where no measured way joins two places.
    pub(super) fn of(poses: &PlacePoses) -> Option<Self> {
        let mut parts: BTreeMap<PlaceId, Part> = BTreeMap::new();
        for (place, pose) in PlaceId::all().zip(poses.poses()).filter(|(place, _)| poses.is_joined(*place)) {
            let Some(part) = poses.part(place) else { continue };
            parts.entry(part).or_insert_with(|| Part::at(pose)).reach(pose);
        }
        // Of two that are as large, the one that was there first.
        let (_, largest) = parts.iter().max_by_key(|(lowest, part)| (part.places, Reverse(**lowest)))?;
        Some(Self {
            parts: u32::try_from(parts.len()).unwrap_or(u32::MAX),
            measured_places: parts.values().map(|part| part.places).sum(),
            sides_m: [0, 1]
                .map(|axis| (100.0 * (largest.most_m[axis] - largest.least_m[axis])).round() / 100.0),
        })
    }
}

impl Part {
    fn at(pose: &PlanarPose) -> Self {
        let position_m = [pose.x_m(), pose.y_m()];
        Self { places: 0, least_m: position_m, most_m: position_m }
    }

    /// Takes in one more place.
    fn reach(&mut self, pose: &PlanarPose) {
        self.places += 1;
        for (axis, metres) in [pose.x_m(), pose.y_m()].into_iter().enumerate() {
            self.least_m[axis] = self.least_m[axis].min(metres);
            self.most_m[axis] = self.most_m[axis].max(metres);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use topomap::log::{Link, LinkKind};
    use topomap::metric::{OdometryNoise, RelativePose};

    use super::*;

    /// From place to place, as far ahead and to the left.
    fn driven(from: u32, to: u32, [x_m, y_m]: [f64; 2]) -> Link {
        let way = RelativePose::new(PlanarPose::new(x_m, y_m, 0.0), Matrix3::identity() * 1e-4).unwrap();
        Link { from: PlaceId::new(from), to: PlaceId::new(to), kind: LinkKind::Driven(way) }
    }

    fn extent(places: usize, links: &[Link]) -> Option<MapExtent> {
        MapExtent::of(&PlacePoses::new(vec![0; places], links, &OdometryNoise::default()))
    }

    #[test]
    fn without_metres_there_is_none() {
        let seen = Link { from: PlaceId::new(0), to: PlaceId::new(1), kind: LinkKind::Session };
        assert_eq!(extent(2, &[seen]), None);
        assert_eq!(extent(0, &[]), None);
    }

    #[test]
    fn the_part_with_the_most_places_is_measured() {
        // The second part is longer, and has fewer places; the last place is by itself.
        let links = [
            driven(0, 1, [2.0, 0.0]),
            driven(1, 2, [1.0, -3.5]),
            driven(2, 3, [-4.0, 1.0]),
            driven(4, 5, [90.0, 0.0]),
        ];
        let expected = MapExtent { parts: 2, measured_places: 6, sides_m: [4.0, 3.5] };
        assert_eq!(extent(7, &links), Some(expected));
    }
}
