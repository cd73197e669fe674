//! The halves of drives that close a loop, over a segment with motors: they conform, follow
//! torques, velocities and positions, and keep following, stopping and resetting apart.

mod rig;

use rig::{CYCLE_PERIOD, Rig, at_drives, six_drives};
use taktil_drivers_ethercat::{Config, DriveMode, ExchangeTimes, Halves, LinesOutConfig};
use taktil_drivers_ethercat_emulator::{Description, PLANNED_ERROR_CODE};
use taktil_hal::conformance::{
    CycleDriver, check_drive_in, check_drive_out_drop, check_drive_out_observed,
};
use taktil_hal::{
    CHANNELS, DigitalOut, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest,
    DriveState, Encoders, Error, ErrorKind, LinesOut, Nanos,
};

/// Six drives in a mode, without the enable line at them.
fn drives(mode: DriveMode) -> (Vec<Description>, Config) {
    let (devices, mut config) = six_drives();
    for device in &mut config.devices[1..] {
        (device.mode, device.code_max) = (mode, Some(3_000));
    }
    config.lines_out = None;
    (devices, config)
}

/// A lane of the halves for drives.
struct Lane {
    halves: Halves,
    release: Nanos,
}

/// What a cycle answered.
struct Cycle {
    reports: [DriveActual; CHANNELS],
    answer: Result<(), Error>,
}

impl Lane {
    fn new(mut halves: Halves) -> Lane {
        // Nobody serves the converters beside the drives.
        halves.analog_out = None;
        Lane { halves, release: Nanos::ZERO }
    }

    fn cycle(&mut self, rig: &Rig, request: DriveRequest, reset: bool, target: i32) -> Cycle {
        self.release += CYCLE_PERIOD;
        let drives = self.halves.drive_in.as_mut().unwrap();
        let reports = drives.sample(self.release).unwrap().value;
        let mut targets = [0; CHANNELS];
        targets[..6].fill(target);
        let command = DriveCommand { targets, request, reset };
        let answer = self.halves.drive_out.as_mut().unwrap().commit(self.release, &command);
        rig.pass(Nanos::from_micros(900));
        Cycle { reports, answer }
    }

    fn cycles(&mut self, rig: &Rig, count: usize, request: DriveRequest, target: i32) -> Cycle {
        for _ in 1..count {
            self.cycle(rig, request, false, target);
        }
        self.cycle(rig, request, false, target)
    }
}

/// Drives that follow, and where they are.
fn following(mode: DriveMode) -> (Rig, Lane, i32) {
    let (devices, config) = drives(mode);
    let rig = Rig::with_motors(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    let at = lane.cycles(&rig, 30, DriveRequest::Off, 0).reports[0].position.0;
    let target = if mode == DriveMode::Position { at } else { 0 };
    let last = lane.cycles(&rig, 10, DriveRequest::Follow, target);
    assert!(last.answer.is_ok(), "{:?}", last.answer);
    assert!(last.reports[..6].iter().all(|drive| drive.state == DriveState::Following));
    (rig, lane, at)
}

#[test]
fn each_mode_follows_its_targets() {
    let (rig, mut lane, at) = following(DriveMode::Position);
    assert_eq!(lane.halves.drive_out.as_ref().unwrap().control_loop(), DriveLoop::Position);
    let far = lane.cycles(&rig, 2_000, DriveRequest::Follow, at + 700).reports[3];
    assert!((far.position.0 - at - 700).abs() < 5, "{far:?}");
    let (rig, mut lane, _) = following(DriveMode::Velocity);
    let fast = lane.cycles(&rig, 2_000, DriveRequest::Follow, 2_000).reports[5];
    // The emulated drive has no integral part, and its motor has friction.
    assert!((1_200..2_001).contains(&fast.velocity_counts_s), "{fast:?}");
    let (rig, mut lane, _) = following(DriveMode::Torque);
    let pushed = lane.cycles(&rig, 100, DriveRequest::Follow, 300).reports[0];
    assert_eq!(pushed.torque_code, 300);
    assert!(pushed.velocity_counts_s > 1_000, "{pushed:?}");
    let counts = lane.halves.encoders.as_mut().unwrap().sample(lane.release).unwrap().value;
    assert_eq!(counts[0], pushed.position, "the encoders count the same");
}

#[test]
fn a_quick_stop_and_off_are_two_requests() {
    let (rig, mut lane, _) = following(DriveMode::Velocity);
    lane.cycles(&rig, 500, DriveRequest::Follow, 2_000);
    let braking = lane.cycles(&rig, 3, DriveRequest::QuickStop, 2_000).reports[0];
    assert_eq!(braking.state, DriveState::Stopping);
    assert!(braking.torque_code < 0, "{braking:?}");
    let stands = lane.cycles(&rig, 600, DriveRequest::QuickStop, 2_000).reports[0];
    assert_eq!((stands.state, stands.torque_code), (DriveState::Off, 0));
    let (rig, mut lane, _) = following(DriveMode::Velocity);
    lane.cycles(&rig, 500, DriveRequest::Follow, 2_000);
    let coasting = lane.cycles(&rig, 3, DriveRequest::Off, 2_000).reports[0];
    assert_eq!((coasting.state, coasting.torque_code), (DriveState::Off, 0));
}

#[test]
fn a_fault_of_a_drive_is_reported_with_its_code_and_reset_by_an_act_of_its_own() {
    let (rig, mut lane, at) = following(DriveMode::Position);
    let now = rig.world().now.as_secs_f64();
    let fault = format!("kind=failing target=ethercat.4 at={now} for=0.02 value=1");
    let rig = rig.with_faults(&[&fault]);
    let failed = lane.cycles(&rig, 8, DriveRequest::Follow, at);
    let report = failed.reports[2];
    assert_eq!((report.state, report.fault_code), (DriveState::Fault, PLANNED_ERROR_CODE));
    let error = failed.answer.unwrap_err();
    assert_eq!((error.kind, error.channel), (ErrorKind::Transient, 2));
    lane.cycles(&rig, 30, DriveRequest::Off, at);
    let again = lane.cycles(&rig, 30, DriveRequest::Follow, at).reports[2];
    assert_eq!(again.state, DriveState::Fault, "a request to follow resets nothing");
    lane.cycles(&rig, 5, DriveRequest::Off, at);
    let reset = (0..5).map(|_| lane.cycle(&rig, DriveRequest::Off, true, at)).last().unwrap();
    assert_eq!((reset.reports[2].state, reset.reports[2].fault_code), (DriveState::Off, 0));
    let last = lane.cycles(&rig, 10, DriveRequest::Follow, at);
    assert!(last.answer.is_ok(), "{:?}", last.answer);
    assert!(last.reports[..6].iter().all(|drive| drive.state == DriveState::Following));
}

#[test]
fn a_request_to_follow_that_stood_through_a_fault_counts_anew() {
    let (rig, mut lane, at) = following(DriveMode::Position);
    let now = rig.world().now.as_secs_f64();
    let fault = format!("kind=failing target=ethercat.4 at={now} for=0.02 value=1");
    let rig = rig.with_faults(&[&fault]);
    lane.cycles(&rig, 40, DriveRequest::Follow, at);
    for _ in 0..10 {
        lane.cycle(&rig, DriveRequest::Follow, true, at);
    }
    let held = lane.cycles(&rig, 20, DriveRequest::Follow, at).reports[2];
    assert_eq!(held.state, DriveState::Off, "{held:?}");
    lane.cycles(&rig, 2, DriveRequest::Off, at);
    let last = lane.cycles(&rig, 10, DriveRequest::Follow, at).reports[2];
    assert_eq!(last.state, DriveState::Following);
}

#[test]
fn the_halves_conform() {
    for (mode, exchange) in [
        (DriveMode::Torque, ExchangeTimes::Twice),
        (DriveMode::Velocity, ExchangeTimes::Once),
        (DriveMode::Position, ExchangeTimes::Twice),
        (DriveMode::Position, ExchangeTimes::Pipelined),
    ] {
        let (devices, config) = drives(mode);
        let config = Config { exchange, watchdog_ms: 5_000, ..config };
        let rig = Rig::with_motors(devices);
        let mut lane = Lane::new(rig.open(&config).unwrap());
        // Without an answer yet there is nothing to read.
        let _ = lane.halves.drive_in.as_mut().unwrap().sample(Nanos::ZERO);
        rig.pass(CYCLE_PERIOD);
        lane.cycles(&rig, 30, DriveRequest::Off, 0);
        let mut bench = CycleDriver::new(lane.release + CYCLE_PERIOD, CYCLE_PERIOD, |_| {
            rig.pass(CYCLE_PERIOD);
        });
        let drives = lane.halves.drive_in.as_mut().unwrap();
        assert_eq!(check_drive_in(drives, &mut bench), [], "{mode:?}");
        let mut powered = || rig.world().segment.enabled_drives().contains(&true);
        let half = lane.halves.drive_out.as_mut().unwrap();
        assert_eq!(check_drive_out_observed(half, &mut bench, &mut powered), [], "{mode:?}");
        let half = Box::new(lane.halves.drive_out.take().unwrap());
        assert_eq!(check_drive_out_drop(half, &mut bench, &mut powered), [], "{mode:?}");
    }
}

#[test]
fn an_enable_line_at_the_drives_has_to_say_so_too() {
    let (devices, mut config) = drives(DriveMode::Torque);
    config.lines_out =
        Some(LinesOutConfig { enable: at_drives(), brake_release: None, watchdog_feed: None });
    let rig = Rig::with_motors(devices);
    let mut lane = Lane::new(rig.open(&config).unwrap());
    assert_eq!(lane.halves.drive_out.as_ref().unwrap().longest_wait(), Nanos::ZERO);
    assert!(lane.halves.digital_out.as_ref().unwrap().longest_wait() > Nanos::ZERO);
    let mut cycle = |line: bool, feed: bool| {
        let cycle = lane.cycle(&rig, DriveRequest::Follow, false, 0);
        let lines = LinesOut { enable: line, brake_release: line, watchdog_feed: feed };
        let _ = lane.halves.digital_out.as_mut().unwrap().commit(lane.release, &lines);
        cycle.reports[0].state
    };
    let without = (0..40).map(|tick| cycle(false, tick % 2 == 0)).last();
    assert_eq!(without, Some(DriveState::Off));
    let with = (0..40).map(|tick| cycle(true, tick % 2 == 0)).last();
    assert_eq!(with, Some(DriveState::Following));
    drop(lane.halves.digital_out.take());
    assert!(lane.halves.drive_out.as_ref().unwrap().longest_wait() > Nanos::ZERO);
}

#[test]
fn drives_of_different_modes_have_no_half_of_their_own() {
    let (devices, mut config) = drives(DriveMode::Torque);
    config.devices[3].mode = DriveMode::Velocity;
    let halves = Rig::with_motors(devices).open(&config);
    // Codes of different worth are refused, or there is no half: nobody drives them by one target.
    assert!(halves.is_err() || halves.is_ok_and(|halves| halves.drive_out.is_none()));
}
