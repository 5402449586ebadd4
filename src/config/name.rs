//! Names of nets and credentials.

use super::report::quoted;
use super::toml_table::Entry;

/// A name that metrics, logs and URLs of the API can carry.
pub(super) fn name(entry: &Entry<'_>) -> Option<String> {
    let name = entry.text()?;
    if !is_well_formed(name) {
        entry.fault(
            format!("{} is not a name", quoted(name)),
            "use 1 to 63 of A-Z a-z 0-9 . _ - and begin with a letter or digit",
        );
        return None;
    }
    if name == NONE {
        entry.fault("\"none\" is the label of what belongs to no net", "choose another name");
        return None;
    }
    Some(name.to_owned())
}

/// The label of what belongs to no net.
const NONE: &str = "none";

fn is_well_formed(name: &str) -> bool {
    (1..=63).contains(&name.len())
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'))
}

/// Whether a net or a credential may have this name.
#[cfg(feature = "cli")]
pub(crate) fn is_name(name: &str) -> bool {
    is_well_formed(name) && name != NONE
}
