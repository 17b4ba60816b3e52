//! How many streams of robots may be open, and which came first.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::error::ServiceError;

/// Streams that may be open at a time: each holds a few frames, of up to 4 MiB each.
const MAX_STREAMS: usize = 500;

/// When to ask again for a stream.
const RETRY: Duration = Duration::from_secs(5);

/// Room for streams, and their numbers. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct Streams {
    room: Arc<Semaphore>,
    next: Arc<AtomicU64>,
}

impl Streams {
    pub(super) fn new() -> Self {
        Self { room: Arc::new(Semaphore::new(MAX_STREAMS)), next: Arc::default() }
    }

    /// Room for one stream, until the last copy is dropped.
    pub(super) fn room(&self) -> Result<Arc<OwnedSemaphorePermit>, ServiceError> {
        let room = self.room.clone().try_acquire_owned();
        Ok(Arc::new(room.map_err(|_| ServiceError::Unavailable {
            message: format!(
                "the server has {MAX_STREAMS} streams open, and no room for more; end some that are idle, or ask again"
            ),
            retry_after: Some(RETRY),
        })?))
    }

    /// A number above those of all streams before: a later stream on the same session takes it over.
    pub(super) fn number(&self) -> u64 {
        self.next.fetch_add(1, Ordering::Relaxed)
    }
}
