//! Controllers, moteus and ODrive: enabling, torque, watchdog, faults, and the way out of both.

mod rig;

use rig::{CYCLE_PERIOD, DRIVE_IDS, Lane, Rig, config};
use taktil_drivers_can::{NodeConfig, Protocol};
use taktil_drivers_can_emulator::Kind;
use taktil_hal::{AnalogOut, DigitalOut, ErrorKind};

const BOTH: [(Kind, Protocol); 2] =
    [(Kind::Moteus, Protocol::Moteus), (Kind::Odrive, Protocol::Odrive)];

fn lane(kind: Kind, protocol: Protocol, faults: &[&str]) -> Lane {
    Lane::new(&Rig::new(kind, faults), &config(protocol))
}

#[test]
fn enabled_controllers_follow_torques_and_tell_their_positions() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &[]);
        lane.cycles(false, 500, 20);
        assert_eq!(lane.enabled(), 0, "{kind:?}");
        lane.cycles(true, 500, 20);
        assert_eq!(lane.enabled(), 3, "{kind:?}");
        let seen = lane.rig.outputs(2);
        // Half a newton metre has an exact float.
        assert!(seen.target == 500 && (seen.torque_nm - 0.5).abs() < 1e-12, "{seen:?}");
        let cycles = lane.cycles(true, 500, 100);
        let counts: Vec<i32> = cycles.iter().map(|cycle| cycle.counts.unwrap()).collect();
        assert!(counts.is_sorted() && counts[99] > 10_000, "{kind:?}: {counts:?}");
        let turns = lane.rig.motor(0).turns;
        let counts = f64::from(counts[99]) / f64::from(NodeConfig::default().counts_per_turn);
        // The motor has turned on since the answer, by a cycle at its speed.
        let since = lane.rig.motor(0).speed * CYCLE_PERIOD.as_secs_f64();
        assert!((turns - counts).abs() <= since + 1e-4, "{kind:?}: {turns} {counts}");
        assert_eq!(lane.counted("missing answers"), 0, "{kind:?}");
    }
}

#[test]
fn silence_is_ended_by_the_controllers_own_watchdog_and_left_by_two_acts() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &[]);
        lane.cycles(true, 200, 30);
        assert_eq!(lane.enabled(), 3, "{kind:?}");
        lane.rig.advance(lane.release + lane.halves.analog_out.as_mut().unwrap().longest_silence());
        assert_eq!(lane.enabled(), 0, "{kind:?}");
        lane.release = lane.rig.next_release();
        lane.cycles(true, 200, 20);
        assert_eq!(lane.enabled(), 0, "{kind:?}: the wish that stands brings nothing back");
        lane.cycles(false, 0, 10);
        lane.cycles(true, 200, 20);
        assert_eq!(lane.enabled(), 0, "{kind:?}: the first edge clears");
        lane.cycles(false, 0, 10);
        lane.cycles(true, 200, 20);
        assert_eq!(lane.enabled(), 3, "{kind:?}");
    }
}

#[test]
fn dead_lines_are_not_kept_alive_by_torques() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &[]);
        lane.cycles(true, 200, 30);
        lane.feeds = false;
        let silence = config(protocol).silence_ms as usize * 1_000_000;
        lane.cycles(true, 200, silence / CYCLE_PERIOD.0 as usize);
        assert_eq!(lane.enabled(), 0, "{kind:?}");
    }
}

#[test]
fn a_fault_of_a_controller_opens_the_chain_and_takes_one_new_wish() {
    for (kind, protocol) in BOTH {
        let faults = ["kind=failing target=can.1 value=1 at=0.2 for=0.05"];
        let mut lane = lane(kind, protocol, &faults);
        lane.cycles(true, 200, 75);
        assert_eq!(lane.enabled(), 3, "{kind:?}");
        lane.cycles(true, 200, 20);
        let lines = taktil_hal::DigitalIn::sample(&mut lane.halves.digital_in, lane.release);
        let lines = lines.unwrap().value;
        assert!(!lines.estop_a_closed && lines.drive_power, "{kind:?}");
        assert_ne!(lane.halves.monitor.error_code(0), 0, "{kind:?}");
        lane.cycles(true, 200, 20);
        assert!(!lane.rig.outputs(0).is_enabled, "{kind:?}");
        lane.cycles(false, 0, 5);
        lane.cycles(true, 200, 20);
        assert_eq!(lane.enabled(), 3, "{kind:?}: one rise brings all of them back");
    }
}

#[test]
fn safe_values_are_put_out_at_once() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &[]);
        lane.cycles(true, 200, 30);
        lane.halves.analog_out.as_mut().unwrap().safe().unwrap();
        assert_eq!(lane.rig.outputs(1).target, 0, "{kind:?}");
        lane.halves.digital_out.as_mut().unwrap().safe().unwrap();
        assert_eq!(lane.enabled(), 0, "{kind:?}");
        lane.halves.analog_out.as_mut().unwrap().safe().unwrap();
        assert_eq!(lane.enabled(), 0, "{kind:?}: a torque of zero enables nothing");
    }
}

#[test]
fn a_controller_that_vanishes_is_lost_by_name() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &["kind=silence target=can.3 at=0.2"]);
        lane.cycles(true, 200, 60);
        let last = lane.cycles(true, 200, 60)[59].counts.unwrap_err();
        assert_eq!((last.kind, last.channel), (ErrorKind::Lost, 2), "{kind:?}");
        assert_eq!(lane.counted("drives gone silent"), 1, "{kind:?}");
    }
}

#[test]
fn controllers_that_come_up_while_they_are_asked_are_set_up_all_the_same() {
    for (kind, protocol) in BOTH {
        let mut lane = lane(kind, protocol, &["kind=silence at=0 for=0.1"]);
        assert!(lane.release > taktil_hal::Nanos::from_millis(100), "{kind:?}");
        lane.cycles(true, 200, 40);
        let outputs = [0, 1, 2].map(|place| lane.rig.outputs(place));
        let torques = outputs.map(|outputs| outputs.is_enabled && outputs.torque_nm > 0.1);
        assert_eq!(torques, [true; 3], "{kind:?}: {outputs:?}");
    }
}

#[test]
fn a_number_that_nobody_has_is_refused_by_name() {
    for (kind, protocol) in BOTH {
        let rig = Rig::with_ids(kind, &DRIVE_IDS[..2], &[]);
        let text = rig.open(&config(protocol)).unwrap_err().to_string();
        assert!(text.contains("9 sends no position within 500 ms"), "{text}");
    }
}
