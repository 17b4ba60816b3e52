//! Whole panoramas as a compass: the turn at which two of them correlate best.
//!
//! The rotational image difference of insect navigation (Zeil, Hofmann & Chahl, JOSA A 2003), as a correlation. It needs
//! no features, so panoramas of a hundred columns will do, but both have to be taken from nearly the same place: of the
//! way between them it says nothing.

use std::f64::consts::{PI, TAU};

use crate::image::GreyImage;

/// A panorama that can be turned: cylindrical or equirectangular, columns from left to right.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CompassView {
    size_px: (u32, u32),
    /// Each row twice, so that a turned row is a slice of it.
    rows: Vec<i16>,
    row_sums: Vec<i64>,
    /// Width times the sum of squares of what differs from its row's mean.
    variation: i128,
}

/// How one view is turned against another, and how sure that is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompassReading {
    /// How far the target looks to the left of the current view, in radians from -π to π: what the robot that sees the
    /// current view has to turn to look as the target does.
    pub rotation_rad: f64,
    /// Correlation of the turned images, to a whole column, from -1 to 1.
    pub correlation: f64,
    /// How much better it is than at any turn on another hill of the correlation, from 0 to 2: near 0, more than one turn
    /// explains what is seen.
    pub margin: f64,
}

/// Panoramas of different sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "panoramas of {current:?} and {target:?} pixels cannot be turned onto each other; bring both to one size"
)]
pub struct SizesDiffer {
    /// Columns and rows of the current view.
    pub current: (u32, u32),
    /// Columns and rows of the target.
    pub target: (u32, u32),
}

impl CompassView {
    /// `None` of a panorama that looks the same all around: whichever way a robot looks, it sees that.
    #[must_use]
    pub fn new(panorama: &GreyImage) -> Option<Self> {
        let width = panorama.width() as usize;
        let rows = || panorama.pixels().chunks_exact(width);
        let row_sums: Vec<i64> = rows().map(|row| row.iter().copied().map(i64::from).sum()).collect();
        let squares: i128 = panorama.pixels().iter().map(|&grey| i128::from(grey).pow(2)).sum();
        let variation = width as i128 * squares - product(&row_sums, &row_sums);
        let doubled = rows().flat_map(|row| row.iter().chain(row).copied().map(i16::from));
        let size_px = (panorama.width(), panorama.height());
        (variation > 0).then(|| Self { size_px, rows: doubled.collect(), row_sums, variation })
    }

    /// How the target is turned against this view.
    ///
    /// # Errors
    /// [`SizesDiffer`].
    pub fn read(&self, target: &Self) -> Result<CompassReading, SizesDiffer> {
        let correlations = self.correlations(target)?;
        let width = correlations.len();
        let best = highest(&correlations);
        let [before, at, after] = [width - 1, 0, 1].map(|shift| correlations[(best + shift) % width]);
        let columns = best as f64 + peak_of_parabola([before, at, after]);
        // Seen from further left, everything lies further right.
        let turn_rad = TAU * columns / width as f64;
        let rotation_rad = if turn_rad > PI { turn_rad - TAU } else { turn_rad };
        Ok(CompassReading { rotation_rad, correlation: at, margin: at - best_elsewhere(&correlations, best) })
    }

    /// Correlation of this view with the target, of which a thing lies as many columns further right as the place in the
    /// list tells. What is alike all around says nothing of the turn: rows are taken less their means, and the
    /// correlations of all turns add up to 0.
    ///
    /// # Errors
    /// [`SizesDiffer`].
    pub fn correlations(&self, target: &Self) -> Result<Vec<f64>, SizesDiffer> {
        if self.size_px != target.size_px {
            return Err(SizesDiffer { current: self.size_px, target: target.size_px });
        }
        let width = self.size_px.0 as usize;
        let alike_all_around = product(&self.row_sums, &target.row_sums);
        let norm = (self.variation as f64).sqrt() * (target.variation as f64).sqrt();
        let correlation = |shift: usize| {
            let rows = self.rows.chunks_exact(2 * width).zip(target.rows.chunks_exact(2 * width));
            let products: i64 =
                rows.map(|(row, turned)| dot(&row[..width], &turned[shift..shift + width])).sum();
            (width as i128 * i128::from(products) - alike_all_around) as f64 / norm
        };
        Ok((0..width).map(correlation).collect())
    }
}

/// Greys that are added in 32 bits at a time: so many products of two bytes stay below 2^31.
const LANE: usize = 32_768;

fn dot(left: &[i16], right: &[i16]) -> i64 {
    let lanes = left.chunks(LANE).zip(right.chunks(LANE));
    let in_32_bits = |(left, right): (&[i16], &[i16])| {
        let products = left.iter().zip(right).map(|(&a, &b)| i32::from(a) * i32::from(b));
        i64::from(products.sum::<i32>())
    };
    lanes.map(in_32_bits).sum()
}

fn product(left: &[i64], right: &[i64]) -> i128 {
    left.iter().zip(right).map(|(&a, &b)| i128::from(a) * i128::from(b)).sum()
}

/// The first of the highest.
fn highest(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, index| if values[index] > values[best] { index } else { best })
}

/// Where the parabola through three values one apart is highest, from -½ to ½; the middle one is the highest of them.
fn peak_of_parabola([before, at, after]: [f64; 3]) -> f64 {
    let bend = before - 2.0 * at + after;
    if bend < 0.0 { ((before - after) / (2.0 * bend)).clamp(-0.5, 0.5) } else { 0.0 }
}

/// The highest value around the circle that does not lie on the hill of the best; the lowest if there is no other hill.
fn best_elsewhere(around: &[f64], best: usize) -> f64 {
    let width = around.len();
    let at = |step: usize| around[(best + step) % width];
    let descends = |steps: &[usize; 2]| at(steps[1]) <= at(steps[0]);
    let right = (1..width).take_while(|&step| descends(&[step - 1, step])).count();
    let left = (1..width).take_while(|&step| descends(&[width - step + 1, width - step])).count();
    let elsewhere = (right + 1)..width.saturating_sub(left);
    let lowest = around.iter().copied().fold(f64::INFINITY, f64::min);
    elsewhere.map(at).fold(lowest, f64::max)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use proptest::prelude::*;

    use super::*;
    use crate::panorama::{PanoramicCamera, Projection};

    /// What a robot sees that looks to `heading_rad`, of a world whose brightness is a smooth function of where one looks.
    fn seen(heading_rad: f64, size_px: (u32, u32)) -> GreyImage {
        let camera = PanoramicCamera::new(Projection::Cylindrical, size_px).unwrap();
        let (width, height) = size_px;
        let grey = |index: u32| {
            let ray = camera.ray([f64::from(index % width), f64::from(index / width)]);
            let azimuth = ray.y.atan2(ray.x) + heading_rad;
            let waves = [(1.0, 0.3, 30.0), (2.0, 1.9, 25.0), (5.0, 4.0, 30.0), (9.0, 2.2, 20.0)];
            let light: f64 = waves
                .iter()
                .map(|(count, phase, much)| much * (count * azimuth + phase + 3.0 * ray.z * count).sin())
                .sum();
            (128.0 + light).round() as u8
        };
        GreyImage::new(width, height, (0..width * height).map(grey).collect()).unwrap()
    }

    fn view(heading_rad: f64) -> CompassView {
        CompassView::new(&seen(heading_rad, (120, 25))).unwrap()
    }

    fn wrapped(angle: f64) -> f64 {
        (angle + PI).rem_euclid(TAU) - PI
    }

    #[test]
    fn a_target_that_looks_to_the_left_is_turned_to_the_left() {
        let ahead = view(0.0);
        for (target, rotation) in
            [(FRAC_PI_2, FRAC_PI_2), (-FRAC_PI_2, -FRAC_PI_2), (0.0, 0.0), (2.5, 2.5), (-2.5, -2.5)]
        {
            let reading = ahead.read(&view(target)).unwrap();
            assert!((reading.rotation_rad - rotation).abs() < 0.005, "{target}: {reading:?}");
            assert!(reading.correlation > 0.99 && reading.margin > 0.2, "{target}: {reading:?}");
        }
    }

    #[test]
    fn what_looks_the_same_all_around_is_no_compass() {
        let stripes = (0..120 * 25).map(|index: u32| (index / 120 * 10) as u8).collect();
        assert_eq!(CompassView::new(&GreyImage::new(120, 25, stripes).unwrap()), None);
        assert_eq!(CompassView::new(&GreyImage::new(1, 9, (0..9).collect()).unwrap()), None);
    }

    /// A wallpaper that repeats itself looks the same after every repetition.
    #[test]
    fn what_repeats_itself_leaves_the_turn_open() {
        let wallpaper = (0..120 * 25).map(|index: u32| if index % 30 < 15 { 40 } else { 200 }).collect();
        let wallpaper = CompassView::new(&GreyImage::new(120, 25, wallpaper).unwrap()).unwrap();
        let reading = wallpaper.read(&wallpaper).unwrap();
        assert!(reading.correlation > 0.999 && reading.margin < 1e-9, "{reading:?}");
    }

    #[test]
    fn panoramas_of_different_sizes_are_refused() {
        let other = CompassView::new(&seen(0.0, (60, 25))).unwrap();
        let refused = view(0.0).read(&other).unwrap_err();
        assert_eq!(refused, SizesDiffer { current: (120, 25), target: (60, 25) });
    }

    #[test]
    fn long_bright_rows_do_not_overflow() {
        let bright =
            (0..70_000_u32 * 2).map(|index| if index % 70_000 < 35_000 { 255 } else { 254 }).collect();
        let bright = CompassView::new(&GreyImage::new(70_000, 2, bright).unwrap()).unwrap();
        assert_eq!(dot(&bright.rows[..70_000], &bright.rows[..70_000]), 35_000 * (255 * 255 + 254 * 254));
        // Half of a row differs by one: 70,000 * 2 rows * 70,000 * ¼.
        assert_eq!(bright.variation, 70_000 * 70_000 / 2);
    }

    /// The correlation as it is defined, in f64.
    fn dense(current: &GreyImage, target: &GreyImage, shift: usize) -> f64 {
        let width = current.width() as usize;
        let centred = |image: &GreyImage| -> Vec<Vec<f64>> {
            let rows = image.pixels().chunks_exact(width).map(|row| {
                let mean = row.iter().map(|&grey| f64::from(grey)).sum::<f64>() / width as f64;
                row.iter().map(|&grey| f64::from(grey) - mean).collect()
            });
            rows.collect()
        };
        let (current, target) = (centred(current), centred(target));
        let sum_of = |left: &[Vec<f64>], right: &[Vec<f64>], shift: usize| -> f64 {
            let row = |(left, right): (&Vec<f64>, &Vec<f64>)| -> f64 {
                (0..width).map(|column| left[column] * right[(column + shift) % width]).sum()
            };
            left.iter().zip(right).map(row).sum()
        };
        let norm = sum_of(&current, &current, 0).sqrt() * sum_of(&target, &target, 0).sqrt();
        sum_of(&current, &target, shift) / norm
    }

    fn images() -> impl Strategy<Value = [GreyImage; 2]> {
        (1..24_u32, 1..6_u32).prop_flat_map(|(width, height)| {
            let pixels = || prop::collection::vec(any::<u8>(), (width * height) as usize);
            let image = move |pixels| GreyImage::new(width, height, pixels).unwrap();
            [pixels().prop_map(image), pixels().prop_map(image)]
        })
    }

    proptest! {
        #[test]
        fn correlations_are_those_of_the_definition([current, target] in images()) {
            if let (Some(left), Some(right)) = (CompassView::new(&current), CompassView::new(&target)) {
                let correlations = left.correlations(&right).unwrap();
                for (shift, correlation) in correlations.iter().enumerate() {
                    prop_assert!((correlation - dense(&current, &target, shift)).abs() < 1e-9);
                }
                prop_assert!(correlations.iter().sum::<f64>().abs() < 1e-9);
                let reading = left.read(&right).unwrap();
                prop_assert!(reading.correlation <= 1.0 + 1e-12 && (0.0..=2.0 + 1e-12).contains(&reading.margin));
                prop_assert!(reading.rotation_rad.abs() <= PI + 1e-12);
            }
        }

        #[test]
        fn any_turn_is_found_to_a_fraction_of_a_column(from in -PI..PI, to in -PI..PI) {
            let (current, target) = (view(from), view(to));
            let there = current.read(&target).unwrap().rotation_rad;
            let error_px = wrapped(there - (to - from)) * 120.0 / TAU;
            prop_assert!(error_px.abs() < 0.1, "{error_px} px");
            let back = target.read(&current).unwrap().rotation_rad;
            prop_assert!(wrapped(there + back).abs() < 1e-6);
        }
    }
}
