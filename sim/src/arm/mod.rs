//! The arm behind its motors: codes to currents to torques, friction that sticks, brakes, motion
//! of rigid bodies, encoder counts. Refuses to servo: it does what the codes say.
//!
//! Motion goes three ways: [`Arm::step`] is semi-implicit Euler, [`Arm::swing_freely`] the
//! classical fourth-order method for an arm that neither touches nor rubs, and [`Arm::ahead`] gives
//! an implicit stage what it needs.

mod course;
mod friction;
mod gear;

use taktil_hal::CHANNELS;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, LINKS, State, TOOL, rk4_step};
use taktil_mechanics::spatial::{SinCos, spatial_vector};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Matrix6, Pose};

use crate::fidelity::ArmModel;
use crate::finger::{Ahead, Swing};
use crate::hash::Hash;
use crate::scene::{ArmConfig, Invalid, invalid};
use course::Following;
pub(crate) use friction::{Rub, rub};
use gear::Gears;

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
    /// What gives way between motors and joints; none when nothing does.
    gears: Option<Gears>,
    /// What an arm without masses follows.
    following: Option<Box<Following>>,
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
    /// Angles at which the arm was looked at last, their sines and cosines.
    seen: (Joints, SinCos),
    age: u32,
    every: u32,
}

impl Arm {
    pub(crate) fn new(config: &ArmConfig, model: ArmModel, every: u32) -> Result<Arm, Invalid> {
        let puma = Puma260::reference();
        let transmission = Transmission::reference().with_encoder_scale(config.encoder_scale);
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
        let follows = model == ArmModel::Kinematic;
        if !follows && !config.course_deg.is_empty() {
            let what = "is given, but this arm moves by its torques".to_owned();
            let remedy = "say fidelity.arm = \"kinematic\", or leave the course out";
            return Err(invalid("arm.course_deg", what, remedy));
        }
        let following = match follows {
            true => Some(Box::new(Following::new(config, &puma, &q)?)),
            false => None,
        };
        let rubs = if follows || model == ArmModel::Rigid { 0.0 } else { 1.0 };
        let friction = Friction {
            coulomb_nm: rubs * config.coulomb_scale * reference.coulomb_nm,
            viscous_nms_rad: rubs * config.viscous_scale * reference.viscous_nms_rad,
        };
        let links =
            core::array::from_fn(|i| LINKS[i].with_density_factor(config.link_mass_scale[i]));
        let mut dynamics =
            Dynamics::from_bodies(links, &TOOL.with_density_factor(config.tool_mass_scale));
        let mut now = Swing { q, ..Swing::default() };
        let gears = (model == ArmModel::Compliant).then(|| {
            let stiffness = Joints::from(config.gear_stiffness_nm_rad);
            let gears =
                Gears::new(stiffness, config.gear_damping, dynamics.reflected_inertia_kg_m2);
            // The rotors are with the motors, not with the links.
            dynamics.reflected_inertia_kg_m2 = Joints::zeros();
            now.motor.q = gears.balanced(&q, &dynamics.gravity_torque(&q));
            gears
        });
        let turned = if gears.is_some() { now.motor.q } else { q };
        let mut arm = Arm {
            start_counts: transmission.counts(&turned),
            pose: puma.tool_pose(&q),
            puma,
            dynamics,
            transmission,
            drive: Drive::reference(),
            friction,
            gears,
            following,
            now,
            codes: [0; CHANNELS],
            torque: Joints::zeros(),
            enabled: false,
            braked: true,
            inertia_inverse: Matrix6::zeros(),
            bias: Joints::zeros(),
            jacobian: Matrix6::zeros(),
            seen: (q, SinCos::new(&q)),
            age: 0,
            every,
        };
        arm.refresh();
        Ok(arm)
    }

    /// Mass that a force along the finger's axis feels at the start (kg); none where it moves
    /// nothing.
    pub(crate) fn mass_at_tool_kg(&self) -> Option<f64> {
        if self.following.is_some() {
            return None;
        }
        let normal = self.pose.rotation.z_axis;
        let lever = self.jacobian.tr_mul(&spatial_vector(normal, glam::DVec3::ZERO));
        Some(1.0 / lever.dot(&(self.inertia_inverse * lever)))
    }

    /// Whether nothing sticks: the torques are smooth in the state.
    pub(crate) fn is_smooth(&self) -> bool {
        self.gears.is_none() && self.friction.coulomb_nm == Joints::zeros()
    }

    /// Takes the codes that drive the amplifiers from now on.
    pub(crate) fn drive(&mut self, codes: [i32; CHANNELS]) {
        self.codes = codes;
        let mut motor_nm = Joints::zeros();
        for i in 0..JOINTS {
            motor_nm[i] = self.drive.motor_torque_nm(codes[i], i);
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

    /// The part of it that acts on the joints themselves.
    fn on_joints(&self) -> Joints {
        if self.gears.is_some() { Joints::zeros() } else { self.driven() }
    }

    /// Evaluates inertia, bias torques and Jacobian at the present state.
    fn refresh(&mut self) {
        let inertia = self.dynamics.mass_matrix(&self.now.q);
        if let Some(factor) = inertia.cholesky() {
            self.inertia_inverse = factor.inverse();
        }
        self.bias = self.dynamics.bias_torque(&self.now.q, &self.now.qd);
        self.jacobian = self.puma.jacobian_base(&self.now.q);
        self.age = 0;
    }

    /// Tool frame and Jacobian of the present state, for whoever looks between steps.
    pub(crate) fn settle(&mut self, t_s: f64) {
        if let Some(following) = &mut self.following {
            following.t_s = t_s;
            (self.now.q, self.now.qd) = following.at(t_s);
        }
        self.seen = (self.now.q, SinCos::new(&self.now.q));
        (self.pose, self.jacobian) = self.puma.tool_and_jacobian_at(&self.seen.1);
        self.age = self.every;
    }

    /// One semi-implicit Euler step of `h` seconds under a wrench on the tool (N, N m about the
    /// tool point, base frame).
    pub(crate) fn step(&mut self, h: f64, wrench: &Joints) {
        if let Some(following) = &self.following {
            let next_s = following.t_s + h;
            self.settle(next_s);
            return;
        }
        if self.braked {
            self.rest();
            return;
        }
        if self.age >= self.every {
            self.refresh();
        }
        self.age += 1;
        let mut torque = self.jacobian.tr_mul(wrench) - self.bias + self.on_joints();
        let base = self.now;
        for i in 0..JOINTS {
            let rub = self.rub(&base, i, base.qd[i], h);
            self.now.bristle[i] = rub.bristle_rad;
            if let Some((angle, speed)) = rub.motor {
                (self.now.motor.q[i], self.now.motor.qd[i]) = (angle, speed);
            }
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
        if self.following.is_some() {
            return;
        }
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
            self.rest();
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
    /// joints end it at the speeds `guess`, which is at `end_s`.
    pub(crate) fn ahead(&self, base: &Swing, guess: &Joints, h: f64, end_s: f64) -> Ahead {
        if let Some(following) = &self.following {
            let (q, qd) = following.at(end_s);
            let (pose, jacobian) = self.puma.tool_and_jacobian_at(&SinCos::new(&q));
            return Ahead::fixed(pose, jacobian * qd);
        }
        if self.braked {
            return Ahead::fixed(self.pose, Joints::zeros());
        }
        let (q, (seen, sines)) = (base.q + h * guess, &self.seen);
        let at = sines.incremented(&(q - seen)).unwrap_or_else(|| SinCos::new(&q));
        let (pose, jacobian) = self.puma.tool_and_jacobian_at(&at);
        Ahead {
            degrees: JOINTS,
            inertia: self.dynamics.mass_matrix_at(&at),
            push: self.on_joints() - self.dynamics.bias_torque_at(&at, guess),
            jacobian,
            pose,
            carried: Joints::zeros(),
            guess: *guess,
            at,
        }
    }

    /// Torques beside friction at other speeds (rad/s) than those that [`Arm::ahead`] guessed.
    pub(crate) fn push(&self, at: &SinCos, speeds: &Joints) -> Joints {
        self.on_joints() - self.dynamics.bias_torque_at(at, speeds)
    }

    /// What joint `i` feels at the end of a stage beside its torque: friction, or its gear.
    pub(crate) fn rub(&self, base: &Swing, i: usize, speed: f64, h: f64) -> Rub {
        match &self.gears {
            None => rub(&self.friction, i, base.bristle[i], speed, h),
            Some(gears) => gears.pull((base, i), (speed, h), self.driven()[i], &self.friction),
        }
    }

    /// The brakes hold motors and joints.
    fn rest(&mut self) {
        (self.now.qd, self.now.motor.qd) = (Joints::zeros(), Joints::zeros());
    }

    /// Whether the joints follow a course, whatever acts on them.
    pub(crate) fn is_led(&self) -> bool {
        self.following.is_some()
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
        let turned = if self.gears.is_some() { &self.now.motor.q } else { &self.now.q };
        let now = self.transmission.counts(turned);
        core::array::from_fn(|i| now[i].wrapping_sub(self.start_counts[i]))
    }

    /// What the encoders read in the home pose that they were to have at power-up, and their counts
    /// in a motor turn.
    pub(crate) fn home_counts(&self, config: &ArmConfig) -> (Vec<i32>, Vec<f64>) {
        let home = Joints::from_fn(|i, _| config.home_deg[i].to_radians());
        // Behind gears that give way the motors stand where gravity holds the joints.
        let held = |gears: &Gears| gears.balanced(&home, &self.dynamics.gravity_torque(&home));
        let home = self.transmission.counts(&self.gears.as_ref().map_or(home, held));
        let read = (0..JOINTS).map(|i| home[i].wrapping_sub(self.start_counts[i])).collect();
        (read, self.transmission.counts_per_revolution().as_slice().to_vec())
    }

    /// The codes that flow as current now; none when the drives are off.
    pub(crate) fn current_codes(&self) -> [i32; CHANNELS] {
        if self.enabled { self.codes } else { [0; CHANNELS] }
    }

    /// Kinetic and potential energy (J).
    pub(crate) fn energy_j(&self) -> f64 {
        let Swing { q, qd, .. } = &self.now;
        let gears_j = self.gears.map_or(0.0, |gears| gears.energy_j(&self.now));
        self.dynamics.kinetic_energy_j(q, qd) + self.dynamics.potential_energy_j(q) + gears_j
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.now.digest(hash);
        if self.gears.is_some() {
            hash.numbers(self.now.motor.q.as_slice());
            hash.numbers(self.now.motor.qd.as_slice());
        }
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
        self.dynamics.kinetic_energy_j(&self.now.q, &self.now.qd)
    }
}

#[cfg(test)]
mod tests;
