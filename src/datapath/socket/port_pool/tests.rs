use std::collections::BTreeSet;
use std::net::Ipv4Addr;
use std::path::Path;
use std::thread;

use socket2::{Domain, Type};

use super::*;
use crate::config;

/// A configuration with a block from this port on and a single server beside it.
fn config(start_port: u16) -> Config {
    let (press, more) = (start_port + 200, "allow = [\"::/0\"]\nallow_without_password = true");
    let text = format!(
        "[public]\nlisten = [\"127.0.0.1\"]\n[admin]\nlisten = \"127.0.0.1:41000\"\n\
         [[udp_range_net]]\nname = \"section-1\"\nstart_port = {start_port}\n\
         subnet = \"127.9.9.0\"\nnodes = [4]\n{more}\n\
         [[server]]\nname = \"press\"\npublic_port = {press}\nnode = 7\n\
         address = \"127.9.8.7:34379\"\n{more}"
    );
    config::parse(&text, Path::new("pnet-nat.toml")).unwrap().0
}

fn ports(lent: RangeInclusive<u16>, reserved: &str) -> Arc<Ports> {
    let host = Host { lent: vec![lent], reserved: port_ranges(reserved), lowest: 1024 };
    Arc::new(Ports::of_host(host, &config(40_000)))
}

fn take_all(ports: &Arc<Ports>) -> Vec<Port> {
    std::iter::from_fn(|| ports.take().unwrap()).collect()
}

fn numbers(ports: &[Port]) -> BTreeSet<u16> {
    ports.iter().map(Port::number).collect()
}

#[test]
fn every_port_that_nothing_needs_is_taken_once() {
    let ports = ports(39_990..=40_210, "39992,40150-40159");
    let all = take_all(&ports);
    let expected = (39_990..=40_210).filter(|port| {
        !(40_000..=40_127).contains(port)
            && ![39_992, 40_200].contains(port)
            && !(40_150..=40_159).contains(port)
    });
    assert_eq!(numbers(&all), expected.collect());
    assert_eq!(numbers(&all).len(), all.len());
    let number = all[5].number();
    assert!(ports.is_taken(number));
    drop(all);
    assert!(!ports.is_taken(number));
}

#[test]
fn neither_the_admin_server_s_port_nor_those_of_nodes() {
    let lent = |range| numbers(&take_all(&ports(range, ""))).into_iter().collect::<Vec<_>>();
    assert_eq!(lent(40_999..=41_001), [40_999, 41_001]);
    assert_eq!(lent(34_376..=34_381), [34_376, 34_377, 34_380, 34_381]);
    assert_eq!(lent(1000..=1025), [1024, 1025]);
}

#[test]
fn a_host_that_lends_nothing_else() {
    let ports = ports(40_000..=40_127, "1100-40120,40140-65535");
    let others = (1024..=1099).chain(40_128..=40_139);
    assert_eq!(numbers(&take_all(&ports)), others.collect());
}

#[test]
fn another_configuration_keeps_its_ports() {
    let ports = ports(40_000..=42_000, "");
    let (old, new) = (config(40_000), config(41_500));
    ports.keep_out_of(&[&old, &new]);
    let both = numbers(&take_all(&ports));
    assert!(!both.contains(&40_001) && !both.contains(&41_501) && !both.contains(&41_700));
    ports.keep_out_of(&[&new]);
    let new = numbers(&take_all(&ports));
    assert!(new.contains(&40_001) && !new.contains(&41_501));
}

#[test]
fn workers_never_take_the_same_port() {
    let ports = ports(50_000..=50_999, "");
    let taken: Vec<_> = thread::scope(|scope| {
        let workers: Vec<_> = (0..4).map(|_| scope.spawn(|| take_all(&ports))).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    assert_eq!((taken.len(), numbers(&taken).len()), (1000, 1000));
}

#[test]
fn a_port_of_another_program_is_passed_over() {
    let udp = || Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
    let address = Ipv4Addr::new(127, 9, 9, 1);
    let bound = || {
        let other = udp();
        other.bind(&SocketAddr::from((address, 0)).into()).unwrap();
        let port = other.local_addr().unwrap().as_socket().unwrap().port();
        (other, port)
    };
    // The kernel may lend one that the configuration needs itself.
    let is_allowed = |port| ports(port..=port, "").allowed.contains(port);
    let (other, used) = std::iter::repeat_with(bound).find(|&(_, port)| is_allowed(port)).unwrap();
    let ports = ports(used..=used, "");
    let refused = ports.bind(&udp(), address.into()).unwrap_err();
    assert_eq!(refused.kind(), io::ErrorKind::AddrInUse);
    assert!(!ports.is_taken(used));
    drop(other);
    let socket = udp();
    let port = ports.bind(&socket, address.into()).unwrap();
    assert_eq!(port.number(), used);
    assert!(ports.is_taken(used));
}

#[test]
fn what_the_kernel_writes() {
    assert_eq!(port_ranges("8080,40000-40127\n"), [8080..=8080, 40_000..=40_127]);
    assert_eq!(port_ranges("\n"), []);
    let host = Host::read();
    assert!(host.lowest >= 1024 && !host.lent[0].is_empty());
}
