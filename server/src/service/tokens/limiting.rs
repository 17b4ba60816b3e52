//! The quotas of tokens: what they may be, and how they change.

use super::{TokenRow, Tokens};
use crate::error::ServiceError;
use crate::names::{check_id, id_in};
use crate::quotas::{Limits, Quota};
use crate::role::Role;

/// Frames a second that a token may be limited to. With fewer, clients would take the server for gone.
const FRAMES_PER_SECOND: std::ops::RangeInclusive<f64> = 0.1..=1000.0;

/// A change of a token's quotas.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct LimitChange {
    /// What these are `None` of stays as it is.
    pub(crate) limits: Limits,
    /// What is not to be limited any more.
    pub(crate) lifted: Vec<Quota>,
}

impl LimitChange {
    /// What a token's quotas become.
    fn of(&self, before: &Limits) -> Result<Limits, ServiceError> {
        let Limits { maps, sessions, frames_per_second, kept_mib } = &self.limits;
        let mut limits = Limits {
            maps: maps.or(before.maps),
            sessions: sessions.or(before.sessions),
            frames_per_second: frames_per_second.or(before.frames_per_second),
            kept_mib: kept_mib.or(before.kept_mib),
        };
        for quota in &self.lifted {
            let is_set = match quota {
                Quota::Maps => maps.is_some(),
                Quota::Sessions => sessions.is_some(),
                Quota::FramesPerSecond => frames_per_second.is_some(),
                Quota::Kept => kept_mib.is_some(),
            };
            if is_set {
                return Err(ServiceError::invalid(format_args!(
                    "the quota {} is to be both set and lifted; say one of them",
                    quota.setting()
                )));
            }
            match quota {
                Quota::Maps => limits.maps = None,
                Quota::Sessions => limits.sessions = None,
                Quota::FramesPerSecond => limits.frames_per_second = None,
                Quota::Kept => limits.kept_mib = None,
            }
        }
        Ok(limits)
    }
}

impl Tokens {
    /// Changes the quotas of `tokens/{token}`, which keeps its secret.
    pub(crate) async fn limit(&self, name: &str, change: LimitChange) -> Result<TokenRow, ServiceError> {
        let name = check_id("token name", id_in("tokens", name)?)?.to_owned();
        if change == LimitChange::default() {
            return Err(ServiceError::invalid(
                "no quota is to change; set one (max_maps, max_sessions, max_frames_per_second, max_kept_mib) or lift one",
            ));
        }
        check_values(&change.limits)?;
        let tokens = self.clone();
        let changing = self.changing.clone().lock_owned().await;
        // A task of its own: the caller may go away, but database and memory must agree.
        let limited = tokio::spawn(async move {
            let _changing = changing;
            let before = tokens.lock().token(&name)?.clone();
            let limits = change.of(&before.limits)?;
            check_limits(before.role, &limits)?;
            let token = TokenRow { limits, ..before };
            tokens.storage.limit_token(&token).await?;
            tokens.lock().put(token.clone());
            Ok::<_, ServiceError>(token)
        });
        let token = limited.await.map_err(ServiceError::internal)??;
        tracing::info!(token = token.name, limits = ?token.limits, "token limited");
        Ok(token)
    }
}

/// Refuses quotas that would let nothing through.
fn check_values(limits: &Limits) -> Result<(), ServiceError> {
    let Limits { maps, sessions, frames_per_second, kept_mib } = limits;
    let counts = [(Quota::Maps, maps), (Quota::Sessions, sessions), (Quota::Kept, kept_mib)];
    if let Some((quota, _)) = counts.iter().find(|(_, limit)| **limit == Some(0)) {
        return Err(ServiceError::invalid(format_args!(
            "a quota of 0 would let nothing through ({}); say at least 1, take the ability away with another token, or \
             leave it out for no limit",
            quota.setting()
        )));
    }
    if let Some(frames) = frames_per_second.filter(|frames| !FRAMES_PER_SECOND.contains(frames)) {
        return Err(ServiceError::invalid(format_args!(
            "{frames} frames a second cannot be a quota; say from {} to {}, or leave it out for no limit",
            FRAMES_PER_SECOND.start(),
            FRAMES_PER_SECOND.end()
        )));
    }
    Ok(())
}

/// The same, and those of what the role does not do.
pub(super) fn check_limits(role: Role, limits: &Limits) -> Result<(), ServiceError> {
    check_values(limits)?;
    match role {
        Role::Reader if *limits != Limits::default() => Err(ServiceError::invalid(
            "a reader changes nothing and sends no frames, so it has no quotas; leave them out, or choose the role robot",
        )),
        Role::Robot if limits.maps.is_some() => Err(ServiceError::invalid(
            "a robot makes no maps, so max_maps limits nothing; leave it out, or choose the role admin and limit it to maps",
        )),
        Role::Reader | Role::Robot | Role::Admin => Ok(()),
    }
}
