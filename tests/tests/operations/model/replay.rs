//! The second path to the answers: what robots streamed into a map, streamed into a server that knows nothing else.

use std::io::Cursor;

use waypost_client::v1;
use waypost_client::v1::stream_request::Content as Request;
use waypost_client::v1::stream_response::Content as Response;

use super::comparison::{map_line, told_map_line};
use super::plain::{PlainMap, Streamed, World, of_answer, of_event, wanted_settings};
use super::seen::model;
use crate::harness::{RawStream, Server, channel, open};

/// Streams the frames of each map that came about by frames alone; how many there were.
pub(super) async fn replayed(world: &World) -> Result<u64, String> {
    let server = Server::start().await;
    let client = server.client().await;
    let named = client.import_model("small", Cursor::new(model().to_bytes())).await.unwrap();
    let mut frames = 0;
    let all = world.maps.iter().chain(world.past.iter().map(|(map, known)| (map, known)));
    for (number, (of, known)) in all.enumerate() {
        let Some(streamed) = &known.streamed else { continue };
        // Matches name the map.
        let map = &format!("{of}-{number}");
        let settings = Some(wanted_settings(known.careful));
        let request = v1::CreateMapRequest { map_id: map.clone(), model: named.name.clone(), settings };
        client.create_map(request).await.unwrap();
        let told = streamed_again(&server, (map, known), streamed, &named.words_hash).await?;
        frames += told;
        let again = told_map_line(&client.map(map, v1::MapView::Full).await.unwrap());
        let expected = map_line(known);
        if again != expected {
            return Err(format!("maps/{of} streamed into a fresh server is {again}, and was {expected}"));
        }
    }
    server.stop().await;
    Ok(frames)
}

async fn streamed_again(
    server: &Server,
    (map, known): (&str, &PlainMap),
    streamed: &[Streamed],
    words_hash: &str,
) -> Result<u64, String> {
    let channel = channel(&server.endpoint()).await;
    let mut under_way: Option<(String, RawStream)> = None;
    let mut frames = 0;
    for event in streamed {
        let (Streamed::Opened(session) | Streamed::Frame(session, _)) = event;
        let mut stream = match under_way.take() {
            Some((name, stream)) if name == *session => stream,
            _ => {
                let first = v1::OpenSession { words_hash: words_hash.to_owned(), ..open(map, session) };
                let begun = RawStream::begin_over(channel.clone(), Request::Open(first)).await;
                let mut stream = begun.map_err(|status| status.to_string())?;
                let opened = stream.next().await;
                if !matches!(opened, Ok(Some(Response::Opened(_)))) {
                    return Err(format!("{session} of {map} is not opened again: {opened:?}"));
                }
                stream
            }
        };
        if let Streamed::Frame(_, sent) = event {
            let told = of_answer(&stream.answered(sent.message()).await);
            let expected = known.frames().nth(frames).map(|frame| of_event(map, known, frame));
            if Some(&told) != expected.as_ref() {
                return Err(format!("a frame of {session} of {map} is answered {told}; it was {expected:?}"));
            }
            frames += 1;
        }
        under_way = Some((session.clone(), stream));
    }
    Ok(frames as u64)
}
