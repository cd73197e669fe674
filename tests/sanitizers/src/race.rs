//! A data race on purpose: two threads write one number without order. ThreadSanitizer has to find
//! it; otherwise its silence elsewhere would mean nothing.
#![allow(unsafe_code)]

use std::cell::UnsafeCell;
use std::thread;

struct Shared(UnsafeCell<u64>);

// SAFETY: there is none: this is the race.
unsafe impl Sync for Shared {}

static NUMBER: Shared = Shared(UnsafeCell::new(0));

/// Races.
pub fn run() {
    let count = || {
        for _ in 0..10_000 {
            // SAFETY: none, on purpose; plain machine words, so that nothing worse can happen.
            unsafe { *NUMBER.0.get() += 1 };
        }
    };
    let other = thread::spawn(count);
    count();
    other.join().expect("counting does not panic");
    // SAFETY: the other thread has ended.
    println!("ran: {}", unsafe { *NUMBER.0.get() });
}
