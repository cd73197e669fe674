//! Runs empty lanes on the real executor, slice by slice, and adds up their counts.

use std::sync::atomic::AtomicBool;

use anyhow::anyhow;
use hdrhistogram::Histogram;
use taktil_rtcore::live::{self, Attestation, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Figures, Guard, GuardFigures, Invalid, Io, LaneSpec, Machine,
    Misses, Nanos, Task,
};

use taktil_machine_console::option::BadOption;

/// A task that does nothing, so that only the executor is measured.
struct EmptyTask;

impl Task for EmptyTask {
    fn step(&mut self, _cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        Ok(())
    }
}

/// An observer that ignores all records.
struct NullObserver;

impl Observer for NullObserver {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for NullObserver {}

/// The measured lanes.
#[derive(Clone, Debug)]
pub struct Lanes {
    /// The lanes in order of priority.
    pub specs: Vec<LaneSpec>,
}

/// Allowed rates of a lane, Hz.
const RATE_RANGE_HZ: core::ops::RangeInclusive<f64> = 1.0..=20_000.0;

impl Lanes {
    /// One lane for each rate. The phases differ from that of the first lane, so that no lane waits
    /// for the job of another.
    ///
    /// # Errors
    /// [`BadOption`] with the option's name.
    pub fn new(
        rates_hz: &[f64],
        priority: u8,
        phase: Nanos,
        cpu: Option<usize>,
        guard: Option<f64>,
    ) -> Result<Lanes, BadOption> {
        let bad = |what: String| Err(BadOption(what));
        if rates_hz.is_empty() || rates_hz.len() > usize::from(priority) {
            return bad(format!("--rate-hz: {} lanes at priority {priority}", rates_hz.len()));
        }
        if let Some(rate) = rates_hz.iter().find(|rate| !RATE_RANGE_HZ.contains(rate)) {
            let (low, high) = (RATE_RANGE_HZ.start(), RATE_RANGE_HZ.end());
            return bad(format!("--rate-hz {rate}: give {low} to {high}"));
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most 1e9")]
        let period = |rate: f64| Nanos((1e9 / rate).round() as i64);
        let shortest = rates_hz.iter().map(|rate| period(*rate).0).min().unwrap_or(1);
        let step = shortest / i64::try_from(rates_hz.len()).unwrap_or(1);
        let mut specs = Vec::new();
        for (index, rate) in (0u8..).zip(rates_hz) {
            let period = period(*rate);
            let guard = guard.map(|share| Guard::from_cpu_share(share, period)).transpose();
            let guard =
                guard.map_err(|invalid| BadOption(format!("--guard: {}", text(&invalid))))?;
            let mut spec = LaneSpec::new(format!("lane{index}"), period, priority - index);
            spec.phase = phase + Nanos(step * i64::from(index));
            spec.cpu = cpu;
            spec.guard = guard;
            let option = |place: &str| if place == "phase_us" { "--phase-us" } else { "--rate-hz" };
            spec.check()
                .map_err(|bad| BadOption(format!("{}: {}", option(&bad.place), text(&bad))))?;
            specs.push(spec);
        }
        Ok(Lanes { specs })
    }

    fn machine(&self) -> Result<Machine, Invalid> {
        let mut builder = Builder::new();
        for (index, spec) in self.specs.iter().enumerate() {
            let lane = builder.lane(spec.clone())?;
            builder.task(lane, &format!("empty{index}"), |_ports| Ok(Box::new(EmptyTask)))?;
        }
        builder.build()
    }
}

fn text(invalid: &Invalid) -> String {
    format!("{}; {}", invalid.what, invalid.remedy)
}

/// Nanoseconds, 1 ns to 100 s at three digits.
#[must_use]
pub fn histogram() -> Histogram<u64> {
    Histogram::new_with_bounds(1, 100_000_000_000, 3).expect("constant bounds are valid")
}

/// The counts of one lane over all slices.
#[derive(Clone, Debug)]
pub struct LaneTotals {
    /// The specification of the lane.
    pub spec: LaneSpec,
    /// Begin of a job minus its release, ns.
    pub late: Histogram<u64>,
    /// Lateness of the end of a sleep, ns.
    pub wake: Histogram<u64>,
    /// Time from release to sleep without the spin, ns; with an empty task this is the time of the
    /// executor.
    pub awake: Histogram<u64>,
    /// The same for cycles in which the evidence for misses was read, ns.
    pub evidence: Histogram<u64>,
    /// Time of the job alone, ns.
    pub execution: Histogram<u64>,
    /// Number of jobs that ran.
    pub jobs: u64,
    /// Number of jobs left out.
    pub skipped: u64,
    /// Number of jobs that missed, by cause.
    pub misses: Misses,
    /// Page faults from the end of one job to the end of the next.
    pub page_faults: u64,
    /// Heap calls inside jobs.
    pub allocations: u64,
    /// Counts of the release guard.
    pub guard: Option<GuardFigures>,
}

impl LaneTotals {
    fn new(spec: &LaneSpec) -> LaneTotals {
        LaneTotals {
            spec: spec.clone(),
            late: histogram(),
            wake: histogram(),
            awake: histogram(),
            evidence: histogram(),
            execution: histogram(),
            jobs: 0,
            skipped: 0,
            misses: Misses::default(),
            page_faults: 0,
            allocations: 0,
            guard: None,
        }
    }

    fn add_figures(&mut self, figures: &Figures) {
        add_counts(&mut self.late, &figures.lateness_ns);
        add_counts(&mut self.wake, &figures.wake_ns);
        add_counts(&mut self.awake, &figures.awake_ns);
        add_counts(&mut self.evidence, &figures.evidence_ns);
        add_counts(&mut self.execution, &figures.execution_ns);
        self.jobs += figures.jobs;
        self.skipped += figures.skipped;
        self.page_faults += figures.page_faults;
        self.allocations += figures.allocations;
        self.misses = self.misses.plus(&figures.misses);
        if let Some(new) = figures.guard {
            let sum = self.guard.get_or_insert_default();
            sum.spun += new.spun;
            sum.over += new.over;
            sum.early += new.early;
            sum.margin = new.margin;
        }
    }
}

/// Adds counts value by value; the two histograms may differ in resolution.
pub(super) fn add_counts(to: &mut Histogram<u64>, from: &Histogram<u64>) {
    for step in from.iter_recorded() {
        to.saturating_record_n(step.value_iterated_to(), step.count_at_value());
    }
}

/// The sum of all slices.
#[derive(Clone, Debug)]
pub struct Measurement {
    /// Lane by lane.
    pub lanes: Vec<LaneTotals>,
    /// What the kernel granted in the last slice.
    pub attestation: Attestation,
}

impl Measurement {
    /// A measurement without slices.
    #[must_use]
    pub fn new(lanes: &Lanes) -> Measurement {
        let sums = lanes.specs.iter().map(LaneTotals::new).collect();
        Measurement { lanes: sums, attestation: Attestation::default() }
    }

    /// Runs the lanes for a slice; returns the lateness of the releases of the first lane, ns.
    ///
    /// # Errors
    /// A thread for a lane cannot be created.
    pub fn run_slice(
        &mut self,
        lanes: &Lanes,
        long: Nanos,
        stop: &AtomicBool,
    ) -> anyhow::Result<Histogram<u64>> {
        let mut machine = lanes.machine().map_err(|invalid| anyhow!("{invalid}"))?;
        let terms = RunOptions { until: long, contract: Contract::Soft, pace: Pace::Fixed };
        let account = live::run(&mut machine, terms, stop, &mut NullObserver)?;
        self.attestation = account.attestation;
        let mut first = histogram();
        for (index, (_, figures)) in machine.figures().enumerate() {
            self.lanes[index].add_figures(figures);
            if index == 0 {
                add_counts(&mut first, &figures.lateness_ns);
            }
        }
        Ok(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_descend_in_priority_and_stand_apart() {
        let lanes = Lanes::new(&[400.0, 200.0], 80, Nanos::ZERO, Some(0), Some(0.1)).unwrap();
        let (fast, slow) = (&lanes.specs[0], &lanes.specs[1]);
        assert_eq!((fast.period, slow.period), (Nanos(2_500_000), Nanos(5_000_000)));
        assert_eq!((fast.priority, slow.priority), (80, 79));
        assert_eq!((fast.phase, slow.phase), (Nanos::ZERO, Nanos(1_250_000)));
        assert_eq!(fast.guard.unwrap().spin_max, Nanos(250_000));
        assert_eq!(slow.cpu, Some(0));
        assert!(Lanes::new(&[400.0, 200.0], 1, Nanos::ZERO, None, None).is_err(), "none left");
    }

    #[test]
    fn sums_keep_every_count() {
        let mut from = Histogram::new_with_bounds(1, 1_000_000, 2).unwrap();
        from.record_n(10, 3).unwrap();
        from.record(500_000).unwrap();
        let mut to = histogram();
        add_counts(&mut to, &from);
        add_counts(&mut to, &from);
        assert_eq!(to.len(), 8);
        assert_eq!(to.value_at_quantile(0.5), 10);
    }
}
