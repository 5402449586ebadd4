//! The handle of a worker that has sockets. The other threads reach the worker through it.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{self, Sender};
use std::time::Instant;

use nix::sys::epoll::{Epoll, EpollCreateFlags};
use nix::sys::eventfd::{EfdFlags, EventFd};

use crate::config::Config;
use crate::datapath::commands::Command;
use crate::datapath::offload::Carrier;
use crate::nat::{Core, ListenerId};

use super::event_key::EventKey;
use super::public::{Listener, Listeners};
use super::setup::StartError;
use super::worker::{Shared, Worker, WorkerSetup};

/// The handle of a worker.
#[derive(Debug)]
pub(in crate::datapath) struct Handle {
    commands: Sender<Command>,
    wake: Arc<EventFd>,
    epoll: Arc<Epoll>,
}

impl Handle {
    /// Builds a worker around this core, with these public sockets, and returns it with its handle.
    pub(in crate::datapath) fn build(
        config: &Config,
        core: Core,
        listeners: Listeners,
        upstream_limit: usize,
        started: Instant,
        shared: &Shared,
        carrier: Option<Carrier>,
    ) -> Result<(Self, Worker), StartError> {
        let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC).map_err(io::Error::from)?;
        let flags = EfdFlags::EFD_NONBLOCK | EfdFlags::EFD_CLOEXEC;
        let wake = Arc::new(EventFd::from_flags(flags).map_err(io::Error::from)?);
        let (commands, inbox) = mpsc::channel();
        let handle = Self { commands, wake: Arc::clone(&wake), epoll: Arc::new(epoll) };
        for (id, listener) in listeners.iter() {
            handle.watch(id, listener)?;
        }
        let worker = Worker::new(WorkerSetup {
            core,
            listeners,
            shared: shared.clone(),
            upstream_limit,
            settings: config.datapath.clone(),
            carrier,
            started,
            commands: inbox,
            epoll: Arc::clone(&handle.epoll),
            wake,
        })?;
        Ok((handle, worker))
    }

    /// Has the worker wake up when something arrives at a public socket.
    pub(in crate::datapath) fn watch(
        &self,
        id: ListenerId,
        listener: &Listener,
    ) -> Result<(), StartError> {
        let watched = self.epoll.add(&listener.socket, EventKey::Public(id).arrivals());
        watched.map_err(|error| StartError::Watch(error.into()))
    }

    /// Sends the worker a command. A worker that has ended does not answer.
    pub(in crate::datapath) fn ask(&self, command: Command) {
        if self.commands.send(command).is_ok() {
            let _ = self.wake.write(1);
        }
    }
}
