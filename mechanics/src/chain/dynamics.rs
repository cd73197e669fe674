//! Rigid-body dynamics of a chain in the frames of its links: recursive Newton-Euler (Luh, Walker
//! and Paul 1980) and composite rigid bodies (Walker and Orin 1982). Friction and contact forces
//! are not included; a caller adds them as joint efforts. An *effort* is the torque of a revolute
//! joint (N m) or the force of a prismatic one (N).

use super::{Chain, JointKind};
use crate::cholesky::solve_positive_definite;
use crate::rigid_body::{first_moment_inertia, parallel_axis_inertia};
use crate::spatial::{JointMatrix, JointVector, Pose};
use glam::{DMat3, DVec3};

/// The pose of the frame of each link in the frame of the link before it, at `q` (rad or m).
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
    /// Inverse dynamics by the recursive Newton-Euler algorithm: the joint efforts (N m or N) of
    /// the links for the motion `q` (rad or m), `qd`, `qdd`. Gravity is included, drives and
    /// friction are not.
    #[must_use]
    pub fn inverse_dynamics(
        &self,
        q: &JointVector<N>,
        qd: &JointVector<N>,
        qdd: &JointVector<N>,
    ) -> JointVector<N> {
        let pose = link_poses(self, q);
        let (mut force, mut moment) = ([DVec3::ZERO; N], [DVec3::ZERO; N]);
        // Angular velocity and acceleration of the link, and the acceleration of its origin minus
        // that of free fall, in the axes of the link.
        let (mut w, mut wd, mut a) = (DVec3::ZERO, DVec3::ZERO, self.base_acceleration);
        for i in 0..N {
            let to_link = pose[i].rotation.transpose();
            let p = pose[i].translation;
            a = to_link * (a + wd.cross(p) + w.cross(w.cross(p)));
            (w, wd) = (to_link * w, to_link * wd);
            match self.links[i].kind {
                JointKind::Revolute => {
                    // w x (z qd) = (w.y, -w.x, 0) qd
                    wd += DVec3::new(w.y * qd[i], -w.x * qd[i], qdd[i]);
                    w.z += qd[i];
                }
                JointKind::Prismatic => {
                    // The Coriolis acceleration 2 w x (z qd).
                    a += DVec3::new(2.0 * w.y * qd[i], -2.0 * w.x * qd[i], qdd[i]);
                }
            }
            let body = &self.links[i].body;
            let com = body.com_m;
            force[i] = body.mass_kg * (a + wd.cross(com) + w.cross(w.cross(com)));
            moment[i] = body.inertia_kg_m2 * wd + w.cross(body.inertia_kg_m2 * w);
        }
        self.propagate_inward(&pose, &force, &moment)
    }

    /// The efforts (N m or N) that hold the chain at rest at `q` (rad or m) against gravity.
    #[must_use]
    pub fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N> {
        let pose = link_poses(self, q);
        let mut force = [DVec3::ZERO; N];
        let mut a = self.base_acceleration;
        for i in 0..N {
            a = pose[i].rotation.transpose() * a;
            force[i] = self.links[i].body.mass_kg * a;
        }
        self.propagate_inward(&pose, &force, &[DVec3::ZERO; N])
    }

    /// The inward recursion: the efforts that balance a force (N) at and a moment (N m) about the
    /// centre of mass of each link, given in the axes of the link.
    fn propagate_inward(
        &self,
        pose: &[Pose; N],
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
            f = pose[i].rotation * f;
            n = pose[i].rotation * n + pose[i].translation.cross(f);
        }
        tau
    }

    /// Coriolis, centrifugal and gravity efforts (N m or N) at `q` (rad or m) and `qd`.
    #[must_use]
    pub fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        self.inverse_dynamics(q, qd, &JointVector::zeros())
    }

    /// The mass matrix at `q` (rad or m), drives included (kg m^2; kg for prismatic joints), by the
    /// composite rigid body algorithm.
    #[must_use]
    pub fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        let pose = link_poses(self, q);
        let mut out = JointMatrix::<N>::zeros();
        // The composite body of link i and all links outside it: mass, first moment, and inertia
        // about the origin of link i.
        let (mut mass, mut first, mut inertia) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for i in (0..N).rev() {
            let body = &self.links[i].body;
            mass += body.mass_kg;
            first += body.mass_kg * body.com_m;
            inertia =
                inertia + body.inertia_kg_m2 + parallel_axis_inertia(body.mass_kg, body.com_m);
            // Force and moment that accelerate the composite body by one unit of joint i.
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
                f = pose[j].rotation * f;
                n = pose[j].rotation * n + pose[j].translation.cross(f);
            }
            let (r, p) = (pose[i].rotation, pose[i].translation);
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

    /// Potential energy at `q` (rad or m) (J); it is zero where every mass is at the origin of the
    /// base.
    #[must_use]
    pub fn potential_energy_j(&self, q: &JointVector<N>) -> f64 {
        let (mut mass, mut first) = (0.0, DVec3::ZERO);
        for (link, pose) in self.links.iter().zip(link_poses(self, q)).rev() {
            mass += link.body.mass_kg;
            first += link.body.mass_kg * link.body.com_m;
            first = pose.rotation * first + mass * pose.translation;
        }
        self.base_acceleration.dot(first)
    }

    /// Forward dynamics: the joint accelerations (rad/s^2 or m/s^2) under the joint efforts
    /// `effort` (N m or N) at `q` (rad or m) and `qd`. Drives are included, friction is not. NaN
    /// where a number is not finite and for a joint that moves neither a mass nor a drive.
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
