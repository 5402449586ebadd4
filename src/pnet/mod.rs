//! P-NET on IP (IEC PAS 62412), without I/O.

pub mod endpoint;
pub mod ip_net_table;
pub mod wire;
