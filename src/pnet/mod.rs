//! P-NET on IP (IEC PAS 62412), without I/O.

pub mod wire;
