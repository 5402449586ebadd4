//! Memory that the process shares with programs in the kernel: the elements of a map, as counters.

use std::fmt;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::ptr::{self, NonNull};

use super::bpf::{self, MapKind};
use crate::datapath::offload::KernelFlow;
use crate::nat::{Counter, NodeCounters};

/// What can lie in such memory: atomic integers alone, so that others may change it at any time, and so that
/// zeros are a value.
///
/// # Safety
///
/// All of that has to be so, and the size a multiple of eight octets.
pub(in crate::datapath) unsafe trait Shared: Sync + 'static {}

// SAFETY: a `Counter` is an `AtomicU64`.
unsafe impl Shared for Counter {}
// SAFETY: it consists of `Counter`s.
unsafe impl Shared for NodeCounters {}
// SAFETY: it consists of `AtomicU64`s and an even number of `AtomicU32`s.
unsafe impl Shared for KernelFlow {}

/// The elements of a map.
pub(in crate::datapath) struct SharedArray<T> {
    map: OwnedFd,
    elements: NonNull<[T]>,
}

// SAFETY: all there is are shared references to what is `Sync`.
unsafe impl<T: Shared> Send for SharedArray<T> {}
// SAFETY: the same.
unsafe impl<T: Shared> Sync for SharedArray<T> {}

impl<T: Shared> SharedArray<T> {
    /// A map of so many elements, all zero.
    pub(in crate::datapath) fn new(len: usize) -> io::Result<Self> {
        const { assert!(size_of::<T>().is_multiple_of(8) && align_of::<T>() <= 4096) };
        let map = bpf::create_map(MapKind::SharedArray, 4, size_of::<T>(), len, None)?;
        // SAFETY: a new mapping, wherever the kernel likes.
        let address = unsafe {
            libc::mmap(
                ptr::null_mut(),
                len * size_of::<T>(),
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                map.as_raw_fd(),
                0,
            )
        };
        if address == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        let elements = ptr::slice_from_raw_parts_mut(address.cast::<T>(), len);
        let elements = NonNull::new(elements).ok_or_else(|| io::Error::other("mapped at 0"))?;
        Ok(Self { map, elements })
    }

    /// The elements.
    pub(in crate::datapath) fn elements(&self) -> &[T] {
        // SAFETY: the mapping has this length, lasts as long as `self`, and holds values of this type, which
        // others may change.
        unsafe { self.elements.as_ref() }
    }
}

impl<T> AsFd for SharedArray<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.map.as_fd()
    }
}

impl<T> Drop for SharedArray<T> {
    fn drop(&mut self) {
        let octets = self.elements.len() * size_of::<T>();
        // SAFETY: this is the mapping that was made in `new`; nobody borrows from it any more.
        unsafe { libc::munmap(self.elements.as_ptr().cast(), octets) };
    }
}

impl<T> fmt::Debug for SharedArray<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} shared elements", self.elements.len())
    }
}
