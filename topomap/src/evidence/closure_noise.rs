//! What a loop closure measures.

use nalgebra::{Matrix3, Vector3};
use posegraph::{PlanarPose, Pose};

use super::placement::Placement;
use super::two_view::{TwoView, ViewMotion};
use crate::metric::RelativePose;

/// What a closure measures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosureNoise {
    /// Of the position, in metres, above 0: half the place spacing.
    pub position_m: f64,
    /// Of the heading, in radians, above 0.
    pub heading_rad: f64,
    /// Of the heading where the camera's model is not known, in radians, above 0.
    pub heading_without_camera_rad: f64,
    /// Largest |ln s| of a view that is near enough to measure.
    pub max_ln_scale: f64,
    /// Largest |rotation| of the image, in radians.
    pub max_image_rotation_rad: f64,
    /// Largest shift of the image, in image widths, where the camera's model is not known.
    pub max_shift_without_camera_widths: f64,
}

impl ClosureNoise {
    /// Of places `spacing_m` apart.
    #[must_use]
    pub fn of_spacing(spacing_m: f64) -> Self {
        Self {
            position_m: spacing_m / 2.0,
            heading_rad: 3_f64.to_radians(),
            heading_without_camera_rad: 15_f64.to_radians(),
            max_ln_scale: 0.25,
            max_image_rotation_rad: 0.15,
            max_shift_without_camera_widths: 0.1,
        }
    }

    /// The pose of a robot that is at a place, but too far from where the place was seen for the
    /// image to measure anything: within a few place spacings, looking much the same way.
    #[must_use]
    pub fn somewhere(&self) -> RelativePose {
        let position_m = 4.0 * self.position_m;
        let variances = Vector3::new(position_m, position_m, 2.0 * self.heading_without_camera_rad)
            .map(|deviation| deviation * deviation);
        RelativePose::known(PlanarPose::identity(), Matrix3::from_diagonal(&variances))
    }

    /// The pose of the current view in the earlier one's frame. By structure, where that says it; or
    /// else, if the views are near enough to tell: at the same position, turned by the angle of the image's shift as if only rotation had
    /// moved it. Bazeille et al. 2011, section 3. `focal_length_widths` is the camera's, in image
    /// widths.
    #[must_use]
    pub fn measure(&self, view: &TwoView, focal_length_widths: Option<f64>) -> Option<RelativePose> {
        match view.placement {
            Placement::At { pose, .. } => return Some(pose),
            Placement::Nowhere => return None,
            Placement::Unknown => {}
        }
        let (heading, sigma) = match view.motion? {
            ViewMotion::Similarity(motion) => {
                let near = motion.ln_scale.abs() <= self.max_ln_scale
                    && motion.rotation_rad.abs() <= self.max_image_rotation_rad;
                let shift = motion.translation_widths[0];
                match focal_length_widths.filter(|_| near) {
                    // A robot that has turned left sees things further to the right.
                    Some(focal_length) => ((shift / focal_length).atan(), self.heading_rad),
                    None if near && shift.abs() <= self.max_shift_without_camera_widths => {
                        (0.0, self.heading_without_camera_rad)
                    }
                    None => return None,
                }
            }
            // A camera's y axis points down, so that its turn to the left is one about -y.
            ViewMotion::Essential { rotation, .. } => {
                let matrix = rotation.to_rotation_matrix();
                (matrix[(0, 2)].atan2(matrix[(2, 2)]), self.heading_rad)
            }
            ViewMotion::Fundamental(_) => return None,
        };
        let variances =
            Vector3::new(self.position_m, self.position_m, sigma).map(|deviation| deviation * deviation);
        let pose = PlanarPose::new(0.0, 0.0, heading);
        Some(RelativePose::known(pose, Matrix3::from_diagonal(&variances)))
    }
}

#[cfg(test)]
mod tests;
