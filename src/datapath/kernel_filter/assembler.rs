//! Classic BPF programs in the making: what the kernel refuses on a socket before it is queued.

use std::hint;
use std::io;

use libc::{BPF_JMP, BPF_K, BPF_RET};
use socket2::{SockFilter, Socket};

/// Most steps of a program, its two ends apart: a jump reaches 255 steps.
pub(in crate::datapath) const MOST_STEPS: usize = 255;

/// Where a step leads. By name until the whole program is known.
#[derive(Clone, Copy)]
pub(in crate::datapath) enum To {
    Next,
    /// So many steps behind the next one.
    Skip(u8),
    Accept,
    Refuse,
}

/// A program without its two ends: it refuses what comes to its last step and goes on from there.
///
/// Passwords may be in it, so it is wiped when it is dropped.
pub(in crate::datapath) struct Program(Vec<(u32, u32, To, To)>);

impl Program {
    pub(in crate::datapath) fn new() -> Self {
        Self(Vec::with_capacity(MOST_STEPS)) // it never moves, and so leaves nothing behind
    }

    pub(in crate::datapath) fn step(&mut self, code: u32, k: u32) {
        self.0.push((code, k, To::Next, To::Next));
    }

    /// Goes on one way where a comparison of the accumulator with `k` holds, and another where not.
    pub(in crate::datapath) fn compare(&mut self, comparison: u32, k: u32, holds: To, fails: To) {
        self.0.push((BPF_JMP | comparison | BPF_K, k, holds, fails));
    }

    /// Puts the program on a socket, in the place of another, from one datagram to the next.
    pub(in crate::datapath) fn attach(&self, socket: &Socket) -> io::Result<()> {
        let refuse = self.0.len();
        assert!(refuse <= MOST_STEPS);
        let target = |place: usize, to: To| match to {
            To::Next => 0,
            To::Skip(steps) => steps,
            To::Refuse => (refuse - place - 1) as u8,
            To::Accept => (refuse - place) as u8,
        };
        let steps = self.0.iter().enumerate().map(|(place, &(code, k, holds, fails))| {
            SockFilter::new(code as u16, target(place, holds), target(place, fails), k)
        });
        let end = |octets| SockFilter::new((BPF_RET | BPF_K) as u16, 0, 0, octets);
        let mut code = Vec::with_capacity(refuse + 2);
        code.extend(steps.chain([end(0), end(u32::MAX)]));
        let attached = socket.attach_filter(&code);
        code.fill_with(|| end(0));
        hint::black_box(&code);
        attached
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.0.fill((0, 0, To::Next, To::Next));
        hint::black_box(&self.0);
    }
}
