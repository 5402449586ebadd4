//! The configuration: what `pnet-nat run`, `check` and `demo` work from.
//!
//! TOML text becomes a [`Config`] that holds nothing to check again, or [`Faults`]: all of them in
//! one run, each with its line, its key and what to do. `config/pnet-nat.toml` describes the keys. A small
//! relay can have the main ones as environment variables.
//! A client's IPNetTable, which `pnet-nat translate`, `request` and `node` work from, is read in the same way.
//!
//! The tables of the TOML are read key by key instead of by `serde`. `serde` stops at the first fault,
//! and after it nothing of the file has been checked; it also keeps no place for faults that show only
//! when several keys are compared, such as two nets that claim one port. So `toml_table` keeps the
//! line and path of each value, and a value that cannot be read counts as absent while reading goes on.

mod address;
#[cfg(test)]
mod asked;
mod changes;
mod credentials;
mod defaults;
mod environment;
mod excerpt;
mod file;
#[cfg(test)]
pub(crate) mod fixture;
mod guessable;
mod hash;
mod host;
mod ip_net_table;
mod model;
mod name;
mod net;
#[cfg(feature = "cli")]
mod new_password;
mod node_range;
mod odd;
mod overlap;
mod peek;
mod profinet_device;
mod remote_net;
mod report;
mod restart;
mod secret;
mod sections;
mod source;
mod syntax;
#[cfg(test)]
mod tests;
mod text;
mod token;
mod toml_table;

use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;

use toml::de::DeTable;

use crate::nat::{Mapping, NetId, Table};
use crate::pnet::wire::Header;

use host::Host;
use net::{Draft, PublicPort};
use report::Report;
use toml_table::Section;

#[cfg(feature = "cli")]
pub(crate) use changes::each_run;
pub(crate) use changes::runs;
pub use changes::{Changes, NotInForce};
#[cfg(feature = "cli")]
pub(crate) use defaults::ADMIN_LISTEN;
pub use environment::Environment;
#[cfg(feature = "cli")]
pub(crate) use file::shell_quoted;
#[cfg(feature = "cli")]
pub(crate) use host::source_towards;
#[cfg(feature = "cli")]
pub(crate) use ip_net_table::row_as_toml as ip_net_as_toml;
pub use ip_net_table::{Passwords, load as load_ip_net_table, parse as parse_ip_net_table};
pub use model::{
    Admin, Config, Datapath, KernelFlows, Log, NotAPrefilter, NotKernelFlows, Prefilter, Runtime,
};
#[cfg(feature = "cli")]
pub(crate) use name::is_name;
#[cfg(feature = "cli")]
pub(crate) use new_password::new_password;
pub use node_range::{NodeRange, NotANodeRange};
pub use peek::AdminPlace;
pub use report::{Fault, Faults, Warning};
pub use restart::keep_settled;
#[cfg(feature = "cli")]
pub(crate) use secret::read_password;
pub use source::{Source, TwoSources, USUAL_FILE};
pub use text::read_text;
pub use token::{NotAToken, Token};

/// Reads a configuration from text as if it were the file `path`. Does not ask this host about the
/// servers.
pub fn parse(text: &str, path: &Path) -> Result<(Config, Vec<Warning>), Faults> {
    parse_on(text, path, &host::Unknown, None)
}

fn parse_on(
    text: &str,
    path: &Path,
    host: &dyn Host,
    in_force: Option<&Table>,
) -> Result<(Config, Vec<Warning>), Faults> {
    read_document(text, path, |root| read(root, host, in_force))
}

/// What `read` makes of a text in TOML; otherwise all faults that it noted.
fn read_document<T>(
    text: &str,
    path: &Path,
    read: impl FnOnce(Section<'_>) -> Option<T>,
) -> Result<(T, Vec<Warning>), Faults> {
    let report = Report::new(path, text);
    let (document, errors) = DeTable::parse_recoverable(text);
    syntax::note_faults(&report, &errors);
    // The parser recovers after a fault, but what it then makes of the text may not be what was meant.
    let root = || read(Section::root(document.get_ref(), &report));
    let found = report.is_sound().then(root).flatten();
    report.verdict(found)
}

/// The configuration; none when there was a fault.
fn read(mut root: Section<'_>, host: &dyn Host, in_force: Option<&Table>) -> Option<Config> {
    let (place, report) = (root.place.clone(), root.report);
    let public = root.key("public", "");
    let header = sections::protocol(root.key("protocol", "").section());
    let ranges = root.key("udp_range_net", "").sections();
    let servers = root.key("server", "").sections();
    let devices = root.key("profinet_device", "").sections();
    let remote_nets = root.key("remote_net", "").sections();
    let limits = sections::limits(root.key("limits", "").section());
    let datapath = sections::datapath(root.key("datapath", "").section());
    let log = sections::log(root.key("log", "").section());
    let runtime = sections::runtime(root.key("runtime", "").section());
    let (admin, control) = sections::admin(root.key("admin", "").section());
    root.finish();

    let is_empty = |nets: &Option<Vec<Section<'_>>>| nets.as_ref().is_some_and(Vec::is_empty);
    let has_remote_nets = !is_empty(&remote_nets);
    if !has_remote_nets && [&ranges, &servers, &devices].into_iter().all(is_empty) {
        let remedy =
            "add a [[udp_range_net]], a [[server]], a [[profinet_device]] or a [[remote_net]]";
        report.fault(&place, "there is nothing to relay".into(), remedy.into());
    }
    let ranges = ranges.into_iter().flatten().map(net::udp_range_net);
    let servers = servers.into_iter().flatten().map(net::server);
    let devices = devices.into_iter().flatten().map(profinet_device::profinet_device);
    let mut drafts: Vec<Draft<'_>> = ranges.chain(servers).chain(devices).collect();
    let listeners = match drafts.is_empty() && public.is_absent() && has_remote_nets {
        true => Vec::new(), // nobody comes from outside
        false => sections::public(public.section()),
    };
    drafts.extend(remote_nets.into_iter().flatten().map(remote_net::remote_net));
    let listen: Vec<IpAddr> = listeners.iter().map(|(_, address)| *address).collect();
    overlap::refuse_overlaps(&drafts, &listen);
    overlap::warn_of_deaf_listeners(&drafts, &listeners);
    host::check(&drafts, &listen, host, in_force);
    report.is_sound().then(|| {
        let ids = (0..).map(NetId).zip(&drafts);
        let beyond = ids.filter(|(_, draft)| draft.servers_beyond_gateway);
        let beyond_gateway = beyond.map(|(id, _)| id).collect();
        let table = Arc::new(table(header, drafts));
        let files = [vec![report.file.to_owned()], report.secrets.take()].concat();
        Config {
            listen,
            table,
            beyond_gateway,
            limits,
            datapath,
            log,
            runtime,
            admin,
            control,
            files,
        }
    })
}

fn table(header: Header, drafts: Vec<Draft<'_>>) -> Table {
    let (mut nets, mut mappings) = (Vec::new(), Vec::new());
    for (id, draft) in (0..).map(NetId).zip(drafts) {
        let endpoints = draft.public_ports.values.into_iter().zip(draft.servers.values);
        let mapping = |(node_address, (public, server)): (u8, (PublicPort, _))| Mapping {
            net: id,
            node_address,
            local_address: public.address,
            public_port: public.port,
            server,
        };
        mappings.extend(draft.nodes.into_iter().zip(endpoints).map(mapping));
        nets.push(draft.net);
    }
    Table::new(header, nets, mappings)
}
