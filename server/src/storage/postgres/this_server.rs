//! What a server says of itself to the others of its database.

/// Host and port of a server's two listeners, as others reach them; empty where nothing listens.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Addresses {
    pub(crate) grpc: String,
    pub(crate) http: String,
}

/// Of this server.
pub(crate) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Images that this server looks at side by side.
pub(crate) fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// This server, for people.
pub(crate) fn holder() -> String {
    format!("{}, process {}", host_name(), std::process::id())
}

/// As others know this machine.
pub(crate) fn host_name() -> String {
    std::fs::read_to_string("/proc/sys/kernel/hostname")
        .map_or_else(|_| "?".to_owned(), |name| name.trim().to_owned())
}
