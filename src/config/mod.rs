//! The configuration: what `pnet-nat run`, `check` and `demo` work from.
//!
//! TOML text becomes a [`Config`] that holds nothing to check again, or [`Faults`]: all of them in
//! one run, each with its line, its key and what to do. `config/pnet-nat.toml` describes the keys.

mod address;
mod changes;
mod credentials;
mod excerpt;
mod file;
#[cfg(test)]
pub(crate) mod fixture;
mod guessable;
mod host;
mod model;
mod net;
mod node_range;
mod odd;
mod overlap;
mod report;
mod restart;
mod secret;
mod syntax;
#[cfg(test)]
mod tests;
mod token;
mod toml_table;

use std::collections::{HashMap, HashSet};
use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use toml::de::DeTable;

use crate::nat::{Limits, Mapping, NetId, Table};
use crate::pnet::wire::Header;

use file::FileError;
use host::{Host, ThisHost};
use net::Draft;
use report::Report;
use syntax::{Advice, Syntax};
use toml_table::{Entry, LONGEST, Section};

pub(crate) use changes::runs;
pub use changes::{Changes, NotInForce};
pub use model::{Admin, Config, NotAPrefilter, Prefilter, Runtime};
pub use node_range::{NodeRange, NotANodeRange};
pub use report::{Fault, Faults, Warning};
pub use restart::keep_settled;
#[cfg(feature = "cli")]
pub(crate) use secret::read_password;
pub use token::{NotAToken, Token};

/// A worker that looks for datagrams longer than that would rather sleep.
const MOST_BUSY_POLL: Duration = Duration::from_millis(1);
/// A configuration may have so many octets: more than a server for each port takes.
const MOST_OCTETS: u64 = 16 << 20;
/// Unless it is set, an address may send as many wrong passwords as so many of its ports.
const SENDERS_OF_AN_ADDRESS: u32 = 512;

/// Reads a configuration file and the password files that it names, and asks this host about the
/// servers.
pub fn load(path: &Path) -> Result<(Config, Vec<Warning>), Faults> {
    parse_on(&read_text(path)?, path, &ThisHost, None)
}

/// The same for a relay that has this table in force: this host is asked about other servers alone.
pub fn load_again(path: &Path, in_force: &Table) -> Result<(Config, Vec<Warning>), Faults> {
    parse_on(&read_text(path)?, path, &ThisHost, Some(in_force))
}

/// The text of a configuration file.
pub fn read_text(path: &Path) -> Result<String, Faults> {
    let unreadable = |line, problem, remedy: &str| {
        let (file, key, remedy) = (path.to_owned(), String::new(), remedy.to_owned());
        Faults(vec![Fault { file, line, key, problem, remedy, excerpt: None, passes: false }])
    };
    let cannot_be_read = |error: FileError| {
        let remedy = match error.is_absent() {
            true => "name a configuration file that pnet-nat may read with --config".into(),
            false => error.remedy(path),
        };
        unreadable(None, error.to_string(), &remedy)
    };
    let mut octets = Vec::new();
    let (file, _) = file::open(path).map_err(cannot_be_read)?;
    let read = file.take(MOST_OCTETS + 1).read_to_end(&mut octets);
    read.map_err(|error| cannot_be_read(error.into()))?;
    if octets.len() as u64 > MOST_OCTETS {
        let problem = format!("has more than {} MiB", MOST_OCTETS >> 20);
        return Err(unreadable(
            None,
            problem,
            "name a configuration; 65,535 servers fit into less",
        ));
    }
    if let Some(encoding) = utf_16(&octets) {
        let remedy = format!("save the file as UTF-8; `iconv -f {encoding} -t UTF-8` converts it");
        return Err(unreadable(Some(1), "is UTF-16 text".into(), &remedy));
    }
    String::from_utf8(octets).map_err(|err| {
        let sound = &err.as_bytes()[..err.utf8_error().valid_up_to()];
        let line = 1 + sound.iter().filter(|&&octet| octet == b'\n').count();
        unreadable(Some(line), "not UTF-8 text".into(), "save the file as UTF-8")
    })
}

/// As some editors of Windows save a text: with a mark at its beginning, or every second octet zero.
fn utf_16(octets: &[u8]) -> Option<&'static str> {
    match octets {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => Some("UTF-16"),
        [first, 0, second, 0, ..] if *first != 0 && *second != 0 => Some("UTF-16LE"),
        [0, first, 0, second, ..] if *first != 0 && *second != 0 => Some("UTF-16BE"),
        _ => None,
    }
}

/// Where the admin server listens, unless the configuration says otherwise.
const ADMIN_PORT: u16 = 9378;

/// `[runtime] user` of a configuration's text, as far as it can be read: whose rights the rest is to be
/// read with. What is wrong with it, [`parse`] tells.
pub fn user(text: &str) -> Option<String> {
    let (document, _) = DeTable::parse_recoverable(text);
    let runtime = document.get_ref().get("runtime")?.get_ref().as_table()?;
    let user = runtime.get("user")?.get_ref();
    let number = || Some(user.as_integer()?.as_str().to_owned());
    user.as_str().map(str::to_owned).or_else(number)
}

/// Where `[admin]` of a configuration's text has the admin server, as far as it can be read: for who
/// asks a relay that runs, whatever else is wrong with the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdminPlace {
    /// Whether there is one.
    pub enabled: bool,
    /// Where it listens.
    pub listen: SocketAddr,
    /// The file with its token, relative to the configuration.
    pub token_file: Option<PathBuf>,
}

impl Default for AdminPlace {
    fn default() -> Self {
        let listen = (Ipv4Addr::LOCALHOST, ADMIN_PORT).into();
        Self { enabled: true, listen, token_file: None }
    }
}

/// See [`AdminPlace`].
pub fn admin_place(text: &str) -> AdminPlace {
    let usual = AdminPlace::default();
    let (document, _) = DeTable::parse_recoverable(text);
    let admin = document.get_ref().get("admin").and_then(|admin| admin.get_ref().as_table());
    let value = |key: &str| Some(admin?.get(key)?.get_ref());
    let text = |key: &str| value(key).and_then(|value| value.as_str());
    let listen = text("listen").and_then(|listen| listen.parse().ok());
    AdminPlace {
        enabled: value("enabled").and_then(|enabled| enabled.as_bool()).unwrap_or(usual.enabled),
        listen: listen.unwrap_or(usual.listen),
        token_file: text("token_file").map(PathBuf::from),
    }
}

/// Reads a configuration from text, as if it stood in the file `path`, on a host of which nothing is
/// known.
pub fn parse(text: &str, path: &Path) -> Result<(Config, Vec<Warning>), Faults> {
    parse_on(text, path, &host::Unknown, None)
}

fn parse_on(
    text: &str,
    path: &Path,
    host: &dyn Host,
    in_force: Option<&Table>,
) -> Result<(Config, Vec<Warning>), Faults> {
    let report = Report::new(path, text);
    let (document, errors) = DeTable::parse_recoverable(text);
    note_syntax(&report, &errors);
    // Values of a text that is only half understood would be judged wrongly.
    let root = || read(Section::root(document.get_ref(), &report), host, in_force);
    let config = report.is_sound().then(root).flatten();
    report.verdict(config)
}

/// Notes where the text is no TOML, and what to do where that can be told.
fn note_syntax(report: &Report<'_>, errors: &[toml::de::Error]) {
    if errors.is_empty() {
        return;
    }
    let syntax = Syntax::of(&report.lines);
    let mut advised = HashSet::new();
    for (number, error) in errors.iter().enumerate() {
        let offset = error.span().map_or(0, |span| span.start);
        let line = report.line(offset);
        // What the parser makes of the rest of such a line helps nobody.
        if syntax.follows(line, &advised) {
            continue;
        }
        let own = || syntax.advice(offset, error.message());
        let own = (number < report::MOST_TOLD).then(own).flatten();
        if own.is_some() {
            advised.insert(line);
        }
        let as_parsed = || Advice {
            key: String::new(),
            problem: error.message().replace('\n', ", "),
            remedy: "correct the TOML; keys are checked once it can be read".into(),
        };
        report.syntax_fault(offset, own.unwrap_or_else(as_parsed));
    }
}

/// The configuration, unless a fault was noted.
fn read(mut root: Section<'_>, host: &dyn Host, in_force: Option<&Table>) -> Option<Config> {
    let (place, report) = (root.place.clone(), root.report);
    let listeners = public(root.key("public", "").section());
    let header = protocol(root.key("protocol", "").section());
    let ranges = root.key("udp_range_net", "").sections();
    let servers = root.key("server", "").sections();
    let mut runtime = Runtime::default();
    let limits = limits(root.key("limits", "").section(), &mut runtime);
    read_runtime(root.key("runtime", "").section(), &mut runtime);
    let admin = admin(root.key("admin", "").section());
    root.finish();

    if let (Some([]), Some([])) = (ranges.as_deref(), servers.as_deref()) {
        let remedy = "add a [[udp_range_net]] or a [[server]]";
        report.fault(&place, "there is nothing to relay".into(), remedy.into());
    }
    let ranges = ranges.into_iter().flatten().map(net::udp_range_net);
    let servers = servers.into_iter().flatten().map(net::server);
    let drafts: Vec<Draft<'_>> = ranges.chain(servers).collect();
    let listen: Vec<IpAddr> = listeners.iter().map(|(_, address)| *address).collect();
    overlap::refuse_overlaps(&drafts, &listen);
    overlap::warn_of_deaf_listeners(&drafts, &listeners);
    host::check(&drafts, &listen, host, in_force);
    report.is_sound().then(|| {
        let table = Arc::new(table(header, drafts));
        let files = [vec![report.file.to_owned()], report.secrets.take()].concat();
        Config { listen, table, limits, runtime, admin, files }
    })
}

fn public(mut section: Section<'_>) -> Vec<(Entry<'_>, IpAddr)> {
    let entry = section.key("listen", "[\"0.0.0.0\"]").required();
    section.finish();
    let mut listen = Vec::new();
    let mut known = HashSet::new();
    // The first of each family, and the one that stands for all of it.
    let (mut first, mut all) = (HashMap::new(), HashMap::new());
    for element in entry.list() {
        let Some(address) = address::listener(&element) else { continue };
        let family = address.is_ipv4();
        let clash = if address.is_unspecified() { first.get(&family) } else { all.get(&family) };
        if !known.insert(address) {
            element.fault(format!("{address} is listed twice"), "list each address once");
            continue;
        }
        if let Some(other) = clash {
            element.fault(
                format!("{address} and {other} overlap, for one of them is every address"),
                "list either the addresses one by one or the one that is all of them",
            );
        }
        first.entry(family).or_insert(address);
        if address.is_unspecified() {
            all.insert(family, address);
        }
        listen.push((element, address));
    }
    listen
}

fn protocol(mut section: Section<'_>) -> Header {
    let header = section.key("header", "\"02000000\"").parse();
    section.finish();
    header.unwrap_or_default()
}

fn limits(mut section: Section<'_>, runtime: &mut Runtime) -> Limits {
    let max_flows = section.key("max_flows", "65536");
    let burst = section.key("wrong_password_burst", "10");
    let address_burst = section.key("wrong_password_address_burst", "5120");
    let interval = section.key("wrong_password_interval", "\"6s\"");
    let audit_lines = section.key("audit_lines", "500");
    let prefilter = section.key("prefilter", "\"auto\"");
    let busy_poll = section.key("busy_poll", "\"50us\"");
    section.finish();
    let interval = interval.duration(Duration::from_millis(1)..=LONGEST);
    runtime.audit_lines = audit_lines.integer(1..=u32::MAX).unwrap_or(runtime.audit_lines);
    runtime.prefilter = prefilter.parse().unwrap_or(runtime.prefilter);
    let busy_poll = busy_poll.duration(Duration::ZERO..=MOST_BUSY_POLL);
    runtime.busy_poll = busy_poll.unwrap_or(runtime.busy_poll);
    let wrong_password_burst = burst.integer(1..=u16::MAX).unwrap_or(10);
    // With fewer for the address, none of its senders would ever come to their own bound.
    let least = u32::from(wrong_password_burst);
    Limits {
        max_flows: max_flows.integer(1..=net::MOST_FLOWS).unwrap_or(65_536),
        wrong_password_burst,
        wrong_password_address_burst: address_burst
            .integer(least..=u32::MAX)
            .unwrap_or(SENDERS_OF_AN_ADDRESS * least),
        wrong_password_interval: interval.unwrap_or(Duration::from_secs(6)),
    }
}

fn read_runtime(mut section: Section<'_>, runtime: &mut Runtime) {
    let user = section.key("user", "\"pnet-nat\"");
    let workers = section.key("workers", "2");
    let receive_buffer = section.key("receive_buffer", "1048576");
    let drain = section.key("drain", "\"5s\"");
    section.finish();
    runtime.user = match user.is_integer() {
        true => user.integer(1..=u32::MAX - 1).map(|number| number.to_string()),
        false => user.text().map(str::to_owned),
    };
    runtime.workers = workers.integer(1..=256).and_then(NonZeroUsize::new);
    let receive_buffer = receive_buffer.integer(4096..=1 << 30);
    runtime.receive_buffer = receive_buffer.unwrap_or(runtime.receive_buffer);
    runtime.drain = drain.duration(Duration::ZERO..=LONGEST).unwrap_or(runtime.drain);
}

fn admin(mut section: Section<'_>) -> Option<Admin> {
    let enabled = section.key("enabled", "true").boolean().unwrap_or(true);
    let listen_entry = section.key("listen", "\"127.0.0.1:9378\"");
    let listen = address::endpoint(&listen_entry);
    let listen = listen.unwrap_or(SocketAddr::from(([127, 0, 0, 1], 9378)));
    let token_file = section.key("token_file", "\"secrets/admin\"");
    let token = token::token_file(&token_file);
    let open_metrics = section.key("metrics_without_token", "true");
    let reload = section.key("reload", "true");
    section.finish();
    let beyond = !listen.ip().to_canonical().is_loopback();
    if enabled && beyond && !token_file.is_there() {
        listen_entry.fault(
            format!("{listen} can be reached from other hosts, and would answer them all"),
            "set `token_file`, or listen on \"127.0.0.1:9378\"",
        );
    }
    let metrics_without_token = open_metrics.boolean().unwrap_or(false);
    let reload = reload.boolean().unwrap_or(false);
    enabled.then_some(Admin { listen, token, metrics_without_token, reload })
}

fn table(header: Header, drafts: Vec<Draft<'_>>) -> Table {
    let (mut nets, mut mappings) = (Vec::new(), Vec::new());
    for (id, draft) in (0..).map(NetId).zip(drafts) {
        let endpoints = draft.public_ports.values.into_iter().zip(draft.servers.values);
        let mapping = |(node_address, (public_port, server))| Mapping {
            net: id,
            node_address,
            public_port,
            server,
        };
        mappings.extend(draft.nodes.into_iter().zip(endpoints).map(mapping));
        nets.push(draft.net);
    }
    Table::new(header, nets, mappings)
}
