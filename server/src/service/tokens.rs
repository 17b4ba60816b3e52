//! Who may use the server.

use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sha2::{Digest, Sha256};
use tokio::sync::Mutex as AsyncMutex;
use tokio_util::sync::CancellationToken;

use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::net::messages::Room;
use crate::net::standing::Admission;
use crate::pages::{Page, named_page, page_after, page_size};
use crate::quotas::Used;
pub(crate) use crate::storage::TokenRow;
use crate::storage::{SecretHash, Storage, StorageError};

mod caller;
mod changing;
mod ending;
mod guesses;
mod known;
mod limiting;

pub(crate) use caller::{Access, Caller};
pub(crate) use changing::{NewToken, Rotation};
pub(crate) use ending::Ending;
use known::Known;
pub(crate) use limiting::LimitChange;

/// How often the clock is looked at for tokens that expire: it may have been set.
const LOOK: Duration = Duration::from_secs(1);

/// Whom a server without any token serves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Anonymous {
    /// Everyone on the same machine.
    #[default]
    Local,
    /// Everyone who reaches it.
    Everyone,
    /// Nobody.
    Refused,
}

/// All tokens, in memory: to check one costs no query. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Tokens {
    storage: Storage,
    known: Arc<Mutex<Known>>,
    /// Held while tokens change, in the database and here.
    changing: Arc<AsyncMutex<()>>,
}

/// What a call may go on with that was let in.
#[derive(Clone, Debug)]
pub(crate) struct Admitted {
    pub(crate) caller: Arc<Caller>,
    /// When the call must end before it is done.
    pub(crate) ending: Ending,
    /// For the messages that come in.
    pub(crate) room: Room,
}

impl Admitted {
    /// What lets the connection stay over which the call came.
    pub(crate) fn admission(&self) -> Admission {
        Admission { token: self.caller.token.clone(), deleted: self.ending.over().clone() }
    }
}

impl Tokens {
    pub(crate) async fn load(storage: &Storage) -> Result<Self, StorageError> {
        let mut known = Known::new(storage.quotas().clone());
        storage.tokens().await?.into_iter().for_each(|token| known.put(token));
        Ok(Self { storage: storage.clone(), known: Arc::new(Mutex::new(known)), changing: Arc::default() })
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.lock().is_empty()
    }

    /// All, by name.
    pub(crate) fn all(&self) -> Vec<TokenRow> {
        self.lock().tokens().cloned().collect()
    }

    /// Who shows the secret of a token that there is.
    pub(crate) fn caller_named(&self, name: &str) -> Option<Caller> {
        self.lock().token(name).ok().map(|token| Caller::of(token, token.expires_ns))
    }

    pub(crate) fn anonymous(&self) -> Anonymous {
        self.lock().anonymous
    }

    /// Whom to serve from now on while there is no token.
    pub(crate) fn set_anonymous(&self, anonymous: Anonymous) {
        self.lock().anonymous = anonymous;
    }

    /// Whether everyone on this machine is served, and nobody else is to be.
    pub(crate) fn serve_this_machine(&self) -> bool {
        let known = self.lock();
        known.is_empty() && known.anonymous == Anonymous::Local
    }

    /// How many wrong secrets are taken from one address in a minute.
    pub(crate) fn set_guesses_per_minute(&self, guesses: u32) {
        self.lock().guesses.per_minute = guesses;
    }

    /// What there is that counts for a token's quotas.
    pub(crate) fn used_by(&self, token: &str) -> Used {
        self.storage.quotas().used_by(token)
    }

    /// Lets a call from `peer` in, or says why not.
    pub(crate) fn admit(
        &self,
        peer: Option<IpAddr>,
        secret: Option<&str>,
        access: Access,
    ) -> Result<Admitted, ServiceError> {
        let mut known = self.lock();
        if access == Access::Open {
            return Ok(known.anybody(Ending::default()));
        }
        let may_be_anonymous = match known.anonymous {
            // One that is asked of by a neighbour may come from anywhere.
            Anonymous::Local => peer.is_none_or(|peer| peer.to_canonical().is_loopback()),
            Anonymous::Everyone => true,
            Anonymous::Refused => false,
        };
        if known.is_empty() && may_be_anonymous {
            return Ok(known.anybody(known.without_token.clone()));
        }
        let Some(secret) = secret else {
            return Err(ServiceError::unauthenticated(
                "this server asks for a token; send one as `authorization: Bearer SECRET` \
                 (waypost: --token or WAYPOST_TOKEN); who runs the server can create one",
            ));
        };
        let Some(secret) = known.secret(&hash(secret)) else {
            known.guesses.count(peer)?;
            return Err(ServiceError::unauthenticated(
                "this token is not known here: it was deleted, or is of another server, or not whole; \
                 ask who runs the server for a new one",
            ));
        };
        secret.check_time(now_ns())?;
        secret.caller.check(access)?;
        Ok(secret.admitted())
    }

    /// Whose a secret is, whatever they may do: so that a refusal can be told apart from those of others.
    pub(crate) fn holder(&self, secret: Option<&str>) -> Option<Arc<Caller>> {
        Some(self.lock().secret(&hash(secret?))?.caller.clone())
    }

    /// Ends, until the server stops, what was begun with tokens and secrets when their time is over.
    pub(crate) async fn keep_ending(self, stopping: CancellationToken) {
        loop {
            let now = now_ns();
            let next = self.lock().end_what_is_over(now);
            let left = next.map(|at| Duration::from_nanos(at.saturating_sub(now).unsigned_abs()));
            tokio::select! {
                () = tokio::time::sleep(left.unwrap_or(LOOK).min(LOOK)) => {}
                () = stopping.cancelled() => return,
            }
        }
    }

    /// Tokens by name, from a page on.
    pub(crate) fn list(&self, size: u32, page_token: &str) -> Result<Page<TokenRow>, ServiceError> {
        let size = page_size(size)? as usize;
        let after = named_page(page_token)?;
        let mut items = self.all();
        items.retain(|token| token.name > after);
        let more = items.len() > size;
        items.truncate(size);
        let next = items.last().filter(|_| more).map(|token| page_after(&token.name)).unwrap_or_default();
        Ok(Page { items, next })
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn hash(secret: &str) -> SecretHash {
    Sha256::digest(secret).into()
}

#[cfg(test)]
mod tests;
