//! Rigid-body dynamics of the PUMA 260: inverse dynamics, gravity, mass matrix, forward dynamics
//! and energies, all of fixed size. Friction is listed here but enters only where the caller adds
//! it; contact forces are refused: they arrive as joint torques (`J^T` wrench).
//!
//! Recursive Newton-Euler after Luh, Walker and Paul (1980), composite bodies after Walker and Orin
//! (1982), both on links in the fewest numbers after Gautier and Khalil (1990). The motors' rotors
//! appear as `J G^2` on the diagonal of the mass matrix; the inertia that the coupling of the
//! wrist's gears adds off the diagonal is left out. Numbers that are not finite come out as NaN
//! torques or accelerations, never as a panic.

mod grouped;
mod motion;
mod recursion;

pub use motion::{MAX_STEPS, State, free_motion, rk4_step};

use crate::chain::Vector;
use crate::spatial::{Joints, Matrix6, Pose, SinCos};
use glam::{DMat3, DVec3};
use grouped::Grouped;

/// One rigid body in the frame of its link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mass (kg).
    pub mass_kg: f64,
    /// Centre of mass in the link frame (m).
    pub com_m: DVec3,
    /// Inertia about the centre of mass in the axes of the link frame (kg m^2), symmetric.
    pub inertia_kg_m2: DMat3,
}

impl Body {
    /// A body whose axes of inertia are those of the link.
    #[must_use]
    pub const fn diagonal(mass_kg: f64, com_m: [f64; 3], inertia_kg_m2: [f64; 3]) -> Body {
        let [x, y, z] = inertia_kg_m2;
        Body {
            mass_kg,
            com_m: DVec3::new(com_m[0], com_m[1], com_m[2]),
            inertia_kg_m2: DMat3::from_cols(
                DVec3::new(x, 0.0, 0.0),
                DVec3::new(0.0, y, 0.0),
                DVec3::new(0.0, 0.0, z),
            ),
        }
    }

    /// The same body of so many times the density.
    #[must_use]
    pub fn scaled(&self, by: f64) -> Body {
        Body {
            mass_kg: by * self.mass_kg,
            com_m: self.com_m,
            inertia_kg_m2: by * self.inertia_kg_m2,
        }
    }

    /// The body of a frame that stands at `pose` in another, seen from that other one.
    #[must_use]
    pub fn seen_from(&self, pose: &Pose) -> Body {
        let turn = pose.rotation;
        Body {
            mass_kg: self.mass_kg,
            com_m: pose.apply(self.com_m),
            inertia_kg_m2: turn * self.inertia_kg_m2 * turn.transpose(),
        }
    }

    /// Two bodies of one frame, welded.
    #[must_use]
    pub fn weld(&self, other: &Body) -> Body {
        let mass_kg = self.mass_kg + other.mass_kg;
        if mass_kg <= 0.0 {
            return *self;
        }
        let com_m = (self.mass_kg * self.com_m + other.mass_kg * other.com_m) / mass_kg;
        let about = |b: &Body| b.inertia_kg_m2 + steiner(b.mass_kg, b.com_m - com_m);
        Body { mass_kg, com_m, inertia_kg_m2: about(self) + about(other) }
    }
}

/// The inertia of a point mass `m` (kg) at `r` (m) about the origin (kg m^2).
pub(crate) fn steiner(m: f64, r: DVec3) -> DMat3 {
    let square = r.length_squared();
    m * DMat3::from_cols(
        DVec3::new(square, 0.0, 0.0) - r * r.x,
        DVec3::new(0.0, square, 0.0) - r * r.y,
        DVec3::new(0.0, 0.0, square) - r * r.z,
    )
}

/// What a first moment `h` adds to the inertia when the origin moves by `-p`:
/// `2 h.p I - h p^T - p h^T`.
pub(crate) fn carry(h: DVec3, p: DVec3) -> DMat3 {
    let both = 2.0 * h.dot(p);
    DMat3::from_cols(
        DVec3::new(both, 0.0, 0.0) - h * p.x - p * h.x,
        DVec3::new(0.0, both, 0.0) - h * p.y - p * h.y,
        DVec3::new(0.0, 0.0, both) - h * p.z - p * h.z,
    )
}

/// Links 1 to 6 of the PUMA 260. Estimate: the PUMA 560 of Armstrong, Khatib and Burdick (1986)
/// scaled with k = 0.2032/0.4318, length k, mass k^2, inertia k^4. The moment about z of link 3 is
/// raised so that it obeys the triangle inequality, which the published value breaks.
pub const LINKS: [Body; 6] = [
    Body::diagonal(2.0, [0.0, -0.05, 0.0], [0.012, 0.017165, 0.012]),
    Body::diagonal(3.853, [-0.1712, 0.0028235, 0.10706], [0.0063754, 0.025698, 0.026433]),
    Body::diagonal(1.063, [-0.0095529, -0.0066353, 0.032941], [0.0032367, 0.0042176, 0.0011]),
    Body::diagonal(0.1816, [0.0, 0.0089412, 0.0], [8.8275e-05, 6.3754e-05, 8.8275e-05]),
    Body::diagonal(0.07529, [0.0, 0.0, 0.0], [1.4713e-05, 1.9617e-05, 1.4713e-05]),
    Body::diagonal(0.01993, [0.0, 0.0, 0.015059], [7.3563e-06, 7.3563e-06, 1.9617e-06]),
];

/// Force/torque sensor, finger and tactile array on link 6 (estimate).
pub const TOOL: Body = Body::diagonal(0.45, [0.0, 0.0, 0.115], [9.0e-04, 9.0e-04, 1.2e-04]);

/// Inertia of the rotors (kg m^2, estimate).
pub const ROTOR_INERTIA_KG_M2: [f64; 6] = [33e-6, 33e-6, 33e-6, 10e-6, 10e-6, 10e-6];

/// Free fall (m/s^2).
pub const GRAVITY_M_S2: f64 = 9.81;

/// The arm as six rigid bodies and six rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    bodies: [Body; 6],
    grouped: Grouped,
    /// Rotor inertia seen at the joint, `J G^2` (kg m^2).
    pub reflected_kg_m2: Joints,
    /// Acceleration of free fall along -z of the base (m/s^2).
    pub gravity_m_s2: f64,
}

impl Dynamics {
    /// The reference arm with its tool.
    #[must_use]
    pub fn reference() -> Dynamics {
        Dynamics::with_tool(&TOOL)
    }

    /// The reference arm with another body (in the axes of T6) on its flange.
    #[must_use]
    pub fn with_tool(tool: &Body) -> Dynamics {
        Dynamics::of_bodies(LINKS, tool)
    }

    /// The reference arm with other links, and a body on its flange.
    #[must_use]
    pub fn of_bodies(links: [Body; 6], tool: &Body) -> Dynamics {
        let arm = crate::puma260::Puma260::reference();
        let mut bodies = links;
        bodies[5] = bodies[5].weld(tool);
        let gear = Joints::from(crate::transmission::GEAR_RATIO);
        let reflected_kg_m2 = Joints::from(ROTOR_INERTIA_KG_M2).component_mul(&gear);
        Dynamics {
            bodies,
            grouped: Grouped::of(&bodies, (arm.a2_m, arm.d3_m, arm.d4_m)),
            reflected_kg_m2: reflected_kg_m2.component_mul(&gear),
            gravity_m_s2: GRAVITY_M_S2,
        }
    }

    /// Links in their distal Denavit-Hartenberg frames; the last one carries the tool.
    #[must_use]
    pub fn bodies(&self) -> &[Body; 6] {
        &self.bodies
    }

    /// Links in the fewest numbers, and free fall.
    fn falling(&self) -> (&Grouped, f64) {
        (&self.grouped, self.gravity_m_s2)
    }

    /// Torques that hold the arm against gravity (N m).
    #[must_use]
    pub fn gravity(&self, q: &Joints) -> Joints {
        recursion::gravity(self.falling(), &SinCos::of(q))
    }

    /// Torques of the rigid links and the tool for a motion (rad, rad/s, rad/s^2 to N m), gravity
    /// included, rotors and friction not.
    #[must_use]
    pub fn inverse(&self, q: &Joints, qd: &Joints, qdd: &Joints) -> Joints {
        recursion::newton_euler(self.falling(), &SinCos::of(q), qd, qdd)
    }

    /// Coriolis, centrifugal and gravity torques (N m).
    #[must_use]
    pub fn bias(&self, q: &Joints, qd: &Joints) -> Joints {
        self.bias_at(&SinCos::of(q), qd)
    }

    /// [`Dynamics::bias`] at a configuration whose sines are known.
    #[must_use]
    pub fn bias_at(&self, at: &SinCos, qd: &Joints) -> Joints {
        recursion::newton_euler(self.falling(), at, qd, &Joints::zeros())
    }

    /// The mass matrix (kg m^2), rotors included.
    #[must_use]
    pub fn mass_matrix(&self, q: &Joints) -> Matrix6 {
        self.mass_matrix_at(&SinCos::of(q))
    }

    /// [`Dynamics::mass_matrix`] at a configuration whose sines are known.
    #[must_use]
    pub fn mass_matrix_at(&self, at: &SinCos) -> Matrix6 {
        let mut m = recursion::composite(&self.grouped, at);
        for i in 0..6 {
            m[(i, i)] += self.reflected_kg_m2[i];
        }
        m
    }

    /// Joint accelerations under joint torques (rad/s^2), rotors included, friction not. NaN for
    /// numbers that are not finite.
    #[must_use]
    pub fn forward(&self, q: &Joints, qd: &Joints, tau_nm: &Joints) -> Joints {
        let at = SinCos::of(q);
        solve_positive(self.mass_matrix_at(&at), tau_nm - self.bias_at(&at, qd))
    }

    /// Kinetic energy (J), rotors included.
    #[must_use]
    pub fn kinetic_j(&self, q: &Joints, qd: &Joints) -> f64 {
        0.5 * qd.dot(&(self.mass_matrix(q) * qd))
    }

    /// Potential energy (J), zero with every mass at the height of the base frame.
    #[must_use]
    pub fn potential_j(&self, q: &Joints) -> f64 {
        recursion::potential(self.falling(), &SinCos::of(q))
    }
}

/// Friction at the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction<const N: usize = 6> {
    /// Coulomb friction (N m).
    pub coulomb_nm: Vector<N>,
    /// Viscous friction (N m s/rad).
    pub viscous_nms_rad: Vector<N>,
}

impl Friction<6> {
    /// Estimate: joint-side values of the PUMA 560 (Armstrong, Khatib and Burdick 1986) times
    /// 0.104, the cube of the ratio of lengths.
    #[must_use]
    pub fn reference() -> Friction<6> {
        Friction {
            coulomb_nm: Joints::new(2.708, 1.107, 0.663, 0.111, 0.0890, 0.0578),
            viscous_nms_rad: Joints::new(0.605, 0.990, 0.415, 0.0429, 0.0445, 0.0225),
        }
    }
}

impl<const N: usize> Friction<N> {
    /// The torque a motor must add to keep joints moving at `qd` (rad/s): `viscous qd + coulomb
    /// sign(qd)`, the sign of 0 being 0 (N m).
    #[must_use]
    pub fn torque_nm(&self, qd: &Vector<N>) -> Vector<N> {
        let sign = qd.map(|v| if v == 0.0 { 0.0 } else { v.signum() });
        self.viscous_nms_rad.component_mul(qd) + self.coulomb_nm.component_mul(&sign)
    }
}

/// Solves a symmetric positive definite system by Cholesky in place; NaN where it is neither.
fn solve_positive(mut m: Matrix6, mut b: Joints) -> Joints {
    for j in 0..6 {
        let mut d = m[(j, j)];
        for k in 0..j {
            d -= m[(j, k)] * m[(j, k)];
        }
        // The square root of a negative number is the NaN that is promised.
        let root = d.sqrt();
        m[(j, j)] = root;
        for i in j + 1..6 {
            let mut sum = m[(i, j)];
            for k in 0..j {
                sum -= m[(i, k)] * m[(j, k)];
            }
            m[(i, j)] = sum / root;
        }
    }
    for i in 0..6 {
        for k in 0..i {
            b[i] -= m[(i, k)] * b[k];
        }
        b[i] /= m[(i, i)];
    }
    for i in (0..6).rev() {
        for k in i + 1..6 {
            b[i] -= m[(k, i)] * b[k];
        }
        b[i] /= m[(i, i)];
    }
    b
}
