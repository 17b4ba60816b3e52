//! What lies in the plane of one column.

use std::cell::Cell;

use nalgebra::Vector2;

use super::Shot;
use crate::camera::{ColumnRay, RowSlope};
use crate::floor_plan::{Furniture, Hit, Room, Thing, Wall};
use crate::people::Person;
use crate::pose::Pose;
use crate::scene::{PaintedRoom, Scene};
use crate::texture::{Footprint, Texture};

/// Everything that a column's plane cuts, nearest first; all heights above the camera, all ways in
/// lengths of the ray.
pub(super) struct Slabs<'a> {
    scene: &'a Scene,
    shot: &'a Shot,
    slabs: Vec<Slab<'a>>,
    origin: Vector2<f32>,
    direction: Vector2<f32>,
    step: Vector2<f32>,
    floor: f32,
    ceiling: f32,
    /// Of the last point of a floor or ceiling that was looked up.
    room: Cell<usize>,
}

/// The part of the plane that a thing takes: a rectangle.
struct Slab<'a> {
    enters: f32,
    leaves: f32,
    bottom: f32,
    top: f32,
    brightness: f32,
    side: &'a Texture,
    /// Where on the side the ray meets it, and how far off the next column's does, in metres.
    side_x_m: f32,
    side_step_m: f32,
    lid: Option<Lid<'a>>,
}

/// Top and bottom of a box, with the ray in the axes of its texture.
struct Lid<'a> {
    texture: &'a Texture,
    brightness: f32,
    origin: Vector2<f32>,
    direction: Vector2<f32>,
    step: Vector2<f32>,
}

impl Scene {
    pub(super) fn slabs<'a>(
        &'a self,
        view: &Pose,
        ray: ColumnRay,
        shot: &'a Shot,
        height_m: f32,
    ) -> Slabs<'a> {
        let (sin, cos) = view.heading_rad.sin_cos();
        let turned = |v: Vector2<f64>| Vector2::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y);
        let origin = view.position();
        let ray = ColumnRay { direction: turned(ray.direction), step: turned(ray.step) };
        let parts = self.plan().parts();
        let mut slabs = Vec::new();
        for person in &shot.people {
            self.meet_person(person, origin, ray, shot, &mut slabs);
        }
        self.plan().obstacles().cast(parts, origin, ray.direction, |hit| {
            let slab = match hit.thing {
                Thing::Wall(index) => self.meet_wall(index, &parts.walls[index], origin, ray, shot, hit),
                Thing::Furniture(index) => {
                    Some(self.meet_furniture(index, &parts.furniture[index], origin, ray, shot, hit))
                }
            };
            let hides_all = slab
                .as_ref()
                .is_some_and(|slab| slab.bottom <= 0.0 && f64::from(slab.top) >= parts.ceiling_m - 1e-6);
            slabs.extend(slab);
            if hides_all { hit.enters } else { f64::INFINITY }
        });
        for slab in &mut slabs {
            (slab.bottom, slab.top) = (slab.bottom - height_m, slab.top - height_m);
        }
        slabs.sort_by(|a, b| a.enters.total_cmp(&b.enters));
        Slabs {
            scene: self,
            shot,
            slabs,
            origin: origin.cast(),
            direction: ray.direction.cast(),
            step: ray.step.cast(),
            floor: -height_m,
            ceiling: parts.ceiling_m as f32 - height_m,
            room: Cell::new(0),
        }
    }

    fn meet_wall<'a>(
        &'a self,
        index: usize,
        wall: &Wall,
        origin: Vector2<f64>,
        ray: ColumnRay,
        shot: &Shot,
        hit: Hit,
    ) -> Option<Slab<'a>> {
        let along = wall.to - wall.from;
        let side = usize::from(along.perp(&(origin - wall.from)) < 0.0);
        let lit = self.walls[index][side].as_ref()?;
        let length = along.norm();
        let from_start = (ray.direction * hit.enters + origin - wall.from).dot(&along) / length;
        let left = Vector2::new(-along.y, along.x) / length;
        let normal = if side == 0 { left } else { -left };
        Some(Slab {
            enters: hit.enters as f32,
            leaves: hit.leaves as f32,
            bottom: wall.bottom_m as f32,
            top: wall.top_m as f32,
            brightness: brightness(shot, lit.room, normal),
            side: &lit.texture,
            // Seen from the left side, the start is to the right.
            side_x_m: (if side == 0 { length - from_start } else { from_start }) as f32,
            side_step_m: step_along(ray, normal, hit.enters),
            lid: None,
        })
    }

    fn meet_furniture<'a>(
        &'a self,
        index: usize,
        item: &Furniture,
        origin: Vector2<f64>,
        ray: ColumnRay,
        shot: &Shot,
        hit: Hit,
    ) -> Slab<'a> {
        let painted = &self.furniture[index];
        let half = item.size_m.map(|side| side / 2.0);
        let [local_origin, direction] = item.local(origin, ray.direction);
        let [_, step] = item.local(origin, ray.step);
        let at = local_origin + direction * hit.enters;
        // On the side whose plane is the nearest.
        let axis = usize::from((half[1] - at.y.abs()).abs() < (half[0] - at.x.abs()).abs());
        let [length, width] = item.size_m;
        // Sides from left to right as seen from outside, one after the other.
        let (normal, side_x_m) = match (axis, at[axis] > 0.0) {
            (0, true) => (Vector2::x(), at.y + half[1]),
            (0, false) => (-Vector2::x(), width + length + half[1] - at.y),
            (_, true) => (Vector2::y(), width + half[0] - at.x),
            (_, false) => (-Vector2::y(), 2.0 * width + length + at.x + half[0]),
        };
        let local_ray = ColumnRay { direction, step };
        let (sin, cos) = item.pose.heading_rad.sin_cos();
        let world_normal = Vector2::new(cos * normal.x - sin * normal.y, sin * normal.x + cos * normal.y);
        let room = painted.sides.room;
        Slab {
            enters: hit.enters as f32,
            leaves: hit.leaves as f32,
            bottom: item.bottom_m as f32,
            top: item.top_m as f32,
            brightness: brightness(shot, room, world_normal),
            side: &painted.sides.texture,
            side_x_m: side_x_m as f32,
            side_step_m: step_along(local_ray, normal, hit.enters),
            lid: Some(Lid {
                texture: &painted.lid,
                brightness: shot.light.lamp(room),
                origin: (local_origin + Vector2::from(half)).cast(),
                direction: direction.cast(),
                step: step.cast(),
            }),
        }
    }

    fn meet_person<'a>(
        &'a self,
        person: &Person,
        origin: Vector2<f64>,
        ray: ColumnRay,
        shot: &Shot,
        slabs: &mut Vec<Slab<'a>>,
    ) {
        let parts = [
            (Person::RADIUS_M, 0.0, Person::SHOULDER_M),
            (Person::HEAD_RADIUS_M, Person::SHOULDER_M, Person::HEIGHT_M),
        ];
        for (radius, bottom, top) in parts {
            let offset = origin - person.pose.position();
            let square = ray.direction.norm_squared();
            let half = offset.dot(&ray.direction) / square;
            let inside = half * half - (offset.norm_squared() - radius * radius) / square;
            let (enters, leaves) = (-half - inside.max(0.0).sqrt(), -half + inside.max(0.0).sqrt());
            if inside <= 0.0 || enters <= 0.0 {
                continue;
            }
            let normal = (offset + ray.direction * enters) / radius;
            let turn = crate::pose::wrapped(normal.y.atan2(normal.x) - person.pose.heading_rad);
            let room = self.plan().room_index_at(person.pose.position()).unwrap_or_default();
            slabs.push(Slab {
                enters: enters as f32,
                leaves: leaves as f32,
                bottom: bottom as f32,
                top: top as f32,
                brightness: brightness(shot, room, normal),
                side: &self.clothes[(person.look % self.clothes.len() as u64) as usize],
                side_x_m: ((turn + std::f64::consts::PI) * radius) as f32,
                side_step_m: step_along(ray, normal, enters),
                lid: None,
            });
        }
    }
}

/// How far along a surface the next column's ray meets it, in metres; at a glancing angle no more
/// than 16 times as far as straight on.
fn step_along(ray: ColumnRay, normal: Vector2<f64>, enters: f64) -> f32 {
    let facing = (ray.direction.dot(&normal) / ray.direction.norm()).abs();
    let across = ray.step.perp(&ray.direction).abs() / ray.direction.norm();
    (enters * across / facing.max(1.0 / 16.0)) as f32
}

fn brightness(shot: &Shot, room: usize, normal: Vector2<f64>) -> f32 {
    let settings = shot.light.settings();
    let towards = Vector2::new(settings.from_rad.cos(), settings.from_rad.sin());
    shot.light.lamp(room) * (1.0 + settings.directed * normal.dot(&towards)) as f32
}

impl Slabs<'_> {
    /// The light that comes from the first surface along a row's slope; none from outside of all
    /// rooms.
    pub(super) fn light(&self, row: RowSlope) -> f32 {
        let level = if row.slope < 0.0 { self.floor } else { self.ceiling };
        let beyond = if row.slope == 0.0 { f32::INFINITY } else { level / row.slope };
        let mut nearest = beyond;
        let mut lid = None;
        for slab in &self.slabs {
            if slab.enters >= nearest {
                break;
            }
            let height = slab.enters * row.slope;
            if (slab.bottom..=slab.top).contains(&height) {
                return slab.side_light(height, row);
            }
            let level = if height > slab.top { slab.top } else { slab.bottom };
            let at = level / row.slope;
            if at > slab.enters && at < slab.leaves.min(nearest) && slab.lid.is_some() {
                (nearest, lid) = (at, slab.lid.as_ref());
            }
        }
        match lid {
            Some(lid) => lid.light(nearest, row),
            None => self.room_light(nearest, row),
        }
    }

    fn room_light(&self, at: f32, row: RowSlope) -> f32 {
        let point: Vector2<f64> = (self.origin + self.direction * at).cast();
        let rooms: &[Room] = &self.scene.plan().parts().rooms;
        // Mostly that of the row before.
        let mut index = self.room.get();
        if !rooms[index].contains(point) {
            let Some(found) = self.scene.plan().room_index_at(point) else { return 0.0 };
            self.room.set(found);
            index = found;
        }
        let room = &rooms[index];
        let PaintedRoom { floor, ceiling } = &self.scene.rooms[index];
        let texture = if row.slope < 0.0 { floor } else { ceiling };
        let place: Vector2<f32> =
            (room.along_pattern(point - room.center()) + Vector2::from(room.pattern_size_m()) / 2.0).cast();
        let [direction, step] = [self.direction, self.step].map(|vector| room.along_pattern(vector));
        let footprint = lying(direction, step, at, row);
        texture.sample(place.x, place.y, &footprint) * self.shot.light.lamp(index)
    }
}

impl Slab<'_> {
    fn side_light(&self, height: f32, row: RowSlope) -> f32 {
        let down = self.enters * row.step;
        let footprint = if self.side_step_m > down {
            Footprint { major_m: [self.side_step_m, 0.0], minor_m: down }
        } else {
            Footprint { major_m: [0.0, down], minor_m: self.side_step_m }
        };
        self.side.sample(self.side_x_m, self.top - height, &footprint) * self.brightness
    }
}

impl Lid<'_> {
    fn light(&self, at: f32, row: RowSlope) -> f32 {
        let place = self.origin + self.direction * at;
        self.texture.sample(place.x, place.y, &lying(self.direction, self.step, at, row)) * self.brightness
    }
}

/// What a pixel sees of a level surface: long along the ray, and as wide as columns are apart.
fn lying(direction: Vector2<f32>, step: Vector2<f32>, at: f32, row: RowSlope) -> Footprint {
    let along = direction * (at * row.step / row.slope.abs());
    let across = step * at;
    let (length, width) = (along.norm(), across.norm());
    let (major, minor_m) = if length > width { (along, width) } else { (across, length) };
    Footprint { major_m: [major.x, major.y], minor_m }
}
