//! Each rule of the checkers is broken once, in records that are otherwise in order, and is then
//! found by its name; unbroken records break no rule.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;
use taktil_lab_storm::case::{Campaign, Case, Scenes};
use taktil_lab_storm::check::{ArmLimits, Judge};
use taktil_lab_storm::evidence::{Tick, Touch, Witness};
use taktil_lab_world::WorldTruth;
use taktil_machine::tape::{AnalogWord, DigitalEntry, DigitalWord, EncoderEntry};
use taktil_rtcore::status::LaneHealth;
use taktil_rtcore::{FaultCode, Mode, Payload};
use taktil_signal::{
    Applied, ControlState, Desired, Features, JogCommand, JointState, Lines, Request, State,
    Torque, Verb,
};

const CYCLE_PERIOD: Nanos = Nanos(2_500_000);

/// When a job is released (ns).
fn instant_ns(number: u64) -> i64 {
    CYCLE_PERIOD.0 * number as i64
}

/// Records of an arm that is enabled in job 20, holds from job 60 on and moves from job 80 on.
fn tick(number: u64) -> Tick {
    let (mode, state) = match number {
        0..20 => (Mode::Ready, State::Start),
        20..60 => (Mode::Enabling, State::Start),
        60..80 => (Mode::Hold, State::IdleUncalibrated),
        _ => (Mode::Moving, State::ManualUncalibrated),
    };
    let (verb, sequence) = match number {
        0..19 => (Verb::None, 0),
        19..79 => (Verb::Enable, 1),
        _ => (Verb::ManualUncalibrated, 2),
    };
    // A request is taken in the job after it came; a state is as old as the job that began it.
    let taken = [20, 80].iter().filter(|job| number >= **job).count() as u32;
    let entered_ns = [60, 80].iter().rfind(|job| number >= **job).map_or(0, |job| instant_ns(*job));
    let driven = u8::from(number >= 20);
    let codes = [10 * i32::from(driven), 0, 0, 0, 0, 0, 0, 0];
    let (mode, state) = (mode.code(), state as u32);
    Tick {
        tick: number,
        release: CYCLE_PERIOD * number as i64,
        control: Some(ControlState {
            state,
            mode,
            request: taken,
            entered_ns,
            ..ControlState::ZERO
        }),
        request: Some(Request { verb: verb as u32, sequence }),
        jog: Some(JogCommand { sequence: number as u32, ..JogCommand::ZERO }),
        encoders: Some(EncoderEntry {
            acquired_ns: CYCLE_PERIOD.0 * number as i64,
            ..EncoderEntry::ZERO
        }),
        lines_in: Some(DigitalEntry {
            drive_power: 1,
            estop_a_closed: 1,
            estop_b_closed: 1,
            ..DigitalEntry::ZERO
        }),
        analog: Some(AnalogWord { codes, ..AnalogWord::ZERO }),
        lines_out: Some(DigitalWord {
            enable: driven,
            brake_release: u8::from(number >= 60),
            watchdog_feed: (number % 2) as u8,
            ..DigitalWord::ZERO
        }),
        joints: Some(JointState::ZERO),
        lines: Some(Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 }),
        desired: Some(Desired { valid: 1, ..Desired::ZERO }),
        torque: Some(Torque::ZERO),
        applied: Some(Applied::ZERO),
        features: Some(Features::ZERO),
        health: Some(LaneHealth { jobs: number + 1, ..LaneHealth::ZERO }),
    }
}

fn judge() -> Judge {
    let (scenes, none) = (Scenes::built_in().unwrap(), FaultPlan::default());
    let length = Some(Nanos::from_secs(100));
    let case = Case::draw(&scenes, 1, Campaign::Anything, Some(&none), length);
    Judge::new(&case, ArmLimits::new(None))
}

fn rules(judge: &Judge) -> Vec<&'static str> {
    judge.findings.violations.iter().map(|violation| violation.rule).collect()
}

/// The rules that are broken when `change` is made to the records of each of so many jobs.
fn broken(jobs: u64, change: impl Fn(&mut Tick)) -> Vec<&'static str> {
    broken_with_truth(jobs, change, |_| None)
}

fn broken_with_truth(
    jobs: u64,
    change: impl Fn(&mut Tick),
    truth: impl Fn(u64) -> Option<WorldTruth>,
) -> Vec<&'static str> {
    let mut judge = judge();
    for number in 0..jobs {
        let mut tick = tick(number);
        change(&mut tick);
        if let Some(truth) = truth(number) {
            judge.truth(&truth);
        }
        judge.tick(&tick);
    }
    judge.finish();
    rules(&judge)
}

/// A change in job `at` only.
fn once(at: u64, change: impl Fn(&mut Tick)) -> impl Fn(&mut Tick) {
    move |tick| {
        if tick.tick == at {
            change(tick);
        }
    }
}

/// A change from job `at` on.
fn from(at: u64, change: impl Fn(&mut Tick)) -> impl Fn(&mut Tick) {
    move |tick| {
        if tick.tick >= at {
            change(tick);
        }
    }
}

fn control(tick: &mut Tick) -> &mut ControlState {
    tick.control.as_mut().unwrap()
}

fn lines(tick: &mut Tick) -> &mut DigitalWord {
    tick.lines_out.as_mut().unwrap()
}

/// From job `from` on the machine is in this mode and state.
fn goes(tick: &mut Tick, from: u64, mode: Mode, state: State) {
    if tick.tick >= from {
        (control(tick).mode, control(tick).state) = (mode.code(), state as u32);
        control(tick).entered_ns = instant_ns(from);
    }
}

fn make_safe(tick: &mut Tick) {
    tick.analog.as_mut().unwrap().codes = [0; 8];
    (lines(tick).enable, lines(tick).brake_release) = (0, 0);
}

fn ask_to_stop(tick: &mut Tick) {
    tick.request = Some(Request { verb: Verb::Stop as u32, sequence: 3 });
}

#[test]
fn records_in_order_break_no_rule() {
    assert_eq!(broken(200, |_| {}), [""; 0]);
}

#[test]
fn words_to_the_boards_have_to_fit_the_mode() {
    let current = broken(200, once(10, |tick| tick.analog.as_mut().unwrap().codes[3] = 5));
    assert_eq!(current, ["no current without enable", "no current without a mode for it"]);
    let enabled = broken(200, once(10, |tick| lines(tick).enable = 1));
    assert_eq!(enabled, ["no enable without a mode for it"]);
    let lifted = broken(200, once(40, |tick| lines(tick).brake_release = 1));
    assert_eq!(lifted, ["brakes on without a mode"]);
    let silent = broken(200, once(100, |tick| tick.analog = None));
    assert_eq!(silent, ["each job writes to the boards"]);
}

#[test]
fn the_watchdog_is_fed_with_the_inputs_and_not_without() {
    let stuck = broken(200, from(100, |tick| lines(tick).watchdog_feed = 1));
    assert_eq!(stuck, ["the watchdog is fed"]);
    let blind = broken(200, once(100, |tick| tick.joints = None));
    assert_eq!(blind, ["the watchdog starves without inputs"]);
}

#[test]
fn torque_codes_and_numbers_keep_their_limits() {
    let code = |code: i32| once(100, move |tick| tick.analog.as_mut().unwrap().codes[1] = code);
    assert_eq!(broken(200, code(2047)), [""; 0]);
    let beyond = broken(200, code(2100));
    assert_eq!(beyond, ["torque within its limits", "codes within the converter"]);
    let other = broken(
        200,
        once(100, |tick| {
            tick.torque.as_mut().unwrap().tau_nm[2] = 3.0;
            tick.applied.as_mut().unwrap().gate_open = 1;
        }),
    );
    assert_eq!(other, ["the torque asked for is put out"]);
    let nan = broken(200, once(100, |tick| tick.torque.as_mut().unwrap().tau_nm[2] = f64::NAN));
    assert_eq!(nan, ["numbers are finite"]);
}

#[test]
fn modes_and_states_follow_each_other_as_drawn_and_with_a_reason() {
    let has = |found: Vec<&str>, rule: &str| assert!(found.contains(&rule), "{rule}: {found:?}");
    let skipped = broken(60, |tick| goes(tick, 20, Mode::Hold, State::IdleUncalibrated));
    has(skipped, "legal modes only");
    let unasked = broken(60, |tick| tick.request = Some(Request::ZERO));
    has(unasked.clone(), "each change has its reason");
    has(unasked, "drives come on by a second act");
    has(broken(60, |tick| goes(tick, 30, Mode::Hold, State::Start)), "each change has its reason");
    let wild = broken(120, |tick| goes(tick, 80, Mode::Moving, State::TactileServo));
    has(wild.clone(), "legal states only");
    has(wild, "motion is asked for");
    let still = broken(120, |tick| goes(tick, 80, Mode::Moving, State::IdleUncalibrated));
    has(still, "a mode that moves has a state that does");
}

#[test]
fn a_request_to_stop_and_a_stop_have_an_end() {
    assert_eq!(broken(200, from(120, ask_to_stop)), ["a stop is obeyed"]);
    let endless = broken(
        700,
        from(120, |tick| {
            ask_to_stop(tick);
            goes(tick, 121, Mode::Stopping, State::ManualUncalibrated);
        }),
    );
    assert_eq!(endless, ["a stop ends"]);
}

#[test]
fn faults_are_latched_until_a_reset_and_the_first_one_stays() {
    let code = FaultCode::EmergencyStop as u32;
    let latched = |tick: &mut Tick| {
        (control(tick).faults, control(tick).first_fault) = (1 << code, code);
        goes(tick, 100, Mode::Fault, State::Start);
        make_safe(tick);
    };
    let found = |change: &dyn Fn(&mut Tick)| {
        let found = broken(
            200,
            from(100, |tick| {
                latched(tick);
                change(tick);
            }),
        );
        let rules = found.into_iter().filter(|rule| *rule != "no fault without a fault");
        rules.collect::<Vec<_>>()
    };
    assert_eq!(found(&|_| {}), [""; 0]);
    let gone = found(&from(150, |tick| (control(tick).faults, control(tick).first_fault) = (0, 0)));
    assert_eq!(gone, ["latched until a reset", "the first fault stays the first"]);
    let other = found(&from(150, |tick| {
        control(tick).faults |= 2;
        control(tick).first_fault = 1;
    }));
    assert_eq!(other, ["the first fault stays the first"]);
    let unnamed = found(&|tick| control(tick).first_fault = 0);
    assert_eq!(unnamed, ["faults have a first one", "the first fault is the gravest"]);
}

#[test]
fn what_the_boards_say_is_acted_on_in_time() {
    type Change = fn(&mut Tick);
    let changes: [(&str, Change); 7] = [
        ("encoders gone", |tick| tick.encoders.as_mut().unwrap().outcome = 4),
        ("lines gone", |tick| tick.lines_in.as_mut().unwrap().outcome = 4),
        ("outputs fail", |tick| tick.lines_out.as_mut().unwrap().outcome = 1),
        ("emergency stop", |tick| tick.lines_in.as_mut().unwrap().estop_b_closed = 0),
        ("power", |tick| tick.lines_in.as_mut().unwrap().drive_power = 0),
        ("jump", |tick| tick.encoders.as_mut().unwrap().counts[1] = 900 * (tick.tick % 2) as i32),
        ("astray", |tick| tick.joints.as_mut().unwrap().q_rad[4] = 0.2),
    ];
    for (name, change) in changes {
        assert_eq!(broken(200, from(120, change)), ["a fault is acted on in time"], "{name}");
    }
    let gone: Change = |tick| tick.analog.as_mut().unwrap().outcome = 4;
    let lines = "lost converters take the lines with them";
    assert_eq!(broken(200, from(120, gone)), [lines, "a fault is acted on in time"]);
    let taken = broken(
        200,
        from(120, |tick| {
            gone(tick);
            make_safe(tick);
        }),
    );
    assert!(!taken.contains(&lines), "{taken:?}");
    let late = broken(200, |tick| {
        tick.health.as_mut().unwrap().missed = (tick.tick.clamp(120, 140) - 120) as u32;
    });
    assert_eq!(late, ["a fault is acted on in time"], "missed deadlines");
    let panicked = 1 << (FaultCode::TaskPanicked as u16);
    let told = broken(200, once(120, |tick| tick.health.as_mut().unwrap().faults = panicked));
    assert_eq!(told, ["a fault is acted on in time"], "a fault in the health");
}

#[test]
fn a_jump_costs_the_zero() {
    let jumped = |calibrated: u32| {
        broken(
            200,
            from(100, |tick| {
                let code = FaultCode::EncoderJump as u32;
                (control(tick).faults, control(tick).first_fault) = (1 << code, code);
                goes(tick, 100, Mode::Fault, State::Start);
                make_safe(tick);
                tick.joints.as_mut().unwrap().calibrated = calibrated;
            }),
        )
    };
    let rule = "a jump costs the zero";
    assert!(jumped(1).contains(&rule) && !jumped(0).contains(&rule), "{:?}", jumped(1));
}

#[test]
fn desired_joints_keep_limits_and_speed_and_keys_that_are_silent_let_go() {
    let jump = broken(200, from(120, |tick| tick.desired.as_mut().unwrap().q_rad[0] = 0.03));
    let told = "a jog moves at the speed that it says";
    assert_eq!(jump, ["desired joints do not jump", told]);
    let outside = broken(200, |tick| {
        goes(tick, 80, Mode::Moving, State::ManualJoint);
        let q = 160.0_f64.to_radians();
        tick.desired.as_mut().unwrap().q_rad[0] = q;
        tick.joints.as_mut().unwrap().q_rad[0] = q;
    });
    assert!(outside.contains(&"desired joints inside their limits"), "{outside:?}");
    let held = broken(
        300,
        from(120, |tick| {
            tick.jog.as_mut().unwrap().sequence = 120;
            tick.desired.as_mut().unwrap().qd_rad_s[0] = 0.1;
        }),
    );
    assert_eq!(held, ["a jog keeps to its ramp", "a jog ends with its keys"]);
    let code = FaultCode::FollowingError as u32;
    let alarm = broken(
        200,
        from(120, |tick| {
            (control(tick).faults, control(tick).first_fault) = (1 << code, code);
        }),
    );
    assert_eq!(alarm, ["no fault without a fault"]);
}

fn truth(number: u64) -> WorldTruth {
    WorldTruth { t_ns: CYCLE_PERIOD.0 * number as i64, braked: 1, ..WorldTruth::ZERO }
}

#[test]
fn the_arm_itself_is_at_rest_without_drives_and_where_it_says() {
    assert_eq!(broken_with_truth(100, |_| {}, |number| Some(truth(number))), [""; 0]);
    let stop = from(120, |tick| {
        ask_to_stop(tick);
        goes(tick, 121, Mode::Stopping, State::ManualUncalibrated);
        goes(tick, 140, Mode::Ready, State::Start);
        if tick.tick >= 140 {
            make_safe(tick);
        }
    });
    let enabled = |number| Some(WorldTruth { enabled: 1, ..truth(number) });
    let found = broken_with_truth(300, &stop, enabled);
    assert_eq!(found, ["drives off when they may not run"]);
    let moving =
        |number| Some(WorldTruth { qd_rad_s: [0.2, 0.0, 0.0, 0.0, 0.0, 0.0], ..truth(number) });
    let found = broken_with_truth(400, &stop, moving);
    assert!(found.contains(&"rest after a stop"), "{found:?}");
    let faster = |number: u64| {
        let speed = 0.1 * number as f64;
        Some(WorldTruth { qd_rad_s: [speed, 0.0, 0.0, 0.0, 0.0, 0.0], ..truth(number) })
    };
    let found = broken_with_truth(50, |_| {}, faster);
    assert!(found.contains(&"nothing gets faster without drives"), "{found:?}");
    // With an error of the servo nobody asks for the torque of gravity alone.
    let calibrated = |tick: &mut Tick| {
        tick.joints.as_mut().unwrap().calibrated = 1;
        tick.desired.as_mut().unwrap().q_rad[1] = 1e-4;
    };
    let off = |number| {
        let drift = if number > 20 { 0.02 } else { 0.0 };
        Some(WorldTruth { q_rad: [0.0, drift, 0.0, 0.0, 0.0, 0.0], ..truth(number) })
    };
    assert_eq!(broken_with_truth(50, calibrated, off), ["the arm is where it says"]);
}

#[test]
fn images_come_from_new_frames_and_motion_by_touch_needs_them() {
    let judged = |touch: &dyn Fn(u64) -> Touch| -> Vec<&'static str> {
        let mut judge = judge();
        for number in 0..300 {
            let mut now = tick(number);
            goes(&mut now, 80, Mode::Moving, State::TactileServo);
            if number % 2 == 0 {
                judge.touch(&touch(number));
            }
            judge.tick(&now);
        }
        let other = ["legal states only", "motion is asked for"];
        rules(&judge).into_iter().filter(|rule| !other.contains(rule)).collect()
    };
    let good = |number: u64| Touch {
        release: CYCLE_PERIOD * number as i64,
        answered: true,
        new: true,
        sequence: number as u32,
        image: true,
        faults: 0,
    };
    assert_eq!(judged(&good), [""; 0]);
    let held = judged(&|number| Touch { new: number < 150, ..good(number) });
    assert_eq!(held, ["an image is of a new frame", "no motion by touch without frames"]);
    assert_eq!(judged(&|number| Touch { sequence: 7, ..good(number) }), ["frames are counted"]);
}
