//! Where frames that never move lie in each other, by `tf_static`.

use std::collections::BTreeMap;

use crate::error::ChoiceError;
use crate::messages::{Pose, Transform};

/// More frames than any robot has.
const MOST_FRAMES: usize = 10_000;

/// A camera's own axes (x where it looks, y to the left, z up) in those of its optical frame (z where it looks, x to the
/// right, y down), by REP-103.
const CAMERA_IN_OPTICAL: Pose = Pose { position_m: [0.0; 3], orientation: [0.5, -0.5, 0.5, 0.5] };

/// The latest transform of each frame to its parent.
#[derive(Clone, Debug, Default)]
pub(crate) struct StaticTransforms {
    parents: BTreeMap<String, (String, Pose)>,
}

impl StaticTransforms {
    pub(crate) fn add(&mut self, transform: Transform) {
        let Transform { stamp_ns: _, parent, child, pose } = transform;
        if let Ok(pose) = pose.checked()
            && (self.parents.len() < MOST_FRAMES || self.parents.contains_key(&child))
        {
            self.parents.insert(child, (parent, pose));
        }
    }

    /// Pose of the camera in the base, x where it looks, by its optical frame. None if nothing joins them.
    pub(crate) fn camera_in(&self, base: &str, optical: &str) -> Result<Option<Pose>, ChoiceError> {
        let (base_root, base_in_root) = self.in_root(base)?;
        let (root, optical_in_root) = self.in_root(optical)?;
        let camera = || in_optical_frame(compose(inverse(base_in_root), optical_in_root));
        Ok((base_root == root).then(camera))
    }

    /// The frame at the end of a frame's way up, and the frame's pose in it.
    fn in_root(&self, frame: &str) -> Result<(String, Pose), ChoiceError> {
        let mut pose = Pose { position_m: [0.0; 3], orientation: [0.0, 0.0, 0.0, 1.0] };
        let mut at = frame.trim_start_matches('/');
        for _ in 0..=self.parents.len() {
            let Some((parent, in_parent)) = self.parents.get(at) else { return Ok((at.to_owned(), pose)) };
            pose = compose(*in_parent, pose);
            at = parent;
        }
        Err(ChoiceError::TransformLoop { frame: at.to_owned() })
    }
}

/// Pose of a camera, x where it looks, by that of its optical frame.
pub(crate) fn in_optical_frame(optical: Pose) -> Pose {
    compose(optical, CAMERA_IN_OPTICAL)
}

/// The product of two quaternions: first the right one, then the left.
fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

fn conjugate([x, y, z, w]: [f64; 4]) -> [f64; 4] {
    [-x, -y, -z, w]
}

fn rotate(orientation: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [x, y, z, _] = product(product(orientation, [x, y, z, 0.0]), conjugate(orientation));
    [x, y, z]
}

fn compose(outer: Pose, inner: Pose) -> Pose {
    let turned = rotate(outer.orientation, inner.position_m);
    let position_m = std::array::from_fn(|axis| outer.position_m[axis] + turned[axis]);
    Pose { position_m, orientation: product(outer.orientation, inner.orientation) }
}

fn inverse(pose: Pose) -> Pose {
    let orientation = conjugate(pose.orientation);
    Pose { position_m: rotate(orientation, pose.position_m).map(|part| -part), orientation }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(parent: &str, child: &str, position_m: [f64; 3], orientation: [f64; 4]) -> Transform {
        let pose = Pose { position_m, orientation };
        Transform { stamp_ns: 0, parent: parent.to_owned(), child: child.to_owned(), pose }
    }

    fn close<const SIZE: usize>(one: [f64; SIZE], other: [f64; SIZE]) -> bool {
        one.iter().zip(other).all(|(one, other)| (one - other).abs() < 1e-12)
    }

    const UNTURNED: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
    /// An optical frame in that of a camera that looks ahead, as every robot description has it.
    const OPTICAL: [f64; 4] = [-0.5, 0.5, -0.5, 0.5];

    fn robot() -> StaticTransforms {
        let mut transforms = StaticTransforms::default();
        transforms.add(joint("base_footprint", "base_link", [0.0, 0.0, 0.1], UNTURNED));
        transforms.add(joint("base_link", "camera", [0.2, 0.0, 0.3], UNTURNED));
        transforms.add(joint("camera", "camera_optical", [0.0; 3], OPTICAL));
        // To the left.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        transforms.add(joint("base_link", "left", [0.0, 0.1, 0.3], [0.0, 0.0, half, half]));
        transforms.add(joint("left", "left_optical", [0.0; 3], OPTICAL));
        transforms
    }

    #[test]
    fn a_camera_that_looks_ahead_is_not_turned() {
        let camera = robot().camera_in("base_link", "/camera_optical").unwrap().unwrap();
        assert!(close(camera.position_m, [0.2, 0.0, 0.3]), "{camera:?}");
        assert!(close(rotate(camera.orientation, [1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]), "{camera:?}");
        assert!(close(rotate(camera.orientation, [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]), "{camera:?}");
        let camera = robot().camera_in("base_footprint", "camera_optical").unwrap().unwrap();
        assert!(close(camera.position_m, [0.2, 0.0, 0.4]), "{camera:?}");
    }

    #[test]
    fn a_camera_that_looks_left_is() {
        let camera = robot().camera_in("base_link", "left_optical").unwrap().unwrap();
        assert!(close(rotate(camera.orientation, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]), "{camera:?}");
    }

    #[test]
    fn what_nothing_joins_has_no_pose_and_circles_are_told() {
        assert_eq!(robot().camera_in("base_link", "elsewhere").unwrap(), None);
        let mut circle = robot();
        circle.add(joint("camera_optical", "base_footprint", [0.0; 3], UNTURNED));
        let told = circle.camera_in("base_link", "camera_optical").unwrap_err().to_string();
        assert!(told.contains("go in a circle"), "{told}");
    }
}
