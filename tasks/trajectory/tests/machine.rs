//! The task in a machine, in virtual time, fed by scripts.

use std::sync::atomic::AtomicBool;

use taktil_mechanics::Joints;
use taktil_mechanics::paul::JointPath;
use taktil_rtcore::guard::CountingAllocator;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Builder, Cycle, FaultCode, FaultSet, Io, LaneSpec, Nanos, Output, Payload, Task, virtual_time,
};
use taktil_signal::{ControlState, Desired, Goal, JointState, State};
use taktil_tasks_trajectory::{Config, Move, Trajectory};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Writes what a function of the tick says.
struct Feed<T> {
    out: Output<T>,
    at: fn(u64) -> T,
}

impl<T: Payload> Task for Feed<T> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        io.write(&self.out, (self.at)(cycle.tick));
        Ok(())
    }
}

/// Keeps the goals.
struct Keep {
    signal: usize,
    goals: Vec<Goal>,
}

impl Observer for Keep {
    fn record(&mut self, record: &Record<'_>) {
        if record.signal == self.signal {
            self.goals.push(Goal::decode(record.body).unwrap());
        }
    }
}

#[derive(Clone, Copy)]
struct Script {
    control: fn(u64) -> ControlState,
    desired: fn(u64) -> Desired,
    joints: fn(u64) -> JointState,
}

fn run(config: Config, script: &Script, ticks: i64) -> (Vec<Goal>, FaultSet) {
    let mut builder = Builder::new();
    let lane = builder.lane(LaneSpec::new("servo", Nanos::from_micros(2_500), 80)).unwrap();
    let Script { control, desired, joints } = *script;
    let feed = &mut builder;
    feed.task(lane, "control", |p| Ok(Box::new(Feed { out: p.output("out"), at: control })))
        .unwrap();
    feed.task(lane, "joints", |p| Ok(Box::new(Feed { out: p.output("out"), at: joints }))).unwrap();
    feed.task(lane, "trajectory", |p| Ok(Box::new(Trajectory::new(config, p)?))).unwrap();
    feed.task(lane, "desired", |p| Ok(Box::new(Feed { out: p.output("out"), at: desired })))
        .unwrap();
    for port in ["control", "desired", "joints"] {
        builder.bind(format!("trajectory.{port}"), format!("{port}.out"));
    }
    let mut machine = builder.build().unwrap();
    let signal = machine.catalog().find("trajectory.goal").unwrap();
    let mut keep = Keep { signal, goals: Vec::new() };
    let until = Nanos::from_micros(2_500) * ticks;
    virtual_time::run(&mut machine, until, &AtomicBool::new(false), &mut keep).unwrap();
    let (_, figures) = machine.figures().next().unwrap();
    assert_eq!(figures.allocations, 0);
    (keep.goals, figures.faults)
}

const START: [f64; 6] = [0.0, 0.7, -2.68, -3.13, 1.17, 3.13];
const GOAL_DEG: [f64; 6] = [5.0, 42.0, -150.0, -175.0, 65.0, 170.0];

fn queue() -> Config {
    let one = Move { joints_deg: Some(GOAL_DEG), tool: None, by_mm: None, t_s: Some(0.5) };
    Config { moves: vec![one], ..Config::default() }
}

/// IDLE, then a stay from tick 10 to 50, IDLE, and another stay from tick 60 on.
fn two_stays(tick: u64) -> ControlState {
    let (state, entered_ns) = match tick {
        0..10 => (State::IdleCalibrated, 0),
        10..50 => (State::Trajectory, 25_000_000),
        50..60 => (State::IdleCalibrated, 125_000_000),
        _ => (State::Trajectory, 150_000_000),
    };
    ControlState { state: state as u32, entered_ns, ..ControlState::ZERO }
}

fn calibrated(_: u64) -> JointState {
    JointState { q_rad: START, calibrated: 1, ..JointState::ZERO }
}

fn still(_: u64) -> Desired {
    Desired { q_rad: START, valid: 1, ..Desired::ZERO }
}

#[test]
fn each_stay_follows_a_path_from_where_the_arm_is_wanted() {
    let script = Script { control: two_stays, desired: still, joints: calibrated };
    let (goals, faults) = run(queue(), &script, 400);
    assert!(faults.is_empty());
    let points = [Joints::from(START), Joints::from(GOAL_DEG.map(f64::to_radians))];
    let path = JointPath::new(&points, &[0.5], 0.1).unwrap();
    for (tick, goal) in goals.iter().enumerate() {
        let since = match tick {
            0..10 | 50..60 => {
                assert_eq!(*goal, Goal::ZERO, "tick {tick}");
                continue;
            }
            10..50 => tick - 10,
            _ => tick - 60,
        };
        let t_s = since as f64 * 0.0025;
        let wanted = path.at(t_s);
        assert_eq!((Joints::from(goal.q_rad), Joints::from(goal.qd_rad_s)), (wanted.q, wanted.qd));
        assert_eq!((goal.valid, goal.done == 1), (1, t_s >= path.duration_s()), "tick {tick}");
    }
    assert_eq!(goals[60].q_rad, START, "bumpless");
    assert_eq!(goals[399].done, 1);
}

#[test]
fn what_cannot_start_is_done_without_a_valid_goal() {
    let refused = Goal { done: 1, ..Goal::ZERO };
    let uncalibrated = Script {
        control: two_stays,
        desired: still,
        joints: |tick| JointState { calibrated: 0, ..calibrated(tick) },
    };
    let undesired = Script { desired: |_| Desired::ZERO, joints: calibrated, ..uncalibrated };
    let outside = Script {
        desired: |tick| Desired { q_rad: [9.0; 6], ..still(tick) },
        joints: calibrated,
        ..uncalibrated
    };
    for script in [uncalibrated, undesired, outside] {
        let (goals, faults) = run(queue(), &script, 100);
        assert!(faults.contains(FaultCode::MoveRefused));
        assert_eq!((goals[9], goals[10], goals[49]), (Goal::ZERO, refused, refused));
        assert_eq!((goals[50], goals[60]), (Goal::ZERO, refused));
    }
}

#[test]
fn a_zero_that_moves_ends_the_motion() {
    let script = Script {
        control: two_stays,
        desired: still,
        joints: |tick| JointState { datum: u32::from(tick >= 30), ..calibrated(tick) },
    };
    let (goals, faults) = run(queue(), &script, 70);
    assert!(faults.contains(FaultCode::MoveRefused));
    assert_eq!(
        (goals[29].valid, goals[30], goals[49].done),
        (1, Goal { done: 1, ..Goal::ZERO }, 1)
    );
    assert_eq!(goals[60].valid, 1, "the next stay starts anew");
}

#[test]
fn a_displacement_out_of_reach_is_unreachable_and_an_empty_queue_is_soon_done() {
    let script = Script { control: two_stays, desired: still, joints: calibrated };
    let away = Move { joints_deg: None, tool: None, by_mm: Some([0.0, 0.0, 900.0]), t_s: None };
    let (goals, faults) = run(Config { moves: vec![away], ..Config::default() }, &script, 12);
    assert!(faults.contains(FaultCode::Unreachable));
    assert_eq!(goals[11], Goal { done: 1, ..Goal::ZERO });
    let (goals, faults) = run(Config::default(), &script, 300);
    assert!(faults.is_empty());
    assert_eq!((goals[60].q_rad, goals[60].done), (START, 0));
    assert_eq!((goals[299].q_rad, goals[299].done, goals[299].valid), (START, 1, 1));
}
