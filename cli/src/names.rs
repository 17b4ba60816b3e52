//! Resource names as people write them.

use waypost_client::Client;

use crate::failure::Failure;

/// The identifier of a map given with or without its collection.
pub(crate) fn short_map(name: &str) -> &str {
    name.strip_prefix("maps/").unwrap_or(name)
}

/// A name for a session: what no server would take is said before anything else is looked at.
pub(crate) fn new_session(id: &str) -> Result<String, String> {
    let is_lower = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
    let is_name =
        id.bytes().enumerate().all(|(at, byte)| is_lower(byte) || (at > 0 && b"-_".contains(&byte)));
    if is_name && id.len() <= 63 {
        return Ok(id.to_owned());
    }
    Err("use 1 to 63 of a-z, 0-9, - and _, beginning with a letter or digit".to_owned())
}

/// The first twelve digits of a model's hash: enough to name it by.
pub(crate) fn short(name: &str) -> &str {
    let hash = name.strip_prefix("models/").unwrap_or(name);
    hash.get(..12).unwrap_or(hash)
}

/// The name of what is numbered, in a collection, given by its number alone or in full.
pub(crate) fn numbered(collection: &str, name: &str) -> String {
    let is_number = !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { format!("{collection}/{name}") } else { name.to_owned() }
}

/// The name of a frame of a session, by its number or by what its robot calls it.
pub(crate) async fn frame_name(
    client: &Client,
    map: &str,
    session: &str,
    frame: &str,
) -> Result<String, Failure> {
    let session_name = session_name(map, session);
    if !frame.is_empty() && frame.bytes().all(|byte| byte.is_ascii_digit()) {
        return Ok(format!("{session_name}/frames/{frame}"));
    }
    let called = client.frames_called(&session_name, frame).await?;
    match called.as_slice() {
        [only] => Ok(only.name.clone()),
        [] => Err(Failure::NotThere(format!(
            "no frame of {session_name} is called {frame:?}; list what there is: \
             `waypost session frames {map} {session}`"
        ))),
        [first, .., last] => Err(Failure::Unfit(format!(
            "{} frames of {session_name} are called {frame:?}, from {} to {}; name one by its number",
            called.len(),
            number_of(&first.name),
            number_of(&last.name)
        ))),
    }
}

fn number_of(frame: &str) -> &str {
    frame.rsplit('/').next().unwrap_or(frame)
}

/// `maps/{map}/sessions/{session}` of a map and a session that may both be named in full.
pub(crate) fn session_name(map: &str, session: &str) -> String {
    let map = short_map(map);
    let session = session.rsplit('/').next().unwrap_or(session);
    format!("maps/{map}/sessions/{session}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_sessions_are_those_that_servers_take() {
        for name in ["", "monday", "2024-05-01_b"] {
            assert_eq!(new_session(name), Ok(name.to_owned()));
        }
        for name in ["Monday", "-a", "a b", "maps/hall/sessions/a", &"a".repeat(64)] {
            assert!(new_session(name).is_err(), "{name}");
        }
    }

    #[test]
    fn a_number_is_name_enough() {
        for (name, full) in [("1", "jobs/1"), ("jobs/1", "jobs/1"), ("", ""), ("one", "one")] {
            assert_eq!(numbered("jobs", name), full);
        }
    }
}
