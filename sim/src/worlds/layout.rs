//! From rooms and doors to a floor plan.

use std::f64::consts::FRAC_PI_2;

use nalgebra::Vector2;

use crate::floor_plan::{Door, Furniture, PlanParts, Room, Wall};
use crate::pose::Pose;
use crate::random::{Draws, derived_seed};
use crate::texture::{Material, Surface};

pub(super) const CEILING_M: f64 = 2.6;
const DOOR_HEIGHT_M: f64 = 2.05;
const DOOR_WIDTH_M: f64 = 0.95;

/// Rooms and doors of a building that is being drawn.
#[derive(Default)]
pub(super) struct Layout {
    rooms: Vec<Space>,
    doors: Vec<Vector2<f64>>,
    furniture: Vec<Furniture>,
}

/// A rectangle of floor.
#[derive(Clone, Debug)]
pub(super) struct Space {
    pub(super) name: String,
    pub(super) min: Vector2<f64>,
    pub(super) max: Vector2<f64>,
    /// Spaces of the same hall have no walls between them.
    pub(super) hall: Option<u32>,
    pub(super) look: Look,
    /// Quarter turns by which the space is turned against its look-alikes.
    pub(super) quarter_turns: u8,
}

/// What a space looks like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    pub(super) style: u64,
    pub(super) family: u64,
    pub(super) own: u64,
    pub(super) own_share: f64,
    /// What all walls are made of; `None` if the style says.
    pub(super) walls: Option<Material>,
}

impl Look {
    /// Like no other.
    pub(super) fn unique(seed: u64) -> Self {
        Self { style: seed, family: seed, own: seed, own_share: 1.0, walls: None }
    }

    /// The same with walls of one material.
    pub(super) fn walled(self, material: Material) -> Self {
        Self { walls: Some(material), ..self }
    }

    pub(super) fn surface(&self, material: Material, part: u64) -> Surface {
        let Self { style, family, own, own_share, walls: _ } = *self;
        Surface { material, style: derived_seed(style, material as u64), family, own, own_share }.part(part)
    }

    fn wall(&self) -> Material {
        let kinds =
            [Material::Plaster, Material::Wallpaper, Material::Brick, Material::Panelling, Material::Plaster];
        self.walls.unwrap_or(kinds[Draws::new(self.style).below(kinds.len())])
    }

    fn floor(&self) -> Material {
        let kinds = [Material::Carpet, Material::Parquet, Material::Tiles];
        kinds[Draws::new(derived_seed(self.style, 1)).below(kinds.len())]
    }
}

impl Layout {
    pub(super) fn room(&mut self, name: impl Into<String>, [x0, y0, x1, y1]: [f64; 4], look: Look) -> usize {
        self.space(name.into(), [x0, y0, x1, y1], None, look)
    }

    /// A piece of a hall or corridor; pieces that touch are open to each other.
    pub(super) fn hall(&mut self, name: impl Into<String>, [x0, y0, x1, y1]: [f64; 4], look: Look) -> usize {
        self.space(name.into(), [x0, y0, x1, y1], Some(0), look)
    }

    fn space(&mut self, name: String, [x0, y0, x1, y1]: [f64; 4], hall: Option<u32>, look: Look) -> usize {
        let (min, max) = (Vector2::new(x0, y0), Vector2::new(x1, y1));
        self.rooms.push(Space { name, min, max, hall, look, quarter_turns: 0 });
        self.rooms.len() - 1
    }

    pub(super) fn turned(&mut self, room: usize, quarter_turns: u8) {
        self.rooms[room].quarter_turns = quarter_turns;
    }

    /// An opening with a frame; its middle must lie on a border between two spaces.
    pub(super) fn door(&mut self, x: f64, y: f64) {
        self.doors.push(Vector2::new(x, y));
    }

    /// Shelves, cabinets, desks and boxes along all walls of a room, but not where doors are, drawn
    /// by `seed`. A share `density` of the room along the walls is taken, roughly.
    pub(super) fn furnish(&mut self, room: usize, seed: u64, density: f64, depth_limit_m: f64) {
        let space = self.rooms[room].clone();
        let mut draws = Draws::new(seed);
        for side in 0..4 {
            let turns = (side + u64::from(space.quarter_turns)) % 4;
            let (length, depth_axis) = space.side_length_m(turns);
            let mut along = draws.between(0.05, 0.5);
            loop {
                let item = Item::drawn(&mut draws);
                let number = draws.seed();
                let gap = draws.between(0.05, 0.6);
                let skipped = draws.between(0.0, 1.0) > density;
                if along + item.length_m > length - 0.05 {
                    break;
                }
                let deep_enough = item.depth_m <= depth_limit_m && item.depth_m * 3.0 < depth_axis;
                if !skipped && deep_enough && self.has_wall(room, turns, [along, along + item.length_m]) {
                    let pieces = item.at_wall(&space, turns, along, number);
                    if pieces.iter().all(|piece| self.is_room_for(piece)) {
                        self.furniture.extend(pieces);
                    }
                }
                along += item.length_m + gap;
            }
        }
    }

    /// Whether a stretch of a space's side is a wall, and not open to the rest of a hall.
    fn has_wall(&self, room: usize, side: u64, stretch_m: [f64; 2]) -> bool {
        stretch_m.iter().all(|&along_m| {
            let outside = self.rooms[room].on_side(side, along_m).compose(&Pose::new(0.0, -0.01, 0.0));
            !self.are_one_hall(Some(room), self.space_at(outside.position()))
        })
    }

    /// Whether a piece keeps away from doors and other furniture.
    fn is_room_for(&self, piece: &Furniture) -> bool {
        let extent = |item: &Furniture| {
            let corners = item.corners();
            let fold = |join: fn(&Vector2<f64>, &Vector2<f64>) -> Vector2<f64>| {
                corners[1..].iter().fold(corners[0], |a, b| join(&a, b))
            };
            (fold(Vector2::inf), fold(Vector2::sup))
        };
        let (min, max) = extent(piece);
        let far_from_doors = self.doors.iter().all(|door| {
            let outside = (min - door).sup(&(door - max)).sup(&Vector2::zeros());
            outside.norm() > 1.0
        });
        let is_apart = |other: &Furniture| {
            let (other_min, other_max) = extent(other);
            let gap = (min - other_max).sup(&(other_min - max));
            gap.max() > 0.02 || other.bottom_m >= piece.top_m || piece.bottom_m >= other.top_m
        };
        far_from_doors && self.furniture.iter().all(is_apart)
    }

    /// Walls wherever a space ends, with openings for the doors.
    pub(super) fn into_parts(self) -> PlanParts {
        let mut walls = Vec::new();
        let mut frames = Vec::new();
        for border in self.borders() {
            let surface = |(index, side): (Option<usize>, u64), ends: &[Vector2<f64>; 2], above_door: u64| {
                let outside = Surface::unique(Material::Brick, 0, 0);
                index.map_or(outside, |index| self.rooms[index].wall_surface(side, ends, above_door))
            };
            let surfaces = |ends: &[Vector2<f64>; 2], above_door: u64| {
                [surface(border.left, ends, above_door), surface(border.right, ends, above_door)]
            };
            let whole = |surfaces, [from, to]: [Vector2<f64>; 2], bottom_m, top_m| Wall {
                from,
                to,
                bottom_m,
                top_m,
                surfaces,
            };
            let [start, end] = [border.from, border.to];
            let along = (end - start).normalize();
            let mut cuts: Vec<f64> = self.doors.iter().filter_map(|door| border.door_at(*door)).collect();
            cuts.sort_by(f64::total_cmp);
            let mut begin = 0.0;
            for &cut in cuts.iter().chain([&f64::INFINITY]) {
                let stop = (cut - DOOR_WIDTH_M / 2.0).min((end - start).norm());
                if stop - begin > 0.02 {
                    let ends = [begin, stop].map(|distance| start + along * distance);
                    walls.push(whole(surfaces(&ends, 0), ends, 0.0, CEILING_M));
                }
                if cut.is_finite() {
                    let ends = [-0.5, 0.5].map(|half| start + along * (cut + half * DOOR_WIDTH_M));
                    walls.push(whole(surfaces(&ends, 1), ends, DOOR_HEIGHT_M, CEILING_M));
                    let number = frames.len() as u64;
                    frames.extend(ends.map(|post| door_post(post, along, number)));
                    begin = cut + DOOR_WIDTH_M / 2.0;
                }
            }
        }
        let rooms = self.rooms.iter().map(Space::room).collect();
        let doors = self.doors.iter().map(|&position| Door { position, width_m: DOOR_WIDTH_M }).collect();
        let furniture = self.furniture.into_iter().chain(frames).collect();
        PlanParts { ceiling_m: CEILING_M, rooms, walls, furniture, doors }
    }

    /// Straight pieces of border, as long as what is left and right of them stays the same.
    fn borders(&self) -> Vec<Border> {
        let mut borders: Vec<Border> = Vec::new();
        for axis in 0..2 {
            let across = 1 - axis;
            let sorted = |pick: usize| {
                let mut values: Vec<f64> =
                    self.rooms.iter().flat_map(|room| [room.min[pick], room.max[pick]]).collect();
                values.sort_by(f64::total_cmp);
                values.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
                values
            };
            for &line in &sorted(across) {
                for pair in sorted(axis).windows(2) {
                    let at = |along: f64, aside: f64| {
                        let mut point = Vector2::zeros();
                        (point[axis], point[across]) = (along, line + aside);
                        point
                    };
                    let middle = f64::midpoint(pair[0], pair[1]);
                    // Along x the left is +y, along y it is -x.
                    let left = if axis == 0 { 1e-3 } else { -1e-3 };
                    let [left, right] = [left, -left].map(|aside| self.space_at(at(middle, aside)));
                    if left == right || self.are_one_hall(left, right) {
                        continue;
                    }
                    let (from, to) = (at(pair[0], 0.0), at(pair[1], 0.0));
                    // The side of a space that a border is, counter-clockwise from the one with the
                    // least y.
                    let sides = if axis == 0 { [0, 2] } else { [1, 3] };
                    let (left, right) = ((left, sides[0]), (right, sides[1]));
                    match borders.last_mut() {
                        Some(last) if last.to == from && (last.left, last.right) == (left, right) => {
                            last.to = to;
                        }
                        Some(_) | None => borders.push(Border { from, to, left, right }),
                    }
                }
            }
        }
        borders
    }

    fn space_at(&self, point: Vector2<f64>) -> Option<usize> {
        let holds =
            |room: &Space| (0..2).all(|axis| room.min[axis] < point[axis] && point[axis] < room.max[axis]);
        self.rooms.iter().position(holds)
    }

    fn are_one_hall(&self, left: Option<usize>, right: Option<usize>) -> bool {
        let hall = |index: Option<usize>| index.and_then(|index| self.rooms[index].hall);
        hall(left).is_some() && hall(left) == hall(right)
    }
}

struct Border {
    from: Vector2<f64>,
    to: Vector2<f64>,
    /// A space, and which of its sides this is.
    left: (Option<usize>, u64),
    right: (Option<usize>, u64),
}

impl Border {
    /// How far along it a door is.
    fn door_at(&self, door: Vector2<f64>) -> Option<f64> {
        let along = self.to - self.from;
        let offset = door - self.from;
        let length = along.norm();
        let distance = offset.dot(&along) / length;
        let is_on = (offset.perp(&along) / length).abs() < 1e-6;
        (is_on && distance > DOOR_WIDTH_M / 2.0 && distance < length - DOOR_WIDTH_M / 2.0).then_some(distance)
    }
}

fn door_post(at: Vector2<f64>, along: Vector2<f64>, number: u64) -> Furniture {
    let wood = Surface::unique(Material::Wood, number / 2, derived_seed(number, 77));
    Furniture {
        pose: Pose::new(at.x, at.y, along.y.atan2(along.x)),
        size_m: [0.07, 0.14],
        bottom_m: 0.0,
        top_m: DOOR_HEIGHT_M,
        sides: wood,
        lid: wood,
    }
}

impl Space {
    fn room(&self) -> Room {
        let floor = self.look.surface(self.look.floor(), 1000);
        let ceiling = self.look.surface(Material::CeilingBoards, 1001);
        Room {
            name: self.name.clone(),
            min: self.min,
            max: self.max,
            floor,
            ceiling,
            quarter_turns: self.quarter_turns,
        }
    }

    /// The same for the same piece of wall of look-alikes, however they are turned.
    fn wall_surface(&self, side: u64, ends: &[Vector2<f64>; 2], above_door: u64) -> Surface {
        let corner = self.on_side(side, 0.0).position();
        let nearest_mm = ends.iter().map(|end| ((end - corner).norm() * 1000.0).round() as u64).min();
        let local = (side + 4 - u64::from(self.quarter_turns % 4)) % 4;
        let part = ((local * 2 + above_door) << 20) + nearest_mm.unwrap_or_default();
        self.look.surface(self.look.wall(), part)
    }

    /// Length of a side, counter-clockwise from the one with the least y, and how deep the space is
    /// behind it.
    fn side_length_m(&self, side: u64) -> (f64, f64) {
        let size = self.max - self.min;
        if side.is_multiple_of(2) { (size.x, size.y) } else { (size.y, size.x) }
    }

    /// The pose at a distance along a side, which looks along it; the space is to the left.
    fn on_side(&self, side: u64, along_m: f64) -> Pose {
        let corners =
            [self.min, Vector2::new(self.max.x, self.min.y), self.max, Vector2::new(self.min.x, self.max.y)];
        let corner = corners[(side % 4) as usize];
        Pose::new(corner.x, corner.y, FRAC_PI_2 * (side % 4) as f64).driven(along_m, 0.0)
    }
}

/// Something to put against a wall.
struct Item {
    kind: Kind,
    length_m: f64,
    depth_m: f64,
    height_m: f64,
}

enum Kind {
    Shelf,
    Cabinet,
    Desk,
    Crate,
}

impl Item {
    fn drawn(draws: &mut Draws) -> Self {
        let (kind, length, depth, height) = match draws.below(5) {
            0 | 1 => (Kind::Shelf, (0.8, 1.5), (0.28, 0.36), (1.7, 2.1)),
            2 => (Kind::Cabinet, (0.6, 1.2), (0.38, 0.48), (0.8, 1.4)),
            3 => (Kind::Desk, (1.1, 1.6), (0.6, 0.75), (0.7, 0.78)),
            _ => (Kind::Crate, (0.35, 0.6), (0.3, 0.45), (0.3, 0.9)),
        };
        let mut between = |(low, high): (f64, f64)| draws.between(low, high);
        Self { kind, length_m: between(length), depth_m: between(depth), height_m: between(height) }
    }

    /// Boxes that it is made of.
    fn at_wall(&self, space: &Space, side: u64, along_m: f64, number: u64) -> Vec<Furniture> {
        // A hand's breadth from the wall at most, so that it is not in it.
        let from_wall = self.depth_m / 2.0 + 0.01;
        let look = space.look;
        let part = |material, index: u64| look.surface(material, (number % (1 << 40)) + 2000 + index);
        let piece = |middle: f64, length: f64, [bottom_m, top_m]: [f64; 2], material, index| Furniture {
            pose: space.on_side(side, along_m + middle).compose(&Pose::new(0.0, from_wall, 0.0)),
            size_m: [length, self.depth_m],
            bottom_m,
            top_m,
            sides: part(material, index),
            lid: part(Material::Wood, index + 1),
        };
        let middle = self.length_m / 2.0;
        let length = self.length_m;
        let height = self.height_m;
        match self.kind {
            Kind::Shelf => vec![piece(middle, length, [0.0, height], Material::Bookshelf, 0)],
            Kind::Cabinet => vec![piece(middle, length, [0.0, height], Material::Cabinet, 0)],
            Kind::Crate => vec![piece(middle, length, [0.0, height], Material::Wallpaper, 0)],
            Kind::Desk => vec![
                piece(middle, length, [height - 0.05, height], Material::Wood, 0),
                piece(0.25, 0.42, [0.0, height - 0.05], Material::Cabinet, 2),
                piece(length - 0.03, 0.06, [0.0, height - 0.05], Material::Panelling, 4),
            ],
        }
    }
}
