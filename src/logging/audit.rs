//! The audit log: who used the relay and who was refused for guessing, one event a line.
//!
//! The messages are the names of the events and stay the same (`docs/log.md`). A window of
//! the log holds a limited number of lines of each; how many more there would have been is told at
//! its end, so that nobody fills the disk and no count is lost.

use std::array;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use strum::VariantArray;

use crate::nat::{CloseReason, FlowRecord, MappingId, Table, ThrottleScope, Throttled};

/// What the workers write, and how much more they may. Shared by all of them.
#[derive(Debug)]
pub(crate) struct Audit {
    of_event: [Allowance; Event::VARIANTS.len()],
    left_out: AtomicU64,
}

/// Lines of one kind of event in this window.
#[derive(Debug)]
struct Allowance {
    left: AtomicU32,
    left_out: AtomicU64,
}

/// The events that clients and strangers bring about. Those of addresses are apart from those of
/// senders: an address is throttled after hundreds of its ports are, and has to be told of.
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
    /// So many lines of each kind in the first window.
    pub(crate) fn new(lines: u32) -> Self {
        let allowance = |_| Allowance { left: AtomicU32::new(lines), left_out: AtomicU64::new(0) };
        Self { of_event: array::from_fn(allowance), left_out: AtomicU64::new(0) }
    }

    /// Lines of all kinds that were left out since the start.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out.load(Relaxed)
    }

    /// Ends the window: tells what was left out of it, and allows so many lines in the next one.
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

    /// N-10: who, by which public port, and by which credential.
    pub(crate) fn flow_opened(&self, table: &Table, flow: &FlowRecord) {
        if self.may_write(Event::FlowOpened) {
            write_flow(table, flow, Event::FlowOpened, None);
        }
    }

    /// N-10: the same, with why and since when.
    pub(crate) fn flow_closed(&self, table: &Table, flow: &FlowRecord, reason: CloseReason) {
        if self.may_write(Event::FlowClosed) {
            write_flow(table, flow, Event::FlowClosed, Some(reason));
        }
    }

    /// Who is refused from here on, and where he was refused first.
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

    /// Who is listened to again, and how much was refused.
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

    /// Takes one line out of the window's allowance, or counts it as left out.
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

/// `198.51.100.7` or `2001:db8:0:7::/64`.
fn address(throttled: &Throttled) -> String {
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
