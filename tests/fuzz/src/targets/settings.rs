//! What an operator writes.

use std::path::Path;
use std::sync::LazyLock;

use waypost_server::config::{Config, Flags};

use crate::Fed;

/// The server's file of settings.
pub(super) fn config(bytes: &[u8]) -> Fed {
    static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(|| tempfile::tempdir().unwrap());
    let load = |name: &str, content: &[u8]| {
        let path = FOLDER.path().join(name);
        std::fs::write(&path, content).unwrap();
        load(&path)
    };
    let config = match load("given.toml", bytes) {
        Ok(config) => config,
        Err(why) => {
            assert!(!why.is_empty());
            return Fed::Refused;
        }
    };
    let text = config.to_toml().expect("what was UTF-8 still is");
    assert_eq!(load("printed.toml", text.as_bytes()).as_ref(), Ok(&config));
    Fed::Taken
}

fn load(path: &Path) -> Result<Config, String> {
    Config::load(&Flags::default(), Some(path), []).map_err(|error| error.to_string())
}
