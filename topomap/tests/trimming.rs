//! A map under a budget keeps what holds it together.
use std::collections::BTreeSet;

use fabmap::appearance::PlaceId;
use posegraph::PlanarPose;
use proptest::prelude::*;
use topomap::mapper::Mapper;
use topomap::rewriting::{Why, over_budget, without_places};
use topomap::settings::MapperSettings;

use crate::building::{Robot, ahead, first, model, turn_left, unique};

/// Through one corridor twice, and out of it at its middle.
fn crossing(steps: usize, again: usize) -> Robot {
    let mut robot = Robot::new(unique, PlanarPose::new(0.1, 0.0, 0.0), [0.01, 0.003]);
    ahead(&mut robot, steps);
    robot.begin(PlanarPose::new(0.1 + 0.6 * again as f64, 0.0, 0.0), [-0.01, 0.0]);
    ahead(&mut robot, again);
    turn_left(&mut robot);
    ahead(&mut robot, again);
    robot
}

fn islands(mapper: &Mapper) -> usize {
    let mut left: BTreeSet<PlaceId> = PlaceId::first(mapper.map().places().len()).collect();
    let mut islands = 0;
    while let Some(first) = left.pop_first() {
        let mut waiting = vec![first];
        while let Some(place) = waiting.pop() {
            waiting.extend(mapper.map().linked(place).iter().filter(|next| left.remove(next)));
        }
        islands += 1;
    }
    islands
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_left_is_one_map_within_its_budget(steps in 8..20usize, again in 3..8usize, most in 1..30usize) {
        let robot = crossing(steps, again);
        let places = robot.mapper.map().places().len();
        let budgeted = over_budget(&robot.mapper, &robot.log, most);
        prop_assert_eq!(&over_budget(&robot.mapper, &robot.log, most), &budgeted);
        prop_assert_eq!(places - budgeted.dropped.len(), places.min(most) + budgeted.over);
        let dropped: BTreeSet<PlaceId> = budgeted.dropped.iter().map(|dropped| dropped.place).collect();
        prop_assert_eq!(dropped.len(), budgeted.dropped.len());
        let retold = without_places(&MapperSettings::default(), &robot.log, &dropped).unwrap();
        let mut map = Mapper::new(&model(), MapperSettings::default()).unwrap();
        retold.events.iter().for_each(|event| map.fold(event).unwrap());
        prop_assert_eq!(map.map().places().len(), places - dropped.len());
        prop_assert!(islands(&map) <= islands(&robot.mapper));
        // A chain can be thinned to its ends.
        prop_assert!(budgeted.over == 0 || places - dropped.len() <= 4, "{} of {} left", places - dropped.len(), places);
    }
}

#[test]
fn within_its_budget_a_map_keeps_all() {
    let robot = first(unique);
    let places = robot.mapper.map().places().len();
    assert_eq!(over_budget(&robot.mapper, &robot.log, places), topomap::rewriting::Budgeted::default());
}

/// A place that another stands for goes first, then every other one of a row rather than all of one
/// end.
#[test]
fn the_rest_is_thinned_evenly() {
    let robot = first(unique);
    let places = robot.mapper.map().places().len();
    let budgeted = over_budget(&robot.mapper, &robot.log, places * 2 / 3);
    assert_eq!(budgeted.over, 0);
    let least_seen = budgeted.dropped.iter().filter(|dropped| matches!(dropped.why, Why::LeastSeen { .. }));
    let straight: Vec<PlaceId> =
        least_seen.map(|dropped| dropped.place).filter(|&place| place < PlaceId::new(30)).collect();
    let neighbours = straight.iter().filter(|&&place| straight.contains(&place.next())).count();
    assert!(neighbours <= straight.len() / 3, "{straight:?}");
}
