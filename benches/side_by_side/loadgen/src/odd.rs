//! Whether an answer is the one that was asked for: by whom, of whom, in which run.
//!
//! The number of a request says it all: flow (24 bits), slot (8), run (8), counter (24).

use loadgen::datagram;
use std::net::SocketAddrV4;

/// What a request is called.
#[derive(Clone, Copy, PartialEq)]
pub struct Number {
    pub flow: usize,
    pub slot: usize,
    pub counter: u64,
}

impl Number {
    /// As it travels.
    pub fn packed(self) -> u64 {
        let number = (self.flow as u64) << 40 | (self.slot as u64 & 0xff) << 32;
        number | run() << 24 | self.counter & 0xff_ffff
    }
}

/// Answers that are not what was asked for.
#[derive(Default)]
pub struct Odd {
    /// Not the length of a request, empty ones included.
    pub malformed: u64,
    /// To an earlier run.
    pub stale: u64,
    /// To another socket's request: delivered to the wrong client.
    pub foreign: u64,
    /// From another address or port than the one that was asked.
    pub wrong_port: u64,
}

impl Odd {
    /// Number and time of an answer that came to a socket whose flows `asked` tells: none where the
    /// socket does not have the flow, otherwise who was asked.
    pub fn sort(
        &mut self,
        octets: &[u8],
        peer: SocketAddrV4,
        asked: impl Fn(usize) -> Option<SocketAddrV4>,
    ) -> Option<(u64, u64)> {
        let count = match datagram::read(octets) {
            None => &mut self.malformed,
            Some((number, _)) if number >> 24 & 0xff != run() => &mut self.stale,
            Some((number, time)) => match asked(flow(number)) {
                None => &mut self.foreign,
                Some(asked) if asked != peer => &mut self.wrong_port,
                Some(_) => return Some((number, time)),
            },
        };
        *count += 1;
        None
    }
}

/// The flow of a number.
pub fn flow(number: u64) -> usize {
    (number >> 40) as usize
}

/// The slot of a number.
pub fn slot(number: u64) -> usize {
    (number >> 32 & 0xff) as usize
}

fn run() -> u64 {
    u64::from(std::process::id() & 0xff)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_the_askers_from_whom_he_asked() {
        let asked: SocketAddrV4 = "192.0.2.1:7".parse().unwrap();
        let number = Number { flow: 99_999, slot: 15, counter: 3 }.packed();
        let mut octets = [0; datagram::LEN];
        datagram::write(&mut octets, 1, number, 5, datagram::PASSWORD);
        let mut odd = Odd::default();
        let mine = |flow| (flow == 99_999).then_some(asked);
        assert_eq!(odd.sort(&octets, asked, mine), Some((number, 5)));
        assert_eq!((flow(number), slot(number)), (99_999, 15));

        assert_eq!(odd.sort(&octets, "192.0.2.1:8".parse().unwrap(), mine), None);
        assert_eq!(odd.sort(&octets, asked, |_| None), None);
        assert_eq!(odd.sort(&octets[..9], asked, mine), None);
        datagram::write(&mut octets, 1, number ^ 1 << 24, 5, datagram::PASSWORD);
        assert_eq!(odd.sort(&octets, asked, mine), None);
        assert_eq!((odd.wrong_port, odd.foreign, odd.malformed, odd.stale), (1, 1, 1, 1));
    }
}
