//! What `init` has to know: from an option, from whoever sits at the terminal, or from what is offered.
//!
//! Without a terminal, only a sound default takes the place of an answer.

use std::fmt::{self, Display};
use std::io::{self, BufRead, Write};
use std::net::{IpAddr, Ipv4Addr};
use std::str::FromStr;

use ipnet::{IpNet, Ipv4Net};

use super::host::{self, Host};
use super::{Args, Plan};
use crate::config::{NodeRange, NotANodeRange, each_run, is_name};
use crate::pnet::wire::LAST_START_PORT;

/// A subnet of 256 addresses, by its first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Subnet(pub(super) Ipv4Addr);

#[derive(Debug, thiserror::Error)]
#[error("write an IPv4 subnet, which ends with .0: 172.17.17.0")]
pub(super) struct NotASubnet;

impl FromStr for Subnet {
    type Err = NotASubnet;

    fn from_str(text: &str) -> Result<Self, NotASubnet> {
        let address = text.strip_suffix("/24").unwrap_or(text).parse();
        address
            .ok()
            .filter(|address: &Ipv4Addr| address.octets()[3] == 0)
            .map(Self)
            .ok_or(NotASubnet)
    }
}

impl Display for Subnet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl Subnet {
    /// The addresses of nodes, as `pnet-nat node` takes them: `127.17.17.1-4,127.17.17.33`.
    pub(super) fn of_nodes(self, nodes: &Nodes) -> String {
        let [a, b, c, _] = self.0.octets();
        let runs = nodes.runs();
        runs.map(|run| format!("{a}.{b}.{c}.{run}")).collect::<Vec<_>>().join(",")
    }
}

/// Node addresses, each once: at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Nodes(Vec<u16>);

impl Nodes {
    pub(super) fn of(ranges: &[NodeRange]) -> Self {
        let mut nodes: Vec<u16> =
            ranges.iter().flat_map(|range| range.0.clone()).map(u16::from).collect();
        nodes.sort_unstable();
        nodes.dedup();
        Self(nodes)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = u16> {
        self.0.iter().copied()
    }

    /// Runs of them as people write them: `1-4`, `33`.
    pub(super) fn runs(&self) -> impl Iterator<Item = String> {
        each_run(&self.0)
    }
}

impl Display for Nodes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.runs().collect::<Vec<_>>().join(","))
    }
}

/// A network, or a single address, that clients send from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Allowed(pub(super) IpNet);

#[derive(Debug, thiserror::Error)]
#[error(
    "write a network or an address: 198.51.100.0/24, 198.51.100.7; 0.0.0.0/0 lets every IPv4 address in"
)]
pub(super) struct NotAllowed;

impl FromStr for Allowed {
    type Err = NotAllowed;

    fn from_str(text: &str) -> Result<Self, NotAllowed> {
        if let Ok(address) = text.parse::<IpAddr>() {
            return Ok(Self(address.into()));
        }
        let network: IpNet = text.parse().map_err(|_| NotAllowed)?;
        if network == network.trunc() { Ok(Self(network)) } else { Err(NotAllowed) }
    }
}

/// The name of a plant section.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Name(String);

#[derive(Debug, thiserror::Error)]
#[error("use 1 to 63 of A-Z a-z 0-9 . _ - and begin with a letter or digit; not \"none\"")]
pub(super) struct NotAName;

impl FromStr for Name {
    type Err = NotAName;

    fn from_str(text: &str) -> Result<Self, NotAName> {
        if is_name(text) { Ok(Self(text.to_owned())) } else { Err(NotAName) }
    }
}

impl Default for Name {
    fn default() -> Self {
        Self("section-1".to_owned())
    }
}

impl Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// What is offered for an answer.
enum Offer {
    None,
    /// Fits this host; only a person can tell whether it is meant.
    Hint(String),
    /// Right without a person, too.
    Default(String),
}

impl Offer {
    fn hint(offer: Option<impl ToString>) -> Self {
        offer.map_or(Self::None, |offer| Self::Hint(offer.to_string()))
    }
}

/// How an option that was left out gets its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum By {
    /// Somebody sits at the terminal.
    Asking,
    /// Somebody agreed to all that is offered.
    Consent,
    /// Nobody can be asked: only what is right without a person.
    Default,
}

/// Asks, where there is somebody to ask.
pub(super) struct Answers<R, W> {
    input: R,
    output: W,
    by: By,
    missing: Vec<&'static str>,
}

impl<R: BufRead, W: Write> Answers<R, W> {
    pub(super) fn new(input: R, output: W, by: By) -> Self {
        Self { input, output, by, missing: Vec::new() }
    }

    /// Options that have neither a value nor what could take its place, where nobody is asked.
    pub(super) fn missing(&self) -> &[&'static str] {
        &self.missing
    }

    /// None when something is missing, or when the input ends.
    pub(super) fn plan(&mut self, args: Args) -> io::Result<Option<Plan>> {
        let host = Host::this();
        if self.by == By::Asking {
            writeln!(
                self.output,
                "This host has the addresses {host}.\nEnter takes what is in brackets. Without a plant: Ctrl-C, \
                 then pnet-nat init --try\n"
            )?;
        }
        let listen = self.answer(
            args.listen,
            "--listen",
            "Address of this host that clients send to",
            || Offer::hint(host.public()),
            |text| {
                list(text, |one| one.parse::<IpAddr>().map_err(|_| "write an address: 203.0.113.5"))
            },
        )?;
        let heard = listen.clone().unwrap_or_default();
        let subnet = self.answer(
            args.subnet,
            "--subnet",
            "Subnet of the nodes",
            || Offer::hint(host.subnet(&heard)),
            str::parse::<Subnet>,
        )?;
        let nodes = self.answer(
            args.nodes,
            "--nodes",
            "Nodes that clients need, like 1-4, 33",
            || Offer::None,
            |text| list::<NodeRange, NotANodeRange>(text, str::parse),
        )?;
        let nodes = nodes.map(|nodes| Nodes::of(&nodes));
        let allow = self.answer(
            args.allow,
            "--allow",
            "Networks that clients send from, like 198.51.100.0/24",
            || Offer::None,
            |text| list::<Allowed, NotAllowed>(text, str::parse),
        )?;
        let start_port = self.answer(
            args.start_port,
            "--start-port",
            "Start port; node 3 is reached at this port + 3",
            || {
                let nodes = nodes.clone().unwrap_or(Nodes(Vec::new()));
                Offer::Default(host::free_block(&heard, &nodes).to_string())
            },
            |text| {
                let port = text.parse().ok().filter(|port| (1..=LAST_START_PORT).contains(port));
                port.ok_or_else(|| format!("write a port from 1 to {LAST_START_PORT}"))
            },
        )?;
        let name = self.answer(
            args.name,
            "--name",
            "Name of the section",
            || Offer::Default(Name::default().to_string()),
            str::parse::<Name>,
        )?;
        let whole = (listen, subnet, nodes, allow, start_port, name);
        let (Some(listen), Some(subnet), Some(nodes), Some(allow), Some(start_port), Some(name)) =
            whole
        else {
            return Ok(None);
        };
        let allow = allow.into_iter().map(|allowed| allowed.0).collect();
        let admin_port = host::admin_port();
        Ok(Some(Plan { listen, subnet, nodes, allow, start_port, name, admin_port }))
    }

    /// What was given; otherwise what is answered, until it can be read; otherwise a sound default.
    fn answer<T, E: Display>(
        &mut self,
        given: Option<T>,
        option: &'static str,
        question: &str,
        offer: impl FnOnce() -> Offer,
        parse: impl Fn(&str) -> Result<T, E>,
    ) -> io::Result<Option<T>> {
        if given.is_some() {
            return Ok(given);
        }
        let offer = offer();
        if self.by != By::Asking {
            let default = match &offer {
                Offer::Default(text) => parse(text).ok(),
                Offer::Hint(text) if self.by == By::Consent => parse(text).ok(),
                Offer::Hint(_) | Offer::None => None,
            };
            if default.is_none() {
                self.missing.push(option);
            }
            return Ok(default);
        }
        let offered = match &offer {
            Offer::Default(text) | Offer::Hint(text) => text,
            Offer::None => "",
        };
        loop {
            let brackets = if offered.is_empty() { String::new() } else { format!(" [{offered}]") };
            write!(self.output, "{question}{brackets}: ")?;
            self.output.flush()?;
            let mut line = String::new();
            if self.input.read_line(&mut line)? == 0 {
                return Ok(None);
            }
            let text = if line.trim().is_empty() { offered } else { line.trim() };
            match parse(text) {
                Ok(answer) => return Ok(Some(answer)),
                Err(why) => writeln!(self.output, "  {why}")?,
            }
        }
    }
}

/// A list with commas, blanks or both between its elements: at least one.
fn list<T, E: Display>(text: &str, parse: impl Fn(&str) -> Result<T, E>) -> Result<Vec<T>, String> {
    let elements = text.split([',', ' ']).filter(|element| !element.is_empty());
    let list: Result<Vec<T>, E> = elements.map(parse).collect();
    match list {
        Ok(list) if list.is_empty() => Err("write an answer; nothing is offered".to_owned()),
        list => list.map_err(|error| error.to_string()),
    }
}

/// The /24 around an address.
pub(super) fn subnet_of(address: Ipv4Addr) -> Subnet {
    Subnet(Ipv4Net::new_assert(address, 24).trunc().addr())
}

#[cfg(test)]
mod tests;
