//! The passwords of a net: `[[udp_range_net.password]]`, `[[server.password]]` and
//! `[[remote_net.password]]`.

use std::collections::{HashMap, HashSet};

use crate::nat::{Credential, NetKind};

use super::guessable;
use super::name::name;
use super::secret::{device_password_file, make_password, password_file, path_of};
use super::toml_table::{Entry, Section};

/// What the file says of a net's passwords.
pub(super) struct Passwords {
    pub(super) credentials: Vec<Credential>,
    /// Requests without a password pass.
    pub(super) may_be_missing: bool,
    /// Responses without a password are dropped.
    pub(super) are_in_responses: bool,
}

impl Passwords {
    /// Those of a protocol that knows none.
    pub(super) const NONE: Self =
        Self { credentials: Vec::new(), may_be_missing: true, are_in_responses: false };
}

/// The keys of a net about passwords.
pub(super) fn passwords(section: &mut Section<'_>, kind: NetKind) -> Passwords {
    let are_in_responses = section.key("require_response_password", "false");
    // What a remote net sends has a password always.
    let may_be_missing = !kind.is_remote() && allow_without_password(section);
    let credentials = credentials(&section.key("password", ""), kind, may_be_missing);
    let are_in_responses = are_in_responses.boolean().unwrap_or(false);
    Passwords { credentials, may_be_missing, are_in_responses }
}

fn allow_without_password(section: &mut Section<'_>) -> bool {
    let entry = section.key("allow_without_password", "false");
    let allow = entry.boolean().unwrap_or(false);
    if allow {
        entry.warn(
            "requests without a password reach the plant, which PAS 7 forbids",
            "use it only while no client can send one, and keep `allow` narrow",
        );
    }
    allow
}

/// The credentials of a net: at least one, unless it allows requests without a password.
fn credentials(entry: &Entry<'_>, kind: NetKind, allow_without_password: bool) -> Vec<Credential> {
    let Some(sections) = entry.sections() else { return Vec::new() };
    if sections.is_empty() && !allow_without_password {
        // A4, PAS 7
        let net = entry.place.key.split(['[', '.']).next().unwrap_or_default();
        let or = if kind.is_remote() { "" } else { ", or `allow_without_password = true`" };
        let who = if kind.is_remote() { "the other plant's router needs" } else { "clients need" };
        entry.fault(
            format!("missing: {who} a password"),
            format!("add [[{net}.password]] with `name` and `file`{or}"),
        );
    }
    let mut names = HashSet::new();
    let read = sections.into_iter().filter_map(|section| credential(section, kind, &mut names));
    let (files, credentials): (Vec<Entry<'_>>, Vec<Credential>) = read.unzip();
    refuse_shared(&files, &credentials);
    credentials
}

fn credential<'a>(
    mut section: Section<'a>,
    kind: NetKind,
    names: &mut HashSet<String>,
) -> Option<(Entry<'a>, Credential)> {
    let name_entry = section.key("name", "\"service\"").required();
    let file = section.key("file", "\"secrets/section-1\"").required();
    // A remote net has one password for both ways.
    let device_file = (!kind.is_remote()).then(|| section.key("device_file", "\"secrets/device\""));
    section.finish();

    let name = name(&name_entry).unwrap_or_default();
    if !name.is_empty() && !names.insert(name.clone()) {
        name_entry
            .fault(format!("{name:?} is already a password of this net"), "give each its own name");
    }
    let device_password = device_file.and_then(|file| device_password_file(&file));
    let password = password_file(&file)?;
    if let Some(weakness) = guessable::weakness(&password) {
        file.warn(
            format!("a password that is easily guessed: {weakness}"),
            format!("make a random one: {}", make_password(&path_of(&file)?)),
        );
    }
    Some((file, Credential { name, password, device_password }))
}

fn refuse_shared(files: &[Entry<'_>], credentials: &[Credential]) {
    let mut first = HashMap::new();
    for (file, credential) in files.iter().zip(credentials) {
        let other = *first.entry(credential.password.octets()).or_insert(&credential.name);
        if !std::ptr::eq(other, &credential.name) {
            file.fault(
                format!("the same password as {other:?} of this net"),
                "give each its own password, or remove one",
            );
        }
    }
}
