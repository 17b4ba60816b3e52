//! Who asks, and what they may do.

use crate::error::ServiceError;
use crate::names::{check_id, map_of};
use crate::quotas::Limits;
use crate::role::{Abilities, Ability, Reach, Role};
use crate::storage::TokenRow;

/// What a call asks of who makes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// Nothing.
    Open,
    /// A token, whatever it is good for.
    Token,
    /// A token that may do one of these.
    May(&'static [Ability]),
    /// The token of an admin, for all maps: it is about the whole server.
    Server,
}

impl Access {
    pub(crate) const READ: Self = Self::May(&[Ability::Read]);
    pub(crate) const LOCALIZE: Self = Self::May(&[Ability::Localize]);
    pub(crate) const STREAM: Self = Self::May(&[Ability::Stream]);
    /// Which of both a session takes is known by its first message.
    pub(crate) const OPEN_SESSION: Self = Self::May(&[Ability::Localize, Ability::Stream]);
    pub(crate) const NAVIGATE: Self = Self::May(&[Ability::Navigate]);
    pub(crate) const ADMIN: Self = Self::May(&[Ability::Admin]);
}

/// Who asks, and what they may do.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Caller {
    /// Name of the token that was shown; `None` where the server has none.
    pub(crate) token: Option<String>,
    pub(crate) role: Role,
    pub(crate) abilities: Abilities,
    pub(crate) reach: Reach,
    /// When the token expires, or the secret that was shown, if that comes first.
    pub(crate) expires_ns: Option<i64>,
    pub(crate) limits: Limits,
}

impl Caller {
    /// Whoever is served without a token.
    pub(crate) fn anybody() -> Self {
        let role = Role::Admin;
        Self {
            token: None,
            role,
            abilities: role.abilities(),
            reach: Reach::Everywhere,
            expires_ns: None,
            limits: Limits::default(),
        }
    }

    /// Who shows a token's secret that is good until `expires_ns`.
    pub(super) fn of(token: &TokenRow, expires_ns: Option<i64>) -> Self {
        let TokenRow { name, role, abilities, reach, limits, .. } = token.clone();
        Self { token: Some(name), role, abilities, reach, expires_ns, limits }
    }

    /// Refuses what the caller may not do on any map.
    pub(crate) fn check(&self, access: Access) -> Result<(), ServiceError> {
        match access {
            Access::Open | Access::Token => Ok(()),
            Access::May(wanted) => self.check_may(wanted),
            Access::Server => {
                self.check_may(&[Ability::Admin])?;
                if self.reach == Reach::Everywhere {
                    return Ok(());
                }
                Err(denied(format!(
                    "this is about the whole server, and the token {} is for {} alone; ask who runs the server for one \
                     without that limit",
                    self.name(),
                    self.reach
                )))
            }
        }
    }

    fn check_may(&self, wanted: &[Ability]) -> Result<(), ServiceError> {
        if wanted.iter().any(|ability| self.abilities.have(*ability)) {
            return Ok(());
        }
        if wanted == [Ability::Admin] {
            return Err(denied(format!(
                "this takes the token of an admin, and {} is a {}'s; ask who runs the server for one",
                self.name(),
                self.role.name()
            )));
        }
        let wanted: Vec<&str> = wanted.iter().map(|ability| ability.name()).collect();
        Err(denied(format!(
            "this takes a token that may {}, and {} may only {}; ask who runs the server for one that may",
            wanted.join(" or "),
            self.name(),
            self.abilities
        )))
    }

    /// Refuses a map that the caller does not reach, whether there is such a map or not.
    pub(crate) fn check_map(&self, map: &str) -> Result<(), ServiceError> {
        // What is no name is refused for that.
        if self.reach.has(map) || check_id("map name", map).is_err() {
            return Ok(());
        }
        Err(denied(format!(
            "the token {} is for {}, and not for the map {map}; ask who runs the server for one that is",
            self.name(),
            self.reach
        )))
    }

    /// The same for the map in the name of a resource, as in `maps/{map}/places/7`.
    pub(crate) fn check_resource(&self, name: &str) -> Result<(), ServiceError> {
        map_of(name).map_or(Ok(()), |map| self.check_map(map))
    }

    /// Whether the caller reaches all of these maps.
    pub(crate) fn reaches<'a>(&self, maps: impl IntoIterator<Item = &'a str>) -> bool {
        maps.into_iter().all(|map| self.reach.has(map))
    }

    /// Refuses what is about maps of which the caller does not reach all. They are not named: the caller did not, either.
    pub(crate) fn check_reaches<'a>(
        &self,
        what: &str,
        maps: impl IntoIterator<Item = &'a str>,
    ) -> Result<(), ServiceError> {
        if self.reaches(maps) {
            return Ok(());
        }
        Err(self.reaches_not(what))
    }

    /// Why the caller hears nothing about what is about other maps, too.
    pub(crate) fn reaches_not(&self, what: &str) -> ServiceError {
        denied(format!(
            "{what} is about maps that the token {} is not for: it is for {} alone; ask who runs the server for one that \
             is for all of them",
            self.name(),
            self.reach
        ))
    }

    /// Whoever is served without a token is never refused.
    fn name(&self) -> &str {
        self.token.as_deref().unwrap_or("none")
    }
}

fn denied(message: String) -> ServiceError {
    ServiceError::PermissionDenied { message }
}
