//! The floor plans.

use super::layout::{Layout, Look};
use crate::floor_plan::FloorPlan;
use crate::random::derived_seed;
use crate::texture::Material;

/// Least depth of a corridor's furniture is that of a shelf: robots and people pass.
const CORRIDOR_DEPTH_M: f64 = 0.36;
const ANY_DEPTH_M: f64 = 1.0;

#[expect(clippy::expect_used, reason = "the tests draw every building")]
fn drawn(layout: Layout) -> FloorPlan {
    FloorPlan::new(layout.into_parts()).expect("a building drawn by this module is whole")
}

pub(super) fn office(seed: u64) -> FloorPlan {
    let mut layout = Layout::default();
    let look = |number: u64| Look::unique(derived_seed(seed, number));
    let corridors = [
        ("south corridor", [4.0, 4.0, 26.0, 6.0]),
        ("north corridor", [4.0, 14.0, 26.0, 16.0]),
        ("west corridor", [4.0, 6.0, 6.0, 14.0]),
        ("middle corridor", [12.0, 6.0, 14.0, 14.0]),
        ("east corridor", [24.0, 6.0, 26.0, 14.0]),
    ];
    let halls: Vec<usize> =
        (0..).zip(corridors).map(|(number, (name, area))| layout.hall(name, area, look(number))).collect();
    let mut rooms = Vec::new();
    // South and north of the corridors: six rooms of 5 m each.
    for room in 0..6_u32 {
        let x = 5.0 * f64::from(room);
        let number = u64::from(room);
        rooms.push(layout.room(format!("south {}", room + 1), [x, 0.0, x + 5.0, 4.0], look(10 + number)));
        rooms.push(layout.room(format!("north {}", room + 1), [x, 16.0, x + 5.0, 20.0], look(20 + number)));
        let door = (x + 2.5).clamp(4.5, 25.5);
        layout.door(door, 4.0);
        layout.door(door, 16.0);
    }
    for (number, (y, door)) in (0..).zip([(4.0, 5.0), (8.0, 10.0), (12.0, 15.0)]) {
        rooms.push(layout.room(format!("west {}", number + 1), [0.0, y, 4.0, y + 4.0], look(30 + number)));
        rooms.push(layout.room(format!("east {}", number + 1), [26.0, y, 30.0, y + 4.0], look(40 + number)));
        layout.door(4.0, door);
        layout.door(26.0, door);
    }
    for (number, area) in
        (0..).zip([[6.0, 6.0, 12.0, 14.0], [14.0, 6.0, 19.0, 14.0], [19.0, 6.0, 24.0, 14.0]])
    {
        rooms.push(layout.room(format!("inner {}", number + 1), area, look(50 + number)));
    }
    for [x, y] in [[9.0, 6.0], [12.0, 10.0], [16.5, 14.0], [21.5, 6.0], [24.0, 10.0]] {
        layout.door(x, y);
    }
    for (number, hall) in (0..).zip(halls) {
        layout.furnish(hall, derived_seed(seed, 60 + number), 0.35, CORRIDOR_DEPTH_M);
    }
    for (number, room) in (0..).zip(rooms) {
        layout.furnish(room, derived_seed(seed, 70 + number), 0.6, ANY_DEPTH_M);
    }
    drawn(layout)
}

/// Two corridors, joined at both ends, with 24 offices that share furniture, wallpaper and layout;
/// a share `own_share` of the texture, in patches of half a metre, is each office's own.
#[must_use]
pub fn corridors(seed: u64, own_share: f64) -> FloorPlan {
    let mut layout = Layout::default();
    let family = derived_seed(seed, 0);
    let look = |number: u64| {
        let own = derived_seed(seed, 10 + number);
        Look { style: family, family, own, own_share, walls: None }
    };
    // The corridors are alike as well, but each has more of its own.
    let hall = |number: u64| Look { own_share: own_share.max(0.5), ..look(number) };
    let halls = [
        layout.hall("corridor 1", [0.0, 4.0, 28.0, 6.0], hall(100)),
        layout.hall("corridor 2", [0.0, 14.0, 28.0, 16.0], hall(101)),
        layout.hall("west end", [0.0, 6.0, 2.0, 14.0], hall(102)),
        layout.hall("east end", [26.0, 6.0, 28.0, 14.0], hall(103)),
    ];
    let mut offices = Vec::new();
    for row in 0..4_u32 {
        let y = [0.0, 6.0, 10.0, 16.0][row as usize];
        for column in 0..6_u32 {
            let x = 2.0 + 4.0 * f64::from(column);
            let number = u64::from(6 * row + column);
            let office =
                layout.room(format!("office {}", number + 1), [x, y, x + 4.0, y + 4.0], look(number));
            // Rows 0 and 2 have their doors to the north, 1 and 3 to the south.
            let faces_south = row % 2 == 1;
            layout.door(x + 2.0, if faces_south { y } else { y + 4.0 });
            layout.turned(office, if faces_south { 2 } else { 0 });
            offices.push(office);
        }
    }
    for office in offices {
        layout.furnish(office, family, 0.7, ANY_DEPTH_M);
    }
    for hall in halls {
        layout.furnish(hall, derived_seed(family, hall as u64), 0.3, CORRIDOR_DEPTH_M);
    }
    drawn(layout)
}

pub(super) fn booij_office(seed: u64) -> FloorPlan {
    let mut layout = Layout::default();
    let look = |number: u64| Look::unique(derived_seed(seed, number));
    let halls = [
        layout.hall("south hall", [0.0, 0.0, 10.0, 1.6], look(0)),
        layout.hall("west hall", [0.0, 1.6, 1.6, 7.0], look(1)),
        layout.hall("east hall", [8.4, 1.6, 10.0, 7.0], look(2)),
    ];
    let rooms = [
        layout.room("room a", [1.6, 1.6, 4.0, 7.0], look(3)),
        layout.room("room b", [4.0, 1.6, 6.0, 7.0], look(4)),
        layout.room("room c", [6.0, 1.6, 8.4, 7.0], look(5)),
    ];
    for [x, y] in [[1.6, 3.5], [5.0, 1.6], [8.4, 3.5]] {
        layout.door(x, y);
    }
    for (number, room) in (0..).zip(rooms) {
        layout.furnish(room, derived_seed(seed, 10 + number), 0.6, 0.5);
    }
    for (number, hall) in (0..).zip(halls) {
        layout.furnish(hall, derived_seed(seed, 20 + number), 0.15, 0.32);
    }
    drawn(layout)
}

/// A hall of 26 m that ends in far walls, with four rooms off it; photographs hang everywhere.
pub(super) fn gallery(seed: u64) -> FloorPlan {
    let mut layout = Layout::default();
    let look = |number: u64| Look::unique(derived_seed(seed, 300 + number)).walled(Material::Photographs);
    let hall = layout.hall("hall", [0.0, 4.0, 26.0, 6.4], look(0));
    let rooms = [
        ("north 1", [5.0, 6.4, 10.0, 11.0], [7.5, 6.4]),
        ("north 2", [15.0, 6.4, 20.0, 11.0], [17.5, 6.4]),
        ("south 1", [9.0, 0.0, 14.0, 4.0], [11.5, 4.0]),
        ("south 2", [17.0, 0.0, 22.0, 4.0], [19.5, 4.0]),
    ];
    let mut furnished = Vec::new();
    for (number, (name, area, [x, y])) in (1..).zip(rooms) {
        furnished.push(layout.room(name, area, look(number)));
        layout.door(x, y);
    }
    for (number, room) in (0..).zip(furnished) {
        layout.furnish(room, derived_seed(seed, 310 + number), 0.3, ANY_DEPTH_M);
    }
    layout.furnish(hall, derived_seed(seed, 320), 0.08, CORRIDOR_DEPTH_M);
    drawn(layout)
}

pub(super) fn foyer(seed: u64) -> FloorPlan {
    let mut layout = Layout::default();
    let look = |number: u64| Look::unique(derived_seed(seed, 400 + number));
    let hall = layout.hall("hall", [0.0, 4.0, 12.0, 7.0], look(0));
    let rooms = [
        layout.room("north room", [1.0, 7.0, 5.0, 11.0], look(1)),
        layout.room("south room", [7.0, 0.0, 11.0, 4.0], look(2)),
    ];
    layout.door(3.0, 7.0);
    layout.door(9.0, 4.0);
    for (number, room) in (0..).zip(rooms) {
        layout.furnish(room, derived_seed(seed, 410 + number), 0.3, ANY_DEPTH_M);
    }
    layout.furnish(hall, derived_seed(seed, 420), 0.08, CORRIDOR_DEPTH_M);
    drawn(layout)
}

pub(super) fn ring(seed: u64) -> FloorPlan {
    let mut layout = Layout::default();
    let areas = [[0.0, 0.0, 13.5, 2.0], [0.0, 9.5, 13.5, 11.5], [0.0, 2.0, 2.0, 9.5], [11.5, 2.0, 13.5, 9.5]];
    let names = ["south", "north", "west", "east"];
    let numbered = (0..).zip(names.into_iter().zip(areas));
    let look = |number| Look::unique(derived_seed(seed, number));
    let halls: Vec<usize> =
        numbered.map(|(number, (name, area))| layout.hall(name, area, look(number))).collect();
    for (number, hall) in (0..).zip(halls) {
        layout.furnish(hall, derived_seed(seed, 10 + number), 0.4, CORRIDOR_DEPTH_M);
    }
    drawn(layout)
}

/// Six offices, three on either side of a corridor. The same office looks the same wherever it is;
/// corridors differ.
pub(super) fn offices_in_a_row(seed: u64, order: [u64; 6]) -> FloorPlan {
    let mut layout = Layout::default();
    let corridor = derived_seed(seed, 100 + order[0]);
    let hall = layout.hall("corridor", [0.0, 4.0, 12.0, 6.0], Look::unique(corridor));
    let mut offices = Vec::new();
    for (place, number) in (0..6_u32).zip(order) {
        let x = 4.0 * f64::from(place % 3);
        let faces_south = place >= 3;
        let y = if faces_south { 6.0 } else { 0.0 };
        let look = Look::unique(derived_seed(seed, number));
        let office = layout.room(format!("office {}", number + 1), [x, y, x + 4.0, y + 4.0], look);
        layout.door(x + 2.0, if faces_south { y } else { y + 4.0 });
        layout.turned(office, if faces_south { 2 } else { 0 });
        offices.push((office, number));
    }
    for (office, number) in offices {
        layout.furnish(office, derived_seed(seed, 200 + number), 0.6, ANY_DEPTH_M);
    }
    layout.furnish(hall, derived_seed(corridor, 1), 0.3, CORRIDOR_DEPTH_M);
    drawn(layout)
}
