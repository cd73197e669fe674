//! Free motion of the arm under given torques, by the classical fourth-order method of Runge and
//! Kutta with fixed steps. Refuses adaptive steps: the same call makes the same bits.

use super::Dynamics;
use crate::spatial::Joints;

/// Joint angles (rad) and speeds (rad/s).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Joint angles (rad).
    pub q: Joints,
    /// Joint speeds (rad/s).
    pub qd: Joints,
}

/// Most steps that one call of [`free_motion`] takes.
pub const STEPS_MAX: u32 = 10_000_000;

/// One step of `step_s` from `state` at `t_s`. `torque_nm(t, q, qd)` is everything that acts on
/// the joints beside gravity, friction with its sign included; it is asked four times.
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

/// The state after `span_s`, in equal steps none longer than `step_s`. Spans and steps that are
/// not positive and finite, and more than [`MAX_STEPS`] steps, leave the state as it is.
#[must_use]
pub fn free_motion(
    arm: &Dynamics,
    start: &State,
    t_s: f64,
    span_s: f64,
    step_s: f64,
    torque_nm: &mut impl FnMut(f64, &Joints, &Joints) -> Joints,
) -> State {
    // A hair of slack: a span of exactly n steps must not take n + 1 for its rounding.
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
