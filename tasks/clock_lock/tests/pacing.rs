//! The releases of a machine follow a board's clock that drifts, through the schedule, its pacer
//! and its records: on a simulated host in virtual time, on the kernel's clock, and in a replay
//! without the board.
#![expect(clippy::disallowed_types, reason = "a test shares the host's clock with the board")]

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use taktil_hal::fault::SplitMix;
use taktil_hal::{BoardClock, Clock, Error, ErrorKind, Reading, phase_in_cycle};
use taktil_rtcore::linux::MonotonicClock;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Catalog, Observer, Record};
use taktil_rtcore::replay::{self, RecordedRun};
use taktil_rtcore::status::{LaneHealth, PaceStatus};
use taktil_rtcore::virtual_time::{JobTiming, VirtualHost, run_on_host};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, Input, Io, LaneSpec, Machine, Nanos, Output, Payload, Tape, Task,
    payload,
};
use taktil_tasks_clock_lock::{ClockLock, Config};

const JOB_PERIOD: Nanos = Nanos::from_millis(1);
const LOCK_WINDOW: Nanos = Nanos::from_micros(25);
/// Jobs begin at most this late on the simulated host: 20 us on either side of their mean.
const LATENESS_MAX_NS: usize = 40_000;
/// Jobs until the loop has settled from anywhere.
const SETTLING_JOBS: u64 = 20_000;

payload! {
    /// What the board answered; an answer that failed has no phase.
    pub struct PhaseEntry {
        /// phase (ns)
        pub phase_ns: i64,
        /// 1 when it failed
        pub failed: u32,
    }
}

payload! {
    /// What a slower lane saw.
    pub struct Seen {
        /// the correction (ns)
        pub correction_ns: i64,
    }
}

/// The clock of a board beside a host's: fast by `ppm`, and recorded.
struct DriftingBoard {
    host: Arc<Mutex<Nanos>>,
    live: Option<MonotonicClock>,
    ppm: i64,
    /// Every so manieth answer fails; none for 0.
    failing: i64,
    newest: Option<Reading<Nanos>>,
    tape: Tape<PhaseEntry>,
}

/// Where the place of the jobs is in the board's cycle at the start.
const OFFSET_NS: i64 = 300_000;

impl BoardClock for DriftingBoard {
    fn cycle(&self) -> Nanos {
        JOB_PERIOD
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        let host = match &self.live {
            Some(clock) => clock.now(),
            None => *self.host.lock().unwrap(),
        };
        let board = host.0 + host.0 / 1_000 * self.ppm / 1_000 + OFFSET_NS + 1_000_000_000;
        let phase = phase_in_cycle(board.cast_unsigned(), JOB_PERIOD);
        let job = release.0 / JOB_PERIOD.0;
        if self.failing > 0 && job % self.failing == 0 {
            self.tape.append(release, PhaseEntry { phase_ns: 0, failed: 1 });
            return Err(Error::whole(ErrorKind::Transient, "test.board_clock"));
        }
        self.tape.append(release, PhaseEntry { phase_ns: phase.0, failed: 0 });
        let reading = Reading { value: phase, acquired: release };
        self.newest = Some(reading);
        Ok(reading)
    }
}

/// Answers what was recorded.
struct Playback {
    entries: std::vec::IntoIter<PhaseEntry>,
    tape: Tape<PhaseEntry>,
}

impl BoardClock for Playback {
    fn cycle(&self) -> Nanos {
        JOB_PERIOD
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        let lost = Error::whole(ErrorKind::Lost, "test.board_clock");
        let entry = self.entries.next().ok_or(lost)?;
        self.tape.append(release, entry);
        if entry.failed == 1 {
            return Err(lost);
        }
        Ok(Reading { value: Nanos(entry.phase_ns), acquired: release })
    }
}

/// A task of a slower lane that reads the pace.
struct Reader {
    pace: Input<PaceStatus>,
    seen: Output<Seen>,
}

impl Task for Reader {
    fn step(&mut self, _cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let correction_ns = io.read(&self.pace).value.correction_ns;
        io.write(&self.seen, Seen { correction_ns });
        Ok(())
    }
}

/// A lane that is paced, and a slower one beside it.
fn machine(clock: impl FnOnce(Tape<PhaseEntry>) -> Box<dyn BoardClock>) -> Machine {
    let mut builder = Builder::new();
    let fast = builder.lane(LaneSpec::new("fast", JOB_PERIOD, 60)).unwrap();
    let config = Config { window_us: LOCK_WINDOW.0 / 1_000, ..Config::default() };
    builder
        .task(fast, "clock_lock", |ports| {
            let clock = clock(ports.tape("hal.board_clock"));
            Ok(Box::new(ClockLock::new(config, clock, JOB_PERIOD, ports)?))
        })
        .unwrap();
    let slow = builder.lane(LaneSpec::new("slow", JOB_PERIOD * 5, 50)).unwrap();
    builder
        .task(slow, "reader", |ports| {
            Ok(Box::new(Reader { pace: ports.input("pace"), seen: ports.output("seen") }))
        })
        .unwrap();
    builder.bind("reader.pace", "clock_lock.pace");
    builder.pace_from("clock_lock.pace");
    builder.build().unwrap()
}

/// A host whose jobs begin up to 40 us late, drawn from a seed.
struct JitteringHost {
    clock: Arc<Mutex<Nanos>>,
    random: SplitMix,
}

impl VirtualHost for JitteringHost {
    fn timing(&mut self, _lane: usize, _release: Nanos) -> JobTiming {
        let late = Nanos(self.random.below(LATENESS_MAX_NS + 1) as i64);
        JobTiming { late, took: Nanos::from_micros(30) }
    }

    fn begin(&mut self, instant: Nanos) {
        *self.clock.lock().unwrap() = instant;
    }
}

/// What a run left, as far as the tests look at it.
struct Kept {
    pace: usize,
    tape: usize,
    health: Vec<usize>,
    records: u64,
    entries: Vec<PhaseEntry>,
    paces: Vec<PaceStatus>,
    missed: u32,
    /// Where the run's time was 0, as it was told.
    origins: Vec<Nanos>,
    script: Option<RecordedRun>,
}

impl Kept {
    fn new(catalog: &Catalog, with_script: bool) -> Kept {
        let find = |name: &str| catalog.find(name).unwrap();
        Kept {
            pace: find("clock_lock.pace"),
            tape: find("hal.board_clock"),
            health: ["fast.health", "slow.health"].map(find).to_vec(),
            records: 0,
            entries: Vec::new(),
            paces: Vec::new(),
            missed: 0,
            origins: Vec::new(),
            script: with_script.then(|| RecordedRun::new(catalog, &[])),
        }
    }
}

impl Observer for Kept {
    fn record(&mut self, record: &Record<'_>) {
        self.records += 1;
        if record.signal == self.tape {
            self.entries.push(PhaseEntry::decode(record.body).unwrap());
        } else if record.signal == self.pace {
            self.paces.push(PaceStatus::decode(record.body).unwrap());
        } else if self.health.contains(&record.signal) {
            self.missed = self.missed.max(LaneHealth::decode(record.body).unwrap().missed);
        }
        if let Some(script) = &mut self.script {
            script.record(record);
        }
    }
}

impl RunObserver for Kept {
    fn on_epoch(&mut self, origin: Nanos) {
        self.origins.push(origin);
    }
}

/// A run on the simulated host.
fn paced(ppm: i64, failing: i64, until: Nanos, with_script: bool) -> Kept {
    let host = Arc::new(Mutex::new(Nanos::ZERO));
    let board = host.clone();
    let mut machine = machine(|tape| {
        Box::new(DriftingBoard { host: board, live: None, ppm, failing, newest: None, tape })
    });
    let mut kept = Kept::new(machine.catalog(), with_script);
    let mut jitter = JitteringHost { clock: host, random: SplitMix::new(11) };
    let stop = AtomicBool::new(false);
    run_on_host(&mut machine, &mut jitter, until, &stop, &mut kept).unwrap();
    let jobs = (until.0 / JOB_PERIOD.0).cast_unsigned();
    let figures: Vec<_> = machine.figures().map(|(_, one)| (one.jobs, one.skipped)).collect();
    assert_eq!(figures, [(jobs, 0), (jobs / 5, 0)], "no job is left out and none is added");
    kept
}

/// The worst phase after the loop has settled; locked all the time from there.
fn worst_phase(kept: &Kept) -> i64 {
    let settled = kept.paces.iter().skip(SETTLING_JOBS as usize);
    assert!(settled.clone().all(|pace| pace.locked == 1 && pace.clamped == 0 && pace.slips == 0));
    settled.map(|pace| pace.phase_ns.abs()).max().unwrap()
}

#[test]
fn minutes_of_jobs_keep_their_place_in_the_cycle_of_a_board_that_drifts() {
    keeps_its_place(100, 240);
}

#[test]
#[ignore = "minutes: cargo test --release -p taktil-tasks-clock-lock --test pacing -- --ignored"]
fn an_hour_of_jobs_keeps_its_place_too() {
    // The law alone over an hour of both signs is tested beside it.
    keeps_its_place(100, 3_600);
}

fn keeps_its_place(ppm: i64, seconds: i64) {
    let kept = paced(ppm, 0, Nanos::from_secs(seconds), false);
    let worst = worst_phase(&kept);
    assert!(worst <= LOCK_WINDOW.0, "{ppm} ppm: {worst} ns");
    assert_eq!((kept.missed, kept.paces.len() as i64), (0, 1_000 * seconds));
    // The board gains 0.36 s in an hour, and the releases come as much earlier.
    let last = kept.paces.last().unwrap().correction_ns;
    let due = -ppm * 1_000 * seconds;
    assert!((last - due).abs() < 1_000_000, "{last} ns instead of {due} ns");
    println!("{ppm} ppm: phase at most {worst} ns");
}

#[test]
fn a_replay_repeats_the_corrections_from_the_tape_bit_for_bit() {
    for (ppm, failing) in [(-100, 0), (100, 7)] {
        let until = Nanos::from_secs(60);
        let kept = paced(ppm, failing, until, true);
        assert!(worst_phase(&kept) <= LOCK_WINDOW.0);
        let missing = if failing > 0 { 60_000_u32.div_ceil(7) } else { 0 };
        assert_eq!(kept.paces.last().unwrap().missing, missing);
        let play = |entries: Vec<PhaseEntry>| {
            let mut again =
                machine(|tape| Box::new(Playback { entries: entries.into_iter(), tape }));
            let mut repeated = Kept::new(again.catalog(), false);
            let script = kept.script.as_ref().unwrap();
            let stop = AtomicBool::new(false);
            replay::run(&mut again, script, &[], until, &stop, &mut repeated).unwrap();
            repeated
        };
        let repeated = play(kept.entries.clone());
        assert_eq!(repeated.records, kept.records);
        assert_eq!(repeated.paces, kept.paces);
        let mut altered = kept.entries.clone();
        altered[30_001].phase_ns ^= 1 << 12;
        assert_ne!(play(altered).paces, kept.paces, "a phase that was altered is found");
    }
}

#[test]
fn the_kernels_clock_is_moved_as_well() {
    let board = Arc::new(Mutex::new(Nanos::ZERO));
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    // The board's cycle begins wherever this run happens to find it.
    let mut machine = machine(|tape| {
        let live = Some(clock);
        Box::new(DriftingBoard { host: board, live, ppm: 100, failing: 0, newest: None, tape })
    });
    let mut kept = Kept::new(machine.catalog(), false);
    let options =
        RunOptions { until: Nanos::from_secs(3), contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, options, &AtomicBool::new(false), &mut kept).unwrap();
    let median = |paces: &[PaceStatus]| {
        let mut phases: Vec<i64> = paces.iter().map(|pace| pace.phase_ns).collect();
        phases.sort_unstable();
        phases[phases.len() / 2]
    };
    let count = kept.paces.len();
    let (first, last) = (median(&kept.paces[..20]), median(&kept.paces[count - 500..]));
    let moved = kept.paces[count - 1].correction_ns;
    println!("median phase {first} ns, then {last} ns; moved by {moved} ns");
    let told = *kept.origins.last().unwrap() - kept.origins[0];
    assert!((told.0 - moved).abs() < 10_000, "the origin is told to have moved by {told}");
    // However busy the host is: half of the jobs are near the place that they were moved to.
    assert!(last.abs() < 150_000, "{last} ns");
    assert!((moved + first).abs() < 300_000 || first.abs() > 300_000, "{moved} ns from {first} ns");
}
