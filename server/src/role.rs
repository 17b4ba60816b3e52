//! What the holder of a token may do.

/// Role of a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Role {
    /// May stream into maps, query and read
    Robot,
    /// May do everything
    Admin,
}

impl Role {
    /// As it is stored and shown.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Role::Robot => "robot",
            Role::Admin => "admin",
        }
    }

    pub(crate) fn of_name(name: &str) -> Option<Self> {
        [Role::Robot, Role::Admin].into_iter().find(|role| role.name() == name)
    }
}
