//! Names of nets and credentials.

use super::report::quoted;
use super::toml_table::Entry;

/// A name that metrics, logs and URLs of the API can carry.
pub(super) fn name(entry: &Entry<'_>) -> Option<String> {
    let name = entry.text()?;
    let valid = (1..=63).contains(&name.len())
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'));
    if !valid {
        entry.fault(
            format!("{} is not a name", quoted(name)),
            "use 1 to 63 of A-Z a-z 0-9 . _ - and begin with a letter or digit",
        );
        return None;
    }
    if name == "none" {
        entry.fault("\"none\" is the label of what belongs to no net", "choose another name");
        return None;
    }
    Some(name.to_owned())
}
