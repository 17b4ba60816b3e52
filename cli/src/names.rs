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

/// The name of what is numbered, in a collection, given by its number alone or in full.
pub(crate) fn numbered(collection: &str, name: &str) -> String {
    let is_number = !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { format!("{collection}/{name}") } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_name_enough() {
        for (name, full) in [("1", "jobs/1"), ("jobs/1", "jobs/1"), ("", ""), ("one", "one")] {
            assert_eq!(numbered("jobs", name), full);
        }
    }
}
