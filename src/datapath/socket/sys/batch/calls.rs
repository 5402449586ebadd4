//! The system calls of a batch, behind a trait so that tests can play the kernel.
//!
//! The calls are made directly. The C library would make each a cancellation point, which costs as
//! much as all of the relay's own work on a datagram. The library's variadic function `syscall`
//! reads each argument as a `c_long` or a pointer, so each argument is passed in that width.

use std::os::fd::{AsRawFd, BorrowedFd};
use std::ptr;

use libc::{c_long, c_void, mmsghdr, socklen_t};
use nix::errno::Errno;

use crate::datapath::socket::sys::options;

/// The kernel's calls that receive and send datagrams. No call waits.
pub(in crate::datapath) trait Kernel {
    /// Whether the kernel cuts a message into datagrams when it is asked to (UDP_SEGMENT).
    fn cuts_messages(&self) -> bool;

    /// Receives up to `count` datagrams and returns how many it received.
    ///
    /// # Safety
    ///
    /// There are `count` messages. Their pointers lead to as much room as the messages say, and
    /// nothing else uses any of it during the call.
    unsafe fn recvmmsg(
        &self,
        socket: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize>;

    /// Receives one datagram and returns how many octets of it were kept.
    ///
    /// # Safety
    ///
    /// There is room for `len` octets of the datagram, and for as many octets of a name as the
    /// number that `name_len` points at. Nothing else uses any of it during the call.
    unsafe fn recvfrom(
        &self,
        socket: BorrowedFd<'_>,
        octets: *mut c_void,
        len: usize,
        name: *mut c_void,
        name_len: *mut socklen_t,
    ) -> nix::Result<usize>;

    /// Sends as many of the messages as it takes, and returns how many. An error is that of the
    /// first message.
    ///
    /// # Safety
    ///
    /// As for [`recvmmsg`](Self::recvmmsg), but what the pointers lead to is only read.
    unsafe fn sendmmsg(
        &self,
        socket: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize>;

    /// Sends one datagram and returns how many octets it took.
    ///
    /// # Safety
    ///
    /// There are `len` octets, and `name_len` of a name.
    unsafe fn sendto(
        &self,
        socket: BorrowedFd<'_>,
        octets: *const c_void,
        len: usize,
        name: *const c_void,
        name_len: socklen_t,
    ) -> nix::Result<usize>;
}

/// The real kernel.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::datapath) struct Linux;

const DO_NOT_WAIT: c_long = libc::MSG_DONTWAIT as c_long;

impl Kernel for Linux {
    fn cuts_messages(&self) -> bool {
        options::cuts_messages()
    }

    #[inline]
    unsafe fn recvmmsg(
        &self,
        socket: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize> {
        let no_time_out = ptr::null_mut::<libc::timespec>();
        // SAFETY: as the caller promises.
        outcome(unsafe {
            libc::syscall(
                libc::SYS_recvmmsg,
                number(socket),
                messages,
                count as c_long,
                DO_NOT_WAIT,
                no_time_out,
            )
        })
    }

    #[inline]
    unsafe fn recvfrom(
        &self,
        socket: BorrowedFd<'_>,
        octets: *mut c_void,
        len: usize,
        name: *mut c_void,
        name_len: *mut socklen_t,
    ) -> nix::Result<usize> {
        // SAFETY: as the caller promises.
        outcome(unsafe {
            libc::syscall(
                libc::SYS_recvfrom,
                number(socket),
                octets,
                len as c_long,
                DO_NOT_WAIT,
                name,
                name_len,
            )
        })
    }

    #[inline]
    unsafe fn sendmmsg(
        &self,
        socket: BorrowedFd<'_>,
        messages: *mut mmsghdr,
        count: usize,
    ) -> nix::Result<usize> {
        // SAFETY: as the caller promises.
        outcome(unsafe {
            libc::syscall(
                libc::SYS_sendmmsg,
                number(socket),
                messages,
                count as c_long,
                DO_NOT_WAIT,
            )
        })
    }

    #[inline]
    unsafe fn sendto(
        &self,
        socket: BorrowedFd<'_>,
        octets: *const c_void,
        len: usize,
        name: *const c_void,
        name_len: socklen_t,
    ) -> nix::Result<usize> {
        // SAFETY: as the caller promises.
        outcome(unsafe {
            libc::syscall(
                libc::SYS_sendto,
                number(socket),
                octets,
                len as c_long,
                DO_NOT_WAIT,
                name,
                name_len as c_long,
            )
        })
    }
}

fn number(socket: BorrowedFd<'_>) -> c_long {
    socket.as_raw_fd().into()
}

fn outcome(result: c_long) -> nix::Result<usize> {
    Errno::result(result).map(|figure| figure as usize)
}
