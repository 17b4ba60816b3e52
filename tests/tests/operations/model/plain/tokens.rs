//! Tokens as the model has them: who may call what.

use std::collections::BTreeSet;

use waypost_client::Code;
use waypost_client::v1::token::{Ability, Role as WireRole};

use super::super::operations::{By, Reach, Role};
use super::World;

#[derive(Clone, Debug)]
pub(in super::super) struct PlainToken {
    pub(in super::super) role: WireRole,
    /// As the server lists them.
    pub(in super::super) abilities: Vec<Ability>,
    /// Names, or their beginnings; none for all maps.
    pub(in super::super) maps: Vec<String>,
    /// Known by what the server answered.
    pub(in super::super) secret: String,
    /// The one before, for as long as it is good, too.
    pub(in super::super) former: Option<String>,
    pub(in super::super) expires_ns: Option<i64>,
    /// Quotas.
    pub(in super::super) max_maps: Option<u32>,
    pub(in super::super) max_sessions: Option<u32>,
}

/// What a call asks of who makes it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Access {
    /// A token.
    Any,
    May(Ability),
    /// One of both.
    Either(Ability, Ability),
    /// An admin's for all maps.
    Server,
}

/// Who calls, as the model knows them.
#[derive(Clone, Debug)]
pub(in super::super) struct Shown {
    /// What is sent; none without a token.
    pub(in super::super) secret: Option<String>,
    /// Whose it is; none if it is no token's.
    pub(in super::super) token: Option<String>,
}

/// The admin's token that is always there.
pub(in super::super) const OPERATOR: &str = "operator";

/// A token that is asked for.
pub(in super::super) struct Asked {
    pub(in super::super) role: WireRole,
    /// None for all that the role may.
    pub(in super::super) abilities: Vec<Ability>,
    pub(in super::super) maps: Vec<String>,
    pub(in super::super) max_maps: Option<u32>,
    pub(in super::super) max_sessions: Option<u32>,
}

impl Asked {
    pub(in super::super) fn of(role: Role, reach: Reach, limited: bool) -> Self {
        let (role, abilities) = match role {
            Role::Robot => (WireRole::Robot, vec![]),
            Role::Admin => (WireRole::Admin, vec![]),
            Role::Reader => (WireRole::Reader, vec![]),
            Role::Looker => (WireRole::Robot, vec![Ability::Read, Ability::Localize]),
            Role::Sender => (WireRole::Robot, vec![Ability::Stream]),
            Role::Wrong => (WireRole::Reader, vec![Ability::Stream]),
        };
        let maps = match reach {
            Reach::Everywhere => vec![],
            Reach::One(map) => vec![format!("m{map}")],
            Reach::Beginning => vec!["m*".to_owned()],
        };
        // Who only reads has none, and none but an admin makes maps.
        let (max_maps, max_sessions) = match role {
            WireRole::Admin if limited => (Some(1), Some(3)),
            WireRole::Robot if limited => (None, Some(2)),
            WireRole::Admin | WireRole::Robot | WireRole::Reader | WireRole::Unspecified => (None, None),
        };
        Self { role, abilities, maps, max_maps, max_sessions }
    }

    /// All that a role may.
    fn whole(&self) -> Vec<Ability> {
        let all = [Ability::Read, Ability::Localize, Ability::Stream, Ability::Navigate, Ability::Admin];
        let many = match self.role {
            WireRole::Reader => 1,
            WireRole::Robot => 4,
            WireRole::Admin => 5,
            WireRole::Unspecified => 0,
        };
        all[..many].to_vec()
    }
}

impl World {
    /// Whose secret is shown.
    pub(in super::super) fn shown(&self, by: By) -> Shown {
        let gone = || Shown {
            secret: Some(self.gone.last().cloned().unwrap_or_else(|| "waypost_0".to_owned())),
            token: None,
        };
        let of = |name: &str, secret: &str| Shown {
            secret: Some(secret.to_owned()),
            token: Some(name.to_owned()),
        };
        match by {
            By::Operator => of(OPERATOR, &self.tokens[OPERATOR].secret),
            By::Nobody => Shown { secret: None, token: None },
            By::Token(number) => {
                let name = token_name(number);
                self.tokens.get(&name).map_or_else(gone, |token| of(&name, &token.secret))
            }
            By::Former(number) => {
                let name = token_name(number);
                let former = self.tokens.get(&name).and_then(|token| token.former.clone());
                former.map_or_else(gone, |former| of(&name, &former))
            }
        }
    }

    /// Lets a call in that is about these maps.
    pub(super) fn admit(
        &self,
        shown: &Shown,
        access: Access,
        maps: &[&str],
        now_ns: i64,
    ) -> Result<(), Code> {
        let token =
            shown.token.as_ref().and_then(|name| self.tokens.get(name)).ok_or(Code::Unauthenticated)?;
        if token.expires_ns.is_some_and(|at| at <= now_ns) {
            return Err(Code::Unauthenticated);
        }
        let may = |ability: Ability| token.abilities.contains(&ability);
        let may = match access {
            Access::Any => true,
            Access::May(ability) => may(ability),
            Access::Either(one, other) => may(one) || may(other),
            Access::Server => may(Ability::Admin) && token.maps.is_empty(),
        };
        if !may || !maps.iter().all(|map| token.reaches(map)) {
            return Err(Code::PermissionDenied);
        }
        Ok(())
    }

    /// Refuses another map of a token.
    pub(super) fn check_map_quota(&self, shown: &Shown) -> Result<(), Code> {
        let Some((name, token)) = shown.token.as_ref().and_then(|name| self.tokens.get_key_value(name))
        else {
            return Ok(());
        };
        let over = token.max_maps.is_some_and(|most| self.used_by(name).0 >= u64::from(most));
        if over { Err(Code::FailedPrecondition) } else { Ok(()) }
    }

    /// Refuses another session of a token.
    pub(super) fn check_session_quota(&self, shown: &Shown) -> Result<(), Code> {
        let Some((name, token)) = shown.token.as_ref().and_then(|name| self.tokens.get_key_value(name))
        else {
            return Ok(());
        };
        let over = token.max_sessions.is_some_and(|most| self.used_by(name).1 >= u64::from(most));
        if over { Err(Code::FailedPrecondition) } else { Ok(()) }
    }

    /// Whether the caller is an admin, whom all sessions are open to.
    pub(super) fn is_admin(&self, shown: &Shown) -> bool {
        let token = shown.token.as_ref().and_then(|name| self.tokens.get(name));
        token.is_some_and(|token| token.role == WireRole::Admin)
    }

    /// Makes a token whose secret is not known yet.
    pub(in super::super) fn create_token(
        &mut self,
        shown: &Shown,
        name: &str,
        asked: &Asked,
        lifetime_s: Option<u32>,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::Server, &[], now_ns)?;
        let whole = asked.whole();
        let beyond = asked.abilities.iter().any(|ability| !whole.contains(ability));
        if lifetime_s == Some(0) || beyond {
            return Err(Code::InvalidArgument);
        }
        if self.tokens.contains_key(name) {
            return Err(Code::AlreadyExists);
        }
        let abilities = if asked.abilities.is_empty() { whole } else { asked.abilities.clone() };
        let expires_ns = lifetime_s.map(|seconds| now_ns + i64::from(seconds) * 1_000_000_000);
        let token = PlainToken {
            role: asked.role,
            abilities,
            maps: asked.maps.clone(),
            secret: String::new(),
            former: None,
            expires_ns,
            max_maps: asked.max_maps,
            max_sessions: asked.max_sessions,
        };
        self.tokens.insert(name.to_owned(), token);
        Ok(())
    }

    pub(in super::super) fn delete_token(
        &mut self,
        shown: &Shown,
        name: &str,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::Server, &[], now_ns)?;
        let token = self.tokens.remove(name).ok_or(Code::NotFound)?;
        self.gone.push(token.secret);
        Ok(())
    }

    /// Gives a token a secret that is not known yet.
    pub(in super::super) fn rotate_token(
        &mut self,
        shown: &Shown,
        name: &str,
        overlap_s: u32,
        now_ns: i64,
    ) -> Result<(), Code> {
        self.admit(shown, Access::Server, &[], now_ns)?;
        let token = self.tokens.get_mut(name).ok_or(Code::NotFound)?;
        if token.expires_ns.is_some_and(|at| at <= now_ns) {
            return Err(Code::FailedPrecondition);
        }
        let before = std::mem::take(&mut token.secret);
        let older = token.former.take();
        let good = (overlap_s > 0).then(|| before.clone());
        self.gone.extend(older.into_iter().chain(good.is_none().then_some(before)));
        token.former = good;
        Ok(())
    }

    /// Who asks, as the server tells it.
    pub(in super::super) fn caller(&self, shown: &Shown, now_ns: i64) -> Result<String, Code> {
        self.admit(shown, Access::Any, &[], now_ns)?;
        let name = shown.token.as_ref().ok_or(Code::Unauthenticated)?;
        Ok(self.tokens[name].line(&format!("tokens/{name}")))
    }
}

impl PlainToken {
    fn reaches(&self, map: &str) -> bool {
        let is_for = |pattern: &String| match pattern.strip_suffix('*') {
            Some(beginning) => map.starts_with(beginning),
            None => map == pattern,
        };
        self.maps.is_empty() || self.maps.iter().any(is_for)
    }

    /// What it is, in one line.
    pub(in super::super) fn line(&self, name: &str) -> String {
        token_line(name, self.role, &self.abilities, &self.maps)
    }
}

/// The same of what the server tells.
pub(in super::super) fn token_line(
    name: &str,
    role: WireRole,
    abilities: &[Ability],
    maps: &[String],
) -> String {
    let abilities: BTreeSet<&str> = abilities.iter().map(Ability::as_str_name).collect();
    format!("{name} {role:?} {abilities:?} {maps:?}")
}

pub(in super::super) fn token_name(number: u8) -> String {
    format!("t{number}")
}
