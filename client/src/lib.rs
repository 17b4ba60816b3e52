//! Async client of Waypost.
//!
//! [`Client`] asks for models, jobs and maps. [`Session`] streams the frames of one robot into a map
//! and outlives broken connections: it keeps every frame until it is answered, reconnects, resends,
//! and hands the application exactly one outcome per frame, in order.
//!
//! ```no_run
//! # async fn drive(images: Vec<Vec<u8>>) -> Result<(), waypost_client::Error> {
//! use waypost_client::{Client, FrameContent, FrameInput, FrameOutcome, SessionOptions};
//!
//! let client = Client::connect("http://127.0.0.1:7600").await?;
//! let session = client.open_session(SessionOptions::new("office")).await?;
//! let (mut frames, mut outcomes) = session.split();
//! tokio::spawn(async move {
//!     for (sequence, image) in (1..).zip(images) {
//!         let stamp_ns = 1_000_000_000 * sequence as i64;
//!         let content = FrameContent::Image(image);
//!         frames.send(FrameInput { sequence, stamp_ns, content, odometry: None }).await?;
//!     }
//!     Ok::<(), waypost_client::Error>(())
//! });
//! while let Some(outcome) = outcomes.next().await? {
//!     match outcome {
//!         FrameOutcome::Answer(answer) => println!("frame {}: {:?}", answer.sequence, answer.place),
//!         FrameOutcome::Refusal(refusal) => println!("frame {}: {:?}", refusal.sequence, refusal.status),
//!     }
//! }
//! # Ok(())
//! # }
//! ```

pub use client::{Client, JobProgress};
pub use error::Error;
pub use navigation::{Command, Navigation, NavigationEvent, NavigationOptions, Reading};
pub use options::ClientOptions;
pub use session::{
    FrameContent, FrameInput, FrameOutcome, FrameSender, Outcomes, Reconnection, Session, SessionOptions,
};
pub use tonic::Code;
pub use waypost_proto::v1;

mod appearance;
mod client;
mod error;
mod link_end;
mod looks;
mod merges;
mod navigation;
mod options;
mod session;
mod upload;
#[cfg(feature = "words")]
pub mod words;

/// Most bytes of one image; a frame with a longer one is refused.
pub const MAX_IMAGE_BYTES: usize = 4 << 20;
