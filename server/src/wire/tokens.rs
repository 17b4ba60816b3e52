//! Tokens and who shows them as messages.

use waypost_proto::v1;
use waypost_proto::v1::token::Role as WireRole;

use crate::role::Role;
use crate::service::tokens::{Caller, TokenRow};

pub(crate) fn token(row: TokenRow) -> v1::Token {
    let TokenRow { name, role: held, secret_sha256: _, created_ns } = row;
    v1::Token { name: token_name(&name), role: role(held).into(), create_time_ns: created_ns }
}

pub(crate) fn caller(caller: Caller) -> v1::Caller {
    let Caller { token, role: held } = caller;
    let asks_for_token = token.is_some();
    let token = token.map(|token| token_name(&token)).unwrap_or_default();
    v1::Caller { token, role: role(held).into(), asks_for_token }
}

fn token_name(token: &str) -> String {
    format!("tokens/{token}")
}

fn role(role: Role) -> WireRole {
    match role {
        Role::Robot => WireRole::Robot,
        Role::Admin => WireRole::Admin,
    }
}
