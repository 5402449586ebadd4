//! Programs in classic BPF that the kernel runs on datagrams before a worker wakes up.
//!
//! These modules turn the NAT table into programs. None of them has unsafe code.

pub(in crate::datapath) mod assembler;
pub(in crate::datapath) mod flood;
pub(in crate::datapath) mod request;
pub(in crate::datapath) mod reuseport;
mod rpc;
pub(in crate::datapath) mod upstream;
