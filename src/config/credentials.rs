//! The passwords of a net: `[[udp_range_net.password]]`, `[[server.password]]` and
//! `[[remote_net.password]]`.

use std::collections::{HashMap, HashSet};

use crate::nat::{Credential, NetKind};

use super::guessable;
use super::name::name;
use super::secret::{device_password_file, make_password, password_file, path_of};
use super::toml_table::{Entry, Section};

/// The credentials of a net: at least one, unless it allows requests without a password.
pub(super) fn credentials(
    entry: &Entry<'_>,
    kind: NetKind,
    allow_without_password: bool,
) -> Vec<Credential> {
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
