//! The annotated configuration, `config/pnet-nat.toml`: it is valid, names every key that the reader
//! knows, and tells the true defaults.

use super::*;

pub(super) const REFERENCE: &str = include_str!("../../../config/pnet-nat.toml");

pub(super) fn read(text: &str) -> Result<(Config, Vec<Warning>), Faults> {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("secrets")).unwrap();
    let names = ["section-1", "section-1-device", "press", "press-device", "plant-2"];
    for (name, last) in names.into_iter().zip(b'A'..) {
        let path = folder.path().join("secrets").join(name);
        fs::write(&path, [&b"s3cr3t-"[..], &[last]].concat()).unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
    }
    for (name, last) in [("admin", 'f'), ("admin-2", 'g')] {
        let token = folder.path().join("secrets").join(name);
        fs::write(&token, format!("0123456789abcde{last}")).unwrap();
        fs::set_permissions(&token, Permissions::from_mode(0o600)).unwrap();
    }
    parse(text, &folder.path().join("pnet-nat.toml"))
}

/// The reference with its switched-off keys switched on.
pub(super) fn switched_on() -> String {
    let line = |line: &str| match line.trim_start().strip_prefix('#') {
        Some(key) if key.starts_with(|c: char| c.is_ascii_lowercase() || c == '[') => {
            key.to_owned() + "\n"
        }
        _ => line.to_owned() + "\n",
    };
    REFERENCE.lines().map(line).collect()
}

/// The same with another value of one key, in the section whose header line this is.
pub(super) fn switched_on_with(section: &str, key: &str, value: &str) -> String {
    let (mut current, mut found) = (String::new(), false);
    let line = |line: &str| {
        let trimmed = line.trim();
        if trimmed.starts_with('[') {
            current = trimmed.trim_matches(['[', ']']).to_owned();
        }
        if current == section && trimmed.starts_with(&format!("{key} = ")) {
            found = true;
            return format!("{key} = {value}\n");
        }
        format!("{line}\n")
    };
    let text = switched_on().lines().map(line).collect();
    assert!(found, "{section}.{key}");
    text
}

#[test]
fn is_valid_and_warns_of_nothing() {
    for text in [REFERENCE, &switched_on()] {
        assert_eq!(read(text).unwrap_or_else(|faults| panic!("{faults}")).1, []);
    }
}

#[test]
fn tells_the_defaults() {
    let (told, _) = read(REFERENCE).unwrap();
    let (default, _) = super::read(SOUND).unwrap();
    assert_eq!(told.limits, default.limits);
    assert_eq!(told.datapath, default.datapath);
    assert_eq!(told.log, default.log);
    assert_eq!(format!("{:?}", told.runtime), format!("{:?}", default.runtime));
    assert_eq!(format!("{:?}", told.admin), format!("{:?}", default.admin));
    assert_eq!(told.table.header, default.table.header);
    for (told, default) in told.table.nets().iter().zip(default.table.nets()) {
        let rules = |net: &crate::nat::Net| {
            let flags = (net.require_response_password, net.allow_without_password);
            let rates = (net.max_requests, net.max_flow_requests);
            (net.idle_timeout, net.max_flows, rates, flags)
        };
        assert_eq!(rules(told), rules(default));
    }
}

/// Every section gets a key that does not exist, whose fault lists the keys that do.
#[test]
fn has_every_key() {
    let text = switched_on();
    let provoked: String = std::iter::once("unknown_key = 1\n".to_owned())
        .chain(text.lines().map(|line| match line.trim_start().starts_with('[') {
            true => format!("{line}\nunknown_key = 1\n"),
            false => format!("{line}\n"),
        }))
        .collect();
    let Err(Faults(faults)) = read(&provoked) else { panic!("unknown keys are taken") };
    assert_eq!(faults.len(), 15, "one a section: {faults:#?}");
    for fault in faults {
        let (_, keys) = fault.remedy.split_once("the keys here are ").unwrap();
        let mut expected: Vec<&str> = keys.split(", ").collect();
        expected.sort_unstable();
        let section = fault.key.replace("[0]", "").replace("unknown_key", "");
        assert_eq!(keys_of(&text, section.trim_end_matches('.')), expected, "{section}");
    }
}

/// The keys and, for the sake of nested sections, the section names directly below `section`.
fn keys_of<'t>(text: &'t str, section: &str) -> Vec<&'t str> {
    let mut current = "";
    let mut keys = std::collections::BTreeSet::new();
    for line in text.lines().map(str::trim) {
        if line.starts_with('[') {
            current = line.trim_matches(['[', ']']);
            let (parent, name) = current.rsplit_once('.').unwrap_or(("", current));
            if parent == section {
                keys.insert(name);
            }
        } else if let Some((key, _)) = line.split_once(" = ")
            && current == section
            && !line.starts_with('#')
        {
            keys.insert(key);
        }
    }
    keys.into_iter().collect()
}
