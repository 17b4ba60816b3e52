//! REST, byte by byte: no client's tidying stands between.

use serde_json::Value;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::{Cases, Ground};
use crate::harness::in_time;

/// Sends a request as it is; gives status and body.
async fn answer_to(ground: &Ground, request: &[u8]) -> (u16, Vec<u8>) {
    let mut stream = TcpStream::connect(ground.server.http()).await.unwrap();
    // The server may answer, and close, before it has read all.
    let _ = stream.write_all(request).await;
    let mut response = Vec::new();
    let _ = in_time(stream.read_to_end(&mut response)).await;
    let status = response.get(9..12).and_then(|digits| std::str::from_utf8(digits).ok());
    let status = status.and_then(|digits| digits.parse().ok());
    let end =
        response.windows(4).position(|window| window == b"\r\n\r\n").map_or(response.len(), |end| end + 4);
    let shown = String::from_utf8_lossy(&response);
    (status.unwrap_or_else(|| panic!("no status: {shown}")), response[end..].to_vec())
}

async fn get(ground: &Ground, target: &[u8]) -> (u16, Vec<u8>) {
    let end = b" HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    answer_to(ground, &[b"GET ", target, end].concat()).await
}

/// Code and message of an error, which has one form.
fn error_in(body: &[u8]) -> Option<(String, String)> {
    let body: Value = serde_json::from_slice(body).ok()?;
    let text = |of: &str| body["error"][of].as_str().map(str::to_owned);
    text("code").zip(text("message"))
}

pub(super) async fn paths_and_queries(ground: &Ground) -> Cases {
    let mut cases = Cases::new("REST");
    let overlong = format!("/v1/maps/{}", "x".repeat(64));
    let long = format!("/v1/maps/{}", "x".repeat(2_000));
    let targets: Vec<(&str, &[u8], u16, &str)> = vec![
        ("unknown map", b"/v1/maps/nowhere", 404, "list the maps to see what there is"),
        ("places of no map", b"/v1/maps/nowhere/places", 404, "list the maps to see what there is"),
        ("matches of no map", b"/v1/maps/nowhere/loop-closures", 404, "list the maps to see what there is"),
        ("capitals", b"/v1/maps/Drive", 400, "use 1 to 63 of a-z"),
        ("unicode", b"/v1/maps/stra%C3%9Fe", 400, "use 1 to 63 of a-z"),
        ("a space", b"/v1/maps/the%20drive/places", 400, "use 1 to 63 of a-z"),
        ("a null", b"/v1/maps/drive%00", 400, "use 1 to 63 of a-z"),
        ("a slash in disguise", b"/v1/maps/a%2Fb", 400, "write maps/"),
        ("a parent in disguise", b"/v1/maps/%2e%2e%2f%2e%2e%2fetc%2fpasswd", 400, "write maps/"),
        ("a parent", b"/v1/maps/..", 400, "use 1 to 63 of a-z"),
        ("no UTF-8", b"/v1/maps/%ff%fe", 400, "write names as the lists have them"),
        ("half an escape", b"/v1/maps/drive%4", 400, "use 1 to 63 of a-z"),
        ("an escape that is none", b"/v1/maps/%zz", 400, "use 1 to 63 of a-z"),
        ("overlong", overlong.as_bytes(), 400, "use 1 to 63 of a-z"),
        ("long", long.as_bytes(), 400, "use 1 to 63 of a-z"),
        ("no map in it", b"/v1/maps/", 404, "/v1/maps lists the maps"),
        ("below a map", b"/v1/maps/drive/everything", 404, "/v1/maps lists the maps"),
        ("another version", b"/v2/maps", 404, "/v1/maps"),
        ("unknown view", b"/v1/maps/drive?view=everything", 400, "view=full"),
        ("no view", b"/v1/maps/drive?view=", 400, "view=full"),
        ("view twice", b"/v1/maps/drive?view=full&view=basic", 400, "view=full"),
        ("unknown parameter", b"/v1/maps/drive?depth=3", 400, "view=full"),
        ("unknown parameter of a list", b"/v1/maps?view=full", 400, "page_size=NUMBER"),
        ("page size of words", b"/v1/maps?page_size=ten", 400, "page_size=NUMBER"),
        ("page size negative", b"/v1/maps?page_size=-1", 400, "page_size=NUMBER"),
        ("page size of none", b"/v1/maps?page_size=", 400, "page_size=NUMBER"),
        ("page size in fractions", b"/v1/maps/drive/places?page_size=1.5", 400, "page_size=NUMBER"),
        ("page size too large", b"/v1/maps/drive/places?page_size=1001", 400, "at most 1000 entries"),
        ("page size of 2^32", b"/v1/maps/drive/loop-closures?page_size=4294967296", 400, "page_size=NUMBER"),
        ("page size twice", b"/v1/maps/drive/loop-closures?page_size=1&page_size=2", 400, "page_size=NUMBER"),
        ("foreign token of maps", b"/v1/maps?page_token=No%20Token", 400, "begin again without one"),
        ("a name for a token of maps", b"/v1/maps?page_token=junk", 400, "begin again without one"),
        (
            "foreign token of places",
            b"/v1/maps/drive/places?page_token=drive",
            400,
            "begin again without one",
        ),
        ("signed token of places", b"/v1/maps/drive/places?page_token=%2B1", 400, "begin again without one"),
        (
            "foreign token of matches",
            b"/v1/maps/drive/loop-closures?page_token=-1",
            400,
            "begin again without one",
        ),
        ("token that is no UTF-8", b"/v1/maps?page_token=%ff", 400, "begin again without one"),
    ];
    for (case, target, status, fragment) in targets {
        let (found, body) = get(ground, target).await;
        let shown = || ("no error in JSON".to_owned(), String::from_utf8_lossy(&body).into_owned());
        let (code, message) = error_in(&body).unwrap_or_else(shown);
        let expected = if status == 404 { "not_found" } else { "invalid_argument" };
        cases.says(case, ((found, code.as_str()), &message), ((status, expected), fragment));
    }
    cases
}

/// Requests that are bad before their path is looked at: their status alone is Waypost's to say.
pub(super) async fn requests(ground: &Ground) -> Cases {
    let mut cases = Cases::new("REST requests");
    let close = "Host: localhost\r\nConnection: close";
    let get = |target: &str| format!("GET {target} HTTP/1.1\r\n{close}\r\n\r\n").into_bytes();
    let with_body = |method: &str, target: &str, kind: &str, body: &str| {
        let length = body.len();
        let head = format!("{method} {target} HTTP/1.1\r\n{close}\r\nContent-Type: {kind}");
        format!("{head}\r\nContent-Length: {length}\r\n\r\n{body}").into_bytes()
    };
    let json = "application/json";
    let announced = format!("POST /v1/maps HTTP/1.1\r\n{close}\r\nContent-Length: {}\r\n\r\n", 8_u64 << 30);
    let announced = announced.into_bytes();
    let many_headers: String = (0..200).map(|number| format!("X-{number}: y\r\n")).collect();
    let requests: Vec<(&str, Vec<u8>, u16)> = vec![
        ("POST", with_body("POST", "/v1/maps", json, "{}"), 400),
        (
            "POST of a form",
            with_body("POST", "/v1/maps/drive", "application/x-www-form-urlencoded", "a=b"),
            405,
        ),
        ("PUT", with_body("PUT", "/v1/maps/drive", json, "{}"), 405),
        ("PATCH", with_body("PATCH", "/v1/maps/drive/places", json, "{}"), 405),
        ("DELETE", with_body("DELETE", "/v1/maps/drive/places", json, ""), 405),
        ("a method of one's own", with_body("MERGE", "/v1/maps/drive/loop-closures", json, ""), 405),
        ("a body of 8 GiB that does not come", announced, 400),
        ("a target of 100,000 bytes", get(&format!("/v1/maps?page_token={}", "x".repeat(100_000))), 431),
        ("200 headers", format!("GET /v1/maps HTTP/1.1\r\n{many_headers}{close}\r\n\r\n").into_bytes(), 431),
        ("no HTTP", b"HELLO WAYPOST\r\n\r\n".to_vec(), 400),
        (
            "a raw byte in the target",
            [&b"GET /v1/maps/\xff HTTP/1.1\r\n"[..], close.as_bytes(), b"\r\n\r\n"].concat(),
            400,
        ),
        (
            "two lengths",
            b"POST /v1/maps HTTP/1.1\r\nHost: w\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nab".to_vec(),
            400,
        ),
        (
            "a negative length",
            b"POST /v1/maps HTTP/1.1\r\nHost: w\r\nContent-Length: -1\r\n\r\n".to_vec(),
            400,
        ),
    ];
    for (case, request, status) in requests {
        let (found, body) = answer_to(ground, &request).await;
        cases.says(case, (found, &String::from_utf8_lossy(&body)), (status, ""));
    }
    // None of it has hurt the server.
    let (status, body) = self::get(ground, b"/v1/maps/drive").await;
    assert_eq!(status, 200, "{}", String::from_utf8_lossy(&body));
    cases
}
