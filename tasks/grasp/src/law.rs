//! The law of a grasp: fingers close until each of them touches, then hold the object between them,
//! move, turn or lift it, and let it go. Pure: time, joints, torques and touch arrive as arguments.
//!
//! ```text
//!   CLOSING: joints along `closing` until a finger is touched; it waits for the others
//!      │ every finger touched
//!      v
//!   HOLDING: goal of fingertip i = reference_i + plan + correction + squeeze * normal_i
//! ```
//!
//! Grip and place are separate: *squeeze* moves all fingertips inwards alike until the mean load by
//! touch is the grip that is wanted (an integral law on the internal force); *correction* moves all
//! of them as one rigid body until the measured fingertips are, in their mean, where the plan has
//! them (an integral law on the six coordinates of the object). The grip that is wanted is what the
//! friction cones ask for, within bounds: each finger's load is to be its tangential force over the
//! coefficient, times a safety factor.
//!
//! Source: M. T. Mason and J. K. Salisbury, *Robot Hands and the Mechanics of Manipulation*, MIT
//! Press 1985, for grip matrix and internal forces; M. R. Cutkosky and I. Kao, IEEE Transactions on
//! Robotics and Automation 5, 1989, for the compliance of a grasp.

mod plan;

pub use plan::{PalmPlan, Plan};

use glam::DVec3;
use nalgebra::Vector3;
use taktil_mechanics::Pose;
use taktil_mechanics::arm::{Arm, ArmDynamics, PathFollower};
use taktil_mechanics::hand::{FINGER_JOINTS, Fingertip, Hand, PalmFollower};
use taktil_mechanics::spatial::{JointVector, rotation_from_vector};
use taktil_rtcore::{Fold, StateHash};

use crate::touch::{ContactForce, Touch, contact_force, joint_step};

/// Largest correction of the object's place (m) and of its turn (rad).
const SHIFT_MAX_M: f64 = 0.015;
const TILT_MAX_RAD: f64 = 0.3;
/// Distance from the ends of their ranges at which joints stop (rad): half a degree.
const LIMIT_MARGIN_RAD: f64 = 0.0087;
/// Share of the joints' largest speed that the law uses: `setpoint` bears one and a half times it.
const SPEED_SHARE: f64 = 1.0;

/// Smallest load of a finger relative to the weakest grip: below it the hand grips harder, lest
/// the finger lose the object.
const LOAD_SHARE_MIN: f64 = 0.5;

/// Tangential force of a finger that counts for its grip at most, relative to what friction bears
/// at its load: a finger that meets the object is braked by its motors with nothing to carry.
const CARRIED_MAX: f64 = 1.5;
/// Largest correction of an arm's joint (rad): half a degree. Friction that stops a servo farther
/// from its goal is a fault of the gears.
const ARM_CORRECTION_MAX_RAD: f64 = 0.0087;
/// Error of an arm's joint that is left alone (rad): a few counts of an encoder, which an integral
/// term would chase for ever; 0.05 mm at a lever of 1 m.
const ARM_DEAD_ZONE_RAD: f64 = 5e-5;

/// Fastest growth of the grip (N/s).
const GRIP_RISE_N_S: f64 = 20.0;

/// What the grasp does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Phase {
    /// Some finger has not touched yet.
    #[default]
    Closing = 1,
    /// The object is held.
    Holding = 2,
    /// The fingers let it go.
    Opening = 3,
}

/// Gains and bounds of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning<const F: usize> {
    /// Speeds of a finger's joints while it closes (rad/s).
    pub closing_rad_s: Vector3<f64>,
    /// Load from which on a finger counts as touched (N).
    pub touched_n: f64,
    /// Weakest and strongest grip (N): the load of a finger with a share of 1.
    pub grip_min_n: f64,
    /// Strongest grip (N).
    pub grip_max_n: f64,
    /// Load of each finger relative to the grip, so that the loads balance each other.
    pub share: [f64; F],
    /// Coefficient of friction that the law believes in.
    pub friction: f64,
    /// How much stronger the grip is than the friction cone needs.
    pub safety: f64,
    /// Speed of the squeeze for each newton that lacks (m/(N s)).
    pub squeeze_m_n_s: f64,
    /// Largest squeeze (m).
    pub squeeze_max_m: f64,
    /// Rate of the correction of the object's place (1/s).
    pub correction_per_s: f64,
    /// Rate at which the arm's joints are brought to the end of the palm's path (1/s).
    pub lift_correction_per_s: f64,
    /// Time constant with which the grip falls when less is needed, and of the filter of the
    /// motors' torques (s).
    pub grip_fall_s: f64,
    /// Time constant of the filter (s).
    pub filter_s: f64,
    /// What is done with the object.
    pub plan: Plan,
    /// What the arm does with the palm meanwhile.
    pub palm: PalmPlan,
    /// How long the object is held before the fingers open (s); `None` where they hold for good.
    pub open_after_s: Option<f64>,
}

/// What the law knows in one job.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<const F: usize, const N: usize> {
    /// Measured joints (rad).
    pub q: JointVector<N>,
    /// Torques that the motors give (N m).
    pub torque_nm: JointVector<N>,
    /// What each finger felt last.
    pub touch: [Touch; F],
    /// Time since the last job (s).
    pub dt_s: f64,
}

/// Where the grasp began.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reference<const F: usize> {
    /// Fingertips by the goal and as they were measured (m), palm frame.
    goal_m: [DVec3; F],
    measured_m: [DVec3; F],
    middle_m: DVec3,
}

/// The motion of the palm.
#[derive(Clone, Copy, Debug)]
struct PalmMotion<const N: usize> {
    /// Where it began (base frame).
    start: Pose,
    follower: PalmFollower<N>,
    /// Speeds of the last job (rad/s).
    speed_rad_s: JointVector<N>,
    /// What is added to the arm's goals so that its joints come to where the path has them (rad).
    correction_rad: JointVector<N>,
    /// Whether the arm could not follow; it brakes, and stands from then on.
    is_refused: bool,
}

/// The state of the law.
#[derive(Clone, Debug)]
pub struct Law<const F: usize, const N: usize> {
    hand: Hand<F, N>,
    tuning: Tuning<F>,
    goal: JointVector<N>,
    /// Where the fingers began to close (rad).
    start: JointVector<N>,
    touched: [bool; F],
    reference: Option<Reference<F>>,
    palm: Option<PalmMotion<N>>,
    held_s: f64,
    squeeze_m: f64,
    grip_n: f64,
    shift_m: DVec3,
    tilt_rad: DVec3,
    /// Filtered torques of contact (N m).
    torque_nm: Option<JointVector<N>>,
    forces: [ContactForce; F],
}

impl<const F: usize, const N: usize> Fold for Law<F, N> {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(self.goal.as_slice()).add(&self.held_s).add(&self.squeeze_m).add(&self.grip_n);
        for vector in [&self.shift_m, &self.tilt_rad] {
            hash.add(&vector.x).add(&vector.y).add(&vector.z);
        }
        for touched in &self.touched {
            hash.add(touched);
        }
        hash.add(&self.reference.is_some()).add(&self.torque_nm.is_some());
        if let Some(torque) = &self.torque_nm {
            hash.add(torque.as_slice());
        }
        if let Some(reference) = &self.reference {
            for place in reference.goal_m.iter().chain(&reference.measured_m) {
                hash.add(&place.x).add(&place.y).add(&place.z);
            }
        }
        if let Some(palm) = &self.palm {
            hash.add(&palm.start.rotation_rows()).add(&palm.start.translation.to_array());
            hash.add(palm.speed_rad_s.as_slice()).add(palm.correction_rad.as_slice());
            hash.add(&palm.is_refused);
        }
    }
}

impl<const F: usize, const N: usize> Law<F, N> {
    /// The law of a hand that starts to close from the joints `goal` (rad).
    #[must_use]
    pub fn new(hand: Hand<F, N>, tuning: Tuning<F>, goal: &JointVector<N>) -> Law<F, N> {
        Law {
            hand,
            tuning,
            goal: *goal,
            start: *goal,
            touched: [false; F],
            reference: None,
            palm: None,
            held_s: 0.0,
            squeeze_m: 0.0,
            grip_n: tuning.grip_min_n,
            shift_m: DVec3::ZERO,
            tilt_rad: DVec3::ZERO,
            torque_nm: None,
            forces: [ContactForce::default(); F],
        }
    }

    /// What the grasp does.
    #[must_use]
    pub fn phase(&self) -> Phase {
        match self.reference {
            None => Phase::Closing,
            Some(_) if self.tuning.open_after_s.is_some_and(|open_s| self.held_s >= open_s) => {
                Phase::Opening
            }
            Some(_) => Phase::Holding,
        }
    }

    /// Whether the arm could not follow the path of the palm, and brakes or stands.
    #[must_use]
    pub fn is_palm_refused(&self) -> bool {
        self.palm.is_some_and(|palm| palm.is_refused)
    }

    /// The forces of the fingers on the object, as they are felt.
    #[must_use]
    pub fn forces(&self) -> &[ContactForce; F] {
        &self.forces
    }

    /// Distance of each finger from the edge of its friction cone (N).
    #[must_use]
    pub fn margins_n(&self) -> [f64; F] {
        self.forces.map(|force| force.margin_n(self.tuning.friction))
    }

    /// The grip that is wanted (N), the squeeze (m) and the time since every finger touched (s).
    #[must_use]
    pub fn grip(&self) -> (f64, f64, f64) {
        (self.grip_n, self.squeeze_m, self.held_s)
    }

    /// One job: the joints for the hand to go to (rad).
    pub fn step(&mut self, inputs: &Inputs<F, N>) -> JointVector<N> {
        let tips: [Fingertip; F] =
            core::array::from_fn(|f| self.hand.fingertip_in_palm(&inputs.q, f));
        self.feel(inputs, &tips);
        let goal = match (self.phase(), self.reference) {
            (Phase::Holding, Some(reference)) => self.hold(inputs, &tips, &reference),
            (Phase::Opening, _) => self.open(inputs.dt_s),
            _ => self.close(inputs, &tips),
        };
        let most = self.hand.speed_max() * (SPEED_SHARE * inputs.dt_s);
        let (low, high) = (self.hand.q_min(), self.hand.q_max());
        self.goal = JointVector::from_fn(|i, _| {
            let step = (goal[i] - self.goal[i]).max(-most[i]).min(most[i]);
            let inner_low = low[i] + LIMIT_MARGIN_RAD;
            let inner_high = high[i] - LIMIT_MARGIN_RAD;
            (self.goal[i] + step).max(inner_low.min(self.goal[i])).min(inner_high.max(self.goal[i]))
        });
        self.goal
    }

    /// Brings the forces of contact up to date.
    fn feel(&mut self, inputs: &Inputs<F, N>, tips: &[Fingertip; F]) {
        let beside = inputs.torque_nm - self.hand.gravity_torque(&inputs.q);
        let part = (inputs.dt_s / (self.tuning.filter_s + inputs.dt_s)).clamp(0.0, 1.0);
        let torque = match self.torque_nm {
            // A number that is none must not stay in the filter.
            Some(before) if !beside.iter().all(|nm| nm.is_finite()) => before,
            Some(before) => before + (beside - before) * part,
            None => beside,
        };
        self.torque_nm = Some(torque);
        for (f, force) in self.forces.iter_mut().enumerate() {
            let own = Hand::<F, N>::finger_joints(&torque, f);
            let found = contact_force(&tips[f], &inputs.touch[f], &own);
            *force = found.unwrap_or(ContactForce {
                normal_n: inputs.touch[f].load_n,
                tangential: force.tangential,
            });
        }
    }

    /// Fingers that have not touched go on closing.
    fn close(&mut self, inputs: &Inputs<F, N>, tips: &[Fingertip; F]) -> JointVector<N> {
        for (touched, touch) in self.touched.iter_mut().zip(&inputs.touch) {
            *touched |= touch.felt && touch.load_n >= self.tuning.touched_n;
        }
        let mut goal = self.goal;
        for f in (0..F).filter(|f| !self.touched[*f]) {
            for i in 0..FINGER_JOINTS {
                let joint = Hand::<F, N>::first_joint(f) + i;
                goal[joint] += self.tuning.closing_rad_s[i] * inputs.dt_s;
            }
        }
        if self.touched.iter().all(|touched| *touched) && F > 0 {
            let measured_m: [DVec3; F] = core::array::from_fn(|f| tips[f].pose.translation);
            let goal_m = core::array::from_fn(|f| {
                self.hand.fingertip_in_palm(&self.goal, f).pose.translation
            });
            let middle_m = measured_m.iter().sum::<DVec3>() / F as f64;
            self.reference = Some(Reference { goal_m, measured_m, middle_m });
            self.palm = self.hand.carrier().map(|_| PalmMotion {
                start: self.hand.tool_pose(&self.goal),
                follower: self.hand.follower(&self.goal),
                speed_rad_s: JointVector::zeros(),
                correction_rad: JointVector::zeros(),
                is_refused: false,
            });
        }
        goal
    }

    /// The fingers go back to where they began to close, as fast as they closed.
    fn open(&mut self, dt_s: f64) -> JointVector<N> {
        self.held_s += dt_s;
        self.squeeze_m = 0.0;
        let most = self.tuning.closing_rad_s.amax() * dt_s;
        JointVector::from_fn(|i, _| match i < Hand::<F, N>::CARRIER_JOINTS {
            true => self.goal[i],
            false => self.goal[i] + (self.start[i] - self.goal[i]).clamp(-most, most),
        })
    }

    /// Puts the arm's joints for the palm's path into a goal; where the arm cannot follow, each of
    /// its joints brakes as fast as it may.
    ///
    /// Friction of the gears stops a servo without an integral term short of its goal, and the
    /// object's weight, which no model has, pulls it away. While the palm is to stand at the far
    /// end of its path the error of each joint is therefore integrated. The sum has a bound (K. J.
    /// Astrom and T. Hagglund, *Advanced PID Control*, 2006, section 3.5, on windup) and the error
    /// a dead zone against hunting (B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit,
    /// Automatica 30, 1994). On the way an error is lag; before it and after the way back the
    /// object may stand on something, against which an integral would only wind up. The sum then
    /// rests, and it fades with the way back.
    fn move_palm(&mut self, goal: &mut JointVector<N>, inputs: &Inputs<F, N>) {
        let plan = self.tuning.palm;
        let Some(palm) = self.palm.as_mut().filter(|_| !plan.is_still()) else { return };
        let dt_s = inputs.dt_s;
        let before = *palm.follower.joints();
        if !palm.is_refused {
            let (shift, turn) = plan.at(self.held_s);
            let rotation = rotation_from_vector(turn) * palm.start.rotation;
            let pose = Pose::new(rotation, palm.start.translation + shift);
            palm.is_refused = palm.follower.step(&pose, dt_s).is_err();
        }
        let most = self.hand.acceleration_max() * dt_s;
        let is_at_end = plan.stands_at_end(self.held_s);
        let rate = self.tuning.lift_correction_per_s * dt_s;
        let kept = 1.0 - plan.share_back(self.held_s);
        for joint in 0..Hand::<F, N>::CARRIER_JOINTS {
            let speed_rad_s = &mut palm.speed_rad_s[joint];
            if palm.is_refused {
                *speed_rad_s -= speed_rad_s.clamp(-most[joint], most[joint]);
                goal[joint] += *speed_rad_s * dt_s;
                continue;
            }
            let planned = palm.follower.joints()[joint];
            let way = planned - before[joint];
            *speed_rad_s = if dt_s > 0.0 { way / dt_s } else { 0.0 };
            let correction = &mut palm.correction_rad[joint];
            let error = planned - inputs.q[joint];
            if is_at_end && error.abs() > ARM_DEAD_ZONE_RAD {
                *correction = (*correction + rate * error)
                    .clamp(-ARM_CORRECTION_MAX_RAD, ARM_CORRECTION_MAX_RAD);
            }
            goal[joint] = planned + kept * *correction;
        }
    }

    /// The object is held, and moved as planned.
    fn hold(
        &mut self,
        inputs: &Inputs<F, N>,
        tips: &[Fingertip; F],
        reference: &Reference<F>,
    ) -> JointVector<N> {
        self.held_s += inputs.dt_s;
        self.adapt_grip(inputs.dt_s);
        let (shift, turn) = self.tuning.plan.at(self.held_s);
        let lever = |f: usize| reference.measured_m[f] - reference.middle_m;
        let planned = |f: usize| shift + turn.cross(lever(f));
        // The motion of the fingertips as one rigid body, beside the plan.
        let off: [DVec3; F] = core::array::from_fn(|f| {
            tips[f].pose.translation - reference.measured_m[f] - planned(f)
        });
        let mean = off.iter().sum::<DVec3>() / F as f64;
        let spread: f64 = (0..F).map(|f| lever(f).length_squared()).sum();
        let twist: DVec3 = (0..F).map(|f| lever(f).cross(off[f] - mean)).sum();
        let tilt = if spread > 0.0 { twist / spread } else { DVec3::ZERO };
        let rate = self.tuning.correction_per_s * inputs.dt_s;
        self.shift_m = limited(self.shift_m - mean * rate, SHIFT_MAX_M);
        self.tilt_rad = limited(self.tilt_rad - tilt * rate, TILT_MAX_RAD);
        let mut goal = self.goal;
        for f in 0..F {
            let tip = self.hand.fingertip_in_palm(&self.goal, f);
            let normal = tip.pose.rotation.z_axis;
            let target = reference.goal_m[f]
                + planned(f)
                + self.shift_m
                + self.tilt_rad.cross(lever(f))
                + normal * self.squeeze_m;
            let step = joint_step(&tip, target - tip.pose.translation);
            for i in 0..FINGER_JOINTS {
                goal[Hand::<F, N>::first_joint(f) + i] += step[i];
            }
        }
        self.move_palm(&mut goal, inputs);
        goal
    }

    /// The grip that the friction cones ask for, and the squeeze that brings it about. A finger
    /// whose load is too small for what it carries asks for as much more grip as it lacks.
    fn adapt_grip(&mut self, dt_s: f64) {
        let Tuning { friction, safety, grip_min_n, grip_max_n, share, .. } = self.tuning;
        let loads = || self.forces.iter().zip(&share);
        let felt = loads().map(|(force, share)| force.normal_n / share).sum::<f64>() / F as f64;
        let needed = loads().fold(grip_min_n, |needed, (force, share)| {
            // Beyond the cone the motors carry their own inertia, not the object.
            let carried_n = force.tangential.length().min(CARRIED_MAX * friction * force.normal_n);
            let borne_n = safety * carried_n / friction;
            let load_n = borne_n.max(LOAD_SHARE_MIN * grip_min_n * share);
            f64::max(needed, felt + (load_n - force.normal_n) / share)
        });
        let wanted = needed.min(grip_max_n);
        self.grip_n = match wanted > self.grip_n {
            true => wanted.min(self.grip_n + GRIP_RISE_N_S * dt_s),
            false => {
                let part = (dt_s / (self.tuning.grip_fall_s + dt_s)).clamp(0.0, 1.0);
                self.grip_n + (wanted - self.grip_n) * part
            }
        };
        let lacks = self.grip_n - felt;
        let most = self.tuning.squeeze_max_m;
        let squeeze = self.squeeze_m + self.tuning.squeeze_m_n_s * lacks * dt_s;
        if squeeze.is_finite() {
            self.squeeze_m = squeeze.clamp(-most, most);
        }
    }
}

/// A vector cut back to a length; zero for one that is not finite.
fn limited(vector: DVec3, most: f64) -> DVec3 {
    if vector.is_finite() { vector.clamp_length_max(most) } else { DVec3::ZERO }
}

#[cfg(test)]
mod tests;
