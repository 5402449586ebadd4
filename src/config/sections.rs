//! The sections that stand once in the file: all but the nets.

use std::collections::{HashMap, HashSet};
use std::net::IpAddr;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use crate::nat::Limits;
use crate::pnet::wire::Header;

#[cfg(test)]
use super::asked::Wanted;
use super::model::{Admin, Datapath, Log, Runtime};
#[cfg(test)]
use super::model::{KernelFlows, Prefilter};
use super::toml_table::{Entry, LONGEST, Section};
use super::{address, defaults, net, secret, token};

/// A worker that would look for datagrams longer than this had better sleep.
const MOST_BUSY_POLL: Duration = Duration::from_millis(1);

/// The longest path that the kernel takes for a Unix socket.
const MOST_SOCKET_OCTETS: usize = 107;
/// In characters.
const LONGEST_TITLE: usize = 60;

/// `[public]`: the addresses to listen on, each with its place in the file.
pub(super) fn public(mut section: Section<'_>) -> Vec<(Entry<'_>, IpAddr)> {
    let entry = section.key("listen", "[\"0.0.0.0\"]").required();
    section.finish();
    let mut listen = Vec::new();
    let mut known = HashSet::new();
    // By family: the first address, and the one that stands for all.
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
                format!("{address} and {other} overlap: one of them stands for every address"),
                "list either single addresses or the one that stands for all",
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

/// `[protocol]`
pub(super) fn protocol(mut section: Section<'_>) -> Header {
    let header = section.key("header", "\"02000000\"").parse();
    section.finish();
    header.unwrap_or_default()
}

/// `[limits]`
pub(super) fn limits(mut section: Section<'_>) -> Limits {
    let max_flows = section.key("max_flows", "65536");
    let burst = section.key("wrong_password_burst", "10");
    let address_burst = section.key("wrong_password_address_burst", "5120");
    let interval = section.key("wrong_password_interval", "\"6s\"");
    section.finish();
    let interval = interval.duration(Duration::from_millis(1)..=LONGEST);
    let burst = burst.integer(1..=u16::MAX).unwrap_or(defaults::WRONG_PASSWORD_BURST);
    // With a lower bound for the address, none of its senders would reach its own bound.
    let least = u32::from(burst);
    Limits {
        max_flows: max_flows.integer(1..=net::MOST_FLOWS).unwrap_or(defaults::MAX_FLOWS),
        wrong_password_burst: burst,
        wrong_password_address_burst: address_burst
            .integer(least..=u32::MAX)
            .unwrap_or(defaults::SENDERS_OF_AN_ADDRESS * least),
        wrong_password_interval: interval.unwrap_or(defaults::WRONG_PASSWORD_INTERVAL),
    }
}

/// `[datapath]`
pub(super) fn datapath(mut section: Section<'_>) -> Datapath {
    let receive_buffer = section.key("receive_buffer", "1048576");
    let prefilter = section.key("prefilter", "\"auto\"");
    let kernel = section.key("kernel", "\"auto\"");
    let busy_poll = section.key("busy_poll", "\"50us\"");
    #[cfg(test)]
    prefilter.asks(Wanted::OneOf(Prefilter::ALL.map(Prefilter::label).to_vec()));
    #[cfg(test)]
    kernel.asks(Wanted::OneOf(KernelFlows::ALL.map(KernelFlows::label).to_vec()));
    section.finish();
    let default = Datapath::default();
    let busy_poll = busy_poll.duration(Duration::ZERO..=MOST_BUSY_POLL);
    Datapath {
        receive_buffer: receive_buffer.integer(4096..=1 << 30).unwrap_or(default.receive_buffer),
        prefilter: prefilter.parse().unwrap_or(default.prefilter),
        kernel: kernel.parse().unwrap_or(default.kernel),
        busy_poll: busy_poll.unwrap_or(default.busy_poll),
    }
}

/// `[log]`
pub(super) fn log(mut section: Section<'_>) -> Log {
    let audit_lines = section.key("audit_lines", "500");
    section.finish();
    let audit_lines = audit_lines.integer(1..=u32::MAX);
    Log { audit_lines: audit_lines.unwrap_or(Log::default().audit_lines) }
}

/// `[runtime]`
pub(super) fn runtime(mut section: Section<'_>) -> Runtime {
    let user = section.key("user", "\"pnet-nat\"");
    let workers = section.key("workers", "2");
    let pre_drain = section.key("pre_drain", "\"3s\"");
    let drain = section.key("drain", "\"5s\"");
    section.finish();
    let user = match user.is_integer() {
        true => user.integer(1..=u32::MAX - 1).map(|number| number.to_string()),
        false => user.text().map(str::to_owned),
    };
    Runtime {
        user,
        workers: workers.integer(1..=256).and_then(NonZeroUsize::new),
        pre_drain: pre_drain
            .duration(Duration::ZERO..=LONGEST)
            .unwrap_or(Runtime::default().pre_drain),
        drain: drain.duration(Duration::ZERO..=LONGEST).unwrap_or(Runtime::default().drain),
    }
}

/// `[admin]`: the server, unless it is switched off, and the path of the control socket.
pub(super) fn admin(mut section: Section<'_>) -> (Option<Admin>, Option<PathBuf>) {
    let enabled = section.key("enabled", "true").boolean().unwrap_or(true);
    let listen_entry = section.key("listen", "\"127.0.0.1:9378\"");
    let listen = address::endpoint(&listen_entry);
    let listen = listen.unwrap_or(defaults::ADMIN_LISTEN);
    let token_file = section.key("token_file", "\"secrets/admin\"");
    let token = token::token_file(&token_file);
    let open_metrics = section.key("metrics_without_token", "true");
    let reload = section.key("reload", "true");
    let control = control_socket(&section.key("control", "\"/run/pnet-nat/control.sock\""));
    let probe = section.key("probe", "true");
    let title = title(&section.key("title", "\"Dairy, north wing\""));
    section.finish();
    let beyond = !listen.ip().to_canonical().is_loopback();
    if enabled && beyond && !token_file.is_there() {
        listen_entry.fault(
            format!(
                "{listen} can be reached from other hosts, and every request would be answered"
            ),
            format!("set `token_file`, or listen on \"{}\"", defaults::ADMIN_LISTEN),
        );
    }
    let metrics_without_token = open_metrics.boolean().unwrap_or(false);
    let reload = reload.boolean().unwrap_or(false);
    let probe = probe.boolean().unwrap_or(false);
    let admin =
        enabled.then_some(Admin { listen, token, metrics_without_token, reload, probe, title });
    (admin, control)
}

/// A path relative to the folder of the configuration.
fn control_socket(entry: &Entry<'_>) -> Option<PathBuf> {
    if entry.is_absent() {
        return None;
    }
    let path = secret::path_of(entry)?;
    let octets = path.as_os_str().len();
    if octets > MOST_SOCKET_OCTETS || path.file_name().is_none() {
        entry.fault(
            format!("{path:?} cannot be the path of a Unix socket"),
            format!("name a file that the relay makes, in at most {MOST_SOCKET_OCTETS} octets"),
        );
        return None;
    }
    Some(path)
}

/// What fits into the head of a page and the tab of a browser.
fn title(entry: &Entry<'_>) -> Option<String> {
    let title = entry.text()?;
    let length = title.chars().count();
    if !(1..=LONGEST_TITLE).contains(&length) || title.chars().any(char::is_control) {
        entry.fault(
            format!("not 1 to {LONGEST_TITLE} printable characters"),
            "shorten it; the title is for the status page and its tab",
        );
        return None;
    }
    Some(title.to_owned())
}
