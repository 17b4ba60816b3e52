use nalgebra::Matrix3;
use posegraph::PlanarPose;

use super::*;
use crate::log::{Link, LinkKind};
use crate::metric::OdometryNoise;

/// Places in a row, 0.5 m apart, and one more that nothing leads to.
fn row(places: u32) -> PlacePoses {
    let step = RelativePose::new(PlanarPose::new(0.5, 0.0, 0.0), Matrix3::identity() * 1e-4).unwrap();
    let links: Vec<Link> = (1..places)
        .map(|place| Link {
            from: PlaceId::new(place - 1),
            to: PlaceId::new(place),
            kind: LinkKind::Driven(step),
        })
        .collect();
    PlacePoses::new(vec![0; places as usize + 1], &links, &OdometryNoise::default())
}

fn at(places: Vec<(PlaceId, f64)>) -> Belief {
    let on_places: f64 = places.iter().map(|(_, probability)| probability).sum();
    Belief { places, new_place: (1.0 - on_places) / 2.0, remainder: (1.0 - on_places) / 2.0 }
}

fn moved(x_m: f64, y_m: f64, heading_rad: f64) -> RelativePose {
    RelativePose::new(PlanarPose::new(x_m, y_m, heading_rad), Matrix3::identity() * 1e-4).unwrap()
}

/// The weight of each place, and their sum.
fn spread(steps: &[(&Belief, RelativePose)], places: u32) -> (Vec<f64>, f64) {
    let predicted = merged(steps.iter().copied(), &row(places), &PlaceSpacing::default());
    let mut weights = vec![0.0; places as usize + 1];
    predicted.places.iter().for_each(|&(place, weight)| weights[place.index()] = weight);
    let sum: f64 = weights.iter().sum();
    assert!((sum + predicted.elsewhere - 1.0).abs() < 1e-12);
    (weights, sum)
}

#[test]
fn the_robot_is_expected_where_it_has_driven() {
    let belief = at(vec![(PlaceId::new(2), 0.9)]);
    let (weights, sum) = spread(&[(&belief, moved(1.0, 0.0, 0.0))], 8);
    let best = (0..=8).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap();
    assert_eq!(best, 4);
    assert!((sum - 0.9).abs() < 1e-12);
    // Formula by hand: neighbours are one spacing off.
    let ratio = weights[3] / weights[4];
    assert!((ratio - (-0.5 * 0.25 / (0.25 + 1e-4_f64)).exp()).abs() < 1e-12, "{ratio}");
    // Backwards, having turned round, is not where places look the other way.
    let (turned, sum) = spread(&[(&belief, moved(0.5, 0.0, 3.0))], 8);
    assert_eq!(sum, 0.0, "{turned:?}");
}

#[test]
fn the_largest_of_all_steps_counts() {
    let sure = at(vec![(PlaceId::new(0), 0.8)]);
    let vague = at(vec![(PlaceId::new(6), 0.4)]);
    let steps = [(&vague, moved(0.5, 0.0, 0.0)), (&sure, moved(1.5, 0.0, 0.0))];
    let (weights, sum) = spread(&steps, 10);
    assert!((sum - 0.4).abs() < 1e-12, "as much as the latest belief has on places: {sum}");
    assert!(weights[3] > weights[7] && weights[7] > weights[5]);
}

#[test]
fn places_near_are_those_within_the_distance_however_far_it_reaches() {
    let poses = row(30);
    for (x_m, distance_m) in [(3.2, 0.6), (7.0, 2.0), (7.0, 4.0), (-50.0, 52.0), (1e8, 1e9), (0.0, 1e300)] {
        let mut near: Vec<PlaceId> =
            poses.near(PlaceId::new(0), [x_m, 0.0], distance_m).map(|(place, _)| place).collect();
        near.sort_unstable();
        let expected: Vec<PlaceId> = PlaceId::first(30)
            .filter(|place| (0.5 * f64::from(place.number()) - x_m).abs() <= distance_m)
            .collect();
        assert_eq!(near, expected, "{distance_m} m round {x_m}");
    }
    let alone: Vec<_> = poses.near(PlaceId::new(30), [0.0; 2], 1e6).map(|(place, _)| place).collect();
    assert_eq!((alone, poses.near(PlaceId::new(77), [0.0; 2], 1e6).count()), (vec![PlaceId::new(30)], 0));
}

#[test]
fn what_has_no_neighbours_within_reach_is_even() {
    let belief = at(vec![(PlaceId::new(10), 0.7)]);
    let (weights, sum) = spread(&[(&belief, moved(5.0, 0.0, 0.0))], 10);
    assert_eq!(sum, 0.0, "{weights:?}");
    assert_eq!(predict([], &row(3), &PlaceSpacing::default()), MotionPrior::even());
}
