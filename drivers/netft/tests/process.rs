//! The driver over a real UDP socket, against a box in another process, and its heap calls in a
//! cycle.

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

use taktil_drivers_netft::{Config, NetFt, open};
use taktil_drivers_netft_emulator::{Emulator, serve};
use taktil_hal::fault::FaultPlan;
use taktil_hal::{Clock, ErrorKind, ForceTorque, Nanos};
use taktil_rtcore::guard::{CountingAllocator, count_heap_calls, installed};
use taktil_rtcore::linux::MonotonicClock;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);
/// The name under which this program starts itself as a box.
const BOX_TEST: &str = "the_box_of_the_other_tests";
/// The variable that tells it the faults of its link.
const FAULTS_VARIABLE: &str = "NETFT_BOX_FAULTS";

/// A box in a process of its own.
struct Process {
    child: Child,
    address: String,
}

impl Process {
    fn start(faults: &str) -> Process {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([BOX_TEST, "--exact", "--ignored", "--nocapture"])
            .env(FAULTS_VARIABLE, faults)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let address = lines.map_while(Result::ok).find_map(|line| {
            line.split_once("box at ").map(|(_, address)| address.trim().to_owned())
        });
        Process { child, address: address.expect("the box tells its address") }
    }

    fn config(&self) -> Config {
        // A shared machine: times are generous, what they cost is not judged here.
        Config {
            address: self.address.clone(),
            rate_hz: 1000,
            stale_ms: 2_000,
            open_wait_ms: 5_000,
            ..Config::default()
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
#[ignore = "is the box of the other tests, which start it in a process of its own"]
fn the_box_of_the_other_tests() {
    let Ok(faults) = std::env::var(FAULTS_VARIABLE) else { return };
    let plan = faults.split(';').filter(|text| !text.is_empty());
    let plan = FaultPlan::new(plan.map(|text| text.parse().unwrap()).collect());
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    println!("box at {}", socket.local_addr().unwrap());
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    clock.sleep_until(Nanos::ZERO);
    let sensor = |now: Nanos| [1, 2, 3 + (now.0 / 1_000_000) as i32, 4, 5, 6];
    let mut emulator = Emulator::new(1000, Box::new(sensor)).with_faults(plan, "netft", 1);
    let mut goes_on = || clock.now() < Nanos::from_secs(120);
    serve(&mut emulator, &socket, &clock, &mut goes_on).unwrap();
}

fn cycles(half: &mut NetFt, count: i64) -> (u64, Option<i32>) {
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let start = clock.now();
    let (mut good, mut last) = (0, None);
    for cycle in 1..=count {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        match half.sample(release) {
            Ok(reading) => {
                assert!(last <= Some(reading.value.codes[2].0), "{last:?}: {reading:?}");
                (good, last) = (good + 1, Some(reading.value.codes[2].0));
            }
            Err(error) => assert_ne!(error.kind, ErrorKind::Lost),
        }
    }
    (good, last)
}

#[test]
fn a_box_in_another_process_is_read_without_a_heap_call() {
    assert!(installed());
    let process = Process::start("");
    let mut half = open(&process.config()).unwrap();
    let ((good, last), heap_calls) = count_heap_calls(|| cycles(&mut half, 200));
    assert_eq!(heap_calls, 0);
    let seen = half.counts();
    assert!(good > 180 && last > Some(500) && seen.records > 500, "{good} {last:?} {seen:?}");
    assert_eq!((seen.invalid, seen.strange, seen.restarts), (0, 0, 0));
}

#[test]
fn a_bias_is_taken_by_the_box_at_the_opening() {
    let process = Process::start("kind=frozen");
    let mut half = open(&process.config()).unwrap();
    let (_, unbiased) = cycles(&mut half, 20);
    drop(half);
    let mut half = open(&Config { bias: true, ..process.config() }).unwrap();
    let (_, biased) = cycles(&mut half, 20);
    // The box shows its frozen zero; what the sensor read at the opening is subtracted.
    assert_eq!(unbiased, Some(0));
    assert!(biased < Some(0), "{biased:?}");
}

#[test]
fn a_bad_link_and_a_restart_are_survived_and_counted() {
    let process = Process::start(
        "kind=loss value=0.1;kind=duplication value=0.2;kind=restart at=1.5;\
         kind=silence at=2 for=0.3",
    );
    let mut half = open(&process.config()).unwrap();
    let (good, _) = cycles(&mut half, 700);
    let seen = half.counts();
    assert!(good > 400 && seen.missing > 50 && seen.old > 100, "{good}: {seen:?}");
    assert!(seen.restarts == 1 && seen.requests > 0, "{seen:?}");
    let told = half.monitor().counts();
    assert!(
        told.contains(&("records", seen.records)) && told.contains(&("restarts of the box", 1))
    );
}

#[test]
fn a_port_that_nobody_listens_on_is_told_and_does_not_hang() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    let config = Config { address: address.clone(), open_wait_ms: 30, ..Config::default() };
    let silent = open(&config).expect_err("somebody is silent");
    assert!(silent.to_string().contains("no record came within 30 ms"), "{silent}");
    drop(socket);
    let error = open(&config).expect_err("nobody listens");
    assert!(error.to_string().starts_with(&format!("{address}: ")), "{error}");
    assert_eq!(error.place(), "address");
}

#[test]
fn a_box_that_is_not_well_is_not_opened() {
    let process = Process::start("kind=failing value=1");
    let error = open(&process.config()).expect_err("its status is not 0");
    assert!(error.to_string().contains("80020000"), "{error}");
}
