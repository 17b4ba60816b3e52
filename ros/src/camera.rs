//! What is declared of the camera, once the robot has told enough of it.

use std::time::{Duration, Instant};

use waypost_bags::{Camera, CameraInfo, ChoiceError, Intrinsics, Lens, Pose, Undeclared, live::Mountings};
use waypost_client::v1;

/// Latched transforms come with the first contact: after this time there are none.
const MOUNTING_PATIENCE: Duration = Duration::from_secs(10);
/// The base where odometry does not name it.
pub(crate) const DEFAULT_BASE: &str = "base_link";

/// What there is to declare a camera by.
pub(crate) struct Known<'a> {
    pub(crate) image_topic: &'a str,
    pub(crate) info: &'a CameraInfo,
    pub(crate) mountings: &'a Mountings,
    /// Where those come.
    pub(crate) tf_static: &'a str,
    /// As odometry names it, if it has come.
    pub(crate) base: Option<&'a str>,
    /// When the first `CameraInfo` came.
    pub(crate) since: Instant,
}

/// What can be said of the camera by now.
#[derive(Debug, PartialEq)]
pub(crate) enum Verdict {
    /// It is whole.
    Whole(v1::Camera),
    /// Nobody says where it is on the robot, and nobody will.
    Unmounted(v1::Camera, Unmounted),
    /// Where it is on the robot may still come.
    Waiting,
    /// It cannot be declared as it is.
    Undeclarable(Undeclared),
}

/// Why it is not known where a camera is on the robot.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Unmounted {
    /// No transforms lead there.
    #[error(
        "nothing on {topic} joins {base} and {camera}, so the camera is taken to be in the middle of the robot, \
         looking ahead; publish that transform there, or name another topic by tf_static_topic, and start the bridge again"
    )]
    Apart {
        /// What was listened to.
        topic: String,
        /// Frame of the base.
        base: String,
        /// Frame of the camera.
        camera: String,
    },
    /// The transforms contradict each other.
    #[error(
        "the transforms of tf_static go in a circle at {0}, so the camera is taken to be in the middle of the robot, \
         looking ahead; mend the robot's description, and start the bridge again"
    )]
    Circle(String),
}

impl Known<'_> {
    pub(crate) fn verdict(&self) -> Verdict {
        let mut camera = match self.info.declared_on(self.image_topic) {
            Ok(camera) => camera,
            Err(undeclared) => return Verdict::Undeclarable(undeclared),
        };
        let is_late = self.since.elapsed() > MOUNTING_PATIENCE;
        let base = match self.base {
            Some(base) => base,
            None if is_late => DEFAULT_BASE,
            None => return Verdict::Waiting,
        };
        let optical = self.info.frame_id.as_str();
        match self.mountings.camera_in(base, optical) {
            Ok(Some(pose)) => {
                camera.base_to_camera = Some(pose);
                Verdict::Whole(message(&camera))
            }
            Ok(None) if !is_late => Verdict::Waiting,
            Ok(None) => {
                let apart = Unmounted::Apart {
                    topic: self.tf_static.to_owned(),
                    base: base.to_owned(),
                    camera: optical.to_owned(),
                };
                Verdict::Unmounted(message(&camera), apart)
            }
            Err(error) => Verdict::Unmounted(message(&camera), Unmounted::Circle(circle_at(error))),
        }
    }
}

fn circle_at(error: ChoiceError) -> String {
    match error {
        ChoiceError::TransformLoop { frame } => frame,
        other => other.to_string(),
    }
}

fn message(Camera { lens, size_px: (width, height), base_to_camera }: &Camera) -> v1::Camera {
    let model = match lens {
        Lens::Pinhole(Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            v1::camera::Model::Pinhole(v1::Pinhole {
                fx_px: *fx_px,
                fy_px: *fy_px,
                cx_px: *cx_px,
                cy_px: *cy_px,
                distortion: distortion.clone(),
            })
        }
        Lens::Fisheye(Intrinsics { fx_px, fy_px, cx_px, cy_px, distortion }) => {
            v1::camera::Model::Fisheye(v1::Fisheye {
                fx_px: *fx_px,
                fy_px: *fy_px,
                cx_px: *cx_px,
                cy_px: *cy_px,
                distortion: distortion.clone(),
            })
        }
    };
    v1::Camera {
        model: Some(model),
        image_width_px: Some(*width),
        image_height_px: Some(*height),
        base_to_camera: base_to_camera.as_ref().map(pose_message),
    }
}

/// A pose of odometry as the server takes it.
pub(crate) fn odometry_message(pose: &Pose) -> v1::Odometry {
    v1::Odometry { pose: Some(pose_message(pose)), covariance: Vec::new() }
}

pub(crate) fn pose_message(pose: &Pose) -> v1::Pose {
    let ([x, y, z], [qx, qy, qz, qw]) = (pose.position_m, pose.orientation);
    v1::Pose {
        position_m: Some(v1::Vector3 { x, y, z }),
        orientation: Some(v1::Quaternion { x: qx, y: qy, z: qz, w: qw }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn info() -> CameraInfo {
        CameraInfo {
            frame_id: "optical".to_owned(),
            size_px: (640, 480),
            distortion_model: "plumb_bob".to_owned(),
            distortion: vec![0.0; 5],
            intrinsics: [500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0],
            projection: [0.0; 12],
            binning: (0, 0),
            region_px: [0; 4],
        }
    }

    fn verdict(info: &CameraInfo, base: Option<&str>, waited: Duration) -> Verdict {
        let since = Instant::now().checked_sub(waited).unwrap();
        let mountings = Mountings::default();
        Known { image_topic: "/image_raw", info, mountings: &mountings, tf_static: "/tf_static", base, since }
            .verdict()
    }

    #[test]
    fn the_mounting_is_waited_for_and_then_done_without() {
        let info = info();
        assert_eq!(verdict(&info, Some("base_link"), Duration::ZERO), Verdict::Waiting);
        let late = verdict(&info, None, MOUNTING_PATIENCE + Duration::from_secs(1));
        let Verdict::Unmounted(camera, why) = late else { panic!("{late:?}") };
        assert_eq!((camera.image_width_px, camera.base_to_camera), (Some(640), None));
        assert!(why.to_string().contains("base_link and optical"), "{why}");
    }

    #[test]
    fn a_camera_that_was_never_calibrated_is_told() {
        let blank = CameraInfo { intrinsics: [0.0; 9], ..info() };
        assert_eq!(verdict(&blank, None, Duration::ZERO), Verdict::Undeclarable(Undeclared::Uncalibrated));
    }
}
