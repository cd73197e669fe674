//! The driver over a shared file against a board in another thread and in another process, by the
//! clock: readings are whole, and outputs are safe after a process was killed.

mod rig;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use rig::{config, place, text};
use taktil_drivers_regmap::{Board, Config, Halves};
use taktil_drivers_regmap_emulator::{Emulator, Inputs, Outputs, serve};
use taktil_hal::{CHANNELS, Clock, DacCode, ErrorKind, Nanos};
use taktil_rtcore::linux::MonotonicClock;

/// The variable that tells this program, started again by a test, what it is to be.
const ROLE_VARIABLE: &str = "REGMAP_TEST_ROLE";
/// The variable with the file of the registers.
const FILE_VARIABLE: &str = "REGMAP_TEST_FILE";
/// Readings that have to come.
const READINGS_COUNT: usize = 100;
/// Longest time for that on a shared machine.
const WAIT_TIME_MAX: Nanos = Nanos::from_secs(60);
/// How long two lanes disturb each other at most: one may starve, and nothing is mixed meanwhile.
const LANES_TIME_MAX: Nanos = Nanos::from_secs(5);

/// A board whose joints are all at one count, and whose converters all read one code and echo
/// nothing: a mixture of two readings shows.
fn board(path: &std::path::Path) -> Emulator {
    let mut count = 0;
    let plant = Box::new(move |_: Nanos, _: &Outputs| {
        count += 1;
        Inputs {
            counts: vec![65_500 + count / 50; 8],
            codes: vec![(count % 2_000) as i32; 8],
            ..Inputs::default()
        }
    });
    Emulator::new("board", text("vme-arm"), path, 0, plant).unwrap()
}

/// The same program again in another role.
fn again(test: &str, role: &str, file: &std::path::Path) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args([test, "--exact", "--nocapture"])
        .env(ROLE_VARIABLE, role)
        .env(FILE_VARIABLE, file)
        .stdout(Stdio::null())
        .spawn()
        .unwrap()
}

fn role() -> Option<(String, PathBuf)> {
    let role = std::env::var(ROLE_VARIABLE).ok()?;
    Some((role, PathBuf::from(std::env::var_os(FILE_VARIABLE)?)))
}

/// Samples until enough whole readings have come; how many jobs it took.
fn sample(halves: &mut Halves) -> usize {
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let (mut whole, mut jobs) = (0, 0);
    let encoders = halves.encoders.as_mut().unwrap();
    let converters = halves.analog_in.as_mut().unwrap();
    let outputs = halves.analog_out.as_mut().unwrap();
    while whole < READINGS_COUNT {
        assert!(clock.now() < WAIT_TIME_MAX, "{whole} readings in {jobs} jobs");
        let release = clock.now();
        jobs += 1;
        outputs.commit(release, &[DacCode((jobs % 2_000) as i32); CHANNELS]).unwrap();
        // Started early and collected late: the board has a millisecond in every other job, and
        // only as long as its busy bits are looked at in the others.
        if jobs % 2 == 0 {
            halves.start.start(release);
            std::thread::sleep(Duration::from_millis(1));
        }
        let counts = encoders.sample(release);
        let codes = converters.sample(release);
        for error in [counts.err(), codes.err()].into_iter().flatten() {
            assert_eq!(error.kind, ErrorKind::Transient);
        }
        if let (Ok(counts), Ok(codes)) = (counts, codes) {
            let (counts, codes) = (&counts.value[..8], &codes.value[..8]);
            assert!(counts.iter().all(|count| *count == counts[0]), "{counts:?}");
            assert!(codes.iter().all(|code| *code == codes[0]), "{codes:?}");
            whole += 1;
        }
    }
    jobs
}

#[test]
fn a_board_in_another_thread_is_read_whole() {
    let mut config = config("thread", "vme-arm");
    config.encoder_channels = (0..8).collect();
    let mut emulator = board(&config.path);
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let thread = std::thread::spawn(move || {
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        serve(&mut emulator, &clock, &mut || !flag.load(Ordering::Relaxed)).unwrap();
        emulator
    });
    let mut halves = Board::open_halves(&config).unwrap();
    let jobs = sample(&mut halves);
    println!("{READINGS_COUNT} whole readings in {jobs} jobs");
    drop(halves);
    stop.store(true, Ordering::Relaxed);
    let mut emulator = thread.join().unwrap();
    emulator.step(Nanos::from_secs(1_000_000)).unwrap();
    assert_eq!(emulator.outputs().codes, [0; 8]);
}

#[test]
fn gauges_in_a_lane_of_their_own_are_of_one_conversion_too() {
    let mut config = config("lanes", "vme-arm");
    (config.gauge_channels, config.encoder_channels) = ((2..8).collect(), vec![0]);
    let mut emulator = board(&config.path);
    emulator.set_conversion_time(Nanos(0));
    let stop = Arc::new(AtomicBool::new(false));
    let flag = stop.clone();
    let thread = std::thread::spawn(move || {
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        serve(&mut emulator, &clock, &mut || !flag.load(Ordering::Relaxed)).unwrap();
    });
    let halves = Board::open_halves(&config).unwrap();
    let (mut converters, mut gauges) = (halves.analog_in.unwrap(), halves.force_torque.unwrap());
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let enough = AtomicBool::new(false);
    let (left, right) = std::thread::scope(|scope| {
        // A lane that starts conversions in the middle of those of the other one.
        let wrist = scope.spawn(|| {
            let mut whole = 0;
            while whole < READINGS_COUNT && clock.now() < LANES_TIME_MAX {
                match gauges.sample(clock.now()) {
                    Ok(read) => {
                        assert_eq!(read.value.codes, [read.value.codes[0]; 6]);
                        whole += 1;
                    }
                    Err(error) => assert_eq!(error.kind, ErrorKind::Transient),
                }
                std::thread::yield_now();
            }
            enough.store(true, Ordering::Relaxed);
            whole
        });
        let mut whole = 0;
        while !enough.load(Ordering::Relaxed) {
            match converters.sample(clock.now()) {
                Ok(read) => {
                    let wired = converters.channels().min(CHANNELS);
                    let codes = &read.value[..wired];
                    assert!(codes.iter().all(|code| *code == codes[0]), "{read:?}");
                    whole += 1;
                }
                Err(error) => assert_eq!(error.kind, ErrorKind::Transient),
            }
            std::thread::yield_now();
        }
        (wrist.join().unwrap(), whole)
    });
    println!("{left} readings of the gauges, {right} of the converters");
    stop.store(true, Ordering::Relaxed);
    thread.join().unwrap();
    assert!(left + right > 0, "not one reading came");
}

#[test]
fn a_board_in_another_process_is_read_whole() {
    if let Some((_, path)) = role() {
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        serve(&mut board(&path), &clock, &mut || clock.now() < WAIT_TIME_MAX * 2).unwrap();
        return;
    }
    let config = config("process", "vme-arm");
    let mut emulator = again("a_board_in_another_process_is_read_whole", "board", &config.path);
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut halves = loop {
        match Board::open_halves(&config) {
            Ok(halves) => break halves,
            Err(error) => assert!(clock.now() < WAIT_TIME_MAX, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(5));
    };
    let jobs = sample(&mut halves);
    println!("{READINGS_COUNT} whole readings in {jobs} jobs");
    emulator.kill().unwrap();
    emulator.wait().unwrap();
}

#[test]
fn a_killed_process_leaves_a_board_that_another_one_makes_safe() {
    let dvme = |path: PathBuf| Config { relay_ms: Some(10), ..Config::described(path, "dvme-628") };
    if let Some((_, path)) = role() {
        let mut halves = Board::open_halves(&dvme(path)).unwrap();
        let out = halves.analog_out.as_mut().unwrap();
        out.commit(Nanos::ZERO, &[DacCode(1_000); CHANNELS]).unwrap();
        std::thread::sleep(Duration::from_secs(120));
        return;
    }
    let path = place("killed-process");
    let plant = Box::new(|_: Nanos, _: &Outputs| Inputs::default());
    let mut emulator = Emulator::new("board", text("dvme-628"), &path, 0, plant).unwrap();
    let name = "a_killed_process_leaves_a_board_that_another_one_makes_safe";
    let mut driver = again(name, "driver", &path);
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let wait_for = |emulator: &mut Emulator, code: i32| {
        while emulator.outputs().codes != [code; 8] {
            assert!(clock.now() < WAIT_TIME_MAX, "{:?}", emulator.outputs());
            std::thread::sleep(Duration::from_millis(2));
            emulator.step(Nanos::ZERO).unwrap();
        }
    };
    wait_for(&mut emulator, 1_000);
    let busy = Board::open_halves(&dvme(path.clone())).expect_err("it is driven");
    assert!(busy.to_string().contains("another process drives this board"), "{busy}");
    driver.kill().unwrap();
    driver.wait().unwrap();
    emulator.step(Nanos::ZERO).unwrap();
    assert_eq!(emulator.outputs().codes, [1_000; 8]);
    taktil_drivers_regmap::write_safe_values(&dvme(path)).unwrap();
    wait_for(&mut emulator, 0);
}
