//! Tests `supervisor` in a machine with two lanes in virtual time among scripted tasks.

use taktil_rtcore::status::ModeStatus;
use taktil_rtcore::{Cycle, FaultCode, FaultSet, Io, LaneSpec, Mode, Output, Payload, Task};
use taktil_signal::{ControlState, Goal, JointState, Lines, Request, State, Verb};
use taktil_tasks_supervisor::{Config, Supervisor};
use taktil_tests_script::{Bench, SERVO_PERIOD};

const JOBS_RUN: u64 = 400;

/// What the scripted tasks do in one job of the servo lane.
#[derive(Clone, Copy)]
struct Around {
    verb: Verb,
    lines: Option<Lines>,
    joints: bool,
    done: bool,
    valid: bool,
    /// Raised by a task of the servo lane, before the supervisor.
    servo: Option<FaultCode>,
    panics: bool,
}

const QUIET: Around = Around {
    verb: Verb::None,
    lines: Some(Lines { drive_power: 1, estop_a_closed: 1, estop_b_closed: 1 }),
    joints: true,
    done: false,
    valid: true,
    servo: None,
    panics: false,
};

/// Enable in job 10, calibrate in job 50, then the given verb in job 60.
fn started(tick: u64, verb: Verb) -> Around {
    let verb = match tick {
        10 => Verb::Enable,
        50 => Verb::Calibrate,
        60 => verb,
        _ => Verb::None,
    };
    Around { verb, ..QUIET }
}

/// Everything that the supervisor listens to in its own lane.
struct Others {
    script: fn(u64) -> Around,
    sequence: u32,
    calibrated: u32,
    request: Output<Request>,
    lines: Output<Lines>,
    joints: Output<JointState>,
    goal: Output<Goal>,
}

impl Task for Others {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let now = (self.script)(cycle.tick);
        assert!(!now.panics, "on purpose");
        if now.verb != Verb::None {
            self.sequence += 1;
            let request = Request { verb: now.verb as u32, sequence: self.sequence };
            io.write(&self.request, request);
        }
        self.calibrated = u32::from(cycle.tick > 50);
        if let Some(lines) = now.lines {
            io.write(&self.lines, lines);
        }
        if now.joints {
            // The zero moves once, when it is found.
            let (calibrated, datum) = (self.calibrated, self.calibrated);
            io.write(&self.joints, JointState { calibrated, datum, ..JointState::ZERO });
        }
        let (valid, done) = (u32::from(now.valid), u32::from(now.done));
        io.write(&self.goal, Goal { valid, done, ..Goal::ZERO });
        now.servo.map_or(Ok(()), Err)
    }
}

/// Raises a fault in the touch lane from one of its jobs on, for as many jobs.
struct TouchInputs(Option<(FaultCode, u64, u64)>);

impl Task for TouchInputs {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        match self.0 {
            Some((fault, from, jobs)) if (from..from + jobs).contains(&cycle.tick) => Err(fault),
            _ => Ok(()),
        }
    }
}

struct Seen {
    control: Vec<ControlState>,
    mode: Vec<ModeStatus>,
}

impl Seen {
    fn at(&self, tick: usize) -> (State, Mode) {
        let control = &self.control[tick];
        let mode = Mode::from_code(control.mode);
        (State::from_code(control.state).expect("a state"), mode.expect("a mode"))
    }
}

fn run(script: fn(u64) -> Around, touch: Option<(FaultCode, u64, u64)>) -> Seen {
    run_on(true, script, touch)
}

fn run_on(feels: bool, script: fn(u64) -> Around, touch: Option<(FaultCode, u64, u64)>) -> Seen {
    let mut bench = Bench::new();
    let servo = bench.servo();
    let lane = bench.lane(LaneSpec::new("touch", SERVO_PERIOD * 2, 70));
    bench.task(servo, "others", |ports| {
        Ok(Others {
            script,
            sequence: 0,
            calibrated: 0,
            request: ports.output("request"),
            lines: ports.output("lines"),
            joints: ports.output("joints"),
            goal: ports.output("goal"),
        })
    });
    bench.task(servo, "supervisor", |ports| Supervisor::<6>::new(Config::default(), feels, ports));
    bench.task(lane, "scan", |_| Ok(TouchInputs(touch)));
    for (port, signal) in [
        ("request", "others.request"),
        ("lines", "others.lines"),
        ("joints", "others.joints"),
        ("trajectory", "others.goal"),
        ("tactile", "others.goal"),
        ("servo_health", "servo.health"),
        ("touch_health", "touch.health"),
    ] {
        if feels || !["tactile", "touch_health"].contains(&port) {
            bench.bind(&format!("supervisor.{port}"), signal);
        }
    }
    bench.mode_from("supervisor.mode");
    let run = bench.run(SERVO_PERIOD * i64::try_from(JOBS_RUN).unwrap());
    let seen = Seen { control: run.of("supervisor.control"), mode: run.of("supervisor.mode") };
    assert_eq!((seen.control.len(), seen.mode.len()), (400, 400));
    seen
}

#[test]
fn the_way_to_a_trajectory_and_back_takes_the_states_of_the_figure() {
    let seen = run(|tick| Around { done: tick >= 100, ..started(tick, Verb::Trajectory) }, None);
    assert_eq!(seen.at(1).1, Mode::Checking, "the touch lane has not spoken yet");
    assert_eq!(seen.at(9), (State::Start, Mode::Ready));
    assert_eq!(seen.at(10), (State::Start, Mode::Enabling));
    assert_eq!(seen.at(29), (State::Start, Mode::Enabling));
    assert_eq!(seen.at(30), (State::IdleUncalibrated, Mode::Hold));
    assert_eq!(seen.at(50), (State::IdleCalibrated, Mode::Hold));
    let told: Vec<usize> = (0..400).filter(|tick| seen.control[*tick].calibrate == 1).collect();
    assert_eq!(told, [50]);
    assert_eq!(seen.at(60), (State::Trajectory, Mode::Moving));
    assert_eq!(seen.control[60].entered_ns, 60 * SERVO_PERIOD.0);
    assert_eq!(seen.at(99), (State::Trajectory, Mode::Moving));
    assert_eq!(seen.at(100), (State::IdleCalibrated, Mode::Hold));
    let last = seen.control[399];
    assert_eq!((last.faults, last.refused, last.request), (0, 0, 3));
}

#[test]
fn an_empty_trajectory_is_done_a_tactile_servo_without_goal_is_not() {
    let seen =
        run(|tick| Around { done: true, valid: false, ..started(tick, Verb::Trajectory) }, None);
    assert_eq!(seen.at(60), (State::Trajectory, Mode::Moving));
    assert_eq!(seen.at(61), (State::IdleCalibrated, Mode::Hold));
    let seen = run(
        |tick| Around { done: true, valid: tick >= 200, ..started(tick, Verb::TactileServo) },
        None,
    );
    assert_eq!(seen.at(199), (State::TactileServo, Mode::Moving));
    assert_eq!(seen.at(200), (State::IdleCalibrated, Mode::Hold));
}

#[test]
fn a_fault_that_was_reset_does_not_come_back_from_an_old_word() {
    // Job 50 of the touch lane is seen by jobs 102 and 103 of the servo lane: new, then held.
    let seen = run(
        |tick| {
            let mut now = started(tick, Verb::Trajectory);
            if tick == 103 {
                now.verb = Verb::Reset;
            }
            now
        },
        Some((FaultCode::DigitalLost, 50, 1)),
    );
    assert_eq!(seen.at(101), (State::Trajectory, Mode::Moving));
    assert_eq!(seen.at(102), (State::Start, Mode::Fault));
    assert_eq!(seen.at(103), (State::Start, Mode::Checking), "reset while the word is held");
    assert_eq!((seen.at(104), seen.control[104].faults), ((State::Start, Mode::Ready), 0));
}

#[test]
fn a_fault_in_the_servo_lane_stops_in_the_next_job() {
    let seen = run(
        |tick| Around {
            servo: (tick == 100).then_some(FaultCode::FollowingError),
            ..started(tick, Verb::ManualJoint)
        },
        None,
    );
    assert_eq!(seen.at(100), (State::ManualJoint, Mode::Moving));
    assert_eq!(seen.at(101), (State::Start, Mode::Fault), "it stood still: the stop ends at once");
    assert_eq!(seen.control[101].first_fault, FaultCode::FollowingError as u32);
    assert_eq!(seen.at(399), (State::Start, Mode::Fault), "latched");
}

#[test]
fn a_short_gap_of_touch_is_bridged_a_long_one_ends_in_position_hold() {
    let script = |tick| started(tick, Verb::TactileServo);
    let short = run(script, Some((FaultCode::TactileStale, 50, 4)));
    assert_eq!(short.at(399), (State::TactileServo, Mode::Moving));
    assert!(FaultSet(short.control[399].faults).contains(FaultCode::TactileStale), "remembered");
    assert_eq!(short.mode.iter().filter(|mode| mode.action == 1).count(), 8);
    let long = run(script, Some((FaultCode::TactileStale, 50, 40)));
    // Job 50 of the touch lane is seen by job 102 of the servo lane; 20 ms are 8 jobs.
    assert_eq!(long.at(110), (State::TactileServo, Mode::Moving));
    assert_eq!(long.at(111), (State::IdleCalibrated, Mode::Hold));
    assert_eq!(long.at(399), (State::IdleCalibrated, Mode::Hold), "and does not come back alone");
}

#[test]
fn a_task_that_panicked_and_whose_values_stay_away_ends_without_torque() {
    let seen =
        run(|tick| Around { panics: tick == 100, ..started(tick, Verb::TactileServo) }, None);
    assert_eq!(seen.at(99).1, Mode::Moving);
    assert!(FaultSet(seen.control[101].faults).contains(FaultCode::TaskPanicked));
    let off = (100..400).find(|tick| !seen.at(*tick).1.torque_allowed());
    assert!(off.is_some_and(|tick| tick <= 105), "within 10 ms: {off:?}");
    assert_eq!(seen.at(399), (State::Start, Mode::Fault));
}

#[test]
fn joints_and_lines_that_stay_away_take_the_drives() {
    let seen = run(|tick| Around { joints: tick < 100, ..started(tick, Verb::Idle) }, None);
    assert_eq!(seen.at(103).1, Mode::Hold, "10 ms are allowed");
    assert_eq!(seen.at(104), (State::Start, Mode::Fault));
    assert_eq!(seen.control[104].first_fault, FaultCode::EncoderLost as u32);
    assert_eq!(seen.control[104].refused, 1, "idle in IDLE");
    let seen = run(
        |tick| Around { lines: QUIET.lines.filter(|_| tick < 100), ..started(tick, Verb::None) },
        None,
    );
    assert_eq!(seen.control[104].first_fault, FaultCode::DigitalLost as u32);
}

#[test]
fn reset_and_enable_are_two_acts() {
    let seen = run(
        |tick| {
            let mut now = started(tick, Verb::Trajectory);
            if (100..110).contains(&tick) {
                now.lines = Some(Lines { estop_a_closed: 0, estop_b_closed: 0, ..Lines::ZERO });
            }
            match tick {
                120 | 200 => now.verb = Verb::Enable,
                150 => now.verb = Verb::Reset,
                _ => {}
            }
            now
        },
        None,
    );
    assert_eq!(seen.at(100), (State::Start, Mode::Fault), "in the same job");
    assert_eq!(seen.at(149), (State::Start, Mode::Fault));
    assert_eq!(seen.control[149].refused, 1);
    assert_eq!(seen.at(150), (State::Start, Mode::Checking));
    assert_eq!(seen.at(199), (State::Start, Mode::Ready));
    assert_eq!(seen.at(220), (State::IdleUncalibrated, Mode::Hold));
}

#[test]
fn a_machine_that_cannot_feel_grants_everything_but_touch() {
    // The touch lane's faults do not reach it either.
    let lost = Some((FaultCode::TactileStale, 0, 400));
    let tactile = run_on(false, |tick| started(tick, Verb::TactileServo), lost);
    assert_eq!(tactile.at(399), (State::IdleCalibrated, Mode::Hold));
    assert_eq!(tactile.control[399].refused, 1);
    let moved = run_on(false, |tick| started(tick, Verb::Trajectory), lost);
    assert_eq!(moved.at(399), (State::Trajectory, Mode::Moving));
    assert_eq!((moved.control[399].refused, moved.control[399].faults), (0, 0));
}
