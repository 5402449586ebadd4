//! A datapath in the kernel: flows that the core has opened go on without it, at the interfaces.
//!
//! It is a cache of the core's verdicts, and makes none of its own. `carrier` enters the flows that a core
//! offers, and takes them out again; `program` is what the kernel runs; `layout` is what both read;
//! `places` is the memory of the counters; `interfaces` says where the programs run. Invariant: what the
//! program passes, the core would pass, and everything it passes is counted where the core's own counters
//! are added up.
//!
//! The maps and programs have no names in a file system. So they are gone, and nothing passes any more,
//! when the process ends, however it ends.

mod assembler;
mod carrier;
mod interfaces;
mod layout;
mod places;
mod program;
#[cfg(test)]
mod tests;
#[cfg(any(test, fuzzing))]
mod trial;

use std::collections::BTreeMap;
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nix::time::{ClockId, clock_gettime};

use crate::config::{Config, KernelFlows};
use crate::datapath::router::lock;
use crate::datapath::socket::port_pool::Ports;
use crate::datapath::socket::sys::bpf::{self, MapKind, Place};
use crate::datapath::socket::sys::shared_memory::SharedArray;
use crate::nat::{Counter, Lent, NodeCounters, SharedCounters, Table, Writer};
use crate::thread::{self, ThreadError};

pub(in crate::datapath) use carrier::Carrier;
pub(in crate::datapath) use interfaces::Changes;
pub(in crate::datapath) use layout::KernelFlow;
#[cfg(any(test, fuzzing))]
pub use trial::holds;

use interfaces::{Interface, Wanted};
use layout::{Entry, Key, entry};
use places::Places;
use program::Maps;

/// Nodes and credentials that reloads may bring, beside an eighth of those of the start. Later there is no right
/// to make room for more, and flows of others stay on the sockets.
const SPARE: usize = 32;
/// The most flows that the kernel carries: 8 MB.
const MOST_FLOWS: usize = 1 << 16;

/// A lease lasts so long, or a quarter less. Within this time, one datagram of each direction takes the long
/// way.
const SHORTEST_LEASE: u64 = 2_000_000_000;
/// With many flows it lasts so long for each of them: so some thousand datagrams a second take the long way, and
/// not more.
const LEASE_OF_A_FLOW: u64 = 500_000;

/// Why the kernel carries no flows.
#[derive(Debug, thiserror::Error)]
pub enum OffloadError {
    /// Nobody asked for it.
    #[error("[datapath] kernel = \"off\"")]
    Off,
    /// A right is missing.
    #[error("it needs the capabilities CAP_BPF, CAP_NET_ADMIN and CAP_PERFMON ({0})")]
    Forbidden(&'static str),
    /// The kernel has no place for the programs.
    #[error("it needs Linux 6.6 or newer, with tcx")]
    Kernel,
    /// There is nowhere to run.
    #[error("no Ethernet interface has an IPv4 address of [public] listen, or leads to the nodes")]
    NoInterface,
    /// The kernel refused something else.
    #[error("{0}: {1}")]
    System(&'static str, io::Error),
}

impl OffloadError {
    fn of(what: &'static str) -> impl Fn(io::Error) -> Self {
        move |error| match error.kind() {
            io::ErrorKind::PermissionDenied => Self::Forbidden(what),
            io::ErrorKind::Unsupported => Self::Kernel,
            _ => Self::System(what, error),
        }
    }
}

/// Whether the kernel carries flows, for people.
#[derive(Clone, Debug, Default)]
pub struct OffloadState {
    /// Why it carries none; none: it does.
    pub why_not: Option<String>,
    /// Flows that it carries now, or will as soon as a datagram of each direction has shown the way.
    pub flows: usize,
    /// The interfaces at which it does.
    pub interfaces: Vec<String>,
}

/// Maps and programs, and where they run.
#[derive(Debug)]
pub(in crate::datapath) struct Offload {
    entries: OwnedFd,
    flows: Arc<Places<KernelFlow>>,
    nodes: Arc<Places<NodeCounters>>,
    credentials: Arc<Places<Counter>>,
    /// How long a lease lasts.
    lease: SharedArray<Counter>,
    passing: OwnedFd,
    learning: OwnedFd,
    /// A map in a map: when it changes, the kernel waits until no program runs that saw it before.
    barrier: [OwnedFd; 2],
    links: Mutex<Links>,
    /// Grows whenever the address towards a node may have changed.
    sources: AtomicU32,
}

/// Where the programs run.
#[derive(Debug, Default)]
struct Links {
    wanted: Wanted,
    attached: BTreeMap<u32, Attached>,
}

/// The programs at one interface, which run until this is dropped.
#[derive(Debug)]
struct Attached {
    name: String,
    _links: [OwnedFd; 2],
}

impl Offload {
    /// Loads the programs and has them run at the interfaces of this configuration. Needs privileges, which
    /// can be given up afterwards. The second value hears of changes.
    pub(in crate::datapath) fn start(
        config: &Config,
        ports: &Arc<Ports>,
        most_flows: usize,
        started: Instant,
    ) -> Result<(Self, Changes), OffloadError> {
        if config.datapath.kernel == KernelFlows::Off {
            return Err(OffloadError::Off);
        }
        let wanted = Wanted::of(config);
        let changes = Changes::new().map_err(OffloadError::of("a netlink socket"))?;
        let interfaces = wanted.interfaces(ports).map_err(OffloadError::of("the interfaces"))?;
        if interfaces.is_empty() {
            return Err(OffloadError::NoInterface);
        }
        let offload = Self::load(&config.table, most_flows, started)?;
        for interface in interfaces {
            offload.attach(&mut lock(&offload.links).attached, interface)?;
        }
        lock(&offload.links).wanted = wanted;
        Ok((offload, changes))
    }

    /// Has the programs run at the interfaces of another configuration.
    pub(in crate::datapath) fn reload(&self, config: &Config, ports: &Arc<Ports>) {
        let wanted = Wanted::of(config);
        if std::mem::replace(&mut lock(&self.links).wanted, wanted.clone()) != wanted {
            self.follow_interfaces(ports);
        }
    }

    /// Has the programs run where they should by now. All datagrams take the long way first, by which they
    /// learn what has changed.
    fn follow_interfaces(&self, ports: &Arc<Ports>) {
        self.sources.fetch_add(1, Relaxed);
        self.end_leases();
        let Links { wanted, attached } = &mut *lock(&self.links);
        let interfaces = match wanted.interfaces(ports) {
            Ok(interfaces) => interfaces,
            Err(error) => return tracing::warn!(%error, "cannot ask for the interfaces"),
        };
        attached
            .retain(|&index, at| interfaces.contains(&Interface { index, name: at.name.clone() }));
        for interface in interfaces {
            let name = interface.name.clone();
            if !attached.contains_key(&interface.index)
                && let Err(error) = self.attach(attached, interface)
            {
                tracing::warn!(%error, interface = name, "flows at this interface stay on the sockets");
            }
        }
    }

    fn load(table: &Table, most_flows: usize, started: Instant) -> Result<Self, OffloadError> {
        let most_flows = most_flows.clamp(1, MOST_FLOWS);
        let map = OffloadError::of("a map");
        let entries = bpf::create_map(MapKind::Hash, Key::LEN, entry::LEN, 2 * most_flows, None);
        let entries = entries.map_err(&map)?;
        let flows = Arc::new(Places::new(most_flows).map_err(&map)?);
        let credentials: usize = table.nets().iter().map(|net| net.credentials.len()).sum();
        let room = |now: usize| now + now / 8 + SPARE;
        let nodes = Arc::new(Places::new(room(table.mappings().len())).map_err(&map)?);
        let credentials = Arc::new(Places::new(room(credentials)).map_err(&map)?);
        let lease = SharedArray::new(1).map_err(&map)?;
        let inner = bpf::create_map(MapKind::Array, 4, 4, 1, None).map_err(&map)?;
        let outer = bpf::create_map(MapKind::ArrayOfMaps, 4, 4, 1, Some(inner.as_fd()));
        let barrier = [outer.map_err(&map)?, inner];
        let maps = Maps {
            entries: entries.as_fd(),
            flows: flows.as_fd(),
            nodes: nodes.as_fd(),
            credentials: credentials.as_fd(),
            lease: lease.as_fd(),
        };
        let start = clock_of(started);
        let passing = bpf::load(&program::passing(&maps, start), Place::Incoming, "pnet_nat_pass");
        let learning =
            bpf::load(&program::learning(&maps, start), Place::Outgoing, "pnet_nat_learn");
        let program = OffloadError::of("a program");
        let (passing, learning) = (passing.map_err(&program)?, learning.map_err(&program)?);
        let links = Mutex::default();
        let offload = Self {
            entries,
            flows,
            nodes,
            credentials,
            lease,
            passing,
            learning,
            barrier,
            links,
            sources: AtomicU32::new(0),
        };
        offload.set_lease();
        Ok(offload)
    }

    /// Enters one direction of a flow.
    fn enter(&self, entry: &Entry) -> io::Result<()> {
        bpf::update(self.entries.as_fd(), &entry.comes.to_octets(), &entry.to_octets())
    }

    /// Sets how long the next leases last.
    fn set_lease(&self) {
        let lease = (self.flows.lent() as u64 * LEASE_OF_A_FLOW).max(SHORTEST_LEASE);
        self.lease.elements()[0].set(&Writer::of_worker(), lease);
    }

    fn attach(
        &self,
        attached: &mut BTreeMap<u32, Attached>,
        Interface { index, name }: Interface,
    ) -> Result<(), OffloadError> {
        let link = |program: &OwnedFd, place| {
            bpf::link(program.as_fd(), index, place).map_err(|error| match error.raw_os_error() {
                Some(libc::EINVAL) => OffloadError::Kernel,
                _ => OffloadError::of("a program at an interface")(error),
            })
        };
        let _links =
            [link(&self.passing, Place::Incoming)?, link(&self.learning, Place::Outgoing)?];
        attached.insert(index, Attached { name, _links });
        Ok(())
    }

    /// Waits until no program runs that may have seen an entry that is gone.
    pub(in crate::datapath) fn wait_for_programs(&self) {
        let [outer, inner] = &self.barrier;
        let inner = u32::try_from(inner.as_raw_fd()).unwrap_or_default();
        if let Err(error) = bpf::update(outer.as_fd(), &[0; 4], &inner.to_ne_bytes()) {
            tracing::warn!(%error, "cannot wait for the programs in the kernel");
        }
    }

    /// Has the next datagram of every flow take the long way.
    fn end_leases(&self) {
        self.flows.all().iter().for_each(KernelFlow::end_leases);
    }

    /// Starts a thread that follows changes of interfaces, addresses and routes.
    pub(in crate::datapath) fn follow(
        self: &Arc<Self>,
        changes: Changes,
        ports: &Arc<Ports>,
    ) -> Result<(), ThreadError> {
        let (offload, ports) = (Arc::downgrade(self), Arc::clone(ports));
        thread::start("interfaces", move || changes.follow(&offload, &ports))
    }

    /// How it is now.
    pub(in crate::datapath) fn state(&self) -> OffloadState {
        let links = lock(&self.links);
        let interfaces = links.attached.values().map(|attached| attached.name.clone()).collect();
        OffloadState { why_not: None, flows: self.flows.lent(), interfaces }
    }
}

impl SharedCounters for Offload {
    fn node(&self) -> Option<Lent<NodeCounters>> {
        self.nodes.lend()
    }

    fn credential(&self) -> Option<Lent<Counter>> {
        self.credentials.lend()
    }
}

/// What the kernel's clock showed at this time.
fn clock_of(time: Instant) -> u64 {
    let now = clock_gettime(ClockId::CLOCK_MONOTONIC).map(Duration::from).unwrap_or_default();
    u64::try_from(now.saturating_sub(time.elapsed()).as_nanos()).unwrap_or_default()
}
