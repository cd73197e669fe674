//! Implicit steps: finger and pin move together so that momentum changes by the forces at the end
//! of the stage, found by Newton's method on twelve speeds. Two such stages make a step of second
//! order that damps what it cannot follow (Alexander 1977, SDIRK with `gamma = 1 - 1/sqrt(2)`: the
//! second stage starts from the first one carried on, and ends at the step's end).
//!
//! Bristles of friction and contact take part with the state that the end of the stage gives them:
//! sticking, sliding and lost contact are found together with the motion, by the consistent tangent
//! of each (Simo and Hughes 1998). A shortest step that is not resolved is taken by Euler's method
//! backwards instead, which takes energy whatever the forces are. Refuses more than a bounded
//! number of iterations: what has not settled then is said and taken.

mod calm;
mod newton;

use glam::{DMat3, DQuat, DVec3};
use taktil_mechanics::spatial::linear_and_angular;
use taktil_mechanics::{Joints, Pose};

use super::matrix::N;
use super::{Bench, Saved};
use crate::contact::Surface;
use crate::hash::Hash;
use crate::manipulator::{ArmState, RotorState, StagePredictor};
use crate::object::{Grip, Grips};
use crate::rolling::{Memory, Touching};
use crate::surroundings::Surroundings;
use newton::Held;

/// `1 - 1/sqrt(2)`
const GAMMA: f64 = 0.292_893_218_813_452_5;
/// Iterations of a stage at most.
const NEWTON_MAX: usize = 12;
/// A stage has settled when an iteration changes no point's speed by more than this (m/s), or when
/// the next one would not, as the last two shrank.
const SETTLED_M_S: f64 = 2e-8;
/// Largest change after which the next one is judged without being made (m/s): what the bristles
/// have not seen of the motion then is below 1e-10 m.
const CLOSE_M_S: f64 = 2e-7;
/// Factors stay in use, in both stages of a step, while each iteration changes less than this part
/// of the one before.
const SHRINKS: f64 = 0.05;
/// Twice the most with which a joint that nothing holds begins to fall (rad/s^2): over the length
/// of a stage the speed that an arm at rest may come to, on which its centrifugal and Coriolis
/// torques depend.
const FALLING_RAD_S2: f64 = 50.0;

/// What a stage starts from.
struct Base {
    arm: ArmState,
    memory: Option<Memory>,
    grips: Grips,
    /// Angular momentum of the pin (kg m^2/s), which its spin need not match.
    turning: DVec3,
}

/// What a step did.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Outcome {
    /// Difference to the embedded method of first order (m).
    pub(super) error_m: f64,
    pub(super) settled: bool,
    /// What the last iteration changed, after the contacts were evaluated (m/s).
    pub(super) unseen_m_s: f64,
    pub(super) iterations: u32,
}

type Speeds = [f64; N];

/// What one step leaves to the next: where its iteration begins and where inertia and gravity are
/// taken. It saves iterations; what it changes is below what an iteration may leave.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Habit {
    /// How the speeds changed (m/s^2, rad/s^2).
    slope: Speeds,
}

impl Habit {
    /// After something happened nothing goes on as before.
    pub(super) fn forget(&mut self) {
        *self = Habit::default();
    }

    pub(super) fn digest(&self, hash: &mut Hash) {
        hash.numbers(&self.slope);
    }
}

/// The time of a stage: how long it moves things (s), when it ends (s), and whether its step is the
/// shortest there is.
#[derive(Clone, Copy)]
struct Over {
    tau: f64,
    end_s: f64,
    last: bool,
}

/// The balance of momentum at some speeds.
#[derive(Default)]
struct Seen {
    /// What is left of it.
    rest: Speeds,
    /// How what the joints feel grows with their speeds (N m s/rad).
    slopes: [f64; 6],
    /// The surroundings of what may be touched.
    around: Option<Surroundings>,
    /// The contacts of a pin.
    touch: Option<Touching>,
    /// Objects are touched.
    pressed: bool,
}

fn part(u: &Speeds, from: usize) -> DVec3 {
    DVec3::new(u[from], u[from + 1], u[from + 2])
}

fn joints(u: &Speeds) -> Joints {
    Joints::new(u[0], u[1], u[2], u[3], u[4], u[5])
}

impl Bench {
    /// One step of `h` seconds from `start_s`; the state was saved by the caller.
    pub(super) fn implicit(&mut self, start: &Saved, start_s: f64, h: f64) -> Outcome {
        let first = Base::of(start);
        let tau = GAMMA * h;
        let u0 = speeds(&first.arm, first.memory.as_ref());
        let guess = core::array::from_fn(|i| u0[i] + tau * self.habit.slope[i]);
        let mut factors = None;
        let over = Over { tau, end_s: start_s + tau, last: false };
        let (last_1, n_1, u1) = self.stage(&first, guess, over, &mut factors);
        let second = first.carried_on(&self.save(), (1.0 - GAMMA) / GAMMA);
        let u_end: Speeds = core::array::from_fn(|i| u0[i] + (u1[i] - u0[i]) / GAMMA);
        let over = Over { end_s: start_s + h, ..over };
        let (last_2, n_2, u2) = self.stage(&second, u_end, over, &mut factors);
        // The embedded method takes the first stage's slopes for both.
        let off = core::array::from_fn(|i| u2[i] - u_end[i]);
        self.habit.slope = core::array::from_fn(|i| (u2[i] - u0[i]) / h);
        Outcome {
            error_m: h * self.way(&off),
            settled: last_1.is_finite() && last_2.is_finite(),
            unseen_m_s: last_2,
            iterations: n_1 + n_2,
        }
    }

    /// One step of first order, for what is not resolved by the shortest one of the above: its
    /// second stage carries the first one on as if nothing would end, and what a blow stopped is
    /// thrown back. Here all forces are those of the end, and whatever they are they take energy:
    /// this is Euler's method backwards, on contacts that are monotone in the speeds.
    pub(super) fn blow(&mut self, start: &Saved, start_s: f64, h: f64) -> Outcome {
        let base = Base::of(start);
        let u0 = speeds(&base.arm, base.memory.as_ref());
        let over = Over { tau: h, end_s: start_s + h, last: true };
        let (last, iterations, u) = self.stage(&base, u0, over, &mut None);
        let off = core::array::from_fn(|i| 0.5 * (u[i] - u0[i]));
        self.habit.forget();
        Outcome {
            error_m: h * self.way(&off),
            settled: last.is_finite(),
            unseen_m_s: last,
            iterations,
        }
    }

    /// Speed at which the quickest point of finger or pin moves (m/s).
    fn way(&self, u: &Speeds) -> f64 {
        let radius = self.rolling.as_ref().map_or(0.0, |r| r.pin.radius_m);
        let q = joints(u).amax() * self.finger.lever_m();
        q.max(part(u, 6).length()).max(radius * part(u, 9).length())
    }

    /// Moves everything from `base` over `tau` seconds by the forces at the end, `end_s`. Newton's
    /// `factors` may be those of a stage before; those that were used last are left there. Gives
    /// the last change (m/s), infinite when it did not settle, the iterations, and the speeds.
    fn stage(
        &mut self,
        base: &Base,
        guess: Speeds,
        Over { tau, end_s, last: finest }: Over,
        factors: &mut Option<Held>,
    ) -> (f64, u32, Speeds) {
        let mut u = guess;
        let mut predictor = self.finger.predict_stage(&base.arm, &joints(&u), tau, end_s);
        predictor.prescribed_twist += predictor.jacobian * predictor.guessed_speeds;
        for slot in u.iter_mut().take(6).skip(predictor.degrees_of_freedom) {
            *slot = 0.0;
        }
        let (_, table_axes, table) = self.table.at(end_s);
        let mut torques_at = joints(&u);
        let (mut last, mut count) = (f64::INFINITY, 0);
        let (mut before, mut seen) = (f64::INFINITY, Seen::default());
        for _ in 0..NEWTON_MAX {
            count += 1;
            self.evaluate_into(&mut seen, base, &predictor, &u, tau, (&table, &table_axes));
            let held = factors.get_or_insert_with(|| self.held(&predictor, &seen, tau));
            let mut change = held.factors.solve(&seen.rest);
            if self.way(&change) < CLOSE_M_S && self.softer(&seen, held) {
                // Stiffer than what is there by far they would call anything settled.
                *held = self.held(&predictor, &seen, tau);
                change = held.factors.solve(&seen.rest);
            }
            if !change.iter().all(|x| x.is_finite()) {
                break;
            }
            for (speed, change) in u.iter_mut().zip(&change) {
                *speed += change;
            }
            let now = joints(&u);
            let moved = (now - torques_at).amax();
            // The angles stay those that the stage guessed: only what goes with the square of the
            // speeds is seen anew.
            let turned = now.amax() + moved + FALLING_RAD_S2 * tau;
            if tau * moved * turned * self.finger.lever_m() > SETTLED_M_S {
                predictor.forces = self.finger.generalised_forces(&predictor, &now);
                torques_at = now;
            }
            let size = self.way(&change);
            let rate = size / before;
            if size < SETTLED_M_S || (size < CLOSE_M_S && size * rate < 0.1 * SETTLED_M_S) {
                last = size;
                break;
            }
            if rate > SHRINKS {
                *factors = None;
            }
            before = size;
        }
        if finest && !last.is_finite() {
            let (calm, more) =
                self.calm(base, &predictor, (&mut u, &guess), tau, (&table, &table_axes));
            (last, count, *factors) = (calm, count + more, None);
        }
        self.finish(base, &predictor, &u, tau);
        (last, count, u)
    }

    /// The state at the end of a stage.
    fn finish(&mut self, base: &Base, predictor: &StagePredictor, u: &Speeds, tau: f64) {
        let mut next = base.arm;
        for (i, speed) in u.iter().enumerate().take(predictor.degrees_of_freedom) {
            next.qd[i] = *speed;
            next.q[i] += tau * speed;
            let resisting = self.finger.resisting_torque(&base.arm, i, *speed, tau);
            next.bristle[i] = resisting.bristle_rad;
            if let Some(rotor) = resisting.rotor {
                (next.rotors.q[i], next.rotors.qd[i]) = (rotor.angle_rad, rotor.speed_rad_s);
            }
        }
        if predictor.degrees_of_freedom == 0 {
            (next.qd, next.rotors.qd) = (Joints::zeros(), Joints::zeros());
        }
        *self.finger.state_mut() = next;
        if let (Some(rolling), Some(memory)) = (&mut self.rolling, &base.memory) {
            rolling.pin = memory.pin.carried(part(u, 6), part(u, 9), tau);
        }
    }

    /// What is left of the balance of momentum at the speeds `u`, and what it depends on.
    fn evaluate(
        &mut self,
        base: &Base,
        predictor: &StagePredictor,
        u: &Speeds,
        tau: f64,
        table: (&Surface, &DMat3),
    ) -> Seen {
        let mut seen = Seen::default();
        self.evaluate_into(&mut seen, base, predictor, u, tau, table);
        seen
    }

    /// The same in the place of what was seen before, from the same base.
    fn evaluate_into(
        &mut self,
        seen: &mut Seen,
        base: &Base,
        predictor: &StagePredictor,
        u: &Speeds,
        tau: f64,
        (table, table_axes): (&Surface, &DMat3),
    ) {
        let rest = &mut seen.rest;
        let qd = joints(u);
        let swung = predictor.inertia * (qd - base.arm.qd) - tau * predictor.forces;
        for i in 0..predictor.degrees_of_freedom {
            let resisting = self.finger.resisting_torque(&base.arm, i, qd[i], tau);
            rest[i] = -swung[i] - tau * resisting.torque_nm;
            seen.slopes[i] = resisting.slope;
        }
        if self.objects.is_none() && self.rolling.is_none() {
            return;
        }
        let around = seen.around.insert(around(predictor, &qd, tau, table, table_axes));
        if let Some(objects) = &mut self.objects {
            objects.remember(&base.grips);
            self.work.contacts += 1;
            objects.touch(around, tau);
            seen.pressed = objects.touched() > 0 && predictor.degrees_of_freedom > 0;
            if seen.pressed {
                let pulled = predictor.jacobian.tr_mul(&objects.wrench(&around.pad));
                for i in 0..predictor.degrees_of_freedom {
                    rest[i] += tau * pulled[i];
                }
            }
        }
        let (Some(rolling), Some(memory)) = (&mut self.rolling, &base.memory) else { return };
        rolling.pin = memory.pin.carried(part(u, 6), part(u, 9), tau);
        self.work.contacts += 1;
        let touching = seen.touch.get_or_insert_default();
        rolling.touch_from((&memory.pad, &memory.bed), around, tau, touching);
        let (force, moment) = rolling.load(around);
        let pin = &rolling.pin;
        let linear = pin.mass_kg * (pin.velocity - memory.pin.velocity) - tau * force;
        let angular = pin.angular_momentum() - base.turning - tau * moment;
        rest[6..9].copy_from_slice(&(-linear).to_array());
        rest[9..12].copy_from_slice(&(-angular).to_array());
        if touching.finger.is_some() {
            let pulled = predictor.jacobian.tr_mul(&rolling.wrench(around.finger.origin));
            for i in 0..predictor.degrees_of_freedom {
                rest[i] += tau * pulled[i];
            }
        }
    }
}

impl Base {
    fn of(saved: &Saved) -> Base {
        let turning = saved.memory.as_ref().map_or(DVec3::ZERO, |m| m.pin.angular_momentum());
        Base { arm: saved.arm, memory: saved.memory, grips: saved.grips, turning }
    }

    /// This state carried on by `reach` times the way to `other`.
    fn carried_on(&self, other: &Saved, reach: f64) -> Base {
        let (a, b) = (&self.arm, &other.arm);
        let arm = ArmState {
            q: a.q + reach * (b.q - a.q),
            qd: a.qd + reach * (b.qd - a.qd),
            bristle: a.bristle + reach * (b.bristle - a.bristle),
            rotors: RotorState {
                q: a.rotors.q + reach * (b.rotors.q - a.rotors.q),
                qd: a.rotors.qd + reach * (b.rotors.qd - a.rotors.qd),
            },
        };
        let mix = |x: f64, y: f64| x + reach * (y - x);
        let grips = core::array::from_fn(|i| {
            let (a, b): (&Grip, &Grip) = (&self.grips[i], &other.grips[i]);
            let shear_n_m = mix(a.shear_n_m, b.shear_n_m).max(0.0);
            Grip { brush: a.brush + reach * (b.brush - a.brush), shear_n_m }
        });
        let (Some(a), Some(b)) = (&self.memory, &other.memory) else {
            return Base { arm, memory: None, grips, turning: DVec3::ZERO };
        };
        let mix3 = |x: DVec3, y: DVec3| x + reach * (y - x);
        let mut memory = *a;
        let pin = &mut memory.pin;
        pin.position = mix3(a.pin.position, b.pin.position);
        pin.velocity = mix3(a.pin.velocity, b.pin.velocity);
        pin.spin = mix3(a.pin.spin, b.pin.spin);
        pin.roll_rad = mix(a.pin.roll_rad, b.pin.roll_rad);
        let (from, to) = (a.pin.orientation, b.pin.orientation);
        let near = if from.dot(to) < 0.0 { -to } else { to };
        pin.orientation = DQuat::normalize(from + (near - from) * reach);
        memory.pad = a.pad.carried_on(&b.pad, reach);
        memory.bed = a.bed.carried_on(&b.bed, reach);
        let turning = mix3(self.turning, b.pin.angular_momentum());
        Base { arm, memory: Some(memory), grips, turning }
    }
}

fn speeds(arm: &ArmState, memory: Option<&Memory>) -> Speeds {
    let (velocity, spin) =
        memory.map_or((DVec3::ZERO, DVec3::ZERO), |m| (m.pin.velocity, m.pin.spin));
    let mut u = [0.0; N];
    u[..6].copy_from_slice(arm.qd.as_slice());
    u[6..9].copy_from_slice(&velocity.to_array());
    u[9..].copy_from_slice(&spin.to_array());
    u
}

/// The pin's surroundings when the stage ends at the speeds `qd`.
fn around(
    predictor: &StagePredictor,
    qd: &Joints,
    tau: f64,
    table: &Surface,
    axes: &DMat3,
) -> Surroundings {
    let off = predictor.jacobian * (qd - predictor.guessed_speeds);
    let (shift, turn) = split(&(tau * off));
    // Cayley's rotation: exact in length, of third order in the angle.
    let half = 0.5 * turn;
    let (square, twice) = (half.length_squared(), 2.0 / (1.0 + half.length_squared()));
    let turned = |v: DVec3| v + twice * (half.cross(v) + half.cross(half.cross(v)));
    let r = &predictor.pose.rotation;
    let rotation = if square > 0.0 {
        DMat3::from_cols(turned(r.x_axis), turned(r.y_axis), turned(r.z_axis))
    } else {
        *r
    };
    let pad = Pose::new(rotation, predictor.pose.translation + shift);
    let finger = Surface::of_pad(&pad, &(predictor.prescribed_twist + off));
    Surroundings { pad, finger, table: *table, table_axes: *axes }
}

#[cfg(test)]
mod tests {
    use taktil_mechanics::puma260::dynamics::Dynamics;

    use super::*;

    #[test]
    fn a_joint_that_nothing_holds_falls_half_as_fast_as_is_reckoned_with() {
        let (arm, mut most) = (Dynamics::reference(), 0.0_f64);
        let angle = |i: u32| core::f64::consts::PI * f64::from(i) / 6.0;
        for pose in 0..12_u32.pow(4) {
            let [a, b, c, d] = [1, 12, 144, 1728].map(|per| angle(pose / per % 12));
            let q = Joints::new(0.0, a, b, c, d, 0.0);
            let inertia = arm.mass_matrix(&q).cholesky().unwrap();
            most = most.max(inertia.solve(&arm.gravity_torque(&q)).amax());
        }
        assert!((0.4 * FALLING_RAD_S2..0.5 * FALLING_RAD_S2).contains(&most), "{most}");
    }
}
