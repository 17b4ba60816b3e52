//! How are places joined? The map as a pure fold of its log, and the story of one frame.
//!
//! Pure: no I/O, no async, no pixels. Begin with [`mapper`], which tells the story.

mod bytes;
pub mod checkpoint;
pub mod evidence;
pub mod ids;
pub mod in_memory;
pub mod log;
pub mod map;
pub mod mapper;
pub mod merging;
pub mod metric;
pub mod rewriting;
pub mod settings;
