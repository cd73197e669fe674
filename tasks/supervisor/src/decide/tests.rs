//! Tests whole sequences: switching on, moving, stopping, each fault.

mod random;
mod scenario;

use super::*;
use scenario::{Scenario, TICK_PERIOD, set};

#[test]
fn a_calibration_that_is_denied_grants_nothing_whatever_was_known_before() {
    let mut scenario = Scenario::in_state(State::IdleUncalibrated);
    scenario.denies = true;
    assert!(scenario.ask(Verb::Calibrate));
    scenario.ticks(2 * usize::from(SETTLING_JOBS));
    assert_eq!(scenario.at(), (State::IdleUncalibrated, Mode::Hold), "never calibrated");
    // Known from before a stop: the joints still say that they are calibrated.
    let mut scenario = Scenario::in_state(State::IdleCalibrated);
    assert!(scenario.ask(Verb::Stop));
    scenario.ticks(1000);
    assert_eq!(scenario.at(), (State::Start, Mode::Ready));
    assert!(scenario.ask(Verb::Enable));
    scenario.ticks(30);
    scenario.denies = true;
    assert!(scenario.ask(Verb::Calibrate));
    assert!(!scenario.ask(Verb::Trajectory), "not in the time it takes, and not after");
    assert_eq!(scenario.at(), (State::IdleUncalibrated, Mode::Hold));
    assert_eq!(scenario.inputs.joints.map(|joints| joints.calibrated), Some(1));
    scenario.denies = false;
    assert!(scenario.ask(Verb::Calibrate) && scenario.ask(Verb::Trajectory), "granted, it is");
}

#[test]
fn switching_on_takes_power_checks_enable_time_and_standing_still() {
    let mut scenario = Scenario::new();
    scenario.lines().drive_power = 0;
    scenario.ticks(5);
    assert_eq!(scenario.at(), (State::Start, Mode::Off));
    assert!(!scenario.ask(Verb::Enable), "not without power");
    scenario.lines().drive_power = 1;
    scenario.tick();
    assert_eq!(scenario.at(), (State::Start, Mode::Checking));
    scenario.tick();
    assert_eq!(scenario.at(), (State::Start, Mode::Ready));
    assert!(scenario.ask(Verb::Enable));
    assert_eq!(scenario.at(), (State::Start, Mode::Enabling));
    scenario.ticks(19);
    assert_eq!(scenario.at().1, Mode::Enabling, "47.5 ms");
    scenario.tick();
    assert_eq!(scenario.at(), (State::IdleUncalibrated, Mode::Hold), "50 ms");
    assert_eq!(scenario.control.refused, 1);
    assert_eq!(scenario.control.entered_ns, (scenario.inputs.release - TICK_PERIOD).0);
}

#[test]
fn a_moving_arm_is_not_enabled() {
    let mut scenario = Scenario::in_state(State::Start);
    assert!(scenario.ask(Verb::Enable));
    for step in 0..100 {
        scenario.inputs.joints.as_mut().unwrap().q_rad[2] = 1e-3 * f64::from(step);
        scenario.tick();
        assert_eq!(scenario.at().1, Mode::Enabling);
    }
    scenario.ticks(17);
    assert_eq!(scenario.at().1, Mode::Hold);
}

#[test]
fn each_check_that_fails_keeps_the_machine_from_ready_without_a_fault() {
    let spoil: [fn(&mut Scenario); 5] = [
        |s| s.inputs.joints = None,
        |s| s.inputs.touch_silent = true,
        |s| s.inputs.disabled = true,
        |s| (s.lines().estop_a_closed, s.lines().estop_b_closed) = (0, 0),
        |s| s.inputs.lines = None,
    ];
    for (index, spoil) in spoil.iter().enumerate() {
        let mut scenario = Scenario::new();
        spoil(&mut scenario);
        scenario.ticks(100);
        assert!(matches!(scenario.at().1, Mode::Off | Mode::Checking), "{index}");
        assert_eq!(scenario.control.faults, 0, "{index}");
        assert!(!scenario.ask(Verb::Enable));
    }
}

#[test]
fn calibration_is_reported_in_exactly_one_job() {
    let mut scenario = Scenario::in_state(State::IdleUncalibrated);
    assert!(!scenario.ask(Verb::TactileServo), "not before");
    assert!(scenario.ask(Verb::Calibrate));
    assert_eq!(
        (scenario.at(), scenario.control.calibrate),
        ((State::IdleCalibrated, Mode::Hold), 1)
    );
    scenario.tick();
    assert_eq!(scenario.control.calibrate, 0);
    assert!(!scenario.ask(Verb::Calibrate), "the figure has no way back");
    assert_eq!(scenario.control.calibrate, 0);
}

#[test]
fn motion_asked_for_right_after_calibration_waits_until_the_zero_has_settled() {
    let mut scenario = Scenario::in_state(State::IdleUncalibrated);
    assert!(scenario.ask(Verb::Calibrate));
    let heard = scenario.control.request;
    scenario.inputs.request = Some(Request { verb: Verb::Trajectory as u32, sequence: heard + 1 });
    for _ in 0..SETTLING_JOBS {
        scenario.tick();
        assert_eq!((scenario.at().0, scenario.control.request), (State::IdleCalibrated, heard));
    }
    scenario.ticks(2);
    assert_eq!((scenario.at().0, scenario.control.refused), (State::Trajectory, 0));
    let mut scenario = Scenario::in_state(State::IdleUncalibrated);
    assert!(scenario.ask(Verb::Calibrate));
    scenario.inputs.request = Some(Request { verb: Verb::Stop as u32, sequence: heard + 1 });
    scenario.tick();
    assert_eq!(scenario.at().1, Mode::Stopping, "a stop never waits");
}

#[test]
fn a_request_counts_once_however_long_it_stands() {
    let mut scenario = Scenario::in_state(State::IdleCalibrated);
    assert!(!scenario.ask(Verb::Enable));
    scenario.ticks(10);
    assert_eq!(scenario.control.refused, 1);
    for verb in [12, u32::MAX] {
        scenario.sequence += 1;
        scenario.inputs.request = Some(Request { verb, sequence: scenario.sequence });
        scenario.ticks(3);
    }
    assert_eq!(scenario.control.refused, 3, "unknown verbs are refused");
    assert!(scenario.ask(Verb::None), "nothing is never refused");
}

#[test]
fn every_moving_state_is_entered_and_left_with_its_mode() {
    for state in State::ALL {
        let mut scenario = Scenario::in_state(state);
        let moving = crate::law::required_mode(state) == Some(Mode::Moving);
        assert_eq!(scenario.at().1 == Mode::Moving, moving, "{state:?}");
        assert_eq!(scenario.ask(Verb::Idle), moving, "{state:?}");
        if moving {
            let idle = if state == State::ManualUncalibrated {
                State::IdleUncalibrated
            } else {
                State::IdleCalibrated
            };
            assert_eq!(scenario.at(), (idle, Mode::Hold));
        }
    }
}

#[test]
fn a_trajectory_ends_by_itself_and_an_old_word_does_not_end_it() {
    let mut scenario = Scenario::in_state(State::IdleCalibrated);
    scenario.inputs.trajectory =
        SourceReport { stamp: scenario.inputs.release - TICK_PERIOD, done: true };
    assert!(scenario.ask(Verb::Trajectory));
    scenario.ticks(5);
    assert_eq!(scenario.at(), (State::Trajectory, Mode::Moving), "a word from before the start");
    scenario.inputs.trajectory.stamp = scenario.inputs.release - TICK_PERIOD;
    scenario.tick();
    assert_eq!(scenario.at(), (State::IdleCalibrated, Mode::Hold));
    let mut scenario = Scenario::in_state(State::TrajectoryUser);
    scenario.inputs.trajectory = SourceReport { stamp: scenario.inputs.release, done: true };
    scenario.ticks(5);
    assert_eq!(scenario.at(), (State::TrajectoryUser, Mode::Moving), "waits for more moves");
}

#[test]
fn lasting_blindness_leaves_the_tactile_servo_for_position_hold() {
    let mut scenario = Scenario::in_state(State::TactileServo);
    scenario.inputs.present = set(&[FaultCode::TactileStale]);
    scenario.raise(FaultCode::TactileStale);
    assert_eq!(scenario.status.action, 1);
    scenario.ticks(8);
    assert_eq!(scenario.at(), (State::TactileServo, Mode::Moving), "20 ms are bridged");
    scenario.tick();
    assert_eq!(scenario.at(), (State::IdleCalibrated, Mode::Hold));
    assert!(!scenario.ask(Verb::TactileServo), "still blind");
    scenario.inputs.present = FaultSet::NONE;
    scenario.tick();
    assert_eq!(scenario.control.first_fault, FaultCode::TactileStale as u32, "remembered");
    assert!(scenario.ask(Verb::TactileServo));
    assert!(scenario.ask(Verb::Reset), "and acknowledged in passing");
    assert_eq!((scenario.control.faults, scenario.control.first_fault), (0, 0));
    assert_eq!(scenario.at(), (State::TactileServo, Mode::Moving));
}

#[test]
fn a_stop_waits_for_standstill_and_ends_in_ready() {
    for state in State::ALL.into_iter().filter(|state| *state != State::Start) {
        let mut scenario = Scenario::in_state(state);
        scenario.inputs.joints.as_mut().unwrap().q_rad[0] = 0.1;
        assert!(scenario.ask(Verb::Stop), "{state:?}");
        assert_eq!(scenario.at(), (state, Mode::Stopping));
        assert!(!scenario.ask(Verb::Stop) && !scenario.ask(Verb::Idle), "nothing else until then");
        scenario.ticks(13);
        assert_eq!(scenario.at(), (state, Mode::Stopping), "37.5 ms");
        scenario.tick();
        assert_eq!(scenario.at(), (State::Start, Mode::Ready));
        assert_eq!(scenario.control.faults, 0);
    }
}

#[test]
fn a_stop_ends_even_if_the_arm_never_comes_to_rest() {
    let mut scenario = Scenario::in_state(State::Trajectory);
    assert!(scenario.ask(Verb::Stop));
    let mut jobs = 0;
    while scenario.at().1 == Mode::Stopping {
        jobs += 1;
        // It swings: not at rest, but not on its way either.
        scenario.inputs.joints.as_mut().unwrap().q_rad[0] = 0.01 * f64::from(jobs % 2);
        scenario.tick();
        assert!(jobs < 500);
    }
    assert_eq!(jobs, 400);
    assert_eq!(scenario.at(), (State::Start, Mode::Ready));
}

#[test]
fn every_fault_in_every_state_leads_to_the_state_of_its_class() {
    for state in State::ALL {
        for fault in FaultCode::ALL {
            let mut scenario = Scenario::in_state(state);
            let before = scenario.at();
            scenario.raise(*fault);
            let latched = FaultSet(scenario.control.faults).contains(*fault);
            assert_eq!(latched, fault.class() != Class::Note, "{fault:?}");
            match fault.class() {
                Class::Note | Class::Degrade => assert_eq!(scenario.at(), before),
                Class::DriveOff => assert_eq!(scenario.at(), (State::Start, Mode::Fault)),
                Class::ControlledStop => {
                    scenario.ticks(40);
                    let mode = if state == State::Start { Mode::Ready } else { Mode::Fault };
                    assert_eq!(scenario.at(), (State::Start, mode), "{fault:?} in {state:?}");
                    assert!(!scenario.ask(Verb::Enable), "latched");
                }
            }
            if latched {
                assert_eq!(scenario.control.first_fault, *fault as u32);
            }
        }
    }
}

#[test]
fn after_a_fault_moving_again_takes_reset_and_enable() {
    let mut scenario = Scenario::in_state(State::TactileServo);
    scenario.raise(FaultCode::FollowingError);
    scenario.raise(FaultCode::EncoderJump);
    scenario.raise(FaultCode::SoftLimit);
    assert_eq!(scenario.at(), (State::Start, Mode::Fault));
    assert_eq!(scenario.control.first_fault, FaultCode::FollowingError as u32);
    assert!(!scenario.ask(Verb::Enable));
    assert!(scenario.ask(Verb::Reset));
    assert_eq!(scenario.at(), (State::Start, Mode::Checking));
    assert_eq!((scenario.control.faults, scenario.control.first_fault), (0, 0));
    scenario.ticks(200);
    assert_eq!(scenario.at(), (State::Start, Mode::Ready), "and no further by itself");
    assert!(scenario.ask(Verb::Enable));
    scenario.ticks(30);
    assert_eq!(scenario.at(), (State::IdleUncalibrated, Mode::Hold), "START forgets the zero");
}

#[test]
fn an_open_emergency_stop_takes_the_drives_in_the_same_job() {
    for state in State::ALL {
        for (a, b) in [(0, 0), (0, 1), (1, 0)] {
            let mut scenario = Scenario::in_state(state);
            *scenario.lines() = Lines { drive_power: 0, estop_a_closed: a, estop_b_closed: b };
            scenario.tick();
            assert_eq!(scenario.at(), (State::Start, Mode::Fault), "{state:?}");
            assert_eq!(scenario.control.first_fault, FaultCode::EmergencyStop as u32);
            assert!(!FaultSet(scenario.control.faults).contains(FaultCode::DrivePowerLost));
            let disagrees = |s: &Scenario| {
                FaultSet(s.control.faults).contains(FaultCode::EmergencyStopDisagrees)
            };
            scenario.ticks(8);
            assert!(!disagrees(&scenario), "20 ms are allowed");
            scenario.tick();
            assert_eq!(disagrees(&scenario), a != b);
        }
    }
}

#[test]
fn a_reset_with_the_emergency_stop_open_leads_no_further_than_checking() {
    let mut scenario = Scenario::in_state(State::Trajectory);
    (scenario.lines().estop_a_closed, scenario.lines().estop_b_closed) = (0, 0);
    scenario.tick();
    assert!(scenario.ask(Verb::Reset));
    scenario.ticks(20);
    assert_eq!((scenario.at(), scenario.control.faults), ((State::Start, Mode::Checking), 0));
    scenario.lines().estop_a_closed = 1;
    scenario.ticks(10);
    assert_eq!(scenario.at().1, Mode::Fault, "only one channel closed");
    assert_eq!(scenario.control.first_fault, FaultCode::EmergencyStopDisagrees as u32);
}

#[test]
fn a_gap_in_which_the_boards_let_go_takes_the_drives_and_a_shorter_one_does_not() {
    for (gap_ms, fault) in [(50, None), (51, Some(FaultCode::LaneSilent))] {
        let mut scenario = Scenario::in_state(State::IdleCalibrated);
        let before = scenario.inputs.release;
        scenario.tick();
        let period = scenario.inputs.release - before;
        scenario.inputs.release += Nanos::from_millis(gap_ms) - period;
        scenario.tick();
        assert_eq!(scenario.control.faults, fault.map_or(0, |fault| set(&[fault]).0), "{gap_ms}");
        let mode = if fault.is_some() { Mode::Fault } else { Mode::Hold };
        assert_eq!(scenario.at().1, mode, "{gap_ms}");
    }
    let mut scenario = Scenario::in_state(State::Start);
    scenario.inputs.release += Nanos::from_secs(1);
    scenario.tick();
    assert_eq!(scenario.control.faults, 0, "nothing was driven");
}

#[test]
fn lost_power_lines_joints_and_lanes_take_the_drives() {
    type Spoil = fn(&mut Scenario);
    let spoil: [(Spoil, FaultCode); 5] = [
        (|s| s.lines().drive_power = 0, FaultCode::DrivePowerLost),
        (|s| s.inputs.lines = None, FaultCode::DigitalLost),
        (|s| s.inputs.joints = None, FaultCode::EncoderLost),
        (|s| s.inputs.touch_silent = true, FaultCode::LaneSilent),
        (|s| s.inputs.disabled = true, FaultCode::TaskPanicked),
    ];
    for (spoil, fault) in spoil {
        let mut scenario = Scenario::in_state(State::IdleCalibrated);
        spoil(&mut scenario);
        scenario.tick();
        assert_eq!(scenario.at(), (State::Start, Mode::Fault), "{fault:?}");
        assert_eq!(scenario.control.faults, set(&[fault]).0);
    }
    let mut scenario = Scenario::in_state(State::Start);
    scenario.lines().drive_power = 0;
    scenario.tick();
    assert_eq!(
        (scenario.at(), scenario.control.faults),
        ((State::Start, Mode::Off), 0),
        "by intent"
    );
    scenario.lines().estop_a_closed = 0;
    scenario.ticks(20);
    assert_eq!(scenario.control.faults, 0, "without power there is nothing to stop");
}

#[test]
fn a_reset_that_comes_with_a_fault_was_not_meant_for_it() {
    let mut scenario = Scenario::in_state(State::IdleCalibrated);
    scenario.sequence += 1;
    let reset = Request { verb: Verb::Reset as u32, sequence: scenario.sequence };
    scenario.inputs.request = Some(reset);
    (scenario.lines().estop_a_closed, scenario.lines().estop_b_closed) = (0, 0);
    let refused = scenario.control.refused;
    scenario.tick();
    assert_eq!(scenario.at(), (State::Start, Mode::Fault), "it is told, whoever asked for a reset");
    assert_eq!(scenario.control.first_fault, FaultCode::EmergencyStop as u32);
    assert_eq!(scenario.control.refused, refused + 1);
    assert!(scenario.ask(Verb::Reset), "the next one is meant for it");
}

#[test]
fn a_reset_in_the_job_in_which_the_stop_for_a_fault_ends_comes_too_early() {
    let stopping = || {
        let mut scenario = Scenario::in_state(State::Trajectory);
        scenario.inputs.joints.as_mut().unwrap().q_rad[0] = 0.1;
        scenario.raise(FaultCode::FollowingError);
        assert_eq!(scenario.at(), (State::Trajectory, Mode::Stopping));
        scenario
    };
    let mut scenario = stopping();
    let jobs = (1..500).find(|_| {
        scenario.tick();
        scenario.at().1 == Mode::Fault
    });
    let mut scenario = stopping();
    scenario.ticks(jobs.unwrap() - 1);
    assert_eq!(scenario.at().1, Mode::Stopping);
    let refused = scenario.control.refused;
    scenario.sequence += 1;
    let reset = Request { verb: Verb::Reset as u32, sequence: scenario.sequence };
    scenario.inputs.request = Some(reset);
    scenario.tick();
    assert_eq!(scenario.at(), (State::Start, Mode::Fault), "FAULT is passed and told");
    assert_eq!(scenario.control.refused, refused + 1);
    assert!(scenario.ask(Verb::Reset), "the next one is meant for it");
}

#[test]
fn a_machine_with_a_task_that_panicked_is_not_enabled_again() {
    let mut scenario = Scenario::in_state(State::IdleCalibrated);
    scenario.inputs.disabled = true;
    scenario.ticks(500);
    assert_eq!(scenario.at(), (State::Start, Mode::Fault));
    scenario.ask(Verb::Reset);
    scenario.ticks(10);
    assert_eq!(scenario.at(), (State::Start, Mode::Checking), "it is still gone");
    for verb in [Verb::Enable, Verb::Reset, Verb::Enable] {
        scenario.ask(verb);
        scenario.ticks(100);
        assert_eq!(scenario.at(), (State::Start, Mode::Checking), "{verb:?}");
    }
}

#[test]
fn a_stop_in_which_the_speed_does_not_fall_takes_the_drives_before_its_time_is_over() {
    let mut scenario = Scenario::in_state(State::ManualJoint);
    scenario.inputs.joints.as_mut().unwrap().q_rad[1] = -0.1;
    assert!(scenario.ask(Verb::Stop));
    let ticks = (0..400).position(|step| {
        scenario.inputs.joints.as_mut().unwrap().q_rad[1] = 1e-3 * f64::from(step);
        scenario.tick();
        scenario.at().1 == Mode::Fault
    });
    assert!(ticks.is_some_and(|ticks| ticks <= 84), "0.2 s and a job or two: {ticks:?}");
    assert_eq!(scenario.control.first_fault, FaultCode::StopFailed as u32);
    // A stop that slows ends in its own time.
    let mut scenario = Scenario::in_state(State::ManualJoint);
    scenario.inputs.joints.as_mut().unwrap().q_rad[1] = -0.1;
    assert!(scenario.ask(Verb::Stop));
    for step in 0..400 {
        let t_s = 2.5e-3 * f64::from(step.min(200));
        scenario.inputs.joints.as_mut().unwrap().q_rad[1] = t_s * (1.0 - t_s);
        scenario.tick();
    }
    assert_eq!((scenario.at().1, scenario.control.faults), (Mode::Ready, 0));
}
