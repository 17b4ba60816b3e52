//! Connections that are meant to do harm: floods, halves, hoards. Whoever means well is served meanwhile, the memory stays what it
//! was, what does harm is closed in time, and the log says where it came from.

mod floods;
mod hoards;
mod wire;

use std::io::{Read, Write};
use std::net::SocketAddr;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use waypost_client::{Client, ClientOptions};
use waypost_server::Role;
use wire::{Abuse, Answered, Wire, block, frame, kind, opened};

use crate::harness::{Answer, ServerProcess, http, in_time};

/// A connection without an admitted call is kept for so long here.
const STRANGER_TIME_S: u64 = 1;

/// Within which a connection that does harm has to be closed. It is [`STRANGER_TIME_S`] where nothing closes it earlier; the
/// rest is for machines that are busy with other things.
const CLOSED_WITHIN: Duration = Duration::from_secs(STRANGER_TIME_S + 9);

/// What the server's memory may grow by, whatever is done to it: it has 50 MiB at its start.
const MOST_GROWTH: u64 = 32 << 20;

/// A server of its own process, as operators run it, with a token of an admin.
struct Attacked {
    server: ServerProcess,
    secret: String,
    rss_before: u64,
    _directory: TempDir,
}

impl Attacked {
    async fn start() -> Self {
        Self::start_with(&["--stranger-time-s", &STRANGER_TIME_S.to_string()]).await
    }

    async fn start_with(options: &[&str]) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let secret = waypost_server::offline::create_token(
            directory.path().into(),
            "operator",
            Role::Admin,
            Default::default(),
        );
        let secret = secret.await.unwrap();
        let server = ServerProcess::start_with(directory.path(), options);
        let attacked = Self { server, secret, rss_before: 0, _directory: directory };
        // What is made for the first call is no growth.
        attacked.others_are_served().await;
        let rss_before = attacked.server.rss_bytes();
        Self { rss_before, ..attacked }
    }

    fn ports(&self) -> [SocketAddr; 2] {
        [self.server.grpc(), self.server.http()]
    }

    /// An admin who comes new, and whatever looks after the server's health.
    async fn others_are_served(&self) {
        let options = ClientOptions::new(self.server.endpoint()).with_token(&self.secret);
        in_time(async { Client::connect(options).await.unwrap().maps().await.unwrap() }).await;
        let alive = Answer::to(http().get(format!("http://{}/healthz", self.server.http()))).await;
        assert_eq!(alive.text(), "ok\n");
    }

    /// The same where strangers have all their places: none makes room in its first second, so whoever comes tries again.
    async fn others_are_served_soon(&self) {
        let options = ClientOptions::new(self.server.endpoint()).with_token(&self.secret);
        let health = format!("http://{}/healthz", self.server.http());
        in_time(async {
            while !matches!(Client::connect(options.clone()).await, Ok(client) if client.maps().await.is_ok())
                || http().get(&health).send().await.is_err()
            {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        })
        .await;
    }

    /// Lets `abuse` do what it does on so many connections to each of `ports`, until each of them is closed. Gives the longest
    /// that one stayed open.
    async fn endures(&self, ports: &[SocketAddr], connections: usize, abuse: Abuse) -> Duration {
        let abusing: Vec<JoinHandle<Duration>> = ports
            .iter()
            .flat_map(|&port| std::iter::repeat_n(port, connections))
            .map(|port| std::thread::spawn(move || wire::stays_open(port, abuse, CLOSED_WITHIN * 3)))
            .collect();
        while !abusing.iter().all(JoinHandle::is_finished) {
            self.others_are_served().await;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        let longest = abusing.into_iter().map(|thread| thread.join().unwrap()).max().unwrap();
        self.others_are_served().await;
        longest
    }

    /// Ends it; what it said. Its memory must not have grown by more.
    fn ends(self, most_growth: u64) -> String {
        let growth = self.server.rss_bytes().saturating_sub(self.rss_before);
        let log = self.server.log();
        assert!(growth <= most_growth, "the memory grew by {} MiB", growth >> 20);
        assert!(!log.contains("panicked"), "{log}");
        self.server.stop();
        log
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn floods_of_frames_are_cut_and_delay_nobody() {
    let floods: [(&str, Abuse); 9] = [
        ("rapid resets", floods::rapid_resets),
        ("CONTINUATION", floods::continuations),
        ("SETTINGS", floods::settings),
        ("PING", floods::pings),
        ("WINDOW_UPDATE", floods::window_updates),
        ("WINDOW_UPDATE overflow", floods::window_overflow),
        ("PRIORITY", floods::priorities),
        ("empty DATA", floods::empty_data),
        ("headers by reference", floods::header_bomb),
    ];
    let attacked = Attacked::start().await;
    for (flood, abuse) in floods {
        let open = attacked.endures(&attacked.ports(), 2, abuse).await;
        println!("{flood}: closed within {open:.1?}");
        assert!(open <= CLOSED_WITHIN, "{flood}: open for {open:?}");
    }
    let log = attacked.ends(MOST_GROWTH);
    assert!(log.contains("peer=127.0.0.1") && log.contains(TOLD), "{log}");
}

/// What the log says of those whose calls were not admitted, with where they came from.
const TOLD: &str = "without an admitted call";

/// A byte in a while, and never the last.
fn drip(wire: &mut Wire, said: &[u8], byte: u8) -> std::io::Result<()> {
    wire.write_all(said)?;
    loop {
        std::thread::sleep(Duration::from_millis(200));
        wire.write_all(&[byte])?;
    }
}

fn half_a_preface(wire: &mut Wire) -> std::io::Result<()> {
    wire.write_all(&opened()[..10])
}

fn half_a_frame(wire: &mut Wire) -> std::io::Result<()> {
    let call = frame(kind::HEADERS, kind::END_HEADERS, 1, &block("/x", &[]));
    drip(wire, &[opened(), call[..9].to_vec()].concat(), 0)
}

fn half_the_headers(wire: &mut Wire) -> std::io::Result<()> {
    wire.write_all(&[opened(), frame(kind::HEADERS, 0, 1, &block("/x", &[]))].concat())
}

fn half_a_request(wire: &mut Wire) -> std::io::Result<()> {
    drip(wire, b"GET /v1/maps HTTP/1.1\r\nHost: localhost\r\nX-Slow: ", b'a')
}

/// Chunks that go on for ever, without a token.
fn endless_chunks(wire: &mut Wire) -> std::io::Result<()> {
    let head = b"POST /v1/maps HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n";
    drip(wire, head, b'\n')
}

#[tokio::test(flavor = "multi_thread")]
async fn halves_are_not_waited_for() {
    let halves: [(&str, Abuse); 3] = [
        ("half a preface", half_a_preface),
        ("half a frame", half_a_frame),
        ("half the headers", half_the_headers),
    ];
    let of_http: [(&str, Abuse); 2] =
        [("half a request", half_a_request), ("endless chunks", endless_chunks)];
    let attacked = Attacked::start().await;
    let ports = attacked.ports();
    let all = halves.map(|half| (half, &ports[..])).into_iter();
    for ((half, abuse), ports) in all.chain(of_http.map(|half| (half, &ports[1..]))) {
        // A preface that does not come has ten seconds of its own, and a stranger's connection one: what is first.
        let open = attacked.endures(ports, 30, abuse).await;
        println!("{half}: closed within {open:.1?}");
        assert!(open <= CLOSED_WITHIN + Duration::from_secs(9), "{half}: open for {open:?}");
    }
    let log = attacked.ends(MOST_GROWTH);
    assert!(log.contains("peer=127.0.0.1") && log.contains(TOLD), "{log}");
}

/// The same flood where strangers have an hour: it is that setting which cuts it.
#[tokio::test(flavor = "multi_thread")]
async fn without_the_limit_on_strangers_a_flood_goes_on() {
    let attacked = Attacked::start_with(&["--stranger-time-s", "3600"]).await;
    let port = attacked.server.grpc();
    let most = Duration::from_secs(STRANGER_TIME_S + 3);
    let open =
        tokio::task::spawn_blocking(move || wire::stays_open(port, floods::pings, most)).await.unwrap();
    assert!(open >= most, "closed after {open:?}");
    attacked.others_are_served().await;
    attacked.ends(MOST_GROWTH);
}

#[tokio::test(flavor = "multi_thread")]
async fn hundreds_of_idle_connections_keep_nobody_out() {
    const IDLE: usize = 300;
    fn idle(wire: &mut Wire) -> std::io::Result<()> {
        wire.write_all(&opened())
    }
    let attacked = Attacked::start().await;
    for port in attacked.ports() {
        let held: Vec<_> = (0..IDLE)
            .filter_map(|_| {
                let mut wire = Wire::to(port).ok()?;
                idle(&mut wire).ok()?;
                Some(wire)
            })
            .collect();
        attacked.others_are_served_soon().await;
        let began = Instant::now();
        let closed = tokio::task::spawn_blocking(|| {
            held.into_iter().all(|mut wire| wire.is_closed_within(CLOSED_WITHIN))
        });
        assert!(closed.await.unwrap(), "some are open after {:?}", began.elapsed());
    }
    attacked.ends(MOST_GROWTH);
}

/// Reads the first answer on a connection of HTTP/1, as far as it comes.
fn status_line(wire: &mut Wire) -> String {
    let mut head = [0; 12];
    let read = wire.read_exact(&mut head);
    read.map_or_else(|error| error.to_string(), |()| String::from_utf8_lossy(&head).into_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn headers_that_are_too_large_are_refused() {
    let attacked = Attacked::start().await;
    let [grpc, rest] = attacked.ports();
    let bearer = format!("Bearer {}", attacked.secret);
    tokio::task::spawn_blocking(move || {
        let mut wire = Wire::to(rest).unwrap();
        let large = "a".repeat(20 << 10);
        // The server may close before all of it is sent.
        let _ = wire
            .write_all(format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\nX: {large}\r\n\r\n").as_bytes());
        assert_eq!(status_line(&mut wire), "HTTP/1.1 431");
        for port in [grpc, rest] {
            let mut wire = Wire::to(port).unwrap();
            let many: Vec<(&str, &str)> = [("x", "0123456789")].repeat(700);
            let fields = [&[("authorization", bearer.as_str())][..], &many].concat();
            let call = block("/waypost.v1.MapService/ListMaps", &fields);
            assert!(call.len() < 16 << 10, "it fits into one frame");
            wire.write_all(&[opened(), frame(kind::HEADERS, kind::END_HEADERS, 1, &call)].concat()).unwrap();
            // Refused by itself, with 431 or a reset; the connection may stay.
            let answered = wire.answer_on(1, CLOSED_WITHIN);
            assert!(answered.as_ref().is_some_and(Answered::refused), "{answered:?}");
        }
    })
    .await
    .unwrap();
    attacked.others_are_served().await;
    attacked.ends(MOST_GROWTH);
}

/// A client that asks on and on, and reads nothing, is not read any further.
#[tokio::test(flavor = "multi_thread")]
async fn requests_in_a_row_wait_for_who_does_not_read() {
    const CONNECTIONS: usize = 10;
    /// More than the system holds for both ends.
    const TOO_MUCH: usize = 64 << 20;
    let attacked = Attacked::start().await;
    let (rest, bearer) = (attacked.server.http(), format!("Authorization: Bearer {}", attacked.secret));
    let request = format!("GET /v1/openapi.json HTTP/1.1\r\nHost: localhost\r\n{bearer}\r\n\r\n");
    let asking = tokio::task::spawn_blocking(move || {
        let mut held = Vec::new();
        for _ in 0..CONNECTIONS {
            let mut wire = Wire::to(rest).unwrap();
            wire.give_up_after(Duration::from_millis(100));
            let mut taken = 0;
            while taken < TOO_MUCH && wire.write_all(&request.as_bytes().repeat(100)).is_ok() {
                taken += 100 * request.len();
            }
            assert!(taken < TOO_MUCH, "all is taken, and nothing read");
            held.push(wire);
        }
        // In their order, each whole: what comes first is an answer.
        assert_eq!(status_line(&mut held[0]), "HTTP/1.1 200");
        held
    });
    let held = asking.await.unwrap();
    attacked.others_are_served().await;
    let growth = attacked.server.rss_bytes().saturating_sub(attacked.rss_before);
    assert!(growth <= 2 * MOST_GROWTH, "the memory grew by {} MiB", growth >> 20);
    drop(held);
    attacked.others_are_served().await;
    attacked.ends(2 * MOST_GROWTH);
}

/// With a token, too, a body ends somewhere.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_without_an_end_are_refused_when_they_are_too_much() {
    let attacked = Attacked::start().await;
    let (rest, bearer) = (attacked.server.http(), format!("Authorization: Bearer {}", attacked.secret));
    tokio::task::spawn_blocking(move || {
        let mut wire = Wire::to(rest).unwrap();
        let head = format!(
            "POST /v1/maps HTTP/1.1\r\nHost: localhost\r\n{bearer}\r\nContent-Type: application/json\r\n\
             Transfer-Encoding: chunked\r\n\r\n"
        );
        wire.write_all(head.as_bytes()).unwrap();
        let chunk = [format!("{:x}\r\n", 1 << 16).as_bytes(), &vec![b' '; 1 << 16], b"\r\n"].concat();
        let sent = (0..2000).take_while(|_| wire.write_all(&chunk).is_ok()).count();
        assert!(sent < 2000, "{sent} chunks of 64 KiB were taken");
        drop(wire);
        // What was answered may be lost when the connection is reset; of a body that stops in time it is not.
        let mut wire = Wire::to(rest).unwrap();
        let _ = wire.write_all(head.as_bytes()).and_then(|()| wire.write_all(&chunk.repeat(81)));
        assert_eq!(status_line(&mut wire), "HTTP/1.1 413");
    })
    .await
    .unwrap();
    attacked.others_are_served().await;
    attacked.ends(MOST_GROWTH);
}
