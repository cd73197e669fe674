//! Drives of CANopen: set-up, enabling, torque, faults, silence and what ends it for good.

mod rig;

use rig::{CYCLE_PERIOD, DRIVE_IDS, Lane, Rig, config};
use taktil_drivers_can::{Config, NodeConfig, Protocol};
use taktil_drivers_can_emulator::{BusFrame, Kind, error_report};
use taktil_hal::{AnalogOut, DigitalIn, DigitalOut, ErrorKind, Nanos};

/// A rated torque (mNm).
const RATED_MNM: u32 = 2_000;

fn lane(faults: &[&str]) -> Lane {
    Lane::new(&Rig::new(Kind::CanOpen(RATED_MNM), faults), &config(Protocol::Canopen))
}

#[test]
fn enabled_drives_follow_torques_and_tell_their_positions() {
    let mut lane = lane(&[]);
    assert!(lane.cycles(false, 100, 20).iter().all(|cycle| cycle.counts == Ok(0)));
    assert_eq!((lane.enabled(), lane.rig.outputs(0).target), (0, 0));
    // A cycle each for ready, switched on and enabled, and one for the torque.
    let way: Vec<usize> = (0..5)
        .map(|_| {
            lane.cycle(true, 100);
            lane.enabled()
        })
        .collect();
    assert_eq!(way, [0, 0, 3, 3, 3]);
    let seen = lane.rig.outputs(1);
    // A tenth of the rated 2 Nm, by a product of exact numbers and 1e-6.
    assert!(seen.target == 100 && (seen.torque_nm - 0.2).abs() < 1e-12, "{seen:?}");
    let cycles = lane.cycles(true, 100, 200);
    let counts: Vec<i32> = cycles.iter().map(|cycle| cycle.counts.unwrap()).collect();
    assert!(counts.is_sorted() && counts[199] > 10_000, "{counts:?}");
    assert!(cycles.iter().all(|cycle| cycle.torques.is_ok() && cycle.lines.is_ok()));
    assert_eq!((lane.counted("missing answers"), lane.counted("late answers")), (0, 0));
    let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
    assert!(lines.drive_power && lines.estop_a_closed && lines.estop_b_closed);
}

#[test]
fn a_fault_is_told_and_takes_two_acts() {
    let mut lane = lane(&["kind=failing target=can.2 value=1 at=0.3 for=0.1"]);
    lane.cycles(true, 50, 100);
    assert_eq!(lane.enabled(), 3);
    lane.cycles(true, 50, 30);
    let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
    assert!(!lines.estop_a_closed && !lines.estop_b_closed && lines.drive_power);
    assert_eq!(lane.halves.monitor.error_code(1), 0x2310);
    assert_eq!(lane.halves.monitor.error_text(1), "continuous overcurrent of the motor");
    assert_eq!(lane.counted("emergency messages"), 1);
    lane.cycles(true, 50, 100);
    assert_eq!(lane.enabled(), 2, "the wish that stands brings nothing back");
    // The line falls, the chain closes, and one rise resets the drive and enables all of them.
    lane.cycles(false, 0, 5);
    let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
    assert!(lines.estop_a_closed && lines.drive_power, "nothing keeps a person from enabling");
    for _ in 0..20 {
        lane.cycles(true, 50, 1);
        let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
        assert!(lines.estop_a_closed && lines.estop_b_closed, "the reset is under way");
    }
    assert_eq!(lane.enabled(), 3);
    let counts = |cycles: Vec<rig::Cycle>| cycles.last().unwrap().counts.unwrap();
    let before = counts(lane.cycles(true, 100, 1));
    assert!(counts(lane.cycles(true, 100, 100)) > before + 1_000, "it moves again");
}

#[test]
fn a_fault_at_rest_is_told_before_it_is_enabled_over() {
    let rig =
        Rig::new(Kind::CanOpen(RATED_MNM), &["kind=failing target=can.2 value=1 at=0.1 for=0.1"]);
    let mut lane = Lane::new(&rig, &Config { enable_ms: 50, ..config(Protocol::Canopen) });
    lane.cycles(false, 0, 120);
    lane.cycles(true, 50, 10);
    assert!(!lane.rig.outputs(1).is_enabled, "the first rise resets");
    assert_eq!(lane.enabled(), 2);
    lane.cycles(true, 50, 20);
    let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
    assert!(!lines.drive_power, "the drive is missing");
    lane.cycles(false, 0, 5);
    lane.cycles(true, 50, 20);
    assert_eq!(lane.enabled(), 3);
}

#[test]
fn a_drive_that_is_not_enabled_in_time_takes_power_away() {
    let rig = Rig::new(Kind::CanOpen(RATED_MNM), &["kind=failing target=can.3 value=1"]);
    let mut lane = Lane::new(&rig, &Config { enable_ms: 50, ..config(Protocol::Canopen) });
    let power = |lane: &mut Lane| {
        let lines = lane.halves.digital_in.sample(lane.release).unwrap().value;
        lane.release += CYCLE_PERIOD;
        lines.drive_power
    };
    lane.cycles(true, 0, 10);
    assert!(power(&mut lane));
    lane.cycles(true, 0, 20);
    assert!(!power(&mut lane));
    lane.cycles(false, 0, 1);
    assert!(power(&mut lane), "it is wanted no longer");
}

#[test]
fn silence_of_either_half_switches_torque_off_in_time() {
    let silence = config(Protocol::Canopen).silence_ms as usize;
    let cycles = silence * 1_000_000 / CYCLE_PERIOD.0 as usize;
    for (feeds, commits) in [(false, true), (true, false), (false, false)] {
        let mut lane = lane(&[]);
        lane.cycles(true, 50, 50);
        assert_eq!(lane.enabled(), 3);
        (lane.feeds, lane.commits) = (feeds, commits);
        lane.cycles(true, 50, cycles);
        assert_eq!(lane.enabled(), 0, "feeds {feeds}, commits {commits}");
    }
    // Without any software: time passes, and nobody sends anything.
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 50);
    lane.rig.advance(lane.release + lane.halves.analog_out.as_mut().unwrap().longest_silence());
    assert_eq!(lane.enabled(), 0);
}

#[test]
fn safe_values_are_put_out_at_once_and_on_drop() {
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 50);
    lane.halves.analog_out.as_mut().unwrap().safe().unwrap();
    assert_eq!((lane.rig.outputs(2).target, lane.enabled()), (0, 3));
    lane.halves.digital_out.as_mut().unwrap().safe().unwrap();
    assert_eq!(lane.enabled(), 0);
    lane.cycles(false, 0, 1);
    lane.cycles(true, 50, 50);
    assert_eq!(lane.enabled(), 3, "a safe state is not latched");
    let Lane { rig, halves, .. } = lane;
    drop(halves);
    for place in 0..DRIVE_IDS.len() {
        let outputs = rig.outputs(place);
        assert!(!outputs.is_enabled && outputs.target == 0);
    }
}

#[test]
fn a_lost_frame_is_transient_and_a_lost_controlword_is_repeated() {
    let mut lane = lane(&["kind=loss value=0.05 at=0.1"]);
    let cycles = lane.cycles(true, 50, 400);
    assert_eq!(lane.enabled(), 3);
    let bad: Vec<_> = cycles.iter().filter_map(|cycle| cycle.counts.err()).collect();
    assert!(bad.len() > 10 && bad.iter().all(|error| error.kind == ErrorKind::Transient));
    assert!(bad.iter().all(|error| usize::from(error.channel) < DRIVE_IDS.len()), "{bad:?}");
    assert!(lane.counted("missing answers") >= bad.len() as u64);
}

#[test]
fn a_late_answer_is_no_answer() {
    let mut lane = lane(&["kind=delay value=0.004 target=can.1 at=0.1 for=0.03"]);
    lane.cycles(true, 50, 30);
    let before = lane.counted("late answers");
    let cycles = lane.cycles(true, 50, 30);
    assert!(cycles.iter().any(|cycle| cycle.counts.is_err()));
    assert!(lane.counted("late answers") > before);
    assert!(cycles[29].counts.is_ok());
}

#[test]
fn a_drive_that_falls_silent_is_lost_by_name() {
    let mut lane = lane(&["kind=silence target=can.2 at=0.2"]);
    lane.cycles(true, 50, 60);
    let cycles = lane.cycles(true, 50, 60);
    let first = cycles.iter().find_map(|cycle| cycle.counts.err()).unwrap();
    assert_eq!((first.kind, first.channel), (ErrorKind::Transient, 1));
    let last = cycles[59].counts.unwrap_err();
    assert_eq!((last.kind, last.channel), (ErrorKind::Lost, 1));
    assert_eq!(cycles[59].torques.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(lane.counted("drives gone silent"), 1);
    // The others get their safe values all the same.
    let _ = lane.halves.digital_out.as_mut().unwrap().safe();
    assert!(!lane.rig.outputs(0).is_enabled);
}

#[test]
fn a_drive_that_restarts_is_lost() {
    let mut lane = lane(&["kind=restart target=can.3 at=0.2"]);
    lane.cycles(true, 50, 60);
    let last = lane.cycles(true, 50, 40)[39].counts.unwrap_err();
    assert_eq!((last.kind, last.channel), (ErrorKind::Lost, 2));
    assert_eq!(lane.counted("drives restarted"), 1);
}

#[test]
fn a_drive_that_leaves_the_exchange_is_lost() {
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 20);
    // Somebody else stops the drive of the second channel.
    lane.rig.inject(&BusFrame::classic(0x705, &[0x04]));
    let error = lane.cycles(true, 50, 2)[1].counts.unwrap_err();
    assert_eq!((error.kind, error.channel), (ErrorKind::Lost, 1));
    assert_eq!(lane.counted("drives that left"), 1);
}

#[test]
fn errors_of_the_controller_are_counted_and_bus_off_is_final() {
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 20);
    for (class, state) in [(0x04, 0x20), (0x20, 0), (0x88, 0), (0x100, 0)] {
        lane.rig.inject(&error_report(class, state));
        assert!(lane.cycle(true, 50).counts.is_ok());
    }
    let numbers = ["error frames", "error passive", "not acknowledged"].map(|n| lane.counted(n));
    assert_eq!(numbers, [4, 1, 1]);
    assert_eq!((lane.counted("restarts of the controller"), lane.counted("bus-off")), (1, 0));
    lane.rig.inject(&error_report(0x40, 0));
    let after = lane.cycles(true, 50, 3);
    assert_eq!(after[2].counts.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(after[2].lines.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(lane.counted("bus-off"), 1);
}

#[test]
fn a_full_queue_is_transient_and_counted() {
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 20);
    // The SYNC and one torque pass.
    lane.rig.set_room(2);
    let cycle = lane.cycle(true, 50);
    assert!(cycle.counts.is_ok());
    assert_eq!(cycle.torques.unwrap_err().kind, ErrorKind::Transient);
    assert!(lane.counted("frames not sent, queue full") >= 2);
    lane.rig.set_room(usize::MAX);
    let cycle = lane.cycle(true, 50);
    assert!(cycle.torques.is_ok() && cycle.lines.is_ok());
}

#[test]
fn halves_that_end_on_a_full_queue_put_every_safe_value_out() {
    let mut lane = lane(&[]);
    lane.cycles(true, 50, 20);
    assert_eq!(lane.enabled(), 3);
    assert!((0..3).all(|place| lane.rig.outputs(place).target == 50));
    // Nothing passes now, and one frame after each wait.
    lane.rig.set_room(0);
    lane.rig.world.lock().unwrap().room_a_wait = 1;
    let rig = lane.rig.clone();
    drop(lane);
    assert!((0..3).all(|place| rig.outputs(place).target == 0), "no torque is left");
    assert!((0..3).all(|place| !rig.outputs(place).is_wanted), "no drive is led on");
}

#[test]
fn a_pulled_cable_is_reported_and_lost_in_time() {
    let mut lane = lane(&["kind=unplugged at=0.2"]);
    lane.cycles(true, 50, 130);
    assert_eq!(lane.cycle(true, 50).counts.unwrap_err().kind, ErrorKind::Lost);
    assert_eq!(lane.counted("not acknowledged"), 1);
    assert_eq!(lane.enabled(), 0, "the drives miss the host");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let refused = |rig: &Rig, config: &Config| rig.open(config).unwrap_err().to_string();
    let rig = Rig::new(Kind::CanOpen(RATED_MNM), &[]);
    let nodes = vec![NodeConfig { id: 5, rated_torque_mnm: 1_999, ..NodeConfig::default() }];
    let text = refused(&rig, &Config { nodes, ..config(Protocol::Canopen) });
    assert!(text.contains("drive 5 has a rated torque of 2000 mNm, not 1999"), "{text}");
    let nodes = vec![NodeConfig { id: 7, ..NodeConfig::default() }];
    let text = refused(&rig, &Config { nodes, ..config(Protocol::Canopen) });
    assert!(text.contains("drive 7 does not answer within 500 ms"), "{text}");
    let moteus = Rig::new(Kind::Moteus, &[]);
    let text = refused(&moteus, &config(Protocol::Canopen));
    assert!(text.contains("drive 1 does not answer"), "{text}");
}

#[test]
fn the_set_up_bears_a_bad_bus() {
    for seed in 0..5 {
        let fault = format!("kind=loss value=0.1 at=0.00{seed}");
        let rig = Rig::new(Kind::CanOpen(RATED_MNM), &[&fault, "kind=duplication value=0.2"]);
        // What is lost is asked for again, most of the time.
        if let Err(error) = rig.open(&config(Protocol::Canopen)) {
            assert!(error.to_string().contains("does not answer"), "{error}");
        }
    }
}

#[test]
fn brakes_are_lifted_by_an_output_of_the_first_drive() {
    let rig = Rig::new(Kind::CanOpen(RATED_MNM), &[]);
    let mut lane = Lane::new(&rig, &Config { brake_bit: Some(16), ..config(Protocol::Canopen) });
    lane.cycles(true, 0, 5);
    let digital = [0, 1].map(|place| lane.rig.outputs(place).digital);
    assert_eq!(digital, [1 << 16, 0]);
    lane.halves.digital_out.as_mut().unwrap().safe().unwrap();
    assert_eq!(lane.rig.outputs(0).digital, 0);
}

#[test]
fn a_second_sample_of_a_release_is_the_same_and_asks_nobody() {
    let mut lane = lane(&[]);
    lane.cycles(true, 100, 50);
    lane.rig.advance(lane.release);
    let first = taktil_hal::Encoders::sample(&mut lane.halves.encoders, lane.release);
    let sent = lane.rig.world.lock().unwrap().sent.len();
    lane.rig.advance(lane.release + Nanos::from_millis(1));
    let again = taktil_hal::Encoders::sample(&mut lane.halves.encoders, lane.release);
    assert_eq!((first, sent), (again, lane.rig.world.lock().unwrap().sent.len()));
}
