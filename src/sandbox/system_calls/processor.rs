//! What differs between processors: the number by which a filter knows one, and calls that only
//! some of them have.

use libc::c_long;

/// The number of this processor in what the kernel hands to a filter (AUDIT_ARCH_ of
/// linux/audit.h). None: nobody has tried which calls a relay makes there.
pub(super) const NUMBER: Option<u32> = if cfg!(target_arch = "x86_64") {
    Some(0xc000_003e)
} else if cfg!(target_arch = "aarch64") {
    Some(0xc000_00b7)
} else if cfg!(target_arch = "arm") {
    Some(0x4000_0028)
} else if cfg!(target_arch = "riscv64") {
    Some(0xc000_00f3)
} else {
    None
};

/// Maps memory. The third argument is the same on all processors.
#[cfg(target_pointer_width = "64")]
pub(super) const MMAP: c_long = libc::SYS_mmap;
#[cfg(target_pointer_width = "32")]
pub(super) const MMAP: c_long = libc::SYS_mmap2;

/// The call that `openat` has replaced.
#[cfg(any(target_arch = "x86_64", target_arch = "arm"))]
pub(super) const OPEN: Option<c_long> = Some(libc::SYS_open);
#[cfg(not(any(target_arch = "x86_64", target_arch = "arm")))]
pub(super) const OPEN: Option<c_long> = None;

/// Calls that are allowed with any arguments on this processor, beside those of every processor.
#[cfg(target_arch = "x86_64")]
pub(super) const ALLOWED: &[c_long] = &[
    libc::SYS_newfstatat,
    // Older forms
    libc::SYS_epoll_wait,
    libc::SYS_lstat,
    libc::SYS_readlink,
    libc::SYS_stat,
];
#[cfg(all(target_pointer_width = "64", not(target_arch = "x86_64")))]
pub(super) const ALLOWED: &[c_long] = &[libc::SYS_newfstatat];
#[cfg(target_pointer_width = "32")]
pub(super) const ALLOWED: &[c_long] = &[
    // 32-bit forms
    libc::SYS__llseek,
    libc::SYS_fcntl64,
    libc::SYS_fstat64,
    libc::SYS_fstatat64,
    libc::SYS_fstatfs64,
    libc::SYS_getegid32,
    libc::SYS_geteuid32,
    libc::SYS_statfs64,
    libc::SYS_ugetrlimit,
    // The forms with 64-bit time, which libc does not know. They have the same numbers on all 32-bit
    // processors
    403, // clock_gettime64
    407, // clock_nanosleep_time64
    411, // timerfd_settime64
    417, // recvmmsg_time64
    422, // futex_time64
    // Where a 64-bit C library calls sendto and recvfrom
    libc::SYS_recv,
    libc::SYS_send,
    // Older forms
    libc::SYS_epoll_wait,
    libc::SYS_lstat64,
    libc::SYS_readlink,
    libc::SYS_stat64,
];
