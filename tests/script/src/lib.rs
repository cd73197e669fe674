//! A machine around the task under test: other tasks are functions of the tick, the run is in
//! virtual time, and what came out is asked for by the name of its signal. Brings the counting
//! allocator with it. Refuses a run in which a job used the heap or was left out, unless a task
//! panicked in it.

pub mod dice;

use std::io::Write;
use std::sync::atomic::AtomicBool;

use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, FaultSet, Invalid, Io, LaneId, LaneSpec, Nanos, Output, Payload,
    Ports, Task, virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The period of the servo lane (2.5 ms).
pub const SERVO_PERIOD: Nanos = Nanos::from_micros(2_500);

/// Writes what a function of the tick says; `None`: nothing.
struct Feed<T, F> {
    out: Output<T>,
    at: F,
}

impl<T: Payload, F: FnMut(u64) -> Option<T> + Send> Task for Feed<T, F> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if let Some(value) = (self.at)(cycle.tick) {
            io.write(&self.out, value);
        }
        Ok(())
    }
}

/// Says why a test shows nothing here, past the harness, which keeps what a test that passes
/// prints.
pub fn skipped(why: impl core::fmt::Display) {
    let said = writeln!(std::io::stderr(), "SKIPPED: {why}");
    said.expect("a test has a standard error");
}

/// Does as another task until a job, and does not return from that one.
pub struct Hanging<T> {
    /// The other task.
    pub until_then: T,
    /// Number of the job.
    pub tick: u64,
}

impl<T: Task> Task for Hanging<T> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        if cycle.tick >= self.tick {
            loop {
                std::thread::sleep(std::time::Duration::from_secs(1));
            }
        }
        self.until_then.step(cycle, io)
    }
}

/// The machine while it is put together. What cannot be fails the test at once.
#[derive(Default)]
pub struct Bench {
    builder: Builder,
}

impl Bench {
    /// Nothing yet.
    #[must_use]
    pub fn new() -> Bench {
        Bench::default()
    }

    /// A lane called `servo`, of one [`SERVO_PERIOD`].
    pub fn servo(&mut self) -> LaneId {
        self.lane(LaneSpec::new("servo", SERVO_PERIOD, 80))
    }

    /// Any other lane.
    ///
    /// # Panics
    /// When it is refused.
    pub fn lane(&mut self, spec: LaneSpec) -> LaneId {
        self.builder.lane(spec).expect("a lane that holds")
    }

    /// The next task of a lane.
    ///
    /// # Panics
    /// When it is refused; [`Bench::refused`] is for those that have to be.
    pub fn task<T: Task + 'static>(
        &mut self,
        lane: LaneId,
        name: &str,
        make: impl FnOnce(&mut Ports) -> Result<T, Invalid>,
    ) {
        let made = self.builder.task(lane, name, |ports| Ok(Box::new(make(ports)?)));
        made.unwrap_or_else(|why| panic!("{name}: {why}"));
    }

    /// Why a task is refused.
    ///
    /// # Panics
    /// When it is not.
    pub fn refused<T: Task + 'static>(
        &mut self,
        lane: LaneId,
        name: &str,
        make: impl FnOnce(&mut Ports) -> Result<T, Invalid>,
    ) -> Invalid {
        let made = self.builder.task(lane, name, |ports| Ok(Box::new(make(ports)?)));
        made.expect_err("it has to be refused")
    }

    /// A task `name` that writes `name.out` as `at` says, by the job of its lane; `None`: nothing.
    ///
    /// # Panics
    /// When the name is taken.
    pub fn feed<T: Payload>(
        &mut self,
        lane: LaneId,
        name: &str,
        at: impl FnMut(u64) -> Option<T> + Send + 'static,
    ) {
        self.task(lane, name, |ports| Ok(Feed { out: ports.output("out"), at }));
    }

    /// Binds each of these inputs of `task` to the feed that is called like it.
    pub fn bind_feeds(&mut self, task: &str, ports: &[&str]) {
        for port in ports {
            self.bind(&format!("{task}.{port}"), &format!("{port}.out"));
        }
    }

    /// Binds one input.
    pub fn bind(&mut self, input: &str, signal: &str) {
        self.builder.bind(input, signal);
    }

    /// Where every lane takes its mode from.
    pub fn mode_from(&mut self, signal: &str) {
        self.builder.mode_from(signal);
    }

    /// Runs all jobs released before `until`.
    ///
    /// # Panics
    /// When the machine cannot be built, a task does not start, a job is left out, or one used the
    /// heap although no task of its lane panicked.
    #[must_use]
    pub fn run(self, until: Nanos) -> Run {
        let mut machine = self.builder.build().unwrap_or_else(|why| panic!("{why}"));
        let mut run =
            Run { catalog: machine.catalog().clone(), rows: Vec::new(), faults: FaultSet::NONE };
        let stop = AtomicBool::new(false);
        virtual_time::run(&mut machine, until, &stop, &mut run).expect("every task starts");
        assert!(guard::installed());
        for (spec, figures) in machine.figures() {
            assert_eq!(figures.jobs, spec.jobs_before(until), "lane {}", spec.name);
            let panicked = figures.faults.contains(FaultCode::TaskPanicked);
            assert!(panicked || figures.allocations == 0, "lane {} used the heap", spec.name);
            run.faults = run.faults.union(figures.faults);
        }
        run
    }
}

/// What came out of a run.
pub struct Run {
    catalog: Catalog,
    /// Signal, tick and body of every record.
    rows: Vec<(usize, u64, Vec<u8>)>,
    faults: FaultSet,
}

impl Observer for Run {
    fn record(&mut self, record: &Record<'_>) {
        self.rows.push((record.signal, record.tick, record.body.to_vec()));
    }
}

impl Run {
    /// Every value of a signal with the job that wrote it.
    ///
    /// # Panics
    /// When there is no such signal, or it carries something else.
    #[must_use]
    pub fn ticked<T: Payload>(&self, signal: &str) -> Vec<(u64, T)> {
        let number = self.catalog.find(signal).unwrap_or_else(|| panic!("there is no `{signal}`"));
        let rows = self.rows.iter().filter(|row| row.0 == number);
        rows.map(|row| (row.1, T::decode(&row.2).expect("a value of its type"))).collect()
    }

    /// Every value of a signal.
    ///
    /// # Panics
    /// As [`Run::ticked`].
    #[must_use]
    pub fn of<T: Payload>(&self, signal: &str) -> Vec<T> {
        self.ticked(signal).into_iter().map(|(_, value)| value).collect()
    }

    /// Every fault that a lane saw.
    #[must_use]
    pub fn faults(&self) -> FaultSet {
        self.faults
    }
}
