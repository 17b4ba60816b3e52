use proptest::prelude::*;

use super::*;

fn graph(images: u32, links: &[(u32, u32, f64)]) -> AppearanceGraph {
    let mut graph = AppearanceGraph::default();
    (0..images).for_each(|_| {
        graph.add_image();
    });
    links.iter().for_each(|&(a, b, similarity)| graph.link(a, b, similarity));
    graph
}

/// Similar to the images whose numbers are near its own.
struct InARow(ImageId);

impl Panorama for InARow {
    fn overlap(&self, image: ImageId) -> Option<Overlap> {
        let apart = self.0.abs_diff(image);
        let motion = PlanarMotion::new(0.0, 0.0);
        (apart < 8).then(|| Overlap { constrained: 80 / apart.max(1), features: 400, motion })
    }
}

#[test]
fn similar_images_are_linked_and_no_others() {
    let mut all = AppearanceGraph::default();
    for image in 0..20 {
        let added = all.add(&InARow(image), Checks::All);
        assert_eq!(added, Added { image, checks: image as usize });
    }
    // 80 / 3 of 400 features are above a twentieth, 80 / 4 are not.
    assert_eq!(all.neighbours(10).iter().map(|link| link.to).collect::<Vec<_>>(), [7, 8, 9, 11, 12, 13]);
    assert_eq!(all.similarity(3, 4), Some(0.2));
    assert_eq!(all.links().count(), 19 + 18 + 17);
    // Votes for the one before, and no other: its neighbours lead to the rest.
    let mut few = AppearanceGraph::default();
    for image in 0..20 {
        let votes: Vec<f64> = (0..image).map(|other| if other + 1 == image { 0.1 } else { 0.002 }).collect();
        let added = few.add(&InARow(image), Checks::Promising(&votes));
        assert!(added.checks <= 8, "{added:?}");
    }
    assert_eq!(few, all);
    // Without votes nothing is compared.
    assert_eq!(few.add(&InARow(20), Checks::Promising(&[])), Added { image: 20, checks: 0 });
}

#[test]
fn a_few_matches_of_few_features_are_no_similarity() {
    let of = |constrained| Overlap { constrained, features: 29, motion: PlanarMotion::new(0.0, 0.0) };
    assert_eq!(of(MIN_CONSTRAINED - 1).similarity(), 0.0);
    assert!((of(MIN_CONSTRAINED).similarity() - 8.0 / 29.0).abs() < 1e-12);
}

#[test]
fn the_shortest_path_prefers_views_with_much_in_common() {
    // Straight from 0 to 3 is 1 / 0.1; over 1 and 2 it is 3 / 0.5.
    let graph = graph(5, &[(0, 3, 0.1), (0, 1, 0.5), (1, 2, 0.5), (2, 3, 0.5), (0, 2, 0.05)]);
    let distances = graph.distances_to(3).unwrap();
    assert!((distances.of(0).unwrap() - 6.0).abs() < 1e-12);
    assert_eq!(distances.path(&graph, 0), [0, 1, 2, 3]);
    assert_eq!((distances.of(4), distances.path(&graph, 4)), (None, Vec::new()));
    assert_eq!(graph.distances_to(5), Err(NoSuchImage { image: 5, images: 5 }));
}

#[test]
fn rooms_are_found_and_corridors_are_not_cut_from_them_at_random() {
    // Three rooms of ten images that see each other, joined through doors, and one that nobody has
    // seen from elsewhere.
    let mut links = Vec::new();
    for room in 0..3 {
        for a in 0..10 {
            links.extend((0..a).map(|b| (10 * room + a, 10 * room + b, 0.3)));
        }
    }
    links.extend([(9, 10, 0.1), (8, 11, 0.08), (19, 20, 0.1)]);
    let spaces = graph(31, &links).convex_spaces();
    let expected: Vec<u32> = (0..31).map(|image| image / 10).collect();
    assert_eq!(spaces, expected);
    // What is seen of a room from beyond its door is little.
    assert_eq!(graph(31, &links).room_around(3, &spaces), (0..10).collect::<Vec<_>>());
    let with_a_hall = [&links[..], &[(3, 30, 0.2), (4, 30, 0.2), (5, 30, 0.2)]].concat();
    let hall = graph(31, &with_a_hall);
    let spaces_with_a_hall = hall.convex_spaces();
    assert_eq!(spaces_with_a_hall[30], spaces_with_a_hall[3], "too little to cut it off");
    assert_eq!(hall.room_around(3, &spaces_with_a_hall), (0..10).collect::<Vec<_>>());
    assert_eq!(hall.room_around(31, &spaces_with_a_hall), []);
    // One room alone stays whole.
    let room: Vec<_> = links.into_iter().filter(|&(a, b, _)| a < 10 && b < 10).collect();
    assert_eq!(graph(10, &room).convex_spaces(), [0; 10]);
}

/// In a narrow hall before the door of a room all of it is matched, and the hall besides.
#[test]
fn who_sees_a_room_whole_from_before_its_door_is_not_in_it() {
    const BEFORE_THE_DOOR: ImageId = 10;
    let mut links = Vec::new();
    for a in 0..10 {
        links.extend((0..a).map(|b| (a, b, 0.3)));
        links.push((a, BEFORE_THE_DOOR, 0.15));
    }
    links.extend((11..23).map(|hall| (BEFORE_THE_DOOR, hall, 0.3)));
    let one_space = [0; 23];
    assert_eq!(graph(23, &links).room_around(3, &one_space), (0..10).collect::<Vec<_>>());
    // What sees little besides is in the room.
    let niche = graph(23, &links[..links.len() - 10]);
    assert_eq!(niche.room_around(3, &one_space), (0..11).collect::<Vec<_>>());
}

/// Bellman and Ford's relaxation of all links, as often as there are images.
fn plain_distances(graph: &AppearanceGraph, goal: ImageId) -> Vec<f64> {
    let mut distances = vec![f64::INFINITY; graph.len()];
    distances[goal as usize] = 0.0;
    for _ in 0..graph.len() {
        for (from, Link { to, similarity }) in graph.links().collect::<Vec<_>>() {
            let a = from as usize;
            let b = to as usize;
            distances[a] = distances[a].min(distances[b] + 1.0 / similarity);
            distances[b] = distances[b].min(distances[a] + 1.0 / similarity);
        }
    }
    distances
}

proptest! {
    #[test]
    fn distances_are_those_of_plain_relaxation(
        links in prop::collection::vec((0..12u32, 0..12u32, 0.051..1.0f64), 0..40), goal in 0..12u32,
    ) {
        let graph = graph(12, &links);
        let found = graph.distances_to(goal).unwrap();
        let expected = plain_distances(&graph, goal);
        for image in 0..12 {
            let plain = Some(expected[image as usize]).filter(|distance| distance.is_finite());
            prop_assert_eq!(found.of(image).is_some(), plain.is_some());
            let apart = found.of(image).unwrap_or(0.0) - plain.unwrap_or(0.0);
            prop_assert!(apart.abs() < 1e-9);
            let path = found.path(&graph, image);
            prop_assert_eq!(path.last().copied(), plain.map(|_| goal));
        }
    }
}
