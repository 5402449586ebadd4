//! The tick of a worker. It comes about once a second while there is something to look at.
//!
//! The tick has its own timer instead of a time-out for each wait. A wait with a time-out sets up a
//! timer and removes it again, at every wake-up.

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
    /// A ticker that does not run yet. `epoll` will report each tick.
    pub(in crate::datapath) fn new(epoll: &Epoll) -> io::Result<Self> {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        epoll.add(&timer, EventKey::Tick.arrivals())?;
        Ok(Self { timer, running: false })
    }

    /// Starts or stops the ticker, where that is a change.
    #[inline]
    pub(in crate::datapath) fn run(&mut self, run: bool) {
        if run != self.running {
            self.turn(run);
        }
    }

    /// Reads a tick, so that the next one can wake the worker.
    pub(in crate::datapath) fn read(&self) {
        let _: Result<(), Errno> = self.timer.wait(); // an error: it was stopped meanwhile
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
