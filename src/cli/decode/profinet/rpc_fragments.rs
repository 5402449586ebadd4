//! Fragments of DCE/RPC calls, put together (P-8).
//!
//! Invariant: memory has a bound, whatever the capture holds: [`CALLS`] calls of at most [`OCTETS`] octets. A
//! call that is too long is forgotten, and when there are too many, the one that has waited longest.

use std::collections::VecDeque;

use super::rpc::RpcFields;
use crate::profinet::Uuid;
use crate::profinet::rpc::PacketType;

/// The most calls that wait for fragments.
const CALLS: usize = 32;
/// The most octets of a call. A record has at most 65,535, and its header some more.
const OCTETS: usize = 1 << 17;
/// The most fragments of a call.
const FRAGMENTS: u16 = 1024;

/// Calls that wait for fragments, the one that has waited longest first.
#[derive(Debug, Default)]
pub(in crate::cli::decode) struct RpcFragments {
    calls: VecDeque<Call>,
}

/// What the fragments of a call have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) activity: Uuid,
    pub(super) sequence: u32,
    pub(super) packet_type: PacketType,
}

/// One fragment of a call.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fragment<'a> {
    pub(super) key: Key,
    pub(super) number: u16,
    pub(super) is_last: bool,
    pub(super) octets: &'a [u8],
}

#[derive(Debug)]
struct Call {
    key: Key,
    /// In the order of their numbers, each once.
    fragments: Vec<(u16, Vec<u8>)>,
    last: Option<u16>,
    octets: usize,
}

impl RpcFragments {
    /// Keeps a fragment. The stub data of the whole call, if this was the fragment that it waited for.
    pub(in crate::cli::decode) fn add(&mut self, fields: &RpcFields<'_>) -> Option<Vec<u8>> {
        let fragment = fields.fragment()?;
        let place = self.calls.iter().position(|call| call.key == fragment.key);
        let mut call = match place.and_then(|place| self.calls.remove(place)) {
            Some(call) => call,
            None => Call::new(fragment.key),
        };
        if !call.add(&fragment) {
            return None;
        }
        if call.is_whole() {
            return Some(call.fragments.into_iter().flat_map(|(_, octets)| octets).collect());
        }
        if self.calls.len() == CALLS {
            self.calls.pop_front();
        }
        self.calls.push_back(call);
        None
    }
}

impl Call {
    fn new(key: Key) -> Self {
        Self { key, fragments: Vec::new(), last: None, octets: 0 }
    }

    /// Whether the call can still become whole.
    fn add(&mut self, fragment: &Fragment<'_>) -> bool {
        if fragment.number >= FRAGMENTS || self.octets + fragment.octets.len() > OCTETS {
            return false;
        }
        if fragment.is_last {
            self.last = Some(fragment.number);
        }
        match self.fragments.binary_search_by_key(&fragment.number, |(number, _)| *number) {
            // It was sent again.
            Ok(_) => {}
            Err(place) => {
                self.octets += fragment.octets.len();
                self.fragments.insert(place, (fragment.number, fragment.octets.to_vec()));
            }
        }
        true
    }

    fn is_whole(&self) -> bool {
        self.last.is_some_and(|last| {
            self.fragments.len() == usize::from(last) + 1
                && self.fragments.last().is_some_and(|(number, _)| *number == last)
        })
    }
}

#[cfg(test)]
mod tests;
