use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::token_service_server::TokenService;

use super::Adapter;
use super::reach::with_caller;
use crate::pages::Page;
use crate::service::tokens::TokenRow;
use crate::wire::tokens::{caller, limit_change, new_token, rotation, token};

#[tonic::async_trait]
impl TokenService for Adapter {
    async fn create_token(
        &self,
        request: Request<v1::CreateTokenRequest>,
    ) -> Result<Response<v1::CreateTokenResponse>, Status> {
        let new = new_token(request.into_inner())?;
        let (created, secret) = self.service.tokens.create(new).await?;
        let token = Some(self.token(created));
        Ok(Response::new(v1::CreateTokenResponse { token, secret }))
    }

    async fn rotate_token(
        &self,
        request: Request<v1::RotateTokenRequest>,
    ) -> Result<Response<v1::RotateTokenResponse>, Status> {
        let (name, rotation) = rotation(request.into_inner());
        let (rotated, secret) = self.service.tokens.rotate(&name, rotation).await?;
        let token = Some(self.token(rotated));
        Ok(Response::new(v1::RotateTokenResponse { token, secret }))
    }

    async fn update_token(
        &self,
        request: Request<v1::UpdateTokenRequest>,
    ) -> Result<Response<v1::Token>, Status> {
        let (name, change) = limit_change(request.into_inner())?;
        let limited = self.service.tokens.limit(&name, change).await?;
        Ok(Response::new(self.token(limited)))
    }

    async fn list_tokens(
        &self,
        request: Request<v1::ListTokensRequest>,
    ) -> Result<Response<v1::ListTokensResponse>, Status> {
        let v1::ListTokensRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.tokens.list(page_size, &page_token)?;
        let tokens = items.into_iter().map(|row| self.token(row)).collect();
        Ok(Response::new(v1::ListTokensResponse { tokens, next_page_token: next }))
    }

    async fn delete_token(
        &self,
        request: Request<v1::DeleteTokenRequest>,
    ) -> Result<Response<v1::DeleteTokenResponse>, Status> {
        let v1::DeleteTokenRequest { name } = request.into_inner();
        self.service.tokens.delete(&name).await?;
        Ok(Response::new(v1::DeleteTokenResponse {}))
    }

    async fn get_caller(
        &self,
        request: Request<v1::GetCallerRequest>,
    ) -> Result<Response<v1::Caller>, Status> {
        let (asks, v1::GetCallerRequest {}) = with_caller(request)?;
        Ok(Response::new(caller(&asks)))
    }
}

impl Adapter {
    /// A token with what there is that counts for it.
    fn token(&self, row: TokenRow) -> v1::Token {
        let used = self.service.tokens.used_by(&row.name);
        token(row, used)
    }
}
