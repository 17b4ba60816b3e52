//! Resource names: `maps/{map}/sessions/{session}`, `models/{hash}`, `jobs/{number}`.

use crate::error::ServiceError;

/// Longest identifier that a person or robot may choose.
const MAX_ID_LEN: usize = 63;

/// Checks a chosen identifier; `what` says of what.
pub(crate) fn check_id<'a>(what: &str, id: &'a str) -> Result<&'a str, ServiceError> {
    let first = id.chars().next().is_some_and(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
    let others = id.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_');
    if first && others && id.len() <= MAX_ID_LEN {
        return Ok(id);
    }
    Err(ServiceError::invalid(format_args!(
        "{id:?} is no {what}; use 1 to {MAX_ID_LEN} of a-z, 0-9, - and _, beginning with a letter or digit"
    )))
}

/// The identifier in `{collection}/{id}`.
pub(crate) fn id_in<'a>(collection: &str, name: &'a str) -> Result<&'a str, ServiceError> {
    match name.strip_prefix(collection).and_then(|rest| rest.strip_prefix('/')) {
        Some(id) if !id.is_empty() && !id.contains('/') => Ok(id),
        Some(_) | None => {
            Err(ServiceError::invalid(format_args!("{name:?} is no name here; write {collection}/…")))
        }
    }
}

/// The map in `maps/{map}`.
pub(crate) fn map_in(name: &str) -> Result<&str, ServiceError> {
    check_id("map name", id_in("maps", name)?)
}

/// The map that a resource is, or is of, as in `maps/{map}/places/7`; `None` if it is of none.
pub(crate) fn map_of(name: &str) -> Option<&str> {
    name.strip_prefix("maps/").map(|rest| rest.split_once('/').map_or(rest, |(map, _)| map))
}

pub(crate) fn token_name(token: &str) -> String {
    format!("tokens/{token}")
}

pub(crate) fn map_name(map: &str) -> String {
    format!("maps/{map}")
}

pub(crate) fn session_name(map: &str, session: &str) -> String {
    format!("maps/{map}/sessions/{session}")
}

pub(crate) fn place_name(map: &str, place: u32) -> String {
    format!("maps/{map}/places/{place}")
}

pub(crate) fn model_name(hash: &str) -> String {
    format!("models/{hash}")
}

/// Map and session in `maps/{map}/sessions/{session}`.
pub(crate) fn session_in(name: &str) -> Result<(&str, &str), ServiceError> {
    let (map, session) = name.split_once("/sessions/").ok_or_else(|| {
        ServiceError::invalid(format_args!("{name:?} is no name here; write maps/…/sessions/…"))
    })?;
    Ok((map_in(map)?, check_id("session name", session)?))
}

/// Map, session and sequence number in `maps/{map}/sessions/{session}/frames/{sequence}`.
pub(crate) fn frame_in(name: &str) -> Result<(&str, &str, u64), ServiceError> {
    let malformed = || {
        ServiceError::invalid(format_args!(
            "{name:?} is no name here; write maps/…/sessions/…/frames/… with the frame's sequence number"
        ))
    };
    let (session, sequence) = name.split_once("/frames/").ok_or_else(malformed)?;
    let (map, session) = session_in(session)?;
    Ok((map, session, number(sequence).ok_or_else(malformed)?))
}

/// Map and number in `maps/{map}/places/{number}`.
pub(crate) fn place_in(name: &str) -> Result<(&str, u32), ServiceError> {
    let malformed =
        || ServiceError::invalid(format_args!("{name:?} is no name here; write maps/…/places/NUMBER"));
    let (map, place) = name.split_once("/places/").ok_or_else(malformed)?;
    let place = number(place).and_then(|place| u32::try_from(place).ok()).ok_or_else(malformed)?;
    Ok((map_in(map)?, place))
}

/// Map and number in `maps/{map}/corrections/{number}`.
pub(crate) fn correction_in(name: &str) -> Result<(&str, u64), ServiceError> {
    let malformed =
        || ServiceError::invalid(format_args!("{name:?} is no name here; write maps/…/corrections/NUMBER"));
    let (map, correction) = name.split_once("/corrections/").ok_or_else(malformed)?;
    Ok((map_in(map)?, number(correction).ok_or_else(malformed)?))
}

pub(crate) fn correction_name(map: &str, correction: u64) -> String {
    format!("maps/{map}/corrections/{correction}")
}

/// Map and navigation in `maps/{map}/navigations/{navigation}`.
pub(crate) fn navigation_in(name: &str) -> Result<(&str, &str), ServiceError> {
    let (map, navigation) = name.split_once("/navigations/").ok_or_else(|| {
        ServiceError::invalid(format_args!("{name:?} is no name here; write maps/…/navigations/…"))
    })?;
    Ok((map_in(map)?, check_id("navigation name", navigation)?))
}

pub(crate) fn navigation_name(map: &str, navigation: &str) -> String {
    format!("maps/{map}/navigations/{navigation}")
}

/// Digits alone: no sign, and one way of writing each number.
pub(crate) fn number(text: &str) -> Option<u64> {
    let plain = text == "0" || (!text.starts_with('0') && text.bytes().all(|digit| digit.is_ascii_digit()));
    text.parse().ok().filter(|_| plain)
}

pub(crate) fn frame_name(session_name: &str, sequence: u64) -> String {
    format!("{session_name}/frames/{sequence}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identifiers_are_checked() {
        for good in ["a", "0", "floor-3", "robot_7", &"x".repeat(63)] {
            assert_eq!(check_id("map name", good), Ok(good));
        }
        for bad in ["", "-a", "A", "a b", "ä", "../x", "a/b", &"x".repeat(64)] {
            assert!(matches!(check_id("map name", bad), Err(ServiceError::InvalidArgument { .. })), "{bad}");
        }
    }

    #[test]
    fn names_are_taken_apart() {
        assert_eq!(map_in("maps/office"), Ok("office"));
        for bad in ["office", "maps/", "maps", "map/office", "maps/a/sessions/b", ""] {
            assert!(map_in(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_map_of_a_resource_is_the_one_that_it_is_found_by() {
        for name in ["maps/a", "maps/a/sessions/b", "maps/a/sessions/b/frames/7", "maps/a/navigations/b"] {
            assert_eq!(map_of(name), Some("a"), "{name}");
        }
        assert_eq!(map_of("maps/a/places/1"), place_in("maps/a/places/1").ok().map(|(map, _)| map));
        for other in ["", "a", "maps", "models/maps/a", "/maps/a"] {
            assert_eq!(map_of(other), None, "{other}");
        }
    }

    #[test]
    fn frames_and_places_are_named_in_one_way() {
        assert_eq!(frame_in("maps/a/sessions/b/frames/7"), Ok(("a", "b", 7)));
        assert_eq!(place_in("maps/a/places/0"), Ok(("a", 0)));
        assert_eq!(correction_in("maps/a/corrections/7"), Ok(("a", 7)));
        for bad in ["maps/a/corrections/", "maps/a/corrections/+7", "corrections/7", "maps/A/corrections/7"] {
            assert!(correction_in(bad).is_err(), "{bad}");
        }
        for bad in [
            "maps/a/sessions/b/frames/",
            "maps/a/sessions/b/frames/+7",
            "maps/a/sessions/b/frames/07",
            "maps/a/frames/7",
        ] {
            assert!(frame_in(bad).is_err(), "{bad}");
        }
        for bad in ["maps/a/places/-1", "maps/a/places/4294967296", "maps/a/places", "maps/A/places/1"] {
            assert!(place_in(bad).is_err(), "{bad}");
        }
    }
}
