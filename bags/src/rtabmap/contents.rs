//! What is in a database: its nodes, which of them are frames, and what is of no use here.

use std::collections::BTreeMap;
use std::io::Cursor;

use super::calibration::{Calibration, Images, NoCamera, with_head, without_head};
use super::database::{Database, MOST_IMAGE_BYTES, NodeRow, Tables};
use super::error::{Omitted, RtabError};
use super::matrix::pose_of_bytes;
use super::version::Version;
use super::{RtabNode, RtabSession};
use crate::camera::{Camera, Lens};
use crate::messages::Pose;

/// How many of what a database has.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Contents {
    /// All nodes.
    pub nodes: u64,
    /// Nodes that are frames.
    pub frames: u64,
    /// Nodes that are none, by the reason.
    pub omitted: BTreeMap<Omitted, u64>,
    /// Frames without a pose by odometry.
    pub without_pose: u64,
    /// What is of no use here, and how many there are of it; nothing that is not there.
    pub unused: Vec<(&'static str, u64)>,
}

/// What a node has beside its image.
#[derive(Default)]
struct Unused {
    depth_images: u64,
    right_images: u64,
    scans: u64,
    grids: u64,
    user_data: u64,
    gps: u64,
    sensors: u64,
    ground_truth: u64,
}

/// Lists a database.
///
/// # Errors
/// [`RtabError::NoNodes`], [`RtabError::NoImages`], or what cannot be read.
pub(super) fn survey(
    database: &Database,
    version: &Version,
) -> Result<(Vec<RtabSession>, Contents), RtabError> {
    let images = images_by(&database.parameters()?);
    let mut survey = Survey { has_models: version.has_camera_models(), images, ..Survey::default() };
    database.nodes(&mut |row| survey.node(row))?;
    survey.finish(database)
}

/// Images are rectified unless both parameters say otherwise: RTAB-Map rectifies those that are not.
fn images_by(parameters: &str) -> Images {
    let value = |name: &str| {
        let pairs = parameters.split(';').filter_map(|pair| pair.split_once(':'));
        pairs.filter(|(key, _)| *key == name).map(|(_, value)| value == "true").next_back()
    };
    let already = value("Rtabmap/ImagesAlreadyRectified").unwrap_or(true);
    let features_only = value("Rtabmap/RectifyOnlyFeatures").unwrap_or(false);
    if !already && features_only { Images::Raw } else { Images::Rectified }
}

struct Survey {
    has_models: bool,
    images: Images,
    sessions: BTreeMap<i64, RtabSession>,
    /// The first calibration of each session, as it is written.
    calibrations: BTreeMap<i64, Vec<u8>>,
    contents: Contents,
    unused: Unused,
}

impl Default for Survey {
    fn default() -> Self {
        Self {
            has_models: false,
            images: Images::Rectified,
            sessions: BTreeMap::new(),
            calibrations: BTreeMap::new(),
            contents: Contents::default(),
            unused: Unused::default(),
        }
    }
}

impl Survey {
    fn node(&mut self, row: &NodeRow<'_>) {
        let calibration = self.calibration(row.calibration);
        self.count(row, calibration.as_ref().is_ok_and(|found| found.is_stereo));
        let session = self.sessions.entry(row.map_id).or_insert_with(|| RtabSession {
            map_id: row.map_id,
            nodes: Vec::new(),
            camera: Err(NoCamera::Missing),
            other_calibrations: 0,
        });
        let stamp_ns = nanoseconds(row.stamp_s);
        let before_ns = session.frames().last().map_or(0, |node| node.stamp_ns);
        let several = calibration.as_ref().is_ok_and(|found| found.models.len() > 1);
        let image = match stamp_ns {
            _ if several && row.image_bytes > 0 => Err(Omitted::SeveralCameras),
            None | Some(..=0) => image_of(row).and(Err(Omitted::NoStamp)),
            Some(stamp_ns) if stamp_ns <= before_ns => image_of(row).and(Err(Omitted::NotRising)),
            Some(_) => image_of(row),
        };
        let pose = pose_of_bytes(row.pose);
        match image {
            Ok(image_px) => {
                self.contents.frames += 1;
                self.contents.without_pose += u64::from(pose.is_none());
                if session.frames().next().is_none() {
                    session.camera = declared(calibration, self.images, image_px);
                    self.calibrations.insert(row.map_id, row.calibration.to_vec());
                } else if self.calibrations.get(&row.map_id).is_none_or(|first| first != row.calibration) {
                    let other = declared(calibration, self.images, image_px);
                    session.other_calibrations += u64::from(!alike(&session.camera, &other));
                }
            }
            Err(omitted) => *self.contents.omitted.entry(omitted).or_default() += 1,
        }
        session.nodes.push(RtabNode { id: row.id, stamp_ns: stamp_ns.unwrap_or(0), pose, image });
    }

    fn calibration(&self, bytes: &[u8]) -> Result<Calibration, NoCamera> {
        match bytes {
            [] => Err(NoCamera::Missing),
            bytes if self.has_models => with_head(bytes),
            bytes => without_head(bytes),
        }
    }

    fn count(&mut self, row: &NodeRow<'_>, is_stereo: bool) {
        self.contents.nodes += 1;
        let Unused { depth_images, right_images, scans, grids, user_data, gps, sensors, ground_truth } =
            &mut self.unused;
        *(if is_stereo { right_images } else { depth_images }) += u64::from(row.depth_bytes > 0);
        *scans += u64::from(row.scan_bytes > 0);
        *grids += u64::from(row.grid_bytes > 0);
        *user_data += u64::from(row.user_data_bytes > 0);
        *gps += u64::from(row.gps_bytes > 0);
        *sensors += u64::from(row.sensor_bytes > 0);
        *ground_truth += u64::from(pose_of_bytes(row.ground_truth).is_some());
    }

    fn finish(self, database: &Database) -> Result<(Vec<RtabSession>, Contents), RtabError> {
        let Self { sessions, mut contents, unused, .. } = self;
        let path = database.path().to_owned();
        if contents.nodes == 0 {
            return Err(RtabError::NoNodes(path));
        }
        if contents.frames == 0 {
            let first =
                sessions.values().flat_map(|session| &session.nodes).find_map(|node| node.image.err());
            let first = first.unwrap_or(Omitted::NoImage);
            return Err(RtabError::NoImages { path, nodes: contents.nodes, first });
        }
        let Unused { depth_images, right_images, scans, grids, user_data, gps, sensors, ground_truth } =
            unused;
        let Tables { words, features, global_descriptors } = database.tables()?;
        let counted = [
            ("depth images", depth_images),
            ("right images of stereo", right_images),
            ("laser scans", scans),
            ("occupancy grids", grids),
            ("user data", user_data),
            ("GPS fixes", gps),
            ("readings of other sensors", sensors),
            ("poses of ground truth", ground_truth),
            ("visual words", words),
            ("visual features", features),
            ("global descriptors", global_descriptors),
        ];
        contents.unused = counted.into_iter().filter(|(_, count)| *count > 0).collect();
        Ok((sessions.into_values().collect(), contents))
    }
}

/// Seconds as nanoseconds, if that is a number of them.
fn nanoseconds(stamp_s: f64) -> Option<i64> {
    let stamp_ns = (stamp_s * 1e9).round();
    (stamp_ns.is_finite() && stamp_ns.abs() < i64::MAX as f64).then_some(stamp_ns as i64)
}

fn image_of(row: &NodeRow<'_>) -> Result<(u32, u32), Omitted> {
    match row.image {
        None if row.image_bytes > MOST_IMAGE_BYTES => Err(Omitted::TooLong),
        // RTAB-Map takes four bytes and less for nothing.
        None | Some([] | [_] | [_, _] | [_, _, _] | [_, _, _, _]) => Err(Omitted::NoImage),
        Some(image) => size_px(image),
    }
}

/// Width and height of an image, by the head of its file.
pub(super) fn size_px(image: &[u8]) -> Result<(u32, u32), Omitted> {
    match image {
        [0xff, 0xd8, 0xff, ..] | [0x89, b'P', b'N', b'G', ..] => {
            let reader = image::ImageReader::new(Cursor::new(image)).with_guessed_format();
            let size_px = reader.ok().and_then(|reader| reader.into_dimensions().ok());
            size_px.filter(|(width, height)| *width > 0 && *height > 0).ok_or(Omitted::Head)
        }
        _ => Err(Omitted::Format),
    }
}

fn declared(
    calibration: Result<Calibration, NoCamera>,
    images: Images,
    image_px: (u32, u32),
) -> Result<Camera, NoCamera> {
    calibration?.models.first().ok_or(NoCamera::Missing)?.declared(images, image_px)
}

/// Whether two cameras see alike: within a thousandth of a focal length, a centimetre and a degree.
fn alike(one: &Result<Camera, NoCamera>, other: &Result<Camera, NoCamera>) -> bool {
    let (Ok(one), Ok(other)) = (one, other) else { return one.is_err() && other.is_err() };
    let numbers = |camera: &Camera| {
        let (Lens::Pinhole(of) | Lens::Fisheye(of)) = &camera.lens;
        [of.fx_px, of.fy_px, of.cx_px, of.cy_px]
    };
    let largest_px = numbers(one)[0].max(1.0) * 1e-3;
    let is_same_lens = std::mem::discriminant(&one.lens) == std::mem::discriminant(&other.lens)
        && one.size_px == other.size_px
        && numbers(one).iter().zip(numbers(other)).all(|(one, other)| (one - other).abs() <= largest_px);
    is_same_lens
        && match (&one.base_to_camera, &other.base_to_camera) {
            (Some(one), Some(other)) => near(one, other),
            (one, other) => one.is_none() && other.is_none(),
        }
}

fn near(one: &Pose, other: &Pose) -> bool {
    let apart = one.position_m.iter().zip(other.position_m).all(|(one, other)| (one - other).abs() <= 0.01);
    let dot: f64 = one.orientation.iter().zip(other.orientation).map(|(one, other)| one * other).sum();
    apart && 2.0 * dot.abs().min(1.0).acos() <= 1_f64.to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_raw_only_where_both_parameters_say_so() {
        let parameters = |already: bool, features: bool| {
            format!("A/B:1;Rtabmap/ImagesAlreadyRectified:{already};Rtabmap/RectifyOnlyFeatures:{features}")
        };
        assert_eq!(images_by(&parameters(false, true)), Images::Raw);
        for (already, features) in [(true, true), (true, false), (false, false)] {
            assert_eq!(images_by(&parameters(already, features)), Images::Rectified);
        }
        assert_eq!(images_by(""), Images::Rectified);
    }

    #[test]
    fn stamps_are_nanoseconds() {
        assert_eq!(nanoseconds(623.422), Some(623_422_000_000));
        assert_eq!([nanoseconds(f64::NAN), nanoseconds(f64::INFINITY), nanoseconds(1e12)], [None; 3]);
    }
}
