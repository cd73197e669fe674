//! Exchanges that are sent in one cycle and collected in the next one: no half waits, readings say
//! how old they are, one request is under way at a time, and late answers are counted and dropped.

mod rig;

use rig::{CYCLE_PERIOD, Lane, Rig, six_drives, terminals};
use taktil_drivers_ethercat::{Config, DeviceConfig, ExchangeTimes, Kind};
use taktil_drivers_ethercat_emulator::{Model, State};
use taktil_hal::{
    AnalogIn, AnalogOut, BoardClock, DigitalIn, DigitalOut, DriveIn, DriveOut, Encoders, ErrorKind,
    Nanos,
};

fn pipelined(config: Config) -> Config {
    Config { exchange: ExchangeTimes::Pipelined, ..config }
}

fn open(rig: &Rig, config: Config) -> Lane {
    let mut lane = Lane::new(rig.open(&pipelined(config)).unwrap());
    lane.age = CYCLE_PERIOD;
    lane
}

/// Six drives that follow, with motors behind them.
fn following() -> (Rig, Lane) {
    let (devices, config) = six_drives();
    let rig = Rig::with_motors(devices);
    let mut lane = open(&rig, config);
    lane.cycles(&rig, 30, false, 0);
    let last = lane.cycles(&rig, 15, true, 0);
    assert!(last.counts.is_ok() && last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
    (rig, lane)
}

#[test]
fn no_half_waits_and_the_declared_waits_say_so() {
    let (devices, mut config) = terminals();
    let mut waits = Vec::new();
    let halves = Rig::new(devices).open(&pipelined(config.clone())).unwrap();
    waits.extend(halves.encoders.iter().map(Encoders::longest_wait));
    waits.extend(halves.analog_in.iter().map(AnalogIn::longest_wait));
    waits.extend(halves.analog_out.iter().map(AnalogOut::longest_wait));
    waits.extend(halves.digital_in.iter().map(DigitalIn::longest_wait));
    waits.extend(halves.digital_out.iter().map(DigitalOut::longest_wait));
    let (devices, drives) = six_drives();
    config = Config { sync: Some(Default::default()), ..pipelined(drives) };
    let halves = Rig::new(devices).open(&config).unwrap();
    waits.extend(halves.drive_in.iter().map(DriveIn::longest_wait));
    waits.extend(halves.drive_out.iter().map(DriveOut::longest_wait));
    waits.extend(halves.board_clock.iter().map(BoardClock::longest_wait));
    assert_eq!(waits, [Nanos::ZERO; 8]);
}

#[test]
fn the_machine_file_declares_it_by_name() {
    let parsed: Config = toml::from_str("exchange = \"pipelined\"\n").unwrap();
    assert_eq!(parsed.exchange, ExchangeTimes::Pipelined);
    assert!(parsed.exchange_wait() == Nanos::ZERO && Config::default().exchange_wait().0 > 0);
    let refused = toml::from_str::<Config>("exchange = \"later\"\n").unwrap_err().to_string();
    assert!(refused.contains("pipelined") && refused.contains("once"), "{refused}");
}

#[test]
fn the_first_cycle_has_no_reading_and_each_later_one_that_of_the_cycle_before() {
    let (devices, config) = six_drives();
    let rig = Rig::new(devices);
    let mut lane = open(&rig, config);
    let first = lane.cycle(&rig, false, 0);
    assert_eq!(first.counts.map_err(|error| error.kind), Err(ErrorKind::Transient));
    for tick in 1..200 {
        // A cycle sends a frame at its release; what is set afterwards, the next one reads.
        rig.set_counts(|joint| i64::from(tick) * 100 + joint as i64);
        let sent = rig.world().sent;
        let counts = lane.cycle(&rig, false, 0).counts.unwrap();
        let due = if tick == 1 { 0 } else { (tick - 1) * 100 };
        assert_eq!(counts[0], due, "cycle {tick}");
        // Beside the frame of the cycle only the requests of operation of the first ones.
        let frames = rig.world().sent - sent;
        assert!(frames == 1 || (frames == 2 && tick < 12), "cycle {tick}: {frames} frames");
    }
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.exchanges, seen.answers), (200, 199), "{seen:?}");
    assert_eq!((seen.timeouts, seen.stray_frames, seen.wrong_counters), (0, 0, 0), "{seen:?}");
    assert_eq!(rig.world().segment.states(), [State::Operational; 7]);
}

#[test]
fn torque_turns_motors_one_cycle_later() {
    let (rig, mut lane) = following();
    let before = lane.cycle(&rig, true, 300).counts.unwrap();
    assert_eq!(rig.world().segment.target_torques(), [0; 6], "it goes with the next frame");
    let after = lane.cycles(&rig, 100, true, 300).counts.unwrap();
    assert_eq!(rig.world().segment.target_torques(), [300; 6]);
    for (before, after) in before.iter().zip(after) {
        assert!((80..130).contains(&(after - before)), "{before} to {after}");
    }
}

#[test]
fn an_answer_that_comes_within_the_cycle_is_in_time_however_long_it_took() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig =
        rig.with_faults(&[&format!("kind=delay target=ethercat at={at} for=0.05 value=0.0006")]);
    for _ in 0..60 {
        let cycle = lane.cycle(&rig, true, 0);
        assert!(cycle.counts.is_ok() && cycle.analog.is_ok(), "{cycle:?}");
    }
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.timeouts, seen.stray_frames), (0, 0), "{seen:?}");
}

#[test]
fn an_answer_that_is_later_than_a_cycle_is_counted_and_never_taken_for_the_next_one() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig =
        rig.with_faults(&[&format!("kind=delay target=ethercat at={at} for=0.0005 value=0.0015")]);
    let sent = lane.cycle(&rig, true, 0);
    assert!(sent.counts.is_ok(), "the answer of the cycle before: {sent:?}");
    let late = lane.cycle(&rig, true, 0);
    assert_eq!(late.counts.map_err(|error| error.kind), Err(ErrorKind::Transient));
    let next = lane.cycles(&rig, 3, true, 0);
    assert!(next.counts.is_ok() && next.analog.is_ok(), "{next:?}");
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.timeouts, seen.stray_frames), (1, 1), "{seen:?}");
    assert_eq!(seen.exchanges, seen.answers + 2, "one is lost, one under way: {seen:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
}

#[test]
fn a_lost_frame_costs_one_reading() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=silence target=ethercat at={at} for=0.0005")]);
    let outcomes: Vec<bool> = (0..10).map(|_| lane.cycle(&rig, true, 0).counts.is_ok()).collect();
    assert_eq!(outcomes.iter().filter(|is_good| !**is_good).count(), 1, "{outcomes:?}");
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.timeouts, seen.stray_frames, seen.state_drops), (1, 0, 0), "{seen:?}");
}

#[test]
fn a_cable_that_was_pulled_and_returns_leads_the_devices_back_without_a_wait() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=unplugged target=ethercat.4 at={at} for=0.05")]);
    lane.cycles(&rig, 30, true, 100);
    assert_eq!(rig.world().segment.enabled_drives()[2..], [false; 4]);
    let back = lane.cycles(&rig, 80, true, 100);
    assert!(back.counts.is_ok(), "{back:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [false; 6], "a wish that stood waits");
    assert_eq!(rig.world().segment.states()[1..], [State::Operational; 6]);
    let seen = lane.halves.monitor.diagnostics();
    assert!(seen.wrong_counters > 0 && seen.recoveries >= 4 && seen.state_drops > 0, "{seen:?}");
}

#[test]
fn silence_ends_in_loss_and_safe_values_still_go_out() {
    let (rig, mut lane) = following();
    lane.cycles(&rig, 20, true, 500);
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=silence target=ethercat at={at} for=0.5")]);
    let last = lane.cycles(&rig, 400, true, 500);
    assert_eq!(last.counts.map_err(|error| error.kind), Err(ErrorKind::Lost));
    let analog = lane.halves.analog_out.as_mut().unwrap().safe();
    assert_eq!(analog.map_err(|error| error.kind), Err(ErrorKind::Lost));
}

#[test]
fn halves_that_go_leave_the_devices_in_init() {
    let (rig, mut lane) = following();
    lane.cycle(&rig, true, 300);
    drop(lane);
    let world = rig.world();
    assert_eq!(world.segment.states(), [State::Init; 7]);
    assert_eq!(world.segment.outputs().torques, [0.0; 6]);
}

#[test]
fn process_data_that_do_not_fit_into_one_frame_are_refused() {
    let count = 50;
    let mut devices = vec![Model::Coupler.into()];
    devices.extend((0..count).map(|_| Model::AnalogInput.into()));
    let mut listed = vec![DeviceConfig::of(Kind::Ek1100)];
    listed.extend((0..count).map(|_| DeviceConfig::of(Kind::El3104)));
    let config = Config { devices: listed, ..Config::default() };
    let rig = Rig::new(devices);
    let refusal = rig.open(&pipelined(config.clone())).unwrap_err().to_string();
    assert!(refusal.contains("51 devices") && refusal.contains("a frame has"), "{refusal}");
    assert!(rig.open(&config).is_ok(), "several frames are waited for one after the other");
}
