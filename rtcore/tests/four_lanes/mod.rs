//! A machine of four lanes on two processors whose runs could not repeat by chance: devices answer
//! with the real time, jobs overrun on purpose, a task panics, and a device fails now and then. It
//! is run live, recorded, and repeated from the record.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::AtomicBool;

use taktil_rtcore::linux::monotonic;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::replay::{self, RecordedRun};
use taktil_rtcore::trace::Decision;
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Input, Invalid, Io, LaneSpec, Machine, Nanos, Output, Payload,
    Ports, StateHash, Tape, Task, payload,
};

payload! {
    /// What a device answered.
    pub struct Answer {
        /// value
        pub value: f64,
        /// 1 when it failed
        pub failed: u32,
    }
}

payload! {
    /// A number that flows between tasks.
    pub struct Number {
        /// value
        pub value: f64,
        /// how often it was written
        pub count: u64,
    }
}

/// One record, as it came.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RecordedValue {
    /// Number of the signal.
    pub(crate) signal: usize,
    /// Job.
    pub(crate) tick: u64,
    /// Release of that job.
    pub(crate) release: Nanos,
    /// Encoded value.
    pub(crate) body: Vec<u8>,
}

/// Every record of a run.
#[derive(Clone, Default)]
pub(crate) struct Kept(pub(crate) Vec<RecordedValue>);

impl Observer for Kept {
    fn record(&mut self, record: &Record<'_>) {
        let (signal, tick, release) = (record.signal, record.tick, record.release);
        self.0.push(RecordedValue { signal, tick, release, body: record.body.to_vec() });
    }
}

impl RunObserver for Kept {}

impl Kept {
    /// Hands every record on.
    pub(crate) fn play(&self, observer: &mut dyn Observer) {
        for RecordedValue { signal, tick, release, body } in &self.0 {
            observer.record(&Record { signal: *signal, tick: *tick, release: *release, body });
        }
    }

    /// The records of the jobs released before `until`, signal by signal in the order of time.
    fn by_signal(&self, until: Nanos) -> BTreeMap<usize, Vec<&RecordedValue>> {
        let mut all: BTreeMap<usize, Vec<&RecordedValue>> = BTreeMap::new();
        for row in self.0.iter().filter(|row| row.release < until) {
            all.entry(row.signal).or_default().push(row);
        }
        all
    }

    /// Where two runs part first, in time and then in the catalog: signal, tick, both bodies.
    pub(crate) fn difference(
        &self,
        other: &Kept,
        catalog: &Catalog,
        until: Nanos,
    ) -> Option<String> {
        let (ours, theirs) = (self.by_signal(until), other.by_signal(until));
        let none = Vec::new();
        let mut found: Option<(Nanos, String)> = None;
        for (number, signal) in catalog.signals.iter().enumerate() {
            let (a, b) = (ours.get(&number).unwrap_or(&none), theirs.get(&number).unwrap_or(&none));
            let parted = (0..a.len().max(b.len())).find(|&i| a.get(i) != b.get(i));
            let Some(index) = parted else { continue };
            let row = a.get(index).or(b.get(index)).expect("one of them is longer");
            if found.as_ref().is_none_or(|(at, _)| row.release < *at) {
                let (a, b) = (a.get(index).map(|r| &r.body), b.get(index).map(|r| &r.body));
                let text = format!("{} at tick {}: {a:?} against {b:?}", signal.name, row.tick);
                found = Some((row.release, text));
            }
        }
        found.map(|(_, text)| text)
    }
}

/// A device: live it answers with the time, repeated from its tape.
enum Device {
    Live,
    Taped(VecDeque<RecordedValue>),
}

impl Device {
    fn sample(&mut self, release: Nanos) -> Answer {
        match self {
            Device::Live => {
                let now = monotonic().0;
                let failed = u32::from(now.rem_euclid(7) == 0);
                Answer { value: (now % 1_000_000_000) as f64 * 1e-9, failed }
            }
            Device::Taped(rows) => {
                let row = rows.pop_front().expect("the tape has an answer for each job");
                assert_eq!(row.release, release, "the tape is at another job");
                Answer::decode(&row.body).unwrap()
            }
        }
    }
}

/// Reads a device; keeps a running mean.
struct Sense {
    device: Device,
    tape: Tape<Answer>,
    mean: f64,
    count: u64,
    out: Output<Number>,
}

impl Task for Sense {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let answer = self.device.sample(cycle.release);
        self.tape.append(cycle.release, answer);
        if answer.failed == 1 {
            return Err(FaultCode::EncoderLost);
        }
        self.count += 1;
        self.mean += (answer.value - self.mean) / 64.0;
        io.write(&self.out, Number { value: self.mean, count: self.count });
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.mean).add(&self.count);
    }
}

/// What a [`Law`] does out of the ordinary.
#[derive(Clone, Copy, Default)]
struct Habit {
    /// Every so many ticks it keeps the processor for so long.
    overrun: Option<(u64, Nanos)>,
    /// Panics in the first job at or after this release.
    panics_at: Option<Nanos>,
    /// Writes only when its sum falls into the lower half.
    moody: bool,
}

/// Mixes what it reads, with a memory, and says how fresh it was.
struct Law {
    from: Vec<Input<Number>>,
    sum: f64,
    count: u64,
    habit: Habit,
    out: Output<Number>,
}

impl Task for Law {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        for input in &self.from {
            let sample = io.read(input);
            self.sum = 0.75 * self.sum + sample.value.value;
            self.count = self.count.wrapping_mul(31) + sample.freshness as u64;
            self.sum += sample.age.as_secs_f64();
        }
        assert!(self.habit.panics_at.is_none_or(|at| cycle.release < at), "on purpose");
        if let Some((every, length)) = self.habit.overrun
            && cycle.tick % every == every - 1
        {
            let end = monotonic() + length;
            while monotonic() < end {}
        }
        if !(self.habit.moody && self.sum.to_bits() & 1 == 1) {
            io.write(&self.out, Number { value: self.sum, count: self.count });
        }
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.sum).add(&self.count);
    }
}

/// Builds the machine; with `tapes` its devices answer from there, and nobody overruns.
struct Maker<'a> {
    builder: Builder,
    tapes: Option<(&'a Kept, Catalog)>,
}

impl Maker<'_> {
    fn sense(&mut self, lane: taktil_rtcore::LaneId, name: &str, tape: &str) {
        let device = match &self.tapes {
            None => Device::Live,
            Some((kept, catalog)) => {
                let number = catalog.find(tape).unwrap();
                let rows = kept.0.iter().filter(|row| row.signal == number);
                Device::Taped(rows.cloned().collect())
            }
        };
        let make = |ports: &mut Ports| -> Result<Box<dyn Task>, Invalid> {
            let (tape, out) = (ports.tape(tape), ports.output("number"));
            Ok(Box::new(Sense { device, tape, mean: 0.0, count: 0, out }))
        };
        self.builder.task(lane, name, make).unwrap();
    }

    fn law(&mut self, lane: taktil_rtcore::LaneId, name: &str, from: &[&str], habit: Habit) {
        const NAMES: [&str; 4] = ["a", "b", "c", "d"];
        let mut habit = habit;
        if self.tapes.is_some() {
            habit.overrun = None;
        }
        let make = |ports: &mut Ports| -> Result<Box<dyn Task>, Invalid> {
            let from = NAMES[..from.len()].iter().map(|input| ports.input_delayed(input)).collect();
            let out = ports.output("number");
            Ok(Box::new(Law { from, sum: 0.0, count: 0, habit, out }))
        };
        self.builder.task(lane, name, make).unwrap();
        for (input, signal) in NAMES.iter().zip(from) {
            self.builder.bind(format!("{name}.{input}"), format!("{signal}.number"));
        }
    }
}

fn lane(name: &str, period_us: i64, priority: u8, cpu: usize) -> LaneSpec {
    let mut spec = LaneSpec::new(name, Nanos::from_micros(period_us), priority);
    spec.cpu = Some(cpu);
    spec.delivery = spec.period * 4;
    spec.delivery = Nanos(spec.delivery.0 / 5);
    spec.deadline = spec.delivery;
    spec
}

/// 1 kHz and 200 Hz on CPU 0, 400 Hz and 50 Hz on CPU 1; values cross in every direction.
pub(crate) fn machine(tapes: Option<&Kept>, stall: Nanos) -> Machine {
    let mut plain = Maker { builder: Builder::new(), tapes: None };
    fill(&mut plain);
    let plain = plain.builder.build().unwrap();
    let Some(kept) = tapes else { return plain };
    let catalog = plain.catalog().clone();
    let mut maker = Maker { builder: Builder::new(), tapes: Some((kept, catalog)) };
    fill(&mut maker);
    maker.builder.for_replay(stall);
    maker.builder.build().unwrap()
}

fn fill(maker: &mut Maker<'_>) {
    let fast = maker.builder.lane(lane("fast", 1000, 50, 0)).unwrap();
    let servo = maker.builder.lane(lane("servo", 2500, 45, 1)).unwrap();
    let touch = maker.builder.lane(lane("touch", 5000, 40, 0)).unwrap();
    let plan = maker.builder.lane(lane("plan", 20_000, 35, 1)).unwrap();
    let plain = Habit::default();
    let busy = |every, us| Habit { overrun: Some((every, Nanos::from_micros(us))), ..plain };
    maker.sense(fast, "gyro", "hal.gyro");
    maker.law(fast, "rate", &["gyro", "law", "route"], busy(97, 3200));
    maker.sense(servo, "arm", "hal.arm");
    maker.law(servo, "law", &["arm", "rate", "skin", "route"], busy(61, 4100));
    maker.law(servo, "frail", &["rate"], Habit { panics_at: Some(Nanos(400_000_000)), ..plain });
    maker.sense(touch, "array", "hal.array");
    maker.law(touch, "skin", &["array", "rate"], Habit { moody: true, ..busy(37, 7000) });
    maker.law(plan, "route", &["law", "skin", "rate", "frail"], busy(11, 25_000));
}

/// A live run at the fixed pace of boards, recorded.
pub(crate) fn run_live(until: Nanos) -> (Machine, Kept) {
    let mut machine = machine(None, Nanos::ZERO);
    let mut kept = Kept::default();
    let terms = RunOptions { until, contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, terms, &AtomicBool::new(false), &mut kept).unwrap();
    (machine, kept)
}

/// What a replay gave: its records, and until when the recording was whole.
pub(crate) fn repeat(recorded: &Kept, lanes: &[LaneSpec]) -> (Machine, Kept, Nanos) {
    let catalog = machine(None, Nanos::ZERO).catalog().clone();
    let mut script = RecordedRun::new(&catalog, &[]);
    recorded.play(&mut script);
    let until = script.gap(lanes.iter(), false).map_or(Nanos::MAX, |gap| gap.until);
    let stall = script.longest_pause(lanes.iter());
    let mut machine = machine(Some(recorded), stall);
    let mut kept = Kept::default();
    let stop = AtomicBool::new(false);
    replay::run(&mut machine, &script, &[], until, &stop, &mut kept).unwrap();
    (machine, kept, until)
}

/// Jobs left out, and signals that were held later than due, as the decisions say.
pub(crate) fn skips_and_lags(kept: &Kept, catalog: &Catalog) -> (u64, u64) {
    let mut sums = (0, 0);
    for row in &kept.0 {
        if catalog.signals[row.signal].type_name == Decision::NAME {
            let decision = Decision::decode(&row.body).unwrap();
            sums.0 += u64::from(decision.skipped);
            sums.1 += decision.lags.iter().filter(|lag| **lag > 0).count() as u64;
        }
    }
    sums
}
