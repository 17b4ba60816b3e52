//! Who may use the server.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sha2::{Digest, Sha256};
use tokio::sync::Mutex as AsyncMutex;
use tokio_util::sync::CancellationToken;

use super::models::Page;
use super::names::{check_id, id_in, page_size};
use super::{Service, now_ns};
use crate::error::ServiceError;
use crate::role::Role;
use crate::storage::{SecretHash, Storage, StorageError, TokenRow};

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
    /// Whoever is on the same machine.
    #[default]
    Local,
    /// Whoever reaches it.
    Everyone,
    /// Nobody.
    Refused,
}

/// All tokens, in memory: to check one costs no query.
#[derive(Debug)]
pub(crate) struct Tokens {
    known: Mutex<Known>,
    /// Held while tokens change, in the database and here.
    changing: Arc<AsyncMutex<()>>,
}

#[derive(Debug, Default)]
struct Known {
    /// Looked up by the hash of the secret: how long that takes tells nothing about secrets.
    by_hash: HashMap<SecretHash, Holder>,
    /// What is served to those without a token; cancelled by the first token.
    without_token: CancellationToken,
    anonymous: Anonymous,
}

#[derive(Debug)]
struct Holder {
    token: TokenRow,
    /// Cancelled when the token is deleted.
    deleted: CancellationToken,
}

impl Tokens {
    pub(crate) async fn load(storage: &Storage) -> Result<Self, StorageError> {
        let mut known = Known::default();
        storage.tokens().await?.into_iter().for_each(|token| known.add(token));
        Ok(Self { known: Mutex::new(known), changing: Arc::default() })
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.lock().by_hash.is_empty()
    }

    /// All, by name.
    pub(crate) fn list(&self) -> Vec<TokenRow> {
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
    fn add(&mut self, token: TokenRow) {
        self.without_token.cancel();
        let deleted = CancellationToken::new();
        self.by_hash.insert(token.secret_sha256, Holder { token, deleted });
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

impl Service {
    /// Lets a call in, or says why not. What comes back is cancelled when its token is deleted; the
    /// call must end then.
    pub(crate) fn admit(
        &self,
        secret: Option<&str>,
        access: Access,
    ) -> Result<CancellationToken, ServiceError> {
        if access == Access::Open {
            return Ok(CancellationToken::new());
        }
        let known = self.tokens.lock();
        if known.by_hash.is_empty() && known.anonymous != Anonymous::Refused {
            return Ok(known.without_token.clone());
        }
        let Some(secret) = secret else {
            return Err(ServiceError::unauthenticated(
                "this server asks for a token; send one as `authorization: Bearer SECRET` \
                 (waypost: --token or WAYPOST_TOKEN); who runs the server can create one",
            ));
        };
        let Some(Holder { token, deleted }) = known.by_hash.get(&hash(secret)) else {
            return Err(ServiceError::unauthenticated(
                "this token is not known here: it was deleted, or is of another server, or not whole; \
                 ask who runs the server for a new one",
            ));
        };
        match (access, token.role) {
            (Access::Open | Access::Robot, _) | (Access::Admin, Role::Admin) => Ok(deleted.clone()),
            (Access::Admin, Role::Robot) => Err(ServiceError::PermissionDenied {
                message: format!(
                    "this takes the token of an admin, and {} is a robot's; ask who runs the server for one",
                    token.name
                ),
            }),
        }
    }

    /// Makes a token; gives its secret too, which is not kept.
    pub(crate) async fn create_token(
        self: &Arc<Self>,
        name: &str,
        role: Role,
    ) -> Result<(TokenRow, String), ServiceError> {
        let name = check_id("token name", name)?.to_owned();
        let secret = new_secret()?;
        let token = TokenRow { name: name.clone(), role, secret_sha256: hash(&secret), created_ns: now_ns() };
        let (service, changing) = (self.clone(), self.tokens.changing.clone().lock_owned().await);
        // A task of its own: whoever asked may go away, but database and memory must agree.
        let created = tokio::spawn(async move {
            let _changing = changing;
            service.tokens.lock().check_new(role)?;
            match service.storage.put_token(&token).await {
                Ok(()) => {}
                Err(StorageError::Exists) => {
                    let message = format!("there is a token {name} already; choose another name");
                    return Err(ServiceError::AlreadyExists { message });
                }
                Err(error) => return Err(error.into()),
            }
            service.tokens.lock().add(token.clone());
            Ok(token)
        });
        let token = created.await.map_err(ServiceError::internal)??;
        tracing::info!(token = token.name, role = role.name(), "token created");
        Ok((token, secret))
    }

    /// Deletes `tokens/{token}`; what is being done with it ends.
    pub(crate) async fn delete_token(self: &Arc<Self>, name: &str) -> Result<(), ServiceError> {
        let name = check_id("token name", id_in("tokens", name)?)?.to_owned();
        let (service, changing) = (self.clone(), self.tokens.changing.clone().lock_owned().await);
        let deleted = tokio::spawn(async move {
            let _changing = changing;
            service.tokens.lock().check_deletion(&name)?;
            service.storage.delete_token(&name).await?;
            service.tokens.lock().remove(&name);
            Ok::<_, ServiceError>(name)
        });
        let name = deleted.await.map_err(ServiceError::internal)??;
        tracing::info!(token = name, "token deleted");
        Ok(())
    }

    /// Tokens after the name `page_token`, by name.
    pub(crate) fn list_tokens(&self, size: u32, page_token: &str) -> Result<Page<TokenRow>, ServiceError> {
        let size = page_size(size)? as usize;
        if !page_token.is_empty() {
            check_id("page token", page_token)?;
        }
        let mut items = self.tokens.list();
        items.retain(|token| token.name.as_str() > page_token);
        let more = items.len() > size;
        items.truncate(size);
        let next = items.last().filter(|_| more).map(|token| token.name.clone()).unwrap_or_default();
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
mod tests {
    use super::*;

    async fn service(directory: &std::path::Path) -> Arc<Service> {
        let storage = Storage::open(directory).await.unwrap();
        let tokens = Tokens::load(&storage).await.unwrap();
        Arc::new(Service::new(storage, tokens, crate::metrics::Metrics::new().unwrap()))
    }

    fn is_unauthenticated(admitted: &Result<CancellationToken, ServiceError>) -> bool {
        matches!(admitted, Err(ServiceError::Unauthenticated { .. }))
    }

    #[tokio::test]
    async fn roles_open_what_they_are_for() {
        let directory = tempfile::tempdir().unwrap();
        let service = service(directory.path()).await;
        let before = service.admit(None, Access::Admin).unwrap();
        let (_, admin) = service.create_token("operator", Role::Admin).await.unwrap();
        assert!(before.is_cancelled(), "what was let in without a token must end");
        let (_, robot) = service.create_token("robot", Role::Robot).await.unwrap();
        for access in [Access::Robot, Access::Admin] {
            assert!(is_unauthenticated(&service.admit(None, access)));
            assert!(is_unauthenticated(&service.admit(Some(""), access)));
            assert!(is_unauthenticated(&service.admit(Some(&robot[..robot.len() - 1]), access)));
            assert!(service.admit(Some(&admin), access).is_ok());
        }
        assert!(service.admit(None, Access::Open).is_ok());
        assert!(service.admit(Some(&robot), Access::Robot).is_ok());
        let denied = service.admit(Some(&robot), Access::Admin);
        assert!(matches!(denied, Err(ServiceError::PermissionDenied { .. })), "{denied:?}");
        service.stop().await;
    }

    #[tokio::test]
    async fn a_token_outlives_the_server_and_only_its_hash_is_stored() {
        let directory = tempfile::tempdir().unwrap();
        let first = service(directory.path()).await;
        let (_, secret) = first.create_token("operator", Role::Admin).await.unwrap();
        first.stop().await;
        drop(first);
        assert!(secret.starts_with(PREFIX) && secret.len() == PREFIX.len() + 64, "{secret}");
        let file = std::fs::read(directory.path().join("waypost.sqlite")).unwrap();
        let holds = |bytes: &[u8]| file.windows(bytes.len()).any(|window| window == bytes);
        assert!(holds(&hash(&secret)) && !holds(&secret.as_bytes()[PREFIX.len()..]));
        let second = service(directory.path()).await;
        let admitted = second.admit(Some(&secret), Access::Admin).unwrap();
        second.delete_token("tokens/operator").await.unwrap();
        assert!(admitted.is_cancelled());
        assert!(second.admit(None, Access::Admin).is_ok(), "with no token left, everyone is served again");
        second.stop().await;
    }

    #[tokio::test]
    async fn nobody_is_locked_out_and_no_door_is_left_open() {
        let directory = tempfile::tempdir().unwrap();
        let service = service(directory.path()).await;
        let refused = |result: Result<(), ServiceError>| match result {
            Err(ServiceError::FailedPrecondition { message }) => message,
            other => panic!("{other:?}"),
        };
        let first_robot = service.create_token("robot", Role::Robot).await.map(drop);
        assert!(refused(first_robot).contains("the first token must be an admin's"));
        service.create_token("operator", Role::Admin).await.unwrap();
        service.create_token("robot", Role::Robot).await.unwrap();
        let exists = service.create_token("robot", Role::Robot).await;
        assert!(matches!(exists, Err(ServiceError::AlreadyExists { .. })), "{exists:?}");
        let last_admin = service.delete_token("tokens/operator").await;
        assert!(refused(last_admin).contains("create another admin token first"));
        service.delete_token("tokens/robot").await.unwrap();
        service.tokens.set_anonymous(Anonymous::Refused);
        let last = service.delete_token("tokens/operator").await;
        assert!(refused(last).contains("the last token"));
        let missing = service.delete_token("tokens/nobody").await;
        assert!(matches!(missing, Err(ServiceError::NotFound { .. })), "{missing:?}");
        service.stop().await;
    }

    #[tokio::test]
    async fn lists_go_by_name_in_pages() {
        let directory = tempfile::tempdir().unwrap();
        let service = service(directory.path()).await;
        for name in ["c", "a", "b"] {
            service.create_token(name, Role::Admin).await.unwrap();
        }
        let names = |page: &Page<TokenRow>| {
            page.items.iter().map(|token| token.name.clone()).collect::<Vec<_>>().join(" ")
        };
        let first = service.list_tokens(2, "").unwrap();
        assert_eq!((names(&first).as_str(), first.next.as_str()), ("a b", "b"));
        let second = service.list_tokens(2, &first.next).unwrap();
        assert_eq!((names(&second).as_str(), second.next.as_str()), ("c", ""));
        assert!(service.list_tokens(2, "no/token").is_err());
        service.stop().await;
    }
}
