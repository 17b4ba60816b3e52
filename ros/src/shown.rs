//! What viewers see of what comes from the robot.

use waypost_bags::live::{LiveImage, LivePose};
use waypost_ros_messages::{CompressedImage, Header, Pose, TransformStamped, Transforms};

use crate::camera::pose_message;
use crate::settings::Topics;
use crate::viewers::{Screen, Viewers, ViewersError};

/// A robot has a few programs that tell of what never moves.
const MOUNTINGS_KEPT: usize = 32;
const PNG: &[u8] = b"\x89PNG";

/// The robot's topics, as far as the bridge reads them.
pub(crate) struct Shown {
    images: Screen,
    camera_infos: Option<Screen>,
    odometry: Option<Screen>,
    mountings: Screen,
    transforms: Screen,
}

impl Shown {
    pub(crate) fn to(viewers: &Viewers, topics: &Topics) -> Result<Self, ViewersError> {
        let raw = |topic: &Option<String>, ros_type, kept| {
            topic.as_ref().map(|topic| viewers.screen_of(topic, ros_type, kept)).transpose()
        };
        let images = topics.image.strip_suffix("/compressed").unwrap_or(&topics.image);
        Ok(Self {
            images: viewers.screen::<CompressedImage>(&format!("{images}/compressed"), 0)?,
            camera_infos: raw(&topics.camera_info, "sensor_msgs/msg/CameraInfo", 1)?,
            odometry: raw(&topics.odometry, "nav_msgs/msg/Odometry", 0)?,
            mountings: viewers.screen::<Transforms>(&topics.tf_static, MOUNTINGS_KEPT)?,
            transforms: viewers.screen::<Transforms>(&topics.tf, 0)?,
        })
    }

    /// An image as the server gets it. The state must not be locked.
    pub(crate) fn image(&self, image: &LiveImage) {
        if !self.images.is_watched() {
            return;
        }
        let LiveImage { stamp_ns, frame_id, file } = image;
        let format = if file.starts_with(PNG) { "png" } else { "jpeg" };
        let header = Header::new(*stamp_ns, frame_id);
        self.images.show(&CompressedImage { header, format: format.to_owned(), data: file.clone() });
    }

    /// Likewise a message about the camera.
    pub(crate) fn camera_info(&self, data: &[u8]) {
        if let Some(screen) = &self.camera_infos {
            screen.show_as_is(data);
        }
    }

    /// Likewise transforms that never change.
    pub(crate) fn mountings(&self, data: &[u8]) {
        self.mountings.show_as_is(data);
    }

    /// Likewise odometry, and the transform that the robot itself tells of it, which the bridge does not read.
    pub(crate) fn odometry(&self, data: &[u8], read: &LivePose, base: &str) {
        if let Some(screen) = &self.odometry {
            screen.show_as_is(data);
        }
        let Some(transform) = Pose::of(&pose_message(&read.pose)) else { return };
        let header = Header::new(read.stamp_ns, &read.frame_id);
        let child_frame_id = base.to_owned();
        let transforms = vec![TransformStamped { header, child_frame_id, transform }];
        self.transforms.show(&Transforms { transforms });
    }
}
