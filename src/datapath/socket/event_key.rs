//! Names the things that a worker waits on and sends to, as the 64 bits that epoll and a batch
//! carry.

use nix::sys::epoll::{EpollEvent, EpollFlags};

use crate::nat::{ListenerId, UpstreamId};

/// What an event of epoll belongs to, or a datagram that is to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::datapath) enum EventKey {
    Public(ListenerId),
    Upstream(UpstreamId),
    Wake,
    Tick,
}

const UPSTREAM: u64 = 1 << 32;
const WAKE: u64 = 1 << 33;
const TICK: u64 = 1 << 34;

impl EventKey {
    pub(in crate::datapath) fn key(self) -> u64 {
        match self {
            Self::Public(id) => u64::from(id.0),
            Self::Upstream(id) => UPSTREAM | u64::from(id.0),
            Self::Wake => WAKE,
            Self::Tick => TICK,
        }
    }

    pub(in crate::datapath) fn from_key(key: u64) -> Self {
        match key {
            WAKE => Self::Wake,
            TICK => Self::Tick,
            _ if key & UPSTREAM != 0 => Self::Upstream(UpstreamId(key as u32)),
            _ => Self::Public(ListenerId(key as u32)),
        }
    }

    /// The epoll event for arrivals. It comes at every wake-up as long as something waits here.
    pub(in crate::datapath) fn arrivals(self) -> EpollEvent {
        EpollEvent::new(EpollFlags::EPOLLIN, self.key())
    }
}
