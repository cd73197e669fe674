//! The driver over a shared file against a board in another thread and in another process, by the
//! clock: readings are whole, and outputs are safe after a process was killed.

mod rig;

use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

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
const PATIENCE: Duration = Duration::from_secs(60);

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
    let (mut whole, mut jobs, begin) = (0, 0, Instant::now());
    let encoders = halves.encoders.as_mut().unwrap();
    let converters = halves.analog_in.as_mut().unwrap();
    let outputs = halves.analog_out.as_mut().unwrap();
    while whole < READINGS_COUNT {
        assert!(begin.elapsed() < PATIENCE, "{whole} readings in {jobs} jobs");
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
            assert!(counts.value.iter().all(|count| *count == counts.value[0]), "{counts:?}");
            assert!(codes.value.iter().all(|code| *code == codes.value[0]), "{codes:?}");
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
fn a_board_in_another_process_is_read_whole() {
    if let Some((_, path)) = role() {
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        let end = clock.now() + Nanos(2 * PATIENCE.as_nanos() as i64);
        serve(&mut board(&path), &clock, &mut || clock.now() < end).unwrap();
        return;
    }
    let config = config("process", "vme-arm");
    let mut emulator = again("a_board_in_another_process_is_read_whole", "board", &config.path);
    let begin = Instant::now();
    let mut halves = loop {
        match Board::open_halves(&config) {
            Ok(halves) => break halves,
            Err(error) => assert!(begin.elapsed() < PATIENCE, "{error}"),
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
        std::thread::sleep(2 * PATIENCE);
        return;
    }
    let path = place("killed-process");
    let plant = Box::new(|_: Nanos, _: &Outputs| Inputs::default());
    let mut emulator = Emulator::new("board", text("dvme-628"), &path, 0, plant).unwrap();
    let name = "a_killed_process_leaves_a_board_that_another_one_makes_safe";
    let mut driver = again(name, "driver", &path);
    let begin = Instant::now();
    let wait_for = |emulator: &mut Emulator, code: i32| {
        while emulator.outputs().codes != [code; 8] {
            assert!(begin.elapsed() < PATIENCE, "{:?}", emulator.outputs());
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
