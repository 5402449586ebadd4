//! Builds classic BPF programs, which tell the kernel what to refuse on a socket before it is
//! queued.

use std::hint;
use std::io;

use libc::{BPF_JMP, BPF_K, BPF_RET};
use socket2::{SockFilter, Socket};

/// The most steps of a program, without the two steps at its end. A jump reaches no further than
/// 255 steps.
pub(in crate::datapath) const MOST_STEPS: usize = 255;

/// Where a step leads. The names become distances when the whole program is known.
#[derive(Clone, Copy)]
pub(in crate::datapath) enum To {
    Next,
    /// Over this number of steps, counted from the next one.
    Skip(u8),
    Accept,
    Refuse,
}

/// A program without the two steps at its end, one of which refuses and the other accepts. A
/// datagram that gets past the last step here is refused.
///
/// Passwords may be in the program, so it is wiped when it is dropped.
pub(in crate::datapath) struct Program(Vec<(u32, u32, To, To)>);

impl Program {
    pub(in crate::datapath) fn new() -> Self {
        Self(Vec::with_capacity(MOST_STEPS)) // it never moves, so no copy of a password is left
    }

    pub(in crate::datapath) fn step(&mut self, code: u32, k: u32) {
        self.0.push((code, k, To::Next, To::Next));
    }

    /// Compares the accumulator with `k`. Goes on to `holds` where the comparison holds, and to
    /// `fails` where it does not.
    pub(in crate::datapath) fn compare(&mut self, comparison: u32, k: u32, holds: To, fails: To) {
        self.0.push((BPF_JMP | comparison | BPF_K, k, holds, fails));
    }

    /// Attaches the program to a socket. It replaces another program between two datagrams.
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
