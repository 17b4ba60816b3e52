//! Numbers of frames and sessions within a map.

/// A frame's number within its map: its position in the log.
pub type FrameId = u64;

/// A session's number within its map, counted from 0.
pub type SessionId = u32;
