//! Which UDP ports are looked at: those of servers.

use std::str::FromStr;

use anyhow::{Context, ensure};

use crate::pnet::wire::{NORMAL_PORT, SECURE_PORT};

/// A range of ports: `20001-20125`, or one port: `20200`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PortRange {
    first: u16,
    last: u16,
}

impl FromStr for PortRange {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let (first, last) = text.split_once('-').unwrap_or((text, text));
        let port = |text: &str| text.parse::<u16>().context("a port is 1 to 65535");
        let (first, last) = (port(first)?, port(last)?);
        ensure!(0 < first && first <= last, "write ports like 20001-20125, the lower one first");
        Ok(Self { first, last })
    }
}

/// A set of ports: a bit for each.
#[derive(Clone)]
pub(super) struct Ports(Box<[u64; Self::WORDS]>);

impl Ports {
    const WORDS: usize = (u16::MAX as usize + 1) / u64::BITS as usize;

    /// The Normal and the Secure port (PAS 11), and these.
    pub(super) fn of_p_net_and(ranges: &[PortRange]) -> Self {
        let mut ports = Self(Box::new([0; Self::WORDS]));
        [NORMAL_PORT, SECURE_PORT].into_iter().for_each(|port| ports.add(port));
        for &PortRange { first, last } in ranges {
            (first..=last).for_each(|port| ports.add(port));
        }
        ports
    }

    pub(super) fn add(&mut self, port: u16) {
        let (word, bit) = Self::place(port);
        self.0[word] |= bit;
    }

    pub(super) fn contains(&self, port: u16) -> bool {
        let (word, bit) = Self::place(port);
        self.0[word] & bit != 0
    }

    fn place(port: u16) -> (usize, u64) {
        (usize::from(port) / u64::BITS as usize, 1 << (u32::from(port) % u64::BITS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_read_as_ranges() {
        let range = |text: &str| text.parse::<PortRange>();
        assert_eq!(range("20001-20125").unwrap(), PortRange { first: 20001, last: 20125 });
        assert_eq!(range("20200").unwrap(), PortRange { first: 20200, last: 20200 });
        for bad in ["", "0", "20125-20001", "20001-", "65536", "20001-20002-3"] {
            assert!(range(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_set_has_the_ports_of_p_net_and_those_that_were_added() {
        let range = |first, last| PortRange { first, last };
        let mut ports = Ports::of_p_net_and(&[range(1, 1), range(20001, 20125)]);
        ports.add(65535);
        let all: Vec<_> = (0..=u16::MAX).filter(|&port| ports.contains(port)).collect();
        let right = [1].into_iter().chain(20001..=20125).chain([34378, 34379, 65535]);
        assert_eq!(all, right.collect::<Vec<_>>());
    }
}
