//! After opening, neither the half nor its worker allocates or frees memory: counted by the
//! allocator over two seconds of a stream with damage in it.

mod wire;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use taktil_drivers_serial::{BoardKind, Config, open};
use taktil_hal::{Arrival, Clock, Nanos, TactileArray, TactileFrame};
use wire::{Emulator, Monotonic};

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

#[expect(unsafe_code, reason = "a global allocator is an unsafe trait")]
// SAFETY: every method passes its arguments on to the system's allocator; counting allocates
// nothing, because the counter is initialised at compile time and has no destructor.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
        // SAFETY: the caller's promise on `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        let _ = CALLS.try_with(|calls| calls.set(calls.get() + 1));
        // SAFETY: `block` came from `System` with this `layout`.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn emulator_process() {
    wire::serve_if_asked();
}

#[test]
fn the_counter_counts() {
    let before = CALLS.get();
    drop(std::hint::black_box(Box::new(before)));
    assert_eq!(CALLS.get() - before, 2);
}

#[test]
fn nothing_is_allocated_after_opening() {
    for (name, board) in [("myrmex", BoardKind::Myrmex), ("flexitac", BoardKind::Flexitac)] {
        let emulator = Emulator::start(name, "allocations", "kind=corruption at=0 value=0.1");
        let clock = Monotonic::start();
        let path = emulator.link().display().to_string();
        let config = Config { path, board, rate_hz: 50.0, ..Config::default() };
        let (mut array, mut worker) = open(&config, Box::new(clock.clone())).unwrap();
        let (mut frame, mut scans) = (TactileFrame::of(&array), 0);
        let before = CALLS.get();
        let end = clock.now() + Nanos::from_secs(2);
        while clock.now() < end {
            assert!(worker.cycle());
            scans += u32::from(array.sample(clock.now(), &mut frame) == Ok(Arrival::New));
        }
        let calls = CALLS.get() - before;
        assert_eq!(calls, 0, "{name}");
        assert!(scans > 0, "{name}");
    }
}
