//! HTTP/2 by hand (RFC 9113), as only those speak it who mean harm.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Kinds of frames, and flags.
pub(super) mod kind {
    pub(crate) const DATA: u8 = 0;
    pub(crate) const HEADERS: u8 = 1;
    pub(crate) const PRIORITY: u8 = 2;
    pub(crate) const RST_STREAM: u8 = 3;
    pub(crate) const SETTINGS: u8 = 4;
    pub(crate) const PING: u8 = 6;
    pub(crate) const WINDOW_UPDATE: u8 = 8;
    pub(crate) const CONTINUATION: u8 = 9;
    pub(crate) const ACK: u8 = 1;
    pub(crate) const END_STREAM: u8 = 1;
    pub(crate) const END_HEADERS: u8 = 4;
}

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const INITIAL_WINDOW: i64 = 65_535;
const FRAME_BYTES: usize = 16 << 10;

pub(super) fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

pub(super) fn data(stream: u32, payload: &[u8]) -> Vec<u8> {
    frame(kind::DATA, 0, stream, payload)
}

/// How a connection begins.
pub(super) fn opened() -> Vec<u8> {
    [PREFACE, &frame(kind::SETTINGS, 0, 0, &[]), &frame(kind::SETTINGS, kind::ACK, 0, &[])].concat()
}

/// A header field that is not indexed, and not compressed (RFC 7541, section 6.2.2).
pub(super) fn literal(name: &str, value: &str) -> Vec<u8> {
    let text = |text: &str| {
        assert!(text.len() < 127, "longer ones take more than a byte");
        [&[text.len() as u8], text.as_bytes()].concat()
    };
    [vec![0], text(name), text(value)].concat()
}

/// The headers of a call of gRPC, with further fields.
pub(super) fn block(path: &str, further: &[(&str, &str)]) -> Vec<u8> {
    let usual = [
        (":method", "POST"),
        (":scheme", "http"),
        (":path", path),
        (":authority", "localhost"),
        ("content-type", "application/grpc"),
        ("te", "trailers"),
    ];
    usual.iter().chain(further).flat_map(|(name, value)| literal(name, value)).collect()
}

/// What came back on a stream.
#[derive(Clone, Debug)]
pub(super) enum Answered {
    Reset,
    /// The block of headers, and whether nothing follows it.
    Headers(Vec<u8>),
}

impl Answered {
    /// Whether it is a reset, or a status of 431 (which is in no table: it is spelt out, or in Huffman's code).
    pub(super) fn refused(&self) -> bool {
        match self {
            Answered::Reset => true,
            Answered::Headers(block) => {
                let spelt = block.windows(3).any(|part| part == b"431");
                // 4, 3, 1 in the code of RFC 7541, appendix B: 011010 011001 00001, then ones.
                spelt || block.windows(3).any(|part| part == [0x69, 0x90, 0xff])
            }
        }
    }
}

/// What is said on a connection. An error means that the server takes no more of it.
pub(super) type Abuse = fn(&mut Wire) -> io::Result<()>;

/// One connection.
#[derive(Debug)]
pub(super) struct Wire {
    stream: TcpStream,
}

impl Wire {
    pub(super) fn to(port: SocketAddr) -> io::Result<Self> {
        let stream = TcpStream::connect(port)?;
        stream.set_nodelay(true)?;
        let mut wire = Self { stream };
        wire.give_up_after(Duration::from_secs(5));
        Ok(wire)
    }

    /// What is written or read fails after that.
    pub(super) fn give_up_after(&mut self, patience: Duration) {
        self.stream.set_write_timeout(Some(patience)).unwrap();
        self.stream.set_read_timeout(Some(patience)).unwrap();
    }

    /// Whether the server closes it, whatever it says before.
    pub(super) fn is_closed_within(&mut self, patience: Duration) -> bool {
        let deadline = Instant::now() + patience;
        let mut heard = [0; 1 << 16];
        while let Some(left) = deadline.checked_duration_since(Instant::now()).filter(|left| !left.is_zero())
        {
            self.stream.set_read_timeout(Some(left)).unwrap();
            match self.stream.read(&mut heard) {
                Ok(0) => return true,
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(_) => return true,
            }
        }
        false
    }

    /// The next frame: its kind, flags, stream and payload.
    fn next(&mut self) -> io::Result<(u8, u8, u32, Vec<u8>)> {
        let mut head = [0; 9];
        self.stream.read_exact(&mut head)?;
        let [a, b, c, kind, flags, stream @ ..] = head;
        let mut payload = vec![0; u32::from_be_bytes([0, a, b, c]) as usize];
        self.stream.read_exact(&mut payload)?;
        Ok((kind, flags, u32::from_be_bytes(stream), payload))
    }

    /// The first answer on a stream.
    pub(super) fn answer_on(&mut self, wanted: u32, patience: Duration) -> Option<Answered> {
        self.give_up_after(patience);
        loop {
            match self.next().ok()? {
                (kind::RST_STREAM, _, stream, _) if stream == wanted => return Some(Answered::Reset),
                (kind::HEADERS, _, stream, block) if stream == wanted => {
                    return Some(Answered::Headers(block));
                }
                _ => {}
            }
        }
    }

    /// Sends as much of `left`, streams and bytes, as the server's windows let through, until they have let nothing through for so
    /// long; answers PINGs. `piece` makes a frame of a stream, the first or a later one, of a length. Gives how many bytes were sent.
    pub(super) fn pour(
        &mut self,
        left: &mut [(u32, usize)],
        still: Duration,
        piece: impl Fn(u32, bool, usize) -> Vec<u8>,
    ) -> usize {
        let mut last = Instant::now();
        let whole: Vec<usize> = left.iter().map(|(_, bytes)| *bytes).collect();
        let mut connection = INITIAL_WINDOW;
        let mut initial = INITIAL_WINDOW;
        let mut granted = vec![0_i64; left.len()];
        let mut sent = 0;
        self.give_up_after(Duration::from_millis(50));
        while last.elapsed() < still {
            for (index, (stream, bytes)) in left.iter_mut().enumerate() {
                let used = (whole[index] - *bytes) as i64;
                let window = (initial + granted[index] - used).min(connection).min(FRAME_BYTES as i64);
                let length = (*bytes).min(usize::try_from(window).unwrap_or(0));
                if length == 0 {
                    continue;
                }
                self.stream.set_write_timeout(Some(Duration::from_secs(5))).unwrap();
                if self.stream.write_all(&piece(*stream, used == 0, length)).is_err() {
                    return sent;
                }
                (*bytes, connection, sent) = (*bytes - length, connection - length as i64, sent + length);
                last = Instant::now();
            }
            match self.next() {
                Ok((kind::WINDOW_UPDATE, _, stream, more)) => {
                    let more = i64::from(u32::from_be_bytes(more.try_into().unwrap()));
                    match left.iter().position(|(known, _)| *known == stream) {
                        Some(index) => granted[index] += more,
                        None => connection += more,
                    }
                }
                Ok((kind::SETTINGS, 0, _, settings)) => {
                    for setting in settings.chunks(6) {
                        if setting[..2] == [0, 4] {
                            initial = i64::from(u32::from_be_bytes(setting[2..6].try_into().unwrap()));
                        }
                    }
                }
                Ok((kind::PING, 0, _, payload)) => {
                    let _ = self.stream.write_all(&frame(kind::PING, kind::ACK, 0, &payload));
                }
                // Refused: nothing more goes there.
                Ok((kind::RST_STREAM, _, stream, _)) => forget(left, stream),
                Ok((kind::HEADERS, flags, stream, _)) if flags & kind::END_STREAM != 0 => {
                    forget(left, stream);
                }
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(_) => return sent,
            }
        }
        sent
    }
}

fn forget(left: &mut [(u32, usize)], stream: u32) {
    left.iter_mut().filter(|(known, _)| *known == stream).for_each(|(_, bytes)| *bytes = 0);
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

impl Read for Wire {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.stream.read(bytes)
    }
}

/// How long a connection stays open on which `abuse` says what it says; `most` if it is open then still.
pub(super) fn stays_open(port: SocketAddr, abuse: Abuse, most: Duration) -> Duration {
    let began = Instant::now();
    // The address has as many connections as it may have: as good as closed at once.
    let Ok(mut wire) = Wire::to(port) else { return began.elapsed() };
    // An error means that the server closed it, or reads no further.
    let _ = abuse(&mut wire);
    if wire.is_closed_within(most.saturating_sub(began.elapsed())) { began.elapsed() } else { most }
}
