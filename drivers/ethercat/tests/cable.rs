//! The driver at one end of a real cable, a veth pair in a network namespace of its own, with the
//! emulated segment at the other end: raw sockets, the kernel's clock, lost links. The tests start
//! themselves again inside a namespace, and say so when this machine does not let them.
#![expect(clippy::disallowed_types, reason = "the segment's thread shows what it puts out")]

mod rig;

use std::io::Write;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use rig::{codes_of, lines_of, locked, six_drives, terminals};
use taktil_drivers_ethercat::{Config, ExchangeTimes, Halves, Segment, SyncConfig};
use taktil_drivers_ethercat_emulator as emulator;
use taktil_drivers_ethercat_emulator::{Description, RawSocket, serve};
use taktil_hal::conformance::{
    CycleDriver, check_analog_in, check_analog_out_observed, check_digital_in,
    check_digital_out_observed, check_encoders,
};
use taktil_hal::{
    AnalogOut, BoardClock, CHANNELS, Clock, DacCode, DigitalOut, Encoders, Error, ErrorKind,
    LinesOut, Nanos, Reading,
};
use taktil_rtcore::guard::{self, CountingAllocator};
use taktil_rtcore::linux::MonotonicClock;
use taktil_rtcore::live::{self, Contract, Pace, RunObserver, RunOptions};
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{Builder, LaneSpec};
use taktil_tasks_clock_lock::{ClockLock, Config as ClockConfig};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// The driver's end of the pair.
const HOST_END: &str = "tk-host";
/// The segment's end.
const SEGMENT_END: &str = "tk-segment";
/// The period of the lanes here: the machine is shared, and what a wait costs is not judged.
const LANE_PERIOD: Nanos = Nanos::from_millis(10);

/// Runs one of the tests below in a namespace with a pair, or says why that is not possible.
fn run_in_namespace(test: &str) {
    let probe = Command::new("unshare").args(["-Urn", "ip", "link"]).output();
    let why = match probe {
        Err(error) => Some(format!("`unshare` cannot be started ({error})")),
        Ok(output) if !output.status.success() => {
            Some(format!("no namespace: {}", String::from_utf8_lossy(&output.stderr).trim()))
        }
        Ok(_) => None,
    };
    if let Some(why) = why {
        // The harness hides what a passing test prints.
        writeln!(std::io::stderr(), "SKIPPED: {test}: {why}").expect("there is a standard error");
        return;
    }
    let pair = format!(
        "ip link add {HOST_END} type veth peer name {SEGMENT_END} && ip link set {HOST_END} up && \
         ip link set {SEGMENT_END} up && exec \"$0\" \"$@\""
    );
    let own = std::env::current_exe().expect("a test has a file");
    let status = Command::new("unshare")
        .args(["-Urn", "sh", "-c", &pair])
        .arg(own)
        .args([test, "--exact", "--ignored", "--nocapture"])
        .status();
    assert!(status.is_ok_and(|status| status.success()), "{test} failed in its namespace");
}

#[test]
fn terminals_conform_over_a_cable() {
    run_in_namespace("inside_terminals_conform");
}

#[test]
fn drives_turn_over_a_cable_without_the_heap() {
    run_in_namespace("inside_drives_turn");
}

#[test]
fn drives_turn_over_a_cable_without_a_wait() {
    run_in_namespace("inside_drives_turn_pipelined");
}

#[test]
fn a_link_that_goes_down_and_comes_back_is_survived() {
    run_in_namespace("inside_a_link_goes_down");
}

#[test]
fn a_lane_follows_the_clock_of_the_segment_over_a_cable() {
    run_in_namespace("inside_a_lane_follows_the_clock");
}

/// What the devices put out, and whether the drives are enabled.
#[derive(Clone, Debug, Default)]
struct Shown {
    outputs: emulator::Outputs,
    enabled: Vec<bool>,
}

/// An emulated segment in a thread of its own.
struct Served {
    ended: Arc<AtomicBool>,
    looks: Arc<AtomicU64>,
    shown: Arc<Mutex<Shown>>,
    thread: Option<JoinHandle<()>>,
    clock: MonotonicClock,
}

impl Served {
    fn start(devices: Vec<Description>) -> Served {
        Served::start_with(devices, |_| ())
    }

    /// A segment that was prepared before anything reaches it.
    fn start_with(
        devices: Vec<Description>,
        prepare: impl FnOnce(&mut emulator::Segment) + Send + 'static,
    ) -> Served {
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        let (ended, looks) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let shown = Arc::<Mutex<Shown>>::default();
        let socket = RawSocket::open(SEGMENT_END).expect("there is a pair");
        let (end, look, show) = (ended.clone(), looks.clone(), shown.clone());
        let thread = std::thread::spawn(move || {
            let mut segment = emulator::Segment::new(devices, emulator::idle_motors());
            prepare(&mut segment);
            let mut goes_on = |segment: &mut emulator::Segment, _: Nanos| {
                let (outputs, enabled) = (segment.outputs(), segment.enabled_drives());
                *locked(&show) = Shown { outputs, enabled };
                look.fetch_add(1, Ordering::SeqCst);
                !end.load(Ordering::SeqCst)
            };
            serve(&mut segment, &socket, &clock, &mut goes_on).expect("the pair stays");
        });
        Served { ended, looks, shown, thread: Some(thread), clock }
    }

    /// What the devices put out and do now.
    fn look(&self) -> Shown {
        let before = self.looks.load(Ordering::SeqCst);
        while self.looks.load(Ordering::SeqCst) < before + 2 {
            std::thread::yield_now();
        }
        locked(&self.shown).clone()
    }

    fn sleep(&self, span: Nanos) {
        self.clock.sleep_until(self.clock.now() + span);
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::SeqCst);
        let joined = self.thread.take().map(JoinHandle::join);
        assert!(matches!(joined, Some(Ok(()))) || std::thread::panicking());
    }
}

/// The configuration with times that a shared machine keeps.
fn on_cable(config: Config) -> Config {
    Config {
        interface: HOST_END.to_owned(),
        period_us: 10_000,
        wait_share: 0.45,
        watchdog_ms: 2_000,
        lost_ms: 5_000,
        ..config
    }
}

/// A lane that is paced by the clock.
struct PacedLane {
    halves: Halves,
    release: Nanos,
    feed: bool,
    /// How old the newest reading was.
    age: Option<Nanos>,
}

impl PacedLane {
    fn new(halves: Halves) -> PacedLane {
        PacedLane { halves, release: Nanos::ZERO, feed: false, age: None }
    }

    /// One job; the first count and what the outputs answered.
    fn job(&mut self, enable: bool, code: i32) -> (Result<i32, ErrorKind>, bool) {
        self.release += LANE_PERIOD;
        let due = self.release;
        let encoders = self.halves.encoders.as_mut().unwrap();
        let reading = encoders.sample(due);
        self.age = reading.map(|reading| due - reading.acquired).ok().or(self.age);
        let count = reading.map(|reading| reading.value[0].0);
        let mut codes = [DacCode(0); CHANNELS];
        codes.iter_mut().take(4).for_each(|one| *one = DacCode(code));
        let analog = self.halves.analog_out.as_mut().unwrap().commit(due, &codes);
        self.feed = !self.feed;
        let lines = LinesOut { enable, brake_release: enable, watchdog_feed: self.feed };
        let lines = self.halves.digital_out.as_mut().unwrap().commit(due, &lines);
        (count.map_err(|error| error.kind), analog.is_ok() && lines.is_ok())
    }

    fn jobs(&mut self, served: &Served, count: usize, enable: bool, code: i32) -> usize {
        let mut good = 0;
        for _ in 0..count {
            let (reading, outputs) = self.job(enable, code);
            good += usize::from(reading.is_ok() && outputs);
            served.sleep(LANE_PERIOD);
        }
        good
    }
}

#[test]
#[ignore = "runs inside the namespace that another test makes"]
fn inside_terminals_conform() {
    let (devices, config) = terminals();
    let served = Served::start(devices);
    let mut lane = PacedLane::new(Segment::open(&on_cable(config)).unwrap());
    lane.jobs(&served, 40, false, 0);
    let mut bench =
        CycleDriver::new(lane.release + LANE_PERIOD, LANE_PERIOD, |_| served.sleep(LANE_PERIOD));
    assert_eq!(check_encoders(lane.halves.encoders.as_mut().unwrap(), &mut bench), []);
    assert_eq!(check_digital_in(lane.halves.digital_in.as_mut().unwrap(), &mut bench), []);
    assert_eq!(check_analog_in(lane.halves.analog_in.as_mut().unwrap(), &mut bench), []);
    // Nobody waits for the lines any more.
    for _ in 0..2 {
        let codes = [DacCode(0); CHANNELS];
        lane.halves.analog_out.as_mut().unwrap().commit(bench.release(), &codes).unwrap();
    }
    let mut codes = || codes_of(&served.look().outputs.volts);
    let mut lines = || lines_of(&served.look().outputs.lines);
    let analog = lane.halves.analog_out.as_mut().unwrap();
    assert_eq!(check_analog_out_observed(analog, &mut bench, &mut codes), []);
    let digital = lane.halves.digital_out.as_mut().unwrap();
    assert_eq!(check_digital_out_observed(digital, &mut bench, &mut lines), []);
    let seen = lane.halves.monitor.diagnostics();
    // A frame that nobody waits for is an answer that the host delayed beyond its wait.
    assert!(seen.wrong_counters == 0 && seen.stray_frames <= seen.timeouts, "{seen:?}");
}

#[test]
#[ignore = "runs inside the namespace that another test makes"]
fn inside_drives_turn() {
    check_drives_turn(ExchangeTimes::Twice);
}

#[test]
#[ignore = "runs inside the namespace that another test makes"]
fn inside_drives_turn_pipelined() {
    check_drives_turn(ExchangeTimes::Pipelined);
}

fn check_drives_turn(exchange: ExchangeTimes) {
    let (devices, config) = six_drives();
    let served = Served::start(devices);
    let config = on_cable(Config { exchange, ..config });
    let is_pipelined = exchange == ExchangeTimes::Pipelined;
    let mut lane = PacedLane::new(Segment::open(&config).unwrap());
    lane.jobs(&served, 40, false, 0);
    lane.jobs(&served, 20, true, 0);
    assert_eq!(served.look().enabled, [true; 6]);
    let before = lane.job(true, 0).0.unwrap();
    let ((), calls) = guard::count_heap_calls(|| {
        for _ in 0..100 {
            let _ = lane.job(true, 200);
            served.sleep(LANE_PERIOD);
        }
    });
    assert!(guard::installed());
    assert_eq!(calls, 0, "the driver used the heap in a job");
    let after = lane.job(true, 0).0.unwrap();
    assert!(after - before > 1_000, "{before} to {after}");
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!(seen.wrong_counters, 0, "{seen:?}");
    let age = lane.age.expect("it has read");
    assert_eq!(age, if is_pipelined { LANE_PERIOD } else { Nanos::ZERO });
    drop(lane);
    let Shown { outputs, enabled } = served.look();
    assert_eq!(enabled, [false; 6]);
    assert!(outputs.torques.iter().all(|torque| *torque <= 0.0), "they brake at most");
}

#[test]
#[ignore = "runs inside the namespace that another test makes"]
fn inside_a_link_goes_down() {
    let (devices, config) = six_drives();
    let served = Served::start(devices);
    let mut config = on_cable(config);
    config.watchdog_ms = 100;
    let mut lane = PacedLane::new(Segment::open(&config).unwrap());
    lane.jobs(&served, 40, false, 0);
    lane.jobs(&served, 20, true, 0);
    assert_eq!(served.look().enabled, [true; 6]);
    let set = |state: &str| {
        let status = Command::new("ip").args(["link", "set", SEGMENT_END, state]).status();
        assert!(status.is_ok_and(|status| status.success()));
    };
    set("down");
    assert_eq!(lane.jobs(&served, 30, true, 0), 0, "nothing passes");
    assert_eq!(served.look().enabled, [false; 6], "the watchdogs have bitten");
    set("up");
    lane.jobs(&served, 100, false, 0);
    assert!(lane.jobs(&served, 20, false, 0) >= 18, "it operates again");
    let seen = lane.halves.monitor.diagnostics();
    assert!(seen.timeouts + seen.send_failures > 0 && seen.recoveries >= 6, "{seen:?}");
}

/// The segment's clock as a lane reads it, with the phases of its jobs for the test.
struct WatchedClock {
    clock: Box<dyn BoardClock>,
    phases: Arc<Mutex<Vec<Nanos>>>,
}

impl BoardClock for WatchedClock {
    fn cycle(&self) -> Nanos {
        self.clock.cycle()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        let answer = self.clock.sample(release);
        if let Ok(reading) = answer {
            locked(&self.phases).push(reading.value);
        }
        answer
    }
}

/// Takes no record.
struct NoObserver;

impl Observer for NoObserver {
    fn record(&mut self, _record: &Record<'_>) {}
}

impl RunObserver for NoObserver {}

/// The phase that half of these are below.
fn median(phases: &[Nanos]) -> Nanos {
    let mut sorted = phases.to_vec();
    sorted.sort_unstable();
    sorted[sorted.len() / 2]
}

#[test]
#[ignore = "runs inside the namespace that another test makes"]
fn inside_a_lane_follows_the_clock() {
    let (devices, mut config) = six_drives();
    config.sync = Some(SyncConfig::default());
    let served = Served::start_with(devices, |segment| {
        (0..7).for_each(|position| segment.set_clock_drift(position, 100));
    });
    let mut halves = Segment::open(&on_cable(config)).unwrap();
    let clock = Box::new(halves.board_clock.take().unwrap());
    let phases = Arc::<Mutex<Vec<Nanos>>>::default();
    let shown = phases.clone();
    let mut builder = Builder::new();
    let lane = builder.lane(LaneSpec::new("bus", LANE_PERIOD, 60)).unwrap();
    let slew = ClockConfig { slew_max_ppm: 5_000, window_us: 1_000 };
    builder
        .task(lane, "clock_lock", |ports| {
            let clock = Box::new(WatchedClock { clock, phases: shown });
            Ok(Box::new(ClockLock::new(slew, clock, LANE_PERIOD, ports)?))
        })
        .unwrap();
    builder.pace_from("clock_lock.pace");
    let mut machine = builder.build().unwrap();
    let options =
        RunOptions { until: Nanos::from_secs(8), contract: Contract::Soft, pace: Pace::Fixed };
    live::run(&mut machine, options, &AtomicBool::new(false), &mut NoObserver).unwrap();
    let phases = locked(&phases);
    let (first, last) = (median(&phases[..10]), median(&phases[phases.len() - 200..]));
    // Wherever the cycle of the segment was found, the jobs come to their place in it; where the
    // machine is busy, late jobs draw the others before it.
    assert!(last.0.abs() < 1_500_000, "{first} at the start, {last} at the end");
    let named = "a median phase of";
    writeln!(std::io::stderr(), "{named} {first} at the start, {last} at the end").unwrap();
    drop(served);
}
