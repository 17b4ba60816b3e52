use super::*;
use crate::route::Route;
use crate::worlds::NamedWorld;

#[test]
fn ways_lead_from_any_room_to_any_other() {
    for world in NamedWorld::ALL {
        let plan = world.plan(2);
        let space = FreeSpace::new(&plan, 0.2);
        let rooms = &plan.parts().rooms;
        for room in &rooms[1..] {
            let (from, to) = (rooms[0].center(), room.center());
            let corners = space.shortest_path(from, to).unwrap();
            let length: f64 = corners.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            assert!(length >= (to - from).norm() - 1e-9);
            let back = space.shortest_path(to, from).unwrap();
            let length_back: f64 = back.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
            assert!(
                (length / length_back - 1.0).abs() < 0.03,
                "{length} m to {}, {length_back} back",
                room.name
            );
            let pieces = corners.windows(2);
            assert!(pieces.into_iter().all(|pair| plan.is_free_line(pair[0], pair[1], 0.2)), "{}", room.name);
        }
    }
}

#[test]
fn places_are_free_and_all_over() {
    let plan = NamedWorld::Loop.plan(1);
    let space = FreeSpace::new(&plan, 0.2);
    let places: Vec<Vector2<f64>> = (0..40).map(|seed| space.place(seed).unwrap()).collect();
    assert!(places.iter().all(|&place| plan.clearance_m(place) >= 0.2));
    let names: std::collections::BTreeSet<&str> =
        places.iter().map(|&place| plan.room_at(place).unwrap().name.as_str()).collect();
    assert_eq!(names.len(), 4);
    assert!(FreeSpace::new(&plan, 1.5).place(0).is_err());
}

#[test]
fn a_wall_has_no_way_through() {
    let plan = NamedWorld::Loop.plan(1);
    let space = FreeSpace::new(&plan, 0.2);
    let inside = Vector2::new(6.0, 5.0);
    assert_eq!(
        space.shortest_path(Vector2::new(1.0, 1.0), inside),
        Err(RouteError::Blocked { x_m: 6.0, y_m: 5.0 })
    );
    let opposite = space.shortest_path(Vector2::new(1.0, 1.0), Vector2::new(12.5, 10.5)).unwrap();
    assert!(Route::through(&opposite).unwrap().check(&plan, 0.15).is_ok());
}

#[test]
fn named_routes_are_free_and_as_long_as_said() {
    for world in NamedWorld::ALL {
        for seed in 0..12 {
            let plan = world.plan(seed);
            for named in world.routes() {
                let route = Route::named(&plan, &named, 0.25);
                let route = route.unwrap_or_else(|error| panic!("{} {}: {error}", world.name(), named.name));
                if let Some(length_m) = named.length_m {
                    assert!(
                        (route.length_m() - length_m).abs() < 0.05,
                        "{}: {} m",
                        named.name,
                        route.length_m()
                    );
                }
            }
        }
    }
}
