use tonic::{Request, Response, Status};
use waypost_proto::v1;
use waypost_proto::v1::token_service_server::TokenService;

use super::Adapter;
use super::access::bearer;
use crate::error::ServiceError;
use crate::pages::Page;
use crate::role::Role;
use crate::wire::tokens::{caller, token};

#[tonic::async_trait]
impl TokenService for Adapter {
    async fn create_token(
        &self,
        request: Request<v1::CreateTokenRequest>,
    ) -> Result<Response<v1::CreateTokenResponse>, Status> {
        let message = request.into_inner();
        let role = role(message.role)?;
        let v1::CreateTokenRequest { token_id, role: _ } = message;
        let (created, secret) = self.service.tokens.create(&token_id, role).await?;
        Ok(Response::new(v1::CreateTokenResponse { token: Some(token(created)), secret }))
    }

    async fn list_tokens(
        &self,
        request: Request<v1::ListTokensRequest>,
    ) -> Result<Response<v1::ListTokensResponse>, Status> {
        let v1::ListTokensRequest { page_size, page_token } = request.into_inner();
        let Page { items, next } = self.service.tokens.list(page_size, &page_token)?;
        let tokens = items.into_iter().map(token).collect();
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
        let (metadata, _, v1::GetCallerRequest {}) = request.into_parts();
        let headers = metadata.into_headers();
        Ok(Response::new(caller(self.service.tokens.caller(bearer(&headers))?)))
    }
}

fn role(code: i32) -> Result<Role, ServiceError> {
    match v1::token::Role::try_from(code) {
        Ok(v1::token::Role::Robot) => Ok(Role::Robot),
        Ok(v1::token::Role::Admin) => Ok(Role::Admin),
        Ok(v1::token::Role::Unspecified) => {
            Err(ServiceError::invalid("say which role the token has: ROLE_ROBOT or ROLE_ADMIN"))
        }
        Err(_) => {
            Err(ServiceError::invalid(format_args!("{code} is no role; write ROLE_ROBOT or ROLE_ADMIN")))
        }
    }
}
