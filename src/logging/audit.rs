//! The audit log: who used the relay, and who was refused after too many wrong passwords. Each
//! event is one line.
//!
//! The messages are the names of the events, and these never change (`docs/log.md`). In each
//! window, the log takes a limited number of lines of each event. At the end of the window, a line
//! says how many more there would have been. So nobody can fill the disk, and no count is lost.

use std::array;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use strum::VariantArray;

use crate::nat::{CloseReason, FlowRecord, MappingId, Table, ThrottleScope, Throttled};

/// Writes the lines of all workers, and knows how many more lines it may write. The workers share
/// it.
#[derive(Debug)]
pub(crate) struct Audit {
    of_event: [Allowance; Event::VARIANTS.len()],
    left_out: AtomicU64,
}

/// How many lines of one event this window still has room for, and how many were left out.
#[derive(Debug)]
struct Allowance {
    left: AtomicU32,
    left_out: AtomicU64,
}

/// The events that clients and strangers cause. Throttling of an address is a different event from
/// throttling of a sender: hundreds of an address's ports are throttled before the address is, and
/// the line about the address must not be left out because of them.
#[derive(Clone, Copy, VariantArray)]
enum Event {
    FlowOpened,
    FlowClosed,
    SenderThrottlingBegun,
    SenderThrottlingEnded,
    AddressThrottlingBegun,
    AddressThrottlingEnded,
}

impl Audit {
    /// Allows this many lines of each event in the first window.
    pub(crate) fn new(lines: u32) -> Self {
        let allowance = |_| Allowance { left: AtomicU32::new(lines), left_out: AtomicU64::new(0) };
        Self { of_event: array::from_fn(allowance), left_out: AtomicU64::new(0) }
    }

    /// The lines of all events that were left out since the start.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out.load(Relaxed)
    }

    /// Ends the window: reports how many lines were left out, and allows `lines` of each event in
    /// the next window.
    pub(crate) fn end_window(&self, lines: u32, window: Duration) {
        for &event in Event::VARIANTS {
            let allowance = &self.of_event[event as usize];
            allowance.left.store(lines, Relaxed);
            let count = allowance.left_out.swap(0, Relaxed);
            if count > 0 {
                let seconds = window.as_secs_f64().ceil() as u64;
                tracing::warn!(of = event.name(), count, seconds, "audit lines left out");
            }
        }
    }

    /// Writes who opened a flow, through which public port, and with which credential (N-10).
    pub(crate) fn flow_opened(&self, table: &Table, flow: &FlowRecord) {
        if self.may_write(Event::FlowOpened) {
            write_flow(table, flow, Event::FlowOpened, None);
        }
    }

    /// Writes the same when a flow ends, with the close reason and the flow's age (N-10).
    pub(crate) fn flow_closed(&self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        if self.may_write(Event::FlowClosed) {
            write_flow(table, flow, Event::FlowClosed, Some(reason));
        }
    }

    /// Writes who is refused from now on, and the node at which the first refusal happened.
    pub(crate) fn throttling_begun(
        &self,
        table: &Table,
        throttled: &Throttled,
        mapping: MappingId,
    ) {
        let event = match throttled.scope {
            ThrottleScope::Sender => Event::SenderThrottlingBegun,
            ThrottleScope::Address => Event::AddressThrottlingBegun,
        };
        if self.may_write(event) {
            let mapping = table.mapping(mapping);
            tracing::info!(
                scope = throttled.scope.label(),
                address = address(throttled),
                client = %throttled.sender,
                net = %table.net(mapping.net).name,
                node = mapping.node_address,
                public_port = mapping.public_port,
                "{}", event.name()
            );
        }
    }

    /// Writes who may send again, and how many requests were refused.
    pub(crate) fn throttling_ended(&self, throttled: &Throttled) {
        let event = match throttled.scope {
            ThrottleScope::Sender => Event::SenderThrottlingEnded,
            ThrottleScope::Address => Event::AddressThrottlingEnded,
        };
        if self.may_write(event) {
            tracing::info!(
                scope = throttled.scope.label(),
                address = address(throttled),
                client = %throttled.sender,
                refused = throttled.refused,
                age_seconds = throttled.age.as_secs(),
                "{}", event.name()
            );
        }
    }

    /// Takes one line from the window's allowance. If none is left, counts the line as left out.
    fn may_write(&self, event: Event) -> bool {
        let Allowance { left, left_out } = &self.of_event[event as usize];
        let taken = left.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).is_ok();
        if !taken {
            left_out.fetch_add(1, Relaxed);
            self.left_out.fetch_add(1, Relaxed);
        }
        taken
    }
}

impl Event {
    const fn name(self) -> &'static str {
        match self {
            Self::FlowOpened => "flow opened",
            Self::FlowClosed => "flow closed",
            Self::SenderThrottlingBegun | Self::AddressThrottlingBegun => "throttling begun",
            Self::SenderThrottlingEnded | Self::AddressThrottlingEnded => "throttling ended",
        }
    }
}

/// The address as text: `198.51.100.7` or `2001:db8:0:7::/64`.
pub(crate) fn address(throttled: &Throttled) -> String {
    let network = throttled.address();
    match network.addr() {
        IpAddr::V4(address) => address.to_string(),
        IpAddr::V6(_) => network.to_string(),
    }
}

fn write_flow(table: &Table, flow: &FlowRecord, event: Event, closed: Option<CloseReason>) {
    let mapping = table.mapping(flow.mapping);
    let net = table.net(mapping.net);
    let credential = flow.credential.map(|index| &net.credentials[index].name);
    tracing::info!(
        net = %net.name,
        node = mapping.node_address,
        client = %flow.client,
        public_address = %flow.public_address,
        public_port = mapping.public_port,
        credential = credential.map(tracing::field::display),
        upstream_port = flow.upstream_port,
        reason = closed.map(CloseReason::label),
        age_seconds = closed.map(|_| flow.age.as_secs()),
        "{}",
        event.name()
    );
}
