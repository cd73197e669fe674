//! Friction of the joints: an elasto-plastic bristle for each, of stiffness `fc / 1e-4 rad`,
//! damped, which yields at the Coulomb torque, so that a joint at rest really rests; viscous
//! friction is added. The torque is a continuous function of the step's final speed, so that an
//! implicit step does not chatter. It needs the joint's motion in one step only.

use taktil_mechanics::friction::Friction;

/// Joint displacement at which a bristle yields (rad).
const BRISTLE_RAD: f64 = 1e-4;
/// Damping of a bristle over its stiffness (s).
const BRISTLE_DAMPING_S: f64 = 1e-3;

/// What resists the motion of a coordinate at the end of a step, and how it depends on the speed
/// at which the step ends. For a carriage torques are forces (N) and angles are lengths (m).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ResistingTorque {
    /// Torque against the motion (N m).
    pub(crate) torque_nm: f64,
    /// Its derivative with respect to the speed (N m s/rad).
    pub(crate) slope: f64,
    /// The bristle's deflection (rad).
    pub(crate) bristle_rad: f64,
    /// The rotor, if it turns beside its joint.
    pub(crate) rotor: Option<RotorEnd>,
}

/// A rotor at the end of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RotorEnd {
    /// Angle on the joint's side (rad).
    pub(crate) angle_rad: f64,
    /// Speed on the joint's side (rad/s).
    pub(crate) speed_rad_s: f64,
}

/// Friction of joint `i` when it ends a step of `h` seconds at `speed` (rad/s), from a deflection
/// of its bristle.
pub(crate) fn friction_torque<const N: usize>(
    friction: &Friction<N>,
    i: usize,
    bristle_rad: f64,
    speed: f64,
    h: f64,
) -> ResistingTorque {
    let (coulomb, viscous) = (friction.coulomb_nm[i], friction.viscous_nms_rad[i]);
    let deflection = (bristle_rad + h * speed).clamp(-BRISTLE_RAD, BRISTLE_RAD);
    let stiffness = coulomb / BRISTLE_RAD;
    let elastic = stiffness * (deflection + BRISTLE_DAMPING_S * speed);
    let sticks = elastic.abs() < coulomb;
    let carried = if deflection.abs() < BRISTLE_RAD { h } else { 0.0 };
    ResistingTorque {
        torque_nm: elastic.clamp(-coulomb, coulomb) + viscous * speed,
        slope: if sticks { stiffness * (carried + BRISTLE_DAMPING_S) } else { 0.0 } + viscous,
        bristle_rad: deflection,
        rotor: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bristle_yields_at_the_coulomb_torque_and_its_slope_is_exact() {
        let friction = Friction::reference();
        let still = friction.viscous_nms_rad[0];
        let slide = friction_torque(&friction, 0, 0.0, 10.0, 1e-3);
        assert_eq!(slide.torque_nm, friction.coulomb_nm[0] + 10.0 * still);
        assert_eq!(slide.bristle_rad, BRISTLE_RAD);
        for (speed, h) in [(1e-3, 1e-3), (0.04, 1e-3), (-2.0, 1e-3), (1e-2, 2e-2)] {
            let at = |v: f64| friction_torque(&friction, 0, 0.0, v, h).torque_nm;
            let slope = (at(speed + 1e-7) - at(speed - 1e-7)) / 2e-7;
            let stated = friction_torque(&friction, 0, 0.0, speed, h).slope;
            assert!((slope - stated).abs() < 1e-4 * (1.0 + slope), "{speed}: {slope} {stated}");
        }
        assert_eq!(friction_torque(&friction, 0, 0.0, 0.0, 1e-3).torque_nm, 0.0);
    }
}
