//! Motion under an operator's hand in the whole stack: minutes of random keys, and the tool along
//! the axes asked for. The bounds hold whatever keys are pressed.

use taktil_lab_scene::scene::{OperatorAction, Scene, Step};
use taktil_lab_world::WorldTruth;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_rtcore::{FaultSet, Nanos};
use taktil_signal::{ControlState, Desired, JogFrame, JointState, State, Verb};

use taktil_tests::bench::{RecordedRun, SceneDraft, run};
use taktil_tests_script::dice::Dice;

fn axis(dice: &mut Dice) -> f64 {
    [0.0, 0.0, 0.0, 1.0, -1.0, 0.5][usize::try_from(dice.roll(6)).unwrap()]
}

fn ask(verb: Verb) -> Step {
    Step { act: OperatorAction::Ask(verb), at: Nanos::ZERO }
}

/// The arm high above the table, then these acts.
fn scene(acts: impl IntoIterator<Item = Step>, duration_s: f64) -> Scene {
    let mut scene = SceneDraft::of("hold.toml").set("duration_s", duration_s).scene();
    scene.script = vec![ask(Verb::Enable), ask(Verb::Calibrate)];
    scene.script.extend(acts);
    scene
}

fn random_keys(frames: &[JogFrame], seconds: i64, dice: &mut Dice) -> Vec<Step> {
    let mut keys = Vec::new();
    let mut left = Nanos::from_secs(seconds);
    while left > Nanos::ZERO {
        let span = Nanos::from_millis(20 + i64::try_from(dice.roll(600)).unwrap());
        let frame = frames[usize::try_from(dice.roll(frames.len() as u64)).unwrap()];
        let axes = core::array::from_fn(|_| axis(dice));
        keys.push(Step { act: OperatorAction::Hold { axes, frame, span }, at: Nanos::ZERO });
        left -= span;
    }
    keys
}

/// No setpoint steps further than the joint's largest speed in one tick, none leaves the limits.
fn check_setpoints(kept: &RecordedRun) -> f64 {
    let arm = Puma260::reference();
    let mut before: Option<Joints> = None;
    let mut farthest = 0.0f64;
    let joints = kept.of::<JointState>("sense.joints");
    // From when the zeros are known, and everybody counts from them.
    let known = joints.iter().position(|row| row.1.calibrated == 1).unwrap() + 4;
    let first = kept.of::<Desired>("setpoint.desired")[known].1.q_rad;
    for (release, desired) in kept.of::<Desired>("setpoint.desired").iter().skip(known) {
        let q = Joints::from(desired.q_rad);
        if let Some(before) = before {
            let share = (q - before).abs().component_div(&(arm.speed_max_rad_s * 0.0025)).amax();
            assert!(share <= 1.0 + 1e-9, "a jump of {share} at {release}");
        }
        assert!(arm.within_limits(&q), "{q} at {release}");
        farthest = farthest.max((q - Joints::from(first)).amax());
        before = Some(q);
    }
    farthest
}

#[test]
fn a_minute_of_random_keys_never_makes_the_setpoint_jump() {
    let mut dice = Dice::new(1);
    let both = [JogFrame::Base, JogFrame::Tool];
    for (verb, frames, state) in [
        (Verb::ManualJoint, &[JogFrame::Joints][..], State::ManualJoint),
        (Verb::ManualCartesian, &both[..], State::ManualCartesian),
    ] {
        let acts = [ask(verb)].into_iter().chain(random_keys(frames, 60, &mut dice));
        let mut scene = scene(acts, 60.0);
        // The arm may go anywhere: neither pin nor table is to be in its way.
        scene.world.table.height_mm = Some(-900.0);
        let kept = run(&scene, 1);
        let control = kept.last_control();
        assert_eq!((control.state, FaultSet(control.faults)), (state as u32, FaultSet::NONE));
        assert!(check_setpoints(&kept) > 0.2, "it moved");
    }
}

#[test]
fn keys_move_the_true_tool_along_the_axes_asked_for() {
    let hold = |axis: usize, by: f64, frame| {
        let mut axes = [0.0; 6];
        axes[axis] = by;
        Step {
            act: OperatorAction::Hold { axes, frame, span: Nanos::from_secs(1) },
            at: Nanos::ZERO,
        }
    };
    let acts = [
        ask(Verb::ManualCartesian),
        hold(2, 1.0, JogFrame::Base),
        hold(0, 1.0, JogFrame::Tool),
        ask(Verb::Idle),
    ];
    let kept = run(&scene(acts, 6.0), 1);
    assert_eq!(kept.last_control().state, State::IdleCalibrated as u32);
    let truth = kept.of::<WorldTruth>("world.truth");
    let (first, last) = (truth[0].1.tool_m, truth.last().unwrap().1.tool_m);
    // 1 s at 40 mm/s up the base's z, then along the tool's x, which is the base's -x.
    for (axis, wanted) in [(0, -0.04), (1, 0.0), (2, 0.04)] {
        let way = last[axis] - first[axis];
        assert!((way - wanted).abs() < 1.5e-3, "axis {axis}: {way}");
    }
}

#[test]
fn the_home_pose_is_jogged_to_before_the_zeros_are_known() {
    let mut scene = SceneDraft::of("hold.toml").set("duration_s", 4.0).scene();
    let axes = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let span = Nanos::from_secs(1);
    let hold = OperatorAction::Hold { axes, frame: JogFrame::Joints, span };
    scene.script = vec![
        ask(Verb::Enable),
        ask(Verb::ManualUncalibrated),
        Step { act: hold, at: Nanos::ZERO },
        ask(Verb::Idle),
        ask(Verb::Calibrate),
    ];
    let kept = run(&scene, 1);
    assert_eq!(kept.last_control().state, State::IdleCalibrated as u32);
    assert_eq!(kept.last_control().faults, 0);
    let joints = kept.of::<JointState>("sense.joints");
    let counts = |at: usize| joints[at].1.counts[5];
    // 5 % of the sixth joint's 280 deg/s for 1 s, in counts before they were initialised.
    let before = joints.iter().rposition(|row| row.1.calibrated == 0).unwrap();
    assert_ne!(counts(0), counts(before), "the sixth joint was turned");
}

#[test]
fn the_tour_goes_through_the_states_in_order_without_a_fault() {
    let kept = run(&SceneDraft::of("tour.toml").scene(), 1);
    let mut states = Vec::new();
    for (_, control) in kept.of::<ControlState>("supervisor.control") {
        let state = State::from_code(control.state).unwrap();
        if states.last() != Some(&state) {
            states.push(state);
        }
    }
    assert_eq!(
        states,
        [
            State::Start,
            State::IdleUncalibrated,
            State::ManualUncalibrated,
            State::IdleUncalibrated,
            State::IdleCalibrated,
            State::ManualJoint,
            State::IdleCalibrated,
            State::ManualCartesian,
            State::IdleCalibrated,
            State::TrajectoryUser,
            State::IdleCalibrated,
            State::Trajectory,
            State::IdleCalibrated,
            State::TactileServo,
        ]
    );
    let last = kept.last_control();
    assert_eq!((last.faults, last.refused), (0, 0));
    check_setpoints(&kept);
    let truth = kept.of::<WorldTruth>("world.truth").last().unwrap().1;
    assert_eq!(truth.in_contact, 1, "it ends at the pin");
}
