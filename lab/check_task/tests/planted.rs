//! Tasks with one defect each, planted on purpose: each defect is found, by the check that is meant
//! for it and by no other, and a task without one is sound.

use std::cell::Cell;
use std::hash::{BuildHasher, Hasher};
use std::path::PathBuf;
use std::sync::Once;

use clap::Parser;
use taktil_lab_check_task::command::{CheckTaskArgs, check};
use taktil_lab_check_task::report::{Check, Failure, Outcome, Report};
use taktil_machine::own::{self, OwnTask, Section};
use taktil_machine::robot::AnyRobot;
use taktil_rtcore::guard::CountingAllocator;
use taktil_rtcore::{
    Cycle, FaultCode, Freshness, Input, Invalid, Io, Nanos, Output, Ports, StateHash, Task, payload,
};
use taktil_signal::{ControlState, Desired, Goal, JointState};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

payload! {
    /// What the planted tasks show.
    pub struct Shown {
        /// A number that depends on everything.
        pub number: f64,
    }
}

/// What is wrong with a task.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Defect {
    None,
    HeapCall,
    Panic,
    NotFinite,
    StaleValue,
    InvalidValue,
    BeyondJoint,
    BeyondPort,
    SlowOnce,
    RandomNumber,
    WallClock,
    KeptState,
    Leak,
    PanicInStop,
    Census,
}

use Defect::{
    BeyondJoint, BeyondPort, Census, HeapCall, InvalidValue, KeptState, Leak, NotFinite, Panic,
    PanicInStop, RandomNumber, SlowOnce, StaleValue, WallClock,
};

/// The budget of the tasks (us).
const BUDGET_US: u32 = 200;
/// A step so far from the first one that only a long run reaches it.
const FAR_STEP: u64 = 100_000;

struct Planted {
    defect: Defect,
    control: Input<ControlState>,
    joints: Input<JointState>,
    desired: Input<Desired>,
    goal: Output<Goal>,
    shown: Output<Shown>,
    steps: u64,
    random: u64,
}

fn make(defect: Defect, ports: &mut Ports) -> Box<dyn Task> {
    if defect == Census {
        let joints = ports.input_within("joints", Nanos::from_millis(10));
        let (control, desired) = (ports.input("control"), ports.input_delayed("desired"));
        return Box::new(CensusTask { control, joints, desired, tick: 0 });
    }
    Box::new(Planted {
        defect,
        control: ports.input("control"),
        joints: ports.input_within("joints", Nanos::from_millis(10)),
        desired: ports.input_delayed("desired"),
        goal: ports.output("goal"),
        shown: ports.output_within("shown", |shown: &Shown| shown.number.abs() <= 1e6),
        steps: 0,
        random: std::collections::hash_map::RandomState::new().build_hasher().finish(),
    })
}

/// A weight for each state that there is.
const STATE_WEIGHTS: [f64; 9] = [1.0; 9];

impl Task for Planted {
    fn start(&mut self) -> Result<(), FaultCode> {
        if self.defect == Leak {
            Box::leak(Box::new([0_u8; 64]));
        }
        Ok(())
    }

    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.steps += 1;
        let control = io.read(&self.control).usable().unwrap_or_default();
        let joints = match self.defect {
            StaleValue => Some(io.read(&self.joints).value),
            _ => io.read(&self.joints).usable(),
        };
        let desired = io.read(&self.desired).usable();
        let desired = desired.filter(|value| value.valid == 1 || self.defect == InvalidValue);
        let weight = match self.defect {
            Panic => STATE_WEIGHTS[control.state as usize],
            _ => STATE_WEIGHTS.get(control.state as usize).copied().unwrap_or(1.0),
        };
        let mut number = weight * (cycle.tick % 1000) as f64;
        number += joints.map_or(0.0, |joints| joints.q_rad[0].clamp(-9.0, 9.0));
        number += desired.map_or(0.0, |desired| desired.q_rad[0].clamp(-9.0, 9.0));
        match self.defect {
            HeapCall if self.steps.is_multiple_of(5000) => {
                std::hint::black_box(Box::new(number));
            }
            NotFinite => number += (2.7 - number.clamp(-3.0, 3.0).abs()).sqrt(),
            BeyondPort if self.steps.is_multiple_of(5000) => number = 1e7,
            SlowOnce if self.steps.is_multiple_of(FAR_STEP) => {
                for turn in 0..4_000_000_u32 {
                    std::hint::black_box(turn);
                }
            }
            RandomNumber => number += (self.random % 1000) as f64,
            WallClock => number += (taktil_rtcore::linux::monotonic().0 / 1_000_000 % 1000) as f64,
            KeptState => number += self.steps as f64,
            _ => {}
        }
        let mut goal = Goal::default();
        if let Some(joints) = joints {
            (goal.q_rad, goal.valid) = (joints.q_rad, 1);
            if self.defect == BeyondJoint && self.steps.is_multiple_of(5000) {
                goal.q_rad[5] = 4.7;
            }
        }
        // Extreme values are not passed on: what is copied stays within a port's range.
        goal.q_rad.iter_mut().for_each(|q_rad| *q_rad = q_rad.clamp(-7.0, 7.0));
        io.write(&self.goal, goal);
        io.write(
            &self.shown,
            Shown {
                number: if number.is_nan() && self.defect != NotFinite { 0.0 } else { number },
            },
        );
        Ok(())
    }

    fn fold(&self, hash: &mut StateHash) {
        if self.defect == KeptState {
            hash.add(&self.steps);
        }
    }

    fn stop(&mut self) {
        assert!(self.defect != PanicInStop, "no stop without a word");
        if self.defect != KeptState {
            self.steps = 0;
        }
    }
}

thread_local! {
    /// What the task `census` has met on this thread, one bit each.
    static MET: Cell<u64> = const { Cell::new(0) };
}

/// Takes down what kinds of inputs it meets.
struct CensusTask {
    control: Input<ControlState>,
    joints: Input<JointState>,
    desired: Input<Desired>,
    tick: u64,
}

impl CensusTask {
    fn kinds(&self, cycle: &Cycle, io: &mut Io<'_>) -> Vec<u32> {
        let control = io.read(&self.control);
        let joints = io.read(&self.joints);
        let desired = io.read(&self.desired);
        let mut kinds = vec![control.freshness as u32, 4 + joints.freshness as u32];
        kinds.push(8 + cycle.mode.code());
        if control.value.state < 9 {
            kinds.push(16 + control.value.state);
        }
        let angle = joints.value.q_rad[2];
        let speed = joints.value.qd_rad_s[1];
        let of = |is: bool, kind: u32| is.then_some(kind);
        kinds.extend(
            [
                of(cycle.tick > self.tick + 1, 25),
                of(cycle.tick > self.tick + 100, 26),
                of(desired.value.valid == 0 && desired.freshness != Freshness::Absent, 27),
                of(desired.value.valid == 1, 28),
                of(angle.is_nan(), 29),
                of(angle == f64::INFINITY, 30),
                of(speed == f64::MAX, 31),
                of(speed < -1e17, 32),
                of(joints.freshness == Freshness::New && angle == 0.0, 33),
                of(control.value.state == u32::MAX, 34),
                of(control.value.entered_ns == i64::MIN, 35),
                of(joints.age > Nanos::from_millis(20), 36),
                of(control.value.entered_ns == cycle.release.0 && cycle.tick > 0, 37),
            ]
            .into_iter()
            .flatten(),
        );
        kinds
    }
}

impl Task for CensusTask {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        for kind in self.kinds(cycle, io) {
            MET.set(MET.get() | 1 << kind);
        }
        self.tick = cycle.tick;
        Ok(())
    }
}

macro_rules! planted {
    ($($name:literal => $defect:expr),* $(,)?) => {
        static TASKS: &[OwnTask] = &[$(OwnTask {
            name: $name,
            make: {
                fn of(
                    _: &Section,
                    _: &AnyRobot,
                    ports: &mut Ports,
                ) -> Result<Box<dyn Task>, Invalid> {
                    Ok(make($defect, ports))
                }
                of
            },
        }),*];
    };
}

planted! {
    "good" => Defect::None,
    "heap_call" => HeapCall,
    "panics" => Panic,
    "not_finite" => NotFinite,
    "stale_value" => StaleValue,
    "invalid_value" => InvalidValue,
    "beyond_joint" => BeyondJoint,
    "beyond_port" => BeyondPort,
    "slow_once" => SlowOnce,
    "random_number" => RandomNumber,
    "wall_clock" => WallClock,
    "kept_state" => KeptState,
    "leaks" => Leak,
    "panics_in_stop" => PanicInStop,
    "census" => Census,
}

#[derive(Parser)]
struct CommandLine {
    #[command(flatten)]
    arguments: CheckTaskArgs,
}

static REGISTER: Once = Once::new();

/// A scene that runs the task before `setpoint`.
fn scene(name: &str, budget_us: u32) -> PathBuf {
    let machine = concat!(env!("CARGO_MANIFEST_DIR"), "/../../sim/scenes/machine/puma260.toml");
    let text = format!(
        "title = \"A planted task\"\nmachine = \"{machine}\"\n[world.pin]\npresent = false\n\
         [robot.insert.{name}]\nlane = \"servo\"\nbefore = \"setpoint\"\nbudget_us = {budget_us}\n\
         [robot.wiring]\n\"{name}.control\" = \"supervisor.control\"\n\
         \"{name}.joints\" = \"sense.joints\"\n\"{name}.desired\" = \"setpoint.desired\"\n"
    );
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let file = folder.join(format!("check-task-{name}.toml"));
    std::fs::write(&file, text).unwrap();
    file
}

fn run_check(name: &str, ticks: usize, more: &[&str]) -> anyhow::Result<Report> {
    REGISTER.call_once(|| own::register(TASKS).unwrap());
    let scene = scene(name, BUDGET_US).display().to_string();
    let ticks = ticks.to_string();
    let mut words =
        vec!["check-task", name, "--scene", &scene, "--ticks", &ticks, "--starts", "60"];
    words.extend(more);
    let CommandLine { arguments } = CommandLine::parse_from(words);
    check(own::find(name).unwrap(), &arguments, false)
}

/// The failure of the one check that fails.
fn only_failure(report: &Report, check: Check) -> Failure {
    assert_eq!(report.failed().collect::<Vec<_>>(), [check], "{}", report.text());
    match report.outcome(check) {
        Some(Outcome::Failed(failure)) => failure.clone(),
        other => panic!("{other:?}"),
    }
}

fn find(name: &str, check: Check) -> Failure {
    only_failure(&run_check(name, 20_000, &[]).unwrap(), check)
}

#[test]
fn a_task_without_a_defect_is_sound() {
    let report = run_check("good", 50_000, &[]).unwrap();
    assert!(report.is_sound(), "{}", report.text());
    let all_held = report.lines.iter().all(|line| line.outcome == Outcome::Held);
    assert!(all_held && report.lines.len() == Check::ALL.len(), "{}", report.text());
    assert_eq!(report.json()["sound"], true);
    let other_seed = run_check("good", 5000, &["--seed", "77"]).unwrap();
    assert!(other_seed.is_sound(), "{}", other_seed.text());
}

#[test]
fn a_heap_call_in_one_step_of_5000_is_found() {
    let failure = find("heap_call", Check::HeapCalls);
    assert_eq!(failure.at.unwrap().step, 4999);
    assert_eq!(failure.what, "2 heap calls in one step");
}

#[test]
fn a_panic_at_a_limit_is_found_with_its_line_and_repeats_by_its_run() {
    let failure = find("panics", Check::Panics);
    assert!(failure.what.contains("tests/planted.rs:"), "{failure:?}");
    let at = failure.at.unwrap();
    assert!(at.inputs.iter().any(|line| line.starts_with("control: usable")), "{at:?}");
    let run = at.run.to_string();
    let again = run_check("panics", 20_000, &["--run", &run]).unwrap();
    let repeated = only_failure(&again, Check::Panics);
    assert_eq!((repeated.at.unwrap(), repeated.count), (at, 1));
    assert!(again.text().contains(&format!("--seed 1 --run {run}")), "{}", again.text());
}

#[test]
fn a_number_that_is_not_finite_is_found_with_its_field() {
    let failure = find("not_finite", Check::NotFinite);
    assert_eq!(failure.what, "shown.number is NaN");
}

#[test]
fn values_that_must_not_be_used_are_found_where_they_count() {
    let stale = find("stale_value", Check::StaleInputs);
    assert!(stale.what.contains("not usable (") && stale.what.contains("joints"), "{stale:?}");
    let invalid = find("invalid_value", Check::StaleInputs);
    assert!(invalid.what.contains("desired"), "{invalid:?}");
}

#[test]
fn outputs_out_of_their_range_are_found() {
    let joint = find("beyond_joint", Check::Ranges);
    assert!(joint.what.starts_with("goal.q_rad[5] is 4.7, beyond -4.66"), "{joint:?}");
    let port = find("beyond_port", Check::Ranges);
    assert!(port.what.starts_with("shown is out of the range"), "{port:?}");
}

#[test]
fn a_step_that_is_slow_once_in_100_000_is_found() {
    let report = run_check("slow_once", 200_000, &[]).unwrap();
    let failure = only_failure(&report, Check::Budget);
    assert_eq!((failure.count, failure.at.unwrap().step), (1, FAR_STEP as usize - 1));
    let budget = Nanos::from_micros(i64::from(BUDGET_US));
    assert!(report.worst > budget && report.p999 < budget);
}

#[test]
fn steps_that_do_not_repeat_are_found() {
    for name in ["random_number", "wall_clock"] {
        find(name, Check::Repeats);
    }
}

#[test]
fn state_that_outlives_a_stop_is_found() {
    let failure = find("kept_state", Check::Restart);
    assert!(failure.what.contains("against a fresh one at step 0: shown.number"), "{failure:?}");
}

#[test]
fn memory_that_each_start_loses_is_found() {
    let failure = find("leaks", Check::Leak);
    assert_eq!(failure.what, "50 starts and stops left 3200 bytes in 50 blocks");
}

#[test]
fn a_panic_in_stop_is_found() {
    assert_eq!(find("panics_in_stop", Check::Panics).what, "`stop` panicked");
}

#[test]
fn inputs_are_of_every_kind() {
    run_check("census", 30_000, &[]).unwrap();
    // An input without a limit is never stale.
    let never = 1 << (Freshness::Stale as u32);
    let all = (1 << 38) - 1;
    let missing = all & !never & !MET.get();
    assert_eq!(missing, 0, "{missing:#b}");
    assert_eq!(MET.get() & never, 0);
}

#[test]
fn what_cannot_be_meant_is_refused() {
    for (more, what) in [
        (&["--ticks", "10"][..], "--ticks 10: give 1000 to 10000000"),
        (&["--starts", "1"], "--starts 1: give 20 to 1000000"),
        (&["--run", "900"], "--run 900: there are"),
    ] {
        let scene = scene("good", BUDGET_US).display().to_string();
        let words = [&["check-task", "good", "--scene", &scene], more].concat();
        let CommandLine { arguments } = CommandLine::parse_from(words);
        REGISTER.call_once(|| own::register(TASKS).unwrap());
        let refused = check(own::find("good").unwrap(), &arguments, false).unwrap_err();
        assert!(refused.to_string().contains(what), "{refused}");
    }
}
