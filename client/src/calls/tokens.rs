//! Tokens: who may call the server.

use waypost_proto::v1;

use crate::client::{Call, Client, PAGE_SIZE};
use crate::error::Error;

impl Client {
    /// Creates a token. Returns it with its secret, which the server does not keep.
    ///
    /// # Errors
    /// [`Error::Status`] with ALREADY_EXISTS or INVALID_ARGUMENT; with FAILED_PRECONDITION if the
    /// first token is not an admin's.
    pub fn create_token<'a>(
        &'a self,
        token_id: &'a str,
        role: v1::token::Role,
    ) -> Call<'a, (v1::Token, String)> {
        Box::pin(async move {
            let request = v1::CreateTokenRequest {
                token_id: token_id.to_owned(),
                role: role.into(),
                ..v1::CreateTokenRequest::default()
            };
            self.create_limited_token(request).await
        })
    }

    /// Creates a token that may be limited: to abilities, to maps, to a time, by quotas. Returns it with its secret, which the server
    /// does not keep.
    ///
    /// # Errors
    /// As [`Client::create_token`].
    pub fn create_limited_token(&self, request: v1::CreateTokenRequest) -> Call<'_, (v1::Token, String)> {
        Box::pin(async move {
            let v1::CreateTokenResponse { token, secret } =
                self.taken(self.tokens_client().create_token(request).await)?;
            Ok((token.ok_or(Error::Protocol("a new token came without its name"))?, secret))
        })
    }

    /// All tokens, by name.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn tokens(&self) -> Call<'_, Vec<v1::Token>> {
        Box::pin(async move {
            self.all_pages(|page_token| async move {
                let request = v1::ListTokensRequest { page_size: PAGE_SIZE, page_token };
                let page = self.tokens_client().list_tokens(request).await?.into_inner();
                Ok((page.tokens, page.next_page_token))
            })
            .await
        })
    }

    /// Gives a token a new secret, and returns both. The secret before stays good for the request's overlap.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND or INVALID_ARGUMENT; with FAILED_PRECONDITION if the token has expired and no
    /// lifetime is given, or if the server could not be administered once it expires.
    pub fn rotate_token(&self, request: v1::RotateTokenRequest) -> Call<'_, (v1::Token, String)> {
        Box::pin(async move {
            let request = v1::RotateTokenRequest { name: full_name(&request.name), ..request };
            let v1::RotateTokenResponse { token, secret } =
                self.taken(self.tokens_client().rotate_token(request).await)?;
            Ok((token.ok_or(Error::Protocol("a rotated token came without its name"))?, secret))
        })
    }

    /// Changes the quotas of a token, which keeps its secret: those that the request sets or lifts, also for streams that
    /// are open.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND, or INVALID_ARGUMENT for a quota that is none for the token's role.
    pub fn update_token(&self, request: v1::UpdateTokenRequest) -> Call<'_, v1::Token> {
        Box::pin(async move {
            let request = v1::UpdateTokenRequest { name: full_name(&request.name), ..request };
            self.taken(self.tokens_client().update_token(request).await)
        })
    }

    /// Deletes a token, by `name` or `tokens/name`.
    ///
    /// # Errors
    /// [`Error::Status`] with NOT_FOUND; with FAILED_PRECONDITION if the server could not be
    /// administered without it.
    pub fn delete_token<'a>(&'a self, name: &'a str) -> Call<'a, ()> {
        Box::pin(async move {
            let request = v1::DeleteTokenRequest { name: full_name(name) };
            let v1::DeleteTokenResponse {} = self.taken(self.tokens_client().delete_token(request).await)?;
            Ok(())
        })
    }

    /// Who this client is to the server, and what it may do.
    ///
    /// # Errors
    /// As every call: [`Error::Connection`] or [`Error::Status`].
    pub fn caller(&self) -> Call<'_, v1::Caller> {
        Box::pin(async move { self.taken(self.tokens_client().get_caller(v1::GetCallerRequest {}).await) })
    }
}

fn full_name(name: &str) -> String {
    if name.starts_with("tokens/") { name.to_owned() } else { format!("tokens/{name}") }
}
