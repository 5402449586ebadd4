//! The endpoint addresses of a client, used in rotation.

use super::{EndpointId, Ignored};

/// Endpoint addresses are 1 to this one.
const LAST: u8 = 125;

/// What was last heard of an address.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Past {
    #[default]
    Unused,
    Answered,
    GivenUp,
}

#[derive(Clone, Copy, Debug, Default)]
struct Use {
    owner: Option<EndpointId>,
    past: Past,
}

/// Who has which address, and who had it.
#[derive(Clone, Debug)]
pub(super) struct Addresses {
    /// Address 1 is the first.
    uses: [Use; LAST as usize],
    last: u8,
}

impl Default for Addresses {
    fn default() -> Self {
        Self { uses: [Use::default(); LAST as usize], last: 0 }
    }
}

impl Addresses {
    /// Gives an endpoint the free address that has rested for longest. `None` when all are in use.
    pub(super) fn take(&mut self, owner: EndpointId) -> Option<u8> {
        for _ in 0..LAST {
            self.last = self.last % LAST + 1;
            let entry = &mut self.uses[usize::from(self.last - 1)];
            if entry.owner.is_none() {
                *entry = Use { owner: Some(owner), past: Past::Unused };
                return Some(self.last);
            }
        }
        None
    }

    /// Notes what became of a request from this address.
    pub(super) fn note(&mut self, address: u8, past: Past) {
        if let Some(entry) = self.entry(address) {
            entry.past = past;
        }
    }

    /// Takes an address back from its endpoint.
    pub(super) fn free(&mut self, address: u8) {
        if let Some(entry) = self.entry(address) {
            entry.owner = None;
        }
    }

    /// The endpoint that may wait for a response to this address.
    pub(super) fn owner(&self, address: u8) -> Result<EndpointId, Ignored> {
        let index = usize::from(address).checked_sub(1);
        match index.and_then(|index| self.uses.get(index)) {
            Some(Use { past: Past::Answered, .. }) => Err(Ignored::Duplicate),
            Some(Use { past: Past::GivenUp, .. }) => Err(Ignored::Late),
            Some(Use { owner: Some(owner), .. }) => Ok(*owner),
            _ => Err(Ignored::NotForUs),
        }
    }

    fn entry(&mut self, address: u8) -> Option<&mut Use> {
        self.uses.get_mut(usize::from(address).checked_sub(1)?)
    }
}
