use futures::StreamExt;
use tokio::io::AsyncWriteExt;
use tokio_util::sync::CancellationToken;

use super::*;
use crate::net::standing::Admission;

const PATIENT: Limits = Limits { connections: 2, kept_for_strangers: 1, patience: Duration::from_secs(60) };
const HASTY: Limits = Limits { patience: Duration::from_millis(50), ..PATIENT };
const TWO: Strangers =
    Strangers { connections: 2, connections_per_address: 2, time: Duration::from_secs(60) };

async fn port(limits: Limits) -> Connections {
    Connections::at(TcpListener::bind("127.0.0.1:0").await.unwrap(), None, limits, TWO).unwrap()
}

async fn client(connections: &Connections, says: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(connections.at).await.unwrap();
    stream.write_all(says).await.unwrap();
    stream
}

/// Whether the server closes it, once it may have done so.
async fn is_closed(mut stream: TcpStream) -> bool {
    let read = tokio::time::timeout(Duration::from_secs(30), stream.read_u8()).await;
    read.is_ok_and(|read| read.is_err())
}

#[tokio::test]
async fn answers_do_not_wait_for_the_acknowledgement_of_those_before() {
    let mut connections = port(PATIENT).await;
    let _client = client(&connections, PREFACE).await;
    let Connection { wire, .. } = connections.next().await.unwrap().unwrap();
    assert!(matches!(wire, Wire::Plain(stream) if stream.nodelay().unwrap()));
}

#[tokio::test]
async fn nothing_that_was_said_is_lost() {
    let mut connections = port(PATIENT).await;
    for said in [PREFACE, b"G", b"PUT / HTTP/1.1\r\nHost: a\r\n\r\n", &[PREFACE, b"\0\0\0"].concat()] {
        let mut client = client(&connections, said).await;
        let mut connection = connections.next().await.unwrap().unwrap();
        client.write_all(b" and more").await.unwrap();
        let mut heard = vec![0; said.len() + 9];
        connection.read_exact(&mut heard).await.unwrap();
        assert_eq!(heard, [said, b" and more"].concat());
        connection.write_all(b"!").await.unwrap();
        assert_eq!(client.read_u8().await.unwrap(), b'!');
    }
}

#[tokio::test]
async fn who_says_nothing_or_half_of_it_is_cut() {
    let mut connections = port(HASTY).await;
    for said in [&b""[..], b"P", &PREFACE[..PREFACE.len() - 1]] {
        assert!(is_closed(client(&connections, said).await).await, "{said:?}");
    }
    let _client = client(&connections, PREFACE).await;
    assert!(connections.next().await.unwrap().is_ok());
}

#[tokio::test]
async fn a_stranger_is_cut_when_its_time_is_over() {
    let brief = Strangers { time: Duration::from_millis(50), ..TWO };
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut connections = Connections::at(listener, None, PATIENT, brief).unwrap();
    let _client = client(&connections, PREFACE).await;
    let mut stranger = connections.next().await.unwrap().unwrap();
    let cut = tokio::time::timeout(Duration::from_secs(30), async {
        let mut heard = Vec::new();
        stranger.read_to_end(&mut heard).await
    });
    assert_eq!(cut.await.unwrap().unwrap_err().kind(), io::ErrorKind::ConnectionAborted);
}

#[tokio::test]
async fn there_are_only_so_many() {
    let full = Limits { kept_for_strangers: 0, ..PATIENT };
    let mut connections = port(full).await;
    let _clients = [client(&connections, b"GET").await, client(&connections, b"GET").await];
    let first = connections.next().await.unwrap().unwrap();
    let second = connections.next().await.unwrap().unwrap();
    for connection in [&first, &second] {
        connection
            .place
            .standing()
            .admit(Admission { token: None, deleted: CancellationToken::new() })
            .unwrap();
    }
    // It may be closed before it has said anything.
    assert!(is_closed(TcpStream::connect(connections.at).await.unwrap()).await);
    drop(first);
    let _third = client(&connections, b"GET").await;
    assert!(connections.next().await.unwrap().is_ok());
}
