//! What the relay takes of the machine, and what the kernel drops for want of room.

use std::fmt;
use std::fs;
use std::ops::Range;

use crate::harness::{Network, Process};

/// Octets that a process may grow by: an allocator is not exact.
const SLACK: u64 = 1 << 20;
/// File descriptors that the admin server and a reload hold for a moment.
const MOMENTARY: u64 = 4;

/// Resident memory in octets, and open file descriptors, from time to time.
#[derive(Debug, Default)]
pub(crate) struct Usage(Vec<[u64; 2]>);

impl Usage {
    pub(crate) fn sample(&mut self, process: &Process) {
        let descriptors = fs::read_dir(format!("/proc/{}/fd", process.id())).unwrap().count();
        self.0.push([process.resident(), descriptors as u64]);
    }

    /// The last quarter took no more than the second one: in the first, everything is still new.
    pub(crate) fn assert_flat(&self) {
        let quarter = self.0.len() / 4;
        let (early, late) = (self.peak(quarter..2 * quarter), self.peak(3 * quarter..self.0.len()));
        assert!(late[0] <= early[0] + early[0] / 20 + SLACK, "memory grows: {self}");
        assert!(late[1] <= early[1] + MOMENTARY, "file descriptors grow: {self}");
    }

    fn peak(&self, range: Range<usize>) -> [u64; 2] {
        let samples = &self.0[range];
        [0, 1].map(|what| samples.iter().map(|sample| sample[what]).max().expect("a sample"))
    }
}

impl fmt::Display for Usage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [resident, descriptors] = self.0[self.0.len() - 1];
        let peak = self.peak(0..self.0.len());
        let mib = |octets: u64| octets as f64 / f64::from(1 << 20);
        write!(
            f,
            "{:.1} MiB (at most {:.1}), {descriptors} file descriptors (at most {})",
            mib(resident),
            mib(peak[0]),
            peak[1]
        )
    }
}

/// Datagrams that found a socket's queue full: of clients, of the relay, of nodes.
#[derive(Debug)]
pub(crate) struct Overflows([u64; 3]);

impl Overflows {
    pub(crate) fn now(network: &Network) -> Self {
        Self([&network.internet, &network.edge, &network.plant].map(|side| side.enter(overflows)))
    }

    pub(crate) fn since(&self, before: &Self) -> Self {
        Self([0, 1, 2].map(|side| self.0[side] - before.0[side]))
    }

    pub(crate) fn total(&self) -> u64 {
        self.0.iter().sum()
    }
}

impl fmt::Display for Overflows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [clients, relay, nodes] = self.0;
        write!(f, "{clients} at clients, {relay} at the relay, {nodes} at nodes")
    }
}

/// Of the calling thread's network namespace.
fn overflows() -> u64 {
    let snmp = fs::read_to_string("/proc/thread-self/net/snmp").unwrap();
    let mut udp = snmp.lines().filter_map(|line| line.strip_prefix("Udp: "));
    let (names, values) = (udp.next().unwrap(), udp.next().unwrap());
    let mut fields = names.split(' ').zip(values.split(' '));
    let (_, errors) = fields.find(|(name, _)| *name == "RcvbufErrors").unwrap();
    errors.parse().unwrap()
}
