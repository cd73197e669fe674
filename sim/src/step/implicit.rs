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
use crate::finger::{Ahead, Rotors, Swing};
use crate::hash::Hash;
use crate::object::{Grip, Grips};
use crate::rolling::{Around, Memory, Touching};
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
/// Distance at which turning counts as moving (m).
const ARM_M: f64 = 0.1;

/// What a stage starts from.
struct Base {
    swing: Swing,
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
    around: Option<Around>,
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
        let u0 = speeds(&first.swing, first.memory.as_ref());
        let guess = core::array::from_fn(|i| u0[i] + tau * self.habit.slope[i]);
        let mut factors = None;
        let over = Over { tau, end_s: start_s + tau, last: false };
        let (last_1, n_1, u1) = self.stage(&first, guess, over, &mut factors);
        let second = first.carried_on(&self.save(), (1.0 - GAMMA) / GAMMA);
        let ahead: Speeds = core::array::from_fn(|i| u0[i] + (u1[i] - u0[i]) / GAMMA);
        let over = Over { end_s: start_s + h, ..over };
        let (last_2, n_2, u2) = self.stage(&second, ahead, over, &mut factors);
        // The embedded method takes the first stage's slopes for both.
        let off = core::array::from_fn(|i| u2[i] - ahead[i]);
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
        let u0 = speeds(&base.swing, base.memory.as_ref());
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
        let mut ahead = self.finger.ahead(&base.swing, &joints(&u), tau, end_s);
        ahead.carried += ahead.jacobian * ahead.guess;
        for slot in u.iter_mut().take(6).skip(ahead.degrees) {
            *slot = 0.0;
        }
        let (_, table_axes, table) = self.table.at(end_s);
        let mut torques_at = joints(&u);
        let (mut last, mut count) = (f64::INFINITY, 0);
        let (mut before, mut seen) = (f64::INFINITY, Seen::default());
        for _ in 0..NEWTON_MAX {
            count += 1;
            self.evaluate_into(&mut seen, base, &ahead, &u, tau, (&table, &table_axes));
            let held = factors.get_or_insert_with(|| self.held(&ahead, &seen, tau));
            let mut change = held.factors.solve(&seen.rest);
            if self.way(&change) < CLOSE_M_S && self.softer(&seen, held) {
                // Stiffer than what is there by far they would call anything settled.
                *held = self.held(&ahead, &seen, tau);
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
                ahead.push = self.finger.push(&ahead, &now);
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
                self.calm(base, &ahead, (&mut u, &guess), tau, (&table, &table_axes));
            (last, count, *factors) = (calm, count + more, None);
        }
        self.finish(base, &ahead, &u, tau);
        (last, count, u)
    }

    /// The state at the end of a stage.
    fn finish(&mut self, base: &Base, ahead: &Ahead, u: &Speeds, tau: f64) {
        let mut next = base.swing;
        for (i, speed) in u.iter().enumerate().take(ahead.degrees) {
            next.qd[i] = *speed;
            next.q[i] += tau * speed;
            let rub = self.finger.rub(&base.swing, i, *speed, tau);
            next.bristle[i] = rub.bristle_rad;
            if let Some((angle, speed)) = rub.motor {
                (next.motor.q[i], next.motor.qd[i]) = (angle, speed);
            }
        }
        if ahead.degrees == 0 {
            (next.qd, next.motor.qd) = (Joints::zeros(), Joints::zeros());
        }
        *self.finger.swing_mut() = next;
        if let (Some(rolling), Some(memory)) = (&mut self.rolling, &base.memory) {
            rolling.pin = memory.pin.carried(part(u, 6), part(u, 9), tau);
        }
    }

    /// What is left of the balance of momentum at the speeds `u`, and what it depends on.
    fn evaluate(
        &mut self,
        base: &Base,
        ahead: &Ahead,
        u: &Speeds,
        tau: f64,
        table: (&Surface, &DMat3),
    ) -> Seen {
        let mut seen = Seen::default();
        self.evaluate_into(&mut seen, base, ahead, u, tau, table);
        seen
    }

    /// The same in the place of what was seen before, from the same base.
    fn evaluate_into(
        &mut self,
        seen: &mut Seen,
        base: &Base,
        ahead: &Ahead,
        u: &Speeds,
        tau: f64,
        (table, table_axes): (&Surface, &DMat3),
    ) {
        let rest = &mut seen.rest;
        let qd = joints(u);
        let swung = ahead.inertia * (qd - base.swing.qd) - tau * ahead.push;
        for i in 0..ahead.degrees {
            let rub = self.finger.rub(&base.swing, i, qd[i], tau);
            rest[i] = -swung[i] - tau * rub.torque_nm;
            seen.slopes[i] = rub.slope;
        }
        if self.objects.is_none() && self.rolling.is_none() {
            return;
        }
        let around = seen.around.insert(around(ahead, &qd, tau, table, table_axes));
        if let Some(objects) = &mut self.objects {
            objects.remember(&base.grips);
            self.work.contacts += 1;
            objects.touch(around, tau);
            seen.pressed = objects.touched() > 0 && ahead.degrees > 0;
            if seen.pressed {
                let pulled = ahead.jacobian.tr_mul(&objects.wrench(&around.pad));
                for i in 0..ahead.degrees {
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
            let pulled = ahead.jacobian.tr_mul(&rolling.wrench(around.finger.origin));
            for i in 0..ahead.degrees {
                rest[i] += tau * pulled[i];
            }
        }
    }
}

impl Base {
    fn of(saved: &Saved) -> Base {
        let turning = saved.memory.as_ref().map_or(DVec3::ZERO, |m| m.pin.angular_momentum());
        Base { swing: saved.swing, memory: saved.memory, grips: saved.grips, turning }
    }

    /// This state carried on by `reach` times the way to `other`.
    fn carried_on(&self, other: &Saved, reach: f64) -> Base {
        let (a, b) = (&self.swing, &other.swing);
        let swing = Swing {
            q: a.q + reach * (b.q - a.q),
            qd: a.qd + reach * (b.qd - a.qd),
            bristle: a.bristle + reach * (b.bristle - a.bristle),
            motor: Rotors {
                q: a.motor.q + reach * (b.motor.q - a.motor.q),
                qd: a.motor.qd + reach * (b.motor.qd - a.motor.qd),
            },
        };
        let mix = |x: f64, y: f64| x + reach * (y - x);
        let grips = core::array::from_fn(|i| {
            let (a, b): (&Grip, &Grip) = (&self.grips[i], &other.grips[i]);
            let shear_n_m = mix(a.shear_n_m, b.shear_n_m).max(0.0);
            Grip { brush: a.brush + reach * (b.brush - a.brush), shear_n_m }
        });
        let (Some(a), Some(b)) = (&self.memory, &other.memory) else {
            return Base { swing, memory: None, grips, turning: DVec3::ZERO };
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
        Base { swing, memory: Some(memory), grips, turning }
    }
}

fn speeds(swing: &Swing, memory: Option<&Memory>) -> Speeds {
    let (velocity, spin) =
        memory.map_or((DVec3::ZERO, DVec3::ZERO), |m| (m.pin.velocity, m.pin.spin));
    let mut u = [0.0; N];
    u[..6].copy_from_slice(swing.qd.as_slice());
    u[6..9].copy_from_slice(&velocity.to_array());
    u[9..].copy_from_slice(&spin.to_array());
    u
}

/// The pin's surroundings when the stage ends at the speeds `qd`.
fn around(ahead: &Ahead, qd: &Joints, tau: f64, table: &Surface, axes: &DMat3) -> Around {
    let off = ahead.jacobian * (qd - ahead.guess);
    let (shift, turn) = linear_and_angular(&(tau * off));
    // Cayley's rotation: exact in length, of third order in the angle.
    let half = 0.5 * turn;
    let (square, twice) = (half.length_squared(), 2.0 / (1.0 + half.length_squared()));
    let turned = |v: DVec3| v + twice * (half.cross(v) + half.cross(half.cross(v)));
    let r = &ahead.pose.rotation;
    let rotation = if square > 0.0 {
        DMat3::from_cols(turned(r.x_axis), turned(r.y_axis), turned(r.z_axis))
    } else {
        *r
    };
    let pad = Pose::new(rotation, ahead.pose.translation + shift);
    let finger = Surface::of_pad(&pad, &(ahead.carried + off));
    Around { pad, finger, table: *table, table_axes: *axes }
}

impl crate::finger::Finger {
    /// How far a unit of a coordinate moves the finger at most (m), roughly.
    fn lever_m(&self) -> f64 {
        match self {
            crate::finger::Finger::Arm(_) => 5.0 * ARM_M,
            crate::finger::Finger::Carriage(_) | crate::finger::Finger::Chained(_) => 1.0,
        }
    }
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
