//! What a building is made of, and where in it there is room.

mod obstacles;

use nalgebra::Vector2;

use crate::pose::Pose;
use crate::texture::Surface;

pub(crate) use obstacles::{Hit, Obstacles, Thing};

/// A building of one storey, seen from above: x and y in metres, heights above the floor.
#[derive(Clone, Debug)]
pub struct FloorPlan {
    parts: PlanParts,
    obstacles: Obstacles,
}

/// What a [`FloorPlan`] is made from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlanParts {
    /// Height of all ceilings, in metres.
    pub ceiling_m: f64,
    /// They must not overlap; outside of them there is nothing to see.
    pub rooms: Vec<Room>,
    /// Walls, and what is above doors.
    pub walls: Vec<Wall>,
    /// Everything that stands about.
    pub furniture: Vec<Furniture>,
    /// Ways from room to room, for those who want to know.
    pub doors: Vec<Door>,
}

/// A rectangle with a floor and a ceiling: a room, or a piece of a corridor.
#[derive(Clone, Debug, PartialEq)]
pub struct Room {
    /// What people call it.
    pub name: String,
    /// Its corner with the smallest coordinates.
    pub min: Vector2<f64>,
    /// Its corner with the largest coordinates.
    pub max: Vector2<f64>,
    /// What one walks on.
    pub floor: Surface,
    /// What one looks up to.
    pub ceiling: Surface,
    /// By how many quarters, counter-clockwise, the patterns of floor and ceiling are turned:
    /// look-alikes may lie in different directions.
    pub quarter_turns: u8,
}

/// A wall without thickness.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Where it starts.
    pub from: Vector2<f64>,
    /// Where it ends.
    pub to: Vector2<f64>,
    /// Where it begins above the floor, in metres: above 0 over a door.
    pub bottom_m: f64,
    /// Where it ends above the floor, in metres.
    pub top_m: f64,
    /// What is to be seen of it from the left and from the right, as one walks from its start to
    /// its end.
    pub surfaces: [Surface; 2],
}

/// A box.
#[derive(Clone, Debug, PartialEq)]
pub struct Furniture {
    /// Where its middle is, and how it is turned.
    pub pose: Pose,
    /// Length along its own x axis and width along its own y axis, in metres.
    pub size_m: [f64; 2],
    /// Where it begins above the floor, in metres.
    pub bottom_m: f64,
    /// Where it ends above the floor, in metres.
    pub top_m: f64,
    /// All around.
    pub sides: Surface,
    /// On top and below.
    pub lid: Surface,
}

/// An opening in a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Door {
    /// Its middle.
    pub position: Vector2<f64>,
    /// Its width in metres.
    pub width_m: f64,
}

/// Why parts make no floor plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FloorPlanError {
    /// Nowhere to be.
    #[error("the plan has no rooms; add one at least")]
    NoRooms,
    /// A ceiling where no robot fits.
    #[error("the ceiling is {ceiling_m} m high; it must be from {} to {} m", FloorPlan::CEILINGS_M.0, FloorPlan::CEILINGS_M.1)]
    Ceiling {
        /// As given.
        ceiling_m: f64,
    },
    /// Something has no size, is larger than any building or leaves the storey.
    #[error(
        "{what} {index} has a length that is not above 0 and at most {} m, or leaves floor or ceiling",
        FloorPlan::MAX_SIDE_M
    )]
    Size {
        /// `room`, `wall`, `furniture` or `door`.
        what: &'static str,
        /// Its number in the parts.
        index: usize,
    },
    /// Two rooms claim the same floor.
    #[error("room {first:?} and room {second:?} overlap; move one of them")]
    Overlap {
        /// A room's name.
        first: String,
        /// Another room's name.
        second: String,
    },
}

impl FloorPlan {
    /// Lowest and highest ceiling, in metres.
    pub const CEILINGS_M: (f64, f64) = (2.0, 10.0);
    /// Longest wall or room, in metres.
    pub const MAX_SIDE_M: f64 = 200.0;
    /// What begins higher than this above the floor is in no one's way, in metres.
    pub const HEADROOM_M: f64 = 1.9;

    /// # Errors
    /// [`FloorPlanError`] if the parts make no building.
    pub fn new(parts: PlanParts) -> Result<Self, FloorPlanError> {
        parts.check()?;
        let obstacles = Obstacles::new(&parts);
        Ok(Self { parts, obstacles })
    }

    /// What it is made of.
    #[must_use]
    pub fn parts(&self) -> &PlanParts {
        &self.parts
    }

    /// Corners with the smallest and the largest coordinates.
    #[must_use]
    pub fn bounds(&self) -> [Vector2<f64>; 2] {
        let rooms = &self.parts.rooms;
        let fold = |pick: fn(&Room) -> Vector2<f64>,
                    join: fn(&Vector2<f64>, &Vector2<f64>) -> Vector2<f64>| {
            rooms.iter().map(pick).reduce(|a, b| join(&a, &b)).unwrap_or_default()
        };
        [fold(|room| room.min, Vector2::inf), fold(|room| room.max, Vector2::sup)]
    }

    /// The room that holds a point.
    #[must_use]
    pub fn room_at(&self, point: Vector2<f64>) -> Option<&Room> {
        self.room_index_at(point).map(|index| &self.parts.rooms[index])
    }

    pub(crate) fn room_index_at(&self, point: Vector2<f64>) -> Option<usize> {
        self.parts.rooms.iter().position(|room| room.contains(point))
    }

    /// The room of that name.
    #[must_use]
    pub fn room(&self, name: &str) -> Option<&Room> {
        self.parts.rooms.iter().find(|room| room.name == name)
    }

    /// Metres from a point to the nearest wall or furniture that would be in a robot's way; 0
    /// inside of furniture and outside of all rooms.
    #[must_use]
    pub fn clearance_m(&self, point: Vector2<f64>) -> f64 {
        if self.room_index_at(point).is_none() { 0.0 } else { self.obstacles.distance_m(&self.parts, point) }
    }

    /// Whether a round robot has room along a straight line.
    #[must_use]
    pub fn is_free_line(&self, from: Vector2<f64>, to: Vector2<f64>, radius_m: f64) -> bool {
        // What touches the capsule is nearer to one of these points than its radius, or by a hair
        // outside of it.
        let steps = ((to - from).norm() / 0.02).ceil().max(1.0);
        (0..=steps as usize)
            .all(|step| self.clearance_m(from + (to - from) * (step as f64 / steps)) >= radius_m)
    }

    pub(crate) fn obstacles(&self) -> &Obstacles {
        &self.obstacles
    }
}

impl PlanParts {
    fn check(&self) -> Result<(), FloorPlanError> {
        let Self { ceiling_m, rooms, walls, furniture, doors } = self;
        if rooms.is_empty() {
            return Err(FloorPlanError::NoRooms);
        }
        if !(FloorPlan::CEILINGS_M.0..=FloorPlan::CEILINGS_M.1).contains(ceiling_m) {
            return Err(FloorPlanError::Ceiling { ceiling_m: *ceiling_m });
        }
        let length = |metres: f64| metres > 0.0 && metres <= FloorPlan::MAX_SIDE_M;
        let heights =
            |bottom: f64, top: f64| bottom >= 0.0 && length(top - bottom) && top <= *ceiling_m + 1e-9;
        let refuse =
            |what, bad: Option<usize>| bad.map_or(Ok(()), |index| Err(FloorPlanError::Size { what, index }));
        refuse(
            "room",
            rooms.iter().position(|room| !(room.max - room.min).iter().all(|&side| length(side))),
        )?;
        refuse(
            "wall",
            walls.iter().position(|wall| {
                !length((wall.to - wall.from).norm()) || !heights(wall.bottom_m, wall.top_m)
            }),
        )?;
        refuse(
            "furniture",
            furniture.iter().position(|item| {
                let Pose { x_m, y_m, heading_rad } = item.pose;
                let placed = [x_m, y_m, heading_rad].iter().all(|number| number.is_finite());
                !placed
                    || !item.size_m.iter().all(|&side| length(side))
                    || !heights(item.bottom_m, item.top_m)
            }),
        )?;
        refuse("door", doors.iter().position(|door| !length(door.width_m)))?;
        self.check_overlaps()
    }

    fn check_overlaps(&self) -> Result<(), FloorPlanError> {
        for (index, first) in self.rooms.iter().enumerate() {
            let shared = |second: &&Room| {
                let common = first.max.inf(&second.max) - first.min.sup(&second.min);
                common.iter().all(|&side| side > 1e-6)
            };
            if let Some(second) = self.rooms[index + 1..].iter().find(shared) {
                let (first, second) = (first.name.clone(), second.name.clone());
                return Err(FloorPlanError::Overlap { first, second });
            }
        }
        Ok(())
    }
}

impl Room {
    /// Where its middle is.
    #[must_use]
    pub fn center(&self) -> Vector2<f64> {
        (self.min + self.max) / 2.0
    }

    /// Length and width of floor and ceiling, along the axes of their patterns.
    pub(crate) fn pattern_size_m(&self) -> [f64; 2] {
        let size = self.max - self.min;
        if self.quarter_turns.is_multiple_of(2) { [size.x, size.y] } else { [size.y, size.x] }
    }

    /// A direction along the axes of the patterns of floor and ceiling.
    pub(crate) fn along_pattern<T: nalgebra::Scalar + std::ops::Neg<Output = T>>(
        &self,
        v: Vector2<T>,
    ) -> Vector2<T> {
        let [x, y] = v.into();
        match self.quarter_turns % 4 {
            0 => Vector2::new(x, y),
            1 => Vector2::new(y, -x),
            2 => Vector2::new(-x, -y),
            _ => Vector2::new(-y, x),
        }
    }

    /// Whether a point is in it; walls belong to the room behind them in x and y.
    #[must_use]
    pub fn contains(&self, point: Vector2<f64>) -> bool {
        (0..2).all(|axis| self.min[axis] <= point[axis] && point[axis] < self.max[axis])
    }
}
