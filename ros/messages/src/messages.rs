//! The messages of ROS 2, laid out as CDR has them.

use byteorder::{BigEndian, LittleEndian};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use waypost_proto::v1;

pub use cdr_encoding::Error as CdrError;

/// What CDR in little endian begins with.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message of ROS.
pub trait Message: Serialize + Send + 'static {
    /// Its type as ROS names it, as in `nav_msgs/msg/Path`.
    const TYPE: &'static str;
}

/// A message in CDR, behind its four bytes of encapsulation.
///
/// # Errors
/// If it has something that CDR cannot say.
pub fn encoded<M: Message>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut data = ENCAPSULATION.to_vec();
    data.extend(laid_out(message)?);
    Ok(data)
}

/// Likewise of anything, without those bytes.
///
/// # Errors
/// If it has something that CDR cannot say.
pub fn laid_out<T: Serialize>(told: &T) -> Result<Vec<u8>, CdrError> {
    cdr_encoding::to_vec::<T, LittleEndian>(told)
}

/// What CDR says behind its four bytes of encapsulation, in either byte order. What comes behind it is not looked at.
///
/// # Errors
/// If it is something else.
pub fn decoded<T: DeserializeOwned>(data: &[u8]) -> Result<T, CdrError> {
    let (encapsulation, body) = data.split_at_checked(4).ok_or(CdrError::Eof)?;
    let read = match encapsulation[1] {
        0 => cdr_encoding::from_bytes::<T, BigEndian>(body),
        _ => cdr_encoding::from_bytes::<T, LittleEndian>(body),
    };
    read.map(|(told, _)| told)
}

/// builtin_interfaces/Time
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    /// Of nanoseconds since the robot's epoch; what a message cannot say becomes its nearest.
    pub fn of_ns(stamp_ns: i64) -> Self {
        let seconds = stamp_ns.div_euclid(1_000_000_000);
        let nanosec = u32::try_from(stamp_ns.rem_euclid(1_000_000_000)).unwrap_or(0);
        Self { sec: i32::try_from(seconds).unwrap_or(i32::MAX), nanosec }
    }
}

/// std_msgs/Header
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Header {
    /// When what is told was so.
    pub stamp: Time,
    /// The frame in which it is told.
    pub frame_id: String,
}

impl Header {
    /// At nanoseconds since the robot's epoch, in a frame.
    pub fn new(stamp_ns: i64, frame_id: &str) -> Self {
        Self { stamp: Time::of_ns(stamp_ns), frame_id: frame_id.to_owned() }
    }
}

/// geometry_msgs/Vector3 and Point
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Metres, or metres a second, or radians a second.
    pub x: f64,
    /// Likewise.
    pub y: f64,
    /// Likewise.
    pub z: f64,
}

/// geometry_msgs/Quaternion
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

/// geometry_msgs/Pose and Transform, which are laid out alike.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Metres.
    pub position: Vector3,
    /// A unit quaternion.
    pub orientation: Quaternion,
}

impl Pose {
    /// Where nothing is moved or turned.
    pub const ORIGIN: Self = Self {
        position: Vector3 { x: 0.0, y: 0.0, z: 0.0 },
        orientation: Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 },
    };

    /// None if a part is missing.
    pub fn of(pose: &v1::Pose) -> Option<Self> {
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
pub struct Transforms {
    /// In no order.
    pub transforms: Vec<TransformStamped>,
}

impl Message for Transforms {
    const TYPE: &'static str = "tf2_msgs/msg/TFMessage";
}

/// geometry_msgs/TransformStamped
#[derive(Clone, Debug, Serialize)]
pub struct TransformStamped {
    /// When, and in which frame.
    pub header: Header,
    /// The frame that is placed in the header's.
    pub child_frame_id: String,
    /// Where that is.
    pub transform: Pose,
}

/// 6 x 6 numbers in two halves: serde has no arrays of 36.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Covariance([f64; 18], [f64; 18]);

impl Covariance {
    /// Of what nobody has said: zeros, as ROS has it.
    pub const UNKNOWN: Self = Self([0.0; 18], [0.0; 18]);

    /// Of a robot on a floor: the same in x and y, and of the heading.
    pub fn planar(position_sigma_m: f64, heading_sigma_rad: f64) -> Self {
        let (mut upper, mut lower) = ([0.0; 18], [0.0; 18]);
        upper[0] = position_sigma_m.powi(2);
        upper[7] = position_sigma_m.powi(2);
        lower[17] = heading_sigma_rad.powi(2);
        Self(upper, lower)
    }
}

/// geometry_msgs/PoseWithCovarianceStamped
#[derive(Clone, Debug, Serialize)]
pub struct PoseWithCovarianceStamped {
    /// When, and in which frame.
    pub header: Header,
    /// The robot's.
    pub pose: Pose,
    /// About the axes of the header's frame.
    pub covariance: Covariance,
}

impl Message for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs/msg/PoseWithCovarianceStamped";
}

/// nav_msgs/Odometry
#[derive(Clone, Debug, Serialize)]
pub struct Odometry {
    /// When, and in which frame.
    pub header: Header,
    /// The frame that moves in it.
    pub child_frame_id: String,
    /// Where that is.
    pub pose: Pose,
    /// About the axes of the header's frame.
    pub covariance: Covariance,
    /// How it moves, in its own frame.
    pub twist: Twist,
    /// Likewise.
    pub twist_covariance: Covariance,
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";
}

/// geometry_msgs/PoseStamped
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PoseStamped {
    /// When, and in which frame.
    pub header: Header,
    /// The robot's.
    pub pose: Pose,
}

/// nav_msgs/Path
#[derive(Clone, Debug, Serialize)]
pub struct Path {
    /// When, and in which frame.
    pub header: Header,
    /// By their stamps.
    pub poses: Vec<PoseStamped>,
}

impl Message for Path {
    const TYPE: &'static str = "nav_msgs/msg/Path";
}

/// geometry_msgs/Twist
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Twist {
    /// Metres a second.
    pub linear: Vector3,
    /// Radians a second.
    pub angular: Vector3,
}

impl Message for Twist {
    const TYPE: &'static str = "geometry_msgs/msg/Twist";
}

/// diagnostic_msgs/KeyValue
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KeyValue {
    /// What is told.
    pub key: String,
    /// Its value, in words.
    pub value: String,
}

/// diagnostic_msgs/DiagnosticStatus
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DiagnosticStatus {
    /// 0 is well, 1 a warning, 2 an error.
    pub level: u8,
    /// Which part is told of.
    pub name: String,
    /// How it fares, in a sentence.
    pub message: String,
    /// Empty: it is no hardware.
    pub hardware_id: String,
    /// Numbers behind it.
    pub values: Vec<KeyValue>,
}

/// diagnostic_msgs/DiagnosticArray
#[derive(Clone, Debug, Serialize)]
pub struct DiagnosticArray {
    /// When, and in which frame.
    pub header: Header,
    /// One for each part.
    pub status: Vec<DiagnosticStatus>,
}

impl Message for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
}

/// sensor_msgs/CompressedImage
#[derive(Clone, Debug, Default, Serialize)]
pub struct CompressedImage {
    /// When, and in which frame.
    pub header: Header,
    /// `jpeg` or `png`.
    pub format: String,
    /// The file's bytes.
    pub data: Vec<u8>,
}

impl Message for CompressedImage {
    const TYPE: &'static str = "sensor_msgs/msg/CompressedImage";
}

/// std_msgs/Float64
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Float64 {
    /// The number.
    pub data: f64,
}

impl Message for Float64 {
    const TYPE: &'static str = "std_msgs/msg/Float64";
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
