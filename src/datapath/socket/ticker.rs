//! The tick of a worker: about once a second, as long as there is something to look at.
//!
//! A timer of its own rather than a time-out of each wait: a wait that has one sets up and takes
//! down a timer, and does so for every wake-up.

use std::io;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::epoll::Epoll;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};

use crate::datapath::socket::event_key::EventKey;

const TICK: Duration = Duration::from_secs(1);

/// Wakes a worker once a second, or lets it sleep.
pub(in crate::datapath) struct Ticker {
    timer: TimerFd,
    running: bool,
}

impl Ticker {
    /// Stands still; `epoll` will tell of each tick.
    pub(in crate::datapath) fn new(epoll: &Epoll) -> io::Result<Self> {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        epoll.add(&timer, EventKey::Tick.arrivals())?;
        Ok(Self { timer, running: false })
    }

    /// Starts or stops it, where that is a change.
    #[inline]
    pub(in crate::datapath) fn run(&mut self, run: bool) {
        if run != self.running {
            self.turn(run);
        }
    }

    /// Takes a tick, so that another can come.
    pub(in crate::datapath) fn read(&self) {
        let _: Result<(), Errno> = self.timer.wait(); // none: it was stopped meanwhile
    }

    #[cold]
    fn turn(&mut self, run: bool) {
        let changed = if run {
            self.timer.set(Expiration::Interval(TICK.into()), TimerSetTimeFlags::empty())
        } else {
            self.timer.unset()
        };
        self.running = run == changed.is_ok();
    }
}
