//! PAS Figure 11: two plant sections, a local router between them, a NAT router, and a remote client.
//! Every datagram is where the IPNetTable of its sender says, with the octets that the standard asks
//! for.
//!
//! Needs root.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr};

use serde_json::Value;

use crate::harness::{
    Capture, Namespace, PASSWORD, Packet, Process, Relay, eventually, folder, left_out, pnet_nat,
};

const SECTION_1: [u8; 3] = [172, 17, 17];
const SECTION_2: [u8; 3] = [172, 17, 18];
const PUBLIC: Ipv4Addr = Ipv4Addr::new(198, 51, 100, 1);

/// The relay at the NAT router.
const ROUTER: &str = r#"
[public]
listen = ["198.51.100.1"]
[admin]
listen = "127.0.0.1:9378"
[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "172.17.17.0"
nodes = ["1-12"]
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
[[udp_range_net]]
name = "section-2"
start_port = 20200
subnet = "172.17.18.0"
servers_beyond_gateway = true
nodes = ["1-2"]
allow = ["198.51.100.0/24"]
[[udp_range_net.password]]
name = "service"
file = "secrets/section-1"
"#;

/// The client in section 1, on a machine of its own. Its local router is node 121 there.
const LOCAL: &str = r#"
node_address = 100
[[ip_net]]
id = 1
type = "IPRange"
address = "172.17.17.0"
port = 34378
router = 0
[[ip_net]]
id = 2
type = "IPRange"
address = "172.17.18.0"
port = 34378
router = 121
"#;

/// The remote client. The NAT router is node 1 of its own net.
const REMOTE: &str = r#"
node_address = 7
[[ip_net]]
id = 1
type = "IPRange"
address = "198.51.100.0"
port = 34378
router = 0
[[ip_net]]
id = 2
type = "UDPRange"
address = "198.51.100.1"
port = 20000
router = 1
use_password = true
password_file = "secrets/section-1"
[[ip_net]]
id = 3
type = "UDPRange"
address = "198.51.100.1"
port = 20200
router = 1
use_password = true
password_file = "secrets/section-1"
"#;

struct Plant {
    internet: Namespace,
    nat_router: Namespace,
    section_1: Namespace,
    workstation: Namespace,
    local_router: Namespace,
    section_2: Namespace,
}

impl Plant {
    fn build() -> Option<Self> {
        let made = || -> Result<Self, String> {
            Ok(Self {
                internet: Namespace::new("inet")?,
                nat_router: Namespace::new("nat")?,
                section_1: Namespace::new("plant1")?,
                workstation: Namespace::new("client")?,
                local_router: Namespace::new("local")?,
                section_2: Namespace::new("plant2")?,
            })
        };
        match made() {
            Ok(plant) => {
                plant.cable();
                Some(plant)
            }
            Err(error) => {
                left_out(&format!("network namespaces, which need root and iproute2: {error}"));
                None
            }
        }
    }

    fn cable(&self) {
        let Self { internet, nat_router, section_1, workstation, local_router, section_2 } = self;
        // Section 1 is a switch, into which the client and the two routers are plugged.
        section_1.ip(&format!(
            "link add br0 type bridge
             link add to_nat type veth peer name plant netns {}
             link add to_local type veth peer name plant1 netns {}
             link add to_client type veth peer name eth0 netns {}
             link set to_client master br0
             link set to_nat master br0
             link set to_local master br0
             link set lo up\nlink set br0 up\nlink set to_nat up\nlink set to_local up
             link set to_client up",
            nat_router.name(),
            local_router.name(),
            workstation.name(),
        ));
        internet.ip(&format!("link add eth0 type veth peer name wan netns {}", nat_router.name()));
        section_2
            .ip(&format!("link add eth0 type veth peer name plant2 netns {}", local_router.name()));
        let addresses = |[a, b, c]: [u8; 3], nodes: &[u8], device: &str| -> String {
            let add = |node| format!("address add {a}.{b}.{c}.{node}/24 dev {device}\n");
            nodes.iter().map(add).collect()
        };
        let nodes: Vec<u8> = (1..=12).collect();
        section_1.ip(&addresses(SECTION_1, &nodes, "br0"));
        workstation.ip("link set lo up\nlink set eth0 up");
        workstation
            .ip(&(addresses(SECTION_1, &[100], "eth0")
                + "route add 172.17.18.0/24 via 172.17.17.121"));
        section_2.ip("link set lo up\nlink set eth0 up");
        section_2
            .ip(&(addresses(SECTION_2, &[1, 2], "eth0") + "route add default via 172.17.18.121"));
        local_router.ip("link set lo up\nlink set plant1 up\nlink set plant2 up");
        local_router.ip(&(addresses(SECTION_1, &[121], "plant1")
            + &addresses(SECTION_2, &[121], "plant2")));
        local_router.enter(|| fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap());
        nat_router.ip("link set lo up\nlink set wan up\nlink set plant up");
        nat_router.ip(&(addresses(SECTION_1, &[120], "plant")
            + "address add 198.51.100.1/24 dev wan\nroute add 172.17.18.0/24 via 172.17.17.121"));
        internet.ip("link set lo up\nlink set eth0 up\naddress add 198.51.100.7/24 dev eth0");
    }
}

/// A client: its namespace and its folder with table and secrets.
struct Client<'a> {
    namespace: &'a Namespace,
    folder: tempfile::TempDir,
}

/// Where a request leads, as `translate` says.
struct Way {
    to: SocketAddr,
    next_hop: Option<u64>,
    password: bool,
}

impl<'a> Client<'a> {
    fn new(namespace: &'a Namespace, table: &str) -> Self {
        let folder = folder("");
        fs::write(folder.path().join("client.toml"), table).unwrap();
        Self { namespace, folder }
    }

    /// Asks one node, and takes its answer.
    fn ask(&self, net: u8, node: u8) {
        // The machine may be busy.
        self.json(&["request", "--timeout", "20s"], net, node);
    }

    fn json(&self, command: &[&str], net: u8, node: u8) -> Value {
        let table = self.folder.path().join("client.toml");
        let [net, node] = [net, node].map(|number| number.to_string());
        let of_node = ["--net", &net, "--node", &node, "--format", "json"];
        let arguments = [command, &["--table", table.to_str().unwrap()], &of_node].concat();
        let mut process = self.namespace.enter(|| Process::start(pnet_nat(&arguments)));
        assert_eq!(process.end(), Some(0), "{}{}", process.stdout(), process.stderr());
        let line = process.stdout();
        serde_json::from_str(line.lines().next().unwrap()).unwrap()
    }

    fn way(&self, net: u8, node: u8) -> Way {
        let told = self.json(&["translate"], net, node);
        let address: Ipv4Addr = told["address"].as_str().unwrap().parse().unwrap();
        let port = told["port"].as_u64().unwrap() as u16;
        let (next_hop, password) = (told["next_hop"].as_u64(), told["password"].as_bool().unwrap());
        Way { to: (address, port).into(), next_hop, password }
    }
}

/// The requests and responses among captured packets: the first request, and the answer to it.
#[track_caller]
fn exchange(capture: Capture) -> [(SocketAddr, SocketAddr, Vec<u8>); 2] {
    let packets = capture.end();
    let datagrams = packets.iter().map(|packet| match packet {
        Packet::Udp { from, to, octets } => (*from, *to, octets.clone()),
        other => panic!("{other:?}"),
    });
    let datagrams: Vec<_> = datagrams.collect();
    let there = datagrams.first().expect("a request").clone();
    let back = datagrams.iter().find(|(_, to, _)| *to == there.0).expect("a response").clone();
    [there, back]
}

#[test]
fn pas_figure_11_every_way_is_as_the_tables_say() {
    let Some(plant) = Plant::build() else { return };
    let passwords = folder("");
    let password = passwords.path().join("secrets/section-1");
    let nodes = |namespace: &Namespace, listen: &str, count: usize| {
        let arguments = ["node", "--listen", listen, "--password-file", password.to_str().unwrap()];
        let nodes = namespace.enter(|| Process::start(pnet_nat(&arguments)));
        eventually("the nodes are there", || {
            (nodes.stdout().lines().count() == count).then_some(())
        });
        nodes
    };
    let _section_1 = nodes(&plant.section_1, "172.17.17.1-12", 12);
    let _section_2 = nodes(&plant.section_2, "172.17.18.1-2", 2);
    plant.nat_router.enter(|| {
        let relay = Relay::start(ROUTER, "127.0.0.1:9378".parse().unwrap(), None);
        let local = Client::new(&plant.workstation, LOCAL);
        let remote = Client::new(&plant.internet, REMOTE);
        for node in 1..=12 {
            direct(&local, &plant.section_1, node);
            through_the_nat_router(&remote, 2, &plant.section_1, SECTION_1, node);
        }
        for node in 1..=2 {
            through_the_local_router(&plant, &local, node);
            through_the_nat_router(&remote, 3, &plant.section_2, SECTION_2, node);
        }
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// Method a: on the wire of the section, to the Normal port, without a password.
fn direct(client: &Client<'_>, section: &Namespace, node: u8) {
    let way = client.way(1, node);
    assert_eq!((way.to, way.next_hop, way.password), (normal(SECTION_1, node), None, false));
    let wire = section.capture();
    client.ask(1, node);
    let [request, response] = exchange(wire);
    assert_eq!((request.1, response.0), (way.to, way.to));
    check(&request.2, &[1, node], None);
    // R-37: it asks from a port of its own, so it is no known client.
    check(&response.2, &[125], None);
}

/// Method b: the same, but the local router has it in its hands.
fn through_the_local_router(plant: &Plant, client: &Client<'_>, node: u8) {
    let way = client.way(2, node);
    assert_eq!((way.to, way.next_hop, way.password), (normal(SECTION_2, node), Some(121), false));
    let (router, wire) = (plant.local_router.capture(), plant.section_2.capture());
    client.ask(2, node);
    let there = exchange(wire);
    assert_eq!(exchange(router), there, "what the router had is what came");
    let [request, response] = there;
    assert_eq!((request.1, response.0), (way.to, way.to));
    check(&request.2, &[2, node], None);
    check(&response.2, &[125], None);
}

/// Method d: to the NAT router's address and the node's public port, with the password; from there
/// to the Secure port of the node, octet for octet.
fn through_the_nat_router(
    client: &Client<'_>,
    net: u8,
    section: &Namespace,
    subnet: [u8; 3],
    node: u8,
) {
    let way = client.way(net, node);
    let start_port = if net == 2 { 20000 } else { 20200 };
    let public = SocketAddr::from((PUBLIC, start_port + u16::from(node)));
    assert_eq!((way.to, way.next_hop, way.password), (public, Some(1), true));
    let (outside, inside) = (client.namespace.capture(), section.capture());
    client.ask(net, node);
    let [[request, response], [passed, answer]] = [exchange(outside), exchange(inside)];
    assert_eq!((request.1, response.0), (public, public));
    let [a, b, c] = subnet;
    let secure = SocketAddr::from(([a, b, c, node], 34379));
    assert_eq!((passed.1, answer.0), (secure, secure));
    assert_eq!((&passed.2, &answer.2), (&request.2, &response.2), "R-8");
    check(&request.2, &[net, node], Some(PASSWORD));
    check(&response.2, &[125], Some(PASSWORD));
}

fn normal([a, b, c]: [u8; 3], node: u8) -> SocketAddr {
    ([a, b, c, node], 34378).into()
}

/// Checks header, the beginning of the route, and the password.
#[track_caller]
fn check(octets: &[u8], route: &[u8], password: Option<&[u8; 8]>) {
    assert_eq!(octets[..4], [2, 0, 0, 0], "{octets:02X?}");
    assert_eq!(octets[4..4 + route.len()], *route, "{octets:02X?}");
    let ends = octets.last_chunk() == Some(PASSWORD);
    assert_eq!(ends, password.is_some(), "{octets:02X?}");
}
