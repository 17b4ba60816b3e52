//! What robots and people do: drawn at random, one step after the other, whatever the server holds by then. So a list of
//! steps still means something when some are taken out of it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::seen::PLACES;

/// Names there are for maps, sessions and tokens: few, so that steps meet what others made.
pub(super) const MAPS: u8 = 5;
pub(super) const SESSIONS: u8 = 4;
pub(super) const TOKENS: u8 = 4;

/// One thing that is done, by whom, and where the server is killed meanwhile.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Step {
    pub(super) by: By,
    pub(super) operation: Operation,
    pub(super) killed: Option<Kill>,
}

/// Before, or in the middle of, the n-th call of the disk that changes something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kill {
    pub(super) nth: u32,
    pub(super) halfway: bool,
}

/// Whose secret is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// An admin's, who is always there.
    Operator,
    /// That of a token, if there is one of that number.
    Token(u8),
    /// The one that a token had before, or that of one that is gone.
    Former(u8),
    /// None.
    Nobody,
}

/// From which frame a robot goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum From {
    Next,
    /// Two numbers are left out.
    Gap,
    /// So many that were acknowledged come again before.
    Again(u8),
    /// The first one has the stamp of the one before.
    StaleStamp,
    /// The first one has a word that the model has not.
    ForeignWord,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Robot,
    Admin,
    Reader,
    /// A robot's that may only look.
    Looker,
    /// A robot's that may stream and not read.
    Sender,
    /// A reader's that was to stream, which is no token.
    Wrong,
}

/// The maps of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reach {
    Everywhere,
    One(u8),
    /// All whose names begin alike, which all of them do.
    Beginning,
}

/// How a server ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    Kill,
    Stop,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Operation {
    /// A map that closes loops soon, or one that is careful.
    CreateMap {
        map: u8,
        careful: bool,
    },
    DeleteMap {
        map: u8,
    },
    /// A robot drives on, or is carried to `start`, and streams what it sees.
    Drive {
        map: u8,
        session: u8,
        from: From,
        start: Option<u64>,
        frames: u8,
        noise: u64,
    },
    /// Several robots drive on, all at once.
    Together {
        map: u8,
        robots: u8,
        frames: u8,
        noise: u64,
    },
    /// A robot that leaves nothing behind.
    Localize {
        map: u8,
        start: u64,
        frames: u8,
        noise: u64,
    },
    Query {
        map: u8,
        place: u64,
        noise: u64,
    },
    SetLabel {
        map: u8,
        place: u32,
        label: u8,
    },
    DeleteLabel {
        map: u8,
        place: u32,
    },
    DeleteSession {
        map: u8,
        session: u8,
    },
    Trim {
        map: u8,
        places: u32,
    },
    Compact {
        map: u8,
    },
    /// Exported, and imported under another name.
    Copy {
        from: u8,
        to: u8,
    },
    Merge {
        sources: Vec<u8>,
        target: u8,
    },
    /// The merge that was committed so many merges ago.
    UndoMerge {
        back: u8,
    },
    /// A loop closure is none, says somebody.
    Withdraw {
        map: u8,
        which: u32,
    },
    /// Two frames are of one place, says somebody.
    Confirm {
        map: u8,
        which: u32,
        earlier: u32,
    },
    UndoCorrection {
        map: u8,
        which: u32,
    },
    /// A token, and whether it has quotas.
    CreateToken {
        token: u8,
        role: Role,
        reach: Reach,
        lifetime_s: Option<u32>,
        limited: bool,
    },
    DeleteToken {
        token: u8,
    },
    RotateToken {
        token: u8,
        overlap_s: u32,
    },
    /// All maps that the caller may see.
    ListMaps,
    WhoAmI,
    /// The server ends and starts again.
    Restart {
        end: End,
    },
}

impl Operation {
    /// Whether it is one call, and writes.
    fn may_be_killed(&self) -> bool {
        !matches!(
            self,
            Self::Together { .. }
                | Self::Localize { .. }
                | Self::Query { .. }
                | Self::ListMaps
                | Self::WhoAmI
                | Self::Restart { .. }
        )
    }

    /// Its name, for counting.
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::CreateMap { .. } => "create map",
            Self::DeleteMap { .. } => "delete map",
            Self::Drive { .. } => "drive",
            Self::Together { .. } => "several at once",
            Self::Localize { .. } => "localize",
            Self::Query { .. } => "query",
            Self::SetLabel { .. } => "set label",
            Self::DeleteLabel { .. } => "delete label",
            Self::DeleteSession { .. } => "delete session",
            Self::Trim { .. } => "trim",
            Self::Compact { .. } => "compact",
            Self::Copy { .. } => "export and import",
            Self::Merge { .. } => "merge",
            Self::UndoMerge { .. } => "undo merge",
            Self::Withdraw { .. } => "withdraw",
            Self::Confirm { .. } => "confirm",
            Self::UndoCorrection { .. } => "undo correction",
            Self::CreateToken { .. } => "create token",
            Self::DeleteToken { .. } => "delete token",
            Self::RotateToken { .. } => "rotate token",
            Self::ListMaps => "list maps",
            Self::WhoAmI => "who am I",
            Self::Restart { .. } => "restart",
        }
    }
}

/// The steps of a run: the same ones for the same random numbers.
pub(super) fn steps(random: &mut ChaCha8Rng, count: u64) -> Vec<Step> {
    (0..count).map(|_| step(random)).collect()
}

fn step(random: &mut ChaCha8Rng) -> Step {
    let operation = operation(random);
    let by = match random.random_range(0..100) {
        0..74 => By::Operator,
        74..95 => By::Token(random.random_range(0..TOKENS)),
        95..98 => By::Former(random.random_range(0..TOKENS)),
        _ => By::Nobody,
    };
    // Most operations make few calls of the disk.
    let most = if random.random_bool(0.8) { 8 } else { 60 };
    let kill = Kill { nth: random.random_range(1..=most), halfway: random.random_bool(0.5) };
    let killed = (random.random_bool(0.06) && operation.may_be_killed()).then_some(kill);
    Step { by, operation, killed }
}

fn operation(random: &mut ChaCha8Rng) -> Operation {
    let map = random.random_range(0..MAPS);
    let other = random.random_range(0..MAPS);
    let session = random.random_range(0..2 * SESSIONS);
    let token = random.random_range(0..TOKENS);
    let noise = random.random_range(0..1000);
    let start = random.random_range(0..PLACES);
    let place = random.random_range(0..30);
    match random.random_range(0..1000) {
        0..60 => Operation::CreateMap { map, careful: random.random_bool(0.3) },
        60..80 => Operation::DeleteMap { map },
        80..120 => {
            let (robots, frames) = (random.random_range(2..=4), random.random_range(1..=10));
            Operation::Together { map, robots, frames, noise }
        }
        120..420 => {
            let from = from(random);
            let start = random.random_bool(0.4).then_some(start);
            let frames = random.random_range(1..=16);
            Operation::Drive { map, session, from, start, frames, noise }
        }
        420..460 => {
            let frames = random.random_range(1..=6);
            Operation::Localize { map, start, frames, noise }
        }
        460..530 => Operation::Query { map, place: start, noise },
        530..590 => Operation::SetLabel { map, place, label: random.random_range(0..6) },
        590..620 => Operation::DeleteLabel { map, place },
        620..645 => Operation::DeleteSession { map, session },
        645..665 => Operation::Trim { map, places: random.random_range(0..30) },
        665..680 => Operation::Compact { map },
        680..715 => Operation::Copy { from: map, to: other },
        715..765 => {
            let mut sources = vec![other];
            if random.random_bool(0.4) {
                sources.push(random.random_range(0..MAPS));
            }
            Operation::Merge { sources, target: map }
        }
        765..790 => Operation::UndoMerge { back: random.random_range(0..3) },
        790..805 => Operation::Withdraw { map, which: random.random_range(0..1000) },
        805..820 => {
            let (which, earlier) = (random.random_range(0..1000), random.random_range(0..1000));
            Operation::Confirm { map, which, earlier }
        }
        820..835 => Operation::UndoCorrection { map, which: random.random_range(0..1000) },
        835..885 => {
            let role = role(random);
            let reach = match random.random_range(0..4) {
                0..2 => Reach::Everywhere,
                2 => Reach::One(map),
                _ => Reach::Beginning,
            };
            let lifetime_s = match random.random_range(0..20) {
                0 => Some(1),
                1 => Some(0),
                2..6 => Some(3600),
                _ => None,
            };
            let limited = random.random_bool(0.3);
            Operation::CreateToken { token, role, reach, lifetime_s, limited }
        }
        885..905 => Operation::DeleteToken { token },
        905..925 => {
            Operation::RotateToken { token, overlap_s: if random.random_bool(0.5) { 0 } else { 3600 } }
        }
        925..950 => Operation::ListMaps,
        950..980 => Operation::WhoAmI,
        980..990 => Operation::Restart { end: End::Kill },
        _ => Operation::Restart { end: End::Stop },
    }
}

fn from(random: &mut ChaCha8Rng) -> From {
    match random.random_range(0..20) {
        0..14 => From::Next,
        14 => From::Gap,
        15..18 => From::Again(random.random_range(1..=6)),
        18 => From::StaleStamp,
        _ => From::ForeignWord,
    }
}

fn role(random: &mut ChaCha8Rng) -> Role {
    match random.random_range(0..12) {
        0..4 => Role::Robot,
        4..6 => Role::Admin,
        6..8 => Role::Reader,
        8..10 => Role::Looker,
        10 => Role::Sender,
        _ => Role::Wrong,
    }
}
