//! Memory for large blocks, each from the kernel and back to it.
//!
//! The tables of a relay are large, and most of their pages are never written to. In a new mapping, such a page
//! takes no memory. C libraries make mappings of large blocks, too, but glibc on 64-bit ARM not always: it takes
//! 2 MB of memory at once, cuts tables out of what is left of these, and writes zeros to all of them.

use std::alloc::{GlobalAlloc, Layout, System};
use std::ptr;

/// A block of this size, in octets, is a mapping of its own.
const LARGE: usize = 128 << 10;
/// The smallest page of any processor. Mappings begin with a page.
const PAGE: usize = 4096;

/// The allocator of the program: that of the C library, but for large blocks.
#[derive(Debug)]
pub struct LargeBlocksApart;

// SAFETY: the size and the alignment of a block tell who has allocated it. A mapping begins with a page, has at
// least the size that was asked for, is all zero, and is nobody else's.
//
// Not inlined: the compiler would write it again wherever something is allocated, and the program grow by 0.1 MB.
unsafe impl GlobalAlloc for LargeBlocksApart {
    #[inline(never)]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        if is_large(layout) {
            return map(layout.size());
        }
        // SAFETY: as the caller has promised.
        unsafe { System.alloc(layout) }
    }

    #[inline(never)]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if is_large(layout) {
            return map(layout.size());
        }
        // SAFETY: as the caller has promised.
        unsafe { System.alloc_zeroed(layout) }
    }

    #[inline(never)]
    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        if is_large(layout) {
            // SAFETY: `map` has made it with this size, and nobody uses it any more.
            unsafe { libc::munmap(block.cast(), layout.size()) };
        } else {
            // SAFETY: as the caller has promised.
            unsafe { System.dealloc(block, layout) }
        }
    }

    #[inline(never)]
    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller has promised that the size is one that a layout can have.
        let wanted = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        if !is_large(layout) && !is_large(wanted) {
            // SAFETY: as the caller has promised.
            return unsafe { System.realloc(block, layout, size) };
        }
        // SAFETY: as the caller has promised; the two blocks are not the same.
        unsafe {
            let other = self.alloc(wanted);
            if !other.is_null() {
                ptr::copy_nonoverlapping(block, other, size.min(layout.size()));
                self.dealloc(block, layout);
            }
            other
        }
    }
}

fn is_large(layout: Layout) -> bool {
    layout.size() >= LARGE && layout.align() <= PAGE
}

/// A new mapping; null where the kernel has no memory.
fn map(size: usize) -> *mut u8 {
    let (rights, kind) =
        (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
    // SAFETY: wherever the kernel likes, so that no other memory changes.
    let address = unsafe { libc::mmap(ptr::null_mut(), size, rights, kind, -1, 0) };
    if address == libc::MAP_FAILED { ptr::null_mut() } else { address.cast() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALLOCATOR: LargeBlocksApart = LargeBlocksApart;

    fn layout(size: usize) -> Layout {
        Layout::from_size_align(size, 8).unwrap()
    }

    /// What a block begins with and ends with.
    fn ends(block: *mut u8, size: usize) -> [u8; 2] {
        // SAFETY: tests call it with blocks that they have, of this size.
        unsafe { [*block, *block.add(size - 1)] }
    }

    #[test]
    #[cfg_attr(miri, ignore = "it asks the kernel about its pages")]
    fn a_large_block_takes_memory_where_it_is_written_to() {
        let pages = |block: *mut u8| {
            let mut pages = [0_u8; 256];
            // SAFETY: a mapping of so many pages, and an octet for each of them.
            let done = unsafe { libc::mincore(block.cast(), 256 * PAGE, pages.as_mut_ptr()) };
            assert_eq!(done, 0);
            pages.iter().filter(|&page| page & 1 == 1).count()
        };
        let layout = layout(256 * PAGE);
        // SAFETY: the size is not 0; what is written lies in the block.
        unsafe {
            let block = ALLOCATOR.alloc_zeroed(layout);
            // Where the kernel gives huge pages unasked, one octet would bring all of the block. A kernel without
            // them refuses the call.
            libc::madvise(block.cast(), layout.size(), libc::MADV_NOHUGEPAGE);
            assert_eq!(pages(block), 0);
            block.add(100 * PAGE).write(1);
            assert_eq!(pages(block), 1);
            ALLOCATOR.dealloc(block, layout);
        }
    }

    #[test]
    fn a_block_that_grows_and_shrinks_keeps_its_octets() {
        let mut size = 1000;
        // SAFETY: no size is 0, and each block is given back once, with its last layout.
        unsafe {
            let mut block = ALLOCATOR.alloc_zeroed(layout(size));
            block.write(7);
            for next in [LARGE - 1, LARGE, 3 * LARGE, 2 * LARGE, LARGE - 1, 1000] {
                block.add(size - 1).write(9);
                let kept = size.min(next);
                block.add(kept - 1).write(9);
                block = ALLOCATOR.realloc(block, layout(size), next);
                assert_eq!(ends(block, kept), [7, 9], "from {size} to {next}");
                size = next;
            }
            ALLOCATOR.dealloc(block, layout(size));
        }
    }

    #[test]
    fn a_page_of_alignment_is_kept_and_more_is_too() {
        for align in [8, PAGE, 16 * PAGE] {
            let layout = Layout::from_size_align(2 * LARGE, align).unwrap();
            // SAFETY: the size is not 0.
            unsafe {
                let block = ALLOCATOR.alloc_zeroed(layout);
                assert!(block.addr().is_multiple_of(align));
                assert_eq!(ends(block, 2 * LARGE), [0, 0]);
                ALLOCATOR.dealloc(block, layout);
            }
        }
    }
}
