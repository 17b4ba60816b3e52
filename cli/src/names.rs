//! Resource names as people write them.

/// The identifier of a map given with or without its collection.
pub(crate) fn short_map(name: &str) -> &str {
    name.strip_prefix("maps/").unwrap_or(name)
}

/// The first twelve digits of a model's hash: enough to name it by.
pub(crate) fn short(name: &str) -> &str {
    let hash = name.strip_prefix("models/").unwrap_or(name);
    hash.get(..12).unwrap_or(hash)
}
