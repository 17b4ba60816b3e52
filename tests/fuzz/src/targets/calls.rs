//! Calls over gRPC and REST, to a real server with a map, in this process and without sockets.

use std::path::Path;
use std::pin::Pin;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::body::Body;
use bytes::Bytes;
use http::{HeaderMap, Method, Request, StatusCode};
use http_body::Body as _;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use waypost_server::Server;
use waypost_server::unconnected::Unconnected;

use crate::Fed;

/// Calls after which the server is a new one: maps grow by what they are fed.
const CALLS: u32 = 200;

/// Some calls answer for ever; so much of an answer is heard.
const PATIENCE: Duration = Duration::from_millis(300);
const MOST_FRAMES: usize = 1000;

/// A map of an earlier version, with its model.
const MAP: &[u8] = include_bytes!("../../../tests/fixtures/map-v3.snapshot");

/// A server in a directory of its own.
struct Site {
    runtime: Runtime,
    server: Option<Unconnected>,
    directory: Option<TempDir>,
    calls: u32,
}

static SITE: LazyLock<Mutex<Site>> = LazyLock::new(|| {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    Mutex::new(Site { runtime, server: None, directory: None, calls: 0 })
});

/// What a new site begins with: a directory in which a server has imported [`MAP`] as `drive`.
static BEGINNING: LazyLock<TempDir> = LazyLock::new(|| {
    let directory = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let server = served(directory.path()).await;
        let import = Request::post("/v1/maps/drive/import").body(Body::from(MAP)).unwrap();
        let taken = server.rest(import).await;
        assert!(taken.status().is_success(), "{taken:?}");
        let here = async || server.rest(Request::get("/v1/maps/drive").body(Body::empty()).unwrap()).await;
        while here().await.status() != StatusCode::OK {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        server.stop().await;
    });
    directory
});

async fn served(directory: &Path) -> Unconnected {
    Unconnected::of(Server::open(directory.to_owned().into()).await.unwrap()).await.unwrap()
}

impl Site {
    /// The site, whose server has not had too many calls.
    fn fresh() -> MutexGuard<'static, Self> {
        let beginning = BEGINNING.path();
        let mut guard = SITE.lock().unwrap_or_else(PoisonError::into_inner);
        let site = &mut *guard;
        site.calls += 1;
        if site.server.is_none() || site.calls > CALLS {
            if let Some(old) = site.server.take() {
                site.runtime.block_on(old.stop());
            }
            let directory = tempfile::tempdir().unwrap();
            for entry in std::fs::read_dir(beginning).unwrap() {
                let path = entry.unwrap().path();
                std::fs::copy(&path, directory.path().join(path.file_name().unwrap())).unwrap();
            }
            site.server = Some(site.runtime.block_on(served(directory.path())));
            site.directory = Some(directory);
            site.calls = 0;
        }
        guard
    }
}

/// A call of gRPC: the method in the first line, as `SessionService/Stream`, and then messages, each after its length in two
/// bytes, little-endian. Lengths are made to fit. After a `!` before the method, what follows the line goes as it is.
pub(super) fn grpc(bytes: &[u8]) -> Fed {
    let Some((method, rest)) = first_line(bytes) else { return Fed::Refused };
    let (method, body) = match method.strip_prefix('!') {
        Some(method) => (method, rest.to_vec()),
        None => (method, framed(rest)),
    };
    // A first token would keep all others out.
    if method.starts_with("TokenService")
        && !["TokenService/ListTokens", "TokenService/GetCaller"].contains(&method)
    {
        return Fed::Refused;
    }
    let request = Request::post(format!("http://localhost/waypost.v1.{method}"));
    let request = request.header("content-type", "application/grpc").header("te", "trailers");
    let Ok(request) = request.body(tonic::body::Body::new(Body::from(body))) else { return Fed::Refused };
    let site = Site::fresh();
    let server = site.server.as_ref().unwrap();
    let status = site.runtime.block_on(async {
        let answer = server.grpc(request).await.expect("every call is answered");
        let mut trailers = answer.headers().clone();
        let read = async {
            let mut body = answer.into_body();
            for _ in 0..MOST_FRAMES {
                let Some(frame) =
                    std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await
                else {
                    return;
                };
                match frame {
                    Ok(frame) => trailers.extend(frame.into_trailers().unwrap_or_default()),
                    Err(status) => drop(status.add_header(&mut trailers)),
                }
            }
        };
        let ended = tokio::time::timeout(PATIENCE, read).await;
        ended.ok().and_then(|()| tonic::Status::from_header_map(&trailers))
    });
    match status {
        None => Fed::Taken,
        Some(status) => {
            assert!(!is_our_fault(&status), "{method}: {status:?}");
            if status.code() == tonic::Code::Ok { Fed::Taken } else { Fed::Refused }
        }
    }
}

/// INTERNAL is what tonic says of bytes that are no messages; of anything else, it is a fault of the server.
fn is_our_fault(status: &tonic::Status) -> bool {
    const NO_MESSAGE: [&str; 4] =
        ["failed to decode Protobuf message", "protocol error", "Unexpected EOF", "Missing request message"];
    match status.code() {
        tonic::Code::Internal => !NO_MESSAGE.iter().any(|text| status.message().contains(text)),
        tonic::Code::Unknown | tonic::Code::DataLoss => true,
        _ => false,
    }
}

/// Messages as gRPC frames them.
fn framed(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some((&[low, high], content)) = rest.split_first_chunk() {
        let length = usize::from(u16::from_le_bytes([low, high])).min(content.len());
        body.push(0);
        body.extend((length as u32).to_be_bytes());
        body.extend(&content[..length]);
        rest = &content[length..];
    }
    body
}

fn first_line(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let end = bytes.iter().position(|&byte| byte == b'\n')?;
    let line = std::str::from_utf8(&bytes[..end]).ok()?;
    Some((line, &bytes[end + 1..]))
}

/// A request of REST: `METHOD PATH?QUERY`, headers as lines, an empty line, the body.
pub(super) fn rest(bytes: &[u8]) -> Fed {
    let Some((line, mut rest)) = first_line(bytes) else { return Fed::Refused };
    let Some((method, target)) = line.split_once(' ') else { return Fed::Refused };
    let Ok(method) = method.parse::<Method>() else { return Fed::Refused };
    // A first token would keep all others out.
    if target.contains("token") && !method.is_safe() {
        return Fed::Refused;
    }
    let mut request = Request::builder().method(method.clone()).uri(target);
    while let Some((line, further)) = first_line(rest) {
        rest = further;
        if line.is_empty() {
            break;
        }
        let Some((name, value)) = line.split_once(':') else { return Fed::Refused };
        request = request.header(name, value.trim());
    }
    let Ok(request) = request.body(Body::from(Bytes::copy_from_slice(rest))) else { return Fed::Refused };
    let site = Site::fresh();
    let server = site.server.as_ref().unwrap();
    let (status, headers, body) = site.runtime.block_on(async {
        let (parts, body) = server.rest(request).await.into_parts();
        let read = tokio::time::timeout(PATIENCE, axum::body::to_bytes(body, 64 << 20));
        (parts.status, parts.headers, read.await.ok())
    });
    assert!(
        !status.is_server_error() || status == StatusCode::SERVICE_UNAVAILABLE,
        "{line}: {status} {body:?}"
    );
    // An answer breaks off where what it tells of is deleted meanwhile, by a job that an earlier request began.
    if let Some(Ok(body)) = body
        && is_json(&headers)
        && method != Method::HEAD
    {
        serde_json::from_slice::<serde_json::Value>(&body).unwrap_or_else(|error| panic!("{line}: {error}"));
    }
    if status.is_success() { Fed::Taken } else { Fed::Refused }
}

fn is_json(headers: &HeaderMap) -> bool {
    let kind = headers.get(http::header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.ends_with("json")) && !headers.contains_key(http::header::CONTENT_ENCODING)
}
