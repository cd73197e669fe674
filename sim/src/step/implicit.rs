//! Implicit steps: finger and pin move together so that momentum changes by the forces at the end
//! of the stage, which Newton's method finds on the speeds of both. Two such stages make a step of
//! second order that damps what it cannot follow (Alexander 1977, SDIRK with `gamma = 1 -
//! 1/sqrt(2)`: the second stage starts from an extrapolation of the first one and ends at the
//! step's end).
//!
//! Bristles of friction and contact take part with the state that the end of the stage gives them:
//! sticking, sliding and lost contact are found together with the motion, by the consistent tangent
//! of each (Simo and Hughes 1998). A shortest step that is not resolved is taken by the backward
//! Euler method instead, which dissipates energy whatever the forces are. The number of iterations
//! is bounded: a step that has not converged by then is taken and counted.

mod damped;
mod newton;
mod start;

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::{JointVector, linear_and_angular};

use super::{Plant, SavedState};
use crate::contact::Surface;
use crate::hash::Hash;
use crate::manipulator::StagePredictor;
use crate::rolling::PinContacts;
use crate::surroundings::Surroundings;
use newton::FactoredMatrix;
pub(super) use start::StageRoom;
use start::StageStart;

/// Coefficient of the two-stage method: `1 - 1/sqrt(2)`.
const SDIRK_GAMMA: f64 = 0.292_893_218_813_452_5;
/// Newton iterations of a stage at most.
const NEWTON_STEPS_MAX: usize = 12;
/// Change of every point's speed below which a stage has converged (m/s). A stage has also
/// converged when the ratio of the last two changes predicts that the next change is below it.
const SPEED_TOLERANCE_M_S: f64 = 2e-8;
/// Largest change of speed after which the next change is predicted instead of computed (m/s): the
/// bristles then lack less than 1e-10 m of the motion.
const PREDICTED_TOLERANCE_M_S: f64 = 2e-7;
/// Share of the tolerance that a predicted change has to be below, because it is only predicted.
const PREDICTION_MARGIN: f64 = 0.1;
/// Ratio of successive changes below which a factorised matrix is used again, in both stages of a
/// step.
const CONTRACTION_MAX: f64 = 0.05;
/// Twice the largest acceleration of a joint that falls freely (rad/s^2). Times the length of a
/// stage it bounds the speed that an arm at rest may reach, on which its centrifugal and Coriolis
/// torques depend.
const FREE_ACCELERATION_RAD_S2: f64 = 50.0;

/// Result of a step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct StepOutcome {
    /// Difference of place to the embedded method of first order (m).
    pub(super) error_m: f64,
    pub(super) has_converged: bool,
    /// Change of speed by the last iteration, after the contacts were evaluated (m/s).
    pub(super) last_change_m_s: f64,
    pub(super) iterations: u32,
}

/// What a step leaves for the next step: a guess of the speeds at its end. The guess saves
/// iterations; it changes the result by less than the tolerance of the iteration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WarmStart<const U: usize> {
    /// Acceleration over the last step (m/s^2, rad/s^2).
    acceleration: [f64; U],
}

impl<const U: usize> Default for WarmStart<U> {
    fn default() -> WarmStart<U> {
        WarmStart { acceleration: [0.0; U] }
    }
}

impl<const U: usize> WarmStart<U> {
    /// Discards the guess; after an impact or a released contact the past predicts nothing.
    pub(super) fn clear(&mut self) {
        *self = WarmStart::default();
    }

    pub(super) fn digest(&self, hash: &mut Hash) {
        hash.numbers(&self.acceleration);
    }
}

/// The time of a stage: its length (s), the instant of its end (s), and whether its step is the
/// shortest one that is allowed.
#[derive(Clone, Copy)]
struct StageTime {
    tau: f64,
    end_s: f64,
    is_shortest: bool,
}

/// A stage as its equations see it.
struct Stage<'a, const J: usize> {
    start: &'a StageStart<J>,
    /// The finger at the end of the stage.
    predictor: StagePredictor<J>,
    /// Length of the stage (s).
    tau: f64,
    /// The table at the end of the stage.
    table: Surface,
    table_axes: DMat3,
}

/// Result of a stage.
struct StageResult<const U: usize> {
    /// Change of speed by the last iteration (m/s); infinite when the iteration did not converge.
    last_change_m_s: f64,
    iterations: u32,
    speeds: [f64; U],
}

/// The residual of the balance of momentum at some speeds, and what it was computed from.
struct Residual<const J: usize, const U: usize> {
    /// The residual itself (N s, N m s).
    momentum: [f64; U],
    /// Derivatives of the joints' resisting torques with respect to their speeds (N m s/rad).
    slopes: [f64; J],
    /// The places of finger and table.
    surroundings: Option<Surroundings>,
    /// The contact lines of the pin.
    contacts: Option<PinContacts>,
    /// Whether the finger touches an object.
    touches_objects: bool,
}

impl<const J: usize, const U: usize> Default for Residual<J, U> {
    fn default() -> Residual<J, U> {
        Residual {
            momentum: [0.0; U],
            slopes: [0.0; J],
            surroundings: None,
            contacts: None,
            touches_objects: false,
        }
    }
}

/// Whether a change of speed (m/s) is below the tolerance, or the next change will be, as `rate` is
/// the ratio of the last two.
fn is_converged(change_m_s: f64, rate: f64) -> bool {
    change_m_s < SPEED_TOLERANCE_M_S
        || (change_m_s < PREDICTED_TOLERANCE_M_S
            && change_m_s * rate < PREDICTION_MARGIN * SPEED_TOLERANCE_M_S)
}

/// Three components of a vector of speeds.
fn part<const U: usize>(u: &[f64; U], from: usize) -> DVec3 {
    DVec3::new(u[from], u[from + 1], u[from + 2])
}

/// The finger's part of a vector of speeds.
fn joints<const J: usize, const U: usize>(u: &[f64; U]) -> JointVector<J> {
    JointVector::from_fn(|i, _| u[i])
}

impl<const J: usize, const U: usize> Plant<J, U> {
    /// One step of `h` seconds from `start_s` by the two-stage method; the caller saved the state.
    pub(super) fn step_sdirk(
        &mut self,
        start: &SavedState<J>,
        room: &mut StageRoom<J>,
        start_s: f64,
        h: f64,
    ) -> StepOutcome {
        let StageRoom { first, reached, second } = room;
        first.begin_at(start);
        let tau = SDIRK_GAMMA * h;
        let u0: [f64; U] = speeds(&first.state);
        let guess = core::array::from_fn(|i| u0[i] + tau * self.warm_start.acceleration[i]);
        let mut factors = None;
        let time = StageTime { tau, end_s: start_s + tau, is_shortest: false };
        let first_result = self.solve_stage(first, guess, time, &mut factors);
        let u1 = first_result.speeds;
        self.save(reached);
        second.extrapolate(first, reached, (1.0 - SDIRK_GAMMA) / SDIRK_GAMMA);
        let u_end: [f64; U] = core::array::from_fn(|i| u0[i] + (u1[i] - u0[i]) / SDIRK_GAMMA);
        let time = StageTime { end_s: start_s + h, ..time };
        let second_result = self.solve_stage(second, u_end, time, &mut factors);
        let u2 = second_result.speeds;
        // The embedded method uses the acceleration of the first stage for the whole step.
        let difference = core::array::from_fn(|i| u2[i] - u_end[i]);
        self.warm_start.acceleration = core::array::from_fn(|i| (u2[i] - u0[i]) / h);
        let last_change_m_s = second_result.last_change_m_s;
        StepOutcome {
            error_m: h * self.largest_speed(&difference),
            has_converged: first_result.last_change_m_s.is_finite() && last_change_m_s.is_finite(),
            last_change_m_s,
            iterations: first_result.iterations + second_result.iterations,
        }
    }

    /// One step of the backward Euler method, for a shortest step that the two-stage method did not
    /// resolve. The second stage of that method extrapolates the first one as if the motion went
    /// on, so that an impact that stopped a body throws it back. Here all forces are those of the
    /// end of the step, and they dissipate energy because the contacts are monotone in the speeds.
    pub(super) fn step_backward_euler(
        &mut self,
        start: &SavedState<J>,
        room: &mut StageRoom<J>,
        start_s: f64,
        h: f64,
    ) -> StepOutcome {
        let base = &mut room.first;
        base.begin_at(start);
        let u0: [f64; U] = speeds(&base.state);
        let time = StageTime { tau: h, end_s: start_s + h, is_shortest: true };
        let StageResult { last_change_m_s, iterations, speeds: u } =
            self.solve_stage(base, u0, time, &mut None);
        let difference = core::array::from_fn(|i| 0.5 * (u[i] - u0[i]));
        self.warm_start.clear();
        StepOutcome {
            error_m: h * self.largest_speed(&difference),
            has_converged: last_change_m_s.is_finite(),
            last_change_m_s,
            iterations,
        }
    }

    /// Largest speed of any point of finger or pin (m/s).
    fn largest_speed(&self, u: &[f64; U]) -> f64 {
        let radius = self.rolling.as_ref().map_or(0.0, |r| r.pin.radius_m);
        let q = joints::<J, U>(u).amax() * self.finger.lever_m();
        q.max(part(u, J).length()).max(radius * part(u, J + 3).length())
    }

    /// Moves all bodies from `base` over one stage by the forces at its end. `factors` may be those
    /// of an earlier stage; the factors that were used last are left there.
    fn solve_stage(
        &mut self,
        base: &StageStart<J>,
        guess: [f64; U],
        StageTime { tau, end_s, is_shortest }: StageTime,
        factors: &mut Option<FactoredMatrix<U>>,
    ) -> StageResult<U> {
        let mut u = guess;
        let mut predictor = self.finger.predict_stage(&base.state.arm, &joints(&u), tau, end_s);
        predictor.prescribed_twist += predictor.jacobian * predictor.guessed_speeds;
        for slot in u.iter_mut().take(J).skip(predictor.degrees_of_freedom) {
            *slot = 0.0;
        }
        let (_, table_axes, table) = self.table.at(end_s);
        let mut stage = Stage { start: base, predictor, tau, table, table_axes };
        // Joint speeds at which the generalised forces were evaluated.
        let mut force_speeds: JointVector<J> = joints(&u);
        let (mut last_change_m_s, mut iterations) = (f64::INFINITY, 0);
        let (mut before, mut residual) = (f64::INFINITY, Residual::default());
        for _ in 0..NEWTON_STEPS_MAX {
            iterations += 1;
            self.evaluate_into(&mut residual, &stage, &u);
            let matrix = factors.get_or_insert_with(|| self.factorise(&stage, &residual));
            let mut change = matrix.factors.solve(&residual.momentum);
            if self.largest_speed(&change) < PREDICTED_TOLERANCE_M_S
                && self.has_softened(&residual, matrix)
            {
                // A matrix far stiffer than the contacts would call any speeds converged.
                *matrix = self.factorise(&stage, &residual);
                change = matrix.factors.solve(&residual.momentum);
            }
            // A matrix that is not positive definite gives no direction to go on with.
            if !change.iter().all(|x| x.is_finite()) {
                break;
            }
            for (speed, change) in u.iter_mut().zip(&change) {
                *speed += change;
            }
            let now: JointVector<J> = joints(&u);
            let moved = (now - force_speeds).amax();
            // The joint angles stay at the predicted ones; only the torques that depend on the
            // square of the speeds are evaluated anew.
            let fastest = now.amax() + moved + FREE_ACCELERATION_RAD_S2 * tau;
            if tau * moved * fastest * self.finger.lever_m() > SPEED_TOLERANCE_M_S {
                let state = &base.state.arm;
                stage.predictor.forces =
                    self.finger.generalised_forces(&stage.predictor, state, &now, tau);
                force_speeds = now;
            }
            let size = self.largest_speed(&change);
            let rate = size / before;
            if is_converged(size, rate) {
                last_change_m_s = size;
                break;
            }
            // A slow contraction means that the factors belong to other contacts.
            if rate > CONTRACTION_MAX {
                *factors = None;
            }
            before = size;
        }
        if is_shortest && !last_change_m_s.is_finite() {
            let damped = self.solve_damped(&stage, u, &guess);
            (last_change_m_s, u) = (damped.last_change_m_s, damped.speeds);
            iterations += damped.iterations;
            *factors = None;
        }
        self.take_stage(&stage, &u);
        StageResult { last_change_m_s, iterations, speeds: u }
    }

    /// Writes the state at the end of a stage.
    fn take_stage(&mut self, stage: &Stage<'_, J>, u: &[f64; U]) {
        let Stage { start: base, predictor, tau, .. } = stage;
        let tau = *tau;
        let mut next = base.state.arm;
        for (i, speed) in u.iter().enumerate().take(predictor.degrees_of_freedom) {
            next.qd[i] = *speed;
            next.q[i] += tau * speed;
            let resisting = self.finger.resisting_torque(&base.state.arm, i, *speed, tau);
            next.bristle[i] = resisting.bristle_rad;
            if let Some(rotor) = resisting.rotor {
                (next.rotors.q[i], next.rotors.qd[i]) = (rotor.angle_rad, rotor.speed_rad_s);
            }
        }
        if predictor.degrees_of_freedom == 0 {
            (next.qd, next.rotors.qd) = (JointVector::zeros(), JointVector::zeros());
        }
        *self.finger.state_mut() = next;
        if let (Some(rolling), Some(start)) = (&mut self.rolling, &base.state.pin) {
            rolling.pin = start.pin.moved(part(u, J), part(u, J + 3), tau);
        }
    }

    /// The residual of the balance of momentum at the speeds `u`.
    fn evaluate(&mut self, stage: &Stage<'_, J>, u: &[f64; U]) -> Residual<J, U> {
        let mut residual = Residual::default();
        self.evaluate_into(&mut residual, stage, u);
        residual
    }

    /// Evaluates the residual at the speeds `u` in place of an earlier residual of the same stage.
    fn evaluate_into(&mut self, residual: &mut Residual<J, U>, stage: &Stage<'_, J>, u: &[f64; U]) {
        let Stage { start: base, predictor, tau, table, table_axes } = stage;
        let tau = *tau;
        let momentum = &mut residual.momentum;
        let qd: JointVector<J> = joints(u);
        let arm_momentum = predictor.inertia * (qd - base.state.arm.qd) - predictor.forces * tau;
        for i in 0..predictor.degrees_of_freedom {
            let resisting = self.finger.resisting_torque(&base.state.arm, i, qd[i], tau);
            momentum[i] = -arm_momentum[i] - tau * resisting.torque_nm;
            residual.slopes[i] = resisting.slope;
        }
        if self.objects.is_none() && self.rolling.is_none() {
            return;
        }
        let surroundings =
            residual.surroundings.insert(surroundings(predictor, &qd, tau, table, table_axes));
        if let Some(objects) = &mut self.objects {
            objects.restore(&base.state.bristles);
            self.statistics.contact_evaluations += 1;
            objects.evaluate(surroundings, tau);
            residual.touches_objects =
                objects.contact_bits() > 0 && predictor.degrees_of_freedom > 0;
            if residual.touches_objects {
                let pulled = predictor.jacobian.tr_mul(&objects.wrench(&surroundings.pad));
                for i in 0..predictor.degrees_of_freedom {
                    momentum[i] += tau * pulled[i];
                }
            }
        }
        let (Some(rolling), Some(start)) = (&mut self.rolling, &base.state.pin) else { return };
        rolling.pin = start.pin.moved(part(u, J), part(u, J + 3), tau);
        self.statistics.contact_evaluations += 1;
        let contacts = residual.contacts.get_or_insert_default();
        rolling.evaluate_from(&start.pad, &start.support, surroundings, tau, contacts);
        let (force, moment) = rolling.net_load(surroundings);
        let pin = &rolling.pin;
        let linear = pin.mass_kg * (pin.velocity - start.pin.velocity) - tau * force;
        let angular = pin.angular_momentum() - base.angular_momentum - tau * moment;
        momentum[J..J + 3].copy_from_slice(&(-linear).to_array());
        momentum[J + 3..].copy_from_slice(&(-angular).to_array());
        if contacts.finger.is_some() {
            let pulled = predictor.jacobian.tr_mul(&rolling.wrench(surroundings.finger.origin));
            for i in 0..predictor.degrees_of_freedom {
                momentum[i] += tau * pulled[i];
            }
        }
    }
}

/// The speeds of finger and pin as one vector.
fn speeds<const J: usize, const U: usize>(state: &SavedState<J>) -> [f64; U] {
    let (velocity, spin) = state
        .pin
        .as_ref()
        .map_or((DVec3::ZERO, DVec3::ZERO), |state| (state.pin.velocity, state.pin.spin));
    let mut u = [0.0; U];
    u[..J].copy_from_slice(state.arm.qd.as_slice());
    u[J..J + 3].copy_from_slice(&velocity.to_array());
    u[J + 3..].copy_from_slice(&spin.to_array());
    u
}

/// The places and motions of finger and table when the stage ends at the speeds `qd`.
fn surroundings<const J: usize>(
    predictor: &StagePredictor<J>,
    qd: &JointVector<J>,
    tau: f64,
    table: &Surface,
    axes: &DMat3,
) -> Surroundings {
    let correction = predictor.jacobian * (qd - predictor.guessed_speeds);
    let (shift, turn) = linear_and_angular(&(correction * tau));
    // Cayley's rotation keeps lengths exactly and has an error of third order in the angle.
    let half = 0.5 * turn;
    let (square, twice) = (half.length_squared(), 2.0 / (1.0 + half.length_squared()));
    let rotated = |v: DVec3| v + twice * (half.cross(v) + half.cross(half.cross(v)));
    let r = &predictor.pose.rotation;
    let rotation = if square > 0.0 {
        DMat3::from_cols(rotated(r.x_axis), rotated(r.y_axis), rotated(r.z_axis))
    } else {
        *r
    };
    let pad = Pose::new(rotation, predictor.pose.translation + shift);
    let finger = Surface::of_pad(&pad, &(predictor.prescribed_twist + correction));
    Surroundings { pad, finger, table: *table, table_axes: *axes }
}

#[cfg(test)]
mod tests;
