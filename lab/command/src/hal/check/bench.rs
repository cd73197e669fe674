//! Cycles over the open halves, as a lane has them: each half is sampled or committed once a
//! period, each call is timed, and errors and ages are counted.

use std::collections::BTreeMap;

use taktil_hal::{
    AdcCode, CHANNELS, Clock, Counts, DacCode, Devices, Error, ErrorKind, FORCE_TORQUE_CHANNELS,
    IndexPulses, LinesIn, LinesOut, Nanos, TactileFrame,
};
use taktil_rtcore::linux::thread_counters;

use super::array::ArrayRecord;
use super::spread::{LogCounts, Spread};

/// The kinds of errors, in the order of [`HalfRecord::errors`].
pub(super) const ERROR_KINDS: [ErrorKind; 4] =
    [ErrorKind::Transient, ErrorKind::Stale, ErrorKind::OutOfRange, ErrorKind::Lost];

/// From one look at the arrays to the next, at most: the interval of the fastest ones.
const ARRAY_PERIOD: Nanos = Nanos::from_micros(1_000);

/// What was seen of one half.
#[derive(Clone, Debug, Default)]
pub(super) struct HalfRecord {
    /// The longest wait that the half declares.
    pub(super) declared: Nanos,
    /// Whether it is sampled; the others are committed to.
    pub(super) is_input: bool,
    pub(super) calls: u64,
    pub(super) errors: [u64; ERROR_KINDS.len()],
    /// Durations of the calls in which the host did not take the processor away.
    pub(super) durations: LogCounts,
    /// Calls in which it did.
    pub(super) preempted: u64,
    /// The longest of all calls.
    pub(super) longest: Nanos,
    /// From acquisition to release.
    pub(super) ages: LogCounts,
}

impl HalfRecord {
    /// Calls that were answered with an error.
    pub(super) fn failed(&self) -> u64 {
        self.errors.iter().sum()
    }

    fn count(&mut self, error: Error) {
        if let Some(at) = ERROR_KINDS.iter().position(|kind| *kind == error.kind) {
            self.errors[at] += 1;
        }
    }
}

/// The newest value of each half.
#[derive(Clone, Debug, Default)]
pub(super) struct Newest {
    pub(super) counts: Option<[Counts; CHANNELS]>,
    pub(super) pulses: IndexPulses,
    pub(super) codes_in: Option<[AdcCode; CHANNELS]>,
    pub(super) gauges: Option<[AdcCode; FORCE_TORQUE_CHANNELS]>,
    pub(super) lines: Option<LinesIn>,
    /// Whether the newest commit was refused.
    pub(super) commit_failed: bool,
}

/// What is put out from the next cycle on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Orders {
    pub(super) codes: [DacCode; CHANNELS],
    pub(super) enable: bool,
    pub(super) brake_release: bool,
    /// Nothing is committed, as if the program hung.
    pub(super) silent: bool,
}

/// The open halves with their cycles.
pub(super) struct Bench<'a> {
    devices: Devices,
    clock: &'a dyn Clock,
    period: Nanos,
    /// The release of the next cycle.
    pub(super) release: Nanos,
    pub(super) orders: Orders,
    feed: bool,
    /// Whether cycles are recorded.
    pub(super) records: bool,
    pub(super) halves: BTreeMap<String, HalfRecord>,
    pub(super) arrays: BTreeMap<String, ArrayRecord>,
    pub(super) still_counts: Vec<Spread>,
    pub(super) inputs: Vec<Spread>,
    pub(super) gauges: Vec<Spread>,
    /// Readings in which a gauge stood at an end of its converter's range.
    pub(super) over_range_readings: u64,
    frames: BTreeMap<String, TactileFrame>,
    pub(super) newest: Newest,
    /// Releases that had passed before their cycle could begin.
    pub(super) skipped: u64,
    pub(super) cycles: u64,
    /// The newest release at which the arrays were looked at.
    looked: Nanos,
}

impl<'a> Bench<'a> {
    pub(super) fn new(devices: Devices, clock: &'a dyn Clock, period: Nanos) -> Bench<'a> {
        let mut halves = BTreeMap::new();
        let mut add = |name: &str, declared: Option<Nanos>, is_input: bool| {
            if let Some(declared) = declared {
                let record = HalfRecord { declared, is_input, ..HalfRecord::default() };
                halves.insert(name.to_owned(), record);
            }
        };
        add("encoders", devices.encoders.as_ref().map(|half| half.longest_wait()), true);
        add("analog_in", devices.analog_in.as_ref().map(|half| half.longest_wait()), true);
        add("force_torque", devices.force_torque.as_ref().map(|half| half.longest_wait()), true);
        add("digital_in", devices.digital_in.as_ref().map(|half| half.longest_wait()), true);
        for (name, array) in &devices.tactile {
            add(name, Some(array.longest_wait()), true);
        }
        add("analog_out", devices.analog_out.as_ref().map(|half| half.longest_wait()), false);
        add("digital_out", devices.digital_out.as_ref().map(|half| half.longest_wait()), false);
        let (mut arrays, mut frames) = (BTreeMap::new(), BTreeMap::new());
        for (name, array) in &devices.tactile {
            let record = ArrayRecord::new(array.rows(), array.cols(), array.full_scale());
            arrays.insert(name.clone(), record);
            frames.insert(name.clone(), TactileFrame::of(array.as_ref()));
        }
        let safe = devices.analog_out.as_ref().map_or(DacCode(0), |half| half.safe_value());
        let orders = Orders { codes: [safe; CHANNELS], ..Orders::default() };
        let joints = devices.encoders.as_ref().map_or(0, |half| half.joints());
        let inputs = devices.analog_in.as_ref().map_or(0, |half| half.channels());
        let gauges = devices.force_torque.as_ref().map_or(0, |_| FORCE_TORQUE_CHANNELS);
        Bench {
            arrays,
            frames,
            still_counts: vec![Spread::default(); joints],
            inputs: vec![Spread::default(); inputs],
            gauges: vec![Spread::default(); gauges],
            over_range_readings: 0,
            release: clock.now() + period,
            devices,
            clock,
            period,
            orders,
            feed: false,
            records: false,
            halves,
            newest: Newest::default(),
            skipped: 0,
            cycles: 0,
            looked: clock.now(),
        }
    }

    pub(super) fn period(&self) -> Nanos {
        self.period
    }

    pub(super) fn devices(&self) -> &Devices {
        &self.devices
    }

    /// Whether every array has shown a frame.
    pub(super) fn has_all_frames(&self) -> bool {
        self.arrays.values().all(ArrayRecord::has_frame)
    }

    /// One cycle at the next release; arrays are looked at in between as well, so that no frame is
    /// overtaken by the next one.
    pub(super) fn cycle(&mut self) {
        while !self.arrays.is_empty() {
            let look = self.looked + ARRAY_PERIOD;
            if look >= self.release {
                break;
            }
            self.clock.sleep_until(look);
            self.sample_arrays(look.max(self.clock.now().min(self.release - Nanos(1))));
        }
        self.clock.sleep_until(self.release);
        let release = self.release;
        self.sample(release);
        if !self.orders.silent {
            self.commit(release);
        }
        self.cycles += u64::from(self.records);
        self.release += self.period;
        let now = self.clock.now();
        while self.release < now {
            self.release += self.period;
            self.skipped += u64::from(self.records);
        }
    }

    fn sample(&mut self, release: Nanos) {
        let (clock, records) = (self.clock, self.records);
        let mut halves = Timed { halves: &mut self.halves, clock, records };
        if let Some(half) = &mut self.devices.encoders {
            let reading = halves.call("encoders", || half.sample(release));
            if let Some(reading) = reading {
                halves.age("encoders", release - reading.acquired);
                (self.newest.counts, self.newest.pulses) =
                    (Some(reading.value), half.index_pulses());
                let values = reading.value.iter().map(|count| f64::from(count.0));
                add_all(&mut self.still_counts, values, records);
            }
        }
        if let Some(half) = &mut self.devices.analog_in
            && let Some(reading) = halves.call("analog_in", || half.sample(release))
        {
            halves.age("analog_in", release - reading.acquired);
            self.newest.codes_in = Some(reading.value);
            add_all(&mut self.inputs, reading.value.iter().map(|c| f64::from(c.0)), records);
        }
        if let Some(half) = &mut self.devices.force_torque
            && let Some(reading) = halves.call("force_torque", || half.sample(release))
        {
            halves.age("force_torque", release - reading.acquired);
            let codes = reading.value.codes;
            self.newest.gauges = Some(codes);
            self.over_range_readings += u64::from(!reading.value.is_within_range());
            add_all(&mut self.gauges, codes.iter().map(|c| f64::from(c.0)), records);
        }
        if let Some(half) = &mut self.devices.digital_in {
            let reading = halves.call("digital_in", || half.sample(release));
            if let Some(reading) = &reading {
                halves.age("digital_in", release - reading.acquired);
            }
            self.newest.lines = reading.map(|reading| reading.value);
        }
        self.sample_arrays(release);
    }

    fn sample_arrays(&mut self, release: Nanos) {
        self.looked = release;
        let (clock, records) = (self.clock, self.records);
        let mut halves = Timed { halves: &mut self.halves, clock, records };
        for (name, array) in &mut self.devices.tactile {
            let (Some(frame), Some(record)) =
                (self.frames.get_mut(name), self.arrays.get_mut(name))
            else {
                continue;
            };
            let arrival = halves.call(name, || array.sample(release, frame));
            if arrival == Some(taktil_hal::Arrival::New) {
                halves.age(name, release - frame.acquired);
                record.add(frame, release, records);
            }
            record.looked(release);
        }
    }

    fn commit(&mut self, release: Nanos) {
        let (clock, records) = (self.clock, self.records);
        let mut halves = Timed { halves: &mut self.halves, clock, records };
        self.feed = !self.feed;
        let orders = self.orders;
        let lines = LinesOut {
            enable: orders.enable,
            brake_release: orders.brake_release,
            watchdog_feed: self.feed,
        };
        let mut failed = false;
        if let Some(half) = &mut self.devices.analog_out {
            let done = halves.call("analog_out", || half.commit(release, &orders.codes));
            failed |= done.is_none();
        }
        if let Some(half) = &mut self.devices.digital_out {
            let done = halves.call("digital_out", || half.commit(release, &lines));
            failed |= done.is_none();
        }
        self.newest.commit_failed = failed;
    }

    /// The codes at which the actuators do no harm.
    pub(super) fn safe_codes(&self) -> [DacCode; CHANNELS] {
        let safe = self.devices.analog_out.as_ref().map_or(DacCode(0), |half| half.safe_value());
        [safe; CHANNELS]
    }

    /// Puts all outputs at their safe values.
    pub(super) fn safe(&mut self) -> Result<(), Error> {
        self.devices.safe()
    }
}

fn add_all(spreads: &mut [Spread], values: impl Iterator<Item = f64>, records: bool) {
    if records {
        for (spread, value) in spreads.iter_mut().zip(values) {
            spread.add(value);
        }
    }
}

/// Calls of halves with their times.
struct Timed<'a> {
    halves: &'a mut BTreeMap<String, HalfRecord>,
    clock: &'a dyn Clock,
    records: bool,
}

impl Timed<'_> {
    fn call<T>(&mut self, name: &str, call: impl FnOnce() -> Result<T, Error>) -> Option<T> {
        let before = (thread_counters().preemptions, self.clock.now());
        let answer = call();
        let took = self.clock.now() - before.1;
        let preempted = thread_counters().preemptions != before.0;
        if self.records
            && let Some(half) = self.halves.get_mut(name)
        {
            half.calls += 1;
            half.longest = half.longest.max(took);
            if preempted {
                half.preempted += 1;
            } else {
                half.durations.add(took);
            }
            if let Err(error) = &answer {
                half.count(*error);
            }
        }
        answer.ok()
    }

    fn age(&mut self, name: &str, age: Nanos) {
        if self.records
            && let Some(half) = self.halves.get_mut(name)
        {
            half.ages.add(age);
        }
    }
}
