//! Connections that say nothing, and more of them than there is room for.

use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpStream};
use std::path::Path;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use bytes::Bytes;
use http_body::{Body, Frame};
use reqwest::StatusCode;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic::Status;
use tonic::codegen::Service;
use waypost_client::{Client, ClientOptions, Code, v1};
use waypost_server::{Role, Strangers};

use crate::harness::{Answer, Proxy, Server, ServerProcess, assert_status, channel, http, in_time};

/// A line of the log that tells why connections are not taken.
const COMPLAINT: &str = "connections cannot be taken";

#[tokio::test(flavor = "multi_thread")]
async fn a_server_without_files_to_open_says_so_and_goes_on_when_it_has_some() {
    const FURTHER: u64 = 8;
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    server.limit_further_files(FURTHER);
    for port in [server.grpc(), server.http()] {
        let silent: Vec<TcpStream> = (0..2 * FURTHER).map(|_| TcpStream::connect(port).unwrap()).collect();
        let complaints = || server.log().matches(COMPLAINT).count();
        in_time(async {
            while complaints() == 0 {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        })
        .await;
        // As often as it asks the system anew, it would be five a second.
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(complaints() <= 2, "{}", server.log());
        drop(silent);
        let alive = Answer::to(http().get(format!("http://{}/healthz", server.http()))).await;
        assert_eq!(alive.text(), "ok\n");
    }
    server.client().await.maps().await.unwrap();
    server.stop();
}

#[test]
fn who_connects_and_says_nothing_is_cut() {
    let directory = tempfile::tempdir().unwrap();
    let server = ServerProcess::start(directory.path());
    let silent = [server.grpc(), server.http()].map(|port| TcpStream::connect(port).unwrap());
    for mut stream in silent {
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        assert_eq!(stream.read(&mut [0; 16]).unwrap(), 0);
    }
    server.stop();
}

/// Speaks HTTP/2, answers PINGs, calls nothing, and ends when the server closes the connection.
async fn hold(port: SocketAddr) {
    hold_from(IpAddr::V4(Ipv4Addr::LOCALHOST), port).await;
}

/// The same, from one of this machine's addresses.
async fn hold_from(address: IpAddr, port: SocketAddr) {
    const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
    const SETTINGS: [u8; 9] = [0, 0, 0, 4, 0, 0, 0, 0, 0];
    const PING: u8 = 6;
    const ACK: u8 = 1;
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.bind((address, 0).into()).unwrap();
    let Ok(mut stream) = socket.connect(port).await else { return };
    let held = async {
        stream.write_all(&[PREFACE, &SETTINGS].concat()).await?;
        loop {
            let mut head = [0; 9];
            stream.read_exact(&mut head).await?;
            let mut payload = vec![0; u32::from_be_bytes([0, head[0], head[1], head[2]]) as usize];
            stream.read_exact(&mut payload).await?;
            if head[3] == PING && head[4] & ACK == 0 {
                head[4] |= ACK;
                stream.write_all(&[&head[..], &payload].concat()).await?;
            }
        }
    };
    let ended: std::io::Result<()> = held.await;
    assert!(ended.is_err());
}

/// An admin's token in a directory.
async fn admin(directory: &Path) -> String {
    waypost_server::offline::create_token(directory.into(), "operator", Role::Admin, Default::default())
        .await
        .unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_without_an_admitted_call_is_closed_and_one_with_stays() {
    let directory = tempfile::tempdir().unwrap();
    let secret = admin(directory.path()).await;
    let brief = Strangers { connections: 64, connections_per_address: 64, time: Duration::from_secs(1) };
    let server = Server::start_as(directory.path(), |server| server.with_strangers(brief)).await;
    let proxy = Proxy::start().await;
    proxy.forward_to(Some(server.grpc()));
    let options = ClientOptions::new(proxy.endpoint()).with_token(&secret);
    let client = Client::connect(options).await.unwrap();
    client.maps().await.unwrap();
    // It has this connection or none.
    proxy.forward_to(None);
    for port in [server.grpc(), server.http()] {
        in_time(hold(port)).await;
    }
    client.maps().await.unwrap();
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn strangers_keep_nobody_out() {
    const STRANGERS: usize = 40;
    let directory = tempfile::tempdir().unwrap();
    let secret = admin(directory.path()).await;
    let few = Strangers { connections: 8, connections_per_address: 8, time: Duration::from_secs(3600) };
    let server = Server::start_as(directory.path(), |server| server.with_strangers(few)).await;
    let ports = [server.grpc(), server.http()];
    // A robot that is cut comes again.
    let strangers: Vec<_> = (0..STRANGERS)
        .map(|stranger| {
            tokio::spawn(async move {
                loop {
                    hold(ports[stranger % 2]).await;
                    tokio::time::sleep(Duration::from_millis(500)).await;
                }
            })
        })
        .collect();
    in_time(async {
        for _ in 0..10 {
            let options = ClientOptions::new(server.endpoint()).with_token(&secret);
            while !matches!(Client::connect(options.clone()).await, Ok(client) if client.maps().await.is_ok())
            {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
            let alive = async || http().get(server.url("/healthz")).send().await.is_ok();
            while !alive().await {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        }
    })
    .await;
    strangers.iter().for_each(tokio::task::JoinHandle::abort);
    server.stop().await;
}

/// Strangers that come and go as fast as they can, from several addresses, each holding its connection until it is cut.
#[tokio::test(flavor = "multi_thread")]
async fn strangers_that_come_and_go_keep_nobody_out() {
    const CALLS: usize = 20;
    let directory = tempfile::tempdir().unwrap();
    let secret = admin(directory.path()).await;
    let some = Strangers { connections: 64, connections_per_address: 32, time: Duration::from_secs(3600) };
    let server = Server::start_as(directory.path(), |server| server.with_strangers(some)).await;
    let at = server.grpc();
    let come_and_go = |last: u8| async move {
        let mut coming = tokio::time::interval(Duration::from_millis(10));
        let mut held = tokio::task::JoinSet::new();
        loop {
            coming.tick().await;
            held.spawn(hold_from([127, 0, 0, last].into(), at));
            while held.try_join_next().is_some() {}
        }
    };
    let strangers: Vec<_> = (2..=4).map(|last| tokio::spawn(come_and_go(last))).collect();
    // As many as have places are there.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let mut refused = 0;
    for _ in 0..CALLS {
        let options = ClientOptions::new(server.endpoint()).with_token(&secret);
        let call = async { Client::connect(options).await?.maps().await };
        refused += usize::from(in_time(call).await.is_err());
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    strangers.iter().for_each(tokio::task::JoinHandle::abort);
    assert_eq!(refused, 0, "of {CALLS} calls");
    server.stop().await;
}

/// A message that begins, and never ends.
struct Begun(Option<Bytes>);

impl Body for Begun {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        self.0.take().map_or(Poll::Pending, |begun| Poll::Ready(Some(Ok(Frame::data(begun)))))
    }
}

/// One token's half-sent messages have so much room; those of others are not in the way.
#[tokio::test(flavor = "multi_thread")]
async fn messages_that_are_never_whole_are_refused_beyond_their_room() {
    const CALLS: usize = 6;
    const MOST: u32 = 16 << 20;
    let directory = tempfile::tempdir().unwrap();
    let admin = admin(directory.path()).await;
    let server = Server::start_on(directory.path()).await;
    let client = Client::connect(ClientOptions::new(server.endpoint()).with_token(&admin)).await.unwrap();
    let (_, robot) = client.create_token("robot", v1::token::Role::Robot).await.unwrap();
    let hoard = async |robot: &str| {
        let at = format!("{}/waypost.v1.MapService/GetMap", server.endpoint());
        let request = tonic::codegen::http::Request::post(at).header("content-type", "application/grpc");
        let request = request.header("te", "trailers").header("authorization", format!("Bearer {robot}"));
        let begun = [&[0][..], &MOST.to_be_bytes(), b"begun"].concat();
        let request = request.body(tonic::body::Body::new(Begun(Some(begun.into())))).unwrap();
        let mut connection = channel(&server.endpoint()).await;
        std::future::poll_fn(|context| connection.poll_ready(context)).await.unwrap();
        connection.call(request).await.unwrap()
    };
    let hoarding = (0..CALLS).map(|_| Box::pin(hoard(&robot)));
    let (refused, _, hoarding) = in_time(futures::future::select_all(hoarding)).await;
    let status = Status::from_header_map(refused.headers()).unwrap();
    assert_status("hoard", (status.code(), status.message()), Code::Unavailable, "not whole");
    client.maps().await.unwrap();
    drop(hoarding);
    server.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_was_refused_is_in_the_log_and_has_only_so_many_guesses() {
    let directory = tempfile::tempdir().unwrap();
    admin(directory.path()).await;
    let server = ServerProcess::start_with(directory.path(), &["--wrong-tokens-per-minute", "2"]);
    let guess = async || {
        let url = format!("http://{}/v1/maps", server.http());
        Answer::to(http().get(url).bearer_auth("waypost_wrong")).await
    };
    // A minute may end in between.
    let refused = in_time(async {
        loop {
            let answer = guess().await;
            if answer.status == StatusCode::TOO_MANY_REQUESTS {
                break answer;
            }
        }
    });
    let retry_after_s: u64 = refused.await.header("retry-after").parse().unwrap();
    assert!((1..=60).contains(&retry_after_s), "{retry_after_s} s");
    let log = server.log();
    assert!(log.contains("peer=\"127.0.0.1\"") && log.contains("too many wrong tokens"), "{log}");
    server.stop();
}
