//! The router as the rest of the program sees it: started with a configuration, asked for figures,
//! stopped.
//!
//! Every socket is bound before the first worker runs, so a router starts whole or not at all.

use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use nix::sys::eventfd::{EfdFlags, EventFd};

use crate::config::{Config, Prefilter};
use crate::relay::{Core, Counters, FlowRecord, NetId, Rules};

use super::audit::Audit;
use super::descriptors::{self, Plan, TooFewDescriptors};
use super::public::{KernelDrops, PublicSocket};
use super::socket;
use super::worker::{Command, Parts, Worker};

/// How long a worker may take to tell its flows.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// A running router.
#[derive(Debug)]
pub struct Router {
    config: Config,
    counters: Vec<Arc<Counters>>,
    audit: Arc<Audit>,
    /// Of every worker, to ask the kernel about.
    public: Vec<Arc<[PublicSocket]>>,
    workers: Vec<Handle>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    ready: AtomicBool,
    started: Instant,
}

/// The way to ask a worker for something.
#[derive(Debug)]
struct Handle {
    commands: Sender<Command>,
    wake: Arc<EventFd>,
}

/// Why a router did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The process may not have enough file descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFewDescriptors),
    /// Another program has the port.
    #[error("UDP port {0} is in use; stop what uses it (ss -lunp), or choose another port")]
    PortInUse(SocketAddr),
    /// The address is not the host's.
    #[error(
        "{} is no address of this host; correct [public] listen (ip address shows what there is)",
        .0.ip()
    )]
    NotOurAddress(SocketAddr),
    /// A port below 1024 without the capability for it.
    #[error(
        "UDP port {0} needs CAP_NET_BIND_SERVICE, which is given up after the start; choose ports \
         above 1023, or restart with that capability"
    )]
    NotPermitted(SocketAddr),
    /// Another error of the system.
    #[error("cannot listen on UDP {0}")]
    Listen(SocketAddr, #[source] io::Error),
    /// Another error of the system, not about one address.
    #[error("cannot start a worker")]
    Worker(#[from] io::Error),
}

/// A router with all of its sockets and none of its threads.
pub struct Bound {
    router: Router,
    workers: Vec<Worker>,
}

impl Bound {
    /// Starts the workers. They inherit what the calling thread may do.
    pub fn start(self) -> Result<Router, StartError> {
        let Self { mut router, workers } = self;
        let mut threads = Vec::new();
        for (index, worker) in workers.into_iter().enumerate() {
            let thread = thread::Builder::new().name(format!("worker-{index}"));
            threads.push(thread.spawn(move || worker.run())?);
        }
        router.threads = Mutex::new(threads);
        router.ready = AtomicBool::new(true);
        Ok(router)
    }
}

impl Router {
    /// Binds every socket and starts the workers.
    pub fn start(config: Config) -> Result<Self, StartError> {
        Self::bind(config)?.start()
    }

    /// Binds every socket, and starts no thread yet.
    pub fn bind(config: Config) -> Result<Bound, StartError> {
        let started = Instant::now();
        let addresses = config.table.mappings().len() * config.listen.len();
        let plan = descriptors::plan(addresses, config.runtime.workers)?;
        let public = bind(&config, plan.workers)?;

        let rules = Rules::new(Arc::clone(&config.table), config.limits);
        let audit = Arc::new(Audit::new(config.runtime.audit_lines));
        let mut router = Self {
            config,
            audit,
            counters: Vec::new(),
            public,
            workers: Vec::new(),
            threads: Mutex::default(),
            ready: AtomicBool::new(false),
            started,
        };
        let workers = (0..plan.workers)
            .map(|index| router.build_worker(index, &plan, rules.clone()))
            .collect::<io::Result<_>>()?;
        Ok(Bound { router, workers })
    }

    /// A router without sockets and threads, for tests of what asks it for figures.
    #[cfg(test)]
    pub(crate) fn idle(config: Config, workers: usize) -> Arc<Self> {
        let counters = (0..workers).map(|_| Arc::new(Counters::new(&config.table))).collect();
        let audit = Arc::new(Audit::new(config.runtime.audit_lines));
        Arc::new(Self {
            config,
            audit,
            counters,
            public: Vec::new(),
            workers: Vec::new(),
            threads: Mutex::default(),
            ready: AtomicBool::new(false),
            started: Instant::now(),
        })
    }

    /// Takes no more requests, waits for the answers that are due, at most for the configured drain
    /// time, and ends the workers. Blocks until they have ended.
    pub fn shut_down(&self) {
        self.ready.store(false, Ordering::Release);
        let end = Instant::now() + self.config.runtime.drain;
        self.workers.iter().for_each(|worker| worker.ask(Command::Drain(end)));
        for thread in lock(&self.threads).drain(..) {
            // A worker that panicked has told so itself.
            let _ = thread.join();
        }
    }

    /// The configuration in force.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The counters of each worker; a figure of the router is their sum.
    pub fn counters(&self) -> &[Arc<Counters>] {
        &self.counters
    }

    /// What bounds the audit log.
    pub(crate) fn audit(&self) -> &Audit {
        &self.audit
    }

    /// Whether every socket is bound and no shutdown has begun.
    pub fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Acquire)
    }

    /// When the router started; [`NodeCounters::last_response`](crate::relay::NodeCounters) counts
    /// from here.
    pub fn started(&self) -> Instant {
        self.started
    }

    /// Datagrams that the kernel dropped on a net's public sockets.
    pub fn kernel_drops(&self, net: NetId) -> KernelDrops {
        let sockets = self.public.iter().flat_map(|sockets| sockets.iter());
        sockets.filter(|public| public.net == net).map(PublicSocket::drops).sum()
    }

    /// Up to `limit` open flows. Asks the workers, and waits for them a second at most.
    pub fn flows(&self, limit: usize) -> Vec<FlowRecord> {
        let (reply, answers) = mpsc::sync_channel(self.workers.len());
        for worker in &self.workers {
            worker.ask(Command::Flows(limit, reply.clone()));
        }
        drop(reply);
        let end = Instant::now() + ANSWER_TIME;
        let mut flows = Vec::new();
        while let Ok(more) = answers.recv_timeout(end.saturating_duration_since(Instant::now())) {
            flows.extend(more);
        }
        flows.truncate(limit);
        flows
    }

    fn build_worker(&mut self, index: usize, plan: &Plan, rules: Rules) -> io::Result<Worker> {
        let counters = Arc::new(Counters::new(&self.config.table));
        let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
        let wake = Arc::new(EventFd::from_flags(flags)?);
        let (commands, inbox) = mpsc::channel();
        self.counters.push(Arc::clone(&counters));
        self.workers.push(Handle { commands, wake: Arc::clone(&wake) });
        let core = Core::new(rules, counters, self.started, fastrand::Rng::new());
        Worker::new(Parts {
            core,
            public: Arc::clone(&self.public[index]),
            table: Arc::clone(&self.config.table),
            audit: Arc::clone(&self.audit),
            upstream_limit: plan.upstreams,
            runtime: self.config.runtime.clone(),
            started: self.started,
            commands: inbox,
            wake,
        })
    }
}

impl Handle {
    fn ask(&self, command: Command) {
        // A worker that has ended answers nothing; its channel is closed.
        if self.commands.send(command).is_ok() {
            let _ = self.wake.write(1);
        }
    }
}

/// Opens all public sockets, for each worker those of every port and address.
fn bind(config: &Config, workers: usize) -> Result<Vec<Arc<[PublicSocket]>>, StartError> {
    let mut public: Vec<_> = (0..workers).map(|_| Vec::new()).collect();
    let mut granted = config.runtime.receive_buffer;
    for (mapping, id) in config.table.mappings().iter().zip(config.table.mapping_ids()) {
        for &address in &config.listen {
            let listen = SocketAddr::new(address, mapping.public_port);
            let sockets = socket::public(listen, workers, config.runtime.receive_buffer)
                .map_err(|error| StartError::listen(listen, error))?;
            for (worker, socket) in public.iter_mut().zip(sockets) {
                granted = granted.min(socket::receive_buffer(&socket).unwrap_or(granted));
                let socket = PublicSocket::new(socket, id, &config.table, address);
                if config.runtime.prefilter == Prefilter::Always {
                    let on = socket.filter(true, &config.table);
                    on.map_err(|error| StartError::Listen(listen, error))?;
                }
                worker.push(socket);
            }
        }
    }
    if granted < config.runtime.receive_buffer {
        tracing::warn!(
            asked_octets = config.runtime.receive_buffer,
            granted_octets = granted,
            "receive buffers are shorter than configured; raise net.core.rmem_max"
        );
    }
    Ok(public.into_iter().map(Arc::from).collect())
}

impl StartError {
    fn listen(address: SocketAddr, error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::AddrInUse => Self::PortInUse(address),
            io::ErrorKind::AddrNotAvailable => Self::NotOurAddress(address),
            io::ErrorKind::PermissionDenied => Self::NotPermitted(address),
            _ => Self::Listen(address, error),
        }
    }
}

/// What a poisoned lock guards here is whole all the same: a list of threads.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
