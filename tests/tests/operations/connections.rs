//! Connections that say nothing, and more of them than there is room for.

use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;

use crate::harness::{Answer, ServerProcess, http, in_time};

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
