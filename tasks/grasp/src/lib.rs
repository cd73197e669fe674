//! The task that grasps. In the state TACTILE-SERVO the fingers of a hand close until each of them
//! touches, then hold the object, adapt the grip to what the friction cones ask for, and move or
//! turn the object as the configuration says; an arm that carries the palm lifts it meanwhile. It
//! reports the load, the tangential force and the
//! distance from the edge of the friction cone of each finger, and says when one is beyond it.
//!
//! - In: `control`, `desired` and `torque` (both of the job before), `joints`, and the image of
//!   each finger: `finger1`, `finger2` and so on.
//! - Out: `goal`, `state`.
//! - Rate: every job of the servo lane, 400 Hz; images at 200 Hz.
//! - Source: see [`law`].
//!
//! The normal force is what the arrays feel, the tangential one what the motors' torques leave
//! beside gravity: an array without shear cells does not feel it. Friction of the joints is in that
//! figure.

pub mod config;
pub mod law;
pub mod touch;

pub use config::Config;

use taktil_mechanics::hand::Hand;
use taktil_mechanics::spatial::JointVector;
use taktil_rtcore::{Cycle, FaultCode, Input, Invalid, Io, Output, Ports, StateHash, Task};
use taktil_signal::{
    ControlState, Desired, Goal, GraspState, JointState, State, TactileImage, Torque,
};

use law::{Inputs, Law, Tuning};
use touch::{Touch, TouchScale, touch};

/// What the task does with its goals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Activation {
    /// The machine is in another state.
    Inactive,
    /// The law drives, from joints with this datum.
    Active { datum: u32 },
    /// The law could not take the hand over, or the zero of the joints moved.
    Refused,
}

/// The task of a hand of `F` fingers with `N` joints.
pub struct Grasp<const F: usize, const N: usize> {
    control: Input<ControlState>,
    desired: Input<Desired<N>>,
    joints: Input<JointState<N>>,
    torque: Input<Torque<N>>,
    images: [Input<TactileImage>; F],
    goal: Output<Goal<N>>,
    state: Output<GraspState>,
    hand: Hand<F, N>,
    tuning: Tuning<F>,
    scale: TouchScale,
    touch: [Touch; F],
    law: Law<F, N>,
    activation: Activation,
    /// When the machine last entered TACTILE-SERVO.
    entered_ns: i64,
    /// The goal of the last job (rad).
    last_goal: JointVector<N>,
}

/// The most fingers that [`GraspState`] tells of.
const FINGERS_REPORTED: usize = 3;

impl<const F: usize, const N: usize> Grasp<F, N> {
    /// Declares `control`, `desired`, `joints`, `torque`, an image for each finger, `goal` and
    /// `state`.
    ///
    /// # Errors
    /// What [`Config::tuning`] refuses, and a hand of more than three fingers.
    pub fn new(
        config: &Config,
        hand: Hand<F, N>,
        ports: &mut Ports,
    ) -> Result<Grasp<F, N>, Invalid> {
        if F == 0 || F > FINGERS_REPORTED {
            let what = format!("the hand has {F} fingers");
            return Err(Invalid::new("", what, "grasp with one to three fingers"));
        }
        let tuning = config.tuning::<F>()?;
        if hand.carrier().is_none() && !tuning.palm.is_still() {
            let place = if config.lift_mm == [0.0; 3] { "tilt_deg" } else { "lift_mm" };
            let remedy = "leave it out, or name tips on an arm of six joints in [arm]";
            return Err(Invalid::new(place, "moves a palm that stands still", remedy));
        }
        let rest = JointVector::zeros();
        Ok(Grasp {
            control: ports.input("control"),
            desired: ports.input_delayed("desired"),
            joints: ports.input("joints"),
            torque: ports.input_delayed("torque"),
            images: core::array::from_fn(|f| ports.array_input(FINGER_PORTS[f])),
            goal: ports.output("goal"),
            state: ports.output("state"),
            tuning,
            scale: config.scale(),
            touch: [Touch::default(); F],
            law: Law::new(hand, tuning, &rest),
            hand,
            activation: Activation::Inactive,
            entered_ns: 0,
            last_goal: rest,
        })
    }

    /// Takes the hand over, or leaves it.
    fn update_activation(
        &mut self,
        control: Option<ControlState>,
        desired: Option<Desired<N>>,
        joints: Option<&JointState<N>>,
    ) -> Result<(), FaultCode> {
        let Some(control) = control.filter(|c| c.state == State::TactileServo as u32) else {
            self.activation = Activation::Inactive;
            return Ok(());
        };
        if self.activation != Activation::Inactive && control.entered_ns == self.entered_ns {
            let moved = matches!(self.activation, Activation::Active { datum }
                if joints.is_none_or(|joints| joints.datum != datum));
            if moved {
                self.activation = Activation::Refused;
                return Err(FaultCode::MoveRefused);
            }
            return Ok(());
        }
        self.entered_ns = control.entered_ns;
        let start = desired.filter(|desired| desired.valid == 1);
        let joints = joints.filter(|joints| joints.calibrated == 1);
        let (Some(start), Some(joints)) = (start, joints) else {
            self.activation = Activation::Refused;
            return Err(FaultCode::MoveRefused);
        };
        self.last_goal = JointVector::from(start.q_rad);
        self.law = Law::new(self.hand, self.tuning, &self.last_goal);
        self.activation = Activation::Active { datum: joints.datum };
        Ok(())
    }

    /// The goal of this job.
    fn next_goal(
        &mut self,
        joints: Option<&JointState<N>>,
        torque: Option<Torque<N>>,
        dt_s: f64,
    ) -> Goal<N> {
        match (self.activation, joints) {
            (Activation::Active { .. }, Some(joints)) => {
                let inputs = Inputs {
                    q: JointVector::from(joints.q_rad),
                    torque_nm: JointVector::from(torque.unwrap_or_default().tau_nm),
                    touch: self.touch,
                    dt_s,
                };
                let goal = self.law.step(&inputs);
                let speed = if dt_s > 0.0 { (goal - self.last_goal) / dt_s } else { goal * 0.0 };
                self.last_goal = goal;
                Goal { q_rad: goal.into(), qd_rad_s: speed.into(), valid: 1, done: 0 }
            }
            (Activation::Refused, _) => Goal { done: 1, ..Goal::default() },
            _ => Goal::default(),
        }
    }

    fn report(&self, cycle: &Cycle) -> GraspState {
        let mut state = GraspState { at_ns: cycle.release.0, ..GraspState::default() };
        let (grip_n, squeeze_m, held_s) = self.law.grip();
        for (f, touch) in self.touch.iter().enumerate() {
            (state.load_n[f], state.felt[f]) = (touch.load_n, u32::from(touch.felt));
            (state.middle_x_m[f], state.middle_y_m[f]) = (touch.middle_m.x, touch.middle_m.y);
        }
        if !matches!(self.activation, Activation::Active { .. }) {
            return state;
        }
        state.phase = self.law.phase() as u32;
        (state.grip_n, state.squeeze_m, state.held_s) = (grip_n, squeeze_m, held_s);
        let forces = self.law.forces();
        let margins_n = self.law.margins_n();
        state.least_margin_n = margins_n.iter().copied().fold(f64::INFINITY, f64::min);
        for f in 0..F {
            state.tangential_n[f] = forces[f].tangential.length();
            state.margin_n[f] = margins_n[f];
            if margins_n[f] < 0.0 && self.law.phase() == law::Phase::Holding {
                state.beyond |= 1 << f;
            }
        }
        state
    }
}

/// Names of the ports of the images.
const FINGER_PORTS: [&str; FINGERS_REPORTED] = ["finger1", "finger2", "finger3"];

impl<const F: usize, const N: usize> Task for Grasp<F, N> {
    fn step(&mut self, cycle: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
        let control = io.read(&self.control).usable();
        let desired = io.read(&self.desired).usable();
        let joints = io.read(&self.joints).usable();
        let torque = io.read(&self.torque).usable();
        for f in 0..F {
            let image = self.images[f];
            let felt = io.with_fresh_array(&image, |image, _| touch(image, &self.scale));
            self.touch[f] = felt.unwrap_or(self.touch[f]);
        }
        let outcome = self.update_activation(control, desired, joints.as_ref());
        let was_refused = self.law.is_palm_refused();
        let goal = self.next_goal(joints.as_ref(), torque, cycle.dt.as_secs_f64());
        io.write(&self.goal, goal);
        let state = self.report(cycle);
        io.write(&self.state, state);
        // The arm brakes; the fault tells why.
        let refuses = !was_refused && self.law.is_palm_refused();
        if refuses { outcome.and(Err(FaultCode::Unreachable)) } else { outcome }
    }

    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.law).add(&self.touch).add(&self.entered_ns).add(self.last_goal.as_slice());
        match self.activation {
            Activation::Inactive => hash.word(0),
            Activation::Refused => hash.word(1),
            Activation::Active { datum } => hash.word(2).add(&datum),
        };
    }

    fn stop(&mut self) {
        self.activation = Activation::Inactive;
    }
}
