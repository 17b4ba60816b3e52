//! The messages that a use of images needs, decoded from either ROS.

use crate::bytes::{Encoding, Malformed, Reader};
use crate::error::Problem;

/// Types of messages that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// sensor_msgs/CompressedImage
    CompressedImage,
    /// sensor_msgs/Image
    Image,
    /// sensor_msgs/CameraInfo
    CameraInfo,
    /// nav_msgs/Odometry
    Odometry,
    /// geometry_msgs/PoseStamped
    PoseStamped,
    /// tf2_msgs/TFMessage, or tf/tfMessage
    Transforms,
    /// Another, which is counted alone.
    Other,
}

impl Kind {
    /// By the name of a type, of ROS 1 or 2.
    pub(crate) fn of(type_name: &str) -> Self {
        match type_name.replace("/msg/", "/").as_str() {
            "sensor_msgs/CompressedImage" => Kind::CompressedImage,
            "sensor_msgs/Image" => Kind::Image,
            "sensor_msgs/CameraInfo" => Kind::CameraInfo,
            "nav_msgs/Odometry" => Kind::Odometry,
            "geometry_msgs/PoseStamped" => Kind::PoseStamped,
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Kind::Transforms,
            _ => Kind::Other,
        }
    }
}

/// Opens a message for reading.
pub(crate) fn reader<'a>(encoding: &Encoding, data: &'a [u8]) -> Result<Reader<'a>, Problem> {
    match encoding {
        Encoding::Cdr => Ok(Reader::cdr(data)?),
        Encoding::Ros1 => Ok(Reader::packed(data)),
        Encoding::Other(name) => Err(Problem::Encoding(name.clone())),
    }
}

/// std_msgs/Header
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header<'a> {
    pub(crate) stamp_ns: i64,
    pub(crate) frame_id: &'a str,
}

impl<'a> Header<'a> {
    pub(crate) fn read(reader: &mut Reader<'a>) -> Result<Self, Malformed> {
        let seconds = if reader.is_ros1() {
            let _sequence = reader.u32()?;
            i64::from(reader.u32()?)
        } else {
            i64::from(reader.i32()?)
        };
        let nanoseconds = i64::from(reader.u32()?);
        let frame_id = reader.text()?;
        Ok(Self { stamp_ns: seconds * 1_000_000_000 + nanoseconds, frame_id })
    }
}

/// sensor_msgs/CompressedImage
pub(crate) struct CompressedImage<'a> {
    pub(crate) header: Header<'a>,
    pub(crate) format: &'a str,
    pub(crate) data: &'a [u8],
}

impl<'a> CompressedImage<'a> {
    pub(crate) fn read(reader: &mut Reader<'a>) -> Result<Self, Malformed> {
        Ok(Self { header: Header::read(reader)?, format: reader.text()?, data: reader.bytes()? })
    }
}

/// sensor_msgs/Image
pub(crate) struct Image<'a> {
    pub(crate) header: Header<'a>,
    pub(crate) height_px: u32,
    pub(crate) width_px: u32,
    pub(crate) encoding: &'a str,
    pub(crate) step_bytes: u32,
    pub(crate) data: &'a [u8],
}

impl<'a> Image<'a> {
    pub(crate) fn read(reader: &mut Reader<'a>) -> Result<Self, Malformed> {
        let header = Header::read(reader)?;
        let height_px = reader.u32()?;
        let width_px = reader.u32()?;
        let encoding = reader.text()?;
        let _is_big_endian = reader.u8()?;
        let step_bytes = reader.u32()?;
        let data = reader.bytes()?;
        Ok(Self { header, height_px, width_px, encoding, step_bytes, data })
    }
}

/// sensor_msgs/CameraInfo: a calibrated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Frame of the camera, by REP-103 an optical one: z where it looks, x to the right, y down.
    pub frame_id: String,
    /// Size of the images that the camera was calibrated with.
    pub size_px: (u32, u32),
    /// plumb_bob, rational_polynomial, equidistant or another.
    pub distortion_model: String,
    /// Parameters of the distortion.
    pub distortion: Vec<f64>,
    /// Intrinsics of the raw image, row by row.
    pub intrinsics: [f64; 9],
    /// Projection of the rectified image, row by row.
    pub projection: [f64; 12],
    /// Pixels of the full image that one pixel comes from, along a row and along a column; 0 counts as 1.
    pub binning: (u32, u32),
    /// Part of the full image that is sent, as left edge, upper edge, width and height; all 0 for the whole.
    pub region_px: [u32; 4],
}

impl CameraInfo {
    pub(crate) fn read(reader: &mut Reader<'_>) -> Result<(i64, Self), Malformed> {
        let header = Header::read(reader)?;
        let (height_px, width_px) = (reader.u32()?, reader.u32()?);
        let distortion_model = reader.text()?.to_owned();
        let distortion = reader.sequence(8, Reader::f64)?;
        let intrinsics = reader.f64s()?;
        let _rectification: [f64; 9] = reader.f64s()?;
        let projection = reader.f64s()?;
        let binning = (reader.u32()?, reader.u32()?);
        let [left, upper] = [reader.u32()?, reader.u32()?];
        let [height, width] = [reader.u32()?, reader.u32()?];
        let _do_rectify = reader.u8()?;
        let info = Self {
            frame_id: header.frame_id.to_owned(),
            size_px: (width_px, height_px),
            distortion_model,
            distortion,
            intrinsics,
            projection,
            binning,
            region_px: [left, upper, width, height],
        };
        Ok((header.stamp_ns, info))
    }
}

/// A frame in its parent frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// x, y, z.
    pub position_m: [f64; 3],
    /// A unit quaternion, as x, y, z, w.
    pub orientation: [f64; 4],
}

/// How far the length of a quaternion may be off: some write it as 32-bit floats.
const UNIT_TOLERANCE: f64 = 1e-2;

impl Pose {
    fn read(reader: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self { position_m: reader.f64s()?, orientation: reader.f64s()? })
    }

    /// The same with a quaternion of length 1, if its numbers are a pose.
    pub(crate) fn checked(self) -> Result<Self, Problem> {
        let length = self.orientation.iter().map(|part| part * part).sum::<f64>().sqrt();
        let finite = self.position_m.iter().all(|part| part.is_finite());
        if finite && (length - 1.0).abs() <= UNIT_TOLERANCE {
            Ok(Self { orientation: self.orientation.map(|part| part / length), ..self })
        } else {
            Err(Problem::NotAPose)
        }
    }
}

/// A pose by odometry.
pub(crate) struct StampedPose<'a> {
    pub(crate) stamp_ns: i64,
    /// The frame whose pose it is; empty if the message does not say.
    pub(crate) child_frame: &'a str,
    pub(crate) pose: Pose,
}

impl<'a> StampedPose<'a> {
    /// nav_msgs/Odometry. Its covariances are not read: they are of a pose that drifts, and few drivers know them.
    pub(crate) fn read_odometry(reader: &mut Reader<'a>) -> Result<Self, Malformed> {
        let header = Header::read(reader)?;
        let child_frame = reader.text()?;
        Ok(Self { stamp_ns: header.stamp_ns, child_frame, pose: Pose::read(reader)? })
    }

    /// geometry_msgs/PoseStamped
    pub(crate) fn read_stamped(reader: &mut Reader<'a>) -> Result<Self, Malformed> {
        let header = Header::read(reader)?;
        Ok(Self { stamp_ns: header.stamp_ns, child_frame: "", pose: Pose::read(reader)? })
    }
}

/// One transform of tf2_msgs/TFMessage: the child's pose in the parent.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Transform {
    pub(crate) stamp_ns: i64,
    pub(crate) parent: String,
    pub(crate) child: String,
    pub(crate) pose: Pose,
}

/// Two empty strings, a stamp and seven numbers.
const LEAST_TRANSFORM_BYTES: usize = 4 + 4 + 8 + 7 * 8;

impl Transform {
    pub(crate) fn read_all(reader: &mut Reader<'_>) -> Result<Vec<Self>, Malformed> {
        reader.sequence(LEAST_TRANSFORM_BYTES, |reader| {
            let header = Header::read(reader)?;
            // tf of ROS 1 wrote names with a slash at the front.
            let name = |text: &str| text.trim_start_matches('/').to_owned();
            let (parent, child) = (name(header.frame_id), name(reader.text()?));
            Ok(Self { stamp_ns: header.stamp_ns, parent, child, pose: Pose::read(reader)? })
        })
    }
}
