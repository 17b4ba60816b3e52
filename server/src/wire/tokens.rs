//! Tokens and who shows them as messages.

use waypost_proto::v1;
use waypost_proto::v1::quotas::Kind as WireQuota;
use waypost_proto::v1::token::{Ability as WireAbility, Role as WireRole};

use super::known;
use crate::error::ServiceError;
use crate::names::token_name;
use crate::quotas::{Limits, Quota, Used};
use crate::role::{Abilities, Ability, Role};
use crate::service::tokens::{Caller, LimitChange, NewToken, Rotation, TokenRow};

pub(crate) fn token(row: TokenRow, used: Used) -> v1::Token {
    let TokenRow {
        name,
        role: held,
        abilities: may,
        reach,
        secret_sha256: _,
        created_ns,
        expires_ns,
        former,
        limits,
    } = row;
    v1::Token {
        name: token_name(&name),
        role: role(held).into(),
        create_time_ns: created_ns,
        abilities: abilities(&may),
        maps: reach.patterns().to_vec(),
        expire_time_ns: expires_ns,
        overlap_end_time_ns: former.map(|former| former.until_ns),
        quotas: Some(quotas(&limits)),
        used: Some(quota_use(used)),
    }
}

pub(crate) fn caller(caller: &Caller) -> v1::Caller {
    let Caller { token, role: held, abilities: may, reach, expires_ns, limits } = caller;
    v1::Caller {
        token: token.as_deref().map(token_name).unwrap_or_default(),
        role: role(*held).into(),
        asks_for_token: token.is_some(),
        abilities: abilities(may),
        maps: reach.patterns().to_vec(),
        expire_time_ns: *expires_ns,
        quotas: Some(quotas(limits)),
    }
}

pub(crate) fn new_token(message: v1::CreateTokenRequest) -> Result<NewToken, ServiceError> {
    let v1::CreateTokenRequest { token_id, role, abilities, maps, lifetime_s, quotas } = message;
    Ok(NewToken {
        name: token_id,
        role: requested_role(role)?,
        abilities: abilities.into_iter().map(requested_ability).collect::<Result<_, _>>()?,
        maps,
        lifetime_s,
        limits: requested_limits(quotas.unwrap_or_default()),
    })
}

pub(crate) fn rotation(message: v1::RotateTokenRequest) -> (String, Rotation) {
    let v1::RotateTokenRequest { name, overlap_s, lifetime_s } = message;
    (name, Rotation { overlap_s, lifetime_s })
}

pub(crate) fn limit_change(message: v1::UpdateTokenRequest) -> Result<(String, LimitChange), ServiceError> {
    let v1::UpdateTokenRequest { name, quotas, lifted } = message;
    let limits = requested_limits(quotas.unwrap_or_default());
    let lifted = lifted.into_iter().map(requested_quota).collect::<Result<_, _>>()?;
    Ok((name, LimitChange { limits, lifted }))
}

pub(crate) fn requested_limits(message: v1::Quotas) -> Limits {
    let v1::Quotas { max_maps, max_sessions, max_frames_per_second, max_kept_mib } = message;
    Limits {
        maps: max_maps,
        sessions: max_sessions,
        frames_per_second: max_frames_per_second,
        kept_mib: max_kept_mib,
    }
}

fn requested_quota(code: i32) -> Result<Quota, ServiceError> {
    match known("quota", code)? {
        WireQuota::Maps => Ok(Quota::Maps),
        WireQuota::Sessions => Ok(Quota::Sessions),
        WireQuota::FramesPerSecond => Ok(Quota::FramesPerSecond),
        WireQuota::Kept => Ok(Quota::Kept),
        WireQuota::Unspecified => {
            Err(ServiceError::invalid("one of the quotas to lift is left open; name it, or leave it out"))
        }
    }
}

fn quotas(limits: &Limits) -> v1::Quotas {
    let Limits { maps, sessions, frames_per_second, kept_mib } = limits;
    v1::Quotas {
        max_maps: *maps,
        max_sessions: *sessions,
        max_frames_per_second: *frames_per_second,
        max_kept_mib: *kept_mib,
    }
}

fn quota_use(used: Used) -> v1::QuotaUse {
    let Used { maps, sessions, kept_bytes } = used;
    v1::QuotaUse { maps, sessions, kept_bytes }
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
