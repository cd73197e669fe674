//! An arm that is any chain: codes to currents to torques, friction that sticks, brakes, motion of
//! rigid bodies, encoder counts.
//!
//! Where the scene has something to touch, the arm moves by the implicit steps of finger and pin
//! together, as the PUMA 260 does ([`Coordinates::predict_stage`]). Where it has nothing, the arm
//! has a step of its own at less cost: implicit in the friction, with inertia and bias torques at
//! the middle of the step by one correction. Such steps are of second order in free motion, and a
//! joint that sticks does not chatter, however stiff its bristle is for the step.

use taktil_hal::CHANNELS;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::robot::ChainRobot;
use taktil_mechanics::spatial::{JointMatrix, JointVector, SinCos};
use taktil_mechanics::{Joints, Pose};

use crate::end_stop::stop_at_limits;
use crate::friction::{ResistingTorque, friction_torque};
use crate::hash::Hash;
use crate::manipulator::{
    ArmState, Coordinates, DriveLines, HomeCounts, JOINTS_MAX, Manipulator, MotorMotion,
    StagePredictor,
};
use crate::motors::{codes_per_acceleration, counts_of, motor_motion};
use crate::scene::fidelity::ArmModel;
use crate::scene::{ArmConfig, Invalid, invalid};

/// Evaluations of inertia and bias in a step: a prediction and a correction.
const MIDPOINT_EVALUATIONS: u32 = 2;
/// Newton steps for the speeds at the end of a step at most; the equations are linear but for
/// joints that begin or cease to stick.
const NEWTON_STEPS_MAX: u32 = 8;
/// Least lever of the finger about a joint's axis (m), for an arm whose tool lies on its axes.
const LEVER_MIN_M: f64 = 0.05;
/// Change of speed below which the speeds have converged (rad/s), relative to 1 rad/s plus the
/// fastest joint's speed.
const SPEED_TOLERANCE_RAD_S: f64 = 1e-12;

/// The state of such an arm.
#[derive(Clone, Debug)]
pub(crate) struct ChainArm<const N: usize> {
    robot: ChainRobot<N>,
    friction: Friction<N>,
    start_counts: [i32; N],
    /// Without rotors of their own.
    state: ArmState<N>,
    codes: [i32; CHANNELS],
    torque: JointVector<N>,
    lines: DriveLines,
    pose: Pose,
    /// The scene has something to touch.
    can_touch: bool,
    lever_m: f64,
}

impl<const N: usize> ChainArm<N> {
    /// At rest and braked at `start` (rad); `can_touch` says whether the scene has something to
    /// touch.
    pub(crate) fn new(
        robot: &ChainRobot<N>,
        start: &[f64],
        config: &ArmConfig,
        model: ArmModel,
        can_touch: bool,
    ) -> Result<ChainArm<N>, Invalid> {
        let Ok(start) = <[f64; N]>::try_from(start) else {
            let what = format!("starts with {} joints, has {N}", start.len());
            return Err(invalid("arm", what, "give one angle for each joint"));
        };
        let q = JointVector::from(start);
        if !robot.arm.within_limits(&q) {
            let what = "starts outside the limits of its joints".to_owned();
            return Err(invalid("arm", what, "give angles within them"));
        }
        let (usual, given) = (ArmConfig::default(), config);
        if (given.home_deg, given.zero_error_deg) != (usual.home_deg, usual.zero_error_deg) {
            let what = "holds angles of the PUMA 260".to_owned();
            return Err(invalid("arm", what, "say where this arm starts with start.joints_deg"));
        }
        let masses = (usual.link_mass_scale, usual.tool_mass_scale);
        if (given.link_mass_scale, given.tool_mass_scale) != masses {
            let what = "scales masses, which only the PUMA 260's model bears".to_owned();
            return Err(invalid("arm", what, "leave link_mass_scale and tool_mass_scale out"));
        }
        if config.encoder_scale != usual.encoder_scale {
            let what = "scales the counts of the PUMA 260's encoders".to_owned();
            return Err(invalid("arm", what, "say this arm's by counts_per_rev of its motors"));
        }
        if model == ArmModel::Kinematic || !config.trajectory_deg.is_empty() {
            let what = "asks for a course, which only the PUMA 260 follows".to_owned();
            return Err(invalid("fidelity.arm", what, "say rigid or rigid+motors"));
        }
        if model == ArmModel::Compliant {
            let what = "asks for gears that give way, which only the PUMA 260 has".to_owned();
            return Err(invalid("fidelity.arm", what, "say rigid or rigid+motors"));
        }
        let rubs = if model == ArmModel::Rigid { 0.0 } else { 1.0 };
        let friction = Friction {
            coulomb_nm: robot.friction.coulomb_nm * (rubs * config.coulomb_scale),
            viscous_nms_rad: robot.friction.viscous_nms_rad * (rubs * config.viscous_scale),
        };
        let (pose, jacobian) = robot.arm.tool_and_jacobian(&q);
        let levers_m = jacobian.column_iter().map(|column| column.fixed_rows::<3>(0).norm());
        Ok(ChainArm {
            start_counts: robot.gears.counts(&q),
            pose,
            robot: robot.clone(),
            friction,
            state: ArmState { q, ..ArmState::default() },
            codes: [0; CHANNELS],
            torque: JointVector::zeros(),
            lines: DriveLines::SAFE,
            can_touch,
            lever_m: levers_m.fold(LEVER_MIN_M, f64::max),
        })
    }

    /// Speeds at the end of a step from those at its beginning, with inertia and other torques
    /// held.
    fn end_speeds(
        &self,
        inertia: &JointMatrix<N>,
        torque_nm: &JointVector<N>,
        guess: JointVector<N>,
        h: f64,
    ) -> JointVector<N> {
        let mut speed = guess;
        for _ in 0..NEWTON_STEPS_MAX {
            let mut matrix = *inertia;
            let mut residual = inertia * (speed - self.state.qd) - torque_nm * h;
            for i in 0..N {
                let resisting =
                    friction_torque(&self.friction, i, self.state.bristle[i], speed[i], h);
                residual[i] += h * resisting.torque_nm;
                matrix[(i, i)] += h * resisting.slope;
            }
            let Some(factor) = matrix.cholesky() else { return self.state.qd };
            let change = factor.solve(&residual);
            speed -= change;
            if change.amax() < SPEED_TOLERANCE_RAD_S * (1.0 + speed.amax()) {
                break;
            }
        }
        speed
    }

    /// Torque of the motors on the joints' side (N m), zero when the drives are off.
    fn motor_torque(&self) -> JointVector<N> {
        if self.lines.enabled { self.torque } else { JointVector::zeros() }
    }
}

impl<const N: usize> Manipulator for ChainArm<N> {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn twist(&self) -> Joints {
        self.robot.arm.jacobian_base(&self.state.q) * self.state.qd
    }

    fn steps_by_itself(&self) -> bool {
        !self.can_touch
    }

    fn has_explicit_steps(&self) -> bool {
        false
    }

    fn lever_m(&self) -> f64 {
        self.lever_m
    }

    fn is_beyond_limits(&self) -> bool {
        !self.robot.arm.within_limits(&self.state.q)
    }

    fn stop_at_limits(&mut self) {
        let arm = &self.robot.arm;
        let limits = arm.limits();
        let ArmState { q, qd, .. } = &mut self.state;
        let inertia = |q: &JointVector<N>| arm.mass_matrix(q);
        stop_at_limits(q, qd, |i| (limits.q_min[i], limits.q_max[i]), inertia);
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

    fn motor_motion(&self) -> MotorMotion {
        let gears = &self.robot.gears;
        motor_motion(
            &(gears.exact_counts(&self.state.q) - counts_of(&self.start_counts)),
            &gears.exact_counts(&self.state.qd),
        )
    }

    fn codes_per_acceleration(&self) -> Option<Vec<f64>> {
        let robot = &self.robot;
        let inertia = robot.arm.mass_matrix(&self.state.q);
        Some(codes_per_acceleration(&inertia, &robot.gears, &robot.drive))
    }

    /// The home pose is the one in which the arm started.
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

    fn energy_j(&self) -> f64 {
        let arm = &self.robot.arm;
        0.5 * self.state.qd.dot(&(arm.mass_matrix(&self.state.q) * self.state.qd))
            + arm.potential_energy_j(&self.state.q)
    }

    fn digest(&self, hash: &mut Hash) {
        for state in [&self.state.q, &self.state.qd, &self.state.bristle] {
            hash.numbers(state.as_slice());
        }
        hash.word(u64::from(self.lines.enabled) << 1 | u64::from(self.lines.braked));
        for code in self.codes.iter().take(JOINTS_MAX) {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }
}

impl<const N: usize> Coordinates<N> for ChainArm<N> {
    fn state(&self) -> &ArmState<N> {
        &self.state
    }

    fn state_mut(&mut self) -> &mut ArmState<N> {
        &mut self.state
    }

    /// The step of an arm that touches nothing.
    fn step(&mut self, h: f64, _wrench: &Joints) {
        if self.lines.braked {
            self.state.qd = JointVector::zeros();
            return;
        }
        let motors_nm = self.motor_torque();
        let mut end = self.state.qd;
        for _ in 0..MIDPOINT_EVALUATIONS {
            let mean = (self.state.qd + end) * 0.5;
            let middle = self.state.q + mean * (0.5 * h);
            let torque_nm = motors_nm - self.robot.arm.bias_torque(&middle, &mean);
            end = self.end_speeds(&self.robot.arm.mass_matrix(&middle), &torque_nm, end, h);
        }
        for i in 0..N {
            let resisting = friction_torque(&self.friction, i, self.state.bristle[i], end[i], h);
            self.state.bristle[i] = resisting.bristle_rad;
        }
        self.state.q += (self.state.qd + end) * (0.5 * h);
        self.state.qd = end;
        self.stop_at_limits();
        self.pose = self.robot.arm.tool_pose(&self.state.q);
    }

    fn predict_stage(
        &self,
        base: &ArmState<N>,
        guess: &JointVector<N>,
        h: f64,
        _end_s: f64,
    ) -> StagePredictor<N> {
        if self.lines.braked {
            return StagePredictor::prescribed(self.pose, Joints::zeros());
        }
        let arm = &self.robot.arm;
        let q = base.q + guess * h;
        let (pose, jacobian) = arm.tool_and_jacobian(&q);
        StagePredictor {
            degrees_of_freedom: N,
            inertia: arm.mass_matrix(&q),
            forces: self.motor_torque() - arm.bias_torque(&q, guess),
            jacobian,
            pose,
            prescribed_twist: Joints::zeros(),
            guessed_speeds: *guess,
            sin_cos: SinCos { s: [0.0; 6], c: [1.0; 6] },
        }
    }

    fn generalised_forces(
        &self,
        predictor: &StagePredictor<N>,
        base: &ArmState<N>,
        speeds: &JointVector<N>,
        h: f64,
    ) -> JointVector<N> {
        if predictor.degrees_of_freedom == 0 {
            return predictor.forces;
        }
        let q = base.q + predictor.guessed_speeds * h;
        self.motor_torque() - self.robot.arm.bias_torque(&q, speeds)
    }

    fn resisting_torque(
        &self,
        base: &ArmState<N>,
        i: usize,
        speed: f64,
        h: f64,
    ) -> ResistingTorque {
        friction_torque(&self.friction, i, base.bristle[i], speed, h)
    }

    fn update_kinematics(&mut self, _t_s: f64) {
        self.pose = self.robot.arm.tool_pose(&self.state.q);
    }

    fn clone_box(&self) -> Box<dyn Coordinates<N>> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests;
