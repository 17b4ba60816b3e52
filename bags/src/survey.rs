//! The first reading of a bag: which topics there are, and whether what they hold can be used.

use std::collections::{BTreeMap, HashMap};

use crate::bytes::Encoding;
use crate::error::{LeftOut, Problem};
use crate::images;
use crate::messages::{CameraInfo, Header, Kind, StampedPose, Transform, reader};
use crate::source::{Body, Channel, RawMessage};
use crate::succession::{Astray, Succession};
use crate::transforms::StaticTransforms;

/// The frame that odometry is in, among transforms.
pub(crate) const ODOM_FRAME: &str = "odom";

/// A topic of a bag.
#[derive(Clone, Debug)]
pub struct Topic {
    /// With its slash at the front.
    pub name: String,
    /// As the bag names it; empty if it does not.
    pub type_name: String,
    /// What it is read as.
    pub kind: Kind,
    /// How the first of its messages is written.
    pub encoding: Encoding,
    /// Messages.
    pub count: u64,
    /// When the first and the last of them were recorded.
    pub recorded_ns: (i64, i64),
    /// Stamps of the first and the last of them; none where they have no header that is read.
    pub stamped_ns: Option<(i64, i64)>,
    /// Messages that cannot be read.
    pub left_out: Option<LeftOut>,
    /// Of images: `jpeg`, `png` or the encoding of the first.
    pub form: Option<String>,
    /// Of images: width and height of the first.
    pub size_px: Option<(u32, u32)>,
    /// `frame_id` of the first header.
    pub frame_id: Option<String>,
    /// Of odometry: the frame whose pose it is.
    pub child_frame: Option<String>,
    /// Of odometry: which of its stamps count.
    pub(crate) order: Succession<()>,
    /// Of transforms that may move: each pair of parent and child.
    pub(crate) joints: BTreeMap<(String, String), Joint>,
    /// Of camera infos: the first.
    pub camera_info: Option<CameraInfo>,
    /// Of camera infos: how many differ from the first.
    pub changed_camera_infos: u64,
    /// Of images: header and recording of each; no header where it cannot be read.
    pub(crate) images: Vec<ImageStamps>,
}

/// More pairs of frames than any robot has.
const MOST_JOINTS: usize = 1000;

/// A frame's transforms to its parent, while a bag is read.
#[derive(Clone, Debug, Default)]
pub(crate) struct Joint {
    /// Transforms that are poses.
    pub(crate) count: u64,
    /// Which of their stamps count.
    pub(crate) order: Succession<()>,
}

/// When an image was taken and recorded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImageStamps {
    pub(crate) header_ns: Option<i64>,
    pub(crate) log_ns: i64,
}

impl Topic {
    fn new(channel: &Channel, log_ns: i64) -> Self {
        let Channel { topic, type_name, encoding } = channel.clone();
        Self {
            name: topic,
            kind: Kind::of(&type_name),
            type_name,
            encoding,
            count: 0,
            recorded_ns: (log_ns, log_ns),
            stamped_ns: None,
            left_out: None,
            form: None,
            size_px: None,
            frame_id: None,
            child_frame: None,
            order: Succession::default(),
            joints: BTreeMap::new(),
            camera_info: None,
            changed_camera_infos: 0,
            images: Vec::new(),
        }
    }

    /// Messages per second, by their stamps or else by when they were recorded; none for fewer than two.
    pub fn rate_hz(&self) -> Option<f64> {
        let (first_ns, last_ns) = self.stamped_ns.unwrap_or(self.recorded_ns);
        let span_s = last_ns.checked_sub(first_ns).filter(|span_ns| *span_ns > 0)? as f64 / 1e9;
        (self.count > 1).then(|| (self.count - 1) as f64 / span_s)
    }

    /// Messages that can be read.
    pub fn readable(&self) -> u64 {
        self.count - self.left_out.as_ref().map_or(0, |left_out| left_out.count)
    }

    /// Of odometry, of a base: readable messages whose stamps do not follow those around them, and whether its clock was
    /// set back.
    pub(crate) fn astray(&self, base_frame: &str) -> Astray {
        let joint = self.joints.get(&(ODOM_FRAME.to_owned(), base_frame.to_owned()));
        let mut order = joint.map_or(&self.order, |joint| &joint.order).clone();
        order.end();
        order.astray()
    }

    /// Whether what it holds never moves.
    pub(crate) fn is_static(&self) -> bool {
        self.name.ends_with("tf_static")
    }

    fn add_joint(&mut self, transform: Transform) {
        let Transform { stamp_ns, parent, child, pose } = transform;
        let key = (parent, child);
        if pose.checked().is_ok() && (self.joints.len() < MOST_JOINTS || self.joints.contains_key(&key)) {
            let joint = self.joints.entry(key).or_default();
            joint.count += 1;
            joint.order.push(stamp_ns, ());
        }
    }

    fn leave_out(&mut self, log_ns: i64, problem: Problem) {
        let number = self.count;
        self.left_out
            .get_or_insert(LeftOut {
                count: 0,
                first_number: number,
                first_log_ns: log_ns,
                first_problem: problem,
            })
            .count += 1;
    }

    fn stamped(&mut self, stamp_ns: i64, frame_id: &str) {
        let (first_ns, _) = self.stamped_ns.unwrap_or((stamp_ns, stamp_ns));
        self.stamped_ns = Some((first_ns, stamp_ns));
        if self.frame_id.is_none() {
            self.frame_id = Some(frame_id.to_owned());
        }
    }

    fn image(&mut self, encoding: &Encoding, data: &[u8]) -> Result<i64, Problem> {
        let looked = images::look(self.kind, encoding, data)?;
        self.stamped(looked.stamp_ns, &looked.frame_id);
        if self.form.is_none() {
            self.form = Some(looked.form);
            self.size_px = looked.size_px.or_else(|| images::size_px(self.kind, encoding, data));
        }
        Ok(looked.stamp_ns)
    }

    fn read_camera_info(&mut self, encoding: &Encoding, data: &[u8]) -> Result<(), Problem> {
        let (stamp_ns, info) = CameraInfo::read(&mut reader(encoding, data)?)?;
        self.stamped(stamp_ns, &info.frame_id);
        match &self.camera_info {
            None => self.camera_info = Some(info),
            Some(first) => self.changed_camera_infos += u64::from(*first != info),
        }
        Ok(())
    }

    fn read_pose(&mut self, encoding: &Encoding, data: &[u8]) -> Result<(), Problem> {
        let mut bytes = reader(encoding, data)?;
        let header = Header::read(&mut bytes)?;
        let pose = pose(self.kind, encoding, data)?;
        self.stamped(pose.stamp_ns, header.frame_id);
        if self.child_frame.is_none() && !pose.child_frame.is_empty() {
            self.child_frame = Some(pose.child_frame.trim_start_matches('/').to_owned());
        }
        pose.pose.checked()?;
        self.order.push(pose.stamp_ns, ());
        Ok(())
    }
}

/// A pose of a message of kind `Odometry` or `PoseStamped`.
pub(crate) fn pose<'a>(kind: Kind, encoding: &Encoding, data: &'a [u8]) -> Result<StampedPose<'a>, Problem> {
    let mut bytes = reader(encoding, data)?;
    let pose = match kind {
        Kind::PoseStamped => StampedPose::read_stamped(&mut bytes)?,
        _ => StampedPose::read_odometry(&mut bytes)?,
    };
    Ok(pose)
}

/// All topics, while a bag is read for the first time.
#[derive(Default)]
pub(crate) struct Survey {
    pub(crate) topics: Vec<Topic>,
    pub(crate) transforms: StaticTransforms,
    pub(crate) by_name: HashMap<String, Vec<usize>>,
}

impl Survey {
    pub(crate) fn message(&mut self, message: &RawMessage<'_>) {
        let &RawMessage { channel, log_ns, ref body } = message;
        let index = self.index(channel, log_ns);
        let Some(topic) = self.topics.get_mut(index) else { return };
        topic.count += 1;
        let (first_ns, last_ns) = topic.recorded_ns;
        topic.recorded_ns = (first_ns.min(log_ns), last_ns.max(log_ns));
        let read = readable(body).and_then(|data| match topic.kind {
            Kind::CompressedImage | Kind::Image => topic.image(&channel.encoding, data).map(Some),
            Kind::CameraInfo => topic.read_camera_info(&channel.encoding, data).map(|()| None),
            Kind::Odometry | Kind::PoseStamped => topic.read_pose(&channel.encoding, data).map(|()| None),
            Kind::Transforms => {
                let transforms = Transform::read_all(&mut reader(&channel.encoding, data)?)?;
                if let Some(first) = transforms.first() {
                    topic.stamped(first.stamp_ns, &first.parent);
                }
                if topic.is_static() {
                    transforms.into_iter().for_each(|transform| self.transforms.add(transform));
                } else {
                    transforms.into_iter().for_each(|transform| topic.add_joint(transform));
                }
                Ok(None)
            }
            Kind::Other => Ok(None),
        });
        if matches!(topic.kind, Kind::CompressedImage | Kind::Image) {
            topic.images.push(ImageStamps { header_ns: read.as_ref().ok().copied().flatten(), log_ns });
        }
        if let Err(problem) = read {
            topic.leave_out(log_ns, problem);
        }
    }

    fn index(&mut self, channel: &Channel, log_ns: i64) -> usize {
        let known = self.by_name.get(&channel.topic).and_then(|indices| {
            indices.iter().copied().find(|index| self.topics[*index].type_name == channel.type_name)
        });
        known.unwrap_or_else(|| {
            self.topics.push(Topic::new(channel, log_ns));
            let index = self.topics.len() - 1;
            self.by_name.entry(channel.topic.clone()).or_default().push(index);
            index
        })
    }
}

/// The bytes of a message, if there are any to read.
pub(crate) fn readable<'a>(body: &Body<'a>) -> Result<&'a [u8], Problem> {
    match body {
        Body::Whole(data) => Ok(data),
        Body::TooLong(size_bytes) => {
            Err(Problem::TooLong { size_bytes: *size_bytes, limit_bytes: crate::input::MOST_MESSAGE_BYTES })
        }
        Body::Unreadable(reason) => Err(Problem::Compression(reason.clone())),
    }
}
