//! Messages one at a time, as they come from a robot that runs: ROS 2's CDR, behind its four bytes of encapsulation.

use crate::bytes::{Encoding, Reader};
use crate::camera::{Camera, Rectification, Undeclared, camera};
use crate::error::{ChoiceError, Problem};
use crate::images;
use crate::messages::{CameraInfo, Header, Kind, Pose, Transform};
use crate::survey;
use crate::transforms::StaticTransforms;

/// An image as a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LiveImage {
    /// When it was taken; above 0.
    pub stamp_ns: i64,
    /// Of its header.
    pub frame_id: String,
    /// A JPEG or PNG: as it is, or made of raw pixels.
    pub file: Vec<u8>,
}

/// A pose with its stamp and the frames that it is between.
#[derive(Clone, Debug, PartialEq)]
pub struct LivePose {
    /// Of its header; 0 where that says none.
    pub stamp_ns: i64,
    /// The frame that the pose is in.
    pub frame_id: String,
    /// The frame whose pose it is; empty if the message does not say.
    pub child_frame: String,
    /// The pose, its quaternion of length 1.
    pub pose: Pose,
}

/// An image of a message of kind [`Kind::Image`] or [`Kind::CompressedImage`].
///
/// # Errors
/// What is wrong with it.
pub fn image(kind: Kind, data: &[u8]) -> Result<LiveImage, Problem> {
    let looked = images::look(kind, &Encoding::Cdr, data)?;
    if looked.stamp_ns <= 0 {
        return Err(Problem::NoStamp);
    }
    let file = images::file(kind, &Encoding::Cdr, data)?;
    Ok(LiveImage { stamp_ns: looked.stamp_ns, frame_id: looked.frame_id, file })
}

/// A pose of a message of kind [`Kind::Odometry`] or [`Kind::PoseStamped`].
///
/// # Errors
/// What is wrong with it.
pub fn pose(kind: Kind, data: &[u8]) -> Result<LivePose, Problem> {
    let frame_id = Header::read(&mut Reader::cdr(data)?)?.frame_id;
    let stamped = survey::pose(kind, &Encoding::Cdr, data)?;
    let name = |frame: &str| frame.trim_start_matches('/').to_owned();
    Ok(LivePose {
        stamp_ns: stamped.stamp_ns,
        frame_id: name(frame_id),
        child_frame: name(stamped.child_frame),
        pose: stamped.pose.checked()?,
    })
}

/// A sensor_msgs/CameraInfo.
///
/// # Errors
/// What is wrong with it.
pub fn camera_info(data: &[u8]) -> Result<CameraInfo, Problem> {
    let (_, info) = CameraInfo::read(&mut Reader::cdr(data)?)?;
    Ok(info)
}

/// A std_msgs/String.
///
/// # Errors
/// What is wrong with it.
pub fn text(data: &[u8]) -> Result<String, Problem> {
    Ok(Reader::cdr(data)?.text()?.to_owned())
}

impl CameraInfo {
    /// The camera of the images of a topic: raw, or rectified if its name has a part `image_rect…`.
    ///
    /// # Errors
    /// Why such a camera cannot be declared.
    pub fn declared_on(&self, image_topic: &str) -> Result<Camera, Undeclared> {
        camera(self, Rectification::of(image_topic))
    }
}

/// Where the parts of a robot are that never move, by `/tf_static`.
#[derive(Clone, Debug, Default)]
pub struct Mountings {
    transforms: StaticTransforms,
}

impl Mountings {
    /// Takes what a message of tf2_msgs/TFMessage says.
    ///
    /// # Errors
    /// What is wrong with it; nothing of it is taken then.
    pub fn add(&mut self, data: &[u8]) -> Result<(), Problem> {
        let transforms = Transform::read_all(&mut Reader::cdr(data)?)?;
        transforms.into_iter().for_each(|transform| self.transforms.add(transform));
        Ok(())
    }

    /// Pose of a camera in the base, x where it looks, by its optical frame. None if nothing joins them.
    ///
    /// # Errors
    /// [`ChoiceError::TransformLoop`] where transforms go in a circle.
    pub fn camera_in(&self, base: &str, optical: &str) -> Result<Option<Pose>, ChoiceError> {
        self.transforms.camera_in(base, optical)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Little-endian CDR of an odometry message at the origin.
    fn odometry(stamp_s: i32, w: f64) -> Vec<u8> {
        let mut data = vec![0, 1, 0, 0];
        data.extend(stamp_s.to_le_bytes());
        data.extend(5_u32.to_le_bytes());
        for name in [b"odom\0\0\0\0", b"base\0\0\0\0"] {
            data.extend(5_u32.to_le_bytes());
            data.extend(name);
        }
        for number in [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, w] {
            data.extend(f64::to_le_bytes(number));
        }
        data
    }

    #[test]
    fn odometry_says_which_frames_it_is_between() {
        let read = pose(Kind::Odometry, &odometry(3, 1.0)).unwrap();
        assert_eq!((read.stamp_ns, read.frame_id.as_str()), (3_000_000_005, "odom"));
        assert_eq!((read.child_frame.as_str(), read.pose.position_m), ("base", [1.0, 2.0, 0.0]));
        assert_eq!(pose(Kind::Odometry, &odometry(3, 0.5)), Err(Problem::NotAPose));
    }

    #[test]
    fn what_is_cut_off_is_named_by_its_byte() {
        let whole = odometry(3, 1.0);
        let cut = pose(Kind::Odometry, &whole[..whole.len() - 1]).unwrap_err().to_string();
        assert!(cut.contains("at byte 84"), "{cut}");
        assert!(text(&[0, 1, 0, 0, 9, 0, 0, 0, b'a', 0]).is_err());
        assert_eq!(text(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]).unwrap(), "a");
    }

    #[test]
    fn an_image_without_a_stamp_is_refused() {
        let mut data = vec![0, 1, 0, 0];
        data.extend([0; 8]);
        data.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        data.extend([5, 0, 0, 0]);
        data.extend(b"jpeg\0\0\0\0");
        data.extend([3, 0, 0, 0, 0xff, 0xd8, 0xff]);
        assert_eq!(image(Kind::CompressedImage, &data), Err(Problem::NoStamp));
        data[4] = 1;
        assert_eq!(image(Kind::CompressedImage, &data).unwrap().file, [0xff, 0xd8, 0xff]);
    }
}
