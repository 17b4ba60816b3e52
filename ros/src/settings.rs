//! What the bridge does, and how.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

use serde::Deserialize;
use waypost_bags::Kind;

use crate::robot_words::WordForm;

/// How readers of sensors ask for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SensorQos {
    /// Takes what writers of either kind send; what is lost is lost.
    BestEffort,
    /// Lost messages are sent again; only writers that are reliable, too, are heard.
    Reliable,
}

/// What becomes of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// It grows.
    Map,
    /// It stays as it is.
    Localize,
    /// It stays as it is, and the robot is driven along it: by us, or by Nav2.
    Drive,
}

/// Full names of topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Topics {
    pub(crate) image: String,
    pub(crate) image_kind: Kind,
    pub(crate) camera_info: Option<String>,
    pub(crate) odometry: Option<String>,
    pub(crate) tf: String,
    pub(crate) tf_static: String,
    pub(crate) goal_pose: String,
    pub(crate) goal: String,
    pub(crate) cmd_vel: String,
    /// Nav2's action.
    pub(crate) navigate_to_pose: String,
    pub(crate) pose: String,
    pub(crate) path: String,
    pub(crate) markers: String,
    pub(crate) diagnostics: String,
    /// The parameters of the bridge's node, and what else it is asked.
    pub(crate) services: Services,
    pub(crate) new_place: String,
    pub(crate) most_probable_place: String,
    pub(crate) matched: String,
}

/// Full names of services.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Services {
    pub(crate) localize: String,
    pub(crate) start: String,
    pub(crate) finish: String,
    pub(crate) set_parameters: String,
    pub(crate) get_parameters: String,
    pub(crate) list_parameters: String,
}

/// What the bridge does, and how.
#[derive(Clone, Debug)]
pub(crate) struct Settings {
    pub(crate) server: String,
    pub(crate) token: Option<String>,
    pub(crate) ca: Option<PathBuf>,
    /// None where services choose it.
    pub(crate) map: Option<String>,
    /// Empty for the server to choose.
    pub(crate) session: String,
    pub(crate) mode: Mode,
    /// Whether Nav2 drives.
    pub(crate) is_by_nav2: bool,
    /// As the server has it by itself, if nothing is said.
    pub(crate) speed_m_s: Option<f64>,
    pub(crate) domain: u16,
    /// Empty for all.
    pub(crate) networks: Vec<IpAddr>,
    /// Other machines to find, as `robot.local` or `10.0.0.5:7410`.
    pub(crate) peers: Vec<String>,
    /// Without slashes at its ends; empty for none.
    pub(crate) namespace: String,
    pub(crate) topics: Topics,
    pub(crate) sensor_qos: SensorQos,
    pub(crate) map_frame: String,
    /// 0 for all.
    pub(crate) most_hz: f64,
    /// As the mode has it by itself, if nothing is said.
    pub(crate) buffer_frames: Option<usize>,
    pub(crate) position_sigma_m: f64,
    pub(crate) heading_sigma_rad: f64,
    /// Images are sent where none are asked for.
    pub(crate) words: Option<WordForm>,
    /// Whether services choose map and mode.
    pub(crate) is_served: bool,
    /// Where whoever looks on by Foxglove connects to.
    pub(crate) foxglove: Option<SocketAddr>,
}
