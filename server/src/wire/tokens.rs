//! Tokens and who shows them as messages.

use waypost_proto::v1;
use waypost_proto::v1::token::{Ability as WireAbility, Role as WireRole};

use super::known;
use crate::error::ServiceError;
use crate::role::{Abilities, Ability, Role};
use crate::service::tokens::{Caller, NewToken, Rotation, TokenRow};

pub(crate) fn token(row: TokenRow) -> v1::Token {
    let TokenRow {
        name,
        role: held,
        abilities: may,
        reach,
        secret_sha256: _,
        created_ns,
        expires_ns,
        former,
    } = row;
    v1::Token {
        name: token_name(&name),
        role: role(held).into(),
        create_time_ns: created_ns,
        abilities: abilities(&may),
        maps: reach.patterns().to_vec(),
        expire_time_ns: expires_ns,
        overlap_end_time_ns: former.map(|former| former.until_ns),
    }
}

pub(crate) fn caller(caller: &Caller) -> v1::Caller {
    let Caller { token, role: held, abilities: may, reach, expires_ns } = caller;
    v1::Caller {
        token: token.as_deref().map(token_name).unwrap_or_default(),
        role: role(*held).into(),
        asks_for_token: token.is_some(),
        abilities: abilities(may),
        maps: reach.patterns().to_vec(),
        expire_time_ns: *expires_ns,
    }
}

pub(crate) fn new_token(message: v1::CreateTokenRequest) -> Result<NewToken, ServiceError> {
    let v1::CreateTokenRequest { token_id, role, abilities, maps, lifetime_s } = message;
    Ok(NewToken {
        name: token_id,
        role: requested_role(role)?,
        abilities: abilities.into_iter().map(requested_ability).collect::<Result<_, _>>()?,
        maps,
        lifetime_s,
    })
}

pub(crate) fn rotation(message: v1::RotateTokenRequest) -> (String, Rotation) {
    let v1::RotateTokenRequest { name, overlap_s, lifetime_s } = message;
    (name, Rotation { overlap_s, lifetime_s })
}

fn token_name(token: &str) -> String {
    format!("tokens/{token}")
}

fn role(role: Role) -> WireRole {
    match role {
        Role::Reader => WireRole::Reader,
        Role::Robot => WireRole::Robot,
        Role::Admin => WireRole::Admin,
    }
}

fn requested_role(code: i32) -> Result<Role, ServiceError> {
    match WireRole::try_from(code) {
        Ok(WireRole::Reader) => Ok(Role::Reader),
        Ok(WireRole::Robot) => Ok(Role::Robot),
        Ok(WireRole::Admin) => Ok(Role::Admin),
        Ok(WireRole::Unspecified) => {
            Err(ServiceError::invalid("say which role the token has: ROLE_READER, ROLE_ROBOT or ROLE_ADMIN"))
        }
        Err(_) => Err(ServiceError::invalid(format_args!(
            "{code} is no role; write ROLE_READER, ROLE_ROBOT or ROLE_ADMIN"
        ))),
    }
}

fn abilities(abilities: &Abilities) -> Vec<i32> {
    let of = |ability| match ability {
        Ability::Read => WireAbility::Read,
        Ability::Localize => WireAbility::Localize,
        Ability::Stream => WireAbility::Stream,
        Ability::Navigate => WireAbility::Navigate,
        Ability::Admin => WireAbility::Admin,
    };
    abilities.iter().map(|ability| of(ability).into()).collect()
}

fn requested_ability(code: i32) -> Result<Ability, ServiceError> {
    match known("ability", code)? {
        WireAbility::Read => Ok(Ability::Read),
        WireAbility::Localize => Ok(Ability::Localize),
        WireAbility::Stream => Ok(Ability::Stream),
        WireAbility::Navigate => Ok(Ability::Navigate),
        WireAbility::Admin => Ok(Ability::Admin),
        WireAbility::Unspecified => {
            Err(ServiceError::invalid("one of the abilities is left open; name it, or leave it out"))
        }
    }
}
