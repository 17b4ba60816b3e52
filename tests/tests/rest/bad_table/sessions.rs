//! Queries, and what is asked of sessions and frames.

use tonic::{Code, Status};
use waypost_client::v1;
use waypost_proto::v1::frame;
use waypost_proto::v1::query_request::Content;
use waypost_proto::v1::recognition_service_client::RecognitionServiceClient;
use waypost_proto::v1::session_service_client::SessionServiceClient;

use super::maps::{SIGNED_TOKEN, bad_map_names, bad_pages};
use super::words::{BadWords, bad_words};
use super::{Cases, Ground};
use crate::harness::{histogram, images, word_maker};

fn good_query() -> v1::QueryRequest {
    v1::QueryRequest {
        map: "maps/drive".to_owned(),
        content: Some(Content::Histogram(histogram(1))),
        words_hash: word_maker().words_hash().to_owned(),
        explained_words: Some(0),
    }
}

pub(super) async fn queries(ground: &Ground) -> Cases {
    let mut service = RecognitionServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("query");
    for (case, map, code, fragment) in bad_map_names() {
        let result = service.query(v1::QueryRequest { map, ..good_query() }).await;
        cases.refused(&format!("map, {case}"), result, code, fragment);
    }
    let (invalid, precondition) = (Code::InvalidArgument, Code::FailedPrecondition);
    let image =
        |bytes: &[u8]| v1::QueryRequest { content: Some(Content::Image(bytes.to_vec())), ..good_query() };
    let hash = |words_hash: &str| v1::QueryRequest { words_hash: words_hash.to_owned(), ..good_query() };
    let explained = |explained_words| v1::QueryRequest { explained_words, ..good_query() };
    let of_other_words = v1::QueryRequest { map: "maps/other".to_owned(), ..good_query() };
    let mut long = images()[0].clone();
    long.resize((4 << 20) + 1, 0);
    for (case, request, code, fragment) in [
        ("nothing", v1::QueryRequest { content: None, ..good_query() }, invalid, "send an image or words"),
        ("an empty image", image(b""), invalid, "send the bytes of a JPEG or PNG"),
        ("text as image", image(b"no picture"), invalid, "convert it to JPEG or PNG"),
        ("half an image", image(&images()[0][..9000]), invalid, "send the whole file again"),
        ("an image too long", image(&long), invalid, "shrink it or lower its JPEG quality"),
        ("words undeclared", hash(""), invalid, "give the words_hash of the model"),
        ("words of another hash", hash(&"0".repeat(64)), precondition, "download that model"),
        ("a hash cut short", hash(&word_maker().words_hash()[..63]), precondition, "download that model"),
        ("an endless hash", hash(&"f".repeat(100_000)), precondition, "download that model"),
        ("words of another map", of_other_words, precondition, "download that model"),
        ("101 explained words", explained(Some(101)), invalid, "lists at most 100 words"),
        ("all words explained", explained(Some(u32::MAX)), invalid, "lists at most 100 words"),
    ] {
        cases.refused(case, service.query(request).await, code, fragment);
    }
    cases
}

pub(super) async fn queried_words(ground: &Ground) -> Cases {
    let mut service = RecognitionServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("queried words");
    for BadWords { case, content, fragment } in bad_words() {
        let content = match content {
            frame::Content::Histogram(histogram) => Content::Histogram(histogram),
            frame::Content::Words(words) => Content::Words(words),
            frame::Content::Image(image) => Content::Image(image),
        };
        let result = service.query(v1::QueryRequest { content: Some(content), ..good_query() }).await;
        cases.refused(case, result, Code::InvalidArgument, fragment);
    }
    cases
}

pub(super) async fn names(ground: &Ground) -> Cases {
    let mut service = SessionServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("session and frame names");
    let (invalid, missing) = (Code::InvalidArgument, Code::NotFound);
    for (case, map, code, fragment) in bad_map_names() {
        let request = v1::ListSessionsRequest { map, ..Default::default() };
        cases.refused(&format!("list, {case}"), service.list_sessions(request).await, code, fragment);
    }
    let overlong = format!("maps/drive/sessions/{}", "x".repeat(64));
    for (case, name, code, fragment) in [
        ("no name", "", invalid, "write maps/…/sessions/…"),
        ("a map", "maps/drive", invalid, "write maps/…/sessions/…"),
        ("of no collection", "drive/sessions/robot", invalid, "write maps/"),
        ("no session in it", "maps/drive/sessions/", invalid, "use 1 to 63 of a-z"),
        ("capitals", "maps/drive/sessions/Robot", invalid, "use 1 to 63 of a-z"),
        ("unicode", "maps/drive/sessions/römer", invalid, "use 1 to 63 of a-z"),
        ("a path", "maps/drive/sessions/../robot", invalid, "use 1 to 63 of a-z"),
        ("overlong", &overlong, invalid, "use 1 to 63 of a-z"),
        ("of a bad map", "maps/Drive/sessions/robot", invalid, "use 1 to 63 of a-z"),
        ("of no map", "maps/nowhere/sessions/robot", missing, "list the maps to see what there is"),
        ("of another map", "maps/other/sessions/robot", missing, "list its sessions to see what there is"),
        ("unknown", "maps/drive/sessions/nobody", missing, "list its sessions to see what there is"),
    ] {
        let request = v1::GetSessionRequest { name: name.to_owned() };
        cases.refused(&format!("session, {case}"), service.get_session(request).await, code, fragment);
        let request = v1::ListFramesRequest { session: name.to_owned(), ..Default::default() };
        cases.refused(&format!("frames, {case}"), service.list_frames(request).await, code, fragment);
    }
    let frame = |end: &str| format!("maps/drive/sessions/robot/frames/{end}");
    for (case, name, code, fragment) in [
        ("no name", String::new(), invalid, "with the frame's sequence number"),
        ("a session", "maps/drive/sessions/robot".to_owned(), invalid, "with the frame's sequence number"),
        ("no number", frame(""), invalid, "with the frame's sequence number"),
        ("a word", frame("first"), invalid, "with the frame's sequence number"),
        ("negative", frame("-1"), invalid, "with the frame's sequence number"),
        ("a fraction", frame("1.0"), invalid, "with the frame's sequence number"),
        ("2^64", frame("18446744073709551616"), invalid, "with the frame's sequence number"),
        ("below a frame", frame("1/image"), invalid, "with the frame's sequence number"),
        ("unknown", frame("11"), missing, "list its frames to see what there is"),
        ("2^63", frame("9223372036854775808"), missing, "list its frames to see what there is"),
        ("2^64 - 1", frame("18446744073709551615"), missing, "list its frames to see what there is"),
        ("of no session", "maps/drive/sessions/nobody/frames/1".to_owned(), missing, "list its sessions"),
        ("of no map", "maps/nowhere/sessions/robot/frames/1".to_owned(), missing, "list the maps"),
        ("of a bad session", "maps/drive/sessions/R2/frames/1".to_owned(), invalid, "use 1 to 63 of a-z"),
    ] {
        let mut check = |call: &str, result: Result<(), Status>| {
            cases.refused(&format!("{call}, {case}"), result, code, fragment);
        };
        let request = v1::GetFrameRequest { name: name.clone() };
        check("frame", service.get_frame(request).await.map(drop));
        let request = v1::GetFrameImageRequest { name: name.clone(), size: 0 };
        check("image", service.get_frame_image(request).await.map(drop));
        let request = v1::ExplainFrameRequest { name, place_number: None, max_words: Some(0) };
        check("explain", service.explain_frame(request).await.map(drop));
    }
    for size in [99, -1] {
        let request = v1::GetFrameImageRequest { name: frame("1"), size };
        let result = service.get_frame_image(request).await;
        cases.refused(&format!("image, size {size}"), result, invalid, "size has the value");
    }
    let request = v1::GetFrameImageRequest { name: frame("1"), size: 0 };
    let result = service.get_frame_image(request).await;
    cases.refused("image of words", result, missing, "the robot sent words, or the map keeps less");
    for (case, place, words, code, fragment) in [
        ("explain, 101 words", None, 101, invalid, "at most 100 words"),
        ("explain, all words", None, u32::MAX, invalid, "at most 100 words"),
        ("explain, a place to come", Some(u32::MAX), 1, missing, "ask about an earlier one"),
    ] {
        let request =
            v1::ExplainFrameRequest { name: frame("2"), place_number: place, max_words: Some(words) };
        cases.refused(case, service.explain_frame(request).await, code, fragment);
    }
    cases
}

pub(super) async fn pages(ground: &Ground) -> Cases {
    let mut service = SessionServiceClient::new(ground.channel().await);
    let mut cases = Cases::new("pages of sessions");
    for (case, page_size, token, fragment) in bad_pages().into_iter().chain([SIGNED_TOKEN]) {
        let page_token = token.to_owned();
        let map = "maps/drive".to_owned();
        let request = v1::ListSessionsRequest { map, page_size, page_token: page_token.clone() };
        let result = service.list_sessions(request).await;
        cases.refused(&format!("sessions, {case}"), result, Code::InvalidArgument, fragment);
        let session = "maps/drive/sessions/robot".to_owned();
        let request = v1::ListFramesRequest { session, page_size, page_token, ..Default::default() };
        let result = service.list_frames(request).await;
        cases.refused(&format!("frames, {case}"), result, Code::InvalidArgument, fragment);
    }
    cases
}
