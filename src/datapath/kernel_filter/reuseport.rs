//! Decides which worker a client belongs to.
//!
//! By default the kernel spreads datagrams over the sockets of a port by the addresses and ports of
//! both ends. A client that polls many nodes would then be known to every worker, and would use an
//! upstream port of each. This program uses only the client's address and port. So a client has one
//! worker, and one upstream port with it.

use std::io;

use nix::sys::socket::{setsockopt, sockopt};
use socket2::Socket;

/// Has the kernel give each client's datagrams to one of the `workers` sockets that share the port
/// of this one. They are numbered in the order in which they were bound.
pub(in crate::datapath) fn by_client(socket: &Socket, workers: usize) -> io::Result<()> {
    let mut program = if socket.domain()? == socket2::Domain::IPV4 {
        // The source address, and the source port where the header has no options. With options,
        // the program reads the last two octets of the options instead. These serve as well,
        // because a client's options are always the same.
        program(&[SOURCE_V4], SOURCE_PORT_V4, workers)
    } else {
        program(&SOURCE_V6, SOURCE_PORT_V6, workers)
    };
    let program = libc::sock_fprog { len: program.len() as u16, filter: program.as_mut_ptr() };
    setsockopt(socket, sockopt::AttachReusePortCbpf, &program)?;
    Ok(())
}

const SOURCE_V4: u32 = NETWORK_HEADER + 12;
const SOURCE_PORT_V4: u32 = NETWORK_HEADER + 20;
const SOURCE_V6: [u32; 4] =
    [NETWORK_HEADER + 8, NETWORK_HEADER + 12, NETWORK_HEADER + 16, NETWORK_HEADER + 20];
const SOURCE_PORT_V6: u32 = NETWORK_HEADER + 40;

/// Offsets that are added to this one count from the IP header.
const NETWORK_HEADER: u32 = libc::SKF_NET_OFF as u32;

/// Knuth's multiplicative hash: neighbouring ports go to different workers.
const SPREAD: u32 = 0x9e37_79b1;

/// A classic BPF program that computes a hash. It adds up the words, multiplies the sum by a
/// constant, adds the port and multiplies by the constant again. The result is the upper half of
/// that, modulo the number of workers.
fn program(words: &[u32], port: u32, workers: usize) -> Vec<libc::sock_filter> {
    use libc::{
        BPF_A, BPF_ABS, BPF_ADD, BPF_ALU, BPF_H, BPF_K, BPF_LD, BPF_MISC, BPF_MOD, BPF_MUL,
        BPF_RET, BPF_RSH, BPF_TAX, BPF_W, BPF_X,
    };
    let step = |code: u32, k: u32| libc::sock_filter { code: code as u16, jt: 0, jf: 0, k };
    let mut steps = vec![step(BPF_LD | BPF_W | BPF_ABS, words[0])];
    for &word in &words[1..] {
        steps.extend([
            step(BPF_MISC | BPF_TAX, 0),
            step(BPF_LD | BPF_W | BPF_ABS, word),
            step(BPF_ALU | BPF_ADD | BPF_X, 0),
        ]);
    }
    steps.extend([
        step(BPF_ALU | BPF_MUL | BPF_K, SPREAD),
        step(BPF_MISC | BPF_TAX, 0),
        step(BPF_LD | BPF_H | BPF_ABS, port),
        step(BPF_ALU | BPF_ADD | BPF_X, 0),
        step(BPF_ALU | BPF_MUL | BPF_K, SPREAD),
        step(BPF_ALU | BPF_RSH | BPF_K, 16),
        step(BPF_ALU | BPF_MOD | BPF_K, workers as u32),
        step(BPF_RET | BPF_A, 0),
    ]);
    steps
}
