//! What the driver does when frames are lost, cables are pulled, devices leave operation and drives
//! fail.

mod rig;

use rig::{Lane, Rig, six_drives, terminals};
use taktil_drivers_ethercat::fault_text;
use taktil_drivers_ethercat_emulator::{PLANNED_ERROR_CODE, State};
use taktil_hal::{DigitalOut, DriveIn, DriveState, ErrorKind, Nanos};

/// Six drives that follow, with motors behind them.
fn following() -> (Rig, Lane) {
    let (devices, config) = six_drives();
    let rig = Rig::with_motors(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    lane.cycles(&rig, 30, false, 0);
    let last = lane.cycles(&rig, 10, true, 0);
    assert!(last.counts.is_ok() && last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
    (rig, lane)
}

#[test]
fn torque_turns_motors_and_the_encoders_follow() {
    let (rig, mut lane) = following();
    let before = lane.cycle(&rig, true, 300).counts.unwrap();
    let after = lane.cycles(&rig, 100, true, 300).counts.unwrap();
    for (before, after) in before.iter().zip(after) {
        // 24 000 counts/s^2 for a tenth of a second, less friction.
        assert!((90..130).contains(&(after - before)), "{before} to {after}");
    }
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.timeouts, seen.wrong_counters, seen.stray_frames), (0, 0, 0), "{seen:?}");
    assert_eq!((seen.exchanges, seen.answers), (seen.answers, seen.exchanges), "{seen:?}");
}

#[test]
fn what_the_drives_say_of_themselves_is_told() {
    let (devices, config) = six_drives();
    let halves = Rig::new(devices).open(&config).unwrap();
    assert_eq!(halves.drives.len(), 6);
    let first = halves.drives[0];
    assert_eq!(
        (first.device, first.rated_torque_mnm, first.torque_max_permille),
        (1, 1_270, 3_000)
    );
    assert_eq!((first.supported_modes, first.quick_stop_option), (0x380, 2));
    let range = taktil_hal::AnalogOut::code_range(halves.analog_out.as_ref().unwrap());
    assert_eq!((range.0.0, range.1.0), (-3_000, 3_000));
}

#[test]
fn a_falling_line_stops_the_drives_by_their_quick_stop() {
    let (rig, mut lane) = following();
    lane.cycles(&rig, 100, true, 500);
    let turning = rig.outputs().torques;
    assert_eq!(turning, [0.5; 6]);
    lane.cycle(&rig, false, 0);
    assert_eq!(rig.world().segment.controls(), [2; 6]);
    assert!(rig.outputs().torques.iter().all(|torque| *torque < 0.0), "they brake");
    lane.cycles(&rig, 600, false, 0);
    assert_eq!(rig.world().segment.controls(), [0; 6]);
    assert_eq!(rig.outputs().torques, [0.0; 6]);
}

#[test]
fn a_lost_frame_costs_one_reading_and_is_counted() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=silence target=ethercat at={at} for=0.0005")]);
    let lost = lane.cycle(&rig, true, 0);
    assert_eq!(lost.counts.map_err(|error| error.kind), Err(ErrorKind::Transient));
    let good = lane.cycles(&rig, 10, true, 0);
    assert!(good.counts.is_ok() && good.analog.is_ok(), "{good:?}");
    let seen = lane.halves.monitor.diagnostics();
    assert!((1..=2).contains(&seen.timeouts) && seen.state_drops == 0, "{seen:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
}

#[test]
fn a_late_frame_is_counted_and_its_data_are_not_taken_for_new_ones() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let late = format!("kind=delay target=ethercat at={at} for=0.0005 value=0.0006");
    let rig = rig.with_faults(&[&late]);
    assert!(lane.cycle(&rig, true, 0).counts.is_err());
    assert!(lane.cycles(&rig, 5, true, 0).counts.is_ok());
    let seen = lane.halves.monitor.diagnostics();
    assert!(seen.timeouts > 0 && seen.stray_frames > 0, "{seen:?}");
}

#[test]
fn a_pulled_cable_stops_the_drives_and_its_return_moves_nothing_by_itself() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let pulled = format!("kind=unplugged target=ethercat.4 at={at} for=0.05");
    let rig = rig.with_faults(&[&pulled]);
    let cut = lane.cycle(&rig, true, 100);
    assert_eq!(cut.counts.map_err(|error| error.kind), Err(ErrorKind::Transient));
    lane.cycles(&rig, 30, true, 100);
    assert_eq!(
        rig.world().segment.enabled_drives()[2..],
        [false; 4],
        "their watchdogs have bitten"
    );
    // The cable is back: the segment operates again, the drives wait for a new wish.
    let back = lane.cycles(&rig, 60, true, 100);
    assert!(back.counts.is_ok(), "{back:?}");
    assert_eq!(back.analog.map_err(|error| error.kind), Err(ErrorKind::Transient));
    assert_eq!(rig.world().segment.enabled_drives(), [false; 6]);
    assert_eq!(rig.world().segment.states()[1..], [State::Operational; 6]);
    let seen = lane.halves.monitor.diagnostics();
    assert!(seen.wrong_counters > 0 && seen.recoveries >= 4 && seen.state_drops > 0, "{seen:?}");
    assert!(seen.drive_faults >= 4, "{seen:?}");
    // The commits have told of it: the line falls and rises once, which resets and enables.
    lane.cycles(&rig, 10, false, 0);
    assert_eq!(rig.world().segment.enabled_drives(), [false; 6]);
    let last = lane.cycles(&rig, 15, true, 0);
    assert!(last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
}

#[test]
fn a_segment_that_stays_silent_is_lost_for_good() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=unplugged target=ethercat at={at} for=0.4")]);
    let mut kinds = Vec::new();
    for _ in 0..500 {
        let cycle = lane.cycle(&rig, true, 0);
        kinds.push(cycle.counts.map(|_| ()).map_err(|error| error.kind).err());
    }
    kinds.dedup();
    let due = [ErrorKind::Transient, ErrorKind::Stale, ErrorKind::Lost].map(Some);
    assert_eq!(kinds, due);
}

#[test]
fn a_fault_of_a_drive_fails_its_channel_and_tells_its_code() {
    let (rig, mut lane) = following();
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=failing target=ethercat.4 at={at} for=9 value=1")]);
    let last = lane.cycles(&rig, 5, true, 0);
    let error = last.analog.unwrap_err();
    assert_eq!((error.kind, error.channel), (ErrorKind::Transient, 2));
    assert!(last.counts.is_ok() && last.lines.is_ok(), "{last:?}");
    let seen = lane.halves.monitor.diagnostics();
    assert_eq!((seen.drive_faults, seen.newest_fault_device), (1, 4), "{seen:?}");
    assert_eq!(seen.newest_fault_code, u64::from(PLANNED_ERROR_CODE));
    assert_eq!(fault_text(seen.newest_fault_code as u16), "following error");
}

#[test]
fn after_a_fault_that_was_told_one_rise_of_the_line_brings_all_drives_back() {
    let (rig, mut lane) = following();
    lane.cycles(&rig, 50, true, 300);
    let at = rig.world().now.as_secs_f64();
    let fault = format!("kind=failing target=ethercat.4 at={at} for=0.02 value=1");
    let rig = rig.with_faults(&[&fault]);
    assert_eq!(lane.cycles(&rig, 5, true, 0).analog.unwrap_err().channel, 2);
    // Neither the line that stands nor the one that falls resets the fault.
    lane.cycles(&rig, 200, true, 0);
    assert_eq!(lane.cycles(&rig, 700, false, 0).lines, Ok(()));
    let states = lane.halves.drive_in.as_mut().unwrap().sample(lane.release).unwrap().value;
    assert_eq!((states[2].state, states[1].state), (DriveState::Fault, DriveState::Off));
    let last = lane.cycles(&rig, 15, true, 0);
    assert!(last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
    let before = lane.cycle(&rig, true, 300).counts.unwrap();
    let after = lane.cycles(&rig, 100, true, 300).counts.unwrap();
    assert!((0..6).all(|joint| after[joint] - before[joint] > 80), "{before:?} to {after:?}");
}

#[test]
fn drives_whose_watchdogs_bite_after_the_line_was_given_up_come_back_by_one_rise() {
    let (rig, mut lane) = following();
    lane.cycles(&rig, 50, true, 300);
    let at = rig.world().now.as_secs_f64();
    let rig = rig.with_faults(&[&format!("kind=unplugged target=ethercat.4 at={at} for=0.05")]);
    // A machine that tolerates three failed writes takes the line away before a watchdog of 10 ms.
    let cut = lane.cycles(&rig, 4, true, 300);
    assert!(cut.lines.is_err(), "{cut:?}");
    assert_eq!(rig.world().segment.enabled_drives()[2..], [true; 4], "no watchdog has bitten yet");
    // Their reaction to the fault takes as long as their motors turn.
    lane.cycles(&rig, 700, false, 0);
    let states = lane.halves.drive_in.as_mut().unwrap().sample(lane.release).unwrap().value;
    assert_eq!((states[0].state, states[4].state), (DriveState::Off, DriveState::Fault));
    let last = lane.cycles(&rig, 15, true, 0);
    assert!(last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
}

#[test]
fn a_fault_at_rest_is_told_before_it_is_enabled_over() {
    let (rig, mut lane) = following();
    lane.cycles(&rig, 600, false, 0);
    let at = rig.world().now.as_secs_f64();
    let fault = format!("kind=failing target=ethercat.4 at={at} for=0.02 value=1");
    let rig = rig.with_faults(&[&fault]);
    lane.cycles(&rig, 40, false, 0);
    // Nobody was told: the first rise resets, and the drive is missing.
    lane.cycles(&rig, 100, true, 0);
    let others = [true, true, false, true, true, true];
    assert_eq!(rig.world().segment.enabled_drives(), others);
    let missing = lane.cycles(&rig, 500, true, 0);
    assert_eq!(missing.analog.map_err(|error| error.channel), Err(2));
    lane.cycles(&rig, 10, false, 0);
    let last = lane.cycles(&rig, 15, true, 0);
    assert!(last.analog.is_ok() && last.lines.is_ok(), "{last:?}");
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
}

#[test]
fn a_device_that_leaves_operation_is_led_back() {
    let (devices, config) = terminals();
    let rig = Rig::new(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    lane.cycles(&rig, 30, false, 0);
    assert!(lane.cycles(&rig, 3, false, 1_000).analog.is_ok());
    rig.world().segment.drop_device(1, State::SafeOperational);
    let dropped = lane.cycle(&rig, false, 1_000);
    assert!(dropped.counts.is_ok(), "inputs are good in SAFEOP: {dropped:?}");
    assert_eq!(dropped.analog.map_err(|error| error.kind), Err(ErrorKind::Transient));
    let back = lane.cycles(&rig, 5, false, 1_000);
    assert!(back.analog.is_ok(), "{back:?}");
    assert_eq!(lane.halves.monitor.diagnostics().state_drops, 1);
    // What cannot be led back in a lane is lost: its working counter stays low.
    rig.world().segment.drop_device(1, State::Init);
    let gone = lane.cycles(&rig, 250, false, 0);
    assert_eq!(gone.counts.map_err(|error| error.kind), Err(ErrorKind::Lost));
}

#[test]
fn a_half_that_falls_silent_is_made_safe_while_the_other_goes_on() {
    let (rig, mut lane) = following();
    lane.cycle(&rig, true, 400);
    for _ in 0..30 {
        lane.release += rig::CYCLE_PERIOD;
        lane.feed = !lane.feed;
        let lines =
            taktil_hal::LinesOut { enable: true, brake_release: true, watchdog_feed: lane.feed };
        let half = lane.halves.digital_out.as_mut().unwrap();
        let _ = half.commit(lane.release, &lines);
        rig.pass(Nanos::from_micros(900));
    }
    assert_eq!(rig.outputs().torques, [0.0; 6]);
    assert_eq!(rig.world().segment.enabled_drives(), [true; 6]);
    assert_eq!(lane.halves.monitor.diagnostics().silences, 1);
}

#[test]
fn a_line_whose_feed_stands_still_takes_the_drives() {
    let (rig, mut lane) = following();
    for _ in 0..30 {
        lane.feed = false;
        lane.cycle(&rig, true, 0);
    }
    assert_eq!(rig.world().segment.enabled_drives(), [false; 6]);
    assert_eq!(lane.halves.monitor.diagnostics().silences, 1);
}

#[test]
fn halves_that_go_leave_the_devices_in_init() {
    let (rig, lane) = following();
    drop(lane);
    let world = rig.world();
    assert_eq!(world.segment.states(), [State::Init; 7]);
    assert_eq!(world.segment.outputs().torques, [0.0; 6]);
}
