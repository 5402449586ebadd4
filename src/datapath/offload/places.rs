//! Lends the elements of memory that is shared with the kernel.
//!
//! A program may still write to an element for a moment after the last entry that led there is gone. So an
//! element that was given back rests before it is lent again.

use std::collections::VecDeque;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::layout::KernelFlow;
use crate::datapath::router::lock;
use crate::datapath::socket::sys::shared_memory::{Shared, SharedArray};
use crate::nat::{Counter, Lender, Lent, NodeCounters, SharedFlow, Writer};

/// Much longer than a program runs.
const REST: Duration = Duration::from_secs(2);

/// The elements of a map, and which of them are lent.
#[derive(Debug)]
pub(super) struct Places<T> {
    array: SharedArray<T>,
    free: Mutex<Free>,
}

#[derive(Debug)]
struct Free {
    /// The first element that was never lent.
    unused: u32,
    /// Given back at these times, the oldest first.
    resting: VecDeque<(Instant, u32)>,
}

impl<T: Shared> Places<T> {
    pub(super) fn new(len: usize) -> io::Result<Self> {
        let free = Mutex::new(Free { unused: 0, resting: VecDeque::new() });
        Ok(Self { array: SharedArray::new(len)?, free })
    }

    /// All elements.
    pub(super) fn all(&self) -> &[T] {
        self.array.elements()
    }

    /// The number of elements that are lent.
    pub(super) fn lent(&self) -> usize {
        let free = self.free();
        free.unused as usize - free.resting.len()
    }

    fn free(&self) -> MutexGuard<'_, Free> {
        lock(&self.free)
    }

    fn take(&self) -> Option<u32> {
        let mut free = self.free();
        if free.resting.front().is_some_and(|(since, _)| since.elapsed() >= REST) {
            return free.resting.pop_front().map(|(_, place)| place);
        }
        let place = free.unused;
        let is_there = (place as usize) < self.all().len();
        free.unused += u32::from(is_there);
        is_there.then_some(place)
    }

    fn take_back(&self, place: u32) {
        self.free().resting.push_back((Instant::now(), place));
    }
}

impl<T> AsFd for Places<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.array.as_fd()
    }
}

/// Lends a place, with this value.
macro_rules! lend {
    ($element:ty as $lent:ty, $field:expr, $clear:expr) => {
        impl Places<$element> {
            /// An element that nobody has.
            pub(super) fn lend(self: &Arc<Self>) -> Option<Lent<$lent>> {
                let place = self.take()?;
                let clear: fn(&$element) = $clear;
                clear(&self.all()[place as usize]);
                Some(Lent::new(Arc::clone(self) as Arc<dyn Lender<$lent>>, place))
            }
        }

        impl Lender<$lent> for Places<$element> {
            fn get(&self, place: u32) -> &$lent {
                let field: fn(&$element) -> &$lent = $field;
                field(&self.all()[place as usize])
            }

            fn take_back(&self, place: u32) {
                Self::take_back(self, place);
            }
        }
    };
}

lend!(KernelFlow as SharedFlow, |flow| &flow.shared, KernelFlow::wipe);
lend!(NodeCounters as NodeCounters, |node| node, |node| node.clear(&Writer::of_worker()));
lend!(Counter as Counter, |counter| counter, |counter| counter.set(&Writer::of_worker(), 0));
