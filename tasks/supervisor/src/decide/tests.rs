//! Whole stories: switching on, moving, stopping, each fault, and long random runs that may break
//! no rule.

mod story;

use super::*;
use story::{Story, TICK, set};

#[test]
fn a_calibration_that_is_denied_grants_nothing_whatever_was_known_before() {
    let mut story = Story::in_state(State::IdleUncalibrated);
    story.denies = true;
    assert!(story.ask(Verb::Calibrate));
    story.ticks(2 * usize::from(SETTLING_JOBS));
    assert_eq!(story.at(), (State::IdleUncalibrated, Mode::Hold), "never calibrated");
    // Known from before a stop: the joints still say that they are calibrated.
    let mut story = Story::in_state(State::IdleCalibrated);
    assert!(story.ask(Verb::Stop));
    story.ticks(1000);
    assert_eq!(story.at(), (State::Start, Mode::Ready));
    assert!(story.ask(Verb::Enable));
    story.ticks(30);
    story.denies = true;
    assert!(story.ask(Verb::Calibrate));
    assert!(!story.ask(Verb::Trajectory), "not in the time it takes, and not after");
    assert_eq!(story.at(), (State::IdleUncalibrated, Mode::Hold));
    assert_eq!(story.facts.joints.map(|joints| joints.calibrated), Some(1));
    story.denies = false;
    assert!(story.ask(Verb::Calibrate) && story.ask(Verb::Trajectory), "granted, it is");
}

#[test]
fn switching_on_takes_power_checks_enable_time_and_standing_still() {
    let mut story = Story::new();
    story.lines().drive_power = 0;
    story.ticks(5);
    assert_eq!(story.at(), (State::Start, Mode::Off));
    assert!(!story.ask(Verb::Enable), "not without power");
    story.lines().drive_power = 1;
    story.tick();
    assert_eq!(story.at(), (State::Start, Mode::Checking));
    story.tick();
    assert_eq!(story.at(), (State::Start, Mode::Ready));
    assert!(story.ask(Verb::Enable));
    assert_eq!(story.at(), (State::Start, Mode::Enabling));
    story.ticks(19);
    assert_eq!(story.at().1, Mode::Enabling, "47.5 ms");
    story.tick();
    assert_eq!(story.at(), (State::IdleUncalibrated, Mode::Hold), "50 ms");
    assert_eq!(story.control.refused, 1);
    assert_eq!(story.control.entered_ns, (story.facts.release - TICK).0);
}

#[test]
fn a_moving_arm_is_not_enabled() {
    let mut story = Story::in_state(State::Start);
    assert!(story.ask(Verb::Enable));
    for step in 0..100 {
        story.facts.joints.as_mut().unwrap().q_rad[2] = 1e-3 * f64::from(step);
        story.tick();
        assert_eq!(story.at().1, Mode::Enabling);
    }
    story.ticks(17);
    assert_eq!(story.at().1, Mode::Hold);
}

#[test]
fn each_check_that_fails_keeps_the_machine_from_ready_without_a_fault() {
    let spoil: [fn(&mut Story); 4] = [
        |s| s.facts.joints = None,
        |s| s.facts.touch_silent = true,
        |s| (s.lines().estop_a_closed, s.lines().estop_b_closed) = (0, 0),
        |s| s.facts.lines = None,
    ];
    for (index, spoil) in spoil.iter().enumerate() {
        let mut story = Story::new();
        spoil(&mut story);
        story.ticks(100);
        assert!(matches!(story.at().1, Mode::Off | Mode::Checking), "{index}");
        assert_eq!(story.control.faults, 0, "{index}");
        assert!(!story.ask(Verb::Enable));
    }
}

#[test]
fn calibration_is_told_in_exactly_one_job() {
    let mut story = Story::in_state(State::IdleUncalibrated);
    assert!(!story.ask(Verb::TactileServo), "not before");
    assert!(story.ask(Verb::Calibrate));
    assert_eq!((story.at(), story.control.calibrate), ((State::IdleCalibrated, Mode::Hold), 1));
    story.tick();
    assert_eq!(story.control.calibrate, 0);
    assert!(!story.ask(Verb::Calibrate), "the figure has no way back");
    assert_eq!(story.control.calibrate, 0);
}

#[test]
fn motion_asked_for_right_after_calibration_waits_until_the_zero_has_settled() {
    let mut story = Story::in_state(State::IdleUncalibrated);
    assert!(story.ask(Verb::Calibrate));
    let heard = story.control.request;
    story.facts.request = Some(Request { verb: Verb::Trajectory as u32, sequence: heard + 1 });
    for _ in 0..SETTLING_JOBS {
        story.tick();
        assert_eq!((story.at().0, story.control.request), (State::IdleCalibrated, heard));
    }
    story.ticks(2);
    assert_eq!((story.at().0, story.control.refused), (State::Trajectory, 0));
    let mut story = Story::in_state(State::IdleUncalibrated);
    assert!(story.ask(Verb::Calibrate));
    story.facts.request = Some(Request { verb: Verb::Stop as u32, sequence: heard + 1 });
    story.tick();
    assert_eq!(story.at().1, Mode::Stopping, "a stop never waits");
}

#[test]
fn a_request_counts_once_however_long_it_stands() {
    let mut story = Story::in_state(State::IdleCalibrated);
    assert!(!story.ask(Verb::Enable));
    story.ticks(10);
    assert_eq!(story.control.refused, 1);
    for verb in [12, u32::MAX] {
        story.sequence += 1;
        story.facts.request = Some(Request { verb, sequence: story.sequence });
        story.ticks(3);
    }
    assert_eq!(story.control.refused, 3, "unknown verbs are refused");
    assert!(story.ask(Verb::None), "nothing is never refused");
}

#[test]
fn every_moving_state_is_entered_and_left_with_its_mode() {
    for state in State::ALL {
        let mut story = Story::in_state(state);
        let moving = crate::law::needs(state) == Some(Mode::Moving);
        assert_eq!(story.at().1 == Mode::Moving, moving, "{state:?}");
        assert_eq!(story.ask(Verb::Idle), moving, "{state:?}");
        if moving {
            let idle = if state == State::ManualUncalibrated {
                State::IdleUncalibrated
            } else {
                State::IdleCalibrated
            };
            assert_eq!(story.at(), (idle, Mode::Hold));
        }
    }
}

#[test]
fn a_trajectory_ends_by_itself_and_an_old_word_does_not_end_it() {
    let mut story = Story::in_state(State::IdleCalibrated);
    story.facts.trajectory = Word { stamp: story.facts.release - TICK, done: true };
    assert!(story.ask(Verb::Trajectory));
    story.ticks(5);
    assert_eq!(story.at(), (State::Trajectory, Mode::Moving), "a word from before the start");
    story.facts.trajectory.stamp = story.facts.release - TICK;
    story.tick();
    assert_eq!(story.at(), (State::IdleCalibrated, Mode::Hold));
    let mut story = Story::in_state(State::TrajectoryUser);
    story.facts.trajectory = Word { stamp: story.facts.release, done: true };
    story.ticks(5);
    assert_eq!(story.at(), (State::TrajectoryUser, Mode::Moving), "waits for more moves");
}

#[test]
fn lasting_blindness_leaves_the_tactile_servo_for_position_hold() {
    let mut story = Story::in_state(State::TactileServo);
    story.facts.present = set(&[FaultCode::TactileStale]);
    story.raise(FaultCode::TactileStale);
    assert_eq!(story.status.action, 1);
    story.ticks(8);
    assert_eq!(story.at(), (State::TactileServo, Mode::Moving), "20 ms are bridged");
    story.tick();
    assert_eq!(story.at(), (State::IdleCalibrated, Mode::Hold));
    assert!(!story.ask(Verb::TactileServo), "still blind");
    story.facts.present = FaultSet::NONE;
    story.tick();
    assert_eq!(story.control.first_fault, FaultCode::TactileStale as u32, "remembered");
    assert!(story.ask(Verb::TactileServo));
    assert!(story.ask(Verb::Reset), "and acknowledged in passing");
    assert_eq!((story.control.faults, story.control.first_fault), (0, 0));
    assert_eq!(story.at(), (State::TactileServo, Mode::Moving));
}

#[test]
fn a_stop_waits_for_standstill_and_ends_in_ready() {
    for state in State::ALL.into_iter().filter(|state| *state != State::Start) {
        let mut story = Story::in_state(state);
        story.facts.joints.as_mut().unwrap().q_rad[0] = 0.1;
        assert!(story.ask(Verb::Stop), "{state:?}");
        assert_eq!(story.at(), (state, Mode::Stopping));
        assert!(!story.ask(Verb::Stop) && !story.ask(Verb::Idle), "nothing else until then");
        story.ticks(13);
        assert_eq!(story.at(), (state, Mode::Stopping), "37.5 ms");
        story.tick();
        assert_eq!(story.at(), (State::Start, Mode::Ready));
        assert_eq!(story.control.faults, 0);
    }
}

#[test]
fn a_stop_that_never_comes_to_rest_ends_all_the_same() {
    let mut story = Story::in_state(State::Trajectory);
    assert!(story.ask(Verb::Stop));
    let mut jobs = 0;
    while story.at().1 == Mode::Stopping {
        jobs += 1;
        story.facts.joints.as_mut().unwrap().q_rad[0] += 0.01;
        story.tick();
        assert!(jobs < 500);
    }
    assert_eq!(jobs, 400);
    assert_eq!(story.at(), (State::Start, Mode::Ready));
}

#[test]
fn every_fault_in_every_state_ends_where_its_class_says() {
    for state in State::ALL {
        for fault in FaultCode::ALL {
            let mut story = Story::in_state(state);
            let before = story.at();
            story.raise(*fault);
            let latched = FaultSet(story.control.faults).contains(*fault);
            assert_eq!(latched, fault.class() != Class::Note, "{fault:?}");
            match fault.class() {
                Class::Note | Class::Degrade => assert_eq!(story.at(), before),
                Class::DriveOff => assert_eq!(story.at(), (State::Start, Mode::Fault)),
                Class::ControlledStop => {
                    story.ticks(40);
                    let mode = if state == State::Start { Mode::Ready } else { Mode::Fault };
                    assert_eq!(story.at(), (State::Start, mode), "{fault:?} in {state:?}");
                    assert!(!story.ask(Verb::Enable), "latched");
                }
            }
            if latched {
                assert_eq!(story.control.first_fault, *fault as u32);
            }
        }
    }
}

#[test]
fn after_a_fault_moving_again_takes_reset_and_enable() {
    let mut story = Story::in_state(State::TactileServo);
    story.raise(FaultCode::FollowingError);
    story.raise(FaultCode::EncoderJump);
    story.raise(FaultCode::SoftLimit);
    assert_eq!(story.at(), (State::Start, Mode::Fault));
    assert_eq!(story.control.first_fault, FaultCode::FollowingError as u32);
    assert!(!story.ask(Verb::Enable));
    assert!(story.ask(Verb::Reset));
    assert_eq!(story.at(), (State::Start, Mode::Checking));
    assert_eq!((story.control.faults, story.control.first_fault), (0, 0));
    story.ticks(200);
    assert_eq!(story.at(), (State::Start, Mode::Ready), "and no further by itself");
    assert!(story.ask(Verb::Enable));
    story.ticks(30);
    assert_eq!(story.at(), (State::IdleUncalibrated, Mode::Hold), "START forgets the zero");
}

#[test]
fn an_open_emergency_stop_takes_the_drives_in_the_same_job() {
    for state in State::ALL {
        for (a, b) in [(0, 0), (0, 1), (1, 0)] {
            let mut story = Story::in_state(state);
            *story.lines() = Lines { drive_power: 0, estop_a_closed: a, estop_b_closed: b };
            story.tick();
            assert_eq!(story.at(), (State::Start, Mode::Fault), "{state:?}");
            assert_eq!(story.control.first_fault, FaultCode::EmergencyStop as u32);
            assert!(!FaultSet(story.control.faults).contains(FaultCode::DrivePowerLost));
            let disagrees =
                |s: &Story| FaultSet(s.control.faults).contains(FaultCode::EmergencyStopDisagrees);
            story.ticks(8);
            assert!(!disagrees(&story), "20 ms are allowed");
            story.tick();
            assert_eq!(disagrees(&story), a != b);
        }
    }
}

#[test]
fn a_reset_with_the_emergency_stop_open_leads_no_further_than_checking() {
    let mut story = Story::in_state(State::Trajectory);
    (story.lines().estop_a_closed, story.lines().estop_b_closed) = (0, 0);
    story.tick();
    assert!(story.ask(Verb::Reset));
    story.ticks(20);
    assert_eq!((story.at(), story.control.faults), ((State::Start, Mode::Checking), 0));
    story.lines().estop_a_closed = 1;
    story.ticks(10);
    assert_eq!(story.at().1, Mode::Fault, "only one channel closed");
    assert_eq!(story.control.first_fault, FaultCode::EmergencyStopDisagrees as u32);
}

#[test]
fn lost_power_lines_joints_and_lanes_take_the_drives() {
    type Spoil = fn(&mut Story);
    let spoil: [(Spoil, FaultCode); 4] = [
        (|s| s.lines().drive_power = 0, FaultCode::DrivePowerLost),
        (|s| s.facts.lines = None, FaultCode::DigitalLost),
        (|s| s.facts.joints = None, FaultCode::EncoderLost),
        (|s| s.facts.touch_silent = true, FaultCode::LaneSilent),
    ];
    for (spoil, fault) in spoil {
        let mut story = Story::in_state(State::IdleCalibrated);
        spoil(&mut story);
        story.tick();
        assert_eq!(story.at(), (State::Start, Mode::Fault), "{fault:?}");
        assert_eq!(story.control.faults, set(&[fault]).0);
    }
    let mut story = Story::in_state(State::Start);
    story.lines().drive_power = 0;
    story.tick();
    assert_eq!((story.at(), story.control.faults), ((State::Start, Mode::Off), 0), "by intent");
    story.lines().estop_a_closed = 0;
    story.ticks(20);
    assert_eq!(story.control.faults, 0, "without power there is nothing to stop");
}

/// A small generator (Steele, Lea & Flood 2014, SplitMix64): the same story for the same seed.
struct Dice(u64);

impl Dice {
    fn throw(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }
}

/// What may change from one job to the next.
fn disturb(story: &mut Story, dice: &mut Dice) {
    let bit = |dice: &mut Dice| u32::from(dice.throw(50) != 0);
    *story.lines() =
        Lines { drive_power: bit(dice), estop_a_closed: bit(dice), estop_b_closed: bit(dice) };
    if dice.throw(300) == 0 {
        story.facts.raised = set(&[FaultCode::ALL[dice.throw(22) as usize]]);
    }
    story.facts.touch_silent = dice.throw(500) == 0;
    story.facts.present = if dice.throw(9) == 0 { FaultSet::NONE } else { story.facts.raised };
    let done = dice.throw(20) == 0;
    story.facts.trajectory = Word { stamp: story.facts.release - TICK, done };
    if dice.throw(4) == 0 {
        story.sequence += 1;
        let verb = dice.throw(13) as u32;
        story.facts.request = Some(Request { verb, sequence: story.sequence });
    }
}

#[test]
fn long_random_runs_break_no_rule() {
    let mut visited = [0u32; 9];
    for seed in 0..40 {
        let mut dice = Dice(seed);
        let mut story = Story::new();
        let mut before = (story.at(), story.control);
        for _ in 0..5000 {
            // Mostly undisturbed, so that something can happen; then a burst.
            if dice.throw(100) < 30 {
                let keep = story.facts.lines;
                disturb(&mut story, &mut dice);
                if dice.throw(20) != 0 {
                    story.facts.lines = keep;
                }
            } else {
                *story.lines() = Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 };
                story.facts.touch_silent = false;
                story.facts.present = FaultSet::NONE;
            }
            story.tick();
            let (state, mode) = story.at();
            visited[state as usize] += 1;
            let torque = matches!(mode, Mode::Hold | Mode::Moving | Mode::Stopping);
            assert_eq!(state != State::Start, torque, "seed {seed}: {state:?} in {mode:?}");
            if torque && mode != Mode::Stopping {
                assert_eq!(crate::law::needs(state), Some(mode), "seed {seed}");
            }
            let asked = (story.control.request != before.1.request)
                .then(|| story.facts.request.and_then(|r| Verb::from_code(r.verb)))
                .flatten();
            let lost = before.1.faults & !story.control.faults;
            assert!(lost == 0 || asked == Some(Verb::Reset), "seed {seed}: a fault was forgotten");
            if before.0.1 == Mode::Fault && mode != Mode::Fault {
                assert_eq!((asked, mode), (Some(Verb::Reset), Mode::Checking), "seed {seed}");
            }
            if mode == Mode::Enabling && before.0.1 != Mode::Enabling {
                assert_eq!(asked, Some(Verb::Enable), "seed {seed}");
            }
            if story.control.calibrate == 1 {
                assert_eq!((asked, state), (Some(Verb::Calibrate), State::IdleCalibrated));
            }
            before = ((state, mode), story.control);
        }
    }
    assert!(visited.iter().all(|jobs| *jobs > 0), "not every state was visited: {visited:?}");
}
