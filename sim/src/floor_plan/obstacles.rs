//! What a ray meets, and how far it is to the nearest thing.

use nalgebra::Vector2;

use super::{FloorPlan, Furniture, PlanParts, Wall};
use crate::pose::Pose;

/// Walls and furniture, by the square metres of floor that they touch.
#[derive(Clone, Debug)]
pub(crate) struct Obstacles {
    min: Vector2<f64>,
    columns: usize,
    rows: usize,
    cells: Vec<Vec<Thing>>,
}

/// A wall or a piece of furniture, by its number in the plan's parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Thing {
    Wall(usize),
    Furniture(usize),
}

/// Where a ray meets a thing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    pub(crate) thing: Thing,
    /// The ray is inside from here ...
    pub(crate) enters: f64,
    /// ... to here; the same for a wall. In lengths of the ray's direction.
    pub(crate) leaves: f64,
}

const CELL_M: f64 = 1.0;

impl Obstacles {
    pub(crate) fn new(parts: &PlanParts) -> Self {
        let corners = parts.corners();
        let none = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        let (min, max) = corners.iter().fold(none, |(min, max), point| (min.inf(point), max.sup(point)));
        let (min, max) = (min.add_scalar(-CELL_M / 2.0), max.add_scalar(CELL_M / 2.0));
        let [columns, rows] = [0, 1].map(|axis| ((max[axis] - min[axis]) / CELL_M).ceil() as usize);
        let mut obstacles = Self { min, columns, rows, cells: vec![Vec::new(); columns * rows] };
        for (index, wall) in parts.walls.iter().enumerate() {
            obstacles.insert(Thing::Wall(index), &[wall.from, wall.to]);
        }
        for (index, furniture) in parts.furniture.iter().enumerate() {
            obstacles.insert(Thing::Furniture(index), &furniture.corners());
        }
        obstacles
    }

    /// Puts it into all cells that the rectangle around its corners touches.
    fn insert(&mut self, thing: Thing, corners: &[Vector2<f64>]) {
        let bound = |axis: usize, pick: fn(f64, f64) -> f64, aside: f64| {
            let extreme = corners.iter().map(|corner| corner[axis]).reduce(pick).unwrap_or_default();
            ((extreme + aside - self.min[axis]) / CELL_M) as usize
        };
        let [columns, rows] = [0, 1].map(|axis| bound(axis, f64::min, -1e-6)..=bound(axis, f64::max, 1e-6));
        for row in rows {
            for column in columns.clone() {
                self.cells[row * self.columns + column].push(thing);
            }
        }
    }

    /// Shows `meet` what a ray from `origin` meets, cell by cell in the order of the ray but in any
    /// order within one, until it answers that it has seen enough before some length: cells beyond
    /// are left out.
    pub(crate) fn cast(
        &self,
        parts: &PlanParts,
        origin: Vector2<f64>,
        direction: Vector2<f64>,
        mut meet: impl FnMut(Hit) -> f64,
    ) {
        let start = (origin - self.min) / CELL_M;
        let mut cell = [0, 1].map(|axis| start[axis].floor() as i64);
        // To the next cell border in x and in y, and from border to border.
        let step = [0, 1].map(|axis| if direction[axis] < 0.0 { -1_i64 } else { 1 });
        let between = [0, 1].map(|axis| (CELL_M / direction[axis]).abs());
        let mut border = [0, 1].map(|axis| {
            let ahead = if step[axis] > 0 {
                cell[axis] as f64 + 1.0 - start[axis]
            } else {
                start[axis] - cell[axis] as f64
            };
            if direction[axis] == 0.0 { f64::INFINITY } else { ahead * between[axis] }
        });
        let mut entered = 0.0;
        let mut enough = f64::INFINITY;
        while entered <= enough {
            let (Ok(column), Ok(row)) = (usize::try_from(cell[0]), usize::try_from(cell[1])) else { return };
            if column >= self.columns || row >= self.rows {
                return;
            }
            let axis = usize::from(border[1] < border[0]);
            let left = border[axis];
            for &thing in &self.cells[row * self.columns + column] {
                let hit = match thing {
                    Thing::Wall(index) => parts.walls[index].meets(origin, direction),
                    Thing::Furniture(index) => parts.furniture[index].meets(origin, direction),
                };
                // What lies in several cells counts in the one where the ray meets it.
                if let Some((enters, leaves)) = hit.filter(|hit| entered <= hit.0 && hit.0 < left) {
                    enough = meet(Hit { thing, enters, leaves }).min(enough);
                }
            }
            entered = left;
            border[axis] += between[axis];
            cell[axis] += step[axis];
        }
    }

    /// Metres to the nearest thing that begins below [`FloorPlan::HEADROOM_M`].
    pub(crate) fn distance_m(&self, parts: &PlanParts, point: Vector2<f64>) -> f64 {
        let walls = parts.walls.iter().filter(|wall| wall.bottom_m < FloorPlan::HEADROOM_M);
        let furniture = parts.furniture.iter().filter(|item| item.bottom_m < FloorPlan::HEADROOM_M);
        let distances =
            walls.map(|wall| wall.distance_m(point)).chain(furniture.map(|item| item.distance_m(point)));
        distances.fold(f64::INFINITY, f64::min)
    }
}

impl PlanParts {
    fn corners(&self) -> Vec<Vector2<f64>> {
        let rooms = self.rooms.iter().flat_map(|room| [room.min, room.max]);
        let walls = self.walls.iter().flat_map(|wall| [wall.from, wall.to]);
        rooms.chain(walls).chain(self.furniture.iter().flat_map(Furniture::corners)).collect()
    }
}

impl Wall {
    /// Where a ray meets it.
    fn meets(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> Option<(f64, f64)> {
        let along = self.to - self.from;
        let cross = direction.perp(&along);
        let offset = self.from - origin;
        let at = offset.perp(&along) / cross;
        let share = offset.perp(&direction) / cross;
        (at > 0.0 && (0.0..=1.0).contains(&share)).then_some((at, at))
    }

    fn distance_m(&self, point: Vector2<f64>) -> f64 {
        let along = self.to - self.from;
        let share = ((point - self.from).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        (self.from + along * share - point).norm()
    }
}

impl Furniture {
    /// Its corners seen from above.
    #[must_use]
    pub fn corners(&self) -> [Vector2<f64>; 4] {
        let [x, y] = self.size_m.map(|side| side / 2.0);
        [[x, y], [-x, y], [-x, -y], [x, -y]].map(|[x, y]| self.pose.compose(&Pose::new(x, y, 0.0)).position())
    }

    /// A point and a direction in its own axes.
    pub(crate) fn local(&self, point: Vector2<f64>, direction: Vector2<f64>) -> [Vector2<f64>; 2] {
        let (sin, cos) = self.pose.heading_rad.sin_cos();
        let turned = |v: Vector2<f64>| Vector2::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x);
        [turned(point - self.pose.position()), turned(direction)]
    }

    /// Where a ray comes in and goes out.
    fn meets(&self, origin: Vector2<f64>, direction: Vector2<f64>) -> Option<(f64, f64)> {
        let [origin, direction] = self.local(origin, direction);
        let (mut enters, mut leaves) = (f64::NEG_INFINITY, f64::INFINITY);
        for axis in 0..2 {
            let half = self.size_m[axis] / 2.0;
            if direction[axis] == 0.0 {
                if origin[axis].abs() > half {
                    return None;
                }
                continue;
            }
            let crossings = [-half, half].map(|side| (side - origin[axis]) / direction[axis]);
            enters = f64::max(enters, crossings[0].min(crossings[1]));
            leaves = f64::min(leaves, crossings[0].max(crossings[1]));
        }
        (0.0 < enters && enters < leaves).then_some((enters, leaves))
    }

    fn distance_m(&self, point: Vector2<f64>) -> f64 {
        let [local, _] = self.local(point, Vector2::zeros());
        let outside = Vector2::from_fn(|axis, _| (local[axis].abs() - self.size_m[axis] / 2.0).max(0.0));
        outside.norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worlds::NamedWorld;
    use proptest::prelude::*;

    proptest! {
        /// The grid leaves nothing out: against every thing in turn.
        #[test]
        fn rays_meet_what_is_there(x in 0.5..29.5f64, y in 0.5..19.5f64, angle in -3.2..3.2f64) {
            let plan = NamedWorld::Office.plan(3);
            let (origin, direction) = (Vector2::new(x, y), Vector2::new(angle.cos(), angle.sin()));
            let parts = plan.parts();
            let walls = parts.walls.iter().map(|wall| wall.meets(origin, direction));
            let all = walls.chain(parts.furniture.iter().map(|item| item.meets(origin, direction)));
            let mut expected: Vec<f64> = all.flatten().map(|hit| hit.0).collect();
            let mut found = Vec::new();
            plan.obstacles().cast(parts, origin, direction, |hit| { found.push(hit.enters); f64::INFINITY });
            expected.sort_by(f64::total_cmp);
            found.sort_by(f64::total_cmp);
            prop_assert_eq!(found, expected);
        }
    }
}
