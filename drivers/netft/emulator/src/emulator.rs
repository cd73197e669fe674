//! A box on a link with faults: requests in, records out, each at its instant.

use std::collections::VecDeque;

use taktil_hal::fault::{Fault, FaultCounts, FaultKind, FaultPlan, SplitMix};
use taktil_hal::{FORCE_TORQUE_CHANNELS, Nanos};

/// The kinds of faults that a box on its link executes.
pub const EXECUTED_FAULTS: [FaultKind; 10] = [
    FaultKind::Loss,
    FaultKind::Duplication,
    FaultKind::Reordering,
    FaultKind::Delay,
    FaultKind::Truncation,
    FaultKind::Silence,
    FaultKind::Unplugged,
    FaultKind::Restart,
    FaultKind::Frozen,
    FaultKind::Failing,
];

/// The status of a record whose reading failed.
pub const FAILURE_STATUS: u32 = 0x8002_0000;
/// How far a box that is seldom asked makes up for the time that has passed; what is older was
/// sent to nobody.
const CATCH_UP_TIME: Nanos = Nanos::from_millis(200);

/// What the sensor measures at an instant: Fx, Fy, Fz, Tx, Ty, Tz in counts.
pub type Sensor = Box<dyn FnMut(Nanos) -> [i32; FORCE_TORQUE_CHANNELS] + Send>;

/// What passed through the link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Datagrams that came, those lost to a fault included.
    pub requests: u64,
    /// Records that left.
    pub records: u64,
    /// Messages and readings that faults befell.
    pub faults: FaultCounts,
}

/// A record on its way.
#[derive(Clone, Debug)]
struct Datagram {
    due: Nanos,
    bytes: Vec<u8>,
}

/// A box, the sensor behind it and the link before it.
pub struct Emulator {
    period: Nanos,
    /// Absent where the caller tells what is measured; see [`Emulator::set_counts`].
    sensor: Option<Sensor>,
    measured: [i32; FORCE_TORQUE_CHANNELS],
    /// When power came on; samples are counted from there.
    powered: Nanos,
    /// The next record, and how many are still to come; 0 for no end.
    next: Option<(Nanos, u32)>,
    rdt_sequence: u32,
    bias: [i32; FORCE_TORQUE_CHANNELS],
    frozen: [i32; FORCE_TORQUE_CHANNELS],
    plan: FaultPlan,
    target: String,
    random: SplitMix,
    restarts: Vec<Nanos>,
    way: VecDeque<Datagram>,
    /// A record that the next one overtakes.
    overtaken: Option<Vec<u8>>,
    traffic: Traffic,
}

impl std::fmt::Debug for Emulator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Emulator").field("next", &self.next).finish_non_exhaustive()
    }
}

impl Emulator {
    /// Switches a box on that sends `rate_hz` records a second when it is asked to.
    #[must_use]
    pub fn new(rate_hz: u32, sensor: Sensor) -> Emulator {
        Emulator { sensor: Some(sensor), ..Emulator::without_sensor(rate_hz) }
    }

    /// Switches a box on whose caller tells what its sensor measures.
    #[must_use]
    pub fn without_sensor(rate_hz: u32) -> Emulator {
        Emulator {
            period: Nanos(1_000_000_000 / i64::from(rate_hz.max(1))),
            sensor: None,
            measured: [0; FORCE_TORQUE_CHANNELS],
            powered: Nanos::ZERO,
            next: None,
            rdt_sequence: 0,
            bias: [0; FORCE_TORQUE_CHANNELS],
            frozen: [0; FORCE_TORQUE_CHANNELS],
            plan: FaultPlan::default(),
            target: String::new(),
            random: SplitMix::new(0),
            restarts: Vec::new(),
            way: VecDeque::new(),
            overtaken: None,
            traffic: Traffic::default(),
        }
    }

    /// The same box on a link with the faults of `plan` that befall `target`; which messages they
    /// hit is drawn from `seed`.
    #[must_use]
    pub fn with_faults(mut self, plan: FaultPlan, target: &str, seed: u64) -> Emulator {
        let ours = |fault: &&Fault| {
            fault.kind == FaultKind::Restart && (fault.target.is_empty() || fault.target == target)
        };
        self.restarts = plan.faults().iter().filter(ours).map(|fault| fault.at).collect();
        self.restarts.sort();
        self.plan = plan;
        self.target = target.to_owned();
        self.random = SplitMix::new(seed);
        self
    }

    fn strength(&self, kind: FaultKind, now: Nanos) -> Option<f64> {
        self.plan.strength(kind, &self.target, now)
    }

    fn befalls(&mut self, kind: FaultKind, now: Nanos) -> bool {
        let Some(probability) = self.strength(kind, now) else { return false };
        let befallen = self.random.unit() < probability;
        if befallen {
            self.traffic.faults.add(kind);
        }
        befallen
    }

    /// Whether a datagram at `now` cannot pass; counts it.
    fn is_cut_off(&mut self, now: Nanos) -> bool {
        let kinds = [FaultKind::Silence, FaultKind::Unplugged];
        let cut = kinds.into_iter().find(|kind| self.strength(*kind, now).is_some());
        cut.map(|kind| self.traffic.faults.add(kind)).is_some()
    }

    /// Takes a datagram that arrives at `now`, which must not run backwards.
    pub fn receive(&mut self, now: Nanos, packet: &[u8]) {
        self.advance(now);
        self.traffic.requests += 1;
        if self.is_cut_off(now) || self.befalls(FaultKind::Loss, now) {
            return;
        }
        let [0x12, 0x34, high, low, count @ ..] = packet else { return };
        let Ok(count) = <[u8; 4]>::try_from(count) else { return };
        match u16::from_be_bytes([*high, *low]) {
            0x0000 => self.next = None,
            0x0002 => {
                self.rdt_sequence = 0;
                self.next = Some((self.sample_after(now), u32::from_be_bytes(count)));
            }
            0x0042 => self.bias = self.sense(now),
            _ => {}
        }
    }

    /// Tells what the sensor measures from now on, for a box without a sensor of its own.
    pub fn set_counts(&mut self, counts: [i32; FORCE_TORQUE_CHANNELS]) {
        self.measured = counts;
    }

    fn sense(&mut self, now: Nanos) -> [i32; FORCE_TORQUE_CHANNELS] {
        if let Some(sensor) = &mut self.sensor {
            self.measured = sensor(now);
        }
        self.measured
    }

    /// The instant of the first sample after `now`.
    fn sample_after(&self, now: Nanos) -> Nanos {
        let samples = (now - self.powered).0.div_euclid(self.period.0) + 1;
        self.powered + self.period * samples
    }

    fn advance(&mut self, now: Nanos) {
        while self.restarts.first().is_some_and(|at| *at <= now) {
            let at = self.restarts.remove(0);
            self.measure(at);
            self.traffic.faults.add(FaultKind::Restart);
            self.powered = at;
            (self.next, self.rdt_sequence) = (None, 0);
            self.bias = [0; FORCE_TORQUE_CHANNELS];
            self.overtaken = None;
        }
        self.measure(now);
    }

    /// Makes every record up to `now`.
    fn measure(&mut self, now: Nanos) {
        while let Some((due, count)) = self.next.filter(|(due, _)| *due <= now) {
            let missed = (now - CATCH_UP_TIME - due).0 / self.period.0;
            if missed > 0 {
                self.rdt_sequence = self.rdt_sequence.wrapping_add(missed as u32);
                self.next = Some((due + self.period * missed, count));
                continue;
            }
            self.record(due);
            self.next = (count != 1).then(|| (due + self.period, count.saturating_sub(1)));
        }
    }

    fn record(&mut self, now: Nanos) {
        self.rdt_sequence = self.rdt_sequence.wrapping_add(1);
        if self.strength(FaultKind::Frozen, now).is_some() {
            self.traffic.faults.add(FaultKind::Frozen);
        } else {
            self.frozen = self.sense(now);
        }
        let status = if self.befalls(FaultKind::Failing, now) { FAILURE_STATUS } else { 0 };
        let samples = ((now - self.powered).0 / self.period.0) as u32;
        let mut bytes = Vec::with_capacity(36);
        for word in [self.rdt_sequence, samples, status] {
            bytes.extend(word.to_be_bytes());
        }
        for (count, zero) in self.frozen.iter().zip(self.bias) {
            bytes.extend(count.wrapping_sub(zero).to_be_bytes());
        }
        self.send(now, bytes);
    }

    fn send(&mut self, now: Nanos, mut bytes: Vec<u8>) {
        if self.is_cut_off(now) || self.befalls(FaultKind::Loss, now) {
            return;
        }
        if self.befalls(FaultKind::Truncation, now) {
            bytes.truncate(self.random.below(bytes.len()));
        }
        let delay = self.strength(FaultKind::Delay, now);
        if delay.is_some() {
            self.traffic.faults.add(FaultKind::Delay);
        }
        let due = now + Nanos((1e9 * delay.unwrap_or(0.0)) as i64);
        if self.overtaken.is_none() && self.befalls(FaultKind::Reordering, now) {
            self.overtaken = Some(bytes);
            return;
        }
        let twice = self.befalls(FaultKind::Duplication, now);
        for _ in 0..=usize::from(twice) {
            self.insert(Datagram { due, bytes: bytes.clone() });
        }
        if let Some(bytes) = self.overtaken.take() {
            self.insert(Datagram { due, bytes });
        }
    }

    fn insert(&mut self, datagram: Datagram) {
        let at = self.way.partition_point(|other| other.due <= datagram.due);
        self.way.insert(at, datagram);
    }

    /// Gives the records that are due at `now`, oldest first.
    pub fn poll(&mut self, now: Nanos, records: &mut Vec<Vec<u8>>) {
        self.advance(now);
        while let Some(datagram) = self.way.pop_front_if(|datagram| datagram.due <= now) {
            self.traffic.records += 1;
            records.push(datagram.bytes);
        }
    }

    /// When the box does something next by itself, if anything is to come.
    #[must_use]
    pub fn next_due(&self) -> Option<Nanos> {
        let way = self.way.front().map(|datagram| datagram.due);
        let next = self.next.map(|(due, _)| due);
        [way, next, self.restarts.first().copied()].into_iter().flatten().min()
    }

    /// What passed through the link since power came on.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.traffic
    }
}
