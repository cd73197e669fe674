//! Compliant gears: between each motor and its joint stands a torsional spring with a damper, after
//! Spong (1987). The rotor turns beside the link, `J' w' = tau - friction - pull`, and the link
//! feels `pull = k (m - q) + d (w - q')` alone. Friction and encoders are on the motor's side. The
//! rotation of the links acts on a rotor in no other way.
//!
//! Within an implicit stage a rotor is eliminated: for a speed of the joint at the stage's end the
//! rotor's own equation is one piecewise linear, rising function of the rotor's speed.

use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;

use crate::friction::{ResistingTorque, RotorEnd, friction_torque};
use crate::manipulator::ArmState;

/// Steps of Newton's method on a rotor's equation at most; the equation has five straight pieces.
const NEWTON_STEPS_MAX: usize = 8;
/// Change of a rotor's speed below which its equation is solved, relative to 1 rad/s plus the
/// speed.
const SPEED_TOLERANCE: f64 = 1e-12;

/// Springs, dampers and rotors of all joints, on the joints' side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CompliantGears {
    stiffness_nm_rad: Joints,
    damping_nms_rad: Joints,
    rotor_kg_m2: Joints,
}

/// The end of an implicit stage at one joint.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointStage {
    /// Which joint.
    pub(super) joint: usize,
    /// Speed of the joint at the end of the stage (rad/s).
    pub(super) speed: f64,
    /// Length of the stage (s).
    pub(super) h: f64,
    /// Torque of the drive during the stage (N m).
    pub(super) motor_nm: f64,
}

impl CompliantGears {
    /// `damping` is the damping of each rotor on its spring, against a joint that is held, relative
    /// to the critical damping.
    pub(crate) fn new(
        stiffness_nm_rad: Joints,
        damping: f64,
        rotor_kg_m2: Joints,
    ) -> CompliantGears {
        let critical = |i: usize| 2.0 * (stiffness_nm_rad[i] * rotor_kg_m2[i]).sqrt();
        let damping_nms_rad = Joints::from_fn(|i, _| damping * critical(i));
        CompliantGears { stiffness_nm_rad, damping_nms_rad, rotor_kg_m2 }
    }

    /// Angles of the rotors (rad) whose springs hold joints at `q` (rad) under torques (N m).
    pub(crate) fn static_rotor_angles(&self, q: &Joints, torque_nm: &Joints) -> Joints {
        q + torque_nm.component_div(&self.stiffness_nm_rad)
    }

    /// Torque of the gear on its joint at the end of a stage from `base`, with the rotor's angle
    /// and speed there.
    pub(super) fn resisting_torque(
        &self,
        base: &ArmState,
        stage: JointStage,
        friction: &Friction,
    ) -> ResistingTorque {
        let JointStage { joint: i, speed, h, motor_nm } = stage;
        let (k, d, rotor) =
            (self.stiffness_nm_rad[i], self.damping_nms_rad[i], self.rotor_kg_m2[i]);
        let angle = base.q[i] + h * speed;
        let twist = |w: f64| base.rotors.q[i] + h * w - angle;
        let pull = |w: f64| k * twist(w) + d * (w - speed);
        let equation = |w: f64| {
            let rubs = friction_torque(friction, i, base.bristle[i], w, h);
            let left = rotor * (w - base.rotors.qd[i]) + h * (rubs.torque_nm + pull(w) - motor_nm);
            (left, rotor + h * (rubs.slope + h * k + d), rubs.bristle_rad)
        };
        let mut w = base.rotors.qd[i];
        for _ in 0..NEWTON_STEPS_MAX {
            let (left, slope, _) = equation(w);
            let change = left / slope;
            w -= change;
            if change.abs() <= SPEED_TOLERANCE * (1.0 + w.abs()) {
                break;
            }
        }
        let (_, slope, bristle_rad) = equation(w);
        // The share of a change of the joint's speed that its rotor follows.
        let follows = h * (h * k + d) / slope;
        ResistingTorque {
            torque_nm: -pull(w),
            slope: (h * k + d) * (1.0 - follows),
            bristle_rad,
            rotor: Some(RotorEnd { angle_rad: base.rotors.q[i] + h * w, speed_rad_s: w }),
        }
    }

    /// Energy of rotors and springs (J).
    pub(crate) fn energy_j(&self, state: &ArmState) -> f64 {
        let turned = state.rotors.qd.component_mul(&state.rotors.qd).dot(&self.rotor_kg_m2);
        let twist = state.rotors.q - state.q;
        0.5 * (turned + twist.component_mul(&twist).dot(&self.stiffness_nm_rad))
    }
}
