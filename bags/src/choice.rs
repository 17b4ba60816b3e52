//! Which topics are used: those that are asked for, or the only ones that serve.

use crate::bag::Bag;
use crate::camera::{Camera, Rectification, camera};
use crate::error::{ChoiceError, LeftOut};
use crate::image_stamps::stamps;
use crate::messages::Kind;
use crate::survey::{ImageStamps, ODOM_FRAME, Topic};

/// In place of a topic: not to use one that is there.
pub const NONE: &str = "none";
/// The robot's base, if its odometry does not name it.
const BASE_FRAME: &str = "base_link";
/// What stands for the base where only its place on the floor is below `odom`, by REP-120.
const FOOTPRINT_FRAME: &str = "base_footprint";

/// What is wanted of a bag.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Topic of images; the only one if left out.
    pub image_topic: Option<String>,
    /// Topic of camera infos, or `none`; the one beside the images if left out.
    pub camera_info_topic: Option<String>,
    /// Topic of odometry, poses or transforms, or `none`; the only nav_msgs/Odometry if left out.
    pub odometry_topic: Option<String>,
    /// Which times count.
    pub clock: Clock,
    /// What the images are; by their topic's name if left out.
    pub rectification: Option<Rectification>,
}

/// Which times count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clock {
    /// The stamps of the messages' headers.
    #[default]
    Header,
    /// When the messages were recorded.
    Log,
}

impl Clock {
    /// Of each image; none where its header cannot be read.
    fn stamps(self, images: &Topic) -> Vec<Option<i64>> {
        let stamp_ns = |image: &ImageStamps| {
            image.header_ns.map(|header_ns| match self {
                Clock::Header => header_ns,
                Clock::Log => image.log_ns,
            })
        };
        images.images.iter().map(stamp_ns).collect()
    }
}

/// What is used of a bag.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Topic of the images.
    pub image_topic: String,
    pub(crate) image_kind: Kind,
    /// Width and height of the first image.
    pub size_px: Option<(u32, u32)>,
    /// Topic of the camera infos, where the camera can be declared.
    pub camera_info_topic: Option<String>,
    /// The camera that its camera info describes.
    pub camera: Option<Camera>,
    /// Where poses come from.
    pub odometry: Option<OdometrySource>,
    /// Which times count.
    pub clock: Clock,
    /// Stamps of the images, in their order; none for those that are left out.
    pub stamps_ns: Vec<Option<i64>>,
    /// Images that are left out.
    pub left_out: Option<LeftOut>,
    /// What a reader of the list should know.
    pub notes: Vec<String>,
}

/// Where poses come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OdometrySource {
    /// Topic of the poses.
    pub topic: String,
    pub(crate) kind: Kind,
    /// The frame whose pose it is.
    pub base_frame: String,
}

impl Choice {
    /// How many images are used.
    pub fn frame_count(&self) -> usize {
        self.stamps_ns.iter().flatten().count()
    }
}

impl Bag {
    /// Chooses topics.
    ///
    /// # Errors
    /// Where a topic that is asked for is not there or does not serve, or several do and none is asked for.
    pub fn choose(&self, wanted: &Wanted) -> Result<Choice, ChoiceError> {
        let Wanted { image_topic, camera_info_topic, odometry_topic, clock, rectification } = wanted;
        let mut notes = Vec::new();
        let images = self.images(image_topic.as_deref())?;
        let odometry = self.odometry(odometry_topic.as_deref(), &mut notes)?;
        if let (Some(source), Clock::Header) = (&odometry, clock) {
            notes.extend(self.told_of_clock(source));
        }
        let base_frame = odometry.as_ref().map_or(BASE_FRAME, |source| source.base_frame.as_str());
        let info = self.camera_infos(camera_info_topic.as_deref(), images)?;
        let camera = match info {
            Some(info) => {
                let by_name = Rectification::of(&images.name);
                if rectification.is_none() && by_name == Rectification::Raw && images.name.contains("rect") {
                    notes.push(format!(
                        "the images of {} are taken as raw; if they are rectified, give --rectification rectified",
                        images.name
                    ));
                }
                let rectification = rectification.unwrap_or(by_name);
                self.camera((info, rectification), images, base_frame, &mut notes)?
            }
            None => {
                notes.push(format!("no camera is declared: no CameraInfo belongs to {}", images.name));
                None
            }
        };
        let (stamps_ns, left_out) = stamps(images, clock.stamps(images));
        if stamps_ns.iter().flatten().next().is_none() {
            let reason =
                left_out.as_ref().map_or_else(String::new, |left_out| left_out.first_problem.to_string());
            return Err(ChoiceError::NoImages { reason: format!("{}: {reason}", images.name) });
        }
        Ok(Choice {
            image_topic: images.name.clone(),
            image_kind: images.kind,
            size_px: images.size_px,
            camera_info_topic: info.filter(|_| camera.is_some()).map(|info| info.name.clone()),
            camera,
            odometry,
            clock: *clock,
            stamps_ns,
            left_out,
            notes,
        })
    }

    fn images(&self, asked: Option<&str>) -> Result<&Topic, ChoiceError> {
        const FLAG: &str = "--image-topic";
        const TYPES: &str = "sensor_msgs/CompressedImage or sensor_msgs/Image";
        let is_image = |topic: &&Topic| matches!(topic.kind, Kind::CompressedImage | Kind::Image);
        if let Some(asked) = asked {
            return self.asked(asked, FLAG, TYPES, is_image);
        }
        let all: Vec<&Topic> = self.topics().iter().filter(is_image).collect();
        let readable: Vec<&Topic> = all.iter().copied().filter(|topic| topic.readable() > 0).collect();
        // The same images, compressed and not: the compressed ones are what they are.
        let has_compressed = |topic: &Topic| {
            let compressed = format!("{}/compressed", topic.name);
            readable.iter().any(|other| other.name == compressed)
        };
        let serving: Vec<&Topic> = readable.iter().copied().filter(|topic| !has_compressed(topic)).collect();
        match serving.as_slice() {
            [] => Err(ChoiceError::NoImages { reason: why_no_images(&all) }),
            [only] => self.asked(&only.name, FLAG, TYPES, is_image),
            several => Err(ChoiceError::Several { what: "images", topics: names(several), flag: FLAG }),
        }
    }

    fn camera_infos(&self, asked: Option<&str>, images: &Topic) -> Result<Option<&Topic>, ChoiceError> {
        const FLAG: &str = "--camera-info-topic";
        let is_info = |topic: &&Topic| topic.kind == Kind::CameraInfo && topic.camera_info.is_some();
        match asked {
            Some(NONE) => return Ok(None),
            Some(asked) => return self.asked(asked, FLAG, "sensor_msgs/CameraInfo", is_info).map(Some),
            None => {}
        }
        let infos: Vec<&Topic> = self.topics().iter().filter(is_info).collect();
        let raw = images.name.strip_suffix("/compressed").unwrap_or(&images.name);
        let beside = raw.rsplit_once('/').map(|(camera, _)| format!("{camera}/camera_info"));
        if let Some(beside) = infos.iter().find(|info| Some(&info.name) == beside.as_ref()) {
            return Ok(Some(beside));
        }
        let same_frame: Vec<&Topic> =
            infos.iter().copied().filter(|info| info.frame_id == images.frame_id).collect();
        match same_frame.as_slice() {
            [] => Ok(None),
            [only] => Ok(Some(only)),
            several => Err(ChoiceError::Several { what: "camera infos", topics: names(several), flag: FLAG }),
        }
    }

    fn odometry(
        &self,
        asked: Option<&str>,
        notes: &mut Vec<String>,
    ) -> Result<Option<OdometrySource>, ChoiceError> {
        const FLAG: &str = "--odometry-topic";
        const TYPES: &str = "nav_msgs/Odometry, geometry_msgs/PoseStamped or tf2_msgs/TFMessage";
        let source = |topic: &Topic| {
            let base_frame = match topic.kind {
                Kind::Transforms => moving_base(topic)?.to_owned(),
                _ => topic.child_frame.clone().unwrap_or_else(|| BASE_FRAME.to_owned()),
            };
            Ok(OdometrySource { topic: topic.name.clone(), kind: topic.kind, base_frame })
        };
        let has_poses =
            |topic: &&Topic| matches!(topic.kind, Kind::Odometry | Kind::PoseStamped | Kind::Transforms);
        match asked {
            Some(NONE) => return Ok(None),
            Some(asked) => return source(self.asked(asked, FLAG, TYPES, has_poses)?).map(Some),
            None => {}
        }
        let all: Vec<&Topic> = self.topics().iter().filter(|topic| topic.kind == Kind::Odometry).collect();
        let usable: Vec<&Topic> = all.iter().copied().filter(|topic| topic.readable() > 0).collect();
        match usable.as_slice() {
            [] => {
                let serves = |topic: &&Topic| match topic.kind {
                    Kind::PoseStamped => topic.readable() > 0,
                    Kind::Transforms => moving_base(topic).is_ok(),
                    _ => false,
                };
                let others: Vec<&Topic> = self.topics().iter().filter(serves).collect();
                let may = if others.is_empty() {
                    String::new()
                } else {
                    format!("; {FLAG} also takes {}", names(&others).join(", "))
                };
                let reason = if all.is_empty() {
                    "no topic is of type nav_msgs/Odometry".to_owned()
                } else {
                    format!("no message of type nav_msgs/Odometry can be used: {}", first_problems(&all))
                };
                notes.push(format!("frames have no odometry: {reason}{may}"));
                Ok(None)
            }
            [only] => source(only).map(Some),
            several => Err(ChoiceError::Several { what: "odometry", topics: names(several), flag: FLAG }),
        }
    }

    /// What does not follow in the stamps of odometry.
    fn told_of_clock(&self, source: &OdometrySource) -> Option<String> {
        let topic = self.topics().iter().find(|topic| topic.name == source.topic)?;
        let astray = topic.astray(&source.base_frame);
        (!astray.is_none()).then(|| {
            format!("odometry of {}: {astray}; --stamps log takes the times of recording", topic.name)
        })
    }

    /// The topic of a name, if it serves and has one type.
    fn asked(
        &self,
        name: &str,
        flag: &'static str,
        wanted: &'static str,
        serves: impl Fn(&&Topic) -> bool,
    ) -> Result<&Topic, ChoiceError> {
        let named: Vec<&Topic> = self.topics().iter().filter(|topic| topic.name == name).collect();
        match named.as_slice() {
            [] => Err(ChoiceError::NoTopic {
                topic: name.to_owned(),
                present: self.topics().iter().map(|topic| topic.name.clone()).collect(),
            }),
            [only] if serves(only) => Ok(only),
            [only] => Err(ChoiceError::WrongType {
                topic: name.to_owned(),
                type_name: only.type_name.clone(),
                flag,
                wanted,
            }),
            [first, second, ..] => Err(ChoiceError::TypeChanges {
                topic: name.to_owned(),
                first: first.type_name.clone(),
                second: second.type_name.clone(),
            }),
        }
    }

    fn camera(
        &self,
        (info, rectification): (&Topic, Rectification),
        images: &Topic,
        base_frame: &str,
        notes: &mut Vec<String>,
    ) -> Result<Option<Camera>, ChoiceError> {
        let Some(described) = &info.camera_info else { return Ok(None) };
        if info.changed_camera_infos > 0 {
            let name = &info.name;
            let changed = info.changed_camera_infos;
            notes.push(format!("{name} changes in {changed} of its messages; the first is declared"));
        }
        let mut camera = match camera(described, rectification) {
            Ok(camera) => camera,
            Err(reason) => {
                notes.push(format!("no camera is declared of {}: {reason}", info.name));
                return Ok(None);
            }
        };
        if let Some(size_px) = images.size_px.filter(|size_px| *size_px != camera.size_px) {
            let ((width, height), (of_width, of_height)) = (size_px, camera.size_px);
            notes.push(format!(
                "no camera is declared: the images are {width} x {height}, and {} is for {of_width} x {of_height}",
                info.name
            ));
            return Ok(None);
        }
        if let (Rectification::Raw, Some(error_px)) = (rectification, described.approximation_px()) {
            notes.push(format!(
                "the rational_polynomial of {} is declared as the nearest plumb_bob, which is up to {error_px:.2} pixels from it",
                info.name
            ));
        }
        camera.base_to_camera = self.transforms.camera_in(base_frame, &described.frame_id)?;
        if camera.base_to_camera.is_none() {
            notes.push(format!(
                "where the camera is on the robot is not declared: tf_static does not lead from {base_frame} to {}",
                described.frame_id
            ));
        }
        Ok(Some(camera))
    }
}

fn names(topics: &[&Topic]) -> Vec<String> {
    topics.iter().map(|topic| topic.name.clone()).collect()
}

/// The base that a topic of transforms moves in `odom`.
fn moving_base(topic: &Topic) -> Result<&'static str, ChoiceError> {
    let has = |base: &str| topic.joints.contains_key(&(ODOM_FRAME.to_owned(), base.to_owned()));
    let base = [BASE_FRAME, FOOTPRINT_FRAME].into_iter().find(|base| has(base));
    base.ok_or_else(|| {
        let present: Vec<String> = topic
            .joints
            .keys()
            .take(MOST_JOINTS_TOLD)
            .map(|(parent, child)| format!("{parent} to {child}"))
            .collect();
        ChoiceError::NoMotion {
            topic: topic.name.clone(),
            present: match (topic.is_static(), present.is_empty()) {
                (true, _) => "what never moves".to_owned(),
                (false, true) => "none".to_owned(),
                (false, false) => present.join(", "),
            },
        }
    })
}

/// Enough to see what is there.
const MOST_JOINTS_TOLD: usize = 20;

fn why_no_images(all: &[&Topic]) -> String {
    match first_problems(all) {
        none if none.is_empty() => {
            "none is of type sensor_msgs/CompressedImage or sensor_msgs/Image".to_owned()
        }
        reasons => reasons,
    }
}

/// What is wrong with the first message that cannot be read of each topic.
fn first_problems(topics: &[&Topic]) -> String {
    let reasons: Vec<String> = topics
        .iter()
        .filter_map(|topic| {
            let left_out = topic.left_out.as_ref()?;
            Some(format!("{}: message {}: {}", topic.name, left_out.first_number, left_out.first_problem))
        })
        .collect();
    reasons.join("; ")
}
