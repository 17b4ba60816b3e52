//! What Waypost tells ROS 2: its messages, laid out as CDR has them, a map as markers, and recordings of all that as
//! MCAP, which Foxglove and `ros2 bag` open.
//!
//! Nothing here sends anything: `waypost-ros` publishes these messages over DDS, and `waypost` writes them to files.

mod definitions;
mod graph;
mod markers;
mod messages;
mod navigate;
mod recording;
mod services;

pub use definitions::definition;
pub use graph::{Era, Gid, NODES, NodeEntities, Participant};
pub use markers::{DrawnMap, Line, MarkerArray};
pub use messages::{
    CdrError, CompressedImage, Covariance, DiagnosticArray, DiagnosticStatus, Float64, Header, KeyValue,
    Message, Odometry, Path, Pose, PoseStamped, PoseWithCovarianceStamped, Time, TransformStamped,
    Transforms, Twist, Vector3, decoded, encoded, laid_out,
};
pub use navigate::{
    CancelGoal, CancelWanted, FEEDBACK, Feedback, GetResult, GoalId, GoalTaken, GoalWanted, Outcome,
    ResultWanted, SendGoal,
};
pub use recording::{Recording, RecordingError};
pub use services::{
    Done, GetParameters, List, ListParameters, Listed, Names, Nothing, Parameter, ParameterValue, Results,
    Service, Set, SetBool, SetParameters, Switch, Trigger, Values, Wanted,
};
