//! Gears that give way: between each motor and its joint stands a torsional spring with a damper,
//! after Spong (1987): the rotor turns beside the link, `J' w' = tau - friction - pull`, and the
//! link feels `pull = k (m - q) + d (w - q')` alone. Friction and encoders are on the motor's side.
//! Refuses rotors that feel the links' turning otherwise.
//!
//! Within an implicit stage a rotor is eliminated: for a speed of the joint at the stage's end its
//! own equation is one piecewise linear, rising function of the rotor's speed.

use taktil_mechanics::Joints;
use taktil_mechanics::friction::Friction;

use super::friction::{Rub, rub};
use crate::finger::Swing;

/// Steps of Newton's method on a rotor's equation; it has five straight pieces.
const STEPS_MAX: usize = 8;

/// Springs, dampers and rotors of all joints, on the joints' side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Gears {
    stiffness_nm_rad: Joints,
    damping_nms_rad: Joints,
    rotor_kg_m2: Joints,
}

impl Gears {
    /// `damping` is that of each rotor on its spring, against a joint that is held, in parts of the
    /// critical one.
    pub(crate) fn new(stiffness_nm_rad: Joints, damping: f64, rotor_kg_m2: Joints) -> Gears {
        let critical = |i: usize| 2.0 * (stiffness_nm_rad[i] * rotor_kg_m2[i]).sqrt();
        let damping_nms_rad = Joints::from_fn(|i, _| damping * critical(i));
        Gears { stiffness_nm_rad, damping_nms_rad, rotor_kg_m2 }
    }

    /// Where the motors stand when their springs hold joints at `q` (rad) under torques (N m).
    pub(crate) fn balanced(&self, q: &Joints, held_nm: &Joints) -> Joints {
        q + held_nm.component_div(&self.stiffness_nm_rad)
    }

    /// What joint `i` feels of its gear when it ends a stage of `h` seconds from `base` at `speed`
    /// and the drive makes `driven_nm`; with the rotor's place and speed then.
    pub(crate) fn pull(
        &self,
        (base, i): (&Swing, usize),
        (speed, h): (f64, f64),
        driven_nm: f64,
        friction: &Friction,
    ) -> Rub {
        let (k, d, rotor) =
            (self.stiffness_nm_rad[i], self.damping_nms_rad[i], self.rotor_kg_m2[i]);
        let angle = base.q[i] + h * speed;
        let twist = |w: f64| base.motor.q[i] + h * w - angle;
        let pull = |w: f64| k * twist(w) + d * (w - speed);
        let equation = |w: f64| {
            let rubs = rub(friction, i, base.bristle[i], w, h);
            let left = rotor * (w - base.motor.qd[i]) + h * (rubs.torque_nm + pull(w) - driven_nm);
            (left, rotor + h * (rubs.slope + h * k + d), rubs.bristle_rad)
        };
        let mut w = base.motor.qd[i];
        for _ in 0..STEPS_MAX {
            let (left, slope, _) = equation(w);
            let change = left / slope;
            w -= change;
            if change.abs() <= 1e-12 * (1.0 + w.abs()) {
                break;
            }
        }
        let (_, slope, bristle_rad) = equation(w);
        let gives = h * (h * k + d) / slope;
        Rub {
            torque_nm: -pull(w),
            slope: (h * k + d) * (1.0 - gives),
            bristle_rad,
            motor: Some((base.motor.q[i] + h * w, w)),
        }
    }

    /// Energy of rotors and springs (J).
    pub(crate) fn energy_j(&self, now: &Swing) -> f64 {
        let turned = now.motor.qd.component_mul(&now.motor.qd).dot(&self.rotor_kg_m2);
        let twist = now.motor.q - now.q;
        0.5 * (turned + twist.component_mul(&twist).dot(&self.stiffness_nm_rad))
    }
}
