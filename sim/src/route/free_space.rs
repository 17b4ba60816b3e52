//! Shortest ways that are wide enough.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::Vector2;

use super::RouteError;
use crate::floor_plan::FloorPlan;
use crate::random::Draws;

/// Where a round robot can be, on a grid of 10 cm.
#[derive(Clone, Debug)]
pub struct FreeSpace<'a> {
    plan: &'a FloorPlan,
    radius_m: f64,
    min: Vector2<f64>,
    columns: usize,
    /// Metres to the nearest obstacle, row by row.
    clearance_m: Vec<f64>,
}

const CELL_M: f64 = 0.1;

/// Nearer to obstacles than this beyond its radius, a robot goes out of its way to keep away from them.
const COMFORT_M: f64 = 0.25;

impl<'a> FreeSpace<'a> {
    /// Of a robot of that radius; takes some time, so keep it for many ways.
    #[must_use]
    pub fn new(plan: &'a FloorPlan, radius_m: f64) -> Self {
        let [min, max] = plan.bounds();
        let [columns, rows] = [0, 1].map(|axis| ((max[axis] - min[axis]) / CELL_M) as usize + 1);
        let mut space = Self { plan, radius_m, min, columns, clearance_m: Vec::new() };
        space.clearance_m = (0..columns * rows).map(|cell| plan.clearance_m(space.middle(cell))).collect();
        space
    }

    /// A place where the robot fits, anywhere in the building.
    ///
    /// # Errors
    /// [`RouteError::Blocked`] if it fits nowhere.
    pub fn place(&self, seed: u64) -> Result<Vector2<f64>, RouteError> {
        let free: Vec<usize> = (0..self.clearance_m.len()).filter(|&cell| self.is_free(cell)).collect();
        let nowhere = RouteError::Blocked { x_m: self.min.x, y_m: self.min.y };
        free.get(Draws::new(seed).below(free.len())).map(|&cell| self.middle(cell)).ok_or(nowhere)
    }

    fn is_free(&self, cell: usize) -> bool {
        self.clearance_m[cell] >= self.radius_m + CELL_M / 2.0
    }

    /// The shortest way that keeps away from walls, as corners for [`super::Route::through`].
    ///
    /// # Errors
    /// [`RouteError`] if the robot does not fit at one of the ends, or no way is wide enough.
    pub fn shortest_path(
        &self,
        from: Vector2<f64>,
        to: Vector2<f64>,
    ) -> Result<Vec<Vector2<f64>>, RouteError> {
        for end in [from, to] {
            if self.plan.clearance_m(end) < self.radius_m {
                return Err(RouteError::Blocked { x_m: end.x, y_m: end.y });
            }
        }
        let unreachable = RouteError::Unreachable { from: from.into(), to: to.into() };
        let [start, goal] = [from, to].map(|end| self.nearest_free(end));
        let (start, goal) = (start.ok_or(unreachable)?, goal.ok_or(unreachable)?);
        let came_from = self.search(start, goal).ok_or(unreachable)?;
        let mut cells = vec![goal];
        while let Some(&cell) = cells.last().filter(|&&cell| cell != start) {
            cells.push(came_from[cell]);
        }
        let mut way = vec![to];
        way.extend(cells.into_iter().map(|cell| self.middle(cell)));
        way.push(from);
        way.reverse();
        Ok(self.pulled_tight(&way))
    }

    /// Dijkstra's search; for each cell that it has seen, the one before it.
    fn search(&self, start: usize, goal: usize) -> Option<Vec<usize>> {
        let mut came_from = vec![usize::MAX; self.clearance_m.len()];
        let mut cost = vec![u64::MAX; self.clearance_m.len()];
        let mut queue = BinaryHeap::from([Reverse((0, start))]);
        cost[start] = 0;
        while let Some(Reverse((so_far, cell))) = queue.pop() {
            if cell == goal {
                return Some(came_from);
            }
            if so_far > cost[cell] {
                continue;
            }
            for (next, length) in self.neighbours(cell) {
                let discomfort = ((self.radius_m + COMFORT_M - self.clearance_m[next]) / COMFORT_M).max(0.0);
                // In whole numbers, so that equal costs are equal.
                let total = so_far + (length * (1.0 + 3.0 * discomfort)) as u64;
                if total < cost[next] {
                    (cost[next], came_from[next]) = (total, cell);
                    queue.push(Reverse((total, next)));
                }
            }
        }
        None
    }

    /// The free ones of the eight cells around one, and how far it is to them, in 1/1000 of a cell.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = (usize, f64)> {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let rows = self.clearance_m.len() / self.columns;
        let around = (row.saturating_sub(1)..=(row + 1).min(rows - 1)).flat_map(move |next_row| {
            let columns = column.saturating_sub(1)..=(column + 1).min(self.columns - 1);
            columns.map(move |next_column| (next_column, next_row))
        });
        around.filter(move |&next| next != (column, row)).filter_map(move |(next_column, next_row)| {
            let next = next_row * self.columns + next_column;
            let length = if next_column == column || next_row == row { 1000.0 } else { 1414.0 };
            self.is_free(next).then_some((next, length))
        })
    }

    /// Leaves out corners where the straight line is free.
    fn pulled_tight(&self, way: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut corners = vec![way[0]];
        let mut at = 0;
        while at + 1 < way.len() {
            let roomy = self.radius_m + 0.1;
            let is_free = |&to: &usize| self.plan.is_free_line(way[at], way[to], roomy);
            // Further ones may be in sight again behind a corner; the first gap is far enough.
            at = (at + 2..way.len()).take_while(is_free).last().unwrap_or(at + 1);
            corners.push(way[at]);
        }
        corners
    }

    fn middle(&self, cell: usize) -> Vector2<f64> {
        self.min + Vector2::new((cell % self.columns) as f64, (cell / self.columns) as f64) * CELL_M
    }

    fn nearest_free(&self, point: Vector2<f64>) -> Option<usize> {
        let free = (0..self.clearance_m.len()).filter(|&cell| self.is_free(cell));
        let gap = |cell: usize| (self.middle(cell) - point).norm();
        free.min_by(|&a, &b| gap(a).total_cmp(&gap(b))).filter(|&cell| gap(cell) < 3.0 * CELL_M)
    }
}

#[cfg(test)]
mod tests {
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
                assert!(
                    pieces.into_iter().all(|pair| plan.is_free_line(pair[0], pair[1], 0.2)),
                    "{}",
                    room.name
                );
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
                    let route =
                        route.unwrap_or_else(|error| panic!("{} {}: {error}", world.name(), named.name));
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
}
