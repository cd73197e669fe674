//! Rigid-body dynamics of a chain: recursive Newton-Euler (Luh, Walker and Paul 1980) and composite
//! bodies (Walker and Orin 1982) in the frames of the links. Refuses friction and contact: both
//! arrive as joint efforts.

use super::{Chain, JointKind};
use crate::cholesky::solve_positive_definite;
use crate::rigid_body::{first_moment_inertia, parallel_axis_inertia};
use crate::spatial::{JointMatrix, JointVector, Pose};
use glam::{DMat3, DVec3};

/// Frames of the links, each in the one before.
fn link_poses<const N: usize>(chain: &Chain<N>, q: &JointVector<N>) -> [Pose; N] {
    core::array::from_fn(|i| {
        let link = &chain.links[i];
        match link.kind {
            JointKind::Revolute => {
                let (s, c) = libm::sincos(q[i]);
                let (x, y) = (link.origin.rotation.x_axis, link.origin.rotation.y_axis);
                let rotation =
                    DMat3::from_cols(c * x + s * y, c * y - s * x, link.origin.rotation.z_axis);
                Pose::new(rotation, link.origin.translation)
            }
            JointKind::Prismatic => Pose::new(
                link.origin.rotation,
                link.origin.translation + q[i] * link.origin.rotation.z_axis,
            ),
        }
    })
}

impl<const N: usize> Chain<N> {
    /// Joint efforts of the rigid links for a motion (rad, rad/s, rad/s^2 to N m; sliding joints in
    /// m and N), gravity included, drives and friction not.
    #[must_use]
    pub fn inverse_dynamics(
        &self,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        qdd: &JointVector<N>,
    ) -> JointVector<N> {
        let step = link_poses(self, q);
        let (mut force, mut moment) = ([DVec3::ZERO; N], [DVec3::ZERO; N]);
        let (mut w, mut wd, mut a) = (DVec3::ZERO, DVec3::ZERO, self.base_acceleration);
        for i in 0..N {
            let down = step[i].rotation.transpose();
            let p = step[i].translation;
            a = down * (a + wd.cross(p) + w.cross(w.cross(p)));
            (w, wd) = (down * w, down * wd);
            match self.links[i].kind {
                JointKind::Revolute => {
                    // w x (z qd) = (w.y, -w.x, 0) qd
                    wd += DVec3::new(w.y * qd[i], -w.x * qd[i], qdd[i]);
                    w.z += qd[i];
                }
                JointKind::Prismatic => {
                    a += DVec3::new(2.0 * w.y * qd[i], -2.0 * w.x * qd[i], qdd[i]);
                }
            }
            let body = &self.links[i].body;
            let com = body.com_m;
            force[i] = body.mass_kg * (a + wd.cross(com) + w.cross(w.cross(com)));
            moment[i] = body.inertia_kg_m2 * wd + w.cross(body.inertia_kg_m2 * w);
        }
        self.propagate_inward(&step, &force, &moment)
    }

    /// Efforts that hold the chain against gravity.
    #[must_use]
    pub fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N> {
        let step = link_poses(self, q);
        let mut force = [DVec3::ZERO; N];
        let mut a = self.base_acceleration;
        for i in 0..N {
            a = step[i].rotation.transpose() * a;
            force[i] = self.links[i].body.mass_kg * a;
        }
        self.propagate_inward(&step, &force, &[DVec3::ZERO; N])
    }

    /// The inward half: efforts that carry a force at, and a moment about, each centre of mass.
    fn propagate_inward(
        &self,
        step: &[Pose; N],
        force: &[DVec3; N],
        moment: &[DVec3; N],
    ) -> JointVector<N> {
        let mut tau = JointVector::<N>::zeros();
        let (mut f, mut n) = (DVec3::ZERO, DVec3::ZERO);
        for i in (0..N).rev() {
            n += self.links[i].body.com_m.cross(force[i]) + moment[i];
            f += force[i];
            tau[i] = match self.links[i].kind {
                JointKind::Revolute => n.z,
                JointKind::Prismatic => f.z,
            };
            f = step[i].rotation * f;
            n = step[i].rotation * n + step[i].translation.cross(f);
        }
        tau
    }

    /// Coriolis, centrifugal and gravity efforts.
    #[must_use]
    pub fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        self.inverse_dynamics(q, qd, &JointVector::zeros())
    }

    /// The mass matrix, drives included.
    #[must_use]
    pub fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        let step = link_poses(self, q);
        let mut out = JointMatrix::<N>::zeros();
        // Everything from link i outwards: mass, first moment and inertia about its origin.
        let (mut mass, mut first, mut inertia) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for i in (0..N).rev() {
            let body = &self.links[i].body;
            mass += body.mass_kg;
            first += body.mass_kg * body.com_m;
            inertia =
                inertia + body.inertia_kg_m2 + parallel_axis_inertia(body.mass_kg, body.com_m);
            // Unit acceleration of joint i: force and moment on the whole.
            let (mut f, mut n) = match self.links[i].kind {
                JointKind::Revolute => (DVec3::new(-first.y, first.x, 0.0), inertia.z_axis),
                JointKind::Prismatic => {
                    (DVec3::new(0.0, 0.0, mass), DVec3::new(first.y, -first.x, 0.0))
                }
            };
            for j in (0..=i).rev() {
                let entry = match self.links[j].kind {
                    JointKind::Revolute => n.z,
                    JointKind::Prismatic => f.z,
                };
                out[(i, j)] = entry;
                out[(j, i)] = entry;
                f = step[j].rotation * f;
                n = step[j].rotation * n + step[j].translation.cross(f);
            }
            let (r, p) = (step[i].rotation, step[i].translation);
            first = r * first;
            inertia = r * inertia * r.transpose()
                + first_moment_inertia(first, p)
                + parallel_axis_inertia(mass, p);
            first += mass * p;
        }
        for i in 0..N {
            out[(i, i)] += self.reflected_inertia[i];
        }
        out
    }

    /// Potential energy (J), zero with every mass at the origin of the base.
    #[must_use]
    pub fn potential_energy_j(&self, q: &JointVector<N>) -> f64 {
        let (mut mass, mut first) = (0.0, DVec3::ZERO);
        for (link, step) in self.links.iter().zip(link_poses(self, q)).rev() {
            mass += link.body.mass_kg;
            first += link.body.mass_kg * link.body.com_m;
            first = step.rotation * first + mass * step.translation;
        }
        self.base_acceleration.dot(first)
    }

    /// Joint accelerations under joint efforts, drives included, friction not. NaN for numbers that
    /// are not finite and for joints that carry neither mass nor drive.
    #[must_use]
    pub fn forward_dynamics(
        &self,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        effort: &JointVector<N>,
    ) -> JointVector<N> {
        let mut out = effort - self.bias_torque(q, qd);
        solve_positive_definite(&mut self.mass_matrix(q), &mut out);
        out
    }
}
