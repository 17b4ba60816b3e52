//! What the bridge is told by flags, the environment and a file.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use clap::Parser;
use clap::builder::{OsStringValueParser, TypedValueParser};
use serde::Deserialize;
use waypost_bags::Kind;

use crate::names::{NameError, full};
use crate::robot_words::WordForm;
use crate::settings::{Mode, SensorQos, Services, Settings, Topics};

/// In place of a topic: there is none.
const NONE: &str = "none";
const DEFAULT_SERVER: &str = "http://127.0.0.1:7600";
const DEFAULT_MOST_HZ: f64 = 10.0;
const DEFAULT_POSITION_SIGMA_M: f64 = 0.5;
const DEFAULT_HEADING_SIGMA_RAD: f64 = 0.1;

/// Joins a ROS 2 robot to a Waypost server, over DDS: no ROS is needed where this runs.
///
/// Takes images, their camera, odometry and /tf_static; gives map -> odom on /tf, the pose, the path, markers of places
/// and diagnostics, and with --drive it takes goals and drives by cmd_vel.
///
/// Every flag may be a parameter of the file, in the same words with _ for -. A flag wins over the environment, and that
/// over the file.
#[derive(Clone, Debug, Default, Parser, Deserialize)]
#[command(name = "waypost-ros", version)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Given {
    /// A TOML file with parameters.
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    params: Option<PathBuf>,
    /// The Waypost server's address for robots [default: http://127.0.0.1:7600]
    #[arg(long, env = "WAYPOST_SERVER", value_name = "URL")]
    server: Option<String>,
    /// Secret of a token, for servers that ask for one.
    #[arg(long, env = "WAYPOST_TOKEN", hide_env_values = true, value_name = "SECRET")]
    token: Option<String>,
    /// Certificates of the authorities that the server's is trusted by, in PEM.
    #[arg(long, env = "WAYPOST_CA", value_name = "FILE", value_parser = any_path())]
    ca: Option<PathBuf>,
    /// The map, which must exist: `waypost map create` makes one.
    #[arg(long, value_name = "MAP")]
    map: Option<String>,
    /// Name of the session; one that exists is gone on with [default: the server chooses]
    #[arg(long, value_name = "NAME")]
    session: Option<String>,
    /// Find the robot on the map, and leave that as it is. Without this the map grows.
    #[arg(long)]
    localize: bool,
    /// Take goals, and drive by cmd_vel. Needs --localize.
    #[arg(long)]
    drive: bool,
    /// Take goals by name, and hand them to Nav2, which drives. Needs --localize, and is in place of --drive
    #[arg(long, conflicts_with = "drive")]
    nav2: bool,
    /// Speed on straight ways while driving [default: the server's, 0.4]
    #[arg(long, value_name = "M_S")]
    speed_m_s: Option<f64>,
    /// The robot's namespace; topics without a slash at the front are within it, tf too.
    #[arg(long, value_name = "NAME")]
    namespace: Option<String>,
    /// DDS domain, 0 to 232 [default: 0]
    #[arg(long, env = "ROS_DOMAIN_ID", value_name = "NUMBER")]
    domain: Option<u16>,
    /// Addresses of the network interfaces to use, as 127.0.0.1 to stay on this machine [default: all]
    #[arg(long, value_name = "ADDRESS")]
    network: Vec<IpAddr>,
    /// A machine to find without multicast, by its name or IPv4 address; with a port, that one alone
    #[arg(long, value_name = "HOST[:PORT]")]
    peer: Vec<String>,
    /// sensor_msgs/Image, or CompressedImage if the name ends in `compressed` [default: camera/image_raw]
    #[arg(long, value_name = "TOPIC")]
    image_topic: Option<String>,
    /// sensor_msgs/CameraInfo; `none` for a camera that is not declared [default: camera_info beside the images]
    #[arg(long, value_name = "TOPIC")]
    camera_info_topic: Option<String>,
    /// nav_msgs/Odometry; `none` for a robot without [default: odom]
    #[arg(long, value_name = "TOPIC")]
    odometry_topic: Option<String>,
    /// tf2_msgs/TFMessage, where map -> odom is published [default: tf, within the namespace]
    #[arg(long, value_name = "TOPIC")]
    tf_topic: Option<String>,
    /// tf2_msgs/TFMessage, which says where the camera is on the robot [default: tf_static, within the namespace]
    #[arg(long, value_name = "TOPIC")]
    tf_static_topic: Option<String>,
    /// Whether images, camera and odometry are asked for as best effort, which takes either, or as reliable
    /// [default: best-effort]
    #[arg(long, value_name = "QOS")]
    sensor_qos: Option<SensorQos>,
    /// Frame of the map [default: map]
    #[arg(long, value_name = "FRAME")]
    map_frame: Option<String>,
    /// Most frames a second that are sent; the others are left out, 0 for all [default: 10]
    #[arg(long, value_name = "HZ")]
    most_hz: Option<f64>,
    /// Frames that are kept while the server is away; the oldest make way [default: 512, 2 while localizing]
    #[arg(long, value_name = "COUNT")]
    buffer_frames: Option<usize>,
    /// Standard deviation to publish with poses, as the server does not tell it [default: 0.5]
    #[arg(long, value_name = "METRES")]
    position_sigma_m: Option<f64>,
    /// Standard deviation of the heading to publish with poses [default: 0.1]
    #[arg(long, value_name = "RADIANS")]
    heading_sigma_rad: Option<f64>,
    /// Send words in place of images, which stay on the robot; the map's model is downloaded at the start
    #[arg(long, value_enum, value_name = "FORM", num_args = 0..=1, require_equals = true, default_missing_value = "keypoints")]
    words: Option<WordForm>,
    /// Let ROS 2 services choose map and mode, and finish sessions. --map may be left out then
    #[arg(long)]
    services: bool,
    /// Let Foxglove's app look on at this address, as 127.0.0.1:8765: up to 8 at once. Whoever reaches it sees the
    /// images
    #[arg(long, value_name = "ADDRESS:PORT")]
    foxglove: Option<SocketAddr>,
}

/// Why the bridge cannot begin.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SettingsError {
    /// The file is not there.
    #[error("cannot read {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not as it should be.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: toml::de::Error,
    },
    /// No map is named.
    #[error(
        "no map is named; give --map, or `map` in the file of --params; or --services for a robot that chooses it"
    )]
    NoMap,
    /// A drive that would change the map.
    #[error("--drive and --nav2 follow a map that is there; give --localize with either")]
    DriveWithoutLocalize,
    /// Driving sends images.
    #[error("--words keeps images on the robot, and --drive sends them; leave out one, or let --nav2 drive")]
    WordsWhileDriving,
    /// Two who would drive.
    #[error("--drive and --nav2 would both drive the robot; leave out one")]
    TwoDrivers,
    /// A drive without wheels.
    #[error("--drive and --nav2 need odometry and a declared camera; leave out `none` for their topics")]
    DriveBlind,
    /// DDS has no such domain.
    #[error("domain {0} does not exist; choose one from 0 to 232")]
    Domain(u16),
    /// A number that is none, or below what it means.
    #[error("{name} is {value}; it has to be a number of {least}")]
    Number {
        /// The parameter.
        name: &'static str,
        /// As given.
        value: f64,
        /// What it may be.
        least: &'static str,
    },
    /// A frame or a topic.
    #[error(transparent)]
    Name(#[from] NameError),
}

/// The highest domain whose ports exist.
const LAST_DOMAIN: u16 = 232;

/// A path, or nothing: a variable of the environment may be set to that.
fn any_path() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().map(PathBuf::from)
}

impl Given {
    /// With what the file says, where there is one.
    ///
    /// # Errors
    /// If that cannot be read, or what all of it says does not fit together.
    pub(crate) fn settings(self) -> Result<Settings, SettingsError> {
        let given = self.without_what_is_empty();
        match given.params.clone() {
            Some(path) => given.over(read(&path)?).resolved(),
            None => given.resolved(),
        }
    }

    /// An empty variable of the environment counts as unset.
    fn without_what_is_empty(self) -> Self {
        let text = |text: Option<String>| text.filter(|text| !text.is_empty());
        Self {
            server: text(self.server),
            token: text(self.token),
            ca: self.ca.filter(|path| !path.as_os_str().is_empty()),
            ..self
        }
    }

    /// These, and where they say nothing the others.
    fn over(self, file: Self) -> Self {
        Self {
            params: self.params,
            server: self.server.or(file.server),
            token: self.token.or(file.token),
            ca: self.ca.or(file.ca),
            map: self.map.or(file.map),
            session: self.session.or(file.session),
            localize: self.localize || file.localize,
            drive: self.drive || file.drive,
            nav2: self.nav2 || file.nav2,
            speed_m_s: self.speed_m_s.or(file.speed_m_s),
            namespace: self.namespace.or(file.namespace),
            domain: self.domain.or(file.domain),
            network: if self.network.is_empty() { file.network } else { self.network },
            peer: if self.peer.is_empty() { file.peer } else { self.peer },
            image_topic: self.image_topic.or(file.image_topic),
            camera_info_topic: self.camera_info_topic.or(file.camera_info_topic),
            odometry_topic: self.odometry_topic.or(file.odometry_topic),
            tf_topic: self.tf_topic.or(file.tf_topic),
            tf_static_topic: self.tf_static_topic.or(file.tf_static_topic),
            sensor_qos: self.sensor_qos.or(file.sensor_qos),
            map_frame: self.map_frame.or(file.map_frame),
            most_hz: self.most_hz.or(file.most_hz),
            buffer_frames: self.buffer_frames.or(file.buffer_frames),
            position_sigma_m: self.position_sigma_m.or(file.position_sigma_m),
            heading_sigma_rad: self.heading_sigma_rad.or(file.heading_sigma_rad),
            words: self.words.or(file.words),
            services: self.services || file.services,
            foxglove: self.foxglove.or(file.foxglove),
        }
    }

    fn resolved(self) -> Result<Settings, SettingsError> {
        let mode = self.mode()?;
        let topics = self.topics()?;
        if mode == Mode::Drive && (topics.odometry.is_none() || topics.camera_info.is_none()) {
            return Err(SettingsError::DriveBlind);
        }
        if self.words.is_some() && self.drive {
            return Err(SettingsError::WordsWhileDriving);
        }
        let domain = self.domain.unwrap_or(0);
        if domain > LAST_DOMAIN {
            return Err(SettingsError::Domain(domain));
        }
        let map = self.map.filter(|map| !map.is_empty());
        if map.is_none() && !self.services {
            return Err(SettingsError::NoMap);
        }
        let position_sigma_m = self.position_sigma_m.unwrap_or(DEFAULT_POSITION_SIGMA_M);
        let heading_sigma_rad = self.heading_sigma_rad.unwrap_or(DEFAULT_HEADING_SIGMA_RAD);
        Ok(Settings {
            mode,
            is_by_nav2: self.nav2,
            topics,
            domain,
            speed_m_s: self.speed_m_s.map(|speed| at_least_zero("speed_m_s", speed)).transpose()?,
            server: self.server.unwrap_or_else(|| DEFAULT_SERVER.to_owned()),
            token: self.token.filter(|token| !token.is_empty()),
            ca: self.ca,
            map,
            words: self.words,
            is_served: self.services,
            session: self.session.unwrap_or_default(),
            networks: self.network,
            peers: self.peer,
            namespace: self.namespace.unwrap_or_default().trim_matches('/').to_owned(),
            sensor_qos: self.sensor_qos.unwrap_or(SensorQos::BestEffort),
            map_frame: self.map_frame.unwrap_or_else(|| "map".to_owned()),
            most_hz: at_least_zero("most_hz", self.most_hz.unwrap_or(DEFAULT_MOST_HZ))?,
            buffer_frames: self.buffer_frames.map(|frames| frames.max(1)),
            position_sigma_m: at_least_zero("position_sigma_m", position_sigma_m)?,
            heading_sigma_rad: at_least_zero("heading_sigma_rad", heading_sigma_rad)?,
            foxglove: self.foxglove,
        })
    }

    fn mode(&self) -> Result<Mode, SettingsError> {
        match (self.localize, self.drive, self.nav2) {
            (_, true, true) => Err(SettingsError::TwoDrivers),
            (false, false, false) => Ok(Mode::Map),
            (true, false, false) => Ok(Mode::Localize),
            (true, true, false) | (true, false, true) => Ok(Mode::Drive),
            (false, true, false) | (false, false, true) => Err(SettingsError::DriveWithoutLocalize),
        }
    }

    fn topics(&self) -> Result<Topics, NameError> {
        let namespace = self.namespace.as_deref().unwrap_or_default();
        let name = |topic: &str| full(namespace, topic);
        let optional = |topic: &str| if topic == NONE { Ok(None) } else { name(topic).map(Some) };
        let image = name(self.image_topic.as_deref().unwrap_or("camera/image_raw"))?;
        let image_kind = if image.ends_with("compressed") { Kind::CompressedImage } else { Kind::Image };
        let camera_info = match &self.camera_info_topic {
            Some(topic) => optional(topic)?,
            None => Some(beside(&image)),
        };
        Ok(Topics {
            image,
            image_kind,
            camera_info,
            odometry: optional(self.odometry_topic.as_deref().unwrap_or("odom"))?,
            tf: name(self.tf_topic.as_deref().unwrap_or("tf"))?,
            tf_static: name(self.tf_static_topic.as_deref().unwrap_or("tf_static"))?,
            goal_pose: name("goal_pose")?,
            goal: name("waypost/goal")?,
            cmd_vel: name("cmd_vel")?,
            navigate_to_pose: name("navigate_to_pose")?,
            pose: name("waypost/pose")?,
            path: name("waypost/path")?,
            markers: name("waypost/markers")?,
            diagnostics: name("/diagnostics")?,
            services: Services {
                localize: name("waypost/localize")?,
                start: name("waypost/start")?,
                finish: name("waypost/finish")?,
                set_parameters: name("waypost/set_parameters")?,
                get_parameters: name("waypost/get_parameters")?,
                list_parameters: name("waypost/list_parameters")?,
            },
            new_place: name("waypost/new_place")?,
            most_probable_place: name("waypost/most_probable_place")?,
            matched: name("waypost/match")?,
        })
    }
}

/// The topic `camera_info` of the camera whose images a topic has.
fn beside(image: &str) -> String {
    let image = image.strip_suffix("/compressed").unwrap_or(image);
    let camera = image.rsplit_once('/').map_or("", |(camera, _)| camera);
    format!("{camera}/camera_info")
}

fn read(path: &Path) -> Result<Given, SettingsError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| SettingsError::Unreadable { path: path.to_owned(), source })?;
    toml::from_str(&text).map_err(|source| SettingsError::File { path: path.to_owned(), source })
}

fn at_least_zero(name: &'static str, value: f64) -> Result<f64, SettingsError> {
    if value.is_finite() && value >= 0.0 {
        Ok(value)
    } else {
        Err(SettingsError::Number { name, value, least: "0 or above" })
    }
}

#[cfg(test)]
mod tests;
