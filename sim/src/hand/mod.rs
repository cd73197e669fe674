//! A hand of fingers on a palm that stands still or that an arm carries, and one free rigid object
//! among its fingertips and a level support: a manipulator that moves by its own method and carries
//! the object with it.
//!
//! The object is a sphere, a cylinder or a cuboid. Gravity, friction, the fingertips' rubber and
//! pushes from outside act on it. Each fingertip is a flat pad with a tactile array. A step is one
//! of Euler's method backwards over the fingers' joints and the object together ([`solve`]), stable
//! whatever the stiffness and of first order. Decision record 0043 has the reasons, and
//! `docs/measurements/hand.md` the errors.
//!
//! Fingers do not touch each other, the palm or the support, and the object does not touch the
//! palm.

mod foundation;
pub(crate) mod grasp;
mod object;
#[cfg(test)]
mod on_arm_tests;
mod patch;
mod solve;
mod support;
#[cfg(test)]
mod tests;

use glam::DVec3;
use taktil_hal::CHANNELS;
use taktil_mechanics::hand::{Fingertip, Hand, Palm};
use taktil_mechanics::robot::Robot;
use taktil_mechanics::spatial::{JointVector, rotation_z};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::end_stop::stop_at_limits;
use crate::friction::ResistingTorque;
use crate::hash::Hash;
use crate::manipulator::{
    ArmState, Coordinates, DriveLines, HomeCounts, Manipulator, StagePredictor,
};
use crate::scene::fidelity::ArmModel;
use crate::scene::{HandConfig, HeldShape, Invalid, PushConfig, WorldConfig, invalid};
use foundation::Foundation;
use grasp::{FINGERS_MAX, FingerContact, Grasp, HandTruth, StepWork};
use object::{Motion, Solid};
use patch::{Bristle, Pad, PatchLoad, Relative};
use support::Support;

/// What moves: joints, joint bristles, the object and the bristles of the pads.
#[derive(Clone, Copy, Debug, PartialEq)]
struct HandState<const F: usize, const N: usize> {
    q: JointVector<N>,
    qd: JointVector<N>,
    bristle: JointVector<N>,
    object: Motion,
    pads: [Bristle; F],
}

/// The hand and its object.
#[derive(Clone, Debug)]
pub(crate) struct GraspingHand<const F: usize, const N: usize> {
    robot: Robot<N, Hand<F, N>>,
    start_counts: [i32; N],
    solid: Solid,
    mass_kg: f64,
    moments: DVec3,
    pad: Pad,
    support: Support,
    pushes: Vec<PushConfig>,
    state: HandState<F, N>,
    codes: [i32; CHANNELS],
    torque: JointVector<N>,
    lines: DriveLines,
    pose: Pose,
    /// Contacts at the end of the last step.
    loads: [PatchLoad; F],
    support_n: f64,
    push_n: DVec3,
    beyond_small_strain: bool,
    work: StepWork,
    no_state: ArmState,
}

/// The solid of a checked description.
fn solid(config: &HandConfig) -> Solid {
    let (radius_m, half_length_m) = (1e-3 * config.radius_mm, 0.5e-3 * config.length_mm);
    match config.shape {
        HeldShape::Sphere => Solid::Sphere { radius_m },
        HeldShape::Cylinder => Solid::Cylinder { radius_m, half_length_m },
        HeldShape::Cuboid => Solid::Cuboid { half_m: DVec3::from_array(config.size_mm) * 0.5e-3 },
    }
}

impl<const F: usize, const N: usize> GraspingHand<F, N> {
    /// The hand at rest and braked at `start` (rad), the object at rest on its support.
    ///
    /// # Errors
    /// Joints outside their limits; more fingers than arrays; a part that this hand does not have;
    /// an object that stands in a fingertip; what the contact's solver refuses.
    pub(crate) fn new(
        robot: &Robot<N, Hand<F, N>>,
        start: &[f64],
        world: &WorldConfig,
    ) -> Result<GraspingHand<F, N>, Invalid> {
        let config = &world.hand;
        if F == 0 || F > FINGERS_MAX {
            let what = format!("has {F} fingers");
            return Err(invalid("hand", what, "simulate one to three fingers"));
        }
        let q = start_joints::<F, N>(robot, start)?;
        if matches!(world.fidelity.arm, ArmModel::Kinematic | ArmModel::Compliant) {
            let what = "asks for a part that only the PUMA 260 has".to_owned();
            return Err(invalid("fidelity.arm", what, "say rigid or rigid+motors"));
        }
        let rubs = if world.fidelity.arm == ArmModel::Rigid { 0.0 } else { 1.0 };
        let mut robot = robot.clone();
        robot.friction.coulomb_nm *= rubs * world.arm.coulomb_scale;
        robot.friction.viscous_nms_rad *= rubs * world.arm.viscous_scale;
        let solid = solid(config);
        let law = Foundation::new(&world.finger.rubber, &solid)?;
        let pad = Pad { array: world.tactile.geometry(), law, friction: world.finger.friction };
        let support = Support::new(config);
        let rotation = rotation_z(config.yaw_deg.to_radians());
        let place = DVec3::new(config.x_mm, config.y_mm, 0.0) * 1e-3;
        let mut object =
            Motion { pose: Pose::new(rotation, place), velocity: DVec3::ZERO, spin: DVec3::ZERO };
        object.pose.translation.z = support.rest_z_m(&solid, &rotation, config.mass_kg);
        let mut hand = GraspingHand {
            start_counts: robot.gears.counts(&q),
            pose: robot.arm.fingertip(&q, 0).pose,
            robot,
            solid,
            mass_kg: config.mass_kg,
            moments: solid.moments_kg_m2(config.mass_kg),
            pad,
            support,
            pushes: config.push.clone(),
            state: HandState {
                q,
                qd: JointVector::zeros(),
                bristle: JointVector::zeros(),
                object,
                pads: [Bristle::zeros(); F],
            },
            codes: [0; CHANNELS],
            torque: JointVector::zeros(),
            lines: DriveLines::SAFE,
            loads: [PatchLoad::default(); F],
            support_n: 0.0,
            push_n: DVec3::ZERO,
            beyond_small_strain: false,
            work: StepWork::default(),
            no_state: ArmState::default(),
        };
        hand.check_clear()?;
        hand.support_n = hand.mass_kg * taktil_mechanics::rigid_body::GRAVITY_M_S2;
        Ok(hand)
    }

    /// Refuses an object that stands in a fingertip's rubber at the start.
    fn check_clear(&self) -> Result<(), Invalid> {
        for finger in 0..F {
            let load = self.pad.evaluate(&self.solid, &self.relative(finger), &Bristle::zeros());
            if load.deepest_m > 0.0 {
                let what = format!(
                    "puts the object {:.3} mm inside the rubber of finger {} at the start",
                    1e3 * load.deepest_m,
                    finger + 1
                );
                let remedy = "open the hand (start.joints_deg), or move the object";
                return Err(invalid("hand", what, remedy));
            }
        }
        Ok(())
    }

    /// A fingertip in the base frame, of a hand whose palm is there.
    fn tip_of_palm(&self, palm: &Palm, q: &JointVector<N>, finger: usize) -> Fingertip {
        let tip = self.robot.arm.fingertip_in_palm(q, finger);
        if Hand::<F, N>::CARRIER_JOINTS > 0 { palm.carried(&tip) } else { tip }
    }

    /// The twist of a pad at joint speeds (rad/s), base axes, where `by_arm` is that per speed of
    /// the arm's joints.
    fn pad_twist(
        &self,
        tip: &Fingertip,
        by_arm: &Matrix6,
        qd: &JointVector<N>,
        finger: usize,
    ) -> Joints {
        let own = Hand::<F, N>::finger_joints(qd, finger);
        let mut twist = Joints::zeros();
        twist.fixed_rows_mut::<3>(0).copy_from(&(tip.linear * own));
        twist.fixed_rows_mut::<3>(3).copy_from(&(tip.angular * own));
        if Hand::<F, N>::CARRIER_JOINTS > 0 {
            twist += by_arm * Hand::<F, N>::arm_joints(qd);
        }
        twist
    }

    /// The object as a pad has it now.
    fn relative(&self, finger: usize) -> Relative {
        let HandState { q, qd, object, .. } = &self.state;
        let palm = self.robot.arm.palm(q);
        let tip = self.tip_of_palm(&palm, q, finger);
        let by_arm = palm.jacobian_at(tip.pose.translation);
        Relative::of(&tip.pose, &self.pad_twist(&tip, &by_arm, qd, finger), object, 0.0)
    }

    /// Holds joints of palm and fingers at their end stops. What is held is left as it is.
    fn stop_at_limits(&mut self) {
        use taktil_mechanics::arm::{Arm, ArmDynamics};
        let arm = &self.robot.arm;
        let HandState { q, qd, .. } = &mut self.state;
        let inertia = |q: &JointVector<N>| arm.mass_matrix(q);
        stop_at_limits(q, qd, |i| (arm.q_min()[i], arm.q_max()[i]), inertia);
    }
}

/// Checked joint angles of the start (rad).
fn start_joints<const F: usize, const N: usize>(
    robot: &Robot<N, Hand<F, N>>,
    start: &[f64],
) -> Result<JointVector<N>, Invalid> {
    use taktil_mechanics::arm::Arm;
    let Ok(start) = <[f64; N]>::try_from(start) else {
        let what = format!("starts with {} joints, has {N}", start.len());
        return Err(invalid("arm", what, "give one angle for each joint"));
    };
    let q = JointVector::from(start);
    if !robot.arm.within_limits(&q) {
        let what = "starts outside the limits of its joints".to_owned();
        return Err(invalid("arm", what, "give angles within them"));
    }
    Ok(q)
}

impl<const F: usize, const N: usize> Grasp for GraspingHand<F, N> {
    fn fingers(&self) -> usize {
        F
    }

    fn truth(&self) -> HandTruth {
        let mut fingers = [FingerContact::default(); FINGERS_MAX];
        for (finger, load) in fingers.iter_mut().zip(&self.loads) {
            *finger = FingerContact {
                normal_n: load.normal_n,
                friction: load.bristle.into(),
                effort: load.effort,
                slip_m_s: load.slip_m_s,
                middle_m: load.middle.to_array(),
            };
        }
        let object = &self.state.object;
        HandTruth {
            object_m: object.pose.translation,
            object_axes: object.pose.rotation,
            object_m_s: object.velocity,
            object_rad_s: object.spin,
            push_n: self.push_n,
            fingers,
            support_n: self.support_n,
            beyond_small_strain: self.beyond_small_strain,
        }
    }

    fn image(&self, finger: usize, forces: &mut [f64]) {
        self.pad.image(&self.solid, &self.relative(finger), forces);
    }
}

impl<const F: usize, const N: usize> Manipulator for GraspingHand<F, N> {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn twist(&self) -> Joints {
        Joints::zeros()
    }

    fn take_work(&mut self) -> StepWork {
        core::mem::take(&mut self.work)
    }

    fn steps_by_itself(&self) -> bool {
        true
    }

    fn drive(&mut self, codes: &[i32; CHANNELS], lines: DriveLines) {
        (self.codes, self.lines) = (*codes, lines);
        let motor_nm = JointVector::from_fn(|i, _| self.robot.drive.motor_torque_nm(codes[i], i));
        self.torque = self.robot.gears.joint_torque(&motor_nm);
    }

    fn drive_lines(&self) -> DriveLines {
        self.lines
    }

    fn counts(&self) -> [i32; CHANNELS] {
        let now = self.robot.gears.counts(&self.state.q);
        let mut out = [0; CHANNELS];
        for (i, count) in out.iter_mut().enumerate().take(N) {
            *count = now[i].wrapping_sub(self.start_counts[i]);
        }
        out
    }

    /// The home pose is the one in which the hand started.
    fn home_counts(&self) -> Option<HomeCounts> {
        let counts_per_turn = self.robot.gears.counts_per_revolution().as_slice().to_vec();
        Some(HomeCounts { counts: vec![0; N], counts_per_turn })
    }

    fn current_codes(&self) -> [i32; CHANNELS] {
        if self.lines.enabled { self.codes } else { [0; CHANNELS] }
    }

    fn joints(&self) -> (&[f64], &[f64]) {
        (self.state.q.as_slice(), self.state.qd.as_slice())
    }

    fn grasp(&self) -> Option<&dyn Grasp> {
        Some(self)
    }

    fn digest(&self, hash: &mut Hash) {
        let state = &self.state;
        for joints in [&state.q, &state.qd, &state.bristle] {
            hash.numbers(joints.as_slice());
        }
        state.object.digest(hash);
        for pad in &state.pads {
            hash.numbers(pad.as_slice());
        }
        hash.word(u64::from(self.lines.enabled) << 1 | u64::from(self.lines.braked));
        for code in self.codes.iter().take(N) {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }
}

impl<const F: usize, const N: usize> Coordinates<6> for GraspingHand<F, N> {
    fn state(&self) -> &ArmState {
        &self.no_state
    }

    fn state_mut(&mut self) -> &mut ArmState {
        &mut self.no_state
    }

    fn step(&mut self, _h: f64, _wrench: &Joints) {}

    fn step_from(&mut self, t_s: f64, h: f64, _wrench: &Joints) {
        self.step_implicit(t_s + h, h);
        self.stop_at_limits();
        self.pose = self.robot.arm.fingertip(&self.state.q, 0).pose;
    }

    fn predict_stage(&self, _: &ArmState, _: &Joints, _: f64, _: f64) -> StagePredictor {
        StagePredictor::prescribed(self.pose, Joints::zeros())
    }

    fn resisting_torque(&self, _: &ArmState, _: usize, _: f64, _: f64) -> ResistingTorque {
        ResistingTorque::default()
    }

    fn update_kinematics(&mut self, _t_s: f64) {}

    fn clone_box(&self) -> Box<dyn Coordinates<6>> {
        Box::new(self.clone())
    }
}
