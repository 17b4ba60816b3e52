#![doc = include_str!("../README.md")]

pub use calls::events::{MapEvents, Watched};
pub use calls::jobs::JobProgress;
pub use client::{Call, Client};
pub use error::Error;
pub use frame::{FrameContent, FrameInput, FrameOutcome};
pub use navigation::{Command, Navigation, NavigationEvent, NavigationOptions, Reading};
pub use options::ClientOptions;
pub use reconnection::Reconnection;
pub use session::{FrameSender, Outcomes, Session, SessionOptions};
pub use tonic::Code;
pub use waypost_proto::{status_code_name, v1};

mod calls;
mod client;
mod error;
mod frame;
#[cfg(feature = "launch")]
pub mod launch;
mod navigation;
mod options;
mod reconnection;
mod session;
#[cfg(feature = "words")]
pub mod words;

/// Most bytes of one image; a frame with a longer one is refused.
pub const MAX_IMAGE_BYTES: usize = 4 << 20;
