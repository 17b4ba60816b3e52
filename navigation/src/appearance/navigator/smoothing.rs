//! One heading of many.

use nalgebra::{Rotation2, Vector2};

/// The mean of headings as vectors of length 1, the last one counting most, each turned as the
/// robot has turned since.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothedHeading {
    recency: f64,
    sum: Vector2<f64>,
}

/// Headings that cancel each other out show nowhere.
const LEAST_SUM: f64 = 1e-3;

impl SmoothedHeading {
    /// No headings yet; each weighs `recency`, in [0, 1), times as much as the one after it.
    #[must_use]
    pub fn new(recency: f64) -> Self {
        Self { recency, sum: Vector2::zeros() }
    }

    /// The robot has turned to the left: what was ahead is further to the right now.
    pub fn turn(&mut self, turned_rad: f64) {
        self.sum = Rotation2::new(-turned_rad) * self.sum;
    }

    /// One more heading, from straight ahead to the left.
    pub fn take(&mut self, heading_rad: f64) {
        self.sum = self.sum * self.recency + Vector2::new(heading_rad.cos(), heading_rad.sin());
    }

    /// In (-π, π]; `None` if there was no heading, or they cancel each other out.
    #[must_use]
    pub fn heading_rad(&self) -> Option<f64> {
        (self.sum.norm() > LEAST_SUM).then(|| self.sum.y.atan2(self.sum.x))
    }
}
