//! How much may be kept and sent: by the holder of each token, and by all together.
//!
//! What there is of it is counted here, in memory, and by the database for each session: no frame costs a look at more.

mod limits;
mod rate;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

pub use limits::ServerLimits;
pub(crate) use limits::{Holder, Limits, OverQuota, Quota};
use limits::{Whose, over};
use rate::Rate;

/// When to send a frame again that there is no room for: somebody has to make some.
const ROOM_RETRY: Duration = Duration::from_secs(5);

/// What there is of what may be limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Used {
    pub(crate) maps: u64,
    pub(crate) sessions: u64,
    pub(crate) kept_bytes: u64,
}

/// What there is by the token that it counts for; `None` for what counts for none.
pub(crate) type UsedByOwner = HashMap<Option<String>, Used>;

/// How often each quota has refused something, since the server started.
pub(crate) type Refusals = BTreeMap<(Quota, Holder), u64>;

/// The quotas of all tokens and of the server, and what there is. Cheap to clone, and all clones are one.
#[derive(Clone, Debug, Default)]
pub(crate) struct Quotas {
    books: Arc<Mutex<Books>>,
}

#[derive(Debug, Default)]
struct Books {
    server: ServerLimits,
    in_all: Account,
    tokens: HashMap<String, TokenAccount>,
    refusals: Refusals,
}

/// What there is, and what frames that are on their way to the disk will add.
#[derive(Clone, Copy, Debug, Default)]
struct Account {
    used: Used,
    under_way_bytes: u64,
}

#[derive(Debug, Default)]
struct TokenAccount {
    limits: Limits,
    account: Account,
    /// Where frames a second are limited.
    rate: Option<Rate>,
}

impl Account {
    /// Whether so many bytes more are above a limit.
    fn is_over(self, more_bytes: u64, limit_mib: Option<u32>) -> bool {
        let bytes = self.used.kept_bytes.saturating_add(self.under_way_bytes).saturating_add(more_bytes);
        limit_mib.is_some_and(|limit_mib| bytes > bytes_of(limit_mib))
    }
}

fn bytes_of(mib: u32) -> u64 {
    u64::from(mib) << 20
}

impl Quotas {
    /// The quotas of the server from now on.
    pub(crate) fn set_server(&self, limits: ServerLimits) {
        self.lock().server = limits;
    }

    /// The quotas of a token from now on, also for streams that are open.
    pub(crate) fn set_token(&self, token: &str, limits: &Limits) {
        let mut books = self.lock();
        let account = books.tokens.entry(token.to_owned()).or_default();
        if account.limits.frames_per_second != limits.frames_per_second {
            account.rate = limits.frames_per_second.map(|rate| Rate::new(rate, Instant::now()));
        }
        account.limits = limits.clone();
    }

    /// What there is by token, counted anew.
    pub(crate) fn recount(&self, used: UsedByOwner) {
        let mut books = self.lock();
        books.in_all.used = Used::default();
        books.tokens.values_mut().for_each(|token| token.account.used = Used::default());
        for (owner, used) in used {
            books.add(owner.as_deref(), used);
        }
    }

    /// Notes what has come to be there.
    pub(crate) fn add(&self, owner: Option<&str>, more: Used) {
        self.lock().add(owner, more);
    }

    /// What there is that counts for a token.
    pub(crate) fn used_by(&self, token: &str) -> Used {
        self.lock().tokens.get(token).map(|token| token.account.used).unwrap_or_default()
    }

    /// What there is in all, and what was refused.
    pub(crate) fn in_all(&self) -> (Used, Refusals) {
        let books = self.lock();
        (books.in_all.used, books.refusals.clone())
    }

    /// Refuses another map of a token.
    pub(crate) fn check_map(&self, owner: Option<&str>) -> Result<(), OverQuota> {
        self.ask(|books| books.check_map(owner))
    }

    /// Refuses another session of a token: also where it has no room for what that would keep.
    pub(crate) fn check_session(&self, owner: Option<&str>) -> Result<(), OverQuota> {
        self.ask(|books| books.check_session(owner))
    }

    /// Refuses sessions that are to be copied or brought in, with what they keep: for the server as a whole.
    pub(crate) fn check_copies(&self, sessions: u64, bytes: u64) -> Result<(), OverQuota> {
        self.ask(|books| {
            books.check_sessions_in_all(sessions)?;
            books.check_room(None, bytes)
        })
    }

    /// Refuses frames of a session while there is no room for what they would keep.
    pub(crate) fn check_room(&self, owner: Option<&str>) -> Result<(), OverQuota> {
        self.ask(|books| books.check_room(owner, 1)).map_err(|over| over.passing(ROOM_RETRY))
    }

    /// Room for what a frame keeps, until that is on the disk and counted.
    pub(crate) fn reserve(&self, owner: Option<&str>, bytes: u64) -> Result<Reserved, OverQuota> {
        let reserved = self.ask(|books| {
            books.check_room(owner, bytes)?;
            books.set_under_way(owner, |under_way_bytes| under_way_bytes.saturating_add(bytes));
            Ok(())
        });
        reserved.map_err(|over| over.passing(ROOM_RETRY))?;
        Ok(Reserved { quotas: self.clone(), owner: owner.map(str::to_owned), bytes })
    }

    /// A frame that a token sends, or when to send it again. `stream` is whose turn it may be; a sender without one gets no
    /// place in line.
    pub(crate) fn frame(
        &self,
        token: Option<&str>,
        stream: Option<u64>,
        now: Instant,
    ) -> Result<FrameTurn, OverQuota> {
        let limited = self.ask(|books| {
            let rate = token.and_then(|token| Some((token, books.tokens.get_mut(token)?.rate.as_mut()?)));
            let Some((token, rate)) = rate else { return Ok(None) };
            match rate.take(stream, now) {
                Ok(()) => Ok(Some(token.to_owned())),
                Err(wait) => Err(OverQuota::of_frames(token, rate.per_second(), wait)),
            }
        });
        Ok(FrameTurn { quotas: self.clone(), token: limited? })
    }

    /// Asks the books for something, and counts it if they refuse.
    fn ask<T>(&self, what: impl FnOnce(&mut Books) -> Result<T, OverQuota>) -> Result<T, OverQuota> {
        let mut books = self.lock();
        what(&mut books).inspect_err(|over| {
            *books.refusals.entry((over.quota, over.holder)).or_default() += 1;
        })
    }

    fn lock(&self) -> MutexGuard<'_, Books> {
        self.books.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Books {
    fn token<'a>(&'a self, owner: Option<&'a str>) -> Option<(&'a str, &'a TokenAccount)> {
        owner.and_then(|owner| Some((owner, self.tokens.get(owner)?)))
    }

    fn add(&mut self, owner: Option<&str>, more: Used) {
        let account = owner.map(|owner| &mut self.tokens.entry(owner.to_owned()).or_default().account);
        for account in [Some(&mut self.in_all), account].into_iter().flatten() {
            let Used { maps, sessions, kept_bytes } = &mut account.used;
            *maps += more.maps;
            *sessions += more.sessions;
            *kept_bytes += more.kept_bytes;
        }
    }

    fn set_under_way(&mut self, owner: Option<&str>, change: impl Fn(u64) -> u64) {
        let account = owner.map(|owner| &mut self.tokens.entry(owner.to_owned()).or_default().account);
        for account in [Some(&mut self.in_all), account].into_iter().flatten() {
            account.under_way_bytes = change(account.under_way_bytes);
        }
    }

    fn check_map(&self, owner: Option<&str>) -> Result<(), OverQuota> {
        let count = |account: Account| account.used.maps;
        if let Some((name, token)) = self.token(owner)
            && let Some(limit) = token.limits.maps.filter(|limit| count(token.account) >= u64::from(*limit))
        {
            return Err(over(Whose::Token(name), Quota::Maps, count(token.account), limit));
        }
        match self.server.max_maps.filter(|limit| count(self.in_all) >= u64::from(limit.get())) {
            Some(limit) => Err(over(Whose::Server, Quota::Maps, count(self.in_all), limit.get())),
            None => Ok(()),
        }
    }

    fn check_session(&self, owner: Option<&str>) -> Result<(), OverQuota> {
        let count = |account: Account| account.used.sessions;
        if let Some((name, token)) = self.token(owner)
            && let Some(limit) =
                token.limits.sessions.filter(|limit| count(token.account) >= u64::from(*limit))
        {
            return Err(over(Whose::Token(name), Quota::Sessions, count(token.account), limit));
        }
        self.check_sessions_in_all(1)?;
        self.check_room(owner, 1)
    }

    fn check_sessions_in_all(&self, more: u64) -> Result<(), OverQuota> {
        let used = self.in_all.used.sessions;
        match self.server.max_sessions.filter(|limit| used.saturating_add(more) > u64::from(limit.get())) {
            Some(limit) => Err(over(Whose::Server, Quota::Sessions, used, limit.get())),
            None => Ok(()),
        }
    }

    fn check_room(&self, owner: Option<&str>, bytes: u64) -> Result<(), OverQuota> {
        if let Some((name, token)) = self.token(owner)
            && let Some(limit) = token.limits.kept_mib
            && token.account.is_over(bytes, Some(limit))
        {
            return Err(over(Whose::Token(name), Quota::Kept, token.account.used.kept_bytes, limit));
        }
        match self.server.max_kept_mib {
            Some(limit) if self.in_all.is_over(bytes, Some(limit.get())) => {
                Err(over(Whose::Server, Quota::Kept, self.in_all.used.kept_bytes, limit.get()))
            }
            Some(_) | None => Ok(()),
        }
    }
}

/// Room for what a frame keeps.
#[derive(Debug)]
pub(crate) struct Reserved {
    quotas: Quotas,
    owner: Option<String>,
    bytes: u64,
}

impl Drop for Reserved {
    fn drop(&mut self) {
        let bytes = self.bytes;
        self.quotas.lock().set_under_way(self.owner.as_deref(), |under_way| under_way.saturating_sub(bytes));
    }
}

/// A frame that may be looked at; given back when dropped, unless it was.
#[derive(Debug)]
pub(crate) struct FrameTurn {
    quotas: Quotas,
    token: Option<String>,
}

impl FrameTurn {
    /// It was looked at.
    pub(crate) fn spend(mut self) {
        self.token = None;
    }
}

impl Drop for FrameTurn {
    fn drop(&mut self) {
        let Some(token) = &self.token else { return };
        if let Some(rate) = self.quotas.lock().tokens.get_mut(token).and_then(|token| token.rate.as_mut()) {
            rate.give_back();
        }
    }
}
