//! Motors and encoders of wrong polarity in the whole machine over the simulated arm: how far it
//! gets until its drives are off, in every state, and that an arm without a fault goes on.

use std::sync::atomic::AtomicBool;

use taktil_hal::{
    AnalogOut, CHANNELS, Counts, DacCode, Encoders, Error, IndexPulses, Nanos, Reading,
};
use taktil_machine::config::MachineConfig;
use taktil_machine::robot::AnyRobot;
use taktil_machine::wiring;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::record::{Observer, Record};
use taktil_rtcore::{
    Cycle, FaultCode, Input, Io, LaneSpec, Machine, Mode, Output, Payload, Task, payload,
    virtual_time,
};
use taktil_signal::{ControlState, JogCommand, JogFrame, MoveQueue, OperatorMove, Request, Verb};

use taktil_sim::{Timing, World, WorldConfig};

/// What is reversed from when on.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Reversed {
    Nothing,
    Motor(usize),
    Encoder(usize),
    DeadEncoder(usize),
}

/// A converter one of whose channels has the wrong sign from an instant on.
struct ReversedMotor {
    half: Box<dyn AnalogOut>,
    channel: usize,
    from: Nanos,
}

impl AnalogOut for ReversedMotor {
    fn channels(&self) -> usize {
        self.half.channels()
    }
    fn code_range(&self) -> (DacCode, DacCode) {
        self.half.code_range()
    }
    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut codes = *codes;
        if release >= self.from {
            let (DacCode(low), DacCode(high)) = self.half.code_range();
            codes[self.channel] = DacCode((-codes[self.channel].0).clamp(low, high));
        }
        self.half.commit(release, &codes)
    }
    fn safe(&mut self) -> Result<(), Error> {
        self.half.safe()
    }
    fn safe_value(&self) -> DacCode {
        self.half.safe_value()
    }
    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

/// Encoders one of which counts by `sign` from an instant on, from where it stands.
struct ReversedEncoder {
    half: Box<dyn Encoders>,
    channel: usize,
    sign: i32,
    from: Nanos,
    place: Option<i32>,
}

impl Encoders for ReversedEncoder {
    fn joints(&self) -> usize {
        self.half.joints()
    }
    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let mut reading = self.half.sample(release)?;
        if release >= self.from {
            let Counts(count) = reading.value[self.channel];
            let place = *self.place.get_or_insert(count);
            reading.value[self.channel] = Counts(place + self.sign * (count - place));
        }
        Ok(reading)
    }
    fn has_index(&self) -> bool {
        self.half.has_index()
    }
    fn index_pulses(&self) -> IndexPulses {
        self.half.index_pulses()
    }
}

payload! {
    /// The true joints and drives, as the simulator has them.
    pub struct Truth {
        /// The instant, ns.
        pub t_ns: i64,
        /// Joint angles.
        pub q_rad: [f64; 6],
        /// 1 while the drives are enabled.
        pub enabled: u32,
        /// Always 0.
        pub unused: u32,
    }
}

/// Advances the world and says what is true.
struct Physics {
    world: World,
    truth: Output<Truth>,
}

impl Task for Physics {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        self.world.advance(cycle.release + cycle.dt);
        let truth = self.world.truth();
        let (q_rad, enabled) = (truth.q.into(), u32::from(truth.enabled));
        io.write(&self.truth, Truth { t_ns: truth.t.0, q_rad, enabled, unused: 0 });
        Ok(())
    }
}

/// Where the arm stands when it is switched on (deg), far from everything.
const START_DEG: [f64; 6] = [0.0, 46.8, -160.6, -180.0, 66.2, 180.0];

/// What is done to the arm, and in which state.
#[derive(Clone, Debug)]
struct Scene {
    /// Sections that replace those of the machine file.
    sections: String,
    acts: Vec<Act>,
}

/// One act of the operator, at its time.
#[derive(Clone, Copy, Debug)]
enum Act {
    Ask(i64, Verb),
    Hold(i64, [f64; 6]),
}

/// Says what the acts say.
struct Operator {
    acts: Vec<Act>,
    sequence: u32,
    said: (Request, JogCommand),
    request: Output<Request>,
    jog: Output<JogCommand>,
    moves: Output<OperatorMove>,
    _control: Input<ControlState>,
    _queue: Input<MoveQueue>,
}

impl Task for Operator {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let now_ms = cycle.release.0 / 1_000_000;
        while let Some(act) = self.acts.first().copied() {
            let (Act::Ask(at_ms, _) | Act::Hold(at_ms, _)) = act;
            if now_ms < at_ms {
                break;
            }
            self.acts.remove(0);
            self.sequence += 1;
            let sequence = self.sequence;
            match act {
                Act::Ask(_, verb) => self.said.0 = Request { verb: verb as u32, sequence },
                Act::Hold(_, axes) => {
                    let frame = JogFrame::Joints as u32;
                    self.said.1 = JogCommand { axes, frame, sequence };
                }
            }
        }
        // A hand that holds a key says so again and again.
        self.said.1.sequence += 1;
        io.write(&self.request, self.said.0);
        io.write(&self.jog, self.said.1);
        io.write(&self.moves, OperatorMove::ZERO);
        Ok(())
    }
}

fn machine(scene: &Scene, reversed: Reversed, from: Nanos) -> Machine {
    let timing = Timing::default();
    let world = format!(
        "pin = {{ present = false }}\ntable = {{ height_mm = -900.0 }}\narm = {{ home_deg = \
         {START_DEG:?} }}"
    );
    let world: WorldConfig = toml::from_str(&world).unwrap();
    let (world, mut devices) = taktil_sim::build(&world, &timing, 1).unwrap();
    match reversed {
        Reversed::Nothing => {}
        Reversed::Motor(channel) => {
            let half = devices.analog_out.take().unwrap();
            devices.analog_out = Some(Box::new(ReversedMotor { half, channel, from }));
        }
        Reversed::Encoder(channel) | Reversed::DeadEncoder(channel) => {
            let sign = if reversed == Reversed::Encoder(channel) { -1 } else { 0 };
            let half = devices.encoders.take().unwrap();
            let encoder = ReversedEncoder { half, channel, sign, from, place: None };
            devices.encoders = Some(Box::new(encoder));
        }
    }
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../sim/scenes/machine/puma260.toml");
    let shipped: MachineConfig =
        toml::from_str(&std::fs::read_to_string(shipped).unwrap()).unwrap();
    let sections = format!("[sense]\nhome_deg = {START_DEG:?}\n{}", scene.sections);
    let config = shipped.overridden_by(toml::from_str(&sections).unwrap());
    let acts = scene.acts.clone();
    let operator: wiring::OperatorBuilder<'_> = Box::new(move |ports| {
        Ok(Box::new(Operator {
            acts,
            sequence: 0,
            said: (Request::ZERO, JogCommand::ZERO),
            request: ports.output("request"),
            jog: ports.output("jog"),
            moves: ports.output("moves"),
            _control: ports.input_delayed("control"),
            _queue: ports.input_delayed("queue"),
        }))
    });
    let robot = AnyRobot::Puma260(Box::new(Robot::puma260()));
    let mut builder = wiring::assemble(config, &robot, devices, operator).unwrap();
    let mut spec = LaneSpec::new("world", timing.control_period, 70);
    spec.phase = timing.actuation_delay;
    spec.delivery = timing.control_period - timing.actuation_delay;
    spec.deadline = spec.delivery;
    let lane = builder.lane(spec).unwrap();
    builder
        .task(lane, "world", |ports| Ok(Box::new(Physics { world, truth: ports.output("truth") })))
        .unwrap();
    builder.build().unwrap()
}

/// What was true after each period, and what the supervisor said.
struct Seen {
    truth_id: usize,
    control_id: usize,
    truth: Vec<Truth>,
    control: Vec<ControlState>,
}

impl Observer for Seen {
    fn record(&mut self, record: &Record<'_>) {
        if record.signal == self.truth_id {
            self.truth.push(Truth::decode(record.body).unwrap());
        } else if record.signal == self.control_id {
            self.control.push(ControlState::decode(record.body).unwrap());
        }
    }
}

fn run(scene: &Scene, reversed: Reversed, from: Nanos, until: Nanos) -> Seen {
    let mut machine = machine(scene, reversed, from);
    let id = |name: &str| machine.catalog().find(name).unwrap();
    let (truth_id, control_id) = (id("world.truth"), id("supervisor.control"));
    let mut seen = Seen { truth_id, control_id, truth: Vec::new(), control: Vec::new() };
    virtual_time::run(&mut machine, until, &AtomicBool::new(false), &mut seen).unwrap();
    seen
}

/// What became of a run with a fault.
#[derive(Debug)]
struct Outcome {
    /// From the first 0.2 degree off the sound run to the end of the torque (s).
    reaction_s: Option<f64>,
    /// Farthest from the sound run until the end of the torque (deg).
    farthest_deg: f64,
    first: Option<FaultCode>,
}

fn outcome(sound: &Seen, seen: &Seen) -> Outcome {
    let (mut noticed_s, mut off_s): (Option<f64>, Option<f64>) = (None, None);
    let (mut farthest_deg, mut before_deg) = (0.0_f64, 0.0);
    for (now, sound) in seen.truth.iter().zip(&sound.truth) {
        let joints = now.q_rad.iter().zip(&sound.q_rad);
        let away_deg = joints.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max).to_degrees();
        let t_s = now.t_ns as f64 / 1e9;
        if away_deg >= 0.2 && noticed_s.is_none() {
            let share = (0.2 - before_deg) / (away_deg - before_deg);
            noticed_s = Some(t_s - 2.5e-3 * (1.0 - share));
        }
        before_deg = away_deg;
        if off_s.is_none() {
            farthest_deg = farthest_deg.max(away_deg);
            if now.enabled == 0 && sound.enabled == 1 {
                // The drives went off at the begin of this period.
                off_s = Some(t_s - 2.5e-3);
            }
        }
    }
    let reaction_s = noticed_s.map(|noticed_s| off_s.unwrap_or(f64::INFINITY) - noticed_s);
    let code = seen.control.last().map_or(0, |control| control.first_fault);
    let first = u16::try_from(code).ok().and_then(FaultCode::from_code);
    Outcome { reaction_s, farthest_deg, first }
}

/// The arm switched on, then these acts; the pose is told to the servo, or not.
fn scene(pose_is_known: bool, acts: &[Act]) -> Scene {
    let sections = match pose_is_known {
        true => format!("[joint_servo]\nassumed_pose_deg = {START_DEG:?}\n"),
        false => String::new(),
    };
    Scene { sections, acts: [&[Act::Ask(10, Verb::Enable)], acts].concat() }
}

const CALIBRATE: Act = Act::Ask(150, Verb::Calibrate);

fn alone(joint: usize) -> [f64; 6] {
    core::array::from_fn(|i| if i == joint { 1.0 } else { 0.0 })
}

/// The bar: off within 15 ms of the first 0.2 degree and before 1 degree, or never 0.2 degree away.
fn check(sound: &Seen, seen: &Seen, what: &str) -> bool {
    let outcome = outcome(sound, seen);
    println!("{what}: {outcome:?}");
    let Some(reaction_s) = outcome.reaction_s else {
        assert!(outcome.farthest_deg < 0.2, "{what}: {outcome:?}");
        return false;
    };
    assert!(reaction_s <= 0.015, "{what}: {outcome:?}");
    assert!(outcome.farthest_deg < 1.0, "{what}: {outcome:?}");
    assert_eq!(outcome.first, Some(FaultCode::Runaway), "{what}: {outcome:?}");
    true
}

const FROM_THE_START: Nanos = Nanos::ZERO;

fn both(joint: usize) -> [Reversed; 2] {
    [Reversed::Motor(joint), Reversed::Encoder(joint)]
}

#[test]
fn a_reversed_motor_or_encoder_is_off_before_a_degree_when_the_brakes_open() {
    for pose_is_known in [true, false] {
        let scene = scene(pose_is_known, &[]);
        let until = Nanos::from_millis(300);
        let sound = run(&scene, Reversed::Nothing, FROM_THE_START, until);
        assert_eq!(sound.control.last().map(ControlState::mode), Some(Mode::Hold));
        let mut falls = 0;
        for joint in 0..6 {
            for reversed in both(joint) {
                let seen = run(&scene, reversed, FROM_THE_START, until);
                falls += u32::from(check(&sound, &seen, &format!("{pose_is_known} {reversed:?}")));
            }
        }
        assert!(falls >= 2, "the joints under gravity fall: {falls}");
    }
}

#[test]
fn a_reversed_motor_or_encoder_is_off_before_a_degree_when_its_joint_is_jogged() {
    for joint in 0..6 {
        for verb in [Verb::ManualUncalibrated, Verb::ManualJoint] {
            let acts = [CALIBRATE, Act::Ask(200, verb), Act::Hold(250, alone(joint))];
            let known = verb == Verb::ManualJoint;
            let scene = scene(true, if known { &acts } else { &acts[1..] });
            let until = Nanos::from_millis(1200);
            let sound = run(&scene, Reversed::Nothing, FROM_THE_START, until);
            let last = sound.control.last().unwrap();
            assert_eq!((last.mode(), last.first_fault), (Mode::Moving, 0), "{verb:?}");
            // What falls at once is another test's.
            let from = Nanos::from_millis(220);
            for reversed in both(joint) {
                let seen = run(&scene, reversed, from, until);
                let moved = check(&sound, &seen, &format!("{verb:?} {reversed:?}"));
                assert!(moved, "{verb:?} {reversed:?} did not move");
            }
        }
    }
}

#[test]
fn a_motor_or_encoder_that_is_reversed_in_mid_motion_is_off_before_a_degree() {
    let axes = [1.0, -1.0, 1.0, 1.0, -1.0, 1.0];
    let acts = [
        CALIBRATE,
        Act::Ask(200, Verb::ManualJoint),
        Act::Hold(250, axes),
        Act::Hold(900, axes.map(|axis| -axis)),
    ];
    let scene = scene(true, &acts);
    let until = Nanos::from_millis(1_500);
    let sound = run(&scene, Reversed::Nothing, FROM_THE_START, until);
    for at_ms in [300, 500, 800, 950, 1100] {
        let from = Nanos::from_millis(at_ms);
        for reversed in (0..6).flat_map(both) {
            let seen = run(&scene, reversed, from, from + Nanos::from_millis(300));
            check(&sound, &seen, &format!("at {at_ms} ms {reversed:?}"));
        }
    }
}

#[test]
fn a_dead_encoder_is_found_while_its_joint_is_moved() {
    for joint in 0..6 {
        let acts = [CALIBRATE, Act::Ask(200, Verb::ManualJoint), Act::Hold(250, alone(joint))];
        let scene = scene(true, &acts);
        let until = Nanos::from_millis(1200);
        let sound = run(&scene, Reversed::Nothing, FROM_THE_START, until);
        let seen = run(&scene, Reversed::DeadEncoder(joint), FROM_THE_START, until);
        let outcome = outcome(&sound, &seen);
        println!("{joint}: {outcome:?}");
        assert_eq!(outcome.first, Some(FaultCode::StuckEncoder), "joint {joint}: {outcome:?}");
        assert_eq!(seen.control.last().map(ControlState::mode), Some(Mode::Fault));
    }
}
