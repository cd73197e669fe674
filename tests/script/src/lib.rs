//! Builds a machine around the task under test. Other tasks are functions of the tick, the run is
//! in virtual time, and the test reads the outputs by the names of their signals. The crate
//! installs the counting allocator. A run in which a job used the heap or was left out fails,
//! unless a task panicked in it.

pub mod dice;

use std::io::Write;
use std::sync::atomic::AtomicBool;

use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::{
    ArrayPayload, Builder, Cycle, FaultCode, FaultSet, FromRecord, Invalid, Io, LaneId, LaneSpec,
    Nanos, Output, Payload, Ports, Task, virtual_time,
};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The period of the servo lane (2.5 ms).
pub const SERVO_PERIOD: Nanos = Nanos::from_micros(2_500);

/// A task that writes the value of a function of the tick; nothing for `None`.
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

/// A task that writes the value for the number of each job; nothing for `None` and after the last.
struct ArrayFeed<T> {
    out: Output<T>,
    values: Vec<Option<T>>,
}

impl<T: ArrayPayload> Task for ArrayFeed<T> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let at = usize::try_from(cycle.tick).unwrap_or(usize::MAX);
        if let Some(Some(value)) = self.values.get(at) {
            io.write_array(&self.out, value);
        }
        Ok(())
    }
}

/// Reports why a test was skipped on this machine. It writes to the standard error directly,
/// because the test harness hides what a passing test prints.
pub fn report_skip(why: impl core::fmt::Display) {
    let said = writeln!(std::io::stderr(), "SKIPPED: {why}");
    said.expect("a test has a standard error");
}

/// A task that behaves as another task until a given job, from which it never returns.
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

/// A machine under construction. An error in its construction fails the test at once.
#[derive(Default)]
pub struct Bench {
    builder: Builder,
}

impl Bench {
    /// A machine without lanes.
    #[must_use]
    pub fn new() -> Bench {
        Bench::default()
    }

    /// Adds a lane called `servo`, of one [`SERVO_PERIOD`].
    pub fn servo(&mut self) -> LaneId {
        self.lane(LaneSpec::new("servo", SERVO_PERIOD, 80))
    }

    /// Adds a lane.
    ///
    /// # Panics
    /// When the lane is refused.
    pub fn lane(&mut self, spec: LaneSpec) -> LaneId {
        self.builder.lane(spec).expect("a lane that holds")
    }

    /// Adds the next task of a lane.
    ///
    /// # Panics
    /// When the task is refused; [`Bench::refused`] is for tasks that have to be.
    pub fn task<T: Task + 'static>(
        &mut self,
        lane: LaneId,
        name: &str,
        make: impl FnOnce(&mut Ports) -> Result<T, Invalid>,
    ) {
        let made = self.builder.task(lane, name, |ports| Ok(Box::new(make(ports)?)));
        made.unwrap_or_else(|why| panic!("{name}: {why}"));
    }

    /// Adds a task that has to be refused and returns the reason.
    ///
    /// # Panics
    /// When the task is not refused.
    pub fn refused<T: Task + 'static>(
        &mut self,
        lane: LaneId,
        name: &str,
        make: impl FnOnce(&mut Ports) -> Result<T, Invalid>,
    ) -> Invalid {
        let made = self.builder.task(lane, name, |ports| Ok(Box::new(make(ports)?)));
        made.expect_err("it has to be refused")
    }

    /// Adds a task `name` that writes `name.out`: the value of `at` for the number of the lane's
    /// job, and nothing for `None`.
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

    /// As [`Bench::feed`], of array payloads with the lengths of `like`, made before the run.
    ///
    /// # Panics
    /// When the name is taken.
    pub fn array_feed<T: ArrayPayload>(
        &mut self,
        lane: LaneId,
        name: &str,
        like: &T,
        values: Vec<Option<T>>,
    ) {
        self.task(lane, name, |ports| {
            Ok(ArrayFeed { out: ports.array_output("out", like), values })
        });
    }

    /// Binds each of these inputs of `task` to the feed of the same name.
    pub fn bind_feeds(&mut self, task: &str, ports: &[&str]) {
        for port in ports {
            self.bind(&format!("{task}.{port}"), &format!("{port}.out"));
        }
    }

    /// Binds one input.
    pub fn bind(&mut self, input: &str, signal: &str) {
        self.builder.bind(input, signal);
    }

    /// Sets the signal from which every lane takes its mode.
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

/// The records of a run.
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
    /// Every value of a signal with the number of the job that wrote it.
    ///
    /// # Panics
    /// When there is no such signal, or its type is another one.
    #[must_use]
    pub fn values_with_ticks<T: FromRecord>(&self, signal: &str) -> Vec<(u64, T)> {
        let number = self.catalog.find(signal).unwrap_or_else(|| panic!("there is no `{signal}`"));
        let rows = self.rows.iter().filter(|row| row.0 == number);
        let fields = &self.catalog.signals[number].fields;
        let value = |body| T::from_record(fields, body).expect("a value of its type");
        rows.map(|row| (row.1, value(&row.2))).collect()
    }

    /// Every value of a signal.
    ///
    /// # Panics
    /// As [`Run::values_with_ticks`].
    #[must_use]
    pub fn of<T: FromRecord>(&self, signal: &str) -> Vec<T> {
        self.values_with_ticks(signal).into_iter().map(|(_, value)| value).collect()
    }

    /// Every fault that a lane recorded.
    #[must_use]
    pub fn faults(&self) -> FaultSet {
        self.faults
    }
}
