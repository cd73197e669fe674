//! Rigid-body dynamics of the PUMA 260: inverse dynamics, gravity, mass matrix, forward dynamics
//! and energies. Friction and contact forces are not included; a caller adds them as joint torques.
//!
//! The algorithms are the recursive Newton-Euler one (Luh, Walker and Paul 1980) and that of
//! composite rigid bodies (Walker and Orin 1982), on the base parameters of Gautier and Khalil
//! (1990). The rotors of the motors appear as the reflected inertia `J G^2` on the diagonal of the
//! mass matrix; the inertia that the coupling of the wrist's gears adds off the diagonal is
//! neglected. Numbers that are not finite make NaN torques or accelerations and no panic.

mod base_parameters;
mod integration;
mod recursion;

pub use integration::{STEPS_MAX, State, free_motion, rk4_step};

use super::Puma260;
use crate::cholesky::solve_positive_definite;
use crate::rigid_body::{Body, GRAVITY_M_S2};
use crate::spatial::{Joints, Matrix6, SinCos};
use crate::transmission::GEAR_RATIO;
use base_parameters::BaseParameters;

/// Links 1 to 6 of the PUMA 260, in their distal Denavit-Hartenberg frames. Estimate: the PUMA 560
/// of Armstrong, Khatib and Burdick (1986), scaled with k = 0.2032/0.4318: lengths by k, masses by
/// k^2, inertias by k^4. The moment of inertia about z of link 3 is raised so that it obeys the
/// triangle inequality, which the published value violates.
pub const LINKS: [Body; 6] = [
    Body::diagonal(2.0, [0.0, -0.05, 0.0], [0.012, 0.017165, 0.012]),
    Body::diagonal(3.853, [-0.1712, 0.0028235, 0.10706], [0.0063754, 0.025698, 0.026433]),
    Body::diagonal(1.063, [-0.0095529, -0.0066353, 0.032941], [0.0032367, 0.0042176, 0.0011]),
    Body::diagonal(0.1816, [0.0, 0.0089412, 0.0], [8.8275e-05, 6.3754e-05, 8.8275e-05]),
    Body::diagonal(0.07529, [0.0, 0.0, 0.0], [1.4713e-05, 1.9617e-05, 1.4713e-05]),
    Body::diagonal(0.01993, [0.0, 0.0, 0.015059], [7.3563e-06, 7.3563e-06, 1.9617e-06]),
];

/// Force/torque sensor, finger and tactile array, in the frame of link 6 (estimate).
pub const TOOL: Body = Body::diagonal(0.45, [0.0, 0.0, 0.115], [9.0e-04, 9.0e-04, 1.2e-04]);

/// Moments of inertia of the rotors about their own axes (kg m^2, estimate).
pub const ROTOR_INERTIA_KG_M2: [f64; 6] = [33e-6, 33e-6, 33e-6, 10e-6, 10e-6, 10e-6];

/// The dynamic model of the arm: six rigid bodies and six rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    bodies: [Body; 6],
    base_parameters: BaseParameters,
    /// Reflected inertia of the rotors at the joints, `J G^2` (kg m^2).
    pub reflected_inertia_kg_m2: Joints,
    /// Acceleration of free fall along -z of the base (m/s^2).
    pub gravity_m_s2: f64,
}

impl Dynamics {
    /// The reference arm with the tool [`TOOL`].
    #[must_use]
    pub fn reference() -> Dynamics {
        Dynamics::with_tool(&TOOL)
    }

    /// The reference arm with the body `tool`, in the frame T6, on its flange.
    #[must_use]
    pub fn with_tool(tool: &Body) -> Dynamics {
        Dynamics::from_bodies(LINKS, tool)
    }

    /// An arm with the dimensions of the reference arm and the bodies `links`, in their distal
    /// Denavit-Hartenberg frames, and with the body `tool`, in the frame T6, on its flange.
    #[must_use]
    pub fn from_bodies(links: [Body; 6], tool: &Body) -> Dynamics {
        let arm = Puma260::reference();
        let mut bodies = links;
        bodies[5] = bodies[5].combine(tool);
        let gear = Joints::from(GEAR_RATIO);
        let reflected_kg_m2 = Joints::from(ROTOR_INERTIA_KG_M2).component_mul(&gear);
        Dynamics {
            bodies,
            base_parameters: BaseParameters::new(&bodies, &arm),
            reflected_inertia_kg_m2: reflected_kg_m2.component_mul(&gear),
            gravity_m_s2: GRAVITY_M_S2,
        }
    }

    /// The links in their distal Denavit-Hartenberg frames; the last one includes the tool.
    #[must_use]
    pub fn bodies(&self) -> &[Body; 6] {
        &self.bodies
    }

    /// The torques that hold the arm at rest at `q` (rad) against gravity (N m).
    #[must_use]
    pub fn gravity_torque(&self, q: &Joints) -> Joints {
        recursion::gravity_torque(&self.base_parameters, self.gravity_m_s2, &SinCos::new(q))
    }

    /// Inverse dynamics by the recursive Newton-Euler algorithm: the joint torques (N m) of the
    /// links and the tool for the motion `q` (rad), `qd` (rad/s), `qdd` (rad/s^2). Gravity is
    /// included, rotors and friction are not.
    #[must_use]
    pub fn inverse_dynamics(&self, q: &Joints, qd: &Joints, qdd: &Joints) -> Joints {
        recursion::recursive_newton_euler(
            &self.base_parameters,
            self.gravity_m_s2,
            &SinCos::new(q),
            qd,
            qdd,
        )
    }

    /// Coriolis, centrifugal and gravity torques at `q` (rad) and `qd` (rad/s) (N m).
    #[must_use]
    pub fn bias_torque(&self, q: &Joints, qd: &Joints) -> Joints {
        self.bias_torque_at(&SinCos::new(q), qd)
    }

    /// `Dynamics::bias` at a configuration whose sines and cosines are known.
    #[must_use]
    pub fn bias_torque_at(&self, at: &SinCos, qd: &Joints) -> Joints {
        recursion::recursive_newton_euler(
            &self.base_parameters,
            self.gravity_m_s2,
            at,
            qd,
            &Joints::zeros(),
        )
    }

    /// The mass matrix at `q` (rad), rotors included (kg m^2).
    #[must_use]
    pub fn mass_matrix(&self, q: &Joints) -> Matrix6 {
        self.mass_matrix_at(&SinCos::new(q))
    }

    /// [`Dynamics::mass_matrix`] at a configuration whose sines and cosines are known.
    #[must_use]
    pub fn mass_matrix_at(&self, at: &SinCos) -> Matrix6 {
        let mut m = recursion::composite_rigid_body(&self.base_parameters, at);
        for i in 0..6 {
            m[(i, i)] += self.reflected_inertia_kg_m2[i];
        }
        m
    }

    /// Forward dynamics: the joint accelerations (rad/s^2) under the joint torques `tau_nm` (N m)
    /// at `q` (rad) and `qd` (rad/s). Rotors are included, friction is not. NaN where a number is
    /// not finite.
    #[must_use]
    pub fn forward_dynamics(&self, q: &Joints, qd: &Joints, tau_nm: &Joints) -> Joints {
        let at = SinCos::new(q);
        let mut acceleration = tau_nm - self.bias_torque_at(&at, qd);
        solve_positive_definite(&mut self.mass_matrix_at(&at), &mut acceleration);
        acceleration
    }

    /// Kinetic energy at `q` (rad) and `qd` (rad/s), rotors included (J).
    #[must_use]
    pub fn kinetic_energy_j(&self, q: &Joints, qd: &Joints) -> f64 {
        0.5 * qd.dot(&(self.mass_matrix(q) * qd))
    }

    /// Potential energy at `q` (rad) (J); it is zero where every mass is at the height of the base
    /// frame.
    #[must_use]
    pub fn potential_energy_j(&self, q: &Joints) -> f64 {
        recursion::potential_energy_j(&self.base_parameters, self.gravity_m_s2, &SinCos::new(q))
    }
}
