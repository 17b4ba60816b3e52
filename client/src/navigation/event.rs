//! What the server reports during a navigation, besides commands.

use waypost_proto::v1;

/// What the server reports during a navigation, besides commands.
#[derive(Clone, Debug, PartialEq)]
pub enum NavigationEvent {
    /// What a frame showed.
    Seen(v1::FrameSeen),
    /// The server refused a frame.
    FrameRefused(v1::FrameRefusal),
    /// The server refused a wheel report.
    WheelsRefused(v1::WheelRefusal),
    /// The server refused a goal.
    GoalRefused(v1::GoalRefusal),
    /// The connection broke; another attempt follows.
    Disconnected {
        /// Why.
        reason: String,
    },
    /// The connection is back.
    Reconnected {
        /// Whether the navigation continues where it was. If the server was restarted, it does not.
        resumed: bool,
    },
}
