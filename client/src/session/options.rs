//! Options of a session.

use std::num::NonZeroUsize;

use waypost_proto::v1;

use crate::client::map_name;
use crate::reconnection::Reconnection;

/// Frames that may be on their way at once, unless the options say otherwise.
const DEFAULT_WINDOW: NonZeroUsize = NonZeroUsize::MIN.saturating_add(7);

/// Options of a session.
#[derive(Clone, Debug)]
pub struct SessionOptions {
    /// `{map}` or `maps/{map}`.
    pub map: String,
    /// Name of the session within the map; empty to let the server choose one. A session that
    /// exists is resumed.
    pub session_id: String,
    /// Whether the session adds to the map or only localizes in it.
    pub mode: v1::SessionMode,
    /// `words_hash` of the model that the robot makes its words with; empty for one that sends
    /// images. See [`v1::OpenSession`].
    pub words_hash: String,
    /// While localizing, distinguishes this run from earlier ones of the same name: a session of
    /// another run starts from the beginning. Empty to resume any. See [`v1::OpenSession`].
    pub run_id: String,
    /// The robot's camera; a session that is resumed keeps the one it began with.
    pub camera: Option<v1::Camera>,
    /// Frames without an outcome above which sending waits. They are kept in memory.
    pub window_frames: NonZeroUsize,
    /// How a broken connection is mended.
    pub reconnection: Reconnection,
}

impl SessionOptions {
    /// A new session that adds images to a map, with all defaults: 8 frames in flight, no camera.
    pub fn new(map: &str) -> Self {
        Self {
            map: map_name(map),
            session_id: String::new(),
            mode: v1::SessionMode::Map,
            words_hash: String::new(),
            run_id: String::new(),
            camera: None,
            window_frames: DEFAULT_WINDOW,
            reconnection: Reconnection::default(),
        }
    }
}
