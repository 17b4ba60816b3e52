//! Origins: where a page in a browser comes from.

use std::fmt;
use std::str::FromStr;

use http::Uri;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// The origin of a page as browsers send it, RFC 6454: scheme, host and port, such as `https://fleet.example:8443`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin(String);

/// A text names no origin.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no origin: {reason}")]
pub struct NoOrigin {
    text: String,
    reason: &'static str,
}

impl Origin {
    /// As the header `Origin` has it.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for Origin {
    type Err = NoOrigin;

    fn from_str(text: &str) -> Result<Self, NoOrigin> {
        let wrong = |reason| NoOrigin { text: text.to_owned(), reason };
        if text == "*" {
            return Err(wrong("name each page's own, since any page could otherwise act for who visits it"));
        }
        let scheme_missing = || wrong("it begins with http:// or https://");
        let (scheme, host_and_port) = text.split_once("://").ok_or_else(scheme_missing)?;
        let scheme = scheme.to_ascii_lowercase();
        let default_port = match scheme.as_str() {
            "http" => 80,
            "https" => 443,
            _ => return Err(scheme_missing()),
        };
        if host_and_port.contains(['/', '?', '#', '@']) {
            return Err(wrong("it ends after the host or the port, without a path or a slash"));
        }
        let uri = text.parse::<Uri>().map_err(|_| wrong("its host or port cannot be read"))?;
        let host = uri.host().filter(|host| !host.is_empty() && !host.contains('*'));
        let host = host.ok_or_else(|| wrong("it names one host"))?.to_ascii_lowercase();
        let has_port = host_and_port.rsplit(']').next().is_some_and(|rest| rest.contains(':'));
        // Browsers leave out the port that the scheme means anyway.
        match (has_port, uri.port_u16()) {
            (false, _) => Ok(Self(format!("{scheme}://{host}"))),
            (true, Some(port)) if port == default_port => Ok(Self(format!("{scheme}://{host}"))),
            (true, Some(port)) if port > 0 => Ok(Self(format!("{scheme}://{host}:{port}"))),
            (true, Some(_) | None) => Err(wrong("its port is a number from 1 to 65535")),
        }
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.0)
    }
}

impl Serialize for Origin {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.0)
    }
}

impl<'de> Deserialize<'de> for Origin {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_written_as_browsers_write_it() {
        for (text, written) in [
            ("http://127.0.0.1:8080", "http://127.0.0.1:8080"),
            ("HTTPS://Fleet.Example", "https://fleet.example"),
            ("https://fleet.example:443", "https://fleet.example"),
            ("http://fleet.example:443", "http://fleet.example:443"),
            ("http://[::1]:3000", "http://[::1]:3000"),
            ("http://[::1]", "http://[::1]"),
        ] {
            assert_eq!(text.parse::<Origin>().unwrap().as_str(), written);
        }
    }

    #[test]
    fn what_is_no_origin_is_refused_with_its_reason() {
        for (text, says) in [
            ("*", "name each page's own"),
            ("null", "begins with http"),
            ("", "begins with http"),
            ("ftp://fleet.example", "begins with http"),
            ("fleet.example", "begins with http"),
            ("https://fleet.example/", "without a path or a slash"),
            ("https://fleet.example/page?x#y", "without a path or a slash"),
            ("https://me@fleet.example", "without a path or a slash"),
            ("https://", "cannot be read"),
            ("https://*.fleet.example", "one host"),
            ("https://fleet.example:", "from 1 to 65535"),
            ("https://fleet.example:0", "from 1 to 65535"),
            ("https://fleet.example:99999", "from 1 to 65535"),
            ("https://a b", "cannot be read"),
        ] {
            let message = text.parse::<Origin>().unwrap_err().to_string();
            assert!(message.contains(says) && message.contains(text), "{message:?} does not say {says:?}");
        }
    }
}
