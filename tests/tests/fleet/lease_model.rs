//! Lease, fence and append of a database that several servers have, checked in all orders in which their steps can come.
//!
//! Three servers, one robot, PostgreSQL's primary and a standby that follows it. Anything may come between two steps: a server
//! dies, or sleeps for as long as it likes; a lease runs out at any moment, for no clock decides about safety; an answer gets
//! lost; the primary dies and the standby goes on with what it has. Steps are those of `server/src/storage/postgres/lease.rs`
//! (`try_to_take`), `postgres.rs` (`fence`) and `appending.rs`.
//!
//! Each rule that makes this safe is left out once ([`Rule`]): the check then finds an order that breaks a promise.

use stateright::{Checker, HasDiscoveries, Model, Property};

const SERVERS: usize = 3;
/// The robot sends so many frames, each until it is acknowledged.
const FRAMES: usize = 3;
/// The database changes hands so often at most.
const EPOCHS: u8 = 5;
/// Standbys that are promoted, one after the other.
const PROMOTIONS: u8 = 2;

/// What keeps every promise, if all of it is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    /// A transaction that appends finds its own epoch in the lease.
    FenceFindsItsEpoch,
    /// It holds that row until its end: nobody takes it before.
    FenceHoldsTheRow,
    /// A server that took the lease reads the log after that.
    LogIsReadAfterTaking,
    /// Who reads the log looks whether the lease is its own still: another owner may have written what no standby has.
    LogIsReadByTheOwner,
    /// What a server holds of the log is read anew when it is not known what became of a commit.
    LogIsReadAfterDoubt,
    /// A commit is done when a standby has it.
    CommitsReachAStandby,
    /// Who waited for a standby until PostgreSQL gave that up owns nothing, and tells nobody.
    GivingUpEndsOwnership,
}

const RULES: [Rule; 7] = [
    Rule::FenceFindsItsEpoch,
    Rule::FenceHoldsTheRow,
    Rule::LogIsReadAfterTaking,
    Rule::LogIsReadByTheOwner,
    Rule::LogIsReadAfterDoubt,
    Rule::CommitsReachAStandby,
    Rule::GivingUpEndsOwnership,
];

/// What a transaction wrote, in the order of the primary's write-ahead log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Written {
    /// The lease has this epoch.
    Taken { epoch: u8 },
    /// The log of the map has the robot's next frame, by the owner of this epoch.
    Frame { epoch: u8, sequence: usize },
}

/// What a server is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Server {
    /// It owns nothing. `read` are the frames of the log that it holds; `None` where it has yet to read them.
    Reserve { read: Option<usize> },
    /// Its commit of the lease is on its way.
    Taking { epoch: u8, at: usize, read: Option<usize> },
    /// It owns the database, as far as it knows.
    Owner { epoch: u8, read: Option<usize>, transaction: Transaction },
}

const RESERVE: Server = Server::Reserve { read: None };

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Transaction {
    None,
    /// The fence let it through.
    Fenced,
    /// Its commit lies at this place of the write-ahead log, and is waited for.
    Committing {
        at: usize,
    },
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct State {
    written: Vec<Written>,
    /// So much of it is on the standby.
    replicated: usize,
    servers: [Server; SERVERS],
    /// Frames that the robot knows to be stored.
    acknowledged: usize,
    promotions: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Step {
    Take(usize),
    ReadLog(usize),
    /// The robot's next frame is there: it is answered from what is stored, or a transaction is begun.
    Receive(usize),
    Append(usize),
    /// The standby has the next of what was written.
    Replicate,
    /// A server hears that its commit is done.
    Committed(usize),
    /// PostgreSQL waits no longer for the standby: the commit is seen by all.
    GiveUp(usize),
    Die(usize),
    /// The primary dies. What the standby has is the database.
    Promote,
}

/// The protocol without one of its rules, or with all of them.
struct Protocol {
    without: Option<Rule>,
}

impl Server {
    /// Where its commit lies that is waited for.
    fn commits_at(self) -> Option<usize> {
        match self {
            Server::Taking { at, .. } | Server::Owner { transaction: Transaction::Committing { at }, .. } => {
                Some(at)
            }
            Server::Reserve { .. }
            | Server::Owner { transaction: Transaction::None | Transaction::Fenced, .. } => None,
        }
    }

    /// Whether it holds the lease's row as one that must not change.
    fn holds_the_row(self) -> bool {
        match self {
            Server::Owner { transaction: Transaction::Fenced | Transaction::Committing { .. }, .. } => true,
            Server::Reserve { .. }
            | Server::Taking { .. }
            | Server::Owner { transaction: Transaction::None, .. } => false,
        }
    }
}

impl State {
    /// What other transactions see: all but commits that wait for the standby.
    fn seen(&self) -> impl Iterator<Item = Written> {
        let waiting = |at: usize| self.servers.iter().any(|server| server.commits_at() == Some(at));
        self.written.iter().enumerate().filter(move |&(at, _)| !waiting(at)).map(|(_, &written)| written)
    }

    fn epoch(&self) -> u8 {
        let epoch = |written| match written {
            Written::Taken { epoch } => Some(epoch),
            Written::Frame { .. } => None,
        };
        self.seen().filter_map(epoch).last().unwrap_or(0)
    }

    fn frames(&self) -> usize {
        self.seen().filter(|written| matches!(written, Written::Frame { .. })).count()
    }

    fn is_being_taken(&self) -> bool {
        self.servers.iter().any(|server| matches!(server, Server::Taking { .. }))
    }

    /// What becomes of a server whose connections are gone: it does not know what became of its commit.
    fn cut_off(&mut self, number: usize, protocol: &Protocol) {
        self.servers[number] = match self.servers[number] {
            Server::Owner { epoch, read, transaction: Transaction::Committing { .. } } => {
                let read = read.filter(|_| !protocol.keeps(Rule::LogIsReadAfterDoubt));
                Server::Owner { epoch, read, transaction: Transaction::None }
            }
            Server::Owner { epoch, read, transaction: Transaction::None | Transaction::Fenced } => {
                Server::Owner { epoch, read, transaction: Transaction::None }
            }
            Server::Taking { .. } | Server::Reserve { .. } => RESERVE,
        };
    }
}

impl Protocol {
    fn keeps(&self, rule: Rule) -> bool {
        self.without != Some(rule)
    }

    fn may(&self, state: &State, step: Step) -> bool {
        match step {
            Step::Take(number) => {
                let is_held = state.servers.iter().any(|server| server.holds_the_row());
                matches!(state.servers[number], Server::Reserve { .. })
                    && state.epoch() < EPOCHS
                    && !state.is_being_taken()
                    && !(is_held && self.keeps(Rule::FenceHoldsTheRow))
            }
            Step::ReadLog(number) => match state.servers[number] {
                Server::Owner { epoch, read: None, transaction: _ } => {
                    epoch == state.epoch() || !self.keeps(Rule::LogIsReadByTheOwner)
                }
                Server::Reserve { read: None } => !self.keeps(Rule::LogIsReadAfterTaking),
                Server::Owner { .. } | Server::Taking { .. } | Server::Reserve { read: Some(_) } => false,
            },
            Step::Receive(number) => match state.servers[number] {
                Server::Owner { epoch, read: Some(read), transaction: Transaction::None } => {
                    let is_fenced_out = epoch != state.epoch() || state.is_being_taken();
                    state.acknowledged < FRAMES
                        && (state.acknowledged < read
                            || !(is_fenced_out && self.keeps(Rule::FenceFindsItsEpoch)))
                }
                Server::Owner { .. } | Server::Taking { .. } | Server::Reserve { .. } => false,
            },
            Step::Append(number) => {
                matches!(state.servers[number], Server::Owner { transaction: Transaction::Fenced, .. })
            }
            Step::Replicate => state.replicated < state.written.len(),
            Step::Committed(number) => state.servers[number]
                .commits_at()
                .is_some_and(|at| at < state.replicated || !self.keeps(Rule::CommitsReachAStandby)),
            Step::GiveUp(number) => state.servers[number].commits_at().is_some(),
            Step::Die(number) => state.servers[number] != RESERVE,
            Step::Promote => state.promotions < PROMOTIONS,
        }
    }

    fn take(state: &mut State, number: usize) {
        let epoch = state.epoch() + 1;
        let Server::Reserve { read } = state.servers[number] else { return };
        state.servers[number] = Server::Taking { epoch, at: state.written.len(), read };
        state.written.push(Written::Taken { epoch });
    }

    /// The row has the number of the frame, and there is one row of a number: the same frame is not there twice.
    fn append(&self, state: &mut State, number: usize) {
        let Server::Owner { epoch, read: Some(read), transaction: _ } = state.servers[number] else { return };
        let sequence = read + 1;
        let is_there = |written: &Written| matches!(written, Written::Frame { sequence: known, .. } if *known == sequence);
        if state.written.iter().any(is_there) {
            let read = Some(read).filter(|_| !self.keeps(Rule::LogIsReadAfterDoubt));
            state.servers[number] = Server::Owner { epoch, read, transaction: Transaction::None };
            return;
        }
        let transaction = Transaction::Committing { at: state.written.len() };
        state.servers[number] = Server::Owner { epoch, read: Some(read), transaction };
        state.written.push(Written::Frame { epoch, sequence });
    }

    /// A commit is done: the lease is the server's, or the frame is acknowledged.
    fn committed(state: &mut State, number: usize) {
        match state.servers[number] {
            Server::Taking { epoch, at: _, read } => {
                state.servers[number] = Server::Owner { epoch, read, transaction: Transaction::None };
            }
            Server::Owner { epoch, read, transaction: _ } => {
                let read = read.map(|read| read + 1);
                state.acknowledged = state.acknowledged.max(read.unwrap_or(0));
                state.servers[number] = Server::Owner { epoch, read, transaction: Transaction::None };
            }
            Server::Reserve { .. } => {}
        }
    }

    fn promote(&self, state: &mut State) {
        state.written.truncate(state.replicated);
        state.promotions += 1;
        for number in 0..SERVERS {
            state.cut_off(number, self);
        }
    }
}

impl Model for Protocol {
    type State = State;
    type Action = Step;

    fn init_states(&self) -> Vec<State> {
        vec![State {
            written: Vec::new(),
            replicated: 0,
            servers: [RESERVE; SERVERS],
            acknowledged: 0,
            promotions: 0,
        }]
    }

    fn actions(&self, state: &State, steps: &mut Vec<Step>) {
        let of_servers = [
            Step::Take,
            Step::ReadLog,
            Step::Receive,
            Step::Append,
            Step::Committed,
            Step::GiveUp,
            Step::Die,
        ];
        let of_servers = of_servers.into_iter().flat_map(|step| (0..SERVERS).map(step));
        steps
            .extend(of_servers.chain([Step::Replicate, Step::Promote]).filter(|&step| self.may(state, step)));
    }

    fn next_state(&self, before: &State, step: Step) -> Option<State> {
        let mut state = before.clone();
        match step {
            Step::Take(number) => Self::take(&mut state, number),
            Step::ReadLog(number) => {
                let frames = state.frames();
                if let Server::Owner { read, .. } | Server::Reserve { read } = &mut state.servers[number] {
                    *read = Some(frames);
                }
            }
            Step::Receive(number) => {
                let Server::Owner { read, transaction, .. } = &mut state.servers[number] else { return None };
                if read.is_some_and(|read| state.acknowledged < read) {
                    state.acknowledged += 1;
                } else {
                    *transaction = Transaction::Fenced;
                }
            }
            Step::Append(number) => self.append(&mut state, number),
            Step::Replicate => state.replicated += 1,
            Step::Committed(number) => Self::committed(&mut state, number),
            Step::GiveUp(number) if self.keeps(Rule::GivingUpEndsOwnership) => {
                state.servers[number] = RESERVE;
            }
            Step::GiveUp(number) => Self::committed(&mut state, number),
            Step::Die(number) => state.servers[number] = RESERVE,
            Step::Promote => self.promote(&mut state),
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(EACH_ONCE, |_, state: &State| {
                let sequences = state.written.iter().filter_map(|written| match written {
                    Written::Frame { sequence, .. } => Some(*sequence),
                    Written::Taken { .. } => None,
                });
                sequences.eq(1..=state.written.iter().filter(|w| matches!(w, Written::Frame { .. })).count())
            }),
            Property::always(ONE_ORDER, |_, state: &State| {
                let epochs = state.written.iter().scan(0, |current, written| {
                    let follows = match *written {
                        Written::Taken { epoch } => epoch == *current + 1,
                        Written::Frame { epoch, .. } => epoch == *current,
                    };
                    if let Written::Taken { epoch } = *written {
                        *current = epoch;
                    }
                    Some(follows)
                });
                epochs.into_iter().all(|follows| follows)
            }),
            Property::always(NOTHING_LOST, |_, state: &State| {
                let kept = state.written[..state.replicated].iter();
                kept.filter(|written| matches!(written, Written::Frame { .. })).count() >= state.acknowledged
            }),
            Property::always(OWNERS_KNOW, |_, state: &State| {
                state.servers.iter().all(|server| match *server {
                    Server::Owner { epoch, read: Some(read), transaction: Transaction::None } => {
                        epoch != state.epoch() || read == state.frames()
                    }
                    Server::Owner { .. } | Server::Taking { .. } | Server::Reserve { .. } => true,
                })
            }),
            Property::sometimes(GOES_ON, |_, state: &State| {
                let by = |wanted| {
                    let of_it = move |written: &Written| matches!(written, Written::Frame { epoch, .. } if *epoch == wanted);
                    state.written.iter().any(of_it)
                };
                state.acknowledged == FRAMES && state.promotions > 0 && by(1) && by(2)
            }),
        ]
    }
}

const EACH_ONCE: &str = "each frame is there once, in order";
const ONE_ORDER: &str = "epochs follow each other, and an owner writes within its own";
const NOTHING_LOST: &str = "what is acknowledged is on the standby";
const OWNERS_KNOW: &str = "the owner holds all that the log has";
const GOES_ON: &str = "two owners and two machines store all frames";

#[test]
fn all_rules_together_keep_every_promise() {
    let checker = Protocol { without: None }.checker().threads(2).spawn_bfs().join();
    checker.assert_properties();
    println!("{} states, {} steps deep", checker.unique_state_count(), checker.max_depth());
    assert!(checker.unique_state_count() > 10_000, "{}", checker.unique_state_count());
}

#[test]
fn without_any_rule_a_promise_is_broken() {
    for rule in RULES {
        let protocol = Protocol { without: Some(rule) };
        let finish = HasDiscoveries::AnyFailures;
        let checker = protocol.checker().finish_when(finish).spawn_bfs().join();
        let broken = [EACH_ONCE, ONE_ORDER, NOTHING_LOST, OWNERS_KNOW]
            .into_iter()
            .find_map(|promise| checker.discovery(promise).map(|path| (promise, path)));
        let (promise, path) = broken.unwrap_or_else(|| panic!("{rule:?} is not needed"));
        println!("without {rule:?}, not so: {promise}\n  {:?}", path.into_actions());
    }
}
