//! The files of `deploy/wireguard`, run as they are but for keys and interface names.
//!
//! Needs root, wireguard-tools, and the kernel's WireGuard or wireguard-go.

use std::fs;
use std::path::Path;
use std::process::{self, Command};

use crate::harness::{
    Namespace, Network, PASSWORD, Packet, Peer, Relay, exchange, left_out, request,
};

const CONFIGURATION: &str = include_str!("../../deploy/wireguard/pnet-nat.toml");
const EDGE: &str = include_str!("../../deploy/wireguard/edge.conf");
const CLIENT: &str = include_str!("../../deploy/wireguard/client.conf");

/// Whether there is what it takes to bring a tunnel up.
fn can_tunnel() -> bool {
    let missing = ["wg", "wg-quick"].into_iter().find(|tool| which(tool).is_none());
    let kernel = Path::new("/sys/module/wireguard").exists();
    let missing =
        missing.or((!kernel && which("wireguard-go").is_none()).then_some("wireguard-go"));
    if let Some(tool) = missing {
        left_out(&format!("{tool}, for a WireGuard tunnel"));
    }
    missing.is_none()
}

fn which(tool: &str) -> Option<()> {
    let found = Command::new("sh").args(["-c", &format!("command -v {tool}")]).output().unwrap();
    found.status.success().then_some(())
}

/// A private key and its public key.
fn keys(network: &Network) -> (String, String) {
    let private = network.edge.output(&["wg", "genkey"]).trim().to_owned();
    let public = network.edge.output(&["sh", "-c", &format!("echo {private} | wg pubkey")]);
    (private, public.trim().to_owned())
}

/// One end of the tunnel, taken down when dropped: wireguard-go would outlive the namespace.
struct End<'a> {
    namespace: &'a Namespace,
    interface: String,
}

impl<'a> End<'a> {
    fn up(namespace: &'a Namespace, place: &str, configuration: &str, folder: &Path) -> Self {
        // wireguard-go keeps a control socket by the interface's name, for all namespaces.
        let interface = format!("{place}{}", process::id());
        let path = folder.join(&interface).with_extension("conf");
        fs::write(&path, configuration).unwrap();
        namespace.output(&["wg-quick", "up", path.to_str().unwrap()]);
        Self { namespace, interface }
    }
}

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.namespace.ip(&format!("link delete {}", self.interface));
    }
}

#[test]
fn only_the_tunnel_shows_on_the_internet() {
    let Some(network) = Network::build() else { return };
    if !can_tunnel() {
        return;
    }
    let files = tempfile::tempdir().unwrap();
    let (edge, client) = (keys(&network), keys(&network));
    let fill = |text: &str| {
        text.replace("EDGE_PRIVATE_KEY", &edge.0)
            .replace("EDGE_PUBLIC_KEY", &edge.1)
            .replace("CLIENT_PRIVATE_KEY", &client.0)
            .replace("CLIENT_PUBLIC_KEY", &client.1)
    };
    let _ends = [
        End::up(&network.edge, "e", &fill(EDGE), files.path()),
        End::up(&network.internet, "c", &fill(CLIENT), files.path()),
    ];

    network.at_the_edge(|| {
        let relay = Relay::start(CONFIGURATION, network.place("").admin, None);
        let node = network.node(4);
        let line = network.internet.capture();

        let engineer = network.client("10.99.0.2");
        let inside = network.public("10.99.0.1", 4);
        exchange(&engineer, inside, &node, 4);

        let stranger = network.client("198.51.100.7");
        for address in ["198.51.100.1", "10.99.0.1"] {
            stranger.send(network.public(address, 4), &request(4));
        }
        // What comes later has not overtaken it.
        exchange(&engineer, inside, &node, 4);
        assert_eq!((node.waiting(), stranger.waiting()), (None, None));

        let sealed = line.end().iter().filter(|packet| is_sealed(packet, &stranger)).count();
        assert!(sealed > 0, "the tunnel was used");
        relay.expect_drops(&[]);
        relay.finish();
    });
}

/// Whether a packet crossed the Internet for the tunnel; then it shows nothing of what it carries.
fn is_sealed(packet: &Packet, stranger: &Peer) -> bool {
    let Packet::Udp { from, to, octets } = packet else { return false };
    let on_the_line = to.ip().to_string() == "198.51.100.1" && *from != stranger.address();
    if on_the_line {
        assert_eq!(to.port(), 51820);
        assert!(!octets.windows(8).any(|octets| octets == PASSWORD), "a password in clear");
    }
    on_the_line
}
