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

/// Nearer to obstacles than this beyond its radius, a robot goes out of its way to keep away from
/// them.
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
mod tests;
