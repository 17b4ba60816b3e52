//! The targets, by what they take.

mod calls;
mod pictures;
mod recordings;
mod rtabmap;
mod settings;
mod stored;
mod texts;

use crate::Target;

/// All of them.
pub const TARGETS: &[Target] = &[
    Target { name: "bag", feed: recordings::bag },
    Target { name: "camera_file", feed: texts::camera_file },
    Target { name: "config", feed: settings::config },
    Target { name: "event", feed: stored::event },
    Target { name: "features", feed: pictures::features },
    Target { name: "g2o", feed: texts::g2o },
    Target { name: "grpc", feed: calls::grpc },
    Target { name: "image", feed: pictures::image },
    Target { name: "model", feed: stored::model },
    Target { name: "odometry_file", feed: texts::odometry_file },
    Target { name: "orb_vocabulary", feed: texts::orb_vocabulary },
    Target { name: "rest", feed: calls::rest },
    Target { name: "ros_message", feed: recordings::ros_message },
    Target { name: "rtabmap", feed: rtabmap::database },
    Target { name: "snapshot", feed: stored::snapshot },
    Target { name: "tum", feed: texts::tum },
];

/// The target of a name.
#[must_use]
pub fn named(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}
