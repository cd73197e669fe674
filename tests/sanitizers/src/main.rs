//! `taktil-sanitizers clean | malloc | open | thread | link | live | race` does one thing each
//! under a sanitizer, which has to find it or has to stay silent. `drive DRIVER PLACE` runs a
//! driver's halves in a lane, `serve DRIVER PLACE` their board in another process, and `permitted
//! DRIVER [EXCEPT]` prints what the sanitizer is to permit; these need the feature `drivers`. The
//! script `run` judges.

#[cfg(feature = "drivers")]
mod drive;
#[cfg(feature = "drivers")]
mod emulated;
#[cfg(feature = "drivers")]
mod planted;
mod race;
#[cfg(feature = "drivers")]
#[path = "../../../drivers/comedi/tests/rig/node.rs"]
mod wired_double;

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::thread;

use taktil_hal::Nanos;
use taktil_hal::link::link;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Input, Io, LaneSpec, Machine, Output, Task, payload, virtual_time,
};

payload! {
    /// What flows between the lanes.
    pub struct Numbers {
        /// Any.
        pub x: [f64; 6],
    }
}

/// What a job does wrong.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Violation {
    None,
    Malloc,
    Open,
    Thread,
}

struct RelayTask {
    violation: Violation,
    from: Input<Numbers>,
    to: Output<Numbers>,
}

impl Task for RelayTask {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let mut value = io.read(&self.from).value;
        value.x[0] += 1.0;
        match self.violation {
            Violation::None => {}
            Violation::Malloc => drop(std::hint::black_box(vec![cycle.tick; 3])),
            Violation::Open => drop(std::fs::File::open("/dev/null")),
            Violation::Thread => drop(thread::spawn(|| ()).join()),
        }
        io.write(&self.to, value);
        Ok(())
    }
}

struct Sum(f64);

impl Observer for Sum {
    fn record(&mut self, record: &Record<'_>) {
        self.0 += f64::from(record.body[0]);
    }
}

impl RunObserver for Sum {}

/// Two lanes in a ring, each with two tasks, so that every kind of link is used.
fn machine(violation: Violation) -> Machine {
    let mut builder = Builder::new();
    for (name, period_us, other) in [("fast", 1000, "slow0.x"), ("slow", 2000, "fast0.x")] {
        let lane = builder.lane(LaneSpec::new(name, Nanos::from_micros(period_us), 40)).unwrap();
        for (n, signal) in [(0, other.to_owned()), (1, format!("{name}0.x"))] {
            let task = format!("{name}{n}");
            builder
                .task(lane, &task, |ports| {
                    let (from, to) = (ports.input("in"), ports.output("x"));
                    Ok(Box::new(RelayTask { violation, from, to }))
                })
                .unwrap();
            builder.bind(format!("{task}.in"), signal);
        }
    }
    builder.time_tasks();
    builder.build().unwrap()
}

fn run_in_virtual_time(violation: Violation) {
    let stop = AtomicBool::new(false);
    let mut sum = Sum(0.0);
    virtual_time::run(&mut machine(violation), Nanos::from_millis(100), &stop, &mut sum).unwrap();
    println!("ran: {}", sum.0);
}

fn run_on_threads(pace: Pace) {
    let terms = RunOptions { until: Nanos::from_millis(500), contract: Contract::Soft, pace };
    let mut sum = Sum(0.0);
    live::run(&mut machine(Violation::None), terms, &AtomicBool::new(false), &mut sum).unwrap();
    println!("ran: {}", sum.0);
}

/// Two threads and the exchange between them.
fn send_over_link() {
    let (mut sender, mut receiver) = link(64);
    let all = Nanos(200_000);
    let writer = thread::spawn(move || {
        for n in 0..all.0 {
            while sender.send([n; 6], Nanos(n), Nanos(n)).is_err() {
                thread::yield_now();
            }
        }
    });
    let mut last = -1;
    while last + 1 < all.0 {
        if let Some(found) = receiver.newest(all) {
            assert!(found.value[5] > last && found.value[0] == found.value[5]);
            last = found.value[5];
        }
    }
    writer.join().unwrap();
    println!("ran: {last}");
}

/// The words that concern drivers; `None` for other ones.
#[cfg(feature = "drivers")]
fn driver_command(words: &[&str]) -> Option<Result<(), Box<dyn std::error::Error>>> {
    let registered = taktil_machine_boards::register(&planted::DRIVERS);
    let outcome = match words {
        ["serve", driver, place] => emulated::serve(driver, place).map_err(Into::into),
        ["drive", driver, place] => drive::run(driver, place),
        ["permitted", driver] => drive::print_permitted(driver, None),
        ["permitted", driver, except] => drive::print_permitted(driver, Some(except)),
        _ => return None,
    };
    Some(registered.map_err(Into::into).and(outcome))
}

#[cfg(not(feature = "drivers"))]
fn driver_command(_: &[&str]) -> Option<Result<(), Box<dyn std::error::Error>>> {
    None
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["clean"] => run_in_virtual_time(Violation::None),
        ["malloc"] => run_in_virtual_time(Violation::Malloc),
        ["open"] => run_in_virtual_time(Violation::Open),
        ["thread"] => run_in_virtual_time(Violation::Thread),
        ["link"] => send_over_link(),
        ["live"] => [Pace::Slip, Pace::Fixed].into_iter().for_each(run_on_threads),
        ["race"] => race::run(),
        words => match driver_command(words) {
            None => return ExitCode::from(2),
            Some(Ok(())) => {}
            Some(Err(error)) => {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        },
    }
    ExitCode::SUCCESS
}
