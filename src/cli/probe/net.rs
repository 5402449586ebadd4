//! The checks of a net: its interface, its route, and whether its clients' addresses can be heard.

use std::io;
use std::net::{IpAddr, SocketAddr};

use ipnet::IpNet;

use super::host::Interface;
use crate::probe::Check;

/// The way to the servers of a net.
pub(super) struct Way<'a> {
    /// The net's name.
    pub(super) net: &'a str,
    pub(super) servers: Vec<SocketAddr>,
    /// They may be reached by a gateway.
    pub(super) is_beyond_gateway: bool,
    pub(super) interfaces: &'a [Interface],
    /// The address from which datagrams to the first server leave.
    pub(super) source: io::Result<IpAddr>,
}

impl Way<'_> {
    /// Whether an interface is in the subnet of the servers, and whether it is up.
    pub(super) fn interface(&self) -> Option<Check> {
        const CHECK: &str = "interface";
        let near = self.servers.iter().filter(|server| self.interface_of(server.ip()).is_some());
        let (near, all) = (near.count(), self.servers.len());
        let first = self.servers.first()?.ip();
        let found = self.servers.iter().find_map(|server| self.interface_of(server.ip()));
        let Some((interface, address)) = found else {
            if self.is_beyond_gateway {
                return None;
            }
            let text = format!("no interface of this router is in the subnet of {first}");
            let remedy = "correct the address, or give the plant's interface an address in that subnet; if a \
                          gateway leads there, set `servers_beyond_gateway = true`";
            return Some(Check::bad(CHECK, self.net, text).remedy(remedy));
        };
        let Interface { name, is_up, has_link, .. } = interface;
        Some(match (is_up, has_link) {
            (false, _) => {
                Check::bad(CHECK, self.net, format!("{name} has {address}, and is switched off"))
                    .remedy(format!("ip link set {name} up"))
            }
            (true, false) => {
                Check::bad(CHECK, self.net, format!("{name} has {address}, and no link"))
                    .remedy("check its cable and the switch at the other end")
            }
            _ if near < all => {
                let text = format!(
                    "{name} has {address}, in which {} of {all} servers are not",
                    all - near
                );
                Check::doubtful(CHECK, self.net, text)
                    .remedy("give the interface the length of the plant's subnet, as a rule /24")
            }
            _ => Check::good(CHECK, self.net, format!("{name} has {address} and is up")),
        })
    }

    /// Where datagrams to the servers leave.
    pub(super) fn route(&self) -> Option<Check> {
        const CHECK: &str = "route";
        let first = self.servers.first()?.ip();
        let source = match &self.source {
            Ok(source) => *source,
            Err(error) => {
                let text = format!("no route leads to {first}: {error}");
                let remedy = "correct the address, or bring up the interface towards the plant";
                return Some(Check::bad(CHECK, self.net, text).remedy(remedy));
            }
        };
        let leaves = self.interfaces.iter().find(|it| has_address(it, source));
        let leaves = leaves.map_or("an unknown interface", |interface| &interface.name);
        let text = format!("by {leaves}, from {source}");
        let near = self.interface_of(first).map(|(interface, _)| interface);
        Some(match near {
            // A host's own address is reached by loopback.
            Some(near) if near.name == leaves || has_address(near, first) => {
                Check::good(CHECK, self.net, text)
            }
            _ if self.is_beyond_gateway => {
                Check::good(CHECK, self.net, format!("{text}, to a gateway, as is allowed"))
            }
            _ => {
                let text = format!("requests to {first} leave {text}, with their passwords");
                let remedy = "correct the address, or bring up the interface towards the plant";
                Check::bad(CHECK, self.net, text).remedy(remedy)
            }
        })
    }

    /// The interface in whose network an address is, with its own address there.
    fn interface_of(&self, server: IpAddr) -> Option<(&Interface, &IpNet)> {
        self.interfaces.iter().find_map(|interface| {
            let network = interface.addresses.iter().find(|network| network.contains(&server))?;
            Some((interface, network))
        })
    }
}

fn has_address(interface: &Interface, address: IpAddr) -> bool {
    interface.addresses.iter().any(|own| own.addr() == address)
}

/// Whether clients of `allow` can reach an address that is listened on.
pub(super) fn allow(net: &str, allow: &[IpNet], listen: &[IpAddr]) -> Check {
    const CHECK: &str = "allow";
    let heard = |is_ipv4: bool| listen.iter().any(|address| address.is_ipv4() == is_ipv4);
    let deaf: Vec<_> = allow
        .iter()
        .filter(|network| !heard(network.addr().is_ipv4()))
        .map(IpNet::to_string)
        .collect();
    if deaf.is_empty() {
        let networks: Vec<_> = allow.iter().take(4).map(IpNet::to_string).collect();
        let more =
            if allow.len() > 4 { format!(" and {} more", allow.len() - 4) } else { String::new() };
        return Check::good(CHECK, net, format!("lets in {}{more}", networks.join(", ")));
    }
    let text = format!("nobody of {} can reach an address of `[public] listen`", deaf.join(", "));
    let remedy =
        "add \"0.0.0.0\" for IPv4 or \"::\" for IPv6, or one address of this host, to `listen`";
    let check = if deaf.len() == allow.len() { Check::bad } else { Check::doubtful };
    check(CHECK, net, text).remedy(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::Verdict;

    fn interface(name: &str, address: &str, is_up: bool, has_link: bool) -> Interface {
        let addresses = vec![address.parse().unwrap()];
        Interface { name: name.into(), is_up, has_link, addresses }
    }

    fn way(
        plant: Interface,
        source: io::Result<&str>,
        is_beyond_gateway: bool,
    ) -> [Option<(Verdict, String)>; 2] {
        let interfaces = [interface("wan0", "203.0.113.5/24", true, true), plant];
        let servers = [4, 33].map(|last| SocketAddr::from(([172, 17, 17, last], 34379))).to_vec();
        let source = source.map(|source| source.parse().unwrap());
        let way =
            Way { net: "section-1", servers, is_beyond_gateway, interfaces: &interfaces, source };
        [way.interface(), way.route()].map(|check| check.map(|check| (check.verdict, check.text)))
    }

    #[test]
    fn an_interface_in_the_subnet_that_is_up_is_good() {
        let [interface, route] =
            way(interface("plant0", "172.17.17.250/24", true, true), Ok("172.17.17.250"), false);
        assert_eq!(
            interface,
            Some((Verdict::Good, "plant0 has 172.17.17.250/24 and is up".into()))
        );
        assert_eq!(route, Some((Verdict::Good, "by plant0, from 172.17.17.250".into())));
    }

    #[test]
    fn an_interface_that_is_down_is_named_and_so_is_the_way_that_requests_take() {
        let [interface, route] =
            way(interface("plant0", "172.17.17.250/24", false, false), Ok("203.0.113.5"), false);
        let text = "plant0 has 172.17.17.250/24, and is switched off";
        assert_eq!(interface, Some((Verdict::Bad, text.into())));
        let text = "requests to 172.17.17.4 leave by wan0, from 203.0.113.5, with their passwords";
        assert_eq!(route, Some((Verdict::Bad, text.into())));
    }

    #[test]
    fn a_cable_that_is_out_a_short_network_and_no_route_are_told() {
        let [found, _] =
            way(interface("plant0", "172.17.17.250/24", true, false), Ok("172.17.17.250"), false);
        assert_eq!(found.unwrap().1, "plant0 has 172.17.17.250/24, and no link");
        let [found, _] =
            way(interface("plant0", "172.17.17.1/28", true, true), Ok("172.17.17.1"), false);
        assert_eq!(
            found.unwrap(),
            (
                Verdict::Doubtful,
                "plant0 has 172.17.17.1/28, in which 1 of 2 servers are not".into()
            )
        );
        let error = Err(io::Error::from_raw_os_error(libc::ENETUNREACH));
        let [interface, route] =
            way(interface("plant0", "172.71.17.250/24", true, true), error, false);
        assert_eq!(interface.unwrap().0, Verdict::Bad);
        assert!(route.unwrap().1.starts_with("no route leads to 172.17.17.4"));
    }

    #[test]
    fn a_gateway_is_good_where_it_is_meant() {
        let plant = interface("plant0", "172.71.17.250/24", true, true);
        let [interface, route] = way(plant, Ok("203.0.113.5"), true);
        assert_eq!(interface, None);
        assert_eq!(route.unwrap().0, Verdict::Good);
    }

    #[test]
    fn clients_of_a_family_that_nothing_listens_to_are_told_of() {
        let networks = ["198.51.100.0/24", "2001:db8::/32"].map(|network| network.parse().unwrap());
        let (v4, v6): (IpAddr, IpAddr) = ([0; 4].into(), [0u16; 8].into());
        assert_eq!(allow("n", &networks, &[v4, v6]).verdict, Verdict::Good);
        assert_eq!(allow("n", &networks, &[v4]).verdict, Verdict::Doubtful);
        let check = allow("n", &networks[..1], &[v6]);
        assert_eq!(check.verdict, Verdict::Bad);
        assert!(check.text.contains("nobody of 198.51.100.0/24 can reach"), "{}", check.text);
    }
}
