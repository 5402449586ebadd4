//! Programs that the kernel runs on datagrams before a worker wakes up: classic BPF.
//!
//! A module turns the NAT table into a program; none of them has unsafe code.

pub(in crate::datapath) mod assembler;
pub(in crate::datapath) mod flood;
pub(in crate::datapath) mod request;
pub(in crate::datapath) mod reuseport;
pub(in crate::datapath) mod upstream;
