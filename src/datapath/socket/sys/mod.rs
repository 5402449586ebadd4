//! The only unsafe code of the program: system calls that no library offers in the form that a
//! worker needs, the memory layouts that they take, and where large blocks of memory come from.

#[allow(unsafe_code)]
pub(in crate::datapath) mod address;
#[allow(unsafe_code)]
pub(in crate::datapath) mod batch;
#[allow(unsafe_code)]
pub(in crate::datapath) mod bpf;
#[allow(unsafe_code)]
pub(in crate::datapath) mod epoll_wait;
#[allow(unsafe_code)]
pub(in crate::datapath) mod large_blocks;
#[allow(unsafe_code)]
pub(in crate::datapath) mod options;
#[allow(unsafe_code)]
pub(in crate::datapath) mod shared_memory;
