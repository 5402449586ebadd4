//! Opening public sockets, at the start and for a new configuration.
//!
//! A socket that is there already is taken over, so that no datagram to it is lost. Whatever fails,
//! what was there stays, and what was opened is closed again.

use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use crate::config::{Config, Prefilter};
use crate::relay::{ListenerId, MappingId};
use crate::thread::ThreadError;

use super::descriptors::TooFewDescriptors;
use super::filtered::{FilteredSocket, NetDrops};
use super::listen::{self, CallError, ListenError};
use super::public::{Listener, Listeners};
use super::socket;

/// Why a router does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The process may not have enough file descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFewDescriptors),
    /// A public socket cannot be had.
    #[error(transparent)]
    Listen(#[from] ListenError),
    /// The system does not tell of what arrives.
    #[error("cannot wait for datagrams; is sysctl fs.epoll.max_user_watches reached?")]
    Watch(#[source] io::Error),
    /// The system has no thread left for a worker.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// Another error of the system, not about one address.
    #[error("cannot start a worker")]
    Worker(#[from] io::Error),
}

impl StartError {
    /// Whether it may pass by itself, so that another try may succeed.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Descriptors(_) => false,
            Self::Listen(error) => error.may_pass(),
            Self::Thread(_) => true,
            Self::Watch(error) | Self::Worker(error) => listen::may_pass(error),
        }
    }

    /// Whether it passes within seconds.
    pub fn passes_soon(&self) -> bool {
        matches!(self, Self::Listen(error) if error.passes_soon())
    }
}

/// The public sockets of each worker for this configuration, whose nets' figures are `drops`: those
/// of `before` that it names too, in their places, and new ones in places that are free.
pub(super) fn open(
    config: &Config,
    drops: &[Arc<NetDrops>],
    before: &[Listeners],
    workers: usize,
) -> Result<Vec<Listeners>, StartError> {
    // Every worker has the same sockets in the same places.
    let places = before.first().into_iter().flat_map(Listeners::iter);
    let places: HashMap<_, _> = places.map(|(id, listener)| (listener.address, id)).collect();
    let listener = |socket, address, mapping| {
        let net = config.table.mapping(mapping).net;
        let drops = Arc::clone(&drops[usize::from(net.0)]);
        Listener { socket, address, mapping, net, drops }
    };
    let mut next = vec![Listeners::default(); workers];
    let mut new = Vec::new();
    for (address, mapping) in wanted(config) {
        let Some(&id) = places.get(&address) else {
            new.push((address, mapping));
            continue;
        };
        for (next, before) in next.iter_mut().zip(before) {
            let Some(kept) = before.get(id) else { continue };
            next.put(id, listener(Arc::clone(&kept.socket), address, mapping));
        }
    }
    let mut ids = (0..).map(ListenerId);
    for (address, mapping) in new {
        let Some(id) = ids.find(|&id| next[0].get(id).is_none()) else { break };
        let sockets = socket::public(address, workers, config.runtime.receive_buffer);
        let failed = |error| ListenError::new("UDP", address, "[public] listen", error);
        let sockets = sockets.map_err(failed)?;
        for (next, socket) in next.iter_mut().zip(sockets) {
            let listener = listener(Arc::new(FilteredSocket::new(socket)), address, mapping);
            if config.runtime.prefilter == Prefilter::Always {
                let on = listener.filter(true, &config.table);
                let on = on.map_err(CallError::of("setsockopt SO_ATTACH_FILTER"));
                on.map_err(failed)?;
            }
            next.put(id, listener);
        }
    }
    Ok(next)
}

/// Says when the kernel granted less than the configured receive buffer.
pub(super) fn tell_short_buffers(config: &Config, listeners: &[Listeners]) {
    let asked = config.runtime.receive_buffer;
    let sockets = listeners.iter().flat_map(Listeners::iter);
    let granted = sockets.filter_map(|(_, l)| socket::receive_buffer(l.socket.socket()).ok()).min();
    if let Some(granted) = granted.filter(|&granted| granted < asked) {
        tracing::warn!(
            asked_octets = asked,
            granted_octets = granted,
            "receive buffers are shorter than configured; raise net.core.rmem_max"
        );
    }
}

/// Every address that clients send to, with what it stands for.
fn wanted(config: &Config) -> impl Iterator<Item = (SocketAddr, MappingId)> {
    let mappings = config.table.mappings().iter().zip(config.table.mapping_ids());
    mappings.flat_map(|(mapping, id)| {
        let listen = config.listen.iter();
        listen.map(move |&address| (SocketAddr::new(address, mapping.public_port), id))
    })
}
