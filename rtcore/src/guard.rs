//! The allocation guard: a global allocator that counts what is allocated or freed inside a job, on
//! the thread that does it.
//!
//! A binary installs it with `#[global_allocator]`; then every lane reports how many heap calls its
//! jobs made, and tests compare with zero. Outside jobs it passes everything through. Where the
//! allocator is not installed the count is unknown, not zero.
#![allow(unsafe_code)]

use core::cell::Cell;
use core::sync::atomic::{AtomicBool, Ordering};
use std::alloc::{GlobalAlloc, Layout, System};

thread_local! {
    static IN_JOB: Cell<bool> = const { Cell::new(false) };
    static HEAP_CALLS: Cell<u64> = const { Cell::new(0) };
    static BALANCED: Cell<bool> = const { Cell::new(false) };
    static BALANCE: Cell<HeapBalance> = const { Cell::new(HeapBalance { blocks: 0, bytes: 0 }) };
}

/// What was allocated and not freed again; negative when more was freed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HeapBalance {
    /// Blocks.
    pub blocks: i64,
    /// Bytes of them, as they were asked for.
    pub bytes: i64,
}

static INSTALLED: AtomicBool = AtomicBool::new(false);

/// The counting allocator over the system's.
#[derive(Debug, Default, Clone, Copy)]
pub struct CountingAllocator;

fn count_call() {
    // Relaxed: it only ever goes from false to true.
    INSTALLED.store(true, Ordering::Relaxed);
    if IN_JOB.try_with(Cell::get) == Ok(true) {
        let _ = HEAP_CALLS.try_with(|calls| calls.set(calls.get() + 1));
    }
}

/// Enters a change of a thread's balance, where one is kept. Sizes that do not fit count as 0: no
/// such block can be allocated.
fn balance(blocks: i64, added: usize, removed: usize) {
    if BALANCED.try_with(Cell::get) == Ok(true) {
        let bytes = |size: usize| i64::try_from(size).unwrap_or(0);
        let _ = BALANCE.try_with(|balance| {
            let before = balance.get();
            balance.set(HeapBalance {
                blocks: before.blocks + blocks,
                bytes: before.bytes + bytes(added) - bytes(removed),
            });
        });
    }
}

// SAFETY: every method passes its arguments unchanged to the system allocator, which upholds the
// contract; `count_call` and `balance` do not allocate: their thread-locals are initialised at
// compile time and have no destructor.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count_call();
        balance(1, layout.size(), 0);
        // SAFETY: the caller's promise on `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        count_call();
        balance(-1, 0, layout.size());
        // SAFETY: `block` came from `System` with this `layout`, because all four methods use
        // `System`.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count_call();
        balance(1, layout.size(), 0);
        // SAFETY: the caller's promise on `layout` is passed on.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count_call();
        balance(0, size, layout.size());
        // SAFETY: as for `dealloc`; `size` is the caller's promise.
        unsafe { System.realloc(block, layout, size) }
    }
}

/// Whether this process runs on [`CountingAllocator`].
#[must_use]
pub fn installed() -> bool {
    INSTALLED.load(Ordering::Relaxed)
}

/// Whether the calling thread is inside a job now.
#[must_use]
pub fn in_job() -> bool {
    IN_JOB.try_with(Cell::get) == Ok(true)
}

/// Runs `job` as a guarded section; returns its result and the number of heap calls it made.
pub fn count_heap_calls<R>(job: impl FnOnce() -> R) -> (R, u64) {
    let before = HEAP_CALLS.with(Cell::get);
    IN_JOB.with(|inside| inside.set(true));
    let result = job();
    IN_JOB.with(|inside| inside.set(false));
    (result, HEAP_CALLS.with(Cell::get) - before)
}

/// Runs `work`; returns its result and what it allocated on this thread without freeing it on this
/// thread. Meaningful when [`installed`]. An allocation that fails counts as one that was made.
pub fn heap_balance<R>(work: impl FnOnce() -> R) -> (R, HeapBalance) {
    let before = BALANCE.with(Cell::get);
    let outer = BALANCED.with(|balanced| balanced.replace(true));
    let result = work();
    BALANCED.with(|balanced| balanced.set(outer));
    let after = BALANCE.with(Cell::get);
    let balance =
        HeapBalance { blocks: after.blocks - before.blocks, bytes: after.bytes - before.bytes };
    (result, balance)
}
