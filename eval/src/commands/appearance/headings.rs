//! How well two panoramas tell where the one was taken, seen from the other.

use std::f64::consts::{FRAC_PI_2, PI};

use anyhow::{Context, Result};
use nalgebra::Vector2;
use rayon::prelude::*;
use serde::Serialize;
use waypost_sim::floor_plan::{FloorPlan, Room};
use waypost_sim::pose::{Pose, wrapped};
use waypost_sim::scene::Scene;
use waypost_sim::worlds::NamedWorld;
use waypost_vision::panorama::PanoramicView;

use super::eye::Eye;
use crate::plots::{self, HeadingErrors};
use crate::timing::root_mean_square;

/// From position to position of the grid, in metres.
const SPACING_M: f64 = 1.0;

/// Classes of the histogram, [`CLASS_RAD`] wide each, with 0 in the middle of the middle one.
pub(crate) const CLASSES: usize = 61;

/// Width of a class of the histogram, in radians.
pub(crate) const CLASS_RAD: f64 = 0.01;

/// Standard deviation of the heading's error in a real room of about this size: Booij, Terwijn, Zivkovic and Kröse, ICRA
/// 2007, figure 3.
const PUBLISHED_STD_RAD: f64 = 0.31;

/// Errors of headings, over all grids.
#[derive(Serialize)]
pub(crate) struct HeadingFigures {
    /// Grids, each in a building of its own.
    pub grids: usize,
    /// Ordered pairs of images from different positions.
    pub pairs: usize,
    /// Pairs that no motion joins.
    pub without_heading: usize,
    /// Root mean square of the error, in radians, over all others.
    pub heading_error_std_rad: f64,
    /// Median of its size, in radians.
    pub heading_error_median_rad: f64,
    /// Largest, in radians.
    pub heading_error_max_rad: f64,
    /// Root mean square of the rotation's error, in radians.
    pub rotation_error_std_rad: f64,
    /// Errors by class of 0.01 rad, 0 in the middle of the middle one.
    pub histogram: Vec<usize>,
    /// Errors beyond its outermost classes.
    pub outside_histogram: usize,
}

/// Positions and views of a grid.
struct Grid {
    poses: Vec<Pose>,
    views: Vec<PanoramicView>,
}

/// Measures grids of 3 x 3 positions, 2 m wide, with 4 orientations each.
pub(crate) fn measure(eye: &Eye, seeds: &[u64]) -> Result<HeadingFigures> {
    let grids = seeds.iter().map(|&seed| Grid::new(eye, seed)).collect::<Result<Vec<_>, _>>()?;
    let found: Vec<Option<[f64; 2]>> = grids
        .iter()
        .flat_map(|grid| grid.pairs().map(move |pair| (grid, pair)))
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(grid, [current, target])| {
            let compared = grid.views[current].compare(&grid.views[target], &eye.search);
            let motion = compared.overlap?.motion;
            let truth = grid.poses[current].relative(&grid.poses[target]);
            let heading = truth.y_m.atan2(truth.x_m);
            let rotation = motion.rotation_rad() - truth.heading_rad;
            Some([wrapped(motion.heading_rad() - heading), wrapped(rotation)])
        })
        .collect();
    let errors: Vec<[f64; 2]> = found.iter().flatten().copied().collect();
    let of = |which: usize| errors.iter().map(move |error| error[which]).collect::<Vec<f64>>();
    let mut sizes: Vec<f64> = of(0).iter().map(|error| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let histogram = histogram(&of(0));
    Ok(HeadingFigures {
        grids: grids.len(),
        pairs: found.len(),
        without_heading: found.len() - errors.len(),
        heading_error_std_rad: root_mean_square(&of(0)),
        heading_error_median_rad: sizes.get(sizes.len() / 2).copied().unwrap_or(PI),
        heading_error_max_rad: sizes.last().copied().unwrap_or(PI),
        rotation_error_std_rad: root_mean_square(&of(1)),
        outside_histogram: errors.len() - histogram.iter().sum::<usize>(),
        histogram,
    })
}

/// The histogram as one file of SVG.
pub(crate) fn svg(figures: &HeadingFigures) -> Result<String> {
    plots::heading_errors_svg(&HeadingErrors {
        classes: &figures.histogram,
        class_rad: CLASS_RAD,
        outside: figures.outside_histogram,
        without_heading: figures.without_heading,
        std_rad: figures.heading_error_std_rad,
        published_std_rad: PUBLISHED_STD_RAD,
    })
}

fn histogram(errors_rad: &[f64]) -> Vec<usize> {
    let mut classes = vec![0; CLASSES];
    for error in errors_rad {
        let class = (error / CLASS_RAD).round() + (CLASSES / 2) as f64;
        if (0.0..CLASSES as f64).contains(&class) {
            classes[class as usize] += 1;
        }
    }
    classes
}

impl Grid {
    fn new(eye: &Eye, seed: u64) -> Result<Self> {
        let plan = NamedWorld::Office.plan(seed);
        let center = plan.parts().rooms.iter().find_map(|room| roomy(&plan, room));
        let center = center.with_context(|| {
            format!("building {seed} has no room for a grid of images; take another seed")
        })?;
        let poses: Vec<Pose> = offsets()
            .flat_map(|offset| {
                let at = center + offset;
                (0..4).map(move |quarter| Pose::new(at.x, at.y, FRAC_PI_2 * f64::from(quarter) + 0.2))
            })
            .collect();
        let scene = Scene::new(plan);
        let views = eye.see_all(&scene, &poses, seed)?;
        Ok(Self { poses, views })
    }

    /// Current and target, from different positions.
    fn pairs(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let all = (0..self.poses.len())
            .flat_map(|current| (0..self.poses.len()).map(move |target| [current, target]));
        all.filter(|[current, target]| {
            self.poses[*current].distance_m(&self.poses[*target]) > SPACING_M / 2.0
        })
    }
}

fn offsets() -> impl Iterator<Item = Vector2<f64>> {
    (-1..=1).flat_map(|x| (-1..=1).map(move |y| SPACING_M * Vector2::new(f64::from(x), f64::from(y))))
}

/// Where in a room the grid finds place, if it does.
fn roomy(plan: &FloorPlan, room: &Room) -> Option<Vector2<f64>> {
    let steps = |low: f64, high: f64| {
        (1..).map(move |step| low + 0.1 * f64::from(step)).take_while(move |&at| at < high)
    };
    let places = steps(room.min.x, room.max.x)
        .flat_map(|x| steps(room.min.y, room.max.y).map(move |y| Vector2::new(x, y)));
    let has_place = |center: &Vector2<f64>| {
        offsets().all(|offset| room.contains(center + offset) && plan.clearance_m(center + offset) >= 0.25)
    };
    places.into_iter().find(has_place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_off_further_than_the_classes_reach_is_in_none() {
        let classes = histogram(&[0.0, 0.004, -0.006, 0.302, -0.31, 3.1]);
        let counted: Vec<(usize, usize)> =
            classes.into_iter().enumerate().filter(|class| class.1 > 0).collect();
        assert_eq!(counted, [(CLASSES / 2 - 1, 1), (CLASSES / 2, 2), (CLASSES - 1, 1)]);
    }
}
