//! Messages that come in: what they may take of the memory until they are whole, and for how long.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use futures::FutureExt;
use futures::future::BoxFuture;
use http_body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep};
use tonic::body::Body;
use tonic::{Code, Status};

use super::calls::Calls;
use crate::error::ServiceError;

/// What all messages together may take that are under way.
const ALL_BYTES: usize = 256 << 20;

/// What those of one token may take.
const TOKEN_BYTES: usize = 64 << 20;

/// Largest message there is.
pub(crate) const MAX_MESSAGE_BYTES: usize = 16 << 20;

/// How long a message may take to come in; 4 MiB in that time are 280 kbit/s.
const MESSAGE_TIME: Duration = Duration::from_secs(120);

/// How long a message waits for room, and then its sender.
const PATIENCE: Duration = Duration::from_secs(10);
const RETRY: Duration = Duration::from_secs(2);

/// gRPC: a byte that says whether what follows is compressed, and its length.
const PREFIX_LEN: usize = 5;

/// Room for the messages and calls of one token. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Room {
    all: Arc<Semaphore>,
    of_token: Arc<Semaphore>,
    calls: Calls,
    patience: Duration,
}

/// Room that a message has, until this is dropped.
#[derive(Debug)]
pub(crate) struct Reserved {
    _permits: [OwnedSemaphorePermit; 2],
}

impl Room {
    /// All the room there is.
    pub(crate) fn whole() -> Self {
        let all = Arc::new(Semaphore::new(ALL_BYTES));
        Self { of_token: all.clone(), all, calls: Calls::none(), patience: PATIENCE }
    }

    /// A token's part of it.
    pub(crate) fn for_token(&self) -> Self {
        let of_token = Arc::new(Semaphore::new(TOKEN_BYTES));
        Self { all: self.all.clone(), of_token, calls: Calls::none(), patience: self.patience }
    }

    /// The calls that are open.
    pub(crate) fn calls(&self) -> &Calls {
        &self.calls
    }

    /// Waits until there is room for a message of so many bytes.
    ///
    /// # Errors
    /// UNAVAILABLE if there is none for a while.
    pub(crate) async fn reserve(&self, bytes: usize) -> Result<Reserved, ServiceError> {
        let bytes = bytes.min(MAX_MESSAGE_BYTES) as u32;
        let Self { all, of_token, calls: _, patience } = self.clone();
        let reserving = async {
            let of_token_bytes = if Arc::ptr_eq(&all, &of_token) { 0 } else { bytes };
            let of_token = of_token.acquire_many_owned(of_token_bytes).await?;
            Ok::<_, tokio::sync::AcquireError>(Reserved {
                _permits: [of_token, all.acquire_many_owned(bytes).await?],
            })
        };
        match tokio::time::timeout(patience, reserving).await {
            Ok(reserved) => reserved.map_err(ServiceError::internal),
            Err(_elapsed) => Err(ServiceError::Unavailable {
                message: format!(
                    "too many messages have begun to come in with this token and are not whole; send again in {} s, \
                     fewer at a time",
                    RETRY.as_secs()
                ),
                retry_after: Some(RETRY),
            }),
        }
    }
}

/// The messages of one gRPC call: none is read on before there is room for all of it, and none comes in for ever.
pub(crate) struct Metered {
    body: Body,
    room: Room,
    time: Duration,
    /// When the message that is coming in, or the first of the call, has to be whole.
    deadline: Pin<Box<Sleep>>,
    progress: Progress,
    /// A piece of a message that waits for room.
    waiting: Option<(Bytes, BoxFuture<'static, Result<Reserved, ServiceError>>)>,
    /// What the message that is coming in has.
    reserved: Option<Reserved>,
}

impl Metered {
    pub(crate) fn new(body: Body, room: Room) -> Self {
        Self::within(body, room, MESSAGE_TIME)
    }

    fn within(body: Body, room: Room, time: Duration) -> Self {
        let deadline = Box::pin(tokio::time::sleep(time));
        Self { body, room, time, deadline, progress: Progress::default(), waiting: None, reserved: None }
    }

    fn poll_overdue(&mut self, context: &mut Context<'_>) -> Poll<Status> {
        if self.progress.waits_for_a_message() || self.body.is_end_stream() {
            return Poll::Pending;
        }
        self.deadline.as_mut().poll(context).map(|()| {
            ServiceError::deadline(format_args!(
                "a message was not whole {} s after it began; send again, and less at a time or over a faster link",
                self.time.as_secs()
            ))
            .into()
        })
    }
}

impl HttpBody for Metered {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        if let Some((piece, room)) = &mut self.waiting {
            let reserved = std::task::ready!(room.poll_unpin(context));
            let piece = std::mem::take(piece);
            self.waiting = None;
            return Poll::Ready(Some(match reserved {
                Ok(reserved) => {
                    self.reserved = Some(reserved);
                    Ok(Frame::data(piece))
                }
                Err(error) => Err(error.into()),
            }));
        }
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let Poll::Ready(frame) = polled else {
            return self.poll_overdue(context).map(|status| Some(Err(status)));
        };
        let piece = match frame.map(|frame| frame.map(Frame::into_data)) {
            Some(Ok(Ok(piece))) => piece,
            Some(Ok(Err(trailers))) => return Poll::Ready(Some(Ok(trailers))),
            Some(Err(broken)) => return Poll::Ready(Some(Err(gone(broken)))),
            None => return Poll::Ready(None),
        };
        let before = self.progress.messages;
        self.progress.read(&piece);
        if self.progress.messages == before {
            return Poll::Ready(Some(Ok(Frame::data(piece))));
        }
        // Another message is coming in, or none.
        self.reserved = None;
        let deadline = Instant::now() + self.time;
        self.deadline.as_mut().reset(deadline);
        let Some(bytes) = self.progress.unfinished_bytes() else {
            return Poll::Ready(Some(Ok(Frame::data(piece))));
        };
        let room = self.room.clone();
        self.waiting = Some((piece, async move { room.reserve(bytes).await }.boxed()));
        self.poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.waiting.is_none() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// What a call comes to whose client went away while it sent: nobody was refused anything. The transport says UNKNOWN to it.
fn gone(broken: Status) -> Status {
    match broken.code() {
        Code::Unknown => Status::cancelled(format!("the connection broke: {}", broken.message())),
        _ => broken,
    }
}

/// How far the messages of a call have come in.
#[derive(Debug, Default)]
struct Progress {
    /// Begun, as far as their length is known; one more if the last is whole.
    messages: u64,
    prefix: Vec<u8>,
    /// Length of the message that is coming in.
    bytes: usize,
    /// What of it is still to come.
    missing: usize,
}

impl Progress {
    fn read(&mut self, mut piece: &[u8]) {
        while !piece.is_empty() {
            if self.missing > 0 {
                let taken = self.missing.min(piece.len());
                self.missing -= taken;
                piece = &piece[taken..];
                self.messages += u64::from(self.missing == 0);
                continue;
            }
            let taken = (PREFIX_LEN - self.prefix.len()).min(piece.len());
            self.prefix.extend_from_slice(&piece[..taken]);
            piece = &piece[taken..];
            if let [_compressed, a, b, c, d] = self.prefix[..] {
                self.bytes = u32::from_be_bytes([a, b, c, d]) as usize;
                self.missing = self.bytes;
                self.messages += 1;
                self.prefix.clear();
            }
        }
    }

    /// Length of a message that is there in part.
    fn unfinished_bytes(&self) -> Option<usize> {
        (self.missing > 0).then_some(self.bytes)
    }

    /// Whether all messages that have begun are whole, and there was one.
    fn waits_for_a_message(&self) -> bool {
        self.messages > 0 && self.missing == 0 && self.prefix.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use std::future::poll_fn;

    use tokio::sync::mpsc;

    use super::*;

    /// A client that sends what is put into the channel.
    struct Client(mpsc::Receiver<Vec<u8>>);

    impl HttpBody for Client {
        type Data = Bytes;
        type Error = Status;

        fn poll_frame(
            mut self: Pin<&mut Self>,
            context: &mut Context<'_>,
        ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
            self.0.poll_recv(context).map(|piece| piece.map(|piece| Ok(Frame::data(piece.into()))))
        }
    }

    fn message(bytes: u32) -> Vec<u8> {
        [&[0][..], &bytes.to_be_bytes(), &vec![7; bytes as usize]].concat()
    }

    async fn next(metered: &mut Metered) -> Option<Result<Bytes, Status>> {
        let frame = poll_fn(|context| Pin::new(&mut *metered).poll_frame(context)).await;
        frame.map(|frame| frame.map(|frame| frame.into_data().unwrap()))
    }

    async fn call(room: &Room, time: Duration) -> (mpsc::Sender<Vec<u8>>, Metered) {
        let (client, pieces) = mpsc::channel(100);
        (client, Metered::within(Body::new(Client(pieces)), room.clone(), time))
    }

    const LONG: Duration = Duration::from_secs(60);
    const SHORT: Duration = Duration::from_millis(50);

    #[tokio::test]
    async fn all_pieces_come_through_however_they_are_cut() {
        let sent = [message(3), message(0), message(70_000), message(1)].concat();
        for piece_len in [1, 4, 5, 6, 1000, 100_000] {
            let room = Room::whole().for_token();
            let (client, mut metered) = call(&room, LONG).await;
            let pieces: Vec<Vec<u8>> = sent.chunks(piece_len).map(<[u8]>::to_vec).collect();
            let sending = tokio::spawn(async move {
                for piece in pieces {
                    client.send(piece).await.unwrap();
                }
            });
            let mut heard = Vec::new();
            while let Some(piece) = next(&mut metered).await {
                heard.extend_from_slice(&piece.unwrap());
            }
            sending.await.unwrap();
            assert_eq!(heard, sent);
            assert_eq!(room.of_token.available_permits(), TOKEN_BYTES, "pieces of {piece_len}");
        }
    }

    /// A client whose connection breaks.
    struct Broken(Status);

    impl HttpBody for Broken {
        type Data = Bytes;
        type Error = Status;

        fn poll_frame(
            self: Pin<&mut Self>,
            _: &mut Context<'_>,
        ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
            Poll::Ready(Some(Err(self.0.clone())))
        }
    }

    #[tokio::test]
    async fn a_client_that_goes_away_has_cancelled_its_call() {
        for (broken, expected) in [
            (Status::unknown("h2 protocol error: error reading a body from connection"), Code::Cancelled),
            (Status::unavailable("too many messages"), Code::Unavailable),
        ] {
            let mut metered = Metered::within(Body::new(Broken(broken)), Room::whole().for_token(), LONG);
            assert_eq!(next(&mut metered).await.unwrap().unwrap_err().code(), expected);
        }
    }

    #[tokio::test]
    async fn half_a_message_has_room_for_all_of_it_and_not_for_ever() {
        let room = Room { patience: SHORT, ..Room::whole().for_token() };
        let mut held = Vec::new();
        for _ in 0..TOKEN_BYTES / MAX_MESSAGE_BYTES {
            let (client, mut metered) = call(&room, LONG).await;
            client.send(message(MAX_MESSAGE_BYTES as u32)[..10].to_vec()).await.unwrap();
            next(&mut metered).await.unwrap().unwrap();
            held.push((client, metered));
        }
        assert_eq!(room.of_token.available_permits(), 0);
        let (client, mut further) = call(&room, LONG).await;
        client.send(message(100)[..10].to_vec()).await.unwrap();
        let refused = next(&mut further).await.unwrap().unwrap_err();
        assert_eq!(refused.code(), Code::Unavailable, "{refused}");
        // Another token has room, and this one has some again when the messages are given up.
        assert!(Room { all: room.all.clone(), ..Room::whole().for_token() }.reserve(5).await.is_ok());
        held.clear();
        assert_eq!(room.of_token.available_permits(), TOKEN_BYTES);
    }

    #[tokio::test]
    async fn a_call_may_pause_between_messages_but_not_within_one() {
        let room = Room::whole().for_token();
        let (client, mut metered) = call(&room, SHORT).await;
        client.send(message(10)).await.unwrap();
        next(&mut metered).await.unwrap().unwrap();
        assert!(tokio::time::timeout(4 * SHORT, next(&mut metered)).await.is_err());
        client.send(message(10)[..6].to_vec()).await.unwrap();
        next(&mut metered).await.unwrap().unwrap();
        assert_eq!(next(&mut metered).await.unwrap().unwrap_err().code(), Code::DeadlineExceeded);
    }

    #[tokio::test]
    async fn a_call_that_begins_with_silence_ends() {
        let (_client, mut metered) = call(&Room::whole().for_token(), SHORT).await;
        assert_eq!(next(&mut metered).await.unwrap().unwrap_err().code(), Code::DeadlineExceeded);
    }
}
