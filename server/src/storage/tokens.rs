use super::{Storage, StorageError};
use crate::role::Role;

/// SHA-256 of a token's secret.
pub(crate) type SecretHash = [u8; 32];

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TokenRow {
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(crate) secret_sha256: SecretHash,
    pub(crate) created_ns: i64,
}

impl Storage {
    /// All tokens, by name.
    pub(crate) async fn tokens(&self) -> Result<Vec<TokenRow>, StorageError> {
        let rows = sqlx::query_as("SELECT name, role, secret_sha256, created_ns FROM tokens ORDER BY name")
            .fetch_all(&self.readers)
            .await?;
        rows.into_iter().map(token).collect()
    }

    /// [`StorageError::Exists`] if there is one of that name.
    pub(crate) async fn put_token(&self, token: &TokenRow) -> Result<(), StorageError> {
        let TokenRow { name, role, secret_sha256, created_ns } = token;
        self.write(async |transaction| {
            sqlx::query("INSERT INTO tokens (name, role, secret_sha256, created_ns) VALUES (?, ?, ?, ?)")
                .bind(name)
                .bind(role.name())
                .bind(secret_sha256.as_slice())
                .bind(created_ns)
                .execute(&mut **transaction)
                .await?;
            Ok(())
        })
        .await
    }

    pub(crate) async fn delete_token(&self, name: &str) -> Result<(), StorageError> {
        self.write(async |transaction| {
            sqlx::query("DELETE FROM tokens WHERE name = ?").bind(name).execute(&mut **transaction).await?;
            Ok(())
        })
        .await
    }
}

fn token((name, role, hash, created_ns): (String, String, Vec<u8>, i64)) -> Result<TokenRow, StorageError> {
    let damaged = |what: &str| StorageError::Damaged(format!("the {what} of a token"));
    let role = Role::of_name(&role).ok_or_else(|| damaged("role"))?;
    let secret_sha256 = hash.try_into().map_err(|_| damaged("hash"))?;
    Ok(TokenRow { name, role, secret_sha256, created_ns })
}
