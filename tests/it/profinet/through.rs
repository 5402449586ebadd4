//! By which way a controller reaches a device in the plant.

use std::fs;
use std::net::Ipv4Addr;

use crate::harness::{Namespace, Network, PNIO_PORT, Relay};

/// The device.
pub(super) const DEVICE: Ipv4Addr = Ipv4Addr::new(172, 17, 17, 4);
/// The public port that leads to the device.
pub(super) const PUBLIC_PORT: u16 = 20104;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Through {
    /// The controller is in the plant's own subnet.
    Direct,
    /// The kernel translates the public address and port into the device's.
    PortForward,
    /// The same, and the controller's address into the router's: the device needs no route.
    Masquerade,
    /// The relay, with a `[[profinet_device]]`.
    Relay,
}

/// In front of the device.
const CONFIGURATION: &str = r#"
[public]
listen = ["198.51.100.1"]
[admin]
listen = "127.0.0.1:9378"
[runtime]
drain = "100ms"
[[profinet_device]]
name = "drive-4"
public_port = 20104
address = "172.17.17.4"
allow = ["198.51.100.0/24"]
"#;

impl Through {
    pub(super) const ALL: [Self; 4] =
        [Self::Direct, Self::PortForward, Self::Masquerade, Self::Relay];

    /// Sets up the router. The relay runs as long as its handle is kept.
    pub(super) fn prepare(self, network: &Network) -> Option<Relay> {
        let masquerade = match self {
            Self::Direct => return None,
            Self::Relay => return Some(start_relay(network)),
            Self::PortForward => "",
            Self::Masquerade => {
                "chain out { type nat hook postrouting priority srcnat; oifname eth1 masquerade; }"
            }
        };
        network.edge.nft(&format!(
            "table ip profinet {{
                chain in {{ type nat hook prerouting priority dstnat;
                    udp dport {PUBLIC_PORT} dnat to {DEVICE}:{PNIO_PORT}; }}
                {masquerade}
            }}"
        ));
        network.edge.enter(|| fs::write("/proc/sys/net/ipv4/ip_forward", "1").unwrap());
        None
    }

    /// Where the controllers are.
    pub(super) fn controllers(self, network: &Network) -> &Namespace {
        match self {
            Self::Direct => &network.edge,
            Self::PortForward | Self::Masquerade | Self::Relay => &network.internet,
        }
    }

    /// Where they ask for the device's port 34964.
    pub(super) fn asked(self) -> String {
        match self {
            Self::Direct => format!("{DEVICE}:{PNIO_PORT}"),
            Self::PortForward | Self::Masquerade | Self::Relay => {
                format!("198.51.100.1:{PUBLIC_PORT}")
            }
        }
    }

    /// Where they ask for another port of the device, which no rule knows.
    pub(super) fn asked_at(self, port: u16) -> String {
        match self {
            Self::Direct => format!("{DEVICE}:{port}"),
            Self::PortForward | Self::Masquerade | Self::Relay => format!("198.51.100.1:{port}"),
        }
    }
}

/// A relay in front of the device.
pub(super) fn start_relay(network: &Network) -> Relay {
    network.edge.enter(|| Relay::start(CONFIGURATION, "127.0.0.1:9378".parse().unwrap(), None))
}
