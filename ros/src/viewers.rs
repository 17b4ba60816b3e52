//! Whoever looks on by Foxglove's app: what is told to ROS, and what the robot says, by the protocol of that app.

use std::collections::{HashMap, VecDeque};
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    ChannelBuilder, ChannelId, Context, FoxgloveError, PartialMetadata, RawChannel, Schema, WebSocketServer,
    WebSocketServerHandle,
};
use waypost_ros_messages::{Message, definition, encoded};

use crate::gate::Gate;
use crate::state::Shared;

/// Viewers at once. Each may have as much waiting as the numbers below say.
const MOST_VIEWERS: usize = 8;
/// Messages that wait for one viewer: when there are more, the oldest make way, and the robot waits for nobody.
const MOST_WAITING: usize = 64;
/// A larger message is not shown, so that what waits for a viewer has bounds in bytes.
const MOST_BYTES: usize = 4 << 20;
/// To say goodbye.
const FAREWELL: Duration = Duration::from_millis(300);

/// Foxglove's app cannot be let in, or shown something.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ViewersError {
    /// The address cannot be had.
    #[error(
        "Foxglove's app cannot be let in at {address}: {source}; end what has that port, or give another address of \
         this machine by --foxglove"
    )]
    Address {
        /// As given.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
    },
    /// Their library does not begin.
    #[error("Foxglove's app cannot be let in: {0}; please report it")]
    Library(FoxgloveError),
    /// A topic.
    #[error("Foxglove's app cannot be shown {topic}: {source}; please report it")]
    Topic {
        /// Its full name.
        topic: String,
        /// What Foxglove's library said.
        source: FoxgloveError,
    },
}

/// The messages of a topic that a viewer gets who comes late.
struct Kept {
    channel: Arc<RawChannel>,
    most: usize,
    /// With the robot's time in nanoseconds.
    messages: VecDeque<(u64, Vec<u8>)>,
}

type KeptByChannel = Arc<Mutex<HashMap<ChannelId, Kept>>>;

fn lock(kept: &KeptByChannel) -> MutexGuard<'_, HashMap<ChannelId, Kept>> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hands what is kept to those who come.
struct Welcome(KeptByChannel);

impl ServerListener for Welcome {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        let kept = lock(&self.0);
        let Some(Kept { channel, messages, .. }) = kept.get(&channel.id()) else { return };
        for (time_ns, data) in messages {
            let time = PartialMetadata { log_time: Some(*time_ns) };
            channel.log_with_meta_to_sink(data, time, client.sink_id());
        }
    }
}

/// Where viewers connect to.
pub(crate) struct Viewers {
    context: Arc<Context>,
    shared: Shared,
    kept: KeptByChannel,
    open: Mutex<Option<(Gate, WebSocketServerHandle)>>,
}

impl Viewers {
    pub(crate) async fn open(address: SocketAddr, shared: Shared) -> Result<Self, ViewersError> {
        let (context, kept) = (Context::new(), KeptByChannel::default());
        let server = WebSocketServer::new()
            .name("waypost-ros")
            .bind(Ipv4Addr::LOCALHOST.to_string(), 0)
            .context(&context)
            .message_backlog_size(MOST_WAITING)
            .listener(Arc::new(Welcome(kept.clone())));
        let server = server.start().await.map_err(ViewersError::Library)?;
        let behind = SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()));
        let gate = Gate::open(address, MOST_VIEWERS, behind).await;
        let gate = gate.map_err(|source| ViewersError::Address { address, source })?;
        tracing::info!("Foxglove's app may open ws://{}", gate.address());
        Ok(Self { context, shared, kept, open: Mutex::new(Some((gate, server))) })
    }

    /// Shows a topic of messages that Waypost makes; a viewer who comes late gets as many of the latest as is said.
    pub(crate) fn screen<M: Message>(&self, topic: &str, kept: usize) -> Result<Screen, ViewersError> {
        self.screen_of(topic, M::TYPE, kept)
    }

    /// Likewise of a type as in `nav_msgs/msg/Odometry`, whose messages come from elsewhere.
    pub(crate) fn screen_of(&self, topic: &str, ros_type: &str, kept: usize) -> Result<Screen, ViewersError> {
        let schema = Schema::new(ros_type, "ros2msg", definition(ros_type).into_bytes());
        let builder = ChannelBuilder::new(topic).context(&self.context);
        let channel = builder.message_encoding("cdr").schema(schema).build_raw();
        let channel = channel.map_err(|source| ViewersError::Topic { topic: topic.to_owned(), source })?;
        if kept > 0 {
            let none = Kept { channel: channel.clone(), most: kept, messages: VecDeque::new() };
            lock(&self.kept).insert(channel.id(), none);
        }
        Ok(Screen { channel, shared: self.shared.clone(), kept: self.kept.clone() })
    }

    /// Says goodbye to those who are there.
    pub(crate) async fn close(&self) {
        let open = self.open.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some((gate, server)) = open {
            drop(gate);
            // Whoever does not listen any more is left.
            let _ = tokio::time::timeout(FAREWELL, server.stop().wait()).await;
        }
    }
}

/// A topic as viewers see it. Nothing of it waits for them.
#[derive(Clone)]
pub(crate) struct Screen {
    channel: Arc<RawChannel>,
    shared: Shared,
    kept: KeptByChannel,
}

impl Screen {
    /// Whether somebody looks at it.
    pub(crate) fn is_watched(&self) -> bool {
        self.channel.has_sinks()
    }

    /// Shows a message. The state must not be locked.
    pub(crate) fn show<M: Message>(&self, message: &M) {
        if self.is_watched() || lock(&self.kept).contains_key(&self.channel.id()) {
            match encoded(message) {
                Ok(data) => self.show_as_is(&data),
                Err(error) => tracing::debug!("{} is not shown: {error}", self.channel.topic()),
            }
        }
    }

    /// Shows a message that is laid out, behind its four bytes of encapsulation. The state must not be locked.
    pub(crate) fn show_as_is(&self, data: &[u8]) {
        if data.len() > MOST_BYTES {
            return tracing::debug!("{} is not shown: {} bytes", self.channel.topic(), data.len());
        }
        // By the robot's clock, as its transforms are: the app looks these up by the time of what it shows.
        let robot_now_ns = self.shared.lock().robot_now_ns();
        let time_ns = robot_now_ns.and_then(|now_ns| u64::try_from(now_ns).ok()).unwrap_or_else(now_ns);
        // First kept and then shown: whoever comes in between gets it twice, and nobody misses it.
        if let Some(Kept { most, messages, .. }) = lock(&self.kept).get_mut(&self.channel.id()) {
            messages.push_back((time_ns, data.to_vec()));
            while messages.len() > *most {
                messages.pop_front();
            }
        }
        self.channel.log_with_meta(data, PartialMetadata { log_time: Some(time_ns) });
    }
}

fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
