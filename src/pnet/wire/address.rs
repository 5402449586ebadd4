//! The addresses and UDP ports that the standard gives a meaning to.

/// The UDP port on which a server takes packages without a password, `p-net-local` (PAS 5.2.3, 11).
pub const NORMAL_PORT: u16 = 34378;
/// The UDP port on which a server takes packages with a password, `p-net-remote` (PAS 5.2.3, 11).
pub const SECURE_PORT: u16 = 34379;

/// The last address that a server node can have; the first is 1 (R-11, PAS 8, 10).
pub const LAST_NODE: u8 = 125;
/// Broadcast-Node-address: every node of the net (PAS 10).
pub const BNA: u8 = 126;
/// Service-Node-address: every node accepts it, as it does [`BNA`] (PAS 5.4.1.2 a).
pub const SNA: u8 = 127;
/// As the last source element: no confirmation is wanted (PAS 5.7.1.6).
pub const NCNA: u8 = 0;
