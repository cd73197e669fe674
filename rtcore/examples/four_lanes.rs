//! Runs four lanes on two processors live, with overruns on purpose and, if asked for, under a
//! load; then repeats the run from its record and compares both bit for bit: `cargo run --profile
//! dist -p taktil-rtcore --example four_lanes -- 60 load`. Exit code 1 means that they differ.
//! Timing is not judged.

#[path = "../tests/four_lanes/mod.rs"]
mod four_lanes;

use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use four_lanes::{repeat, run_live, skips_and_lags};
use taktil_rtcore::{LaneSpec, Nanos};

/// Threads of the load: more than there are processors, so that all of them are contended.
const LOAD_THREADS: usize = 6;

/// Keeps a processor, the memory and the kernel busy until told to end.
fn keep_busy(over: &AtomicBool) {
    let mut block = vec![0u8; 8 << 20];
    while !over.load(Ordering::Relaxed) {
        for (index, byte) in block.iter_mut().enumerate().step_by(64) {
            *byte = byte.wrapping_add(index as u8);
        }
        std::hint::black_box(&block);
        std::thread::yield_now();
    }
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let seconds = arguments.next().map_or(Some(5), |text| text.parse::<i64>().ok());
    let Some(seconds) = seconds.filter(|seconds| (1..=3600).contains(seconds)) else {
        eprintln!("usage: four_lanes [SECONDS 1..=3600] [load]");
        return ExitCode::from(2);
    };
    let threads = if arguments.next().as_deref() == Some("load") { LOAD_THREADS } else { 0 };
    let over = AtomicBool::new(false);
    let (live, recorded) = std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| keep_busy(&over));
        }
        let outcome = run_live(Nanos::from_secs(seconds));
        over.store(true, Ordering::Relaxed);
        outcome
    });
    println!("{seconds} s live on four lanes, {threads} threads of load");
    for (spec, figures) in live.figures() {
        println!(
            "  {:<6} {:>6} jobs  {:>5} skipped  {:>5} missed  latest {} us",
            spec.name,
            figures.jobs,
            figures.skipped,
            figures.misses.total(),
            figures.lateness_ns.max() / 1000
        );
    }
    let (skips, late) = skips_and_lags(&recorded, live.catalog());
    let records = recorded.0.len();
    println!("  {records} records; {skips} jobs skipped, {late} values taken late");
    let specs: Vec<LaneSpec> = live.figures().map(|(spec, _)| spec.clone()).collect();
    let (_, repeated, until) = repeat(&recorded, &specs);
    if until < Nanos::MAX {
        println!("  records were lost: whole until {until}, repeated until there");
    }
    match recorded.difference(&repeated, live.catalog(), until) {
        None => {
            println!("repeated bit for bit: values, decisions, states");
            ExitCode::SUCCESS
        }
        Some(parted) => {
            println!("different: {parted}");
            ExitCode::FAILURE
        }
    }
}
