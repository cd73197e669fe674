//! How much torque, and for how long, while nothing is seen to move: an encoder that does not count
//! must not let its joint jump. What is known of the arm bounds both: the friction that a joint has
//! and the inertia that it has at least.

use crate::model::Model;

/// Torque over inertia that is allowed for, in parts of that of the file: a motor may be stronger
/// by 1.6, and a gear larger by 1.5, than the file says.
const STRENGTH_RATIO: f64 = 2.4;
/// The same for friction: a joint may be smoother.
const FRICTION_RATIO: f64 = 0.8;
/// Largest motion in one pulse (rad): less than the degree that a joint may move by before its
/// direction is known, because pulses to both sides do not cancel wholly.
const MOTION_MAX_RAD: f64 = 0.7 * core::f64::consts::PI / 180.0;

/// What is known of one joint, at the joint (N m, kg m^2).
#[derive(Clone, Copy, Debug)]
struct JointBounds {
    nm_per_code: f64,
    free_inertia_kg_m2: f64,
    friction_nm: f64,
    holding_nm: f64,
}

/// What is known of all joints, and how long their brakes take (s).
#[derive(Clone, Debug)]
pub(crate) struct UnseenBounds {
    joints: Vec<JointBounds>,
    brake_s: f64,
}

impl UnseenBounds {
    pub(crate) fn new(model: &Model, brake_s: f64) -> UnseenBounds {
        let (inertia, holding) = (model.free_inertia_kg_m2(), model.holding_nm());
        let of = |i: usize| JointBounds {
            nm_per_code: model.nm_per_code(i),
            free_inertia_kg_m2: inertia[i],
            friction_nm: model.friction_nm[i],
            holding_nm: holding[i].abs(),
        };
        UnseenBounds { joints: (0..model.joints).map(of).collect(), brake_s }
    }

    /// The largest code that is tried while one of these joints has not answered: `ratio` times
    /// what overcomes friction and gravity of the one that needs least. Without end where the file
    /// states no friction.
    pub(crate) fn code_max(&self, joints: &[usize], ratio: f64) -> f64 {
        let needed = joints.iter().filter_map(|joint| {
            let JointBounds { nm_per_code, friction_nm, holding_nm, .. } =
                *self.joints.get(*joint)?;
            let code = ratio * (friction_nm + holding_nm) / nm_per_code;
            (friction_nm > 0.0 && code.is_finite()).then_some(code)
        });
        needed.fold(f64::INFINITY, f64::min)
    }

    /// The longest pulse of `code` with which none of these joints moves too far (s), with what it
    /// coasts until its brake holds, whatever the encoders show meanwhile: what counts may be a
    /// joint that is thrown along, or coupled. Without end for a code that moves none.
    pub(crate) fn longest_s(&self, code: f64, joints: &[usize]) -> f64 {
        let longest = joints.iter().filter_map(|joint| self.joints.get(*joint));
        longest.map(|joint| self.longest_of_joint_s(joint, code)).fold(f64::INFINITY, f64::min)
    }

    fn longest_of_joint_s(&self, joint: &JointBounds, code: f64) -> f64 {
        let rubbing = FRICTION_RATIO * joint.friction_nm;
        let driving = STRENGTH_RATIO * joint.nm_per_code * code + joint.holding_nm - rubbing;
        if driving <= 0.0 {
            return f64::INFINITY;
        }
        let a = driving / joint.free_inertia_kg_m2;
        // It coasts until friction or the brake stops it, whichever is sooner.
        let (brake_s, twice_rad) = (self.brake_s, 2.0 * MOTION_MAX_RAD);
        let braked = -brake_s + libm::sqrt(brake_s * brake_s + twice_rad / a);
        let slowing = (rubbing - joint.holding_nm).max(0.0) / joint.free_inertia_kg_m2;
        if slowing <= 0.0 {
            return braked;
        }
        let rubbed = libm::sqrt(twice_rad / (a + a * a / slowing));
        braked.max(rubbed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bounds(brake_s: f64) -> UnseenBounds {
        let light = JointBounds {
            nm_per_code: 1e-3,
            free_inertia_kg_m2: 0.01,
            friction_nm: 0.06,
            holding_nm: 0.0,
        };
        let heavy = JointBounds {
            nm_per_code: 6e-3,
            free_inertia_kg_m2: 0.15,
            friction_nm: 2.7,
            holding_nm: 0.0,
        };
        UnseenBounds { joints: vec![light, heavy], brake_s }
    }

    /// How far a joint with all that the bounds allow for moves in such a pulse (rad).
    fn moved(joint: JointBounds, code: f64, pulse_s: f64, brake_s: f64) -> f64 {
        let rubbing = FRICTION_RATIO * joint.friction_nm;
        let (mut at, mut speed, step_s) = (0.0, 0.0, 1e-5);
        for step in 0..1_000_000 {
            let t = f64::from(step) * step_s;
            let torque = if t < pulse_s { STRENGTH_RATIO * joint.nm_per_code * code } else { 0.0 };
            if t >= pulse_s + brake_s || (t >= pulse_s && speed <= 0.0) {
                break;
            }
            speed += step_s * (torque - rubbing) / joint.free_inertia_kg_m2;
            at += step_s * speed;
        }
        at
    }

    #[test]
    fn the_longest_pulse_moves_the_strongest_joint_by_the_limit_and_no_more() {
        for brake_s in [0.0, 0.005, 0.1] {
            let bounds = bounds(brake_s);
            for code in [40.0, 100.0, 300.0] {
                let pulse_s = bounds.longest_s(code, &[0]);
                let at = moved(bounds.joints[0], code, pulse_s, brake_s);
                assert!((at / MOTION_MAX_RAD - 1.0).abs() < 0.02, "{brake_s} {code}: {at}");
            }
        }
    }

    #[test]
    fn the_joint_that_needs_least_says_how_far_the_torque_goes() {
        let bounds = bounds(0.0);
        assert_eq!(bounds.code_max(&[0, 1], 4.0), 240.0);
        assert_eq!(bounds.code_max(&[1], 4.0), 1_800.0);
        assert_eq!(bounds.code_max(&[], 4.0), f64::INFINITY);
        assert_eq!(bounds.longest_s(10.0, &[0, 1]), f64::INFINITY, "what does not move anything");
        assert!(bounds.longest_s(500.0, &[0, 1]) < bounds.longest_s(500.0, &[1]));
    }
}
