//! The recursions along the links of the PUMA 260, on its base parameters: recursive Newton-Euler
//! (Luh, Walker and Paul 1980), gravity, composite rigid bodies (Walker and Orin 1982) and
//! potential energy. The twists and offsets of the PUMA 260 are written into the code.
//!
//! Quantities of a link are about an origin on the axis of its own joint, in axes that rotate with
//! the link. `in_parent::<J>` takes a quantity of the next link to the origin and axes of link `J`,
//! counted from 1.

use super::base_parameters::{BaseParameters, LinkParameters};
use crate::spatial::{Joints, Matrix6, SinCos};
use glam::DVec3;

/// The rotation of one link about the z axis of its joint: sine and cosine of the joint angle.
#[derive(Clone, Copy)]
struct JointRotation {
    s: f64,
    c: f64,
}

impl JointRotation {
    fn new(at: &SinCos, joint: usize) -> JointRotation {
        JointRotation { s: at.s[joint], c: at.c[joint] }
    }

    /// The vector `v`, given in the axes before the joint, in the axes of the link.
    #[inline(always)]
    fn to_link(self, v: DVec3) -> DVec3 {
        DVec3::new(self.c * v.x + self.s * v.y, self.c * v.y - self.s * v.x, v.z)
    }

    /// The vector `v`, given in the axes of the link, in the axes before the joint.
    #[inline(always)]
    fn to_parent(self, v: DVec3) -> DVec3 {
        DVec3::new(self.c * v.x - self.s * v.y, self.s * v.x + self.c * v.y, v.z)
    }
}

/// The vector `v` rotated by +90 deg about x.
#[inline(always)]
fn rotate_x_plus_90(v: DVec3) -> DVec3 {
    DVec3::new(v.x, -v.z, v.y)
}

/// The vector `v` rotated by -90 deg about x.
#[inline(always)]
fn rotate_x_minus_90(v: DVec3) -> DVec3 {
    DVec3::new(v.x, v.z, -v.y)
}

/// The motion of a link: angular velocity `w` (rad/s), angular acceleration `wd` (rad/s^2), and the
/// acceleration `a` of its origin minus that of free fall (m/s^2).
#[derive(Clone, Copy)]
struct LinkMotion {
    w: DVec3,
    wd: DVec3,
    a: DVec3,
}

impl LinkMotion {
    /// The motion of the next link at the same origin, whose joint has the angle of `turn`, the
    /// speed `qd` (rad/s) and the acceleration `qdd` (rad/s^2).
    #[inline(always)]
    fn across_joint(self, turn: JointRotation, qd: f64, qdd: f64) -> LinkMotion {
        let (mut w, mut wd) = (turn.to_link(self.w), turn.to_link(self.wd));
        // w x (z qd) = (w.y, -w.x, 0) qd
        wd += DVec3::new(w.y * qd, -w.x * qd, qdd);
        w.z += qd;
        LinkMotion { w, wd, a: turn.to_link(self.a) }
    }

    /// The same motion with `map` applied to each of its vectors.
    #[inline(always)]
    fn map(self, map: impl Fn(DVec3) -> DVec3) -> LinkMotion {
        LinkMotion { w: map(self.w), wd: map(self.wd), a: map(self.a) }
    }

    /// The motion of the point of the link that lies `by` (m) from its origin along x.
    #[inline(always)]
    fn at_offset_x(mut self, by: f64) -> LinkMotion {
        let (w, wd) = (self.w, self.wd);
        let relative = DVec3::new(-(w.y * w.y + w.z * w.z), w.x * w.y + wd.z, w.x * w.z - wd.y);
        self.a += by * relative;
        self
    }

    /// The motion of the point of the link that lies `by` (m) from its origin along z.
    #[inline(always)]
    fn at_offset_z(mut self, by: f64) -> LinkMotion {
        let (w, wd) = (self.w, self.wd);
        let relative = DVec3::new(w.x * w.z + wd.y, w.y * w.z - wd.x, -(w.x * w.x + w.y * w.y));
        self.a += by * relative;
        self
    }
}

/// A force `f` (N) and its moment `n` about the origin (N m).
#[derive(Clone, Copy)]
struct Wrench {
    f: DVec3,
    n: DVec3,
}

impl Wrench {
    /// The wrench that causes the motion `moving` of a link (Newton and Euler).
    #[inline(always)]
    fn new(link: &LinkParameters, moving: &LinkMotion) -> Wrench {
        let LinkMotion { w, wd, a } = *moving;
        let (hx, hy) = (link.hx, link.hy);
        let (xx, yy, zz) = (w.x * w.x, w.y * w.y, w.z * w.z);
        let (xy, xz, yz) = (w.x * w.y, w.x * w.z, w.y * w.z);
        let f = DVec3::new(
            hy * (xy - wd.z) - hx * (yy + zz),
            hx * (xy + wd.z) - hy * (xx + zz),
            hx * (xz - wd.y) + hy * (yz + wd.x),
        );
        let inertia_times = |v: DVec3| {
            DVec3::new(
                link.xx * v.x + link.xy * v.y + link.xz * v.z,
                link.xy * v.x + link.yz * v.z,
                link.xz * v.x + link.yz * v.y + link.zz * v.z,
            )
        };
        Wrench { f, n: inertia_times(wd) + w.cross(inertia_times(w)) + weight_moment(link, a) }
    }

    /// The wrench that accelerates the composite body `outer` by 1 rad/s^2 about z.
    #[inline(always)]
    fn of_unit_acceleration(outer: &CompositeBody) -> Wrench {
        let f = DVec3::new(-outer.h.y, outer.h.x, 0.0);
        Wrench { f, n: DVec3::new(outer.xz, outer.yz, outer.zz) }
    }

    /// The same wrench about the origin and in the axes of link `J`, for the wrench of the link
    /// next to `J`, whose joint has the angle of `turn`.
    #[inline(always)]
    fn in_parent<const J: usize>(self, arm: &BaseParameters, turn: JointRotation) -> Wrench {
        let (f, n) = (turn.to_parent(self.f), turn.to_parent(self.n));
        match J {
            5 => Wrench { f: rotate_x_minus_90(f), n: rotate_x_minus_90(n) },
            4 => Wrench { f: rotate_x_plus_90(f), n: rotate_x_plus_90(n) }.about_offset_z(arm.d4),
            3 => Wrench { f: rotate_x_minus_90(f), n: rotate_x_minus_90(n) }.about_offset_z(arm.d3),
            _ => {
                let moment = DVec3::new(0.0, -f.z, f.y);
                Wrench { f, n: n + arm.a2 * moment }
            }
        }
    }

    /// The same wrench about an origin from which the present one lies `by` (m) along z.
    #[inline(always)]
    fn about_offset_z(mut self, by: f64) -> Wrench {
        (self.n.x, self.n.y) = (self.n.x - by * self.f.y, self.n.y + by * self.f.x);
        self
    }

    /// The sum of two wrenches about the same origin.
    #[inline(always)]
    fn plus(self, other: Wrench) -> Wrench {
        Wrench { f: self.f + other.f, n: self.n + other.n }
    }
}

/// The moment about the origin that holds a link against the acceleration `a` (m/s^2) of a uniform
/// field (N m).
#[inline(always)]
fn weight_moment(link: &LinkParameters, a: DVec3) -> DVec3 {
    let (hx, hy) = (link.hx, link.hy);
    DVec3::new(hy * a.z, -hx * a.z, hx * a.y - hy * a.x)
}

/// The component about the axis of joint 1, which is vertical, of the moment `n` in the axes of
/// link 2, whose joint has the angle of `turn`.
#[inline(always)]
fn moment_about_vertical(turn: JointRotation, n: DVec3) -> f64 {
    turn.s * n.x + turn.c * n.y
}

/// Inverse dynamics of the rigid bodies (N m) at the joint speeds `qd` (rad/s) and accelerations
/// `qdd` (rad/s^2), with gravity.
pub(super) fn recursive_newton_euler(
    arm: &BaseParameters,
    gravity_m_s2: f64,
    at: &SinCos,
    qd: &Joints,
    qdd: &Joints,
) -> Joints {
    let turn: [JointRotation; 6] = core::array::from_fn(|i| JointRotation::new(at, i));
    let [two, three, four, five, six] = &arm.links;
    // Link 1 rotates about the vertical. Its axes are those after the twist of +90 deg, so that the
    // vertical is their y.
    let first = LinkMotion {
        w: DVec3::new(0.0, qd[0], 0.0),
        wd: DVec3::new(0.0, qdd[0], 0.0),
        a: DVec3::new(0.0, gravity_m_s2, 0.0),
    };
    let m2 = first.across_joint(turn[1], qd[1], qdd[1]);
    let m3 = m2.at_offset_x(arm.a2).across_joint(turn[2], qd[2], qdd[2]);
    // Expressing a vector in axes rotated by -90 deg rotates its components by +90 deg.
    let m4 = m3.at_offset_z(arm.d3).map(rotate_x_plus_90).across_joint(turn[3], qd[3], qdd[3]);
    let m5 = m4.at_offset_z(arm.d4).map(rotate_x_minus_90).across_joint(turn[4], qd[4], qdd[4]);
    let m6 = m5.map(rotate_x_plus_90).across_joint(turn[5], qd[5], qdd[5]);
    let w6 = Wrench::new(six, &m6);
    let w5 = w6.in_parent::<5>(arm, turn[5]).plus(Wrench::new(five, &m5));
    let w4 = w5.in_parent::<4>(arm, turn[4]).plus(Wrench::new(four, &m4));
    let w3 = w4.in_parent::<3>(arm, turn[3]).plus(Wrench::new(three, &m3));
    let w2 = w3.in_parent::<2>(arm, turn[2]).plus(Wrench::new(two, &m2));
    let about_1 = moment_about_vertical(turn[1], w2.n) + arm.vertical_inertia * qdd[0];
    Joints::new(about_1, w2.n.z, w3.n.z, w4.n.z, w5.n.z, w6.n.z)
}

/// The torques that hold the arm against gravity (N m). Links in base parameters have no mass, so
/// that only moments and no forces are propagated.
pub(super) fn gravity_torque(arm: &BaseParameters, gravity_m_s2: f64, at: &SinCos) -> Joints {
    let turn: [JointRotation; 6] = core::array::from_fn(|i| JointRotation::new(at, i));
    let [two, three, four, five, six] = &arm.links;
    let a2 = turn[1].to_link(DVec3::new(0.0, gravity_m_s2, 0.0));
    let a3 = turn[2].to_link(a2);
    let a4 = turn[3].to_link(rotate_x_plus_90(a3));
    let a5 = turn[4].to_link(rotate_x_minus_90(a4));
    let a6 = turn[5].to_link(rotate_x_plus_90(a5));
    let n6 = weight_moment(six, a6);
    let n5 = rotate_x_minus_90(turn[5].to_parent(n6)) + weight_moment(five, a5);
    let n4 = rotate_x_plus_90(turn[4].to_parent(n5)) + weight_moment(four, a4);
    let n3 = rotate_x_minus_90(turn[3].to_parent(n4)) + weight_moment(three, a3);
    let n2 = turn[2].to_parent(n3) + weight_moment(two, a2);
    Joints::new(moment_about_vertical(turn[1], n2), n2.z, n3.z, n4.z, n5.z, n6.z)
}

/// A link and all links outside it as one rigid body: first moment `h` (kg m) and moments of
/// inertia (kg m^2). Its mass is zero, as those of its parts are.
#[derive(Clone, Copy)]
struct CompositeBody {
    h: DVec3,
    xx: f64,
    yy: f64,
    zz: f64,
    xy: f64,
    xz: f64,
    yz: f64,
}

impl CompositeBody {
    fn new(link: &LinkParameters) -> CompositeBody {
        let h = DVec3::new(link.hx, link.hy, 0.0);
        CompositeBody {
            h,
            xx: link.xx,
            yy: 0.0,
            zz: link.zz,
            xy: link.xy,
            xz: link.xz,
            yz: link.yz,
        }
    }

    /// The same body in the axes before the joint, which has the angle of `turn`.
    #[inline(always)]
    fn to_parent_axes(self, turn: JointRotation) -> CompositeBody {
        let CompositeBody { xx, yy, zz, xy, xz, yz, .. } = self;
        let bend = turn.s * (xx - yy) + 2.0 * turn.c * xy;
        CompositeBody {
            h: turn.to_parent(self.h),
            xx: xx - turn.s * bend,
            yy: yy + turn.s * bend,
            zz,
            xy: turn.c * bend - xy,
            xz: turn.c * xz - turn.s * yz,
            yz: turn.s * xz + turn.c * yz,
        }
    }

    /// The same body rotated by +90 deg about x.
    #[inline(always)]
    fn rotate_x_plus_90(self) -> CompositeBody {
        let CompositeBody { xx, yy, zz, xy, xz, yz, .. } = self;
        CompositeBody { h: rotate_x_plus_90(self.h), xx, yy: zz, zz: yy, xy: -xz, xz: xy, yz: -yz }
    }

    /// The same body rotated by -90 deg about x.
    #[inline(always)]
    fn rotate_x_minus_90(self) -> CompositeBody {
        let CompositeBody { xx, yy, zz, xy, xz, yz, .. } = self;
        CompositeBody { h: rotate_x_minus_90(self.h), xx, yy: zz, zz: yy, xy: xz, xz: -xy, yz: -yz }
    }

    /// The same body about an origin from which the present one lies `by` (m) along z.
    #[inline(always)]
    fn about_offset_z(mut self, by: f64) -> CompositeBody {
        let twice = 2.0 * by * self.h.z;
        (self.xx, self.yy) = (self.xx + twice, self.yy + twice);
        (self.xz, self.yz) = (self.xz - by * self.h.x, self.yz - by * self.h.y);
        self
    }

    /// The same body about the origin and in the axes of link `J`, see [`Wrench::in_parent`].
    #[inline(always)]
    fn in_parent<const J: usize>(self, arm: &BaseParameters, turn: JointRotation) -> CompositeBody {
        let mut out = self.to_parent_axes(turn);
        match J {
            5 => out.rotate_x_minus_90(),
            4 => out.rotate_x_plus_90().about_offset_z(arm.d4),
            3 => out.rotate_x_minus_90().about_offset_z(arm.d3),
            _ => {
                let twice = 2.0 * arm.a2 * out.h.x;
                (out.yy, out.zz) = (out.yy + twice, out.zz + twice);
                (out.xy, out.xz) = (out.xy - arm.a2 * out.h.y, out.xz - arm.a2 * out.h.z);
                out
            }
        }
    }

    /// The union of the body with `link`, about the same origin.
    #[inline(always)]
    fn with_link(self, link: &LinkParameters) -> CompositeBody {
        CompositeBody {
            h: DVec3::new(self.h.x + link.hx, self.h.y + link.hy, self.h.z),
            xx: self.xx + link.xx,
            yy: self.yy,
            zz: self.zz + link.zz,
            xy: self.xy + link.xy,
            xz: self.xz + link.xz,
            yz: self.yz + link.yz,
        }
    }
}

/// The mass matrix of the rigid bodies (kg m^2) by the composite rigid body algorithm.
pub(super) fn composite_rigid_body(arm: &BaseParameters, at: &SinCos) -> Matrix6 {
    let turn: [JointRotation; 6] = core::array::from_fn(|i| JointRotation::new(at, i));
    let [two, three, four, five, six] = &arm.links;
    // The torques at the joints up to that of a link, from the wrench on that link.
    let below_2 = |w: Wrench| [moment_about_vertical(turn[1], w.n), w.n.z];
    let below_3 = |w: Wrench| {
        let [a, b] = below_2(w.in_parent::<2>(arm, turn[2]));
        [a, b, w.n.z]
    };
    let below_4 = |w: Wrench| {
        let [a, b, c] = below_3(w.in_parent::<3>(arm, turn[3]));
        [a, b, c, w.n.z]
    };
    let below_5 = |w: Wrench| {
        let [a, b, c, d] = below_4(w.in_parent::<4>(arm, turn[4]));
        [a, b, c, d, w.n.z]
    };
    let o6 = CompositeBody::new(six);
    let w6 = Wrench::of_unit_acceleration(&o6);
    let [a6, b6, c6, d6, e6] = below_5(w6.in_parent::<5>(arm, turn[5]));
    let o5 = o6.in_parent::<5>(arm, turn[5]).with_link(five);
    let [a5, b5, c5, d5, e5] = below_5(Wrench::of_unit_acceleration(&o5));
    let o4 = o5.in_parent::<4>(arm, turn[4]).with_link(four);
    let [a4, b4, c4, d4] = below_4(Wrench::of_unit_acceleration(&o4));
    let o3 = o4.in_parent::<3>(arm, turn[3]).with_link(three);
    let [a3, b3, c3] = below_3(Wrench::of_unit_acceleration(&o3));
    let o2 = o3.in_parent::<2>(arm, turn[2]).with_link(two);
    let [a2, b2] = below_2(Wrench::of_unit_acceleration(&o2));
    let a1 = arm.vertical_inertia + o2.to_parent_axes(turn[1]).yy;
    Matrix6::from_columns(&[
        Joints::new(a1, a2, a3, a4, a5, a6),
        Joints::new(a2, b2, b3, b4, b5, b6),
        Joints::new(a3, b3, c3, c4, c5, c6),
        Joints::new(a4, b4, c4, d4, d5, d6),
        Joints::new(a5, b5, c5, d5, e5, e6),
        Joints::new(a6, b6, c6, d6, e6, w6.n.z),
    ])
}

/// Potential energy (J), from the vertical component of the first moment of all links.
pub(super) fn potential_energy_j(arm: &BaseParameters, gravity_m_s2: f64, at: &SinCos) -> f64 {
    let turn: [JointRotation; 6] = core::array::from_fn(|i| JointRotation::new(at, i));
    let [two, three, four, five, six] = arm.links.map(|link| DVec3::new(link.hx, link.hy, 0.0));
    let h5 = rotate_x_minus_90(turn[5].to_parent(six)) + five;
    let h4 = rotate_x_plus_90(turn[4].to_parent(h5)) + four;
    let h3 = rotate_x_minus_90(turn[3].to_parent(h4)) + three;
    let h2 = turn[2].to_parent(h3) + two;
    gravity_m_s2 * (arm.vertical_first_moment + turn[1].to_parent(h2).y)
}
