//! What carries the fingertip, as the world and the integrators see it: the PUMA 260, a carriage on
//! rails, or any other arm. The world sees a [`Manipulator`], the integrators its coordinates as
//! [`Coordinates`]; nothing else in the crate asks which of them it is. A manipulator does not know
//! what touches the finger.

use core::fmt::Debug;

use taktil_hal::CHANNELS;
use taktil_mechanics::spatial::{Jacobian, JointMatrix, JointVector, SinCos};
use taktil_mechanics::{Joints, Pose};

use crate::contact::Surface;
use crate::friction::ResistingTorque;
use crate::hand::grasp::{Grasp, StepWork};
use crate::hash::Hash;

/// The most joints that a simulated arm has.
pub(crate) const JOINTS_MAX: usize = 8;

/// Coordinates, their speeds and the deflections of the friction bristles on them: joints (rad,
/// rad/s, rad), or the height of a floating carriage in the first place (m, m/s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ArmState<const J: usize = 6> {
    pub(crate) q: JointVector<J>,
    pub(crate) qd: JointVector<J>,
    pub(crate) bristle: JointVector<J>,
    /// Rotors that turn beside their joints, on the joints' side.
    pub(crate) rotors: RotorState<J>,
}

/// Angles and speeds of the rotors behind compliant gears (rad, rad/s); zero behind stiff gears.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RotorState<const J: usize = 6> {
    pub(crate) q: JointVector<J>,
    pub(crate) qd: JointVector<J>,
}

impl<const J: usize> Default for ArmState<J> {
    fn default() -> ArmState<J> {
        let zeros = JointVector::zeros();
        let rotors = RotorState { q: zeros, qd: zeros };
        ArmState { q: zeros, qd: zeros, bristle: zeros, rotors }
    }
}

impl<const J: usize> ArmState<J> {
    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.numbers(self.q.as_slice());
        hash.numbers(self.qd.as_slice());
        hash.numbers(self.bristle.as_slice());
    }
}

/// The finger at the end of an implicit stage, predicted for guessed speeds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StagePredictor<const J: usize = 6> {
    /// The first so many coordinates move.
    pub(crate) degrees_of_freedom: usize,
    pub(crate) inertia: JointMatrix<J>,
    /// Generalised forces beside friction and contact.
    pub(crate) forces: JointVector<J>,
    /// Twist of the tool per speed.
    pub(crate) jacobian: Jacobian<J>,
    pub(crate) pose: Pose,
    /// Twist that is prescribed; within a stage also the twist of the guessed speeds.
    pub(crate) prescribed_twist: Joints,
    /// Speeds for which the stage's end was predicted.
    pub(crate) guessed_speeds: JointVector<J>,
    /// Sines and cosines of the predicted joint angles; only of the PUMA 260.
    pub(crate) sin_cos: SinCos,
}

impl<const J: usize> StagePredictor<J> {
    /// The prediction for a finger whose motion is prescribed.
    pub(crate) fn prescribed(pose: Pose, prescribed_twist: Joints) -> StagePredictor<J> {
        StagePredictor {
            degrees_of_freedom: 0,
            inertia: JointMatrix::identity(),
            forces: JointVector::zeros(),
            jacobian: Jacobian::zeros(),
            pose,
            prescribed_twist,
            guessed_speeds: JointVector::zeros(),
            sin_cos: SinCos { s: [0.0; 6], c: [1.0; 6] },
        }
    }
}

/// The state of the lines between the drives' board and an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DriveLines {
    /// The drives put current into the motors.
    pub(crate) enabled: bool,
    /// The brakes are on.
    pub(crate) braked: bool,
}

impl DriveLines {
    /// No current flows and the brakes are on.
    pub(crate) const SAFE: DriveLines = DriveLines { enabled: false, braked: true };
}

/// The encoders of an arm in its home pose.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct HomeCounts {
    /// Reading of each encoder.
    pub(crate) counts: Vec<i32>,
    /// Counts in one turn of each motor.
    pub(crate) counts_per_turn: Vec<f64>,
}

/// Angles and speeds of the motors, finer than the encoders count; 0 behind the last joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct MotorMotion {
    /// Angles on the scale of [`Manipulator::counts`] (counts).
    pub(crate) counts: [f64; CHANNELS],
    /// Speeds (counts/s).
    pub(crate) counts_s: [f64; CHANNELS],
}

/// Carries the fingertip: what of it does not depend on the number of its coordinates. Methods
/// with a body do what is right for a manipulator that lacks the part in question.
pub(crate) trait Manipulator: Debug + Send + Sync {
    /// The tool frame.
    fn pose(&self) -> &Pose;

    /// Velocity of the tool point and angular velocity of the tool, stacked (m/s, rad/s).
    fn twist(&self) -> Joints;

    /// What the steps since the last call took, of a manipulator that counts it.
    fn take_work(&mut self) -> StepWork {
        StepWork::default()
    }

    /// The hand that it is, if it is one.
    fn grasp(&self) -> Option<&dyn Grasp> {
        None
    }

    /// Whether the motion is a function of time alone, so that explicit steps sum up time in it.
    fn is_prescribed(&self) -> bool {
        false
    }

    /// Whether the forces are smooth in the state: nothing sticks.
    fn is_smooth(&self) -> bool {
        false
    }

    /// Whether it has a method of its own, which [`Coordinates::step`] is, and feels no contact.
    fn steps_by_itself(&self) -> bool {
        false
    }

    /// Whether rotors turn beside their joints.
    fn has_compliant_gears(&self) -> bool {
        false
    }

    /// Whether explicit steps that feel the contact exist.
    fn has_explicit_steps(&self) -> bool {
        true
    }

    /// Largest distance by which one unit of a coordinate moves the finger, roughly (m).
    fn lever_m(&self) -> f64 {
        1.0
    }

    /// Whether a joint stands beyond its stops.
    fn is_beyond_limits(&self) -> bool {
        false
    }

    /// Puts joints that went beyond their stops back, at rest.
    fn stop_at_limits(&mut self) {}

    /// Takes the codes that drive the amplifiers from now on, and the lines.
    fn drive(&mut self, _codes: &[i32; CHANNELS], _lines: DriveLines) {}

    /// The lines as they were taken last.
    fn drive_lines(&self) -> DriveLines {
        DriveLines::SAFE
    }

    /// Incremental encoder counts, 0 behind the last joint.
    fn counts(&self) -> [i32; CHANNELS] {
        [0; CHANNELS]
    }

    /// The encoders in the home pose; none without encoders.
    fn home_counts(&self) -> Option<HomeCounts> {
        None
    }

    /// Angles and speeds of the motors.
    fn motor_motion(&self) -> MotorMotion {
        MotorMotion::default()
    }

    /// Code of the current that each motor needs for an acceleration of one count/s^2 while the
    /// others keep their speeds, in the present pose; none without motors.
    fn codes_per_acceleration(&self) -> Option<Vec<f64>> {
        None
    }

    /// The codes that flow as current now.
    fn current_codes(&self) -> [i32; CHANNELS] {
        [0; CHANNELS]
    }

    /// Angles (rad) and speeds (rad/s) of the joints; none without joints.
    fn joints(&self) -> (&[f64], &[f64]) {
        (&[], &[])
    }

    /// State of the PUMA 260's joints; none for every other manipulator.
    fn puma_state(&self) -> Option<&ArmState> {
        None
    }

    /// Kinetic and potential energy (J).
    fn energy_j(&self) -> f64 {
        0.0
    }

    /// The face of the pad that it carries.
    fn surface(&self) -> Surface {
        Surface::of_pad(self.pose(), &self.twist())
    }

    /// Adds everything that the next instant depends on.
    fn digest(&self, hash: &mut Hash);
}

/// The coordinates of a manipulator, `J` at most, as the integrators move them.
pub(crate) trait Coordinates<const J: usize>: Manipulator {
    /// What the integrators save and restore; a manipulator that steps by itself leaves it as it
    /// is.
    fn state(&self) -> &ArmState<J>;

    /// The state for an integrator to write.
    fn state_mut(&mut self) -> &mut ArmState<J>;

    /// One explicit step of `h` seconds under a wrench on the tool (N, N m about the tool point,
    /// base frame).
    fn step(&mut self, h: f64, wrench: &Joints);

    /// As [`Coordinates::step`], for a step that begins at `t_s`: for a manipulator on which forces
    /// act that change with time.
    fn step_from(&mut self, _t_s: f64, h: f64, wrench: &Joints) {
        self.step(h, wrench);
    }

    /// One step of `h` seconds by the classical Runge-Kutta method; only for a manipulator that
    /// [`Manipulator::is_smooth`].
    fn step_rk4(&mut self, _h: f64) {}

    /// Predicts the end, at `end_s`, of an implicit stage of `h` seconds from `base`, if the
    /// coordinates end it at the speeds `guess`.
    fn predict_stage(
        &self,
        base: &ArmState<J>,
        guess: &JointVector<J>,
        h: f64,
        end_s: f64,
    ) -> StagePredictor<J>;

    /// The generalised forces of a prediction for other speeds than the guessed ones, for a stage
    /// of `h` seconds from `base`.
    fn generalised_forces(
        &self,
        predictor: &StagePredictor<J>,
        _base: &ArmState<J>,
        _speeds: &JointVector<J>,
        _h: f64,
    ) -> JointVector<J> {
        predictor.forces
    }

    /// Friction on coordinate `i` at the end of a stage of `h` seconds from `base`.
    fn resisting_torque(&self, base: &ArmState<J>, i: usize, speed: f64, h: f64)
    -> ResistingTorque;

    /// Brings tool frame and twist up to date with the state at `t_s`.
    fn update_kinematics(&mut self, t_s: f64);

    /// A copy of its own.
    fn clone_box(&self) -> Box<dyn Coordinates<J>>;
}

impl<const J: usize> Clone for Box<dyn Coordinates<J>> {
    fn clone(&self) -> Box<dyn Coordinates<J>> {
        self.clone_box()
    }
}
