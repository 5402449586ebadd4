//! Waits for events.
//!
//! The system call is made directly, for the same reason as in `batch::calls`: the C library would
//! make it a cancellation point, which costs half as much as the call itself when something is
//! ready.

use std::os::fd::AsRawFd;
use std::ptr;

use libc::c_long;
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollEvent, EpollTimeout};

/// Waits until something is ready or the time is out. Returns how many of `events` the kernel
/// wrote.
pub(in crate::datapath) fn wait(
    epoll: &Epoll,
    events: &mut [EpollEvent],
    time_out: EpollTimeout,
) -> nix::Result<usize> {
    let no_mask = ptr::null::<libc::sigset_t>();
    // SAFETY: the kernel writes at most as many events as there are; an `EpollEvent` is an
    // `epoll_event` and nothing else.
    let ready = unsafe {
        libc::syscall(
            libc::SYS_epoll_pwait,
            c_long::from(epoll.0.as_raw_fd()),
            events.as_mut_ptr(),
            events.len() as c_long,
            c_long::from(i32::from(time_out)),
            no_mask,
            0 as c_long,
        )
    };
    Errno::result(ready).map(|ready| ready as usize)
}
