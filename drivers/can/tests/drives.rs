//! The halves of drives that close a loop, over a bus with motors: they conform, follow torques,
//! velocities and positions, and keep following, stopping and resetting apart.

mod rig;

use rig::{CYCLE_PERIOD, DRIVE_IDS, Rig, config};
use taktil_drivers_can::{Config, DriveMode, Halves, Protocol};
use taktil_drivers_can_emulator::{BusFrame, Kind};
use taktil_hal::conformance::{
    CycleDriver, check_drive_in, check_drive_out_drop, check_drive_out_observed,
};
use taktil_hal::{
    CHANNELS, DigitalOut, DriveActual, DriveCommand, DriveIn, DriveLoop, DriveOut, DriveRequest,
    DriveState, Encoders, Error, ErrorKind, LinesOut,
};

const CANOPEN: (Kind, Protocol) = (Kind::CanOpen(1_000), Protocol::Canopen);
const MOTEUS: (Kind, Protocol) = (Kind::Moteus, Protocol::Moteus);
const ODRIVE: (Kind, Protocol) = (Kind::Odrive, Protocol::Odrive);
/// Who follows what.
const ALL: [((Kind, Protocol), DriveMode); 7] = [
    (CANOPEN, DriveMode::Torque),
    (CANOPEN, DriveMode::Velocity),
    (CANOPEN, DriveMode::Position),
    (MOTEUS, DriveMode::Torque),
    (MOTEUS, DriveMode::Velocity),
    (MOTEUS, DriveMode::Position),
    (ODRIVE, DriveMode::Torque),
];

/// The config of the rig's drives in a mode.
fn mode_config(protocol: Protocol, mode: DriveMode) -> Config {
    Config { mode, velocity_max_counts_s: Some(200_000), ..config(protocol) }
}

/// A lane of the halves for drives.
struct Lane {
    rig: Rig,
    halves: Halves,
    release: taktil_hal::Nanos,
}

/// What a cycle answered.
struct Cycle {
    reports: [DriveActual; CHANNELS],
    answer: Result<(), Error>,
}

impl Lane {
    fn new(rig: &Rig, config: &Config) -> Lane {
        let mut halves = rig.open(config).unwrap();
        // Nobody serves the converters beside the drives, nor the lines.
        (halves.analog_out, halves.digital_out) = (None, None);
        let release = rig.next_release();
        Lane { rig: rig.clone(), halves, release }
    }

    fn cycle(&mut self, request: DriveRequest, reset: bool, target: i32) -> Cycle {
        self.rig.advance(self.release);
        let reading = self.halves.drive_in.sample(self.release).unwrap();
        assert_eq!(reading.acquired, self.release);
        let mut targets = [i32::MAX; CHANNELS];
        targets[..3].fill(target);
        let command = DriveCommand { targets, request, reset };
        let answer = self.halves.drive_out.commit(self.release, &command);
        self.release += CYCLE_PERIOD;
        Cycle { reports: reading.value, answer }
    }

    fn cycles(&mut self, count: usize, request: DriveRequest, target: i32) -> Cycle {
        for _ in 1..count {
            self.cycle(request, false, target);
        }
        self.cycle(request, false, target)
    }
}

/// Whether all three drives are in a state.
fn all_are(cycle: &Cycle, state: DriveState) -> bool {
    cycle.reports[..3].iter().all(|drive| drive.state == state)
}

/// Drives that follow, and where the first of them is.
fn following((kind, protocol): (Kind, Protocol), mode: DriveMode, faults: &[&str]) -> (Lane, i32) {
    let rig = Rig::new(kind, faults);
    let mut lane = Lane::new(&rig, &mode_config(protocol, mode));
    let at = lane.cycles(5, DriveRequest::Off, 0).reports[0].position.0;
    let target = if mode == DriveMode::Position { at } else { 0 };
    let last = lane.cycles(100, DriveRequest::Follow, target);
    assert!(last.answer.is_ok(), "{kind:?} {mode:?}: {:?}", last.answer);
    assert!(all_are(&last, DriveState::Following), "{kind:?} {mode:?}: {:?}", last.reports);
    (lane, at)
}

#[test]
fn each_mode_follows_its_targets() {
    for drives in [CANOPEN, MOTEUS] {
        let (mut lane, at) = following(drives, DriveMode::Position, &[]);
        assert_eq!(lane.halves.drive_out.control_loop(), DriveLoop::Position);
        // The first target acts from where the drive is, and a step is at most 1000 counts.
        let first = lane.cycles(3, DriveRequest::Follow, at + 60_000).reports[2];
        assert!((first.position.0 - at).abs() < 4_000, "{drives:?}: {first:?}");
        let far = lane.cycles(400, DriveRequest::Follow, at + 60_000).reports[2];
        assert!((far.position.0 - at - 60_000).abs() < 400, "{drives:?}: {far:?}");
        let (mut lane, _) = following(drives, DriveMode::Velocity, &[]);
        let fast = lane.cycles(400, DriveRequest::Follow, 100_000).reports[1];
        // A moteus without the gain of position has no integral part, and its motor has friction.
        assert!((90_000..105_000).contains(&fast.velocity_counts_s), "{drives:?}: {fast:?}");
    }
    for drives in [CANOPEN, MOTEUS, ODRIVE] {
        let (mut lane, _) = following(drives, DriveMode::Torque, &[]);
        let pushed = lane.cycles(60, DriveRequest::Follow, 300).reports[0];
        assert!(pushed.position.0 > 1_000, "{drives:?}: {pushed:?}");
        let counts = lane.halves.encoders.sample(lane.release - CYCLE_PERIOD).unwrap().value;
        assert_eq!(counts[0], pushed.position, "{drives:?}: the encoders count the same");
        if drives == CANOPEN {
            assert_eq!(pushed.torque_code, 300);
        }
    }
}

#[test]
fn a_quick_stop_and_off_are_two_requests() {
    for drives in [CANOPEN, MOTEUS] {
        let (mut lane, _) = following(drives, DriveMode::Velocity, &[]);
        lane.cycles(300, DriveRequest::Follow, 100_000);
        let braking = lane.cycles(3, DriveRequest::QuickStop, 100_000).reports[0];
        assert_eq!(braking.state, DriveState::Stopping, "{drives:?}");
        let stands = lane.cycles(300, DriveRequest::QuickStop, 100_000).reports[0];
        assert_eq!(stands.state, DriveState::Off, "{drives:?}");
        assert!(stands.velocity_counts_s.abs() < 3_000, "{drives:?}: {stands:?}");
        let (mut lane, _) = following(drives, DriveMode::Velocity, &[]);
        lane.cycles(300, DriveRequest::Follow, 100_000);
        let coasting = lane.cycles(5, DriveRequest::Off, 100_000).reports[0];
        assert_eq!(coasting.state, DriveState::Off, "{drives:?}");
        assert!(coasting.velocity_counts_s > 80_000, "{drives:?}: {coasting:?}");
    }
}

#[test]
fn a_fault_of_a_drive_is_reported_with_its_code_and_reset_by_an_act_of_its_own() {
    for (drives, code) in [(CANOPEN, 0x2310), (MOTEUS, 36)] {
        let fault = ["kind=failing target=can.2 at=2 for=0.02 value=1"];
        let (mut lane, _) = following(drives, DriveMode::Velocity, &fault);
        lane.release = lane.release.max(taktil_hal::Nanos::from_millis(2_005));
        // The world has stood still for the lane: the drives have gone safe by themselves.
        lane.cycles(20, DriveRequest::Off, 0);
        let failed = lane.cycles(20, DriveRequest::Follow, 0);
        let report = failed.reports[1];
        assert_eq!((report.state, report.fault_code), (DriveState::Fault, code), "{drives:?}");
        if drives == CANOPEN {
            assert_eq!(lane.halves.monitor.error_register(1), 0x11);
        }
        lane.cycles(30, DriveRequest::Off, 0);
        let again = lane.cycles(30, DriveRequest::Follow, 0).reports[1];
        assert_eq!(again.state, DriveState::Fault, "a request to follow resets nothing");
        lane.cycles(5, DriveRequest::Off, 0);
        let reset = (0..8).map(|_| lane.cycle(DriveRequest::Off, true, 0)).last().unwrap();
        assert_eq!(reset.reports[1].state, DriveState::Off, "{drives:?}");
        assert_eq!(reset.reports[1].fault_code, 0, "{drives:?}");
        let last = lane.cycles(40, DriveRequest::Follow, 0);
        assert!(last.answer.is_ok() && all_are(&last, DriveState::Following), "{drives:?}");
    }
}

#[test]
fn a_drive_that_does_not_follow_fails_the_commit_and_a_request_that_stood_counts_anew() {
    for drives in [CANOPEN, MOTEUS] {
        let fault = ["kind=failing target=can.3 at=1 for=0.02 value=1"];
        let (mut lane, _) = following(drives, DriveMode::Velocity, &fault);
        let mut refused = None;
        for _ in 0..400 {
            let cycle = lane.cycle(DriveRequest::Follow, false, 0);
            refused = refused.or(cycle.answer.err());
        }
        let refused = refused.expect("the fault is told");
        assert_eq!((refused.kind, refused.channel), (ErrorKind::Transient, 2), "{drives:?}");
        for _ in 0..10 {
            lane.cycle(DriveRequest::Follow, true, 0);
        }
        let held = lane.cycles(40, DriveRequest::Follow, 0).reports[2];
        assert_eq!(held.state, DriveState::Off, "{drives:?}: {held:?}");
        lane.cycles(3, DriveRequest::Off, 0);
        let last = lane.cycles(40, DriveRequest::Follow, 0).reports[2];
        assert_eq!(last.state, DriveState::Following, "{drives:?}");
    }
}

#[test]
fn the_halves_conform() {
    for ((kind, protocol), mode) in ALL {
        let rig = Rig::new(kind, &[]);
        let mut lane = Lane::new(&rig, &mode_config(protocol, mode));
        lane.cycles(10, DriveRequest::Off, 0);
        let mut bench =
            CycleDriver::new(lane.release, CYCLE_PERIOD, |release| rig.advance(release));
        let drives = &mut lane.halves.drive_in;
        assert_eq!(check_drive_in(drives, &mut bench), [], "{kind:?} {mode:?}");
        let mut powered = || (0..3).any(|place| rig.outputs(place).is_enabled);
        let half = &mut lane.halves.drive_out;
        let found = check_drive_out_observed(half, &mut bench, &mut powered);
        assert_eq!(found, [], "{kind:?} {mode:?}");
        let half = Box::new(lane.halves.drive_out);
        assert_eq!(check_drive_out_drop(half, &mut bench, &mut powered), [], "{kind:?} {mode:?}");
    }
}

#[test]
fn a_line_at_the_drives_has_to_say_so_too_and_its_silence_ends_it() {
    for (kind, protocol) in [CANOPEN, MOTEUS] {
        let rig = Rig::new(kind, &[]);
        let mut halves = rig.open(&mode_config(protocol, DriveMode::Velocity)).unwrap();
        halves.analog_out = None;
        let release = rig.next_release();
        let mut lane = Lane { rig, halves, release };
        let mut feed = false;
        let mut cycles = |count: usize, request: DriveRequest, enable: bool, feeds: bool| {
            let mut last = None;
            for _ in 0..count {
                let cycle = lane.cycle(request, false, 0);
                feed ^= feeds;
                let lines = LinesOut { enable, brake_release: enable, watchdog_feed: feed };
                let half = lane.halves.digital_out.as_mut().unwrap();
                let _ = half.commit(lane.release - CYCLE_PERIOD, &lines);
                last = Some(cycle.reports[0].state);
            }
            last
        };
        let follow = DriveRequest::Follow;
        assert_eq!(cycles(100, follow, false, true), Some(DriveState::Off), "{kind:?}");
        assert_eq!(cycles(100, follow, true, true), Some(DriveState::Following), "{kind:?}");
        // A feed line that stands still ends it within half of `silence_ms`, and nothing comes back
        // by itself.
        assert_eq!(cycles(300, follow, true, false), Some(DriveState::Off), "{kind:?}");
        assert_eq!(cycles(100, follow, true, true), Some(DriveState::Off), "{kind:?}");
        assert_eq!(cycles(5, DriveRequest::Off, true, true), Some(DriveState::Off), "{kind:?}");
        assert_eq!(cycles(100, follow, true, true), Some(DriveState::Following), "{kind:?}");
    }
}

#[test]
fn a_half_for_drives_that_falls_silent_leaves_them_without_torque() {
    for drives in [CANOPEN, MOTEUS] {
        let (mut lane, _) = following(drives, DriveMode::Velocity, &[]);
        lane.release += lane.halves.drive_out.longest_silence();
        lane.rig.advance(lane.release);
        let is_on = (0..3).any(|place| lane.rig.outputs(place).is_enabled);
        assert!(!is_on, "{drives:?}");
    }
}

#[test]
fn safe_takes_the_torque_of_an_axis_whose_reset_is_under_way() {
    let (mut lane, _) = following(ODRIVE, DriveMode::Torque, &[]);
    // A sign of life that somebody made up tells of an error in an axis that follows.
    let data = vec![1, 0, 0, 0, 8, 0, 0, 0];
    let sign_of_life = BusFrame { word: u32::from(DRIVE_IDS[0]) << 5 | 1, is_fd: false, data };
    lane.rig.advance(lane.release);
    lane.rig.inject(&sign_of_life);
    // The reset comes in the cycle in which the error is heard of.
    lane.cycle(DriveRequest::Follow, true, 0);
    assert!(lane.rig.outputs(0).is_enabled, "the axis knows of no error");
    lane.halves.drive_out.safe().unwrap();
    assert!((0..3).all(|place| !lane.rig.outputs(place).is_enabled));
}

#[test]
fn a_drive_without_the_mode_is_refused() {
    let rig = Rig::new(Kind::Odrive, &[]);
    let refused = rig.open(&mode_config(Protocol::Odrive, DriveMode::Velocity)).unwrap_err();
    assert!(refused.to_string().contains("follows torques only"), "{refused}");
    let rig = Rig::new(Kind::CanOpen(1_000), &[]);
    let unbounded = Config { mode: DriveMode::Velocity, ..config(Protocol::Canopen) };
    assert!(rig.open(&unbounded).unwrap_err().to_string().contains("velocity_max_counts_s"));
    let halves = rig.open(&mode_config(Protocol::Canopen, DriveMode::Position)).unwrap();
    assert!(halves.analog_out.is_none(), "torques are no targets of this mode");
}
