//! Opens public sockets, at the start and for a new configuration.
//!
//! A socket that is open already is taken over, so that no datagram to it is lost. A socket that
//! cannot be opened is named, and the others are opened all the same.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use crate::config::{Config, NotInForce, Prefilter, runs};
use crate::nat::{ListenerId, MappingId};
use crate::thread::ThreadError;

use crate::datapath::offload::OffloadError;
use crate::datapath::socket::descriptors::{Share, TooFewDescriptors};
use crate::datapath::socket::filtered::{FilteredSocket, NetDrops};
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::public::{Listener, Listeners};
use crate::datapath::socket::sys::options;
use crate::listen::{self, CallError, ListenError, chain};

/// Why a router does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The process may not have enough file descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFewDescriptors),
    /// A public socket cannot be opened.
    #[error(transparent)]
    Listen(#[from] ListenError),
    /// The system cannot report what arrives.
    #[error("cannot wait for datagrams; is sysctl fs.epoll.max_user_watches reached?")]
    Watch(#[source] io::Error),
    /// The system has no thread left for a worker.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// The kernel does not carry flows, and the configuration requires it.
    #[error("the kernel cannot carry flows, and [datapath] kernel is \"required\"")]
    Offload(#[from] OffloadError),
    /// Another error of the system, not about one address.
    #[error("cannot start a worker")]
    Worker(#[from] io::Error),
}

impl StartError {
    /// Whether the error may pass by itself, so that another try may succeed.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Descriptors(_) | Self::Offload(_) => false,
            Self::Listen(error) => error.may_pass(),
            Self::Thread(_) => true,
            Self::Watch(error) | Self::Worker(error) => listen::may_pass(error),
        }
    }

    /// Whether the error passes within seconds.
    pub fn passes_soon(&self) -> bool {
        matches!(self, Self::Listen(error) if error.passes_soon())
    }
}

/// The public sockets that a configuration wants, as far as they can be opened.
pub(in crate::datapath) struct Opened {
    /// The sockets of each worker. All workers have the same addresses in the same places.
    pub listeners: Vec<Listeners>,
    pub missing: Vec<Missing>,
}

/// A public socket that cannot be opened.
pub(in crate::datapath) struct Missing {
    pub address: SocketAddr,
    pub why: StartError,
}

/// Opens the public sockets of each worker for this configuration. `drops` holds what the kernel
/// dropped, for each net. Sockets of `before` that the configuration wants too keep their places.
/// New sockets get free places.
pub(in crate::datapath) fn open(
    config: &Config,
    drops: &[Arc<NetDrops>],
    before: &[Listeners],
    workers: usize,
    share: &Share,
) -> Opened {
    // Every worker has the same sockets in the same places.
    let places = before.first().into_iter().flat_map(Listeners::iter);
    let places: HashMap<_, _> = places.map(|(id, listener)| (listener.address, id)).collect();
    let listener = |socket, address, mapping| {
        let net = config.table.mapping(mapping).net;
        let drops = Arc::clone(&drops[usize::from(net.0)]);
        let is_long = config.table.net(net).kind.has_long_datagrams();
        Listener { socket, address, mapping, net, is_long, drops }
    };
    let mut next = vec![Listeners::default(); workers];
    let mut new = Vec::new();
    let mut room = share.public_sockets;
    for (address, mapping) in wanted(config) {
        let Some(&id) = places.get(&address) else {
            new.push((address, mapping));
            continue;
        };
        for (next, before) in next.iter_mut().zip(before) {
            let Some(kept) = before.get(id) else { continue };
            next.put(id, listener(Arc::clone(&kept.socket), address, mapping));
        }
        room = room.saturating_sub(1);
    }
    let mut missing = Vec::new();
    let mut unusable: HashMap<IpAddr, ListenError> = HashMap::new();
    let mut ids = (0..).map(ListenerId);
    for (address, mapping) in new {
        if let Some(lack) = share.lack.filter(|_| room == 0) {
            missing.push(Missing { address, why: lack.into() });
            continue;
        }
        if let Some(error) = unusable.get(&address.ip()).and_then(|error| error.at(address)) {
            missing.push(Missing { address, why: error.into() });
            continue;
        }
        let sockets = match filtered(config, address, mapping, workers, |socket| {
            listener(socket, address, mapping)
        }) {
            Ok(sockets) => sockets,
            Err(error) => {
                if let Some(error) = error.at(address) {
                    unusable.insert(address.ip(), error);
                }
                missing.push(Missing { address, why: error.into() });
                continue;
            }
        };
        let Some(id) = ids.find(|&id| next[0].get(id).is_none()) else { break };
        for (next, listener) in next.iter_mut().zip(sockets) {
            next.put(id, listener);
        }
        room = room.saturating_sub(1);
    }
    Opened { listeners: next, missing }
}

/// Opens sockets on one address, with the request filter where it is always on.
fn filtered(
    config: &Config,
    address: SocketAddr,
    mapping: MappingId,
    workers: usize,
    listener: impl Fn(Arc<FilteredSocket>) -> Listener,
) -> Result<Vec<Listener>, ListenError> {
    let key = match config.table.mapping(mapping).local_address {
        None => "[public] listen",
        Some(_) => "[[remote_net]] local_subnet",
    };
    let failed = |error| ListenError::new("UDP", address, key, error);
    let sockets = options::public(address, workers, config.datapath.receive_buffer);
    let mut listeners = Vec::new();
    for socket in sockets.map_err(failed)? {
        let listener = listener(Arc::new(FilteredSocket::new(socket)));
        if config.datapath.prefilter == Prefilter::Always {
            let on = listener.filter(true, &config.table);
            on.map_err(CallError::of("setsockopt SO_ATTACH_FILTER")).map_err(failed)?;
        }
        listeners.push(listener);
    }
    Ok(listeners)
}

/// Describes the missing sockets. All ports of an address that are missing for the same reason make
/// one item.
pub(in crate::datapath) fn told(missing: &[Missing], upstream: &Ports) -> Vec<NotInForce> {
    let mut ports = BTreeMap::<_, Vec<_>>::new();
    for Missing { address, why } in missing {
        let why = match why {
            StartError::Listen(error) if error.is_in_use() && upstream.is_taken(address.port()) => {
                "in use by the relay itself, which waits for an answer there; nothing has to be done: \
                 it is tried again every second"
                    .to_owned()
            }
            StartError::Listen(error) => error.why(),
            other => chain(other),
        };
        ports.entry((address.ip(), why)).or_default().push(address.port());
    }
    let item = |((ip, why), ports)| NotInForce { what: ports_of(ip, ports), why };
    ports.into_iter().map(item).collect()
}

/// Describes UDP ports of an address.
pub(in crate::datapath) fn ports_of(ip: IpAddr, mut ports: Vec<u16>) -> String {
    ports.sort_unstable();
    match ports[..] {
        [port] => format!("UDP port {}", SocketAddr::new(ip, port)),
        _ => format!("UDP ports {} of {ip}", runs(&ports)),
    }
}

/// Warns when the kernel granted less than the configured receive buffer.
pub(in crate::datapath) fn tell_short_buffers(config: &Config, listeners: &[Listeners]) {
    let asked = config.datapath.receive_buffer;
    let sockets = listeners.iter().flat_map(Listeners::iter);
    let granted =
        sockets.filter_map(|(_, l)| options::receive_buffer(l.socket.socket()).ok()).min();
    if let Some(granted) = granted.filter(|&granted| granted < asked) {
        tracing::warn!(
            asked_octets = asked,
            granted_octets = granted,
            "receive buffers are shorter than configured; raise net.core.rmem_max"
        );
    }
}

/// Every address that clients send to, with its mapping.
fn wanted(config: &Config) -> impl Iterator<Item = (SocketAddr, MappingId)> {
    let mappings = config.table.mappings().iter().zip(config.table.mapping_ids());
    mappings.flat_map(|(mapping, id)| {
        let addresses = config.addresses_of(mapping).iter();
        addresses.map(move |&address| (SocketAddr::new(address, mapping.public_port), id))
    })
}
