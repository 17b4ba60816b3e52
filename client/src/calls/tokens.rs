//! Tokens: who may call the server.

use waypost_proto::v1;

use crate::client::{Client, PAGE_SIZE};
use crate::error::Error;

impl Client {
    /// Creates a token. Returns it with its secret, which the server does not keep.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS or INVALID_ARGUMENT; with FAILED_PRECONDITION if the
    /// first token is not an admin's.
    pub async fn create_token(
        &self,
        token_id: &str,
        role: v1::token::Role,
    ) -> Result<(v1::Token, String), Error> {
        let request = v1::CreateTokenRequest {
            token_id: token_id.to_owned(),
            role: role.into(),
            ..v1::CreateTokenRequest::default()
        };
        self.create_limited_token(request).await
    }

    /// Creates a token that may be limited: to abilities, to maps, to a time, by quotas. Returns it with its secret, which the server
    /// does not keep.
    ///
    /// # Errors
    /// As [`Client::create_token`].
    pub async fn create_limited_token(
        &self,
        request: v1::CreateTokenRequest,
    ) -> Result<(v1::Token, String), Error> {
        let v1::CreateTokenResponse { token, secret } =
            self.taken(self.tokens_client().create_token(request).await)?;
        Ok((token.ok_or(Error::Protocol("a new token came without its name"))?, secret))
    }

    /// All tokens, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn tokens(&self) -> Result<Vec<v1::Token>, Error> {
        self.all_pages(|page_token| async move {
            let request = v1::ListTokensRequest { page_size: PAGE_SIZE, page_token };
            let page = self.tokens_client().list_tokens(request).await?.into_inner();
            Ok((page.tokens, page.next_page_token))
        })
        .await
    }

    /// Gives a token a new secret, and returns both. The secret before stays good for the request's overlap.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND or INVALID_ARGUMENT; with FAILED_PRECONDITION if the token has expired and no
    /// lifetime is given, or if the server could not be administered once it expires.
    pub async fn rotate_token(&self, request: v1::RotateTokenRequest) -> Result<(v1::Token, String), Error> {
        let request = v1::RotateTokenRequest { name: full_name(&request.name), ..request };
        let v1::RotateTokenResponse { token, secret } =
            self.taken(self.tokens_client().rotate_token(request).await)?;
        Ok((token.ok_or(Error::Protocol("a rotated token came without its name"))?, secret))
    }

    /// Changes the quotas of a token, which keeps its secret: those that the request sets or lifts, also for streams that
    /// are open.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or INVALID_ARGUMENT for a quota that is none for the token's role.
    pub async fn update_token(&self, request: v1::UpdateTokenRequest) -> Result<v1::Token, Error> {
        let request = v1::UpdateTokenRequest { name: full_name(&request.name), ..request };
        self.taken(self.tokens_client().update_token(request).await)
    }

    /// Deletes a token, by `name` or `tokens/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND; with FAILED_PRECONDITION if the server could not be
    /// administered without it.
    pub async fn delete_token(&self, name: &str) -> Result<(), Error> {
        let request = v1::DeleteTokenRequest { name: full_name(name) };
        let v1::DeleteTokenResponse {} = self.taken(self.tokens_client().delete_token(request).await)?;
        Ok(())
    }

    /// Who this client is to the server, and what it may do.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub async fn caller(&self) -> Result<v1::Caller, Error> {
        self.taken(self.tokens_client().get_caller(v1::GetCallerRequest {}).await)
    }
}

fn full_name(name: &str) -> String {
    if name.starts_with("tokens/") { name.to_owned() } else { format!("tokens/{name}") }
}
