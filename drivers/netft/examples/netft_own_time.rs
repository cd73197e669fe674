//! Prints the driver's own time for a job that takes seven records of a box, as many as come in a
//! millisecond at 7 kHz, from memory.
//!
//! `netft_own_time [CYCLES]`; `netft_own_time --instructions CYCLES` prints nothing, for a tool
//! that counts.

use std::io;

use taktil_drivers_netft::rdt::RECORD_BYTES;
use taktil_drivers_netft::{Arrival, Config, NetFt, Port};
use taktil_hal::{ForceTorque, Nanos};
use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::linux::monotonic;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Cycles of a slice.
const SLICE_CYCLES: i64 = 1_000;
/// Records that arrive between two jobs.
const RECORDS_A_CYCLE: u32 = 7;

/// A box that has some records more whenever it was read empty.
#[derive(Default)]
struct Replay {
    number: u32,
    left: u32,
}

impl Port for Replay {
    fn send(&mut self, _datagram: &[u8]) -> io::Result<()> {
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Arrival {
        if self.left == 0 {
            self.left = RECORDS_A_CYCLE;
            return Arrival::Nothing;
        }
        self.left -= 1;
        self.number = self.number.wrapping_add(1);
        let record = &mut buffer[..RECORD_BYTES];
        record.fill(0);
        record[..4].copy_from_slice(&self.number.to_be_bytes());
        record[4..8].copy_from_slice(&self.number.to_be_bytes());
        record[12..16].copy_from_slice(&self.number.to_be_bytes());
        Arrival::Datagram(RECORD_BYTES)
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let counted = arguments.iter().position(|word| word == "--instructions");
    let counted = counted.map(|at| arguments.remove(at)).is_some();
    let cycles: i64 = arguments.first().map_or(Ok(100_000), |word| word.parse())?;
    let port = Replay { left: RECORDS_A_CYCLE, ..Replay::default() };
    let mut half = NetFt::new(Box::new(port), &Config::default());
    let (mut slices, mut calls, mut failed) = (Vec::new(), 0, 0);
    let mut release = Nanos::ZERO;
    for _ in 0..(cycles / SLICE_CYCLES).max(1) {
        let length = SLICE_CYCLES.min(cycles);
        let begin = monotonic();
        let ((), heap) = guard::count_heap_calls(|| {
            for _ in 0..length {
                release += Nanos::from_millis(1);
                failed += i32::from(half.sample(release).is_err());
            }
        });
        calls += heap;
        slices.push((monotonic() - begin).0 as f64 / length as f64);
    }
    assert_eq!(failed, 0, "every reading is good");
    slices.sort_by(f64::total_cmp);
    if !counted {
        let median = slices[slices.len() / 2];
        println!("{median:.0} ns for {RECORDS_A_CYCLE} records, {calls} calls of the heap");
    }
    Ok(())
}
