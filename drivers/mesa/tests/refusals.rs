//! What is wrong with a card, a host or another program, seen over UDP against a card in another
//! process: each complaint names the address, the place in the configuration and a remedy.

mod other_process;

use std::net::UdpSocket;
use std::sync::atomic::{AtomicBool, Ordering};

use other_process::Card;
use taktil_drivers_mesa::{Board, Config, Halves, Line, LinesInConfig, Terminal};
use taktil_hal::{AnalogOut, CHANNELS, Clock, DacCode, Encoders, ErrorKind, Nanos};
use taktil_rtcore::linux::MonotonicClock;

const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);

#[test]
#[ignore = "is the card of the other tests, which start it in a process of its own"]
fn the_card_of_the_other_tests() {
    other_process::serve_card();
}

/// Opening must fail with this place, these words and a remedy.
fn refused(config: &Config, place: &str, what: &str) {
    let error = Board::open(config).expect_err(what);
    let text = error.to_string();
    assert_eq!(error.place(), place, "{text}");
    assert!(text.starts_with(&format!("{}: ", config.address)), "{text}");
    assert!(text.contains(what), "{text}");
    assert!(text.split("; ").nth(1).is_some_and(|remedy| remedy.len() > 10), "{text}");
}

#[test]
fn every_wrong_firmware_is_named() {
    for (deviation, place, what) in [
        ("cookie", "address", "the cookie reads 0xdeadbeef"),
        ("config", "address", "\"SOMETHNG\", not \"HOSTMOT2\""),
        ("idrom", "address", "the IDROM is of type 9"),
        ("name", "board", "the card is a 7I80, not a 7I92"),
        ("no watchdog", "watchdog_ms", "has no watchdog"),
        ("no encoders", "encoders", "has no encoder"),
        ("no serial", "analog", "has no smart serial"),
        ("pins", "remotes", "has no channel 1"),
        ("no remote", "remotes", "no remote answers on smart-serial channel 1"),
        ("other remote", "remotes", "\"7I76\", number 0x14000001"),
    ] {
        let card = Card::with_firmware(deviation, "");
        refused(&Config { board: "7I92".to_owned(), ..card.config() }, place, what);
    }
}

#[test]
fn a_line_where_the_pins_are_other_ones_is_named() {
    let card = Card::start("");
    let pin =
        |number| Line { at: Terminal::Pin, number, remote: 0, inverted: false, open_drain: false };
    let lines = |estop_b| LinesInConfig { drive_power: pin(20), estop_a: pin(21), estop_b };
    for (line, what) in [(pin(34), "has no pin 34"), (pin(3), "pin 3 is driven by a module")] {
        let config = Config { lines_in: Some(lines(line)), ..card.config() };
        refused(&config, "lines_in.estop_b", what);
    }
}

#[test]
fn silence_is_told_apart_from_a_port_that_nobody_listens_on() {
    let card = Card::start("kind=silence");
    let config = Config { open_wait_ms: 20, ..card.config() };
    refused(&config, "address", "no card answers within 20 ms, asked 10 times");
    drop(card);
    refused(&config, "address", "nobody listens at this port");
}

#[test]
fn a_port_of_this_host_that_is_in_use_is_named() {
    let other = UdpSocket::bind("0.0.0.0:0").unwrap();
    let local_port = other.local_addr().unwrap().port();
    let card = Card::start("");
    let config = Config { local_port, ..card.config() };
    refused(&config, "local_port", &format!("port {local_port} of this host is in use"));
    drop(other);
    drop(Board::open(&config).expect("it is free now"));
}

/// A lane over a card, as long as asked or until it answers otherwise than `Transient` or `Stale`.
fn run(halves: &mut Halves, clock: &dyn Clock, cycles: i64) -> Result<(), ErrorKind> {
    let start = clock.now();
    for cycle in 1..=cycles {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        let sampled = halves.encoders.as_mut().unwrap().sample(release);
        let codes = [DacCode(409); CHANNELS];
        let _ = halves.analog_out.as_mut().unwrap().commit(release, &codes);
        if let Err(error) = sampled
            && !matches!(error.kind, ErrorKind::Transient | ErrorKind::Stale)
        {
            return Err(error.kind);
        }
    }
    Ok(())
}

#[test]
fn a_card_that_reboots_while_running_is_gone_and_can_be_opened_anew() {
    let card = Card::start("kind=restart at=2");
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut halves = Board::open(&card.config()).unwrap();
    assert_eq!(run(&mut halves, &clock, 2_000), Err(ErrorKind::Lost));
    let seen = halves.monitor.diagnostics();
    assert_eq!((seen.restarts, seen.takeovers), (1, 0), "{seen:?}");
    drop(halves);
    let mut halves = Board::open(&card.config()).unwrap();
    assert_eq!(run(&mut halves, &clock, 20), Ok(()));
}

#[test]
fn a_card_that_vanishes_while_running_is_refused_by_its_host_and_then_lost() {
    let card = Card::start("");
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let config = Config { lost_ms: 200, period_us: 10_000, ..card.config() };
    let mut halves = Board::open(&config).unwrap();
    assert_eq!(run(&mut halves, &clock, 5), Ok(()));
    drop(card);
    assert_eq!(run(&mut halves, &clock, 1_000), Err(ErrorKind::Lost));
    let seen = halves.monitor.diagnostics();
    assert!(seen.refusals > 0 && seen.timeouts > 0, "{seen:?}");
}

/// A program that drives a card; whether another one is refused meanwhile, and the first goes on.
fn second_is_refused() -> bool {
    let card = Card::start("");
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut halves = Board::open(&card.config()).unwrap();
    run(&mut halves, &clock, 5).unwrap();
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| {
            while !ended.load(Ordering::Relaxed) {
                run(&mut halves, &clock, 1)?;
            }
            Ok::<(), ErrorKind>(())
        });
        let second = Board::open(&card.config());
        ended.store(true, Ordering::Relaxed);
        let went_on = first.join().unwrap();
        let Err(error) = second else { return false };
        let text = error.to_string();
        assert_eq!(error.place(), "address", "{text}");
        assert!(text.contains("another program drives the card; end it"), "{text}");
        // Whoever only looked has changed nothing.
        assert_eq!(went_on, Ok(()));
        true
    })
}

#[test]
fn a_card_that_another_program_drives_is_not_opened() {
    // On a machine that lets the first program stand still for 50 ms, the second one sees nothing.
    assert!((0..5).any(|_| second_is_refused()));
}

/// The first program stood still while another one opened the card: it goes on without a word to
/// the card, and its end does not touch it.
#[test]
fn who_lost_the_card_to_another_program_leaves_it_alone() {
    let card = Card::start("");
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut first = Board::open(&card.config()).unwrap();
    run(&mut first, &clock, 5).unwrap();
    let mut second = Board::open(&card.config()).expect("the first one stands still");
    run(&mut second, &clock, 5).unwrap();
    assert_eq!(run(&mut first, &clock, 5), Err(ErrorKind::Lost));
    let seen = first.monitor.diagnostics();
    assert_eq!((seen.restarts, seen.takeovers), (0, 1), "{seen:?}");
    drop(first);
    run(&mut second, &clock, 20).unwrap();
    let seen = second.monitor.diagnostics();
    assert_eq!((seen.bites, seen.takeovers), (0, 0), "{seen:?}");
}
