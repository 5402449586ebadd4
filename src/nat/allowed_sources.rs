//! The addresses from which a net's clients may send: the networks of its `allow`, without the
//! plant's own addresses.
//!
//! The look-up is a trie, so a stranger's datagram costs hardly more where the list is long. An
//! attacker who forges the address of one node could direct the answer of another node to it. So an
//! address inside the plant is allowed only by an entry of `allow` that lies in the plant's subnet
//! itself (N-4).

use std::collections::{HashMap, HashSet};
use std::net::IpAddr;
use std::sync::Arc;

use ipnet::{IpNet, Ipv4Net};
use prefix_trie::joint::map::JointPrefixMap;

use super::net::{Mapping, Net, NetKind};

/// the mask of a plant section is 255.255.255.0.
const SECTION: u8 = 24;

/// The look-up for one net: the longest network that contains an address decides.
#[derive(Debug)]
pub(super) struct Sources(JointPrefixMap<IpNet, bool>);

impl Sources {
    /// The look-ups of all nets, in their order. Nets with the same list share one.
    pub(super) fn of(nets: &[Net], mappings: &[Mapping]) -> Vec<Arc<Self>> {
        let plants = plants(nets, mappings);
        let mut made: HashMap<&[IpNet], Arc<Self>> = HashMap::new();
        let lists = nets.iter().map(|net| net.allow.as_slice());
        let of_list =
            |list| made.entry(list).or_insert_with(|| Arc::new(Self::new(list, &plants))).clone();
        lists.map(of_list).collect()
    }

    fn new(allow: &[IpNet], plants: &[IpNet]) -> Self {
        let plants = plants.iter().map(|&plant| (plant, false));
        // `allow` comes last: an entry that is just the plant's subnet allows it.
        let allow = allow.iter().map(|network| (network.trunc(), true));
        Self(plants.chain(allow).collect())
    }

    /// Whether a client may send from this address. An IPv4 address mapped into IPv6 is judged as
    /// IPv4.
    #[inline]
    pub(super) fn contains(&self, source: IpAddr) -> bool {
        let source = IpNet::from(source.to_canonical());
        self.0.get_lpm(&source).is_some_and(|(_, &allowed)| allowed)
    }
}

/// The networks of the plant: the subnet of each section, and each single server outside of them.
fn plants(nets: &[Net], mappings: &[Mapping]) -> Vec<IpNet> {
    let plant = |mapping: &Mapping| {
        let server = mapping.server.ip().to_canonical();
        match (nets[usize::from(mapping.net.0)].kind, server) {
            (NetKind::Remote { .. }, _) => None, // its servers are in another plant
            (NetKind::UdpRange { .. }, IpAddr::V4(server)) => {
                Some(IpNet::V4(Ipv4Net::new_assert(server, SECTION).trunc()))
            }
            (_, server) => Some(IpNet::from(server)),
        }
    };
    let plants: Vec<_> = mappings.iter().filter_map(plant).collect();
    // An entry of `allow` for a section also allows the single servers inside it.
    let is_section = |plant: &IpNet| plant.addr().is_ipv4() && plant.prefix_len() == SECTION;
    let sections: HashSet<IpNet> = plants.iter().copied().filter(is_section).collect();
    let in_a_section = |plant: &IpNet| {
        plant.addr().is_ipv4()
            && plant.prefix_len() > SECTION
            && sections.contains(&IpNet::new_assert(plant.addr(), SECTION).trunc())
    };
    plants.into_iter().filter(|plant| !in_a_section(plant)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn networks(texts: &[&str]) -> Vec<IpNet> {
        texts.iter().map(|text| text.parse().unwrap()).collect()
    }

    fn let_in<'a>(allow: &[&str], plants: &[&str], sources: &[&'a str]) -> Vec<&'a str> {
        let found = Sources::new(&networks(allow), &networks(plants));
        let is_in = |source: &&str| found.contains(source.parse().unwrap());
        sources.iter().copied().filter(is_in).collect()
    }

    #[test]
    fn the_networks_that_are_listed_and_no_other() {
        let allow =
            ["198.51.100.0/24", "203.0.113.7/32", "2001:db8:7::/48", "10.0.0.0/8", "10.1.0.0/16"];
        let sources = [
            "198.51.100.0",
            "198.51.100.255",
            "198.51.101.0",
            "203.0.113.7",
            "203.0.113.8",
            "10.1.2.3",
            "10.2.2.3",
            "11.0.0.0",
            "2001:db8:7::1",
            "2001:db8:8::1",
            "::ffff:10.2.2.3",
            "::ffff:11.0.0.0",
        ];
        let expected = [
            "198.51.100.0",
            "198.51.100.255",
            "203.0.113.7",
            "10.1.2.3",
            "10.2.2.3",
            "2001:db8:7::1",
            "::ffff:10.2.2.3",
        ];
        assert_eq!(let_in(&allow, &[], &sources), expected);
    }

    #[test]
    fn all_of_either_family_is_nothing_of_the_other() {
        assert_eq!(let_in(&["0.0.0.0/0"], &[], &["0.0.0.0", "255.255.255.255", "::1"]).len(), 2);
        assert_eq!(let_in(&["::/0"], &[], &["192.0.2.1", "::1", "::ffff:192.0.2.1"]), ["::1"]);
    }

    #[test]
    fn a_plant_has_no_clients_unless_it_is_named() {
        let plants = ["172.17.17.0/24", "192.0.2.7/32", "fd00::7/128"];
        let sources = [
            "172.17.17.44",
            "172.17.17.7",
            "172.17.18.44",
            "192.0.2.7",
            "192.0.2.8",
            "fd00::7",
            "fd00::8",
        ];
        let beside = ["172.17.18.44", "192.0.2.8", "fd00::8"];
        for wide in [["0.0.0.0/0", "::/0"], ["128.0.0.0/1", "fd00::/8"]] {
            assert_eq!(let_in(&wide, &plants, &sources), beside);
        }
        assert_eq!(let_in(&["172.16.0.0/12"], &plants, &sources), ["172.17.18.44"]);
        let named = |name| let_in(&["0.0.0.0/0", name], &plants, &sources)[0];
        assert_eq!(named("172.17.17.0/24"), "172.17.17.44");
        assert_eq!(named("172.17.17.7/32"), "172.17.17.7");
        assert_eq!(
            let_in(&["172.17.17.0/29", "192.0.2.7/32"], &plants, &sources),
            ["172.17.17.7", "192.0.2.7"]
        );
    }
}
