//! The arm behind its motors: codes to currents to torques, friction that sticks, brakes, motion
//! of rigid bodies, encoder counts. Refuses to servo: it does what the codes say.
//!
//! Motion goes three ways: [`Arm::step`] is semi-implicit Euler, [`Arm::swing_freely`] the
//! classical fourth-order method for an arm that neither touches nor rubs, and [`Arm::ahead`] gives
//! an implicit stage what it needs.

mod friction;

use taktil_hal::CHANNELS;
use taktil_mechanics::dynamics::{Dynamics, Friction, State, rk4_step};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::stack;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::fidelity::ArmModel;
use crate::finger::{Ahead, Swing};
use crate::hash::Hash;
use crate::scene::{ArmConfig, Invalid, invalid};
pub(crate) use friction::{Rub, rub};

/// Joints that are driven.
pub(crate) const JOINTS: usize = 6;

/// State of the arm.
#[derive(Clone, Debug)]
pub(crate) struct Arm {
    puma: Puma260,
    dynamics: Dynamics,
    transmission: Transmission,
    drive: Drive,
    friction: Friction,
    start_counts: [i32; JOINTS],
    pub(crate) now: Swing,
    codes: [i32; CHANNELS],
    torque: Joints,
    pub(crate) enabled: bool,
    pub(crate) braked: bool,
    inertia_inverse: Matrix6,
    bias: Joints,
    jacobian: Matrix6,
    pose: Pose,
    age: u32,
    every: u32,
}

impl Arm {
    pub(crate) fn new(config: &ArmConfig, model: ArmModel, every: u32) -> Result<Arm, Invalid> {
        let puma = Puma260::reference();
        let transmission = Transmission::reference();
        let q =
            Joints::from_fn(|i, _| (config.home_deg[i] + config.zero_error_deg[i]).to_radians());
        for i in 0..JOINTS {
            let (low, high) = (puma.q_min_rad[i], puma.q_max_rad[i]);
            if !(low..=high).contains(&q[i]) {
                let what = format!("is {}, outside the joint's range", config.home_deg[i]);
                let remedy =
                    format!("give {:.1} to {:.1} deg", low.to_degrees(), high.to_degrees());
                return Err(invalid(&format!("arm.home_deg[{i}]"), what, &remedy));
            }
        }
        let reference = Friction::reference();
        let rubs = if model == ArmModel::Rigid { 0.0 } else { 1.0 };
        let friction = Friction {
            coulomb_nm: rubs * config.coulomb_scale * reference.coulomb_nm,
            viscous_nms_rad: rubs * config.viscous_scale * reference.viscous_nms_rad,
        };
        let mut arm = Arm {
            start_counts: transmission.counts(&q),
            pose: puma.tool_pose(&q),
            puma,
            dynamics: Dynamics::reference(),
            transmission,
            drive: Drive::reference(),
            friction,
            now: Swing { q, ..Swing::default() },
            codes: [0; CHANNELS],
            torque: Joints::zeros(),
            enabled: false,
            braked: true,
            inertia_inverse: Matrix6::zeros(),
            bias: Joints::zeros(),
            jacobian: Matrix6::zeros(),
            age: 0,
            every,
        };
        arm.refresh();
        Ok(arm)
    }

    /// Mass that a force along the finger's axis feels at the start (kg).
    pub(crate) fn mass_at_tool_kg(&self) -> f64 {
        let normal = self.pose.rotation.z_axis;
        let lever = self.jacobian.tr_mul(&stack(normal, glam::DVec3::ZERO));
        1.0 / lever.dot(&(self.inertia_inverse * lever))
    }

    /// Whether nothing sticks: the torques are smooth in the state.
    pub(crate) fn is_smooth(&self) -> bool {
        self.friction.coulomb_nm == Joints::zeros()
    }

    /// Takes the codes that drive the amplifiers from now on.
    pub(crate) fn drive(&mut self, codes: [i32; CHANNELS]) {
        self.codes = codes;
        let mut motor_nm = Joints::zeros();
        for i in 0..JOINTS {
            motor_nm[i] = self.drive.torque(codes[i], i);
        }
        self.torque = self.transmission.joint_torque(&motor_nm);
    }

    /// The tool frame.
    pub(crate) fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Velocity of the tool point and angular velocity of the tool, stacked.
    pub(crate) fn twist(&self) -> Joints {
        self.jacobian * self.now.qd
    }

    /// Torque of the motors (N m), none when the drives are off.
    fn driven(&self) -> Joints {
        if self.enabled { self.torque } else { Joints::zeros() }
    }

    /// Evaluates inertia, bias torques and Jacobian at the present state.
    fn refresh(&mut self) {
        let inertia = self.dynamics.mass_matrix(&self.now.q);
        if let Some(factor) = inertia.cholesky() {
            self.inertia_inverse = factor.inverse();
        }
        self.bias = self.dynamics.bias(&self.now.q, &self.now.qd);
        self.jacobian = self.puma.jacobian_base(&self.now.q);
        self.age = 0;
    }

    /// Tool frame and Jacobian of the present state, for whoever looks between steps.
    pub(crate) fn settle(&mut self) {
        self.pose = self.puma.tool_pose(&self.now.q);
        self.jacobian = self.puma.jacobian_base(&self.now.q);
        self.age = self.every;
    }

    /// One semi-implicit Euler step of `h` seconds under a wrench on the tool (N, N m about the
    /// tool point, base frame).
    pub(crate) fn step(&mut self, h: f64, wrench: &Joints) {
        if self.braked {
            self.now.qd = Joints::zeros();
            return;
        }
        if self.age >= self.every {
            self.refresh();
        }
        self.age += 1;
        let mut torque = self.jacobian.tr_mul(wrench) - self.bias + self.driven();
        for i in 0..JOINTS {
            let rub = rub(&self.friction, i, self.now.bristle[i], self.now.qd[i], h);
            self.now.bristle[i] = rub.bristle_rad;
            torque[i] -= rub.torque_nm;
        }
        self.now.qd += h * (self.inertia_inverse * torque);
        self.now.q += h * self.now.qd;
        self.stop_at_limits();
        self.pose = self.puma.tool_pose(&self.now.q);
    }

    /// One step of `h` seconds of the classical fourth-order method with the torque of the codes
    /// held, for an arm without sticking friction.
    pub(crate) fn swing_freely(&mut self, h: f64) {
        let held = self.driven();
        self.swing_under(0.0, h, &mut |_, _, _| held);
    }

    /// The same under any torque of time, angles and speeds beside gravity and viscous friction.
    fn swing_under(
        &mut self,
        t_s: f64,
        h: f64,
        torque_nm: &mut impl FnMut(f64, &Joints, &Joints) -> Joints,
    ) {
        if self.braked {
            self.now.qd = Joints::zeros();
            return;
        }
        let viscous = self.friction.viscous_nms_rad;
        let mut all =
            |t: f64, q: &Joints, qd: &Joints| torque_nm(t, q, qd) - viscous.component_mul(qd);
        let state = State { q: self.now.q, qd: self.now.qd };
        let next = rk4_step(&self.dynamics, &state, t_s, h, &mut all);
        (self.now.q, self.now.qd) = (next.q, next.qd);
    }

    /// Inertia, torques and kinematics at the end of a stage of `h` seconds from `base`, if the
    /// joints end it at the speeds `guess`.
    pub(crate) fn ahead(&self, base: &Swing, guess: &Joints, h: f64) -> Ahead {
        if self.braked {
            return Ahead::fixed(self.pose, Joints::zeros());
        }
        let q = base.q + h * guess;
        Ahead {
            degrees: JOINTS,
            inertia: self.dynamics.mass_matrix(&q),
            push: self.driven() - self.dynamics.bias(&q, guess),
            jacobian: self.puma.jacobian_base(&q),
            pose: self.puma.tool_pose(&q),
            carried: Joints::zeros(),
            guess: *guess,
        }
    }

    /// Torques beside friction at the end of a stage, as in [`Arm::ahead`].
    pub(crate) fn push(&self, base: &Swing, guess: &Joints, h: f64) -> Joints {
        self.driven() - self.dynamics.bias(&(base.q + h * guess), guess)
    }

    /// Friction of joint `i` at the end of a stage.
    pub(crate) fn rub(&self, base: &Swing, i: usize, speed: f64, h: f64) -> Rub {
        rub(&self.friction, i, base.bristle[i], speed, h)
    }

    /// Whether a joint stands beyond its stops.
    pub(crate) fn beyond_limits(&self) -> bool {
        let (low, high) = (&self.puma.q_min_rad, &self.puma.q_max_rad);
        (0..JOINTS).any(|i| !(low[i]..=high[i]).contains(&self.now.q[i]))
    }

    /// The hard stops: a joint that reaches one stays there without bouncing.
    pub(crate) fn stop_at_limits(&mut self) {
        for i in 0..JOINTS {
            let inside = self.now.q[i].clamp(self.puma.q_min_rad[i], self.puma.q_max_rad[i]);
            if inside != self.now.q[i] {
                self.now.q[i] = inside;
                self.now.qd[i] = 0.0;
            }
        }
    }

    /// Incremental encoder counts: zero at power-up, the phase of the discs kept.
    pub(crate) fn counts(&self) -> [i32; JOINTS] {
        let now = self.transmission.counts(&self.now.q);
        core::array::from_fn(|i| now[i].wrapping_sub(self.start_counts[i]))
    }

    /// The codes that flow as current now; none when the drives are off.
    pub(crate) fn current_codes(&self) -> [i32; CHANNELS] {
        if self.enabled { self.codes } else { [0; CHANNELS] }
    }

    /// Kinetic and potential energy (J).
    pub(crate) fn energy_j(&self) -> f64 {
        let Swing { q, qd, .. } = &self.now;
        self.dynamics.kinetic_j(q, qd) + self.dynamics.potential_j(q)
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.now.digest(hash);
        hash.word(u64::from(self.age) << 2 | u64::from(self.enabled) << 1 | u64::from(self.braked));
        for code in self.codes {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }
}

#[cfg(test)]
impl Arm {
    /// Lets the joints turn for ever.
    pub(crate) fn without_stops(&mut self) {
        self.puma.q_min_rad.fill(f64::NEG_INFINITY);
        self.puma.q_max_rad.fill(f64::INFINITY);
    }

    /// Energy of motion (J).
    pub(crate) fn kinetic_j(&self) -> f64 {
        self.dynamics.kinetic_j(&self.now.q, &self.now.qd)
    }
}

#[cfg(test)]
mod tests;
