//! How the servers of a fleet know each other.

use std::net::IpAddr;

use http::{HeaderMap, HeaderName, HeaderValue};
use sha2::{Digest, Sha256};

use crate::net::standing::Standing;

/// What a server adds that asks for somebody else: the address of who asked it, and the fleet's secret.
const FORWARDED: HeaderName = HeaderName::from_static("waypost-forwarded");

/// Those who know the fleet's secret, which is in its database.
#[derive(Clone, Debug, Default)]
pub(crate) struct Neighbours(Option<[u8; 32]>);

impl Neighbours {
    /// Nobody is one where there is no secret.
    pub(crate) fn of(secret: Option<&str>) -> Self {
        Self(secret.map(digest))
    }

    /// For whom a neighbour asks; `None` if it is no neighbour that asks.
    pub(crate) fn on_behalf_of(&self, headers: &HeaderMap) -> Option<IpAddr> {
        let (peer, secret) = headers.get(&FORWARDED)?.to_str().ok()?.split_once(' ')?;
        (digest(secret) == self.0?).then(|| peer.parse().ok())?
    }

    /// The standing of who really asks.
    pub(crate) fn standing(&self, headers: &HeaderMap, standing: &Standing) -> Option<Standing> {
        self.on_behalf_of(headers).map(|peer| standing.on_behalf_of(peer))
    }
}

/// Says for whom is asked, whatever is said of that already.
pub(crate) fn tell(headers: &mut HeaderMap, peer: IpAddr, secret: &str) {
    headers.remove(&FORWARDED);
    if let Ok(mut value) = HeaderValue::from_str(&format!("{peer} {secret}")) {
        value.set_sensitive(true);
        headers.insert(FORWARDED, value);
    }
}

/// Comparing these tells nothing of the secret by the time that it takes.
fn digest(secret: &str) -> [u8; 32] {
    Sha256::digest(secret).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_knows_the_secret_is_believed() {
        let neighbours = Neighbours::of(Some("word"));
        let peer: IpAddr = [192, 0, 2, 7].into();
        let mut headers = HeaderMap::new();
        assert_eq!(neighbours.on_behalf_of(&headers), None);
        tell(&mut headers, peer, "another");
        assert_eq!(neighbours.on_behalf_of(&headers), None);
        tell(&mut headers, peer, "word");
        assert_eq!(neighbours.on_behalf_of(&headers), Some(peer));
        assert_eq!(Neighbours::of(None).on_behalf_of(&headers), None);
        for wrong in ["word", "192.0.2.7", "x word", " word"] {
            headers.insert(FORWARDED, HeaderValue::from_static(wrong));
            assert_eq!(neighbours.on_behalf_of(&headers), None, "{wrong}");
        }
    }
}
