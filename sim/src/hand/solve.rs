//! One step of Euler's method backwards over the object and all fingers together: speeds at the end
//! of the step that the forces at its end bring about, found by Newton's method. Mass matrices,
//! Coriolis and gravity torques are those of the step's beginning.
//!
//! The equations are those of the object, six, and those of the joints, in one matrix of fixed
//! size. Object and fingers are coupled through the contacts; fingers on an arm are coupled to its
//! joints through their masses too. What a hand of fewer joints lacks stays at rest.

use glam::DVec3;
use nalgebra::{Matrix3, Matrix6x3, SMatrix, SVector};
use taktil_mechanics::arm::ArmDynamics;
use taktil_mechanics::hand::{CARRIER_JOINTS, FINGER_JOINTS, Fingertip, Hand};
use taktil_mechanics::rigid_body::GRAVITY_M_S2;
use taktil_mechanics::spatial::{
    JointVector, linear_and_angular, rotate_spatial_vector, rotation_from_vector,
    to_nalgebra_matrix, to_nalgebra_vector,
};
use taktil_mechanics::{Joints, Matrix6, Pose};

use super::object::Motion;
use super::patch::{PatchLoad, Relative};
use super::{FINGERS_MAX, GraspingHand, HandState};
use crate::friction::friction_torque;

/// Unknown speeds of a hand whose palm stands still: those of the object, then those of the
/// fingers' joints.
const UNKNOWN_SPEEDS: usize = 6 + FINGER_JOINTS * FINGERS_MAX;
/// The same of a hand on an arm, whose joints come before the fingers'.
const UNKNOWN_SPEEDS_ON_ARM: usize = UNKNOWN_SPEEDS + CARRIER_JOINTS;
type Speeds<const U: usize> = SVector<f64, U>;
type System<const U: usize> = SMatrix<f64, U, U>;

/// Newton steps at most. Three or four are usual; a contact that begins to slide takes more.
const NEWTON_STEPS_MAX: u32 = 30;
/// Newton steps after which the rest are halved: two contacts that stick and slide in turn.
const FULL_STEPS_MAX: u32 = 12;
/// Change of the speeds at which they have converged (m/s, rad/s), relative to one plus the
/// largest speed: at a stiffness of 1e7 N/m over 1 ms that is 1e-5 N.
const SPEED_TOLERANCE: f64 = 1e-9;

/// What does not change within a step.
struct Frozen<const U: usize> {
    mass: System<U>,
    /// Impulses of the forces that do not depend on the end: gravity, Coriolis, motors, pushes.
    given: Speeds<U>,
    before: Speeds<U>,
}

/// The step's end for some speeds.
struct Trial<const F: usize, const N: usize, const U: usize> {
    state: HandState<F, N>,
    loads: [PatchLoad; F],
    support_n: f64,
    residual: Speeds<U>,
    matrix: System<U>,
}

impl<const F: usize, const N: usize> GraspingHand<F, N> {
    /// Moves object and joints by one step of `h` seconds that ends at `end_s`.
    pub(super) fn step_implicit(&mut self, end_s: f64, h: f64) {
        match Hand::<F, N>::CARRIER_JOINTS {
            0 => self.step_with::<UNKNOWN_SPEEDS>(end_s, h, |m, b| m.lu().solve(b)),
            _ => self.step_with::<UNKNOWN_SPEEDS_ON_ARM>(end_s, h, |m, b| m.lu().solve(b)),
        }
    }

    /// The step with so many unknown speeds, and what solves linear equations for them.
    fn step_with<const U: usize>(
        &mut self,
        end_s: f64,
        h: f64,
        solution: impl Fn(System<U>, &Speeds<U>) -> Option<Speeds<U>>,
    ) {
        let frozen = self.frozen::<U>(end_s, h);
        let mut speeds = frozen.before;
        let mut converged = false;
        let mut trial = self.trial(&frozen, &speeds, end_s, h);
        for step in 0..NEWTON_STEPS_MAX {
            self.work.iterations += 1;
            let Some(change) = solution(trial.matrix, &trial.residual) else { break };
            let part = if step < FULL_STEPS_MAX { 1.0 } else { 0.5 };
            speeds -= change * part;
            trial = self.trial(&frozen, &speeds, end_s, h);
            if change.amax() < SPEED_TOLERANCE * (1.0 + speeds.amax()) {
                converged = true;
                break;
            }
        }
        self.work.unconverged += u64::from(!converged);
        if !speeds.iter().all(|speed| speed.is_finite()) {
            // Nothing moves in a step without a solution.
            (self.state.qd, self.state.object.velocity) = (JointVector::zeros(), DVec3::ZERO);
            self.state.object.spin = DVec3::ZERO;
            return;
        }
        for i in 0..N {
            let (from, speed) = (self.state.bristle[i], speeds[6 + i]);
            let resisting = friction_torque(&self.robot.friction, i, from, speed, h);
            trial.state.bristle[i] = resisting.bristle_rad;
        }
        self.state = trial.state;
        self.loads = trial.loads;
        self.support_n = trial.support_n;
        self.beyond_small_strain =
            self.loads.iter().any(|load| self.pad.law.is_beyond_small_strain(load.deepest_m));
    }

    /// Force (N) and moment about the centre (N m) of the pushes at an instant.
    fn push(&self, t_s: f64) -> (DVec3, DVec3) {
        let (mut force, mut moment) = (DVec3::ZERO, DVec3::ZERO);
        for push in &self.pushes {
            let part = push.share(t_s);
            let one = DVec3::from_array(push.force_n) * part;
            force += one;
            let lever = self.state.object.pose.rotation * DVec3::from_array(push.at_mm) * 1e-3;
            moment += lever.cross(one);
        }
        (force, moment)
    }

    fn frozen<const U: usize>(&mut self, end_s: f64, h: f64) -> Frozen<U> {
        let (force, moment) = self.push(end_s);
        self.push_n = force;
        let HandState { q, qd, object, .. } = &self.state;
        let mut mass = System::<U>::identity();
        let (mut given, mut before) = (Speeds::<U>::zeros(), Speeds::<U>::zeros());
        let axes = object.pose.rotation;
        let inertia = axes * glam::DMat3::from_diagonal(self.moments) * axes.transpose();
        mass.fixed_view_mut::<3, 3>(0, 0).copy_from(&(Matrix3::identity() * self.mass_kg));
        mass.fixed_view_mut::<3, 3>(3, 3).copy_from(&to_nalgebra_matrix(&inertia));
        let weight = DVec3::new(0.0, 0.0, -GRAVITY_M_S2 * self.mass_kg);
        let gyroscopic = object.spin.cross(inertia * object.spin);
        given.fixed_rows_mut::<3>(0).copy_from(&to_nalgebra_vector(h * (force + weight)));
        given.fixed_rows_mut::<3>(3).copy_from(&to_nalgebra_vector(h * (moment - gyroscopic)));
        before.fixed_rows_mut::<3>(0).copy_from(&to_nalgebra_vector(object.velocity));
        before.fixed_rows_mut::<3>(3).copy_from(&to_nalgebra_vector(object.spin));
        if !self.lines.braked {
            let motors = if self.lines.enabled { self.torque } else { JointVector::zeros() };
            let inertia = self.robot.arm.mass_matrix(q);
            let torque = motors - self.robot.arm.bias_torque(q, qd);
            mass.fixed_view_mut::<N, N>(6, 6).copy_from(&inertia);
            given.fixed_rows_mut::<N>(6).copy_from(&(torque * h));
            before.fixed_rows_mut::<N>(6).copy_from(qd);
        }
        Frozen { mass, given, before }
    }

    /// The state at the end of a step that ends with these speeds; the friction bristles of the
    /// joints are those of its beginning.
    fn end_state<const U: usize>(&self, speeds: &Speeds<U>, h: f64) -> HandState<F, N> {
        let start = &self.state;
        let velocity = DVec3::new(speeds[0], speeds[1], speeds[2]);
        let spin = DVec3::new(speeds[3], speeds[4], speeds[5]);
        let qd = JointVector::<N>::from_fn(|i, _| speeds[6 + i]);
        let turned = rotation_from_vector(h * spin) * start.object.pose.rotation;
        // The axes are made orthonormal again, because errors of a product would add up.
        let x = turned.x_axis.normalize();
        let y = (turned.y_axis - x * x.dot(turned.y_axis)).normalize();
        let rotation = glam::DMat3::from_cols(x, y, x.cross(y));
        let pose = Pose::new(rotation, start.object.pose.translation + h * velocity);
        HandState { q: start.q + qd * h, qd, object: Motion { pose, velocity, spin }, ..*start }
    }

    /// Evaluates the equations for speeds at the end of the step.
    fn trial<const U: usize>(
        &self,
        frozen: &Frozen<U>,
        speeds: &Speeds<U>,
        end_s: f64,
        h: f64,
    ) -> Trial<F, N, U> {
        let mut state = self.end_state(speeds, h);
        let mut matrix = frozen.mass;
        let mut residual = frozen.mass * (speeds - frozen.before) - frozen.given;
        let mut support_n = 0.0;
        if let Some(load) = self.support.evaluate(&self.solid, &state.object, end_s, h) {
            let (force, moment) = (to_nalgebra_vector(load.force), to_nalgebra_vector(load.moment));
            let mut linear = residual.fixed_rows_mut::<3>(0);
            linear -= force * h;
            let mut angular = residual.fixed_rows_mut::<3>(3);
            angular -= moment * h;
            let mut block = matrix.fixed_view_mut::<6, 6>(0, 0);
            block -= load.derivative * h;
            support_n = load.normal_n;
        }
        let mut loads = [PatchLoad::default(); F];
        let palm = self.robot.arm.palm(&state.q);
        for (f, slot) in loads.iter_mut().enumerate() {
            let tip = self.tip_of_palm(&palm, &state.q, f);
            let mut jacobian = Matrix6x3::zeros();
            jacobian.fixed_rows_mut::<3>(0).copy_from(&tip.linear);
            jacobian.fixed_rows_mut::<3>(3).copy_from(&tip.angular);
            let by_arm = match Hand::<F, N>::CARRIER_JOINTS {
                0 => Matrix6::zeros(),
                _ => palm.jacobian_at(tip.pose.translation),
            };
            let twist = self.pad_twist(&tip, &by_arm, &state.qd, f);
            let relative = Relative::of(&tip.pose, &twist, &state.object, h);
            let load = self.pad.evaluate(&self.solid, &relative, &self.state.pads[f]);
            state.pads[f] = load.bristle;
            if load.normal_n > 0.0 {
                let braked = self.lines.braked;
                let lever = tip.pose.translation - state.object.pose.translation;
                let jacobian = if braked { Matrix6x3::zeros() } else { jacobian };
                let by_arm = if braked { Matrix6::zeros() } else { by_arm };
                let at = 6 + Hand::<F, N>::first_joint(f);
                let contact = Contact { at, tip, jacobian, by_arm, lever, load };
                add_contact(&mut residual, &mut matrix, &contact, h);
                if Hand::<F, N>::CARRIER_JOINTS > 0 {
                    add_to_arm(&mut residual, &mut matrix, &contact, h);
                }
            }
            *slot = load;
        }
        if !self.lines.braked {
            for i in 0..N {
                let from = self.state.bristle[i];
                let speed = speeds[6 + i];
                let resisting = friction_torque(&self.robot.friction, i, from, speed, h);
                residual[6 + i] += h * resisting.torque_nm;
                matrix[(6 + i, 6 + i)] += h * resisting.slope;
            }
        }
        Trial { state, loads, support_n, residual, matrix }
    }
}

/// A loaded contact of a finger.
struct Contact {
    /// Place of the finger's first joint among the unknown speeds.
    at: usize,
    tip: Fingertip,
    /// Twist of the pad per speed of the finger's joints, base axes.
    jacobian: Matrix6x3<f64>,
    /// Twist of the pad per speed of the arm's joints, base axes.
    by_arm: Matrix6,
    /// The pad's middle from the object's centre (m), base axes.
    lever: DVec3,
    load: PatchLoad,
}

impl Contact {
    /// Force (N) and moment (N m) on the object about the pad's middle, base axes.
    fn wrench(&self) -> Joints {
        rotate_spatial_vector(&self.tip.pose.rotation, &self.load.wrench)
    }

    /// The object's twist at the pad's middle per its own: v + w x lever.
    fn carried(&self) -> Matrix6 {
        let mut carried = Matrix6::identity();
        let cross = to_nalgebra_vector(self.lever).cross_matrix();
        carried.fixed_view_mut::<3, 3>(0, 3).copy_from(&-cross);
        carried
    }

    /// The derivative of the impulse in a step of `h` seconds, base axes.
    fn slope(&self, h: f64) -> Matrix6 {
        let turn = to_nalgebra_matrix(&self.tip.pose.rotation);
        let mut turns = Matrix6::zeros();
        turns.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        turns.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        turns * self.load.derivative * turns.transpose() * h
    }
}

/// Adds a contact's impulses on object and finger and their derivatives to the equations.
fn add_contact<const U: usize>(
    residual: &mut Speeds<U>,
    matrix: &mut System<U>,
    contact: &Contact,
    h: f64,
) {
    let Contact { at, jacobian, lever, .. } = contact;
    let at = *at;
    let wrench = contact.wrench();
    let (force, moment) = linear_and_angular(&wrench);
    let carried = contact.carried();
    let on_object = taktil_mechanics::spatial::spatial_vector(force, moment + lever.cross(force));
    let mut object = residual.fixed_rows_mut::<6>(0);
    object -= on_object * h;
    let mut finger = residual.fixed_rows_mut::<3>(at);
    finger += jacobian.transpose() * wrench * h;
    let slope = contact.slope(h);
    let (by_object, by_finger) = (slope * carried, slope * jacobian);
    let mut block = matrix.fixed_view_mut::<6, 6>(0, 0);
    block -= carried.transpose() * by_object;
    let mut block = matrix.fixed_view_mut::<6, 3>(0, at);
    block += carried.transpose() * by_finger;
    let mut block = matrix.fixed_view_mut::<3, 6>(at, 0);
    block += jacobian.transpose() * by_object;
    let mut block = matrix.fixed_view_mut::<3, 3>(at, at);
    block -= jacobian.transpose() * by_finger;
}

/// Adds what a contact does to the arm that carries its finger.
fn add_to_arm<const U: usize>(
    residual: &mut Speeds<U>,
    matrix: &mut System<U>,
    contact: &Contact,
    h: f64,
) {
    /// The arm's joints come after the object's six speeds.
    const ARM_PLACE: usize = 6;
    let Contact { at, jacobian, by_arm, .. } = contact;
    let mut arm = residual.fixed_rows_mut::<6>(ARM_PLACE);
    arm += by_arm.transpose() * contact.wrench() * h;
    let (slope, carried) = (contact.slope(h), contact.carried());
    let (of_arm, of_finger) = (slope * by_arm, slope * jacobian);
    let mut block = matrix.fixed_view_mut::<6, 6>(0, ARM_PLACE);
    block += carried.transpose() * of_arm;
    let mut block = matrix.fixed_view_mut::<6, 6>(ARM_PLACE, 0);
    block += by_arm.transpose() * (slope * carried);
    let mut block = matrix.fixed_view_mut::<6, 6>(ARM_PLACE, ARM_PLACE);
    block -= by_arm.transpose() * of_arm;
    let mut block = matrix.fixed_view_mut::<6, 3>(ARM_PLACE, *at);
    block -= by_arm.transpose() * of_finger;
    let mut block = matrix.fixed_view_mut::<3, 6>(*at, ARM_PLACE);
    block -= jacobian.transpose() * of_arm;
}
