//! Who holds connections at a port: strangers, of whom there may be few and none for long, and those who were admitted.

use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use crate::error::ServiceError;

/// A stranger is not cut within this time of coming for another from an address with as many: it may be about to show its
/// token. So short that who comes and goes hundreds of times a second leaves places for others.
const GRACE: Duration = Duration::from_millis(100);

/// Connections that were cut and are not yet closed, beyond those that may be open.
const CLOSING: usize = 32;

/// After which a client that found no place may try again.
const FULL_RETRY: Duration = Duration::from_secs(5);

/// What a port grants to connections on which no call was admitted yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Strangers {
    /// Open at a time, in all.
    pub connections: usize,
    /// Open at a time, from one address.
    pub connections_per_address: usize,
    /// How long each is kept.
    pub time: Duration,
}

/// Everyone at one port. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Standings(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    /// Connections that may be open at a time.
    connections: usize,
    /// Of these, as many as admitted callers may hold: the others are kept for health checks.
    admitted: usize,
    strangers: Strangers,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    /// By number: who came first has the lowest.
    connections: BTreeMap<u64, Holder>,
    last: u64,
}

#[derive(Debug)]
struct Holder {
    peer: IpAddr,
    /// Since when it is what it is.
    since: Instant,
    admitted_by: Option<Admission>,
    /// Cancelled when it is to be closed.
    cut: CancellationToken,
}

/// By what a connection's last admitted call was let in.
#[derive(Clone, Debug)]
pub(crate) struct Admission {
    /// Name of the token that it showed; `None` where the server has none.
    pub(crate) token: Option<String>,
    /// Cancelled when that is deleted.
    pub(crate) deleted: CancellationToken,
}

impl Holder {
    fn is_admitted(&self) -> bool {
        self.admitted_by.is_some()
    }

    /// The token that it was admitted by, unless it is to be closed.
    fn stays_by(&self) -> Option<&Option<String>> {
        self.admitted_by.as_ref().filter(|_| !self.cut.is_cancelled()).map(|admission| &admission.token)
    }

    fn is_stranger(&self) -> bool {
        !self.is_admitted() && !self.cut.is_cancelled()
    }
}

impl Standings {
    /// At a port with room for so many connections, some of which are for strangers alone.
    pub(crate) fn new(connections: usize, kept_for_strangers: usize, strangers: Strangers) -> Self {
        let admitted = connections.saturating_sub(kept_for_strangers);
        Self(Arc::new(Shared { connections, admitted, strangers, held: Mutex::default() }))
    }

    /// A place for a connection from `peer`, as a stranger; another stranger's if there is no room. `None` if none can
    /// be had now.
    pub(crate) fn enter(&self, peer: IpAddr) -> Option<Place> {
        let Shared { connections, admitted: _, strangers, held: _ } = &*self.0;
        let mut held = self.held();
        if held.connections.len() >= connections + CLOSING {
            return None;
        }
        let by_address = held.strangers_by_address();
        let mine = by_address.get(&peer).copied().unwrap_or(0);
        if mine >= strangers.connections_per_address {
            held.cut_oldest(peer, GRACE)?;
        } else {
            let all: usize = by_address.values().sum();
            let open = held.connections.values().filter(|holder| !holder.cut.is_cancelled()).count();
            if all >= strangers.connections || open >= *connections {
                // The address with the most has to make room.
                let (most, those) = by_address.into_iter().max_by_key(|(_, those)| *those)?;
                let grace = if those > 2 * (mine + 1) { Duration::ZERO } else { GRACE };
                held.cut_oldest(most, grace)?;
            }
        }
        held.last += 1;
        let number = held.last;
        let cut = CancellationToken::new();
        let holder = Holder { peer, since: Instant::now(), admitted_by: None, cut: cut.clone() };
        held.connections.insert(number, holder);
        Some(Place { standing: Standing { all: self.clone(), number, peer }, cut })
    }

    fn held(&self) -> MutexGuard<'_, Held> {
        self.0.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Held {
    fn strangers_by_address(&self) -> HashMap<IpAddr, usize> {
        let mut by_address = HashMap::new();
        for holder in self.connections.values().filter(|holder| holder.is_stranger()) {
            *by_address.entry(holder.peer).or_default() += 1;
        }
        by_address
    }

    /// Cuts the first connection of the token that holds by far the most; `None` if that is not much more than the token has
    /// for which room is made.
    fn cut_for(&mut self, token: &Option<String>) -> Option<()> {
        let mut by_token: BTreeMap<&Option<String>, usize> = BTreeMap::new();
        for token in self.connections.values().filter_map(Holder::stays_by) {
            *by_token.entry(token).or_default() += 1;
        }
        let mine = by_token.get(token).copied().unwrap_or(0) + 1;
        let (most, _) =
            by_token.into_iter().filter(|(_, those)| *those > 2 * mine).max_by_key(|(_, those)| *those)?;
        let first = self.connections.values().find(|holder| holder.stays_by() == Some(most))?;
        first.cut.cancel();
        Some(())
    }

    /// Cuts the stranger from `peer` that came first; `None` if each has come within the time of grace.
    fn cut_oldest(&mut self, peer: IpAddr, grace: Duration) -> Option<()> {
        let mut strangers = self.connections.values().filter(|holder| holder.is_stranger());
        let oldest = strangers.find(|holder| holder.peer == peer)?;
        (oldest.since.elapsed() >= grace).then(|| oldest.cut.cancel())
    }
}

/// One connection's place at its port; given back when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    standing: Standing,
    /// Cancelled when the connection is to be closed.
    cut: CancellationToken,
}

impl Place {
    pub(crate) fn standing(&self) -> &Standing {
        &self.standing
    }

    pub(crate) fn cut(&self) -> &CancellationToken {
        &self.cut
    }

    /// When to ask again whether the connection may stay; `None` if it may not.
    pub(crate) fn review(&self) -> Option<Duration> {
        let Standing { all, number, peer: _ } = &self.standing;
        let time = all.0.strangers.time;
        let mut held = all.held();
        let holder = held.connections.get_mut(number)?;
        match &holder.admitted_by {
            Some(admission) if admission.deleted.is_cancelled() => {
                holder.admitted_by = None;
                holder.since = Instant::now();
                Some(time)
            }
            Some(_) => Some(time),
            None => time.checked_sub(holder.since.elapsed()).filter(|left| !left.is_zero()),
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let Standing { all, number, peer: _ } = &self.standing;
        all.held().connections.remove(number);
    }
}

/// What calls know of the connection that they come over.
#[derive(Clone, Debug)]
pub(crate) struct Standing {
    all: Standings,
    number: u64,
    peer: IpAddr,
}

impl Standing {
    /// Where the connection comes from.
    pub(crate) fn peer(&self) -> IpAddr {
        self.peer
    }

    /// The same connection, over which a neighbour asks for somebody else.
    pub(crate) fn on_behalf_of(&self, peer: IpAddr) -> Self {
        Self { peer, ..self.clone() }
    }

    /// Whether a call on this connection was ever admitted.
    pub(crate) fn is_admitted(&self) -> bool {
        self.all.held().connections.get(&self.number).is_some_and(Holder::is_admitted)
    }

    /// A call on this connection was admitted: it may stay. Where there is no room, a token that holds by far the most
    /// connections has to make some.
    ///
    /// # Errors
    /// UNAVAILABLE if as many connections of such are open as may be.
    pub(crate) fn admit(&self, admission: Admission) -> Result<(), ServiceError> {
        let mut held = self.all.held();
        let Some(holder) = held.connections.get(&self.number) else { return Ok(()) };
        if holder.admitted_by.as_ref().is_some_and(|admission| !admission.deleted.is_cancelled()) {
            return Ok(());
        }
        let admitted = held.connections.values().filter(|holder| holder.stays_by().is_some()).count();
        let was_admitted = held.connections.get(&self.number).is_some_and(Holder::is_admitted);
        if !was_admitted && admitted >= self.all.0.admitted && held.cut_for(&admission.token).is_none() {
            return Err(ServiceError::Unavailable {
                message: format!(
                    "{admitted} connections are open, and no more are served; close some that are not needed, or \
                     connect again in {} s",
                    FULL_RETRY.as_secs()
                ),
                retry_after: Some(FULL_RETRY),
            });
        }
        if let Some(holder) = held.connections.get_mut(&self.number) {
            holder.admitted_by = Some(admission);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANY: Strangers =
        Strangers { connections: 3, connections_per_address: 2, time: Duration::from_secs(60) };

    fn address(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    fn by(token: &str, deleted: &CancellationToken) -> Admission {
        Admission { token: Some(token.to_owned()), deleted: deleted.clone() }
    }

    #[test]
    fn a_token_that_holds_by_far_the_most_makes_room_for_others() {
        let standings =
            Standings::new(6, 1, Strangers { connections: 6, connections_per_address: 6, ..MANY });
        let token = CancellationToken::new();
        let enter = || standings.enter(address(1)).unwrap();
        let greedy: Vec<Place> = (0..5).map(|_| enter()).collect();
        greedy.iter().for_each(|place| place.standing().admit(by("greedy", &token)).unwrap());
        let admin = enter();
        admin.standing().admit(by("admin", &token)).unwrap();
        let cut = |places: &[Place]| places.iter().filter(|place| place.cut().is_cancelled()).count();
        assert!(greedy[0].cut().is_cancelled() && cut(&greedy) == 1);
        // Four are not more than twice two.
        let second = enter();
        let refused = second.standing().admit(by("admin", &token));
        assert!(matches!(refused, Err(ServiceError::Unavailable { .. })));
        assert!(!admin.cut().is_cancelled());
    }

    /// As if all had come a while ago.
    fn let_time_pass(standings: &Standings) {
        for holder in standings.held().connections.values_mut() {
            holder.since = Instant::now().checked_sub(2 * GRACE).unwrap();
        }
    }

    #[test]
    fn a_stranger_makes_room_for_the_next_one_from_its_address() {
        let standings = Standings::new(100, 1, MANY);
        let first = standings.enter(address(1)).unwrap();
        let second = standings.enter(address(1)).unwrap();
        standings
            .held()
            .connections
            .values_mut()
            .for_each(|holder| holder.since += Duration::from_secs(3600));
        assert!(standings.enter(address(1)).is_none(), "both have come just now");
        let other = standings.enter(address(2)).unwrap();
        let_time_pass(&standings);
        let _third = standings.enter(address(1)).unwrap();
        assert!(first.cut().is_cancelled() && !second.cut().is_cancelled() && !other.cut().is_cancelled());
    }

    #[test]
    fn whoever_holds_the_most_makes_room_for_others() {
        let standings = Standings::new(100, 1, MANY);
        let one = standings.enter(address(1)).unwrap();
        let two = [standings.enter(address(2)).unwrap(), standings.enter(address(2)).unwrap()];
        let_time_pass(&standings);
        let _three = standings.enter(address(3)).unwrap();
        assert!(two[0].cut().is_cancelled() && !two[1].cut().is_cancelled() && !one.cut().is_cancelled());
    }

    /// However fast they come.
    #[test]
    fn an_address_with_many_makes_room_at_once_for_one_with_few() {
        let eight = Strangers { connections: 8, connections_per_address: 8, time: Duration::from_secs(60) };
        let standings = Standings::new(100, 1, eight);
        let many: Vec<Place> = (0..8).map(|_| standings.enter(address(1)).unwrap()).collect();
        let far_ahead = Instant::now() + Duration::from_secs(3600);
        standings.held().connections.values_mut().for_each(|holder| holder.since = far_ahead);
        let few = [standings.enter(address(2)).unwrap(), standings.enter(address(2)).unwrap()];
        assert!(few.iter().all(|place| !place.cut().is_cancelled()));
        assert!(
            many[0].cut().is_cancelled() && many[1].cut().is_cancelled() && !many[2].cut().is_cancelled()
        );
        // Six are not more than twice three.
        assert!(standings.enter(address(2)).is_none());
    }

    #[test]
    fn who_was_admitted_is_never_cut_for_a_stranger_and_strangers_keep_some_places() {
        let standings = Standings::new(3, 1, MANY);
        let token = CancellationToken::new();
        let admitted = [standings.enter(address(1)).unwrap(), standings.enter(address(1)).unwrap()];
        for place in &admitted {
            place.standing().admit(by("robots", &token)).unwrap();
        }
        let health = standings.enter(address(1)).unwrap();
        let refused = health.standing().admit(by("robots", &token));
        assert!(matches!(refused, Err(ServiceError::Unavailable { .. })));
        assert!(admitted[0].standing().admit(by("robots", &token)).is_ok(), "it has its place already");
        let_time_pass(&standings);
        let _next = standings.enter(address(1)).unwrap();
        assert!(health.cut().is_cancelled() && admitted.iter().all(|place| !place.cut().is_cancelled()));
    }

    #[test]
    fn time_ends_for_strangers_and_begins_anew_when_a_token_is_deleted() {
        let brief = Strangers { time: Duration::from_millis(1), ..MANY };
        let standings = Standings::new(3, 1, brief);
        let place = standings.enter(address(1)).unwrap();
        let token = CancellationToken::new();
        place.standing().admit(by("robots", &token)).unwrap();
        let_time_pass(&standings);
        assert!(place.review().is_some());
        token.cancel();
        assert!(place.review().is_some());
        let_time_pass(&standings);
        assert!(place.review().is_none());
        drop(place);
        assert!(standings.held().connections.is_empty());
    }
}
