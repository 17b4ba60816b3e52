//! Who may use the server.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sha2::{Digest, Sha256};
use tokio::sync::Mutex as AsyncMutex;
use tokio_util::sync::CancellationToken;

use crate::clock::now_ns;
use crate::error::ServiceError;
use crate::names::{check_id, id_in};
use crate::net::messages::Room;
use crate::pages::{Page, named_page, page_after, page_size};
use crate::role::Role;
pub(crate) use crate::storage::TokenRow;
use crate::storage::{SecretHash, Storage, StorageError};

mod guesses;

use guesses::Guesses;

/// Begins every secret, so that people and scanners know one that they come across.
const PREFIX: &str = "waypost_";

const SECRET_BYTES: usize = 32;

/// What a call asks of who makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// Nothing.
    Open,
    /// A token, whatever its role.
    Robot,
    /// The token of an admin.
    Admin,
}

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

/// Who asks, and what they may do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Caller {
    /// Name of the token that was shown; `None` where the server has none.
    pub(crate) token: Option<String>,
    pub(crate) role: Role,
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
    /// Cancelled when the call's token is deleted; the call must end then.
    pub(crate) deleted: CancellationToken,
    /// For the messages that come in.
    pub(crate) room: Room,
}

#[derive(Debug)]
struct Known {
    /// Looked up by the hash of the secret: how long that takes tells nothing about secrets.
    by_hash: HashMap<SecretHash, Holder>,
    /// What is served to those without a token; cancelled by the first token.
    without_token: CancellationToken,
    anonymous: Anonymous,
    /// For all messages that come in.
    room: Room,
    guesses: Guesses,
}

#[derive(Debug)]
struct Holder {
    token: TokenRow,
    /// Cancelled when the token is deleted.
    deleted: CancellationToken,
    room: Room,
}

impl Tokens {
    pub(crate) async fn load(storage: &Storage) -> Result<Self, StorageError> {
        let mut known = Known::new();
        storage.tokens().await?.into_iter().for_each(|token| known.add(token));
        Ok(Self { storage: storage.clone(), known: Arc::new(Mutex::new(known)), changing: Arc::default() })
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.lock().by_hash.is_empty()
    }

    /// All, by name.
    pub(crate) fn all(&self) -> Vec<TokenRow> {
        let mut tokens: Vec<TokenRow> = self.lock().tokens().cloned().collect();
        tokens.sort_by(|a, b| a.name.cmp(&b.name));
        tokens
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
        known.by_hash.is_empty() && known.anonymous == Anonymous::Local
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    fn new() -> Self {
        Self {
            by_hash: HashMap::new(),
            without_token: CancellationToken::new(),
            anonymous: Anonymous::default(),
            room: Room::whole(),
            guesses: Guesses::default(),
        }
    }

    /// Let in without a token.
    fn anybody(&self, deleted: CancellationToken) -> Admitted {
        Admitted { deleted, room: self.room.clone() }
    }

    fn add(&mut self, token: TokenRow) {
        self.without_token.cancel();
        let deleted = CancellationToken::new();
        self.by_hash.insert(token.secret_sha256, Holder { token, deleted, room: self.room.for_token() });
    }

    fn remove(&mut self, name: &str) {
        self.by_hash.retain(|_, holder| {
            let stays = holder.token.name != name;
            if !stays {
                holder.deleted.cancel();
            }
            stays
        });
        if self.by_hash.is_empty() {
            self.without_token = CancellationToken::new();
        }
    }

    fn tokens(&self) -> impl Iterator<Item = &TokenRow> {
        self.by_hash.values().map(|holder| &holder.token)
    }

    /// Refuses a token that would let nobody administer the server.
    fn check_new(&self, role: Role) -> Result<(), ServiceError> {
        if role == Role::Robot && self.by_hash.is_empty() {
            return Err(ServiceError::precondition(
                "the first token must be an admin's: as soon as there is a token, only an admin may create another; \
                 create one with the role admin, then this one",
            ));
        }
        Ok(())
    }

    /// Refuses a deletion after which nobody could administer the server, or everybody.
    fn check_deletion(&self, name: &str) -> Result<(), ServiceError> {
        let Some(token) = self.tokens().find(|token| token.name == name) else {
            return Err(ServiceError::not_found(format_args!(
                "there is no token {name}; list the tokens to see what there is"
            )));
        };
        let mut others = self.tokens().filter(|token| token.name != name).peekable();
        if others.peek().is_none() && self.anonymous == Anonymous::Refused {
            return Err(ServiceError::precondition(format_args!(
                "{name} is the last token, and this server listens on a network where it serves nobody without one; \
                 create another admin token first, then delete this one"
            )));
        }
        let is_last_admin = token.role == Role::Admin && others.peek().is_some();
        if is_last_admin && !others.any(|other| other.role == Role::Admin) {
            return Err(ServiceError::precondition(format_args!(
                "{name} is the last admin token, and without one nobody could administer the server; \
                 create another admin token first, or delete the robots' tokens before this one"
            )));
        }
        Ok(())
    }
}

impl Tokens {
    /// Lets a call from `peer` in, or says why not.
    pub(crate) fn admit(
        &self,
        peer: Option<IpAddr>,
        secret: Option<&str>,
        access: Access,
    ) -> Result<Admitted, ServiceError> {
        let mut known = self.lock();
        if access == Access::Open {
            return Ok(known.anybody(CancellationToken::new()));
        }
        if known.by_hash.is_empty() && known.anonymous != Anonymous::Refused {
            return Ok(known.anybody(known.without_token.clone()));
        }
        let Some(secret) = secret else {
            return Err(ServiceError::unauthenticated(
                "this server asks for a token; send one as `authorization: Bearer SECRET` \
                 (waypost: --token or WAYPOST_TOKEN); who runs the server can create one",
            ));
        };
        let Some(Holder { token, deleted, room }) = known.by_hash.get(&hash(secret)) else {
            known.guesses.count(peer)?;
            return Err(ServiceError::unauthenticated(
                "this token is not known here: it was deleted, or is of another server, or not whole; \
                 ask who runs the server for a new one",
            ));
        };
        match (access, token.role) {
            (Access::Open | Access::Robot, _) | (Access::Admin, Role::Admin) => {
                Ok(Admitted { deleted: deleted.clone(), room: room.clone() })
            }
            (Access::Admin, Role::Robot) => Err(ServiceError::PermissionDenied {
                message: format!(
                    "this takes the token of an admin, and {} is a robot's; ask who runs the server for one",
                    token.name
                ),
            }),
        }
    }

    /// How many wrong secrets are taken from one address in a minute.
    pub(crate) fn set_guesses_per_minute(&self, guesses: u32) {
        self.lock().guesses.per_minute = guesses;
    }

    /// Who shows this secret, who was admitted already.
    pub(crate) fn caller(&self, secret: Option<&str>) -> Result<Caller, ServiceError> {
        let known = self.lock();
        if known.by_hash.is_empty() {
            return Ok(Caller { token: None, role: Role::Admin });
        }
        // It may have been deleted since.
        let holder = secret.and_then(|secret| known.by_hash.get(&hash(secret)));
        let token = holder.map(|holder| &holder.token).ok_or_else(no_longer_admitted)?;
        Ok(Caller { token: Some(token.name.clone()), role: token.role })
    }

    /// Makes a token; gives its secret too, which is not kept.
    pub(crate) async fn create(&self, name: &str, role: Role) -> Result<(TokenRow, String), ServiceError> {
        let name = check_id("token name", name)?.to_owned();
        let secret = new_secret()?;
        let token = TokenRow { name: name.clone(), role, secret_sha256: hash(&secret), created_ns: now_ns() };
        let tokens = self.clone();
        let changing = self.changing.clone().lock_owned().await;
        // A task of its own: the caller may go away, but database and memory must agree.
        let created = tokio::spawn(async move {
            let _changing = changing;
            tokens.lock().check_new(role)?;
            match tokens.storage.put_token(&token).await {
                Ok(()) => {}
                Err(StorageError::Exists) => {
                    let message = format!("there is a token {name} already; choose another name");
                    return Err(ServiceError::AlreadyExists { message });
                }
                Err(error) => return Err(error.into()),
            }
            tokens.lock().add(token.clone());
            Ok(token)
        });
        let token = created.await.map_err(ServiceError::internal)??;
        tracing::info!(token = token.name, role = role.name(), "token created");
        Ok((token, secret))
    }

    /// Deletes `tokens/{token}`; what is being done with it ends.
    pub(crate) async fn delete(&self, name: &str) -> Result<(), ServiceError> {
        let name = check_id("token name", id_in("tokens", name)?)?.to_owned();
        let tokens = self.clone();
        let changing = self.changing.clone().lock_owned().await;
        let deleted = tokio::spawn(async move {
            let _changing = changing;
            tokens.lock().check_deletion(&name)?;
            tokens.storage.delete_token(&name).await?;
            tokens.lock().remove(&name);
            Ok::<_, ServiceError>(name)
        });
        let name = deleted.await.map_err(ServiceError::internal)??;
        tracing::info!(token = name, "token deleted");
        Ok(())
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
}

/// Why a call ends whose token was deleted while it went on.
pub(crate) fn no_longer_admitted() -> ServiceError {
    ServiceError::unauthenticated(
        "the token that this call began with was deleted, or the server now asks for one; \
         ask who runs the server for a new one",
    )
}

fn new_secret() -> Result<String, ServiceError> {
    let mut random = [0; SECRET_BYTES];
    getrandom::fill(&mut random).map_err(ServiceError::internal)?;
    let mut secret = PREFIX.to_owned();
    for byte in random {
        write!(secret, "{byte:02x}").map_err(ServiceError::internal)?;
    }
    Ok(secret)
}

fn hash(secret: &str) -> SecretHash {
    Sha256::digest(secret).into()
}

#[cfg(test)]
mod tests;
