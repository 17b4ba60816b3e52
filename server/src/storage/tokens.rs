use super::values::{MaybeReal, MaybeWhole};
use super::{Storage, StorageError};
use crate::quotas::Limits;
use crate::role::{Abilities, Reach, Role};

/// SHA-256 of a token's secret.
pub(crate) type SecretHash = [u8; 32];

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TokenRow {
    pub(crate) name: String,
    pub(crate) role: Role,
    /// All that its role may do, or less.
    pub(crate) abilities: Abilities,
    pub(crate) reach: Reach,
    pub(crate) secret_sha256: SecretHash,
    pub(crate) created_ns: i64,
    /// `None` if it does not expire.
    pub(crate) expires_ns: Option<i64>,
    /// The secret before the last rotation.
    pub(crate) former: Option<FormerSecret>,
    pub(crate) limits: Limits,
}

/// A secret that was replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct FormerSecret {
    pub(crate) sha256: SecretHash,
    /// Until when it is good.
    pub(crate) until_ns: i64,
}

/// A token as the table has it.
#[derive(sqlx::FromRow)]
struct Columns {
    name: String,
    role: String,
    secret_sha256: Vec<u8>,
    created_ns: i64,
    abilities: Option<String>,
    maps: Option<String>,
    expires_ns: Option<i64>,
    former_secret_sha256: Option<Vec<u8>>,
    former_until_ns: Option<i64>,
    #[sqlx(try_from = "MaybeWhole")]
    max_maps: Option<u32>,
    #[sqlx(try_from = "MaybeWhole")]
    max_sessions: Option<u32>,
    max_frames_per_second: Option<f64>,
    #[sqlx(try_from = "MaybeWhole")]
    max_kept_mib: Option<u32>,
}

impl Storage {
    /// All tokens, by name.
    pub(crate) async fn tokens(&self) -> Result<Vec<TokenRow>, StorageError> {
        let rows: Vec<Columns> = sqlx::query_as(
            "SELECT name, role, secret_sha256, created_ns, abilities, maps, expires_ns, former_secret_sha256, \
             former_until_ns, max_maps, max_sessions, max_frames_per_second, max_kept_mib FROM tokens ORDER BY name",
        )
        .fetch_all(&self.readers)
        .await?;
        rows.into_iter().map(token).collect()
    }

    /// [`StorageError::Exists`] if there is one of that name.
    pub(crate) async fn put_token(&self, token: &TokenRow) -> Result<(), StorageError> {
        let TokenRow { name, role, abilities, reach, secret_sha256, created_ns, expires_ns, former, limits } =
            token;
        let Limits { maps, sessions, frames_per_second, kept_mib } = limits;
        let limited = (*abilities != role.abilities()).then(|| abilities.to_text());
        self.write(async |transaction| {
            sqlx::query(
                "INSERT INTO tokens (name, role, secret_sha256, created_ns, abilities, maps, expires_ns, \
                 former_secret_sha256, former_until_ns, max_maps, max_sessions, max_frames_per_second, max_kept_mib) \
                 VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13)",
            )
            .bind(name)
            .bind(role.name())
            .bind(secret_sha256.as_slice())
            .bind(created_ns)
            .bind(&limited)
            .bind(reach.to_text())
            .bind(expires_ns)
            .bind(former.as_ref().map(|former| former.sha256.as_slice()))
            .bind(former.as_ref().map(|former| former.until_ns))
            .bind(maps.map(i64::from))
            .bind(sessions.map(i64::from))
            .bind(MaybeReal(*frames_per_second))
            .bind(kept_mib.map(i64::from))
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// Notes a token's new secret, with the one before, and when the token expires.
    pub(crate) async fn rotate_token(&self, token: &TokenRow) -> Result<(), StorageError> {
        let TokenRow { name, secret_sha256, expires_ns, former, .. } = token;
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE tokens SET secret_sha256 = $1, expires_ns = $2, former_secret_sha256 = $3, former_until_ns = $4 \
                 WHERE name = $5",
            )
            .bind(secret_sha256.as_slice())
            .bind(expires_ns)
            .bind(former.as_ref().map(|former| former.sha256.as_slice()))
            .bind(former.as_ref().map(|former| former.until_ns))
            .bind(name)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    /// Notes a token's quotas.
    pub(crate) async fn limit_token(&self, token: &TokenRow) -> Result<(), StorageError> {
        let TokenRow { name, limits, .. } = token;
        let Limits { maps, sessions, frames_per_second, kept_mib } = limits;
        self.write(async |transaction| {
            sqlx::query(
                "UPDATE tokens SET max_maps = $1, max_sessions = $2, max_frames_per_second = $3, max_kept_mib = $4 \
                 WHERE name = $5",
            )
            .bind(maps.map(i64::from))
            .bind(sessions.map(i64::from))
            .bind(MaybeReal(*frames_per_second))
            .bind(kept_mib.map(i64::from))
            .bind(name)
            .execute(&mut **transaction)
            .await?;
            Ok(())
        })
        .await
    }

    pub(crate) async fn delete_token(&self, name: &str) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query("DELETE FROM tokens WHERE name = $1").bind(name).execute(&mut **transaction).await?;
            Ok(())
        })
        .await
    }
}

fn token(columns: Columns) -> Result<TokenRow, StorageError> {
    let Columns {
        name,
        role,
        secret_sha256,
        created_ns,
        abilities,
        maps,
        expires_ns,
        former_secret_sha256,
        former_until_ns,
        max_maps,
        max_sessions,
        max_frames_per_second,
        max_kept_mib,
    } = columns;
    let damaged = |what: &str| StorageError::Damaged(format!("the {what} of the token {name}"));
    let hash = |bytes: Vec<u8>| SecretHash::try_from(bytes).map_err(|_| damaged("hash"));
    let role = Role::of_name(&role).ok_or_else(|| damaged("role"))?;
    let abilities = match abilities {
        Some(text) => Abilities::of_text(&text).ok_or_else(|| damaged("abilities"))?,
        None => role.abilities(),
    };
    let former = match (former_secret_sha256, former_until_ns) {
        (Some(bytes), Some(until_ns)) => Some(FormerSecret { sha256: hash(bytes)?, until_ns }),
        (None, None) => None,
        (Some(_), None) | (None, Some(_)) => return Err(damaged("secret before")),
    };
    let secret_sha256 = hash(secret_sha256)?;
    let reach = Reach::of_text(maps.as_deref());
    let limits = Limits {
        maps: max_maps,
        sessions: max_sessions,
        frames_per_second: max_frames_per_second,
        kept_mib: max_kept_mib,
    };
    Ok(TokenRow { name, role, abilities, reach, secret_sha256, created_ns, expires_ns, former, limits })
}
