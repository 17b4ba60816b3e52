//! Reads what ROS robots recorded: MCAP, rosbag2's SQLite and ROS 1 bags, as images with odometry and a camera.
//!
//! A bag is read twice. [`Bag::open`] reads all of it, with its checksums, and says which topics there are and what of
//! them can be used; nothing has been done with a bag that turns out to be damaged. [`Bag::choose`] says which topics
//! are used, and [`Bag::read_frames`] hands out the images with their odometry. Neither holds more of a bag than a
//! chunk's buffers and the images that wait for odometry, whatever its length.
//!
//! [`rtabmap`] reads the databases of RTAB-Map likewise, session by session.
//!
//! [`live`] reads the same messages where a robot sends them, and [`Joining`] joins them.

mod bag;
mod bytes;
mod camera;
mod choice;
mod error;
mod frames;
mod image_stamps;
mod images;
mod input;
pub mod live;
mod messages;
mod odometry;
mod pixels;
mod poses;
mod rational;
pub mod rtabmap;
mod source;
mod succession;
mod survey;
mod transforms;

pub use bag::{Bag, CutOff};
pub use bytes::{Encoding, Flaw, Malformed};
pub use camera::{Camera, Intrinsics, Lens, Rectification, Undeclared};
pub use choice::{Choice, Clock, NONE, OdometrySource, Wanted};
pub use error::{BagError, ChoiceError, LeftOut, Problem};
pub use frames::{Joined, Take};
pub use input::{MOST_MESSAGE_BYTES, Progress};
pub use messages::{CameraInfo, Kind, Pose};
pub use odometry::{Frame, Joining, LIVE, Lacks, Patience, RECORDED};
pub use poses::{Lack, MOST_GAP_NS, Poses};
pub use succession::{Astray, Step, Succession};
pub use survey::Topic;
