//! The end of a run: however it ends, the boards get the safe values at once and do not need their
//! own watchdogs for it.
#![expect(clippy::disallowed_types, reason = "a test looks at the world between runs")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use taktil_lab_scene::operator::Operator;
use taktil_lab_scene::scene::Scene;
use taktil_machine::wiring;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Cycle, FaultCode, Io, LaneSpec, Machine, Mode, Nanos, Payload, Task, virtual_time,
};
use taktil_signal::{ControlState, State};
use taktil_sim::{Timing, World};

use taktil_tests::bench::SceneDraft;

/// Advances a world that the test can look at afterwards.
struct Shared(Arc<Mutex<World>>);

impl Task for Shared {
    fn step(&mut self, cycle: &Cycle, _io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.0.lock().unwrap().advance(cycle.release + cycle.dt);
        Ok(())
    }
}

/// Ends the run, as Ctrl-C does, some time after a state was entered.
struct EndIn<'a> {
    control: usize,
    state: State,
    after: Nanos,
    stop: &'a AtomicBool,
    mode: Option<Mode>,
}

impl Observer for EndIn<'_> {
    fn record(&mut self, record: &Record<'_>) {
        if record.signal != self.control {
            return;
        }
        let control = ControlState::decode(record.body).unwrap();
        let since = record.release - Nanos(control.entered_ns);
        if control.state == self.state as u32 && since >= self.after {
            self.mode = Mode::from_code(control.mode);
            self.stop.store(true, Ordering::SeqCst);
        }
    }
}

fn machine(scene: &Scene) -> (Machine, Arc<Mutex<World>>) {
    let timing = Timing::default();
    let (world, devices) = taktil_sim::build(&scene.world, &timing, 1).unwrap();
    let world = Arc::new(Mutex::new(world));
    let script = scene.script.clone();
    let operator: wiring::OperatorBuilder<'_> =
        Box::new(move |ports| Ok(Box::new(Operator::new(script, ports)?)));
    let mut builder =
        wiring::assemble(scene.machine.clone(), &scene.robot, devices, operator).unwrap();
    let mut spec = LaneSpec::new("world", timing.control_period, 70);
    spec.phase = timing.actuation_delay;
    spec.delivery = timing.control_period - timing.actuation_delay;
    spec.deadline = spec.delivery;
    let lane = builder.lane(spec).unwrap();
    let shared = world.clone();
    builder.task(lane, "world", |_| Ok(Box::new(Shared(shared)))).unwrap();
    (builder.build().unwrap(), world)
}

/// Runs until a while after `state` was entered, ends, and looks at the boards.
fn check_end_in(state: State, after: Nanos) {
    let scene = SceneDraft::roll_pin().scene();
    let (mut machine, world) = machine(&scene);
    let control = machine.catalog().find("supervisor.control").unwrap();
    let stop = AtomicBool::new(false);
    let mut end = EndIn { control, state, after, stop: &stop, mode: None };
    let reached = virtual_time::run(&mut machine, scene.duration, &stop, &mut end).unwrap();
    let mode = end.mode.unwrap_or_else(|| panic!("{state:?} was not reached"));
    assert!(mode.brakes_released(), "{state:?}: nothing was in force that a stop could end");
    assert!(reached < scene.duration);

    let mut world = world.lock().unwrap();
    let before = (world.analog_out(), world.digital_out());
    assert!(before.0.iter().any(|code| *code != 0) && before.1.enable, "{before:?}");
    // One period on; the boards' own watchdogs would need 50 ms.
    let now = world.now();
    world.advance(now + Nanos::from_micros(2_500));
    let (codes, lines) = (world.analog_out(), world.digital_out());
    assert!(codes.iter().all(|code| *code == 0), "{state:?}: D/A words {codes:?}");
    assert!(!lines.enable && !lines.brake_release, "{state:?}: {lines:?}");
    let truth = world.truth();
    assert!(!truth.enabled && truth.braked, "{state:?}: enabled or not braked");
    // And the arm stands soon after.
    world.advance(now + Nanos::from_millis(500));
    let speed = world.truth().qd.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    assert!(speed < 1e-3, "{state:?}: still moves at {speed} rad/s");
}

#[test]
fn a_run_ended_while_holding_leaves_the_outputs_safe() {
    check_end_in(State::IdleCalibrated, Nanos::ZERO);
}

#[test]
fn a_run_ended_in_mid_move_leaves_the_outputs_safe() {
    check_end_in(State::Trajectory, Nanos::from_millis(200));
}

#[test]
fn a_run_ended_in_mid_stroke_leaves_the_outputs_safe() {
    check_end_in(State::TactileServo, Nanos::from_millis(2_000));
}
