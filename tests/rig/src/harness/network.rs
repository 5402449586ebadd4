//! Three network namespaces, Internet – edge – plant. They are connected, have addresses, and are
//! removed when they are dropped.
//!
//! The edge does not forward packets, so everything that crosses it went through the relay.
//! Invariant: a thread that enters a namespace also ends there. Sockets and processes that the
//! thread makes stay in the namespace.

use std::fs::{self, File};
use std::io::Write;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4};
use std::panic;
use std::process::{self, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::thread;

use nix::sched::{CloneFlags, setns};
use socket2::{Domain, Protocol, Socket, Type};

use super::pcap::packet;
use super::{Capture, Peer, Place, left_out};

/// The edge's public addresses are .1 and ::1 in the same networks.
const INTERNET: &str = "
    address add 198.51.100.7/24 dev eth0
    address add 198.51.100.8/24 dev eth0
    address add 203.0.113.7/24 dev eth0
    address add 2001:db8:1::7/64 dev eth0 nodad
    address add 2001:db8:2::7/64 dev eth0 nodad";

const EDGE: &str = "
    address add 198.51.100.1/24 dev eth0
    address add 203.0.113.1/24 dev eth0
    address add 2001:db8:1::1/64 dev eth0 nodad
    address add 2001:db8:2::1/64 dev eth0 nodad
    address add 172.17.17.254/24 dev eth1
    link set eth1 up";

/// The nodes 1 to 4 and 33, and a client in the same subnet.
const PLANT: &str = "
    address add 172.17.17.1/24 dev eth0
    address add 172.17.17.2/24 dev eth0
    address add 172.17.17.3/24 dev eth0
    address add 172.17.17.4/24 dev eth0
    address add 172.17.17.33/24 dev eth0
    address add 172.17.17.100/24 dev eth0
    route add default via 172.17.17.254 src 172.17.17.100";

/// The start port in the annotated configuration.
const START_PORT: u16 = 20000;

/// The three namespaces.
#[derive(Debug)]
pub struct Network {
    /// Clients and strangers.
    pub internet: Namespace,
    /// The relay.
    pub edge: Namespace,
    /// The nodes.
    pub plant: Namespace,
}

impl Network {
    /// Builds the namespaces. Where that is not possible, says so and returns `None`.
    pub fn build() -> Option<Self> {
        let made = Namespace::new("inet").and_then(|internet| {
            let (edge, plant) = (Namespace::new("edge")?, Namespace::new("plant")?);
            Ok(Self { internet, edge, plant })
        });
        match made {
            Ok(network) => {
                network.cable();
                Some(network)
            }
            Err(error) => {
                left_out(&format!("network namespaces, which need root and iproute2: {error}"));
                None
            }
        }
    }

    /// Runs a scenario at the edge, where the relay is.
    pub fn at_the_edge(&self, scenario: impl FnOnce() + Send) {
        self.edge.enter(scenario);
    }

    /// A server node: a socket on its Secure port in the plant.
    pub fn node(&self, node_address: u8) -> Peer {
        self.plant.peer((Ipv4Addr::new(172, 17, 17, node_address), 34379).into())
    }

    /// A client on the Internet.
    pub fn client(&self, address: &str) -> Peer {
        self.internet.peer((address.parse::<IpAddr>().unwrap(), 0).into())
    }

    /// The place of a relay at the edge, in front of the nodes, open to every client. The relay has
    /// to be started from the edge.
    pub fn place<'a>(&self, listen: &'a str) -> Place<'a> {
        Place {
            listen,
            admin: (Ipv4Addr::LOCALHOST, 9378).into(),
            start_port: START_PORT,
            subnet: Ipv4Addr::new(172, 17, 17, 0),
            allow: r#"["0.0.0.0/0", "::/0", "172.17.17.0/24"]"#,
        }
    }

    /// The public address and port of a node (R-10).
    pub fn public(&self, address: &str, node_address: u8) -> SocketAddr {
        (address.parse::<IpAddr>().unwrap(), START_PORT + u16::from(node_address)).into()
    }

    fn cable(&self) {
        let cable = |from: &Namespace, near: &str, far: &str| {
            let edge = &self.edge.name;
            from.ip(&format!("link add {near} type veth peer name {far} netns {edge}"));
        };
        cable(&self.internet, "eth0", "eth0");
        cable(&self.plant, "eth0", "eth1");
        let all = [(&self.internet, INTERNET), (&self.edge, EDGE), (&self.plant, PLANT)];
        for (namespace, _) in all {
            namespace.ip("link set lo up\nlink set eth0 up");
        }
        for (namespace, commands) in all {
            namespace.ip(commands);
        }
        // On a real line each datagram travels alone. Without this setting, several would travel as
        // one, and would be lost and counted as one.
        self.edge.ip("link set eth0 gso_max_segs 1\nlink set eth1 gso_max_segs 1");
        self.edge.enter(|| {
            for switch in ["ipv4/ip_forward", "ipv6/conf/all/forwarding"] {
                let path = format!("/proc/sys/net/{switch}");
                if fs::read_to_string(&path).unwrap().trim() != "0" {
                    fs::write(&path, "0").unwrap();
                }
            }
        });
    }
}

/// One network namespace.
#[derive(Debug)]
pub struct Namespace {
    name: String,
}

impl Namespace {
    /// Makes a namespace. Returns the reason if that is not possible.
    pub fn new(place: &str) -> Result<Self, String> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("pnet-nat-{}-{}-{place}", process::id(), NEXT.fetch_add(1, Relaxed));
        let made = Command::new("ip").args(["netns", "add", &name]).output();
        let made = made.map_err(|error| format!("ip: {error}"))?;
        if !made.status.success() {
            return Err(String::from_utf8_lossy(&made.stderr).trim_end().to_owned());
        }
        Ok(Self { name })
    }

    /// The name of the namespace, for commands that need it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Runs `there` in this namespace, on a thread of its own.
    pub fn enter<T: Send>(&self, there: impl FnOnce() -> T + Send) -> T {
        let namespace = File::open(format!("/run/netns/{}", self.name)).unwrap();
        thread::scope(|scope| {
            let thread = scope.spawn(|| {
                setns(namespace, CloneFlags::CLONE_NEWNET).unwrap();
                there()
            });
            thread.join().unwrap_or_else(|panicked| panic::resume_unwind(panicked))
        })
    }

    /// Runs commands of `ip`, one in each line.
    #[track_caller]
    pub fn ip(&self, commands: &str) {
        self.batch(&["ip", "-batch", "-"], commands);
    }

    /// Runs commands of `tc`, one in each line.
    #[track_caller]
    pub fn tc(&self, commands: &str) {
        self.batch(&["tc", "-batch", "-"], commands);
    }

    /// Loads a rule set of the kernel's packet filter.
    #[track_caller]
    pub fn nft(&self, rules: &str) {
        self.batch(&["nft", "-f", "-"], rules);
    }

    /// Runs a command and returns what it prints.
    #[track_caller]
    pub fn output(&self, command: &[&str]) -> String {
        let output = self.command(command).output().unwrap();
        assert!(output.status.success(), "{command:?}: {output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    #[track_caller]
    fn batch(&self, command: &[&str], input: &str) {
        let mut child = self.command(command).stdin(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
        assert!(child.wait().unwrap().success(), "{command:?}: {input}");
    }

    fn command(&self, command: &[&str]) -> Command {
        let mut ip = Command::new("ip");
        ip.args(["netns", "exec", &self.name]).args(command);
        ip
    }

    /// Sends a UDP datagram with any source address and port.
    pub fn forge(&self, from: SocketAddrV4, to: SocketAddrV4, octets: &[u8]) {
        self.forge_all([from], to, octets);
    }

    /// Sends a UDP datagram from each of these, as fast as it goes.
    pub fn forge_all(
        &self,
        from: impl IntoIterator<Item = SocketAddrV4> + Send,
        to: SocketAddrV4,
        octets: &[u8],
    ) {
        self.enter(|| {
            let raw = Protocol::from(nix::libc::IPPROTO_RAW);
            let socket = Socket::new(Domain::IPV4, Type::RAW, Some(raw)).unwrap();
            for from in from {
                let packet = packet(from, to, octets);
                assert_eq!(socket.send_to(&packet, &to.into()).unwrap(), packet.len());
            }
        });
    }

    /// A socket in this namespace, bound to this address.
    pub fn peer(&self, address: SocketAddr) -> Peer {
        self.enter(|| Peer::bind(address))
    }

    /// Captures every UDP and ICMP packet from now on.
    pub fn capture(&self) -> Capture {
        self.enter(Capture::start)
    }
}

impl Drop for Namespace {
    fn drop(&mut self) {
        // This also removes the namespace's cables. If the namespace remains, its name shows which
        // process made it.
        let _ = Command::new("ip").args(["netns", "delete", &self.name]).status();
    }
}
