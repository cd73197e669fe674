//! The driver over a real UDP socket, against a card in another process, and its own time and heap
//! calls in a cycle.

mod other_process;

use std::net::UdpSocket;

use other_process::Card;
use taktil_drivers_mesa::{Board, Config, Halves};
use taktil_hal::{AnalogOut, CHANNELS, Clock, DacCode, Encoders, ErrorKind, Nanos};
use taktil_rtcore::guard::{CountingAllocator, count_heap_calls, installed};
use taktil_rtcore::linux::MonotonicClock;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const CYCLE_PERIOD: Nanos = Nanos::from_millis(5);
fn cycles(halves: &mut Halves, clock: &dyn Clock, count: i64, mut seen: impl FnMut(i64, bool)) {
    let start = clock.now();
    for cycle in 1..=count {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        let counts = halves.encoders.as_mut().unwrap().sample(release);
        let codes = [DacCode(409); CHANNELS];
        let _ = halves.analog_out.as_mut().unwrap().commit(release, &codes);
        match counts {
            Ok(reading) => seen(i64::from(reading.value[0].0), true),
            Err(error) => {
                assert_ne!(error.kind, ErrorKind::Lost);
                seen(0, false);
            }
        }
    }
}

#[test]
#[ignore = "is the card of the other tests, which start it in a process of its own"]
fn the_card_of_the_other_tests() {
    other_process::serve_card();
}

#[test]
fn a_motor_behind_a_card_in_another_process_turns() {
    let card = Card::start("");
    let mut halves = Board::open(&card.config()).unwrap();
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let (mut last, mut good) = (0, 0);
    cycles(&mut halves, &clock, 200, |count, fresh| {
        if fresh {
            assert!(count >= last, "{count} after {last}");
            (last, good) = (count, good + 1);
        }
    });
    let seen = halves.monitor.diagnostics();
    assert!(good > 150, "{seen:?}");
    // A volt for a second, less what pauses of a busy machine take.
    assert!((10..=200).contains(&last), "{last} counts, {seen:?}");
}

#[test]
fn a_bad_link_to_another_process_is_survived_and_counted() {
    let card =
        Card::start("kind=loss value=0.05;kind=duplication value=0.1;kind=reordering value=0.05");
    let config = Config { period_us: 20_000, ..card.config() };
    let mut halves = Board::open(&config).unwrap();
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut good = 0;
    cycles(&mut halves, &clock, 300, |_, fresh| good += u32::from(fresh));
    let seen = halves.monitor.diagnostics();
    assert!(good > 200, "{good}: {seen:?}");
    assert!(
        seen.timeouts > 0
            && seen.duplicate_answers + seen.late_answers + seen.reordered_answers > 0,
        "{seen:?}"
    );
}

#[test]
fn a_port_that_nobody_listens_on_is_told_and_does_not_hang() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = socket.local_addr().unwrap().to_string();
    drop(socket);
    let config = Config { address: address.clone(), open_wait_ms: 20, ..Config::default() };
    let error = Board::open(&config).expect_err("nobody listens");
    assert!(error.to_string().starts_with(&format!("{address}: ")), "{error}");
    assert_eq!(error.place(), "address");
}

#[test]
fn a_cycle_over_the_socket_makes_no_heap_call() {
    assert!(installed());
    let card = Card::start("kind=loss at=2 value=0.02");
    let config = Config { period_us: 20_000, ..card.config() };
    let mut halves = Board::open(&config).unwrap();
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let ((), heap_calls) = count_heap_calls(|| cycles(&mut halves, &clock, 400, |_, _| ()));
    assert_eq!(heap_calls, 0);
    let ((), heap_calls) = count_heap_calls(|| {
        let _ = halves.analog_out.as_mut().unwrap().safe();
        let _ = halves.monitor.diagnostics();
    });
    assert_eq!(heap_calls, 0);
}

#[test]
fn a_wait_that_does_not_sleep_hears_answers_and_ends_by_itself() {
    let card = Card::start("kind=silence at=5");
    let config = Config { busy_poll: true, period_us: 20_000, lost_ms: 200, ..card.config() };
    let mut halves = Board::open(&config).unwrap();
    let bound = halves.monitor.wait_bound();
    assert!(bound.is_processor_time && bound.sample == Nanos::from_millis(18));
    let clock = MonotonicClock::starting_in(Nanos::ZERO);
    let mut good = 0;
    cycles(&mut halves, &clock, 100, |_, fresh| good += u32::from(fresh));
    assert!(good > 50, "{:?}", halves.monitor.diagnostics());
    // It is silent now: each job waits once, and then the card is lost.
    let start = clock.now();
    let encoders = halves.encoders.as_mut().unwrap();
    for cycle in 1..2_000 {
        let release = start + CYCLE_PERIOD * cycle;
        clock.sleep_until(release);
        if encoders.sample(release).is_err_and(|error| error.kind == ErrorKind::Lost) {
            return;
        }
    }
    panic!("never lost: {:?}", halves.monitor.diagnostics());
}

/// Numbers are read from another thread while the lane runs, and take no cycle from it.
#[test]
fn a_monitor_on_another_thread_disturbs_no_lane() {
    let card = Card::start("");
    let mut halves = Board::open(&card.config()).unwrap();
    let monitor = halves.monitor.clone();
    let ended = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let (mut looks, mut last) = (0_u64, 0);
            while !ended.load(std::sync::atomic::Ordering::Relaxed) {
                let seen = monitor.diagnostics();
                assert!(seen.answers >= last, "numbers only grow");
                last = seen.answers;
                looks += 1;
                std::thread::yield_now();
            }
            (looks, last)
        });
        let clock = MonotonicClock::starting_in(Nanos::ZERO);
        cycles(&mut halves, &clock, 100, |_, _| ());
        ended.store(true, std::sync::atomic::Ordering::Relaxed);
        let (looks, last) = reader.join().unwrap();
        assert!(looks > 100 && last > 50, "{looks} {last}");
    });
    let seen = halves.monitor.diagnostics();
    assert_eq!(seen.collisions, 0, "{seen:?}");
    assert!(halves.monitor.speeds_counts_s()[0].is_finite());
}
