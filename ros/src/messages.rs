//! The messages of ROS 2 that the bridge publishes, laid out as CDR has them.

use serde::Serialize;
use waypost_client::v1;

/// A message of ROS.
pub(crate) trait Message: Serialize + Send + 'static {
    /// Its type as DDS names it.
    const TYPE: &'static str;
}

/// builtin_interfaces/Time
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(crate) struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    /// Of nanoseconds since the robot's epoch; what a message cannot say becomes its nearest.
    pub(crate) fn of_ns(stamp_ns: i64) -> Self {
        let seconds = stamp_ns.div_euclid(1_000_000_000);
        let nanosec = u32::try_from(stamp_ns.rem_euclid(1_000_000_000)).unwrap_or(0);
        Self { sec: i32::try_from(seconds).unwrap_or(i32::MAX), nanosec }
    }
}

/// std_msgs/Header
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct Header {
    pub(crate) stamp: Time,
    pub(crate) frame_id: String,
}

impl Header {
    pub(crate) fn new(stamp_ns: i64, frame_id: &str) -> Self {
        Self { stamp: Time::of_ns(stamp_ns), frame_id: frame_id.to_owned() }
    }
}

/// geometry_msgs/Vector3 and Point
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Vector3 {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
}

/// geometry_msgs/Quaternion
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// geometry_msgs/Pose and Transform, which are laid out alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Pose {
    pub(crate) position: Vector3,
    pub(crate) orientation: Quaternion,
}

impl Pose {
    /// Where nothing is moved or turned.
    pub(crate) const ORIGIN: Self = Self {
        position: Vector3 { x: 0.0, y: 0.0, z: 0.0 },
        orientation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 },
    };

    /// None if a part is missing.
    pub(crate) fn of(pose: &v1::Pose) -> Option<Self> {
        let v1::Pose { position_m, orientation } = pose;
        let v1::Vector3 { x, y, z } = position_m.as_ref()?;
        let position = Vector3 { x: *x, y: *y, z: *z };
        let v1::Quaternion { x, y, z, w } = orientation.as_ref()?;
        Some(Self { position, orientation: Quaternion { x: *x, y: *y, z: *z, w: *w } })
    }
}

impl Default for Pose {
    fn default() -> Self {
        Self::ORIGIN
    }
}

/// tf2_msgs/TFMessage
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Transforms {
    pub(crate) transforms: Vec<TransformStamped>,
}

impl Message for Transforms {
    const TYPE: &'static str = "tf2_msgs::msg::dds_::TFMessage_";
}

/// geometry_msgs/TransformStamped
#[derive(Clone, Debug, Serialize)]
pub(crate) struct TransformStamped {
    pub(crate) header: Header,
    pub(crate) child_frame_id: String,
    pub(crate) transform: Pose,
}

/// 6 x 6 numbers in two halves: serde has no arrays of 36.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Covariance([f64; 18], [f64; 18]);

impl Covariance {
    /// Of a robot on a floor: the same in x and y, and of the heading.
    pub(crate) fn planar(position_sigma_m: f64, heading_sigma_rad: f64) -> Self {
        let (mut upper, mut lower) = ([0.0; 18], [0.0; 18]);
        upper[0] = position_sigma_m.powi(2);
        upper[7] = position_sigma_m.powi(2);
        lower[17] = heading_sigma_rad.powi(2);
        Self(upper, lower)
    }
}

/// geometry_msgs/PoseWithCovarianceStamped
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PoseWithCovarianceStamped {
    pub(crate) header: Header,
    pub(crate) pose: Pose,
    pub(crate) covariance: Covariance,
}

impl Message for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_";
}

/// geometry_msgs/PoseStamped
#[derive(Clone, Debug, Serialize)]
pub(crate) struct PoseStamped {
    pub(crate) header: Header,
    pub(crate) pose: Pose,
}

/// nav_msgs/Path
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Path {
    pub(crate) header: Header,
    pub(crate) poses: Vec<PoseStamped>,
}

impl Message for Path {
    const TYPE: &'static str = "nav_msgs::msg::dds_::Path_";
}

/// geometry_msgs/Twist
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Twist {
    pub(crate) linear: Vector3,
    pub(crate) angular: Vector3,
}

impl Message for Twist {
    const TYPE: &'static str = "geometry_msgs::msg::dds_::Twist_";
}

/// diagnostic_msgs/KeyValue
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct KeyValue {
    pub(crate) key: String,
    pub(crate) value: String,
}

/// diagnostic_msgs/DiagnosticStatus
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct DiagnosticStatus {
    /// 0 is well, 1 a warning, 2 an error.
    pub(crate) level: u8,
    pub(crate) name: String,
    pub(crate) message: String,
    pub(crate) hardware_id: String,
    pub(crate) values: Vec<KeyValue>,
}

/// diagnostic_msgs/DiagnosticArray
#[derive(Clone, Debug, Serialize)]
pub(crate) struct DiagnosticArray {
    pub(crate) header: Header,
    pub(crate) status: Vec<DiagnosticStatus>,
}

impl Message for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs::msg::dds_::DiagnosticArray_";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_before_the_epoch_keep_their_nanoseconds_above_zero() {
        assert_eq!(Time::of_ns(1_500_000_000), Time { sec: 1, nanosec: 500_000_000 });
        assert_eq!(Time::of_ns(-1), Time { sec: -1, nanosec: 999_999_999 });
    }

    #[test]
    fn a_pose_with_a_part_missing_is_none() {
        assert_eq!(Pose::of(&v1::Pose::default()), None);
        let orientation = Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
        let whole = v1::Pose { position_m: Some(v1::Vector3::default()), orientation };
        assert_eq!(Pose::of(&whole), Some(Pose::ORIGIN));
    }

    #[test]
    fn the_covariance_is_of_x_y_and_heading() {
        let Covariance(upper, lower) = Covariance::planar(0.5, 0.1);
        assert_eq!((upper[0], upper[7], upper[14]), (0.25, 0.25, 0.0));
        assert!((lower[17] - 0.01).abs() < 1e-12 && lower[..17].iter().all(|entry| *entry == 0.0));
    }
}
