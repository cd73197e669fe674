//! The PUMA 260 behind its motors: codes to currents to torques, friction that sticks, brakes,
//! motion of rigid bodies, encoder counts. It contains no controller: the codes alone drive it.
//!
//! The arm moves in one of three ways: [`Coordinates::step`] is semi-implicit Euler,
//! [`Coordinates::step_rk4`] the classical fourth-order method for an arm that neither touches nor
//! rubs, and [`Coordinates::predict_stage`] gives an implicit stage what it needs.

mod gear;
mod prescribed;

use taktil_hal::CHANNELS;
use taktil_mechanics::friction::Friction;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::puma260::dynamics::{Dynamics, LINKS, State, TOOL, rk4_step};
use taktil_mechanics::spatial::{SinCos, spatial_vector};
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_mechanics::{Joints, Matrix6, Pose};

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
use gear::{CompliantGears, JointStage};
use prescribed::PrescribedMotion;

/// Joints that are driven.
pub(crate) const JOINT_COUNT: usize = 6;
/// Largest distance of the finger from a joint's axis, roughly (m).
const REACH_M: f64 = 0.5;

/// State of the arm.
#[derive(Clone, Debug)]
pub(crate) struct Arm {
    puma: Puma260,
    dynamics: Dynamics,
    transmission: Transmission,
    drive: Drive,
    friction: Friction,
    /// The gears between motors and joints, if they are compliant.
    gears: Option<CompliantGears>,
    /// The trajectory of an arm without masses.
    prescribed: Option<Box<PrescribedMotion>>,
    start_counts: [i32; JOINT_COUNT],
    /// Angles of the home pose without zero errors (rad).
    home: Joints,
    pub(crate) state: ArmState,
    codes: [i32; CHANNELS],
    torque: Joints,
    pub(crate) lines: DriveLines,
    inertia_inverse: Matrix6,
    bias: Joints,
    jacobian: Matrix6,
    pose: Pose,
    /// Angles of the latest evaluation of the kinematics, their sines and cosines.
    reference_q: Joints,
    reference_sin_cos: SinCos,
    /// Explicit steps since inertia, bias and Jacobian were evaluated, and how many there are
    /// between two evaluations.
    steps_since_refresh: u32,
    refresh_interval: u32,
}

impl Arm {
    /// The arm at rest in its home pose with its zero errors, braked. Explicit steps evaluate
    /// inertia, bias and Jacobian anew after `refresh_interval` steps.
    pub(crate) fn new(
        config: &ArmConfig,
        model: ArmModel,
        refresh_interval: u32,
    ) -> Result<Arm, Invalid> {
        let puma = Puma260::reference();
        let transmission = Transmission::reference().with_encoder_scale(config.encoder_scale);
        let q = start_angles(config, &puma)?;
        let reference = Friction::reference();
        let is_prescribed = model == ArmModel::Kinematic;
        if !is_prescribed && !config.trajectory_deg.is_empty() {
            let what = "is given, but this arm moves by its torques".to_owned();
            let remedy = "say fidelity.arm = \"kinematic\", or leave the course out";
            return Err(invalid("arm.trajectory_deg", what, remedy));
        }
        let prescribed = match is_prescribed {
            true => Some(Box::new(PrescribedMotion::new(config, &puma, &q)?)),
            false => None,
        };
        let rubs = if is_prescribed || model == ArmModel::Rigid { 0.0 } else { 1.0 };
        let friction = Friction {
            coulomb_nm: rubs * config.coulomb_scale * reference.coulomb_nm,
            viscous_nms_rad: rubs * config.viscous_scale * reference.viscous_nms_rad,
        };
        let links =
            core::array::from_fn(|i| LINKS[i].with_density_factor(config.link_mass_scale[i]));
        let mut dynamics =
            Dynamics::from_bodies(links, &TOOL.with_density_factor(config.tool_mass_scale));
        let mut state = ArmState { q, ..ArmState::default() };
        let gears = (model == ArmModel::Compliant).then(|| {
            let stiffness = Joints::from(config.gear_stiffness_nm_rad);
            let gears = CompliantGears::new(
                stiffness,
                config.gear_damping,
                dynamics.reflected_inertia_kg_m2,
            );
            // The rotors are with the motors, not with the links.
            dynamics.reflected_inertia_kg_m2 = Joints::zeros();
            state.rotors.q = gears.static_rotor_angles(&q, &dynamics.gravity_torque(&q));
            gears
        });
        let motor_q = if gears.is_some() { state.rotors.q } else { q };
        let mut arm = Arm {
            start_counts: transmission.counts(&motor_q),
            home: Joints::from_fn(|i, _| config.home_deg[i].to_radians()),
            pose: puma.tool_pose(&q),
            puma,
            dynamics,
            transmission,
            drive: Drive::reference(),
            friction,
            gears,
            prescribed,
            state,
            codes: [0; CHANNELS],
            torque: Joints::zeros(),
            lines: DriveLines::SAFE,
            inertia_inverse: Matrix6::zeros(),
            bias: Joints::zeros(),
            jacobian: Matrix6::zeros(),
            reference_q: q,
            reference_sin_cos: SinCos::new(&q),
            steps_since_refresh: 0,
            refresh_interval,
        };
        arm.refresh();
        Ok(arm)
    }

    /// Mass that a force along the finger's axis feels at the start (kg); none where it moves
    /// nothing.
    pub(crate) fn mass_at_tool_kg(&self) -> Option<f64> {
        if self.prescribed.is_some() {
            return None;
        }
        let normal = self.pose.rotation.z_axis;
        let lever = self.jacobian.tr_mul(&spatial_vector(normal, glam::DVec3::ZERO));
        Some(1.0 / lever.dot(&(self.inertia_inverse * lever)))
    }

    /// Torque of the motors on the joints' side (N m), zero when the drives are off.
    fn motor_torque(&self) -> Joints {
        if self.lines.enabled { self.torque } else { Joints::zeros() }
    }

    /// The part of the motors' torque that acts on the joints directly, not through springs (N m).
    fn direct_torque(&self) -> Joints {
        if self.gears.is_some() { Joints::zeros() } else { self.motor_torque() }
    }

    /// Evaluates inertia, bias torques and Jacobian at the present state.
    fn refresh(&mut self) {
        let inertia = self.dynamics.mass_matrix(&self.state.q);
        if let Some(factor) = inertia.cholesky() {
            self.inertia_inverse = factor.inverse();
        }
        self.bias = self.dynamics.bias_torque(&self.state.q, &self.state.qd);
        self.jacobian = self.puma.jacobian_base(&self.state.q);
        self.steps_since_refresh = 0;
    }

    /// One step of the classical Runge-Kutta method under any torque of time, angles and speeds
    /// beside gravity and viscous friction.
    fn step_rk4_under(
        &mut self,
        t_s: f64,
        h: f64,
        torque_nm: &mut impl FnMut(f64, &Joints, &Joints) -> Joints,
    ) {
        if self.lines.braked {
            self.hold_by_brakes();
            return;
        }
        let viscous = self.friction.viscous_nms_rad;
        let mut all =
            |t: f64, q: &Joints, qd: &Joints| torque_nm(t, q, qd) - viscous.component_mul(qd);
        let state = State { q: self.state.q, qd: self.state.qd };
        let next = rk4_step(&self.dynamics, &state, t_s, h, &mut all);
        (self.state.q, self.state.qd) = (next.q, next.qd);
    }

    /// Stops motors and joints.
    fn hold_by_brakes(&mut self) {
        (self.state.qd, self.state.rotors.qd) = (Joints::zeros(), Joints::zeros());
    }
}

/// Angles of the joints at power-up (rad): the home pose and its zero errors.
fn start_angles(config: &ArmConfig, puma: &Puma260) -> Result<Joints, Invalid> {
    let q = Joints::from_fn(|i, _| (config.home_deg[i] + config.zero_error_deg[i]).to_radians());
    for i in 0..JOINT_COUNT {
        let (low, high) = (puma.q_min_rad[i], puma.q_max_rad[i]);
        if !(low..=high).contains(&q[i]) {
            let what = format!("is {}, outside the joint's range", config.home_deg[i]);
            let remedy = format!("give {:.1} to {:.1} deg", low.to_degrees(), high.to_degrees());
            return Err(invalid(&format!("arm.home_deg[{i}]"), what, &remedy));
        }
    }
    Ok(q)
}

impl Manipulator for Arm {
    fn pose(&self) -> &Pose {
        &self.pose
    }

    fn twist(&self) -> Joints {
        self.jacobian * self.state.qd
    }

    fn is_prescribed(&self) -> bool {
        self.prescribed.is_some()
    }

    fn is_smooth(&self) -> bool {
        self.gears.is_none() && self.friction.coulomb_nm == Joints::zeros()
    }

    fn has_compliant_gears(&self) -> bool {
        self.gears.is_some()
    }

    fn lever_m(&self) -> f64 {
        REACH_M
    }

    fn is_beyond_limits(&self) -> bool {
        let (low, high) = (&self.puma.q_min_rad, &self.puma.q_max_rad);
        (0..JOINT_COUNT).any(|i| !(low[i]..=high[i]).contains(&self.state.q[i]))
    }

    fn stop_at_limits(&mut self) {
        let (low, high) = (&self.puma.q_min_rad, &self.puma.q_max_rad);
        let ArmState { q, qd, .. } = &mut self.state;
        let inertia = |q: &Joints| self.dynamics.mass_matrix(q);
        stop_at_limits(q, qd, |i| (low[i], high[i]), inertia);
    }

    fn drive(&mut self, codes: &[i32; CHANNELS], lines: DriveLines) {
        (self.codes, self.lines) = (*codes, lines);
        let mut motor_nm = Joints::zeros();
        for i in 0..JOINT_COUNT {
            motor_nm[i] = self.drive.motor_torque_nm(codes[i], i);
        }
        self.torque = self.transmission.joint_torque(&motor_nm);
    }

    fn drive_lines(&self) -> DriveLines {
        self.lines
    }

    /// The counts are zero at power-up; the phase of the encoder discs is kept.
    fn counts(&self) -> [i32; CHANNELS] {
        let motor_q = if self.gears.is_some() { &self.state.rotors.q } else { &self.state.q };
        let now = self.transmission.counts(motor_q);
        let mut counts = [0; CHANNELS];
        for (i, count) in counts.iter_mut().enumerate().take(JOINT_COUNT) {
            *count = now[i].wrapping_sub(self.start_counts[i]);
        }
        counts
    }

    fn motor_motion(&self) -> MotorMotion {
        let is_compliant = self.gears.is_some();
        let ArmState { q, qd, rotors, .. } = &self.state;
        let (q, qd) = if is_compliant { (&rotors.q, &rotors.qd) } else { (q, qd) };
        let counts = self.transmission.exact_counts(q) - counts_of(&self.start_counts);
        motor_motion(&counts, &self.transmission.exact_counts(qd))
    }

    fn codes_per_acceleration(&self) -> Option<Vec<f64>> {
        let inertia = self.dynamics.mass_matrix(&self.state.q);
        Some(codes_per_acceleration(&inertia, &self.transmission, &self.drive))
    }

    fn home_counts(&self) -> Option<HomeCounts> {
        // Behind compliant gears the motors stand where gravity holds the joints.
        let sagged = |gears: &CompliantGears| {
            gears.static_rotor_angles(&self.home, &self.dynamics.gravity_torque(&self.home))
        };
        let home = self.transmission.counts(&self.gears.as_ref().map_or(self.home, sagged));
        let counts = (0..JOINT_COUNT).map(|i| home[i].wrapping_sub(self.start_counts[i])).collect();
        let counts_per_turn = self.transmission.counts_per_revolution().as_slice().to_vec();
        Some(HomeCounts { counts, counts_per_turn })
    }

    fn current_codes(&self) -> [i32; CHANNELS] {
        if self.lines.enabled { self.codes } else { [0; CHANNELS] }
    }

    fn joints(&self) -> (&[f64], &[f64]) {
        (self.state.q.as_slice(), self.state.qd.as_slice())
    }

    fn puma_state(&self) -> Option<&ArmState> {
        Some(&self.state)
    }

    fn energy_j(&self) -> f64 {
        let ArmState { q, qd, .. } = &self.state;
        let gears_j = self.gears.map_or(0.0, |gears| gears.energy_j(&self.state));
        self.dynamics.kinetic_energy_j(q, qd) + self.dynamics.potential_energy_j(q) + gears_j
    }

    fn digest(&self, hash: &mut Hash) {
        self.state.digest(hash);
        if self.gears.is_some() {
            hash.numbers(self.state.rotors.q.as_slice());
            hash.numbers(self.state.rotors.qd.as_slice());
        }
        let DriveLines { enabled, braked } = self.lines;
        let steps = u64::from(self.steps_since_refresh);
        hash.word(steps << 2 | u64::from(enabled) << 1 | u64::from(braked));
        for code in self.codes.iter().take(JOINTS_MAX) {
            hash.word(u64::from(code.cast_unsigned()));
        }
    }
}

impl Coordinates<6> for Arm {
    fn state(&self) -> &ArmState {
        &self.state
    }

    fn state_mut(&mut self) -> &mut ArmState {
        &mut self.state
    }

    fn step(&mut self, h: f64, wrench: &Joints) {
        if let Some(prescribed) = &self.prescribed {
            let next_s = prescribed.t_s + h;
            self.update_kinematics(next_s);
            return;
        }
        if self.lines.braked {
            self.hold_by_brakes();
            return;
        }
        if self.steps_since_refresh >= self.refresh_interval {
            self.refresh();
        }
        self.steps_since_refresh += 1;
        let mut torque = self.jacobian.tr_mul(wrench) - self.bias + self.direct_torque();
        let base = self.state;
        for i in 0..JOINT_COUNT {
            let resisting = self.resisting_torque(&base, i, base.qd[i], h);
            self.state.bristle[i] = resisting.bristle_rad;
            if let Some(rotor) = resisting.rotor {
                self.state.rotors.q[i] = rotor.angle_rad;
                self.state.rotors.qd[i] = rotor.speed_rad_s;
            }
            torque[i] -= resisting.torque_nm;
        }
        self.state.qd += h * (self.inertia_inverse * torque);
        self.state.q += h * self.state.qd;
        self.stop_at_limits();
        self.pose = self.puma.tool_pose(&self.state.q);
    }

    /// The torque of the codes is held during the step.
    fn step_rk4(&mut self, h: f64) {
        if self.prescribed.is_some() {
            return;
        }
        let held = self.motor_torque();
        self.step_rk4_under(0.0, h, &mut |_, _, _| held);
    }

    fn predict_stage(&self, base: &ArmState, guess: &Joints, h: f64, end_s: f64) -> StagePredictor {
        if let Some(prescribed) = &self.prescribed {
            let (q, qd) = prescribed.at(end_s);
            let (pose, jacobian) = self.puma.tool_and_jacobian_at(&SinCos::new(&q));
            return StagePredictor::prescribed(pose, jacobian * qd);
        }
        if self.lines.braked {
            return StagePredictor::prescribed(self.pose, Joints::zeros());
        }
        let q = base.q + h * guess;
        let near = self.reference_sin_cos.incremented(&(q - self.reference_q));
        let sin_cos = near.unwrap_or_else(|| SinCos::new(&q));
        let (pose, jacobian) = self.puma.tool_and_jacobian_at(&sin_cos);
        StagePredictor {
            degrees_of_freedom: JOINT_COUNT,
            inertia: self.dynamics.mass_matrix_at(&sin_cos),
            forces: self.direct_torque() - self.dynamics.bias_torque_at(&sin_cos, guess),
            jacobian,
            pose,
            prescribed_twist: Joints::zeros(),
            guessed_speeds: *guess,
            sin_cos,
        }
    }

    fn generalised_forces(
        &self,
        predictor: &StagePredictor,
        _base: &ArmState,
        speeds: &Joints,
        _h: f64,
    ) -> Joints {
        if predictor.degrees_of_freedom == 0 {
            return predictor.forces;
        }
        self.direct_torque() - self.dynamics.bias_torque_at(&predictor.sin_cos, speeds)
    }

    /// Friction of the joint, or the torque of its compliant gear.
    fn resisting_torque(&self, base: &ArmState, i: usize, speed: f64, h: f64) -> ResistingTorque {
        match &self.gears {
            None => friction_torque(&self.friction, i, base.bristle[i], speed, h),
            Some(gears) => {
                let motor_nm = self.motor_torque()[i];
                let stage = JointStage { joint: i, speed, h, motor_nm };
                gears.resisting_torque(base, stage, &self.friction)
            }
        }
    }

    fn update_kinematics(&mut self, t_s: f64) {
        if let Some(prescribed) = &mut self.prescribed {
            prescribed.t_s = t_s;
            (self.state.q, self.state.qd) = prescribed.at(t_s);
        }
        self.reference_q = self.state.q;
        self.reference_sin_cos = SinCos::new(&self.state.q);
        (self.pose, self.jacobian) = self.puma.tool_and_jacobian_at(&self.reference_sin_cos);
        // The inverse of the inertia belongs to another state now.
        self.steps_since_refresh = self.refresh_interval;
    }

    fn clone_box(&self) -> Box<dyn Coordinates<6>> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
impl Arm {
    /// Lets the joints turn for ever.
    pub(crate) fn without_stops(&mut self) {
        self.puma.q_min_rad.fill(f64::NEG_INFINITY);
        self.puma.q_max_rad.fill(f64::INFINITY);
    }
}

#[cfg(test)]
mod tests;
