//! Builds chains of small tasks on one lane: a source, hops that pass a value on, and a sink. The
//! tasks do no work of their own, so that the measured time is that of the executor.

use core::hint::black_box;

use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Input, Invalid, Io, LaneSpec, Machine, Nanos, Output, Payload,
    Ports, Recording, Task, bare,
};

taktil_rtcore::payload! {
    /// A small payload of one integer.
    pub struct IntegerPayload {
        /// Number of the job.
        pub count: i32,
    }
}

taktil_rtcore::payload! {
    /// A payload of six numbers, as a joint servo writes it.
    pub struct JointPayload {
        /// Angles, rad.
        pub q_rad: [f64; 6],
    }
}

/// A payload that a source can generate from the number of its job.
pub trait TickPayload: Payload {
    /// The value of job `tick`.
    fn from_tick(tick: u64) -> Self;
}

impl TickPayload for IntegerPayload {
    fn from_tick(tick: u64) -> IntegerPayload {
        #[expect(clippy::cast_possible_truncation, reason = "any number will do")]
        let count = tick as i32;
        IntegerPayload { count }
    }
}

impl TickPayload for JointPayload {
    fn from_tick(tick: u64) -> JointPayload {
        #[expect(clippy::cast_precision_loss, reason = "any number will do")]
        let q = tick as f64;
        JointPayload { q_rad: [q; 6] }
    }
}

struct Source<T>(Output<T>);

impl<T: TickPayload> Task for Source<T> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        io.write(&self.0, T::from_tick(cycle.tick));
        Ok(())
    }
}

struct Hop<T>(Input<T>, Output<T>);

impl<T: Payload> Task for Hop<T> {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let value = io.read(&self.0).value;
        io.write(&self.1, value);
        Ok(())
    }
}

struct Sink<T>(Input<T>);

impl<T: Payload> Task for Sink<T> {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        black_box(io.read(&self.0).value);
        Ok(())
    }
}

/// Which payload a chain carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadKind {
    /// [`IntegerPayload`].
    I32,
    /// [`JointPayload`].
    F64x6,
}

impl PayloadKind {
    /// The payload's type as text.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            PayloadKind::I32 => "i32",
            PayloadKind::F64x6 => "[f64; 6]",
        }
    }
}

/// How a chain is built and run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChainConfig {
    /// Hops between source and sink.
    pub hops: usize,
    /// The payload.
    pub payload: PayloadKind,
    /// What the lane records.
    pub recording: Recording,
    /// Whether each task is timed, as a lane with budgets does.
    pub time_tasks: bool,
}

/// Number of jobs after which records are taken out of the ring, which holds more than that.
pub(super) const JOBS_PER_BATCH: u64 = 250;

/// A chain, ready to run.
pub struct Chain {
    machine: Machine,
    records: u64,
}

struct RecordCounter(u64);

impl Observer for RecordCounter {
    fn record(&mut self, record: &Record<'_>) {
        self.0 += black_box(u64::from(!record.body.is_empty()));
    }
}

fn build<T: TickPayload>(shape: ChainConfig) -> Result<Machine, Invalid> {
    fn boxed<T: Task + 'static>(task: T) -> Result<Box<dyn Task>, Invalid> {
        Ok(Box::new(task))
    }
    let mut builder = Builder::new();
    builder.recording(shape.recording);
    if shape.time_tasks {
        builder.time_tasks();
    }
    let lane = builder.lane(LaneSpec::new("chain", Nanos::from_millis(1), 50))?;
    builder.task(lane, "task0", |ports: &mut Ports| boxed(Source::<T>(ports.output("out"))))?;
    for n in 1..=shape.hops {
        builder.task(lane, &format!("task{n}"), |ports: &mut Ports| {
            boxed(Hop::<T>(ports.input("in"), ports.output("out")))
        })?;
        builder.bind(format!("task{n}.in"), format!("task{}.out", n - 1));
    }
    builder.task(lane, "sink", |ports: &mut Ports| boxed(Sink::<T>(ports.input("in"))))?;
    builder.bind("sink.in", format!("task{}.out", shape.hops));
    builder.build()
}

impl Chain {
    /// Builds and starts a chain.
    ///
    /// # Errors
    /// More hops than a lane has task slots.
    pub fn new(shape: ChainConfig) -> anyhow::Result<Chain> {
        let machine = match shape.payload {
            PayloadKind::I32 => build::<IntegerPayload>(shape),
            PayloadKind::F64x6 => build::<JointPayload>(shape),
        };
        let mut machine = machine.map_err(|invalid| anyhow::anyhow!("{invalid}"))?;
        bare::start(&mut machine).map_err(|(task, _)| anyhow::anyhow!("{task} refused"))?;
        Ok(Chain { machine, records: 0 })
    }

    /// Runs `cycles` jobs of the lane. The records are taken out of the ring between batches of
    /// jobs, as the observing thread does in a live run. `lap` is called with true before each
    /// batch and with false after it, so that it can measure the lane's time.
    pub fn run(&mut self, cycles: u64, mut lap: impl FnMut(bool)) {
        let mut remaining = cycles;
        let mut count = RecordCounter(0);
        while remaining > 0 {
            let jobs = remaining.min(JOBS_PER_BATCH);
            lap(true);
            bare::jobs(&mut self.machine, 0, jobs);
            lap(false);
            self.drain(&mut count);
            remaining -= jobs;
        }
        self.records += count.0;
    }

    /// Runs jobs and leaves their records in the ring.
    pub(super) fn run_undrained(&mut self, jobs: u64) {
        bare::jobs(&mut self.machine, 0, jobs);
    }

    /// Hands the records in the ring to an observer.
    pub(super) fn drain(&mut self, observer: &mut dyn Observer) {
        bare::drain(&mut self.machine, observer);
    }

    /// Number of records taken out of the ring by [`Chain::run`].
    #[must_use]
    pub fn records(&self) -> u64 {
        self.records
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_recorded_or_none() {
        for (recording, payload) in
            [(Recording::Values, PayloadKind::I32), (Recording::Off, PayloadKind::F64x6)]
        {
            let shape = ChainConfig { hops: 6, payload, recording, time_tasks: false };
            let mut chain = Chain::new(shape).unwrap();
            let mut laps = 0;
            chain.run(1000, |_| laps += 1);
            assert_eq!(laps, 2 * 1000 / JOBS_PER_BATCH);
            // A source, six hops and the lane's health.
            let expected = if recording == Recording::Values { 8 * 1000 } else { 0 };
            assert_eq!(chain.records(), expected);
        }
    }

    #[test]
    fn a_chain_longer_than_a_lane_is_refused() {
        let shape = ChainConfig {
            hops: 99,
            payload: PayloadKind::I32,
            recording: Recording::Off,
            time_tasks: false,
        };
        assert!(Chain::new(shape).is_err());
    }
}
