//! The default of every key that has one. `tests::reference` compares them with what
//! `config/pnet-nat.toml` says.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::time::Duration;

use super::model::{Datapath, KernelFlows, Log, Prefilter, Runtime};

/// Of a net: `max_flows`.
pub(super) const NET_MAX_FLOWS: u32 = 4096;
/// Of a net: `idle_timeout`.
pub(super) const IDLE_TIMEOUT: Duration = Duration::from_secs(5 * 60);
/// A flow of a PROFINET device ends after this time without a datagram. Its calls are short, and each can
/// begin a new flow.
pub(super) const CALL_TIMEOUT: Duration = Duration::from_secs(60);
/// Of all nets: `[limits] max_flows`.
pub(super) const MAX_FLOWS: u32 = 65_536;
/// `wrong_password_burst`.
pub(super) const WRONG_PASSWORD_BURST: u16 = 10;
/// `wrong_password_address_burst` divided by `wrong_password_burst`.
pub(super) const SENDERS_OF_AN_ADDRESS: u32 = 512;
/// `wrong_password_interval`.
pub(super) const WRONG_PASSWORD_INTERVAL: Duration = Duration::from_secs(6);
/// `[admin] listen`.
pub(crate) const ADMIN_LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 9378);

impl Default for Datapath {
    fn default() -> Self {
        Self {
            receive_buffer: 1 << 20,
            prefilter: Prefilter::Auto,
            kernel: KernelFlows::Auto,
            busy_poll: Duration::ZERO,
        }
    }
}

impl Default for Log {
    fn default() -> Self {
        Self { audit_lines: 500 }
    }
}

impl Default for Runtime {
    fn default() -> Self {
        Self { user: None, workers: None, pre_drain: Duration::ZERO, drain: Duration::from_secs(5) }
    }
}
