//! The last command from the server, and how long it is valid.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use waypost_proto::v1;

/// A command to the wheels. The default is to stop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// Speed ahead, in m/s.
    pub forward_m_s: f64,
    /// Turn to the left, in rad/s.
    pub turn_rad_s: f64,
}

/// The last command, and when it came.
#[derive(Debug, Default)]
pub(super) struct LastCommand {
    command: Option<(v1::VelocityCommand, Instant)>,
    /// Number of the last one that the application read.
    obeyed: Option<u64>,
}

impl LastCommand {
    /// Keeps a command that has just arrived.
    pub(super) fn set(&mut self, command: v1::VelocityCommand) {
        self.command = Some((command, Instant::now()));
    }

    /// From now on, a stop.
    pub(super) fn forget(&mut self) {
        self.command = None;
    }

    /// The command if it is still valid, which then counts as obeyed; otherwise a stop.
    pub(super) fn obey(&mut self) -> Command {
        let valid = self.command.as_ref().and_then(|(command, since)| {
            let valid = Duration::from_nanos(u64::try_from(command.valid_ns).unwrap_or(0));
            (since.elapsed() < valid).then_some(*command)
        });
        let Some(v1::VelocityCommand { number, forward_m_s, turn_rad_s, valid_ns: _ }) = valid else {
            return Command::default();
        };
        self.obeyed = Some(number);
        Command { forward_m_s, turn_rad_s }
    }

    /// Number of the last command that the application read.
    pub(super) fn obeyed(&self) -> Option<u64> {
        self.obeyed
    }
}

pub(super) fn lock(last: &Mutex<LastCommand>) -> MutexGuard<'_, LastCommand> {
    last.lock().unwrap_or_else(PoisonError::into_inner)
}
