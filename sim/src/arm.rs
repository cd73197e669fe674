//! The arm behind its motors: codes to currents to torques, friction that sticks, brakes, motion
//! of rigid bodies, encoder counts. Refuses to servo: it does what the codes say.
//!
//! Friction is an elasto-plastic bristle per joint: stiffness `fc / 1e-4 rad`, damped, yielding at
//! the Coulomb torque, so that a joint at rest really rests; viscous friction is added.

use taktil_hal::CHANNELS;
use taktil_mechanics::dynamics::{Dynamics, Friction};
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::spatial::stack;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::hash::Hash;
use crate::scene::{ArmConfig, Invalid, invalid};

/// Joint displacement at which a bristle yields (rad).
const BRISTLE_RAD: f64 = 1e-4;
/// Damping of a bristle over its stiffness (s).
const BRISTLE_DAMPING_S: f64 = 1e-3;
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
    pub(crate) q: Joints,
    pub(crate) qd: Joints,
    bristle: Joints,
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
    pub(crate) fn new(config: &ArmConfig, every: u32) -> Result<Arm, Invalid> {
        let puma = Puma260::reference();
        let transmission = Transmission::reference();
        let q = Joints::from(config.home_deg.map(f64::to_radians));
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
        let friction = Friction {
            coulomb_nm: config.coulomb_scale * reference.coulomb_nm,
            viscous_nms_rad: config.viscous_scale * reference.viscous_nms_rad,
        };
        let mut arm = Arm {
            start_counts: transmission.counts(&q),
            pose: puma.tool_pose(&q),
            puma,
            dynamics: Dynamics::reference(),
            transmission,
            drive: Drive::reference(),
            friction,
            q,
            qd: Joints::zeros(),
            bristle: Joints::zeros(),
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
        self.jacobian * self.qd
    }

    /// Evaluates inertia, bias torques and Jacobian at the present state.
    fn refresh(&mut self) {
        let inertia = self.dynamics.mass_matrix(&self.q);
        if let Some(factor) = inertia.cholesky() {
            self.inertia_inverse = factor.inverse();
        }
        self.bias = self.dynamics.bias(&self.q, &self.qd);
        self.jacobian = self.puma.jacobian_base(&self.q);
        self.age = 0;
    }

    /// One semi-implicit Euler step of `h` seconds under a wrench on the tool (N, N m about the
    /// tool point, base frame).
    pub(crate) fn step(&mut self, h: f64, wrench: &Joints) {
        if self.braked {
            self.qd = Joints::zeros();
            return;
        }
        if self.age >= self.every {
            self.refresh();
        }
        self.age += 1;
        let mut torque = self.jacobian.tr_mul(wrench) - self.bias;
        if self.enabled {
            torque += self.torque;
        }
        for i in 0..JOINTS {
            torque[i] -= self.friction_nm(i, h);
        }
        self.qd += h * (self.inertia_inverse * torque);
        self.q += h * self.qd;
        self.stop_at_limits();
        self.pose = self.puma.tool_pose(&self.q);
    }

    /// Moves the bristle of a joint on and returns its torque with the viscous one.
    fn friction_nm(&mut self, i: usize, h: f64) -> f64 {
        let (speed, coulomb) = (self.qd[i], self.friction.coulomb_nm[i]);
        let deflection = (self.bristle[i] + h * speed).clamp(-BRISTLE_RAD, BRISTLE_RAD);
        self.bristle[i] = deflection;
        let elastic = coulomb / BRISTLE_RAD * (deflection + BRISTLE_DAMPING_S * speed);
        elastic.clamp(-coulomb, coulomb) + self.friction.viscous_nms_rad[i] * speed
    }

    /// The hard stops: a joint that reaches one stays there without bouncing.
    fn stop_at_limits(&mut self) {
        for i in 0..JOINTS {
            let inside = self.q[i].clamp(self.puma.q_min_rad[i], self.puma.q_max_rad[i]);
            if inside != self.q[i] {
                self.q[i] = inside;
                self.qd[i] = 0.0;
            }
        }
    }

    /// Incremental encoder counts: zero at power-up, the phase of the discs kept.
    pub(crate) fn counts(&self) -> [i32; JOINTS] {
        let now = self.transmission.counts(&self.q);
        core::array::from_fn(|i| now[i].wrapping_sub(self.start_counts[i]))
    }

    /// The codes that flow as current now; none when the drives are off.
    pub(crate) fn current_codes(&self) -> [i32; CHANNELS] {
        if self.enabled { self.codes } else { [0; CHANNELS] }
    }

    /// Kinetic and potential energy (J).
    pub(crate) fn energy_j(&self) -> f64 {
        self.dynamics.kinetic_j(&self.q, &self.qd) + self.dynamics.potential_j(&self.q)
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.numbers(self.q.as_slice());
        hash.numbers(self.qd.as_slice());
        hash.numbers(self.bristle.as_slice());
        hash.word(u64::from(self.age) << 2 | u64::from(self.enabled) << 1 | u64::from(self.braked));
        for code in self.codes {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }
}
