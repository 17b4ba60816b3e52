//! A floor plan with all its surfaces painted.

use nalgebra::Vector2;
use rayon::prelude::*;

use crate::floor_plan::{FloorPlan, Furniture, Wall};
use crate::people::Person;
use crate::random::derived_seed;
use crate::texture::{Material, Surface, Texture};

/// All that a camera can see of a building. Painting takes a second or so; looking is cheap.
#[derive(Debug)]
pub struct Scene {
    plan: FloorPlan,
    /// From the left and from the right; `None` where no room is.
    pub(crate) walls: Vec<[Option<Lit>; 2]>,
    pub(crate) furniture: Vec<PaintedBox>,
    pub(crate) rooms: Vec<PaintedRoom>,
    pub(crate) clothes: Vec<Texture>,
}

/// A texture in the light of a room.
#[derive(Debug)]
pub(crate) struct Lit {
    pub(crate) texture: Texture,
    pub(crate) room: usize,
}

#[derive(Debug)]
pub(crate) struct PaintedBox {
    /// All around, counter-clockwise from the right end of the side at -x.
    pub(crate) sides: Lit,
    pub(crate) lid: Texture,
}

#[derive(Debug)]
pub(crate) struct PaintedRoom {
    pub(crate) floor: Texture,
    pub(crate) ceiling: Texture,
}

/// Kinds of clothes; people beyond share them.
const CLOTHES: u64 = 8;

impl Scene {
    /// Paints a plan.
    #[must_use]
    pub fn new(plan: FloorPlan) -> Self {
        let parts = plan.parts();
        let walls = parts.walls.par_iter().map(|wall| paint_wall(&plan, wall)).collect();
        let furniture = parts.furniture.par_iter().map(|item| paint_box(&plan, item)).collect();
        let paint_room = |room: &crate::floor_plan::Room| {
            let [length, width] = room.pattern_size_m();
            let paint = |surface| Texture::paint(surface, length, width);
            PaintedRoom { floor: paint(&room.floor), ceiling: paint(&room.ceiling) }
        };
        let rooms = parts.rooms.par_iter().map(paint_room).collect();
        let cloth =
            |look| Surface::unique(Material::Cloth, derived_seed(0xc107, look), derived_seed(0xc108, look));
        let around_m = std::f64::consts::TAU * Person::RADIUS_M;
        let paint = |look| Texture::paint(&cloth(look), around_m, Person::HEIGHT_M);
        let clothes = (0..CLOTHES).into_par_iter().map(paint).collect();
        Self { walls, furniture, rooms, clothes, plan }
    }

    /// What it was painted from.
    #[must_use]
    pub fn plan(&self) -> &FloorPlan {
        &self.plan
    }
}

fn paint_wall(plan: &FloorPlan, wall: &Wall) -> [Option<Lit>; 2] {
    let along = wall.to - wall.from;
    let left = Vector2::new(-along.y, along.x).normalize() * 1e-3;
    let middle = (wall.from + wall.to) / 2.0;
    [(left, 0), (-left, 1)].map(|(aside, side)| {
        let room = plan.room_index_at(middle + aside)?;
        let texture = Texture::paint(&wall.surfaces[side], along.norm(), wall.top_m - wall.bottom_m);
        Some(Lit { texture, room })
    })
}

fn paint_box(plan: &FloorPlan, item: &Furniture) -> PaintedBox {
    let [length, width] = item.size_m;
    let sides = Texture::paint(&item.sides, 2.0 * (length + width), item.top_m - item.bottom_m);
    let room = plan.room_index_at(item.pose.position()).unwrap_or_default();
    PaintedBox { sides: Lit { texture: sides, room }, lid: Texture::paint(&item.lid, length, width) }
}
