//! Buildings that code draws, and ways through them.

mod buildings;
mod layout;

use nalgebra::Vector2;

use crate::floor_plan::FloorPlan;
use crate::render::CameraRig;
use crate::rigs::{camera_rig, gallery_camera_rig};

pub use buildings::corridors;

/// A building by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NamedWorld {
    /// 30 x 20 m: a ring of corridors with a cross corridor, so that there are two loops, and rooms
    /// inside and outside.
    Office,
    /// Two corridors with 24 offices that share furniture, wallpaper and layout and differ in a
    /// fifth of their texture.
    Corridors,
    /// A U-shaped hall with three rooms, as Booij, Terwijn, Zivkovic and Kröse drove in (ICRA
    /// 2007).
    BooijOffice,
    /// A ring of corridors of 40 m and nothing else: for tests.
    Loop,
    /// Six offices along a corridor.
    BuildingA,
    /// The same six offices along another corridor, in another order.
    BuildingB,
    /// A long straight hall with four rooms off it, photographs on all walls, seen by another
    /// camera than the other worlds: for what is tuned on those.
    Gallery,
    /// A short wide hall with two rooms off it.
    Foyer,
}

impl NamedWorld {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Office,
        Self::Corridors,
        Self::BooijOffice,
        Self::Loop,
        Self::BuildingA,
        Self::BuildingB,
        Self::Gallery,
        Self::Foyer,
    ];

    /// What command lines call it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Office => "office",
            Self::Corridors => "corridors",
            Self::BooijOffice => "booij-office",
            Self::Loop => "loop",
            Self::BuildingA => "building-a",
            Self::BuildingB => "building-b",
            Self::Gallery => "gallery",
            Self::Foyer => "foyer",
        }
    }

    /// The world of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|world| world.name() == name)
    }

    /// Its floor plan; other seeds have other furniture and looks.
    #[must_use]
    pub fn plan(self, seed: u64) -> FloorPlan {
        match self {
            Self::Office => buildings::office(seed),
            Self::Corridors => corridors(seed, 0.2),
            Self::BooijOffice => buildings::booij_office(seed),
            Self::Loop => buildings::ring(seed),
            Self::BuildingA => buildings::offices_in_a_row(seed, [0, 1, 2, 3, 4, 5]),
            Self::BuildingB => buildings::offices_in_a_row(seed, [4, 2, 5, 0, 3, 1]),
            Self::Gallery => buildings::gallery(seed),
            Self::Foyer => buildings::foyer(seed),
        }
    }

    /// What the robots there see with.
    #[must_use]
    pub fn camera_rig(self) -> CameraRig {
        match self {
            Self::Gallery => gallery_camera_rig(),
            Self::Office
            | Self::Corridors
            | Self::BooijOffice
            | Self::Loop
            | Self::BuildingA
            | Self::BuildingB
            | Self::Foyer => camera_rig(),
        }
    }

    /// Ways through it that are known to be free: a name, its corners, and how long it is to be in
    /// metres, if shorter than to its last corner.
    #[must_use]
    pub fn routes(self) -> Vec<NamedRoute> {
        match self {
            Self::Office => office_routes(),
            Self::Corridors => vec![
                NamedRoute::new(
                    "round",
                    &[[3.0, 5.0], [27.0, 5.0], [27.0, 15.0], [1.0, 15.0], [1.0, 5.0], [9.0, 5.0]],
                ),
                NamedRoute::new(
                    "offices",
                    &[
                        [1.0, 5.0],
                        [4.0, 5.0],
                        [4.0, 2.2],
                        [4.0, 5.0],
                        [12.0, 5.0],
                        [12.0, 2.2],
                        [12.0, 5.0],
                        [20.0, 5.0],
                    ],
                ),
            ],
            Self::BooijOffice => vec![
                NamedRoute::new(
                    "a-to-c",
                    &[[2.9, 4.2], [2.9, 3.5], [0.8, 3.5], [0.8, 0.8], [9.2, 0.8], [9.2, 3.5], [7.1, 3.5]],
                ),
                NamedRoute::new("b-to-c", &[[5.0, 4.5], [5.0, 0.8], [9.2, 0.8], [9.2, 5.5]]),
            ],
            Self::Loop => {
                let [west, east, south, north] = [1.0, 12.5, 1.0, 10.5];
                let round = [[east, south], [east, north], [west, north], [west, south]];
                let corners = [&[[3.0, south]][..], &round, &round, &[[8.0, south]]].concat();
                let routes = [("once", 46.0), ("twice", 86.0)];
                routes.map(|(name, length_m)| NamedRoute::new(name, &corners).cut(length_m)).to_vec()
            }
            Self::BuildingA | Self::BuildingB => {
                let rooms = (0..3).flat_map(|room| {
                    let x = 2.0 + 4.0 * f64::from(room);
                    [[x, 5.0], [x, 2.2], [x, 5.0], [x, 7.8], [x, 5.0]]
                });
                let corners: Vec<[f64; 2]> =
                    [[0.7, 5.0]].into_iter().chain(rooms).chain([[11.4, 5.0]]).collect();
                vec![NamedRoute::new("offices", &corners)]
            }
            Self::Gallery => gallery_routes(),
            Self::Foyer => {
                let corners = [
                    [1.0, 5.5],
                    [3.0, 5.5],
                    [3.0, 9.8],
                    [3.0, 5.5],
                    [9.0, 5.5],
                    [9.0, 1.2],
                    [9.0, 5.5],
                    [11.0, 5.5],
                ];
                vec![NamedRoute::new("rooms", &corners)]
            }
        }
    }

    /// The route of that name.
    #[must_use]
    pub fn route(self, name: &str) -> Option<NamedRoute> {
        self.routes().into_iter().find(|route| route.name == name)
    }
}

/// A way through a building.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedRoute {
    /// What command lines call it.
    pub name: &'static str,
    /// From where to where, over which corners.
    pub corners: Vec<Vector2<f64>>,
    /// Where it ends, in metres from its start, if before its last corner.
    pub length_m: Option<f64>,
}

impl NamedRoute {
    fn new(name: &'static str, corners: &[[f64; 2]]) -> Self {
        Self { name, corners: corners.iter().copied().map(Vector2::from).collect(), length_m: None }
    }

    fn cut(self, length_m: f64) -> Self {
        Self { length_m: Some(length_m), ..self }
    }
}

/// Ways on which a robot comes back to the hall that it knows, and goes on beyond what it has seen.
fn gallery_routes() -> Vec<NamedRoute> {
    // The middle of the hall, and how far into the rooms.
    let [hall, north, south] = [5.2, 8.7, 1.8];
    let visit = |x: f64, room: f64| [[x, hall], [x, room], [x, hall]];
    let start = [[1.5, hall]];
    let north_rooms = [visit(7.5, north), visit(17.5, north)].concat();
    let route = |name, pieces: &[&[[f64; 2]]]| NamedRoute::new(name, &pieces.concat());
    vec![
        route("frontier", &[&start, &visit(7.5, north), &[[22.5, hall]]]),
        route("rooms", &[&start, &north_rooms, &north_rooms]).cut(62.0),
        route("south", &[&start, &visit(11.5, south), &visit(19.5, south), &[[24.0, hall]]]),
    ]
}

/// As in Bazeille, Battesti and Filliat, table I (ECMR 2011): 38, 82 and 98 m with loops; 100 m
/// with two loops; and a way of 30 m from room to room.
fn office_routes() -> Vec<NamedRoute> {
    // Middles of the corridors.
    let [west, middle, east, south, north] = [5.0, 13.0, 25.0, 5.0, 15.0];
    let small = [[middle, south], [middle, north], [west, north], [west, south]];
    let large = [[east, south], [east, north], [west, north], [west, south]];
    let eight = [
        [middle, south],
        [east, south],
        [east, north],
        [middle, north],
        [middle, south],
        [west, south],
        [west, north],
    ];
    let start = [[west + 1.0, south]];
    let route =
        |name, pieces: &[&[[f64; 2]]], length_m| NamedRoute::new(name, &pieces.concat()).cut(length_m);
    vec![
        route("38m", &[&start, &small, &small], 38.0),
        route("82m", &[&start, &large, &small], 82.0),
        route("98m", &[&start, &large, &small, &small], 98.0),
        route(
            "100m-two-loops",
            &[
                &start,
                &eight,
                &[[west, north], [middle, north], [middle, south], [east, south], [east, north]],
            ],
            100.0,
        ),
        NamedRoute::new(
            "teach",
            &[[7.5, 2.0], [7.5, south], [middle, south], [middle, north], [22.5, north], [22.5, 18.0]],
        ),
    ]
}
