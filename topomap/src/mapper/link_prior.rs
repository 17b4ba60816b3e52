//! Where the robot may have moved since the last frame.

use fabmap::appearance::PlaceId;
use fabmap::place_filter::{Belief, MotionPrior};

/// The prediction without odometry: each place's mass spreads equally over itself and its linked
/// places; what the belief holds of no place in particular stays even.
pub(crate) fn spread_over_links<'a>(
    belief: &Belief,
    linked: impl Fn(PlaceId) -> &'a [PlaceId],
) -> MotionPrior {
    let Belief { places, new_place, remainder } = belief;
    let mut weights = Vec::new();
    for &(place, probability) in places {
        let neighbours = linked(place);
        let share = probability / (neighbours.len() + 1) as f64;
        weights.push((place, share));
        weights.extend(neighbours.iter().map(|&neighbour| (neighbour, share)));
    }
    MotionPrior::from_weights(weights, new_place + remainder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mass_goes_to_the_place_and_its_neighbours() {
        let links: [&[PlaceId]; 3] =
            [&[PlaceId::new(1)], &[PlaceId::new(0), PlaceId::new(2)], &[PlaceId::new(1)]];
        let belief = Belief {
            places: vec![(PlaceId::new(0), 0.5), (PlaceId::new(1), 0.375)],
            new_place: 0.0625,
            remainder: 0.0625,
        };
        let prior = spread_over_links(&belief, |place| links[place.index()]);
        let expected = MotionPrior::from_weights(
            vec![(PlaceId::new(0), 0.375), (PlaceId::new(1), 0.375), (PlaceId::new(2), 0.125)],
            0.125,
        );
        assert_eq!(prior, expected);
    }
}
