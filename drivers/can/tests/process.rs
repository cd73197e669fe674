//! The driver over real sockets, against a bus in another process: a pair of sockets, and one at a
//! path; and its heap calls in a cycle.

use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use taktil_drivers_can::{Config, Halves, NodeConfig, Protocol, SocketPort, attach, open};
use taktil_drivers_can_emulator::{Emulator, Kind, Link, PathLink, serve};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{
    AnalogOut, CHANNELS, Clock, DacCode, DigitalOut, Encoders, ErrorKind, LinesOut, Nanos,
};
use taktil_rtcore::guard::{CountingAllocator, count_heap_calls, installed};
use taktil_rtcore::linux::MonotonicClock;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);
const DRIVE_IDS: [u8; 3] = [1, 5, 9];
/// The name under which this program starts itself as a bus.
const BUS_TEST: &str = "the_bus_of_the_other_tests";
/// The variables that tell it what to serve, the faults, and the path; its standard input is the
/// socket where there is none.
const KIND_VARIABLE: &str = "CAN_BUS_KIND";
const FAULTS_VARIABLE: &str = "CAN_BUS_FAULTS";
const PATH_VARIABLE: &str = "CAN_BUS_PATH";

/// A bus in a process of its own.
struct Process {
    child: Child,
}

impl Process {
    fn start(protocol: Protocol, faults: &str, path: Option<&PathBuf>, input: Stdio) -> Process {
        let child = Command::new(std::env::current_exe().unwrap())
            .args([BUS_TEST, "--exact", "--ignored"])
            .env(KIND_VARIABLE, format!("{protocol:?}"))
            .env(FAULTS_VARIABLE, faults)
            .env(PATH_VARIABLE, path.map_or(String::new(), |path| path.display().to_string()))
            .stdin(input)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Process { child }
    }

    /// A bus behind one end of a pair of sockets, and the other end.
    fn paired(protocol: Protocol, faults: &str) -> (Process, SocketPort) {
        let (own, other) = UnixDatagram::pair().unwrap();
        let process = Process::start(protocol, faults, None, OwnedFd::from(other).into());
        (process, SocketPort::from_socket(own.into()).unwrap())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
#[ignore = "is the bus of the other tests, which start it in a process of its own"]
fn the_bus_of_the_other_tests() {
    let Ok(kind) = std::env::var(KIND_VARIABLE) else { return };
    let kind = match kind.as_str() {
        "Moteus" => Kind::Moteus,
        "Odrive" => Kind::Odrive,
        _ => Kind::CanOpen(1_000),
    };
    let faults = std::env::var(FAULTS_VARIABLE).unwrap();
    let plan = faults.split(';').filter(|text| !text.is_empty());
    let plan = FaultPlan::new(plan.map(|text| text.parse().unwrap()).collect());
    let path = std::env::var(PATH_VARIABLE).unwrap();
    let mut link: Box<dyn Link> = if path.is_empty() {
        let input = std::io::stdin().as_fd().try_clone_to_owned().unwrap();
        Box::new(UnixDatagram::from(input))
    } else {
        Box::new(PathLink::bind(path.as_ref()).unwrap())
    };
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let mut emulator = Emulator::new(kind, &DRIVE_IDS).with_faults(plan, "can", 1);
    let mut goes_on = || clock.now() < Nanos::from_secs(120);
    let _ = serve(&mut emulator, link.as_mut(), &clock, &mut goes_on);
}

fn config(protocol: Protocol) -> Config {
    let node = |id| NodeConfig { id, ..NodeConfig::default() };
    // A shared machine: waits are generous, what they cost is not judged here.
    Config {
        interface: "a pair of sockets".to_owned(),
        protocol,
        nodes: DRIVE_IDS.map(node).to_vec(),
        period_us: 100_000,
        wait_share: 0.5,
        lost_ms: 5_000,
        silence_ms: 4_000,
        open_wait_ms: 6_000,
        ..Config::default()
    }
}

/// What came of some cycles.
#[derive(Debug, Default)]
struct Outcome {
    good: u64,
    last: i32,
    is_lost: bool,
}

fn cycles(halves: &mut Halves, code: i32, count: i64) -> Outcome {
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let start = clock.now();
    let mut outcome = Outcome::default();
    for cycle in 1..=count {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        match halves.encoders.sample(release) {
            Ok(reading) => {
                outcome.good += 1;
                outcome.last = reading.value[0].0;
            }
            Err(error) => outcome.is_lost |= error.kind == ErrorKind::Lost,
        }
        let _ = halves.analog_out.as_mut().unwrap().commit(release, &[DacCode(code); CHANNELS]);
        let watchdog_feed = cycle % 2 == 1;
        let lines = LinesOut { enable: true, brake_release: true, watchdog_feed };
        let _ = halves.digital_out.as_mut().unwrap().commit(release, &lines);
    }
    outcome
}

#[test]
fn drives_in_another_process_are_enabled_and_turn_without_a_heap_call() {
    assert!(installed());
    for protocol in [Protocol::Canopen, Protocol::Moteus, Protocol::Odrive] {
        let (_process, port) = Process::paired(protocol, "");
        let mut halves = attach(Box::new(port), &config(protocol)).unwrap();
        let (outcome, heap_calls) = count_heap_calls(|| cycles(&mut halves, 300, 200));
        let counts = halves.monitor.counts();
        assert!(outcome.good > 180 && !outcome.is_lost, "{protocol:?}: {outcome:?} {counts:?}");
        assert!(outcome.last > 10_000, "{protocol:?}: {outcome:?}");
        assert_eq!(heap_calls, 0, "{protocol:?}");
        let (_, heap_calls) = count_heap_calls(|| {
            let _ = halves.analog_out.as_mut().unwrap().safe();
            let _ = halves.digital_out.as_mut().unwrap().safe();
        });
        assert_eq!(heap_calls, 0, "{protocol:?}");
    }
}

#[test]
fn a_bad_bus_is_survived_and_counted() {
    let faults = "kind=loss value=0.03 at=2;kind=duplication value=0.1 at=2";
    let (_process, port) = Process::paired(Protocol::Canopen, faults);
    let config = Config { wait_share: 0.1, ..config(Protocol::Canopen) };
    let mut halves = attach(Box::new(port), &config).unwrap();
    let outcome = cycles(&mut halves, 100, 700);
    let counts = halves.monitor.counts();
    let of = |name| counts.iter().find(|(own, _)| *own == name).unwrap().1;
    assert!(outcome.good > 400 && !outcome.is_lost, "{outcome:?} {counts:?}");
    assert!(of("missing answers") > 5 && of("late answers") > 5, "{counts:?}");
}

#[test]
fn a_bus_at_a_path_serves_one_host_after_the_other() {
    let folder = std::env::temp_dir();
    let path = folder.join(format!("taktil-can-test-{}", std::process::id()));
    let _ = std::fs::remove_file(&path);
    let process = Process::start(Protocol::Canopen, "", Some(&path), Stdio::null());
    let clock = MonotonicClock::since_boot();
    let end = clock.now() + Nanos::from_secs(20);
    while !path.exists() && clock.now() < end {
        clock.sleep_until(clock.now() + Nanos::from_millis(5));
    }
    let config = Config { interface: path.display().to_string(), ..config(Protocol::Canopen) };
    for _ in 0..2 {
        let mut halves = open(&config).unwrap();
        let outcome = cycles(&mut halves, 300, 60);
        assert!(outcome.good > 50 && outcome.last > 0, "{outcome:?}");
    }
    drop(process);
    std::fs::remove_file(&path).unwrap();
    let error = open(&config).expect_err("nobody is there");
    assert_eq!(error.place(), "interface");
}

#[test]
fn an_interface_that_is_not_there_is_refused_by_name() {
    let config = Config { interface: "taktil-none".to_owned(), ..config(Protocol::Canopen) };
    let error = open(&config).expect_err("there is no such interface");
    assert!(error.to_string().starts_with("taktil-none: it cannot be opened"), "{error}");
    assert_eq!(error.place(), "interface");
}

/// A peer that is gone makes sending fail and nothing else: no signal ends the process.
#[test]
fn a_bus_that_dies_is_lost() {
    let (process, port) = Process::paired(Protocol::Canopen, "");
    let config = Config { lost_ms: 50, wait_share: 0.01, ..config(Protocol::Canopen) };
    let mut halves = attach(Box::new(port), &config).unwrap();
    assert!(cycles(&mut halves, 0, 20).good > 0);
    drop(process);
    assert!(cycles(&mut halves, 0, 40).is_lost);
    let down = halves.monitor.counts().into_iter().find(|(name, _)| name.ends_with("down"));
    assert!(down.unwrap().1 > 0);
}
