//! Integration of the motion of the arm under given torques, by the classical fourth-order method
//! of Runge and Kutta. Steps are fixed and not adaptive, so that the same call makes the same bits.

use super::Dynamics;
use crate::spatial::Joints;

/// The state of motion of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Joint angles (rad).
    pub q: Joints,
    /// Joint speeds (rad/s).
    pub qd: Joints,
}

/// Largest number of steps in one call of [`free_motion`].
pub const STEPS_MAX: u32 = 10_000_000;

/// The state one step of `step_s` (s) after `state` at `t_s` (s). `torque_nm(t, q, qd)` returns the
/// joint torques (N m) beside gravity, including friction with its sign; it is called four times.
#[must_use]
pub fn rk4_step(
    arm: &Dynamics,
    state: &State,
    t_s: f64,
    step_s: f64,
    torque_nm: &mut impl FnMut(f64, &Joints, &Joints) -> Joints,
) -> State {
    let mut slope = |t: f64, at: &State| State {
        q: at.qd,
        qd: arm.forward_dynamics(&at.q, &at.qd, &torque_nm(t, &at.q, &at.qd)),
    };
    let along = |k: &State, h: f64| State { q: state.q + k.q * h, qd: state.qd + k.qd * h };
    let half = 0.5 * step_s;
    let k1 = slope(t_s, state);
    let k2 = slope(t_s + half, &along(&k1, half));
    let k3 = slope(t_s + half, &along(&k2, half));
    let k4 = slope(t_s + step_s, &along(&k3, step_s));
    let sixth = step_s / 6.0;
    State {
        q: state.q + (k1.q + (k2.q + k3.q) * 2.0 + k4.q) * sixth,
        qd: state.qd + (k1.qd + (k2.qd + k3.qd) * 2.0 + k4.qd) * sixth,
    }
}

/// The state `span_s` (s) after `start` at `t_s` (s), by equal steps that are not longer than
/// `step_s` (s), under the torques of [`rk4_step`]. It is `start` itself where the span or the step
/// is not positive and finite, or more than [`STEPS_MAX`] steps would be needed.
#[must_use]
pub fn free_motion(
    arm: &Dynamics,
    start: &State,
    t_s: f64,
    span_s: f64,
    step_s: f64,
    torque_nm: &mut impl FnMut(f64, &Joints, &Joints) -> Joints,
) -> State {
    // The factor keeps a span of exactly n steps from taking n + 1 steps because of rounding.
    let count = (span_s / step_s * (1.0 - 1e-12)).ceil();
    if !(span_s > 0.0 && step_s > 0.0 && count <= f64::from(STEPS_MAX)) {
        return *start;
    }
    let step = span_s / count;
    let mut state = *start;
    let mut done = 0.0;
    while done < count {
        state = rk4_step(arm, &state, t_s + done * step, step, torque_nm);
        done += 1.0;
    }
    state
}
