//! An arm that is any chain, free of contact: codes to currents to torques, friction that sticks,
//! brakes, motion of rigid bodies, encoder counts. Refuses to touch: whatever is felt is the PUMA
//! 260's affair.
//!
//! Steps are implicit in the friction and take inertia and bias torques at the middle of the step
//! by one correction: second order in free motion, and a joint that sticks does not chatter,
//! however stiff its bristle is for the step.

use core::fmt::Debug;

use taktil_hal::CHANNELS;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::robot::ChainRobot;
use taktil_mechanics::spatial::{JointMatrix, JointVector};
use taktil_mechanics::{Joints, Pose};

use crate::arm::rub;
use crate::fidelity::ArmModel;
use crate::hash::Hash;
use crate::scene::{ArmConfig, Invalid, invalid};

/// Evaluations of inertia and bias in a step.
const PASSES: u32 = 2;
/// Iterations for the speeds at the end of a step; the equations are linear but for joints that
/// begin or cease to stick.
const ITERATIONS: u32 = 8;
/// Change of speed below which they have settled (rad/s).
const SETTLED_RAD_S: f64 = 1e-12;

/// An arm free of contact, whatever its number of joints.
pub(crate) trait Loose: Debug + Send + Sync {
    fn pose(&self) -> &Pose;
    fn twist(&self) -> Joints;
    /// One step of `h` seconds.
    fn step(&mut self, h: f64);
    /// Takes the codes that drive the amplifiers from now on, and the lines.
    fn drive(&mut self, codes: [i32; CHANNELS], enabled: bool, braked: bool);
    /// Incremental encoder counts, 0 behind the last joint.
    fn counts(&self) -> [i32; CHANNELS];
    /// What the encoders read in the home pose, in which they started, and their counts in a motor
    /// turn.
    fn home_counts(&self) -> (Vec<i32>, Vec<f64>);
    /// The codes that flow as current now.
    fn current_codes(&self) -> [i32; CHANNELS];
    /// Joint angles (rad) and speeds (rad/s).
    fn joints(&self) -> (&[f64], &[f64]);
    /// Drives on, brakes on.
    fn lines(&self) -> (bool, bool);
    fn energy_j(&self) -> f64;
    fn digest(&self, hash: &mut Hash);
    fn boxed(&self) -> Box<dyn Loose>;
}

impl Clone for Box<dyn Loose> {
    fn clone(&self) -> Box<dyn Loose> {
        self.boxed()
    }
}

/// The state of such an arm.
#[derive(Clone, Debug)]
pub(crate) struct Chained<const N: usize> {
    robot: ChainRobot<N>,
    friction: Friction<N>,
    start_counts: [i32; N],
    q: JointVector<N>,
    qd: JointVector<N>,
    bristle: JointVector<N>,
    codes: [i32; CHANNELS],
    torque: JointVector<N>,
    enabled: bool,
    braked: bool,
    pose: Pose,
}

impl<const N: usize> Chained<N> {
    /// At rest and braked at `start` (rad).
    pub(crate) fn new(
        robot: &ChainRobot<N>,
        start: &[f64],
        config: &ArmConfig,
        model: ArmModel,
    ) -> Result<Chained<N>, Invalid> {
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
        if model == ArmModel::Kinematic || !config.course_deg.is_empty() {
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
        Ok(Chained {
            start_counts: robot.gears.counts(&q),
            pose: robot.arm.tool_pose(&q),
            robot: robot.clone(),
            friction,
            q,
            qd: JointVector::zeros(),
            bristle: JointVector::zeros(),
            codes: [0; CHANNELS],
            torque: JointVector::zeros(),
            enabled: false,
            braked: true,
        })
    }

    /// Speeds at the end of a step from those at its beginning, with inertia and other torques
    /// held.
    fn speeds(
        &self,
        inertia: &JointMatrix<N>,
        push: &JointVector<N>,
        guess: JointVector<N>,
        h: f64,
    ) -> JointVector<N> {
        let mut speed = guess;
        for _ in 0..ITERATIONS {
            let mut matrix = *inertia;
            let mut off = inertia * (speed - self.qd) - push * h;
            for i in 0..N {
                let rub = rub(&self.friction, i, self.bristle[i], speed[i], h);
                off[i] += h * rub.torque_nm;
                matrix[(i, i)] += h * rub.slope;
            }
            let Some(factor) = matrix.cholesky() else { return self.qd };
            let change = factor.solve(&off);
            speed -= change;
            if change.amax() < SETTLED_RAD_S * (1.0 + speed.amax()) {
                break;
            }
        }
        speed
    }

    /// The hard stops: a joint that reaches one stays there without bouncing.
    fn stop_at_limits(&mut self) {
        let limits = self.robot.arm.limits();
        for i in 0..N {
            let inside = self.q[i].clamp(limits.q_min[i], limits.q_max[i]);
            if inside != self.q[i] {
                (self.q[i], self.qd[i]) = (inside, 0.0);
            }
        }
    }
}

impl<const N: usize> Loose for Chained<N> {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn twist(&self) -> Joints {
        self.robot.arm.jacobian_base(&self.q) * self.qd
    }

    fn step(&mut self, h: f64) {
        if self.braked {
            self.qd = JointVector::zeros();
            return;
        }
        let driven = if self.enabled { self.torque } else { JointVector::zeros() };
        let mut end = self.qd;
        for _ in 0..PASSES {
            let mean = (self.qd + end) * 0.5;
            let middle = self.q + mean * (0.5 * h);
            let push = driven - self.robot.arm.bias_torque(&middle, &mean);
            end = self.speeds(&self.robot.arm.mass_matrix(&middle), &push, end, h);
        }
        for i in 0..N {
            self.bristle[i] = rub(&self.friction, i, self.bristle[i], end[i], h).bristle_rad;
        }
        self.q += (self.qd + end) * (0.5 * h);
        self.qd = end;
        self.stop_at_limits();
        self.pose = self.robot.arm.tool_pose(&self.q);
    }

    fn drive(&mut self, codes: [i32; CHANNELS], enabled: bool, braked: bool) {
        (self.codes, self.enabled, self.braked) = (codes, enabled, braked);
        let motor_nm = JointVector::from_fn(|i, _| self.robot.drive.motor_torque_nm(codes[i], i));
        self.torque = self.robot.gears.joint_torque(&motor_nm);
    }

    fn counts(&self) -> [i32; CHANNELS] {
        let now = self.robot.gears.counts(&self.q);
        let mut out = [0; CHANNELS];
        for (i, count) in out.iter_mut().enumerate().take(N) {
            *count = now[i].wrapping_sub(self.start_counts[i]);
        }
        out
    }

    fn home_counts(&self) -> (Vec<i32>, Vec<f64>) {
        (vec![0; N], self.robot.gears.counts_per_revolution().as_slice().to_vec())
    }

    fn current_codes(&self) -> [i32; CHANNELS] {
        if self.enabled { self.codes } else { [0; CHANNELS] }
    }

    fn joints(&self) -> (&[f64], &[f64]) {
        (self.q.as_slice(), self.qd.as_slice())
    }

    fn lines(&self) -> (bool, bool) {
        (self.enabled, self.braked)
    }

    fn energy_j(&self) -> f64 {
        let arm = &self.robot.arm;
        0.5 * self.qd.dot(&(arm.mass_matrix(&self.q) * self.qd)) + arm.potential_energy_j(&self.q)
    }

    fn digest(&self, hash: &mut Hash) {
        for state in [&self.q, &self.qd, &self.bristle] {
            hash.numbers(state.as_slice());
        }
        hash.word(u64::from(self.enabled) << 1 | u64::from(self.braked));
        for code in self.codes {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }

    fn boxed(&self) -> Box<dyn Loose> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests;
