//! Robots on other machines, found by their names where there is no multicast.
//!
//! RustDDS announces itself by multicast, and to the first ports of this machine. One of those ports is taken here: what
//! comes there of our own goes on to the peers, as it is. Whoever gets it answers where it says, and knows the way.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use tokio::net::{UdpSocket, lookup_host};
use tokio::time::{MissedTickBehavior, interval};

/// A peer that starts late hears of us so soon.
const PERIOD: Duration = Duration::from_secs(2);
/// The largest datagram.
const MOST_BYTES: usize = 65_536;
/// RTPS: a message begins with these, then come version, vendor, and whose it is.
const MAGIC: &[u8] = b"RTPS";
const PREFIX_AT: usize = 8;
/// How many programs of a machine are looked for: the last of these is what Cyclone takes by itself.
const PROGRAMS: u16 = 10;
/// To how many ports of this machine RustDDS announces itself.
const OWN_PORTS: u16 = 12;

/// Why peers cannot be told of us.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PeersError {
    /// A name that nobody knows.
    #[error(
        "the peer `{peer}` cannot be found: {why}; give a name or an IPv4 address, as 10.0.0.5 or robot.local:7410"
    )]
    Unknown {
        /// As given.
        peer: String,
        /// What the system said.
        why: String,
    },
    /// Too many programs of DDS on this machine.
    #[error(
        "--peer needs one of the ports {first} to {last} of this machine, by twos, and all are taken; end programs of \
         domain {domain}"
    )]
    NoPort {
        /// The lowest.
        first: u16,
        /// The highest.
        last: u16,
        /// Whose they are.
        domain: u16,
    },
    /// A socket.
    #[error("peers cannot be told of this bridge: {0}")]
    System(#[from] std::io::Error),
}

/// Tells peers of us.
pub(crate) struct Peers {
    /// Where RustDDS announces itself.
    own: UdpSocket,
    out: UdpSocket,
    to: Vec<SocketAddr>,
}

impl Peers {
    /// Finds peers as in `robot.local` or `10.0.0.5:7410`; none where none are given. To be called before the domain is
    /// joined, so that nothing is missed.
    pub(crate) async fn find(domain: u16, peers: &[String]) -> Result<Option<Self>, PeersError> {
        if peers.is_empty() {
            return Ok(None);
        }
        let mut to = Vec::new();
        for peer in peers {
            to.extend(addresses(domain, peer).await?);
        }
        // From the highest on: others take the lowest.
        let ports = || (0..OWN_PORTS).rev().map(|program| port(domain, program));
        let mut own = None;
        for port in ports() {
            if let Ok(socket) = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).await {
                own = Some(socket);
                break;
            }
        }
        let (first, last) = (port(domain, 0), port(domain, OWN_PORTS - 1));
        let own = own.ok_or(PeersError::NoPort { first, last, domain })?;
        let out = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).await?;
        Ok(Some(Self { own, out, to }))
    }

    /// Passes our announcements on until the bridge ends; `whose` is what our messages begin with.
    pub(crate) async fn tell(self, whose: [u8; 12]) {
        let mut due = interval(PERIOD);
        due.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut datagram = vec![0; MOST_BYTES];
        let mut latest = Vec::new();
        loop {
            tokio::select! {
                came = self.own.recv(&mut datagram) => match came {
                    Ok(size) if is_of(&datagram[..size], whose) => {
                        latest = datagram[..size].to_vec();
                        self.send(&latest).await;
                    }
                    // Others of this machine look for us there; they find us at our own port.
                    Ok(_) => {}
                    Err(error) => tracing::debug!("an announcement was lost: {error}"),
                },
                _ = due.tick() => self.send(&latest).await,
            }
        }
    }

    async fn send(&self, announcement: &[u8]) {
        if announcement.is_empty() {
            return;
        }
        for to in &self.to {
            // A peer that is not there yet may come: it is told again.
            if let Err(error) = self.out.send_to(announcement, to).await {
                tracing::debug!("{to} is not told of us: {error}");
            }
        }
    }
}

/// Where a program of a machine listens for announcements: RTPS 2.2, section 9.6.1.1.
fn port(domain: u16, program: u16) -> u16 {
    7400 + 250 * domain + 10 + 2 * program
}

async fn addresses(domain: u16, peer: &str) -> Result<Vec<SocketAddr>, PeersError> {
    let unknown = |why: String| PeersError::Unknown { peer: peer.to_owned(), why };
    let (host, given) = match peer.rsplit_once(':') {
        Some((host, given)) => {
            let given = given.parse().map_err(|_none| unknown(format!("`{given}` is no port")))?;
            (host, Some(given))
        }
        None => (peer, None),
    };
    let found = lookup_host((host, 0)).await.map_err(|error| unknown(error.to_string()))?;
    let found = found.filter_map(|address| match address {
        SocketAddr::V4(address) => Some(*address.ip()),
        SocketAddr::V6(_) => None,
    });
    let address = found.into_iter().next().ok_or_else(|| unknown("it has no IPv4 address".to_owned()))?;
    let ports = match given {
        Some(given) => vec![given],
        None => (0..PROGRAMS).map(|program| port(domain, program)).collect(),
    };
    Ok(ports.into_iter().map(|port| SocketAddr::V4(SocketAddrV4::new(address, port))).collect())
}

/// Whether a message of RTPS is of a participant.
fn is_of(datagram: &[u8], whose: [u8; 12]) -> bool {
    datagram.starts_with(MAGIC) && datagram.get(PREFIX_AT..PREFIX_AT + whose.len()) == Some(&whose[..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_peer_is_all_programs_of_a_machine_or_one_port() {
        let all = addresses(1, "127.0.0.1").await.unwrap();
        assert_eq!(
            (all.len(), all[0], all[9]),
            (10, "127.0.0.1:7660".parse().unwrap(), "127.0.0.1:7678".parse().unwrap())
        );
        assert_eq!(addresses(1, "127.0.0.1:9").await.unwrap(), ["127.0.0.1:9".parse().unwrap()]);
        for peer in ["127.0.0.1:port", "", "no.such.host.invalid", "[::1]:9"] {
            let told = addresses(1, peer).await.unwrap_err().to_string();
            assert!(told.contains(&format!("`{peer}` cannot be found")), "{told}");
        }
    }

    #[test]
    fn only_our_own_announcements_go_on() {
        let message = [&b"RTPS\x02\x04\x01\x12"[..], &[7; 12], b"..."].concat();
        assert!(is_of(&message, [7; 12]));
        assert!(!is_of(&message, [8; 12]));
        for cut in 0..PREFIX_AT + 12 {
            assert!(!is_of(&message[..cut], [7; 12]), "{cut}");
        }
        assert!(!is_of(&[&b"HTTP\x02\x04\x01\x12"[..], &[7; 12]].concat(), [7; 12]));
    }
}
