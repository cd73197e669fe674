//! The driver on a pseudo-terminal against emulators in other processes: this program runs itself
//! anew as the emulator. Time-outs are generous, and nothing depends on the speed of the machine.

mod wire;

use taktil_drivers_serial::{BoardKind, Config, LineState, SerialTactile, open};
use taktil_hal::conformance::{CycleDriver, check_tactile};
use taktil_hal::{Arrival, Clock, ErrorKind, Nanos, TactileArray, TactileFrame};
use wire::{Emulator, Monotonic};

const PATIENCE_TIME: Nanos = Nanos::from_secs(60);

/// Runs as the emulator when the environment says so, and as an empty test otherwise.
#[test]
fn emulator_process() {
    wire::serve_if_asked();
}

fn config(emulator: &Emulator, board: BoardKind) -> Config {
    let path = emulator.link().display().to_string();
    Config { path, board, rate_hz: 50.0, ..Config::default() }
}

/// Samples in real time until `done` says so.
fn sample_until(
    array: &mut SerialTactile,
    clock: &Monotonic,
    mut done: impl FnMut(&mut SerialTactile, Option<ErrorKind>, usize) -> bool,
) {
    let (begin, mut frame, mut count) = (clock.now(), TactileFrame::of(array), 0);
    loop {
        assert!(
            clock.now() - begin < PATIENCE_TIME,
            "nothing after {PATIENCE_TIME}: {:?}",
            array.health()
        );
        let now = clock.now();
        let error = match array.sample(now, &mut frame) {
            Ok(Arrival::New) => {
                assert!(frame.acquired <= now);
                // An image has one count everywhere: no frame is a mixture of two.
                let used = &frame.values[..frame.tactels()];
                assert!(used.iter().all(|value| *value == used[0] && *value >= 20));
                count += 1;
                None
            }
            Ok(Arrival::Held) => None,
            Err(error) => Some(error.kind),
        };
        if done(array, error, count) {
            return;
        }
        clock.sleep_until(now + Nanos::from_millis(5));
    }
}

#[test]
fn every_board_streams_from_another_process() {
    let boards = [
        ("myrmex", BoardKind::Myrmex),
        ("flexitac", BoardKind::Flexitac),
        ("weiss-wts", BoardKind::WeissWts),
        ("weiss-dsa", BoardKind::WeissDsa),
    ];
    for (name, board) in boards {
        let emulator = Emulator::start(name, "stream", "");
        let clock = Monotonic::start();
        let (mut array, worker) = open(&config(&emulator, board), Box::new(clock.clone()))
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(!worker.is_low_latency(), "a pseudo-terminal has no such setting");
        let thread = std::thread::spawn(move || worker.run());
        sample_until(&mut array, &clock, |_, _, count| count >= 40);
        let health = array.health();
        assert_eq!((health.losses, health.overruns, health.reopened), (0, 0, 0), "{name}");
        drop(array);
        thread.join().unwrap();
    }
}

#[test]
fn the_half_conforms_while_its_worker_runs() {
    let emulator = Emulator::start("myrmex", "conform", "");
    let clock = Monotonic::start();
    let (mut array, worker) =
        open(&config(&emulator, BoardKind::Myrmex), Box::new(clock.clone())).unwrap();
    let thread = std::thread::spawn(move || worker.run());
    let first = clock.now();
    let mut bench =
        CycleDriver::new(first, Nanos::from_millis(20), |release| clock.sleep_until(release));
    assert_eq!(check_tactile(&mut array, &mut bench), []);
    drop(bench);
    drop(array);
    thread.join().unwrap();
}

#[test]
fn a_cable_that_is_pulled_and_plugged_in_again_is_survived() {
    // Faults of an emulator count from its own start.
    let emulator = Emulator::start("myrmex", "cable", "kind=unplugged at=3 for=2");
    let clock = Monotonic::start();
    let config = config(&emulator, BoardKind::Myrmex);
    let (mut array, worker) = open(&config, Box::new(clock.clone())).unwrap();
    let thread = std::thread::spawn(move || worker.run());
    let mut stale = false;
    let mut before = 0;
    sample_until(&mut array, &clock, |array, error, count| {
        stale |= error == Some(ErrorKind::Stale);
        assert_ne!(error, Some(ErrorKind::Lost));
        if !stale {
            before = count;
        }
        stale && count > before + 20 && array.health().state == LineState::Healthy
    });
    let health = array.health();
    assert!(health.losses >= 1 && health.reopened >= 1, "{health:?}");
    drop(array);
    thread.join().unwrap();
}

#[test]
fn a_worker_that_has_ended_is_lost_for_good() {
    let emulator = Emulator::start("flexitac", "ended", "");
    let clock = Monotonic::start();
    let (mut array, worker) =
        open(&config(&emulator, BoardKind::Flexitac), Box::new(clock.clone())).unwrap();
    drop(worker);
    sample_until(&mut array, &clock, |_, error, _| error == Some(ErrorKind::Lost));
}

#[test]
fn ports_that_cannot_be_used_are_refused_with_a_remedy() {
    let refused = |config: &Config, what: &str| {
        let clock = Box::new(Monotonic::start());
        let error = open(config, clock).expect_err("must be refused").to_string();
        assert!(error.starts_with(&config.path) && error.contains(what), "{error}");
        assert!(error.split("; ").nth(1).is_some_and(|remedy| remedy.len() > 10), "{error}");
    };
    let missing = Config { path: "/dev/taktil-nowhere".to_owned(), ..Config::default() };
    refused(&missing, "does not exist");
    let file = Config { path: env!("CARGO_MANIFEST_DIR").to_owned(), ..Config::default() };
    refused(&file, "cannot be opened as a serial port");
    let emulator = Emulator::start("myrmex", "busy", "");
    let config = config(&emulator, BoardKind::Myrmex);
    let first = open(&config, Box::new(Monotonic::start())).unwrap();
    refused(&config, "is in use by another process");
    drop(first);
    assert!(open(&config, Box::new(Monotonic::start())).is_ok());
    let wrong = Config { board: BoardKind::WeissWts, start_timeout_ms: 700, ..config };
    refused(&wrong, "Weiss WTS gives no answer to `stop`");
}
