//! From pixels to rays.

use nalgebra::Complex;

use crate::features::Keypoint;

/// A perspective camera, in pixels of the image that the keypoints are in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal lengths in x and y.
    pub focal_px: [f64; 2],
    /// Where the optical axis meets the image.
    pub center_px: [f64; 2],
    /// How its lens bends rays.
    pub distortion: Distortion,
}

impl Pinhole {
    /// Focal length in x of images of `width_px`, in image widths.
    #[must_use]
    pub fn focal_length_widths(&self, width_px: u32) -> f64 {
        self.focal_px[0] / f64::from(width_px)
    }
}

/// How a lens moves points away from where a pinhole would put them: D. C. Brown, Decentering
/// Distortion of Lenses, Photogrammetric Engineering 32(3), 1966, with the coefficients' names as
/// in OpenCV.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// k1, k2, k3.
    pub radial: [f64; 3],
    /// p1, p2.
    pub tangential: [f64; 2],
}

/// Steps in which a ray is found at most. Lenses that are no fisheyes take five.
const MAX_STEPS: usize = 30;

/// How far, in focal lengths, the pixel of a ray may lie from the one that it was found for.
const TOLERANCE: f64 = 1e-6;

impl Pinhole {
    /// A camera without distortion.
    #[must_use]
    pub const fn ideal(focal_px: [f64; 2], center_px: [f64; 2]) -> Self {
        Self { focal_px, center_px, distortion: Distortion { radial: [0.0; 3], tangential: [0.0; 2] } }
    }

    /// A camera with square pixels that looks through the middle of an image of that width and
    /// height, and sees `horizontal_rad` from its left to its right edge.
    #[must_use]
    pub fn of_field_of_view(horizontal_rad: f64, (width_px, height_px): (u32, u32)) -> Self {
        let (width, height) = (f64::from(width_px), f64::from(height_px));
        let focal_px = width / 2.0 / (horizontal_rad / 2.0).tan();
        Self::ideal([focal_px; 2], [(width - 1.0) / 2.0, (height - 1.0) / 2.0])
    }

    /// The same camera, where images of width and height `from` were made `to`.
    #[must_use]
    pub fn resized(&self, from: (u32, u32), to: (u32, u32)) -> Self {
        let factors = [f64::from(to.0) / f64::from(from.0), f64::from(to.1) / f64::from(from.1)];
        // Images are scaled about their corner, half a pixel away from the centre of pixel 0.
        let center = |axis: usize| (self.center_px[axis] + 0.5) * factors[axis] - 0.5;
        Self {
            focal_px: [0, 1].map(|axis| self.focal_px[axis] * factors[axis]),
            center_px: [0, 1].map(center),
            distortion: self.distortion,
        }
    }

    /// The ray of a keypoint, as the point that it passes at depth 1: x + iy, to the right and
    /// down. Not finite where no ray ends at that pixel.
    pub(crate) fn ray(&self, keypoint: &Keypoint) -> Complex<f64> {
        let at = |pixel: f32, axis: usize| (f64::from(pixel) - self.center_px[axis]) / self.focal_px[axis];
        self.distortion.undo(Complex::new(at(keypoint.x_px, 0), at(keypoint.y_px, 1)))
    }
}

impl Distortion {
    /// Where a point at depth 1 is projected.
    pub(crate) fn apply(&self, point: Complex<f64>) -> Complex<f64> {
        point * self.radial_factor(point) + self.tangential_shift(point)
    }

    /// The point that is projected there, by Newton's method. Not finite if there is none on this
    /// side of where the lens folds the image over.
    fn undo(&self, distorted: Complex<f64>) -> Complex<f64> {
        if *self == Self::default() {
            return distorted;
        }
        let mut point = distorted;
        for _ in 0..MAX_STEPS {
            let off = self.apply(point) - distorted;
            let [xx, xy, yy] = self.slope(point);
            let step =
                Complex::new(yy * off.re - xy * off.im, xx * off.im - xy * off.re) / (xx * yy - xy * xy);
            point -= step;
            if step.norm() <= TOLERANCE * TOLERANCE {
                break;
            }
        }
        let [xx, xy, yy] = self.slope(point);
        let unfolded = xx * yy > xy * xy && self.radial_factor(point) > 0.0;
        let found = unfolded && (self.apply(point) - distorted).norm() <= TOLERANCE;
        if found { point } else { Complex::new(f64::NAN, f64::NAN) }
    }

    /// Derivatives of x' by x, of x' by y (which is that of y' by x), and of y' by y.
    fn slope(&self, point: Complex<f64>) -> [f64; 3] {
        let (Complex { re: x, im: y }, square) = (point, point.norm_sqr());
        let ([k1, k2, k3], [p1, p2]) = (self.radial, self.tangential);
        let (factor, growth) =
            (self.radial_factor(point), 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3)));
        [
            factor + growth * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
            growth * x * y + 2.0 * (p1 * x + p2 * y),
            factor + growth * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
        ]
    }

    fn radial_factor(&self, point: Complex<f64>) -> f64 {
        let (square, [k1, k2, k3]) = (point.norm_sqr(), self.radial);
        1.0 + square * (k1 + square * (k2 + square * k3))
    }

    fn tangential_shift(&self, point: Complex<f64>) -> Complex<f64> {
        let (Complex { re: x, im: y }, [p1, p2], square) = (point, self.tangential, point.norm_sqr());
        Complex::new(
            2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Lenses as calibrations give them, over a view of 90 degrees and more.
        #[test]
        fn undoing_finds_the_ray(
            [k1, k2, k3] in [-0.25..0.3f64, -0.02..0.1, -0.005..0.01], [p1, p2] in [-0.003..0.003f64, -0.003..0.003],
            [x, y] in [-1.0..1.0f64, -0.6..0.6],
        ) {
            let distortion = Distortion { radial: [k1, k2, k3], tangential: [p1, p2] };
            // Beyond where the lens folds the image over, two rays come to one pixel.
            let slope = |r2: f64| 1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3));
            prop_assume!((0..=20).all(|step| slope(f64::from(step) / 10.0) > 0.3));
            let point = Complex::new(x, y);
            let found = distortion.undo(distortion.apply(point));
            prop_assert!((found - point).norm() < 1e-4, "{found}, not {point}");
        }

        /// A ray keeps its direction whatever size its image is given.
        #[test]
        fn a_resized_camera_sees_the_same(x in 0..640u16, y in 0..480u16, factor in 1..5u32) {
            let camera = Pinhole { distortion: Distortion { radial: [0.1, 0.0, 0.0], tangential: [0.001; 2] },
                ..Pinhole::ideal([500.0, 490.0], [310.0, 250.0]) };
            let resized = camera.resized((640, 480), (640 * factor, 480 * factor));
            let at = |factor: f32| Keypoint {
                x_px: (f32::from(x) + 0.5) * factor - 0.5, y_px: (f32::from(y) + 0.5) * factor - 0.5,
                size_px: 1.0, angle_rad: 0.0, response: 0.0,
            };
            prop_assert!((camera.ray(&at(1.0)) - resized.ray(&at(factor as f32))).norm() < 1e-5);
        }
    }

    #[test]
    fn the_edges_of_a_field_of_view_are_its_angle_apart() {
        let camera = Pinhole::of_field_of_view(1.2, (640, 480));
        let at = |x_px| Keypoint { x_px, y_px: 239.5, size_px: 1.0, angle_rad: 0.0, response: 0.0 };
        let [left, right] = [-0.5, 639.5].map(|x_px| camera.ray(&at(x_px)).re.atan());
        assert!((right - left - 1.2).abs() < 1e-9);
    }

    #[test]
    fn a_pixel_that_no_ray_comes_to_has_none() {
        // 1 - r² takes no ray further than 0.385 from the axis.
        let distortion = Distortion { radial: [-1.0, 0.0, 0.0], tangential: [0.0; 2] };
        assert!(!distortion.undo(Complex::new(0.6, 0.0)).is_finite());
        assert!(distortion.undo(Complex::new(0.3, 0.0)).is_finite());
    }
}
