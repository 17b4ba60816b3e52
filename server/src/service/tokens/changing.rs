//! Tokens are made, given new secrets, and deleted.

use std::fmt::Write as _;

use super::limiting::check_limits;
use super::{Tokens, hash};
use crate::clock::{after_ns, in_words, now_ns};
use crate::error::ServiceError;
use crate::names::{check_id, id_in};
use crate::quotas::Limits;
use crate::role::{Abilities, Ability, Reach, Role};
use crate::storage::{FormerSecret, StorageError, TokenRow};

/// Begins every secret, so that people and scanners know one that they come across.
pub(super) const PREFIX: &str = "waypost_";

const SECRET_BYTES: usize = 32;

/// Most maps, or beginnings of their names, that a token may be limited to.
const MAX_MAPS: usize = 64;

/// How long a secret stays good that was replaced, and the longest that it may.
const DEFAULT_OVERLAP_S: u32 = 60 * 60;
const MAX_OVERLAP_S: u32 = 7 * 24 * 60 * 60;

/// A token that is to be made.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NewToken {
    pub(crate) name: String,
    pub(crate) role: Role,
    /// What it may do, where that is less than its role may; empty for all that.
    pub(crate) abilities: Vec<Ability>,
    /// The maps that it reaches; empty for all.
    pub(crate) maps: Vec<String>,
    /// After how many seconds it expires, if it does.
    pub(crate) lifetime_s: Option<u32>,
    pub(crate) limits: Limits,
}

#[cfg(test)]
impl NewToken {
    /// Without a limit.
    pub(crate) fn of(name: &str, role: Role) -> Self {
        let limits = Limits::default();
        Self {
            name: name.to_owned(),
            role,
            abilities: Vec::new(),
            maps: Vec::new(),
            lifetime_s: None,
            limits,
        }
    }
}

/// A token's change to a new secret.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Rotation {
    /// For how many seconds the secret before stays good.
    pub(crate) overlap_s: Option<u32>,
    /// After how many seconds the token expires; when it would have, if `None`.
    pub(crate) lifetime_s: Option<u32>,
}

impl Rotation {
    fn check(&self) -> Result<(), ServiceError> {
        let Self { overlap_s, lifetime_s } = self;
        if let Some(overlap_s) = overlap_s.filter(|overlap_s| *overlap_s > MAX_OVERLAP_S) {
            return Err(ServiceError::invalid(format_args!(
                "the secret before stays good for at most {MAX_OVERLAP_S} s (a week), not {overlap_s}; say less, or make \
                 another token"
            )));
        }
        lifetime_s.map_or(Ok(()), check_lifetime)
    }
}

impl Tokens {
    /// Makes a token; gives its secret too, which is not kept.
    pub(crate) async fn create(&self, new: NewToken) -> Result<(TokenRow, String), ServiceError> {
        let now = now_ns();
        let secret = new_secret()?;
        let token = row_of(new, &secret, now)?;
        let tokens = self.clone();
        let changing = self.changing.clone().lock_owned().await;
        // A task of its own: the caller may go away, but database and memory must agree.
        let created = tokio::spawn(async move {
            let _changing = changing;
            tokens.lock().check_new(&token)?;
            match tokens.storage.put_token(&token).await {
                Ok(()) => {}
                Err(StorageError::Exists) => {
                    let message = format!("there is a token {} already; choose another name", token.name);
                    return Err(ServiceError::AlreadyExists { message });
                }
                Err(error) => return Err(error.into()),
            }
            tokens.lock().put(token.clone());
            Ok(token)
        });
        let token = created.await.map_err(ServiceError::internal)??;
        tracing::info!(
            token = token.name,
            role = token.role.name(),
            abilities = %token.abilities,
            maps = %token.reach,
            expires = token.expires_ns.map(in_words),
            limits = ?token.limits,
            "token created"
        );
        Ok((token, secret))
    }

    /// Gives `tokens/{token}` another secret, which is not kept.
    pub(crate) async fn rotate(
        &self,
        name: &str,
        rotation: Rotation,
    ) -> Result<(TokenRow, String), ServiceError> {
        let name = check_id("token name", id_in("tokens", name)?)?.to_owned();
        rotation.check()?;
        let secret = new_secret()?;
        let sha256 = hash(&secret);
        let tokens = self.clone();
        let changing = self.changing.clone().lock_owned().await;
        let rotated = tokio::spawn(async move {
            let _changing = changing;
            let before = tokens.lock().token(&name)?.clone();
            let token = TokenRow { secret_sha256: sha256, ..rotated(before, &rotation, now_ns())? };
            tokens.lock().check_change(&token)?;
            tokens.storage.rotate_token(&token).await?;
            tokens.lock().put(token.clone());
            Ok::<_, ServiceError>(token)
        });
        let token = rotated.await.map_err(ServiceError::internal)??;
        let former_until = token.former.map(|former| in_words(former.until_ns));
        tracing::info!(token = token.name, former_until, "token rotated");
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
}

fn row_of(new: NewToken, secret: &str, now_ns: i64) -> Result<TokenRow, ServiceError> {
    let NewToken { name, role, abilities, maps, lifetime_s, limits } = new;
    lifetime_s.map_or(Ok(()), check_lifetime)?;
    check_limits(role, &limits)?;
    Ok(TokenRow {
        name: check_id("token name", &name)?.to_owned(),
        role,
        abilities: abilities_of(role, abilities)?,
        reach: reach_of(maps)?,
        secret_sha256: hash(secret),
        created_ns: now_ns,
        expires_ns: lifetime_s.map(|seconds| after_ns(now_ns, seconds)),
        former: None,
        limits,
    })
}

/// What a token may do whose role was to be limited to `named`.
fn abilities_of(role: Role, named: Vec<Ability>) -> Result<Abilities, ServiceError> {
    let all = role.abilities();
    let Some(named) = Abilities::of(named) else { return Ok(all) };
    if let Some(beyond) = named.beyond(&all) {
        return Err(ServiceError::invalid(format_args!(
            "a {} may {all}, and not {beyond}; leave that out, or choose another role",
            role.name()
        )));
    }
    if role == Role::Admin && named != all {
        return Err(ServiceError::invalid(
            "an admin may do everything, for it could make itself a token that does; leave the abilities out, or choose \
             the role robot or reader",
        ));
    }
    Ok(named)
}

fn reach_of(maps: Vec<String>) -> Result<Reach, ServiceError> {
    if maps.len() > MAX_MAPS {
        return Err(ServiceError::invalid(format_args!(
            "a token is limited to at most {MAX_MAPS} maps, not {}; name several at once by the beginning of their \
             names, as in floor2-*",
            maps.len()
        )));
    }
    for map in &maps {
        let beginning = map.strip_suffix('*').unwrap_or(map);
        if beginning.is_empty() {
            return Err(ServiceError::invalid(format_args!(
                "{map:?} limits a token to nothing; name maps as in hall or floor2-*, or leave them out for all maps"
            )));
        }
        check_id("map name, nor the beginning of one with an asterisk behind it", beginning)?;
    }
    Ok(Reach::of(maps))
}

fn check_lifetime(lifetime_s: u32) -> Result<(), ServiceError> {
    if lifetime_s == 0 {
        return Err(ServiceError::invalid(
            "a lifetime of 0 s would be over at once; say at least 1 s, or leave it out for a token that does not expire",
        ));
    }
    Ok(())
}

/// A token whose secret becomes its former one.
fn rotated(before: TokenRow, rotation: &Rotation, now_ns: i64) -> Result<TokenRow, ServiceError> {
    let Rotation { overlap_s, lifetime_s } = rotation;
    let overlap_s = overlap_s.unwrap_or(DEFAULT_OVERLAP_S);
    let expires_ns = lifetime_s.map(|seconds| after_ns(now_ns, seconds)).or(before.expires_ns);
    if let Some(at) = before.expires_ns.filter(|at| *at <= now_ns && lifetime_s.is_none()) {
        return Err(ServiceError::precondition(format_args!(
            "the token {} expired at {}, and a new secret would be of no use; say how long it is to live from now on",
            before.name,
            in_words(at)
        )));
    }
    let former = FormerSecret { sha256: before.secret_sha256, until_ns: after_ns(now_ns, overlap_s) };
    Ok(TokenRow { expires_ns, former: Some(former), ..before })
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
