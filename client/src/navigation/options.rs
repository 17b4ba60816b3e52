//! Options of a navigation.

use waypost_proto::v1;

use crate::client::map_name;
use crate::reconnection::Reconnection;

/// Options of a navigation.
#[derive(Clone, Debug)]
pub struct NavigationOptions {
    /// `{map}` or `maps/{map}`.
    pub map: String,
    /// Name of the navigation within the map; empty to let the server choose one.
    pub navigation_id: String,
    /// How the robot sees; its field of view, or a calibration, is needed. On a map that is
    /// navigated by appearance, a panorama or a hyperbolic mirror.
    pub camera: v1::Camera,
    /// `words_hash` of the model that the robot makes its words with; empty for one that sends
    /// images.
    pub words_hash: String,
    /// The first goal; without one the robot stands.
    pub goal: Option<v1::Goal>,
    /// Speeds and distances to drive by.
    pub driving: v1::DrivingSettings,
    /// How a broken connection is mended.
    pub reconnection: Reconnection,
}

impl NavigationOptions {
    /// All defaults, without a goal.
    pub fn new(map: &str, camera: v1::Camera) -> Self {
        Self {
            map: map_name(map),
            navigation_id: String::new(),
            camera,
            words_hash: String::new(),
            goal: None,
            driving: v1::DrivingSettings::default(),
            reconnection: Reconnection::default(),
        }
    }
}
