//! What the system says, read once, and given to the checks of the machine and of the nets.

use std::net::{IpAddr, SocketAddr};
use std::time::SystemTime;

use super::host::{self, Interface};
use super::{conntrack, firewall, machine, net, ports};
use crate::config::{Config, source_towards};
use crate::datapath::descriptors_needed;
use crate::nat::Mapping;
use crate::probe::Check;

/// Addresses that stand for the Internet: reserved for documentation.
const FAR: [&str; 2] = ["203.0.113.1:9", "[2001:db8::1]:9"];

/// What the system says, read once.
pub(super) struct System {
    interfaces: Vec<Interface>,
    sockets: ports::Sockets,
    port_range: Option<String>,
    reserved_ports: String,
    /// The rules of nft.
    rules: Option<serde_json::Value>,
    /// The kernel's entries of address translation.
    translated: Option<String>,
}

impl System {
    pub(super) fn read() -> Self {
        let tables = ["/proc/self/net/udp", "/proc/self/net/udp6"].map(host::read);
        let bound = tables.iter().flatten().flat_map(|table| ports::bound(table)).collect();
        let rules = host::output("nft", &["--json", "list", "ruleset"]);
        // Without this file there is no address translation, and `conntrack` would load it.
        let translates = host::read("/proc/sys/net/netfilter/nf_conntrack_count").is_some();
        let entries = || {
            host::read("/proc/self/net/nf_conntrack")
                .or_else(|| host::output("conntrack", &["-L", "-p", "udp"]))
        };
        Self {
            interfaces: host::interfaces().unwrap_or_default(),
            sockets: ports::Sockets { bound, owners: host::socket_owners() },
            port_range: host::read("/proc/sys/net/ipv4/ip_local_port_range"),
            reserved_ports: host::read("/proc/sys/net/ipv4/ip_local_reserved_ports")
                .unwrap_or_default(),
            rules: rules.and_then(|rules| serde_json::from_str(&rules).ok()),
            translated: if translates { entries() } else { Some(String::new()) },
        }
    }

    /// The checks of the machine.
    pub(super) fn machine(&self, config: &Config) -> Vec<Check> {
        let public: Vec<_> =
            config.table.mappings().iter().flat_map(|it| public(config, it)).collect();
        let relay = self.sockets.relay(&public);
        let process = relay.map_or("self".to_owned(), |pid| pid.to_string());
        let limits = host::read(&format!("/proc/{process}/limits"));
        let synchronised =
            host::output("timedatectl", &["show", "-p", "NTPSynchronized", "--value"]);
        vec![
            machine::descriptors(descriptors_needed(config), limits.as_deref(), relay.is_some()),
            machine::receive_buffer(
                config.datapath.receive_buffer,
                host::number("/proc/sys/net/core/rmem_max"),
            ),
            machine::clock(SystemTime::now(), synchronised.as_deref()),
        ]
    }

    /// The checks of a net, some of whose mappings these are.
    pub(super) fn net(&self, config: &Config, mappings: &[Mapping]) -> Vec<Check> {
        let id = mappings[0].net;
        let net = config.table.net(id);
        let servers: Vec<_> = mappings.iter().map(|mapping| mapping.server).collect();
        let way = net::Way {
            net: &net.name,
            source: source_towards(servers[0]),
            servers,
            is_beyond_gateway: config.beyond_gateway.contains(&id),
            interfaces: &self.interfaces,
        };
        let public: Vec<_> = mappings.iter().flat_map(|it| public(config, it)).collect();
        let ports: Vec<_> = public.iter().map(SocketAddr::port).collect();
        let listen = config.addresses_of(&mappings[0]);
        let interfaces = self.towards_clients(listen);
        let arriving = |address: &SocketAddr| firewall::Arriving {
            is_ipv4: address.is_ipv4(),
            port: address.port(),
            interfaces: &interfaces,
            clients: &net.allow,
        };
        let requests: Vec<_> = public.iter().map(arriving).collect();
        let mut checks: Vec<_> = [way.interface(), way.route()].into_iter().flatten().collect();
        checks.push(net::allow(&net.name, &net.allow, listen));
        checks.push(self.sockets.judge(&net.name, &public));
        checks.push(ports::ephemeral(
            &net.name,
            &ports,
            self.port_range.as_deref(),
            &self.reserved_ports,
        ));
        checks.push(firewall::judge(&net.name, self.rules.as_ref(), &requests));
        checks.push(conntrack::judge(&net.name, &ports, self.translated.as_deref()));
        checks
    }

    /// The interfaces that clients come in by: those with an address of `listen`, or with the route to the
    /// Internet.
    fn towards_clients(&self, listen: &[IpAddr]) -> Vec<String> {
        let far = FAR.iter().filter_map(|far| far.parse().ok());
        let sources: Vec<_> = far.filter_map(|far| source_towards(far).ok()).collect();
        let is_theirs = |address: IpAddr| {
            listen
                .iter()
                .any(|own| *own == address || own.is_unspecified() && sources.contains(&address))
        };
        let theirs = self.interfaces.iter().filter(|interface| {
            interface.addresses.iter().any(|address| is_theirs(address.addr()))
        });
        theirs.map(|interface| interface.name.clone()).collect()
    }
}

/// The addresses and ports at which clients reach a node.
fn public(config: &Config, mapping: &Mapping) -> Vec<SocketAddr> {
    let addresses = config.addresses_of(mapping).iter();
    addresses.map(|address| SocketAddr::new(*address, mapping.public_port)).collect()
}
