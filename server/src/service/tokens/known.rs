//! The tokens that there are, and what was let in by each.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use super::caller::Caller;
use super::ending::{Ending, deleted, now_asked};
use super::guesses::Guesses;
use super::{Admitted, Anonymous};
use crate::clock::{in_words, now_ns};
use crate::error::ServiceError;
use crate::net::messages::Room;
use crate::quotas::{Limits, Quotas};
use crate::role::{Reach, Role};
use crate::storage::{FormerSecret, SecretHash, TokenRow};

#[derive(Debug)]
pub(super) struct Known {
    tokens: BTreeMap<String, TokenRow>,
    /// Looked up by the hash of the secret: how long that takes tells nothing about secrets.
    secrets: HashMap<SecretHash, Secret>,
    /// Of what is served to those without a token: the first token ends it.
    pub(super) without_token: Ending,
    pub(super) anonymous: Anonymous,
    /// For all messages that come in.
    room: Room,
    pub(super) guesses: Guesses,
    quotas: Quotas,
}

/// A secret of a token.
#[derive(Debug)]
pub(super) struct Secret {
    token: String,
    /// Who shows it.
    pub(super) caller: Arc<Caller>,
    ending: Ending,
    limit: Option<Limit>,
    /// Of the token.
    room: Room,
}

/// Until when a secret is good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Limit {
    /// The token expires.
    Expiry(i64),
    /// It was replaced by another.
    Replacement(i64),
}

impl Limit {
    fn at_ns(self) -> i64 {
        match self {
            Limit::Expiry(at_ns) | Limit::Replacement(at_ns) => at_ns,
        }
    }

    /// Why a secret of `token` is refused that was good until then.
    fn passed(self, token: &str) -> ServiceError {
        ServiceError::unauthenticated(match self {
            Limit::Expiry(at_ns) => format!(
                "the token {token} expired at {}; ask who runs the server to make another, or to renew this one \
                 (waypost token rotate {token} --expires-in 30d)",
                in_words(at_ns)
            ),
            Limit::Replacement(at_ns) => format!(
                "the token {token} has a new secret, and this one was good until {}; use the new one, or ask who runs \
                 the server for it",
                in_words(at_ns)
            ),
        })
    }
}

impl Secret {
    /// Refuses it once its time is over.
    pub(super) fn check_time(&self, now_ns: i64) -> Result<(), ServiceError> {
        match self.limit {
            Some(limit) if limit.at_ns() <= now_ns => Err(limit.passed(&self.token)),
            Some(_) | None => Ok(()),
        }
    }

    pub(super) fn admitted(&self) -> Admitted {
        let Self { token: _, caller, ending, limit: _, room } = self;
        Admitted { caller: caller.clone(), ending: ending.clone(), room: room.clone() }
    }
}

impl Known {
    pub(super) fn new(quotas: Quotas) -> Self {
        Self {
            tokens: BTreeMap::new(),
            secrets: HashMap::new(),
            without_token: Ending::default(),
            anonymous: Anonymous::default(),
            room: Room::whole(),
            guesses: Guesses::default(),
            quotas,
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.tokens.is_empty()
    }

    /// All, by name.
    pub(super) fn tokens(&self) -> impl Iterator<Item = &TokenRow> {
        self.tokens.values()
    }

    pub(super) fn token(&self, name: &str) -> Result<&TokenRow, ServiceError> {
        self.tokens.get(name).ok_or_else(|| {
            ServiceError::not_found(format_args!(
                "there is no token {name}; list the tokens to see what there is"
            ))
        })
    }

    pub(super) fn secret(&self, hash: &SecretHash) -> Option<&Secret> {
        self.secrets.get(hash)
    }

    /// Let in without a token.
    pub(super) fn anybody(&self, ending: Ending) -> Admitted {
        Admitted { caller: Arc::new(Caller::anybody()), ending, room: self.room.clone() }
    }

    /// A new token, or one as it has become. What was begun with a secret that it has no more ends.
    pub(super) fn put(&mut self, token: TokenRow) {
        self.without_token.end(now_asked());
        self.quotas.set_token(&token.name, &token.limits);
        let mut before: HashMap<SecretHash, Secret> =
            self.secrets.extract_if(|_, secret| secret.token == token.name).collect();
        let room = before.values().next().map_or_else(|| self.room.for_token(), |secret| secret.room.clone());
        for (hash, limit) in secrets_of(&token) {
            let ending = before.remove(&hash).map(|secret| secret.ending);
            let ending = ending.filter(|ending| !ending.over().is_cancelled()).unwrap_or_default();
            let caller = Arc::new(Caller::of(&token, limit.map(Limit::at_ns)));
            let secret = Secret { token: token.name.clone(), caller, ending, limit, room: room.clone() };
            self.secrets.insert(hash, secret);
        }
        for (_, secret) in before {
            secret.ending.end(Limit::Replacement(now_ns()).passed(&token.name));
        }
        self.tokens.insert(token.name.clone(), token);
    }

    pub(super) fn remove(&mut self, name: &str) {
        self.tokens.remove(name);
        self.quotas.set_token(name, &Limits::default());
        for (_, secret) in self.secrets.extract_if(|_, secret| secret.token == name) {
            secret.ending.end(deleted(name));
        }
        if self.is_empty() {
            self.without_token = Ending::default();
        }
    }

    /// Ends what was begun with secrets whose time is over; when the next one's is.
    pub(super) fn end_what_is_over(&self, now_ns: i64) -> Option<i64> {
        let mut next = None;
        for secret in self.secrets.values() {
            match secret.limit {
                Some(limit) if limit.at_ns() <= now_ns => secret.ending.end(limit.passed(&secret.token)),
                Some(limit) => next = Some(next.map_or(limit.at_ns(), |next: i64| next.min(limit.at_ns()))),
                None => {}
            }
        }
        next
    }

    /// Refuses a token that would let nobody administer the server.
    pub(super) fn check_new(&self, token: &TokenRow) -> Result<(), ServiceError> {
        if self.is_empty() && !administers_for_good(token) {
            return Err(ServiceError::precondition(
                "the first token must be an admin's, for all maps and without an end: as soon as there is a token, only \
                 an admin may create another; create one with the role admin, then this one",
            ));
        }
        Ok(())
    }

    /// Refuses an end for the last token that can administer the server for good.
    pub(super) fn check_change(&self, token: &TokenRow) -> Result<(), ServiceError> {
        let others = || self.tokens().filter(|other| other.name != token.name);
        if administers_for_good(token) || others().any(administers_for_good) {
            return Ok(());
        }
        Err(ServiceError::precondition(format_args!(
            "{} is the last admin token for all maps and without an end, and has to stay so; create another admin token \
             first",
            token.name
        )))
    }

    /// Refuses a deletion after which nobody could administer the server, or everybody.
    pub(super) fn check_deletion(&self, name: &str) -> Result<(), ServiceError> {
        let token = self.token(name)?;
        let mut others = self.tokens().filter(|token| token.name != name).peekable();
        if others.peek().is_none() && self.anonymous == Anonymous::Refused {
            return Err(ServiceError::precondition(format_args!(
                "{name} is the last token, and this server listens on a network where it serves nobody without one; \
                 create another admin token first, then delete this one"
            )));
        }
        let is_last_admin = administers_for_good(token) && others.peek().is_some();
        if is_last_admin && !others.any(administers_for_good) {
            return Err(ServiceError::precondition(format_args!(
                "{name} is the last admin token for all maps and without an end, and without one nobody could administer \
                 the server; create another admin token first, or delete all others before this one"
            )));
        }
        Ok(())
    }
}

/// Whether the server can be looked after with this token alone, as long as it is there.
fn administers_for_good(token: &TokenRow) -> bool {
    token.role == Role::Admin && token.reach == Reach::Everywhere && token.expires_ns.is_none()
}

/// The secrets that a token has or had, and until when each is good.
fn secrets_of(token: &TokenRow) -> impl Iterator<Item = (SecretHash, Option<Limit>)> {
    let expiry = token.expires_ns.map(Limit::Expiry);
    let former = token.former.map(|FormerSecret { sha256, until_ns }| {
        let replacement = Limit::Replacement(until_ns);
        (sha256, expiry.filter(|expiry| expiry.at_ns() <= until_ns).or(Some(replacement)))
    });
    [(token.secret_sha256, expiry)].into_iter().chain(former)
}
