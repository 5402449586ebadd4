//! By which way a controller reaches a device in the plant.

use std::fs;
use std::net::Ipv4Addr;

use crate::harness::{Namespace, Network, PNIO_PORT};

/// The device.
pub(super) const DEVICE: Ipv4Addr = Ipv4Addr::new(172, 17, 17, 4);
/// The public port that leads to the device.
const PUBLIC_PORT: u16 = 40104;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Through {
    /// The controller is in the plant's own subnet.
    Direct,
    /// The kernel translates the public address and port into the device's.
    PortForward,
    /// The same, and the controller's address into the router's: the device needs no route.
    Masquerade,
}

impl Through {
    pub(super) const ALL: [Self; 3] = [Self::Direct, Self::PortForward, Self::Masquerade];

    /// Sets up the router.
    pub(super) fn prepare(self, network: &Network) {
        let masquerade = match self {
            Self::Direct => return,
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
    }

    /// Where the controllers are.
    pub(super) fn controllers(self, network: &Network) -> &Namespace {
        match self {
            Self::Direct => &network.edge,
            Self::PortForward | Self::Masquerade => &network.internet,
        }
    }

    /// Where they ask for the device's port 34964.
    pub(super) fn asked(self) -> String {
        match self {
            Self::Direct => format!("{DEVICE}:{PNIO_PORT}"),
            Self::PortForward | Self::Masquerade => format!("198.51.100.1:{PUBLIC_PORT}"),
        }
    }

    /// Where they ask for another port of the device, which no rule knows.
    pub(super) fn asked_at(self, port: u16) -> String {
        match self {
            Self::Direct => format!("{DEVICE}:{port}"),
            Self::PortForward | Self::Masquerade => format!("198.51.100.1:{port}"),
        }
    }
}
