//! The recursions along the chain. Refuses any chain but the PUMA's: the twists are in the code.

use super::{Dynamics, steiner};
use crate::spatial::{Joints, Matrix6, SinCos};
use glam::{DMat3, DVec3};

/// Twist of a link: the turn about x between two joint axes.
#[derive(Clone, Copy)]
enum Twist {
    Plus90,
    None,
    Minus90,
}

const TWISTS: [Twist; 6] =
    [Twist::Plus90, Twist::None, Twist::Minus90, Twist::Plus90, Twist::Minus90, Twist::None];

/// One joint: `Rz(theta) Rx(alpha)` by its sine and cosine.
#[derive(Clone, Copy)]
struct Turn {
    s: f64,
    c: f64,
}

impl Turn {
    /// A vector of frame i-1 in frame i.
    #[inline(always)]
    fn down(self, twist: Twist, v: DVec3) -> DVec3 {
        let (x, y) = (self.c * v.x + self.s * v.y, self.c * v.y - self.s * v.x);
        match twist {
            Twist::Plus90 => DVec3::new(x, v.z, -y),
            Twist::None => DVec3::new(x, y, v.z),
            Twist::Minus90 => DVec3::new(x, -v.z, y),
        }
    }

    /// A vector of frame i in frame i-1.
    #[inline(always)]
    fn up(self, twist: Twist, v: DVec3) -> DVec3 {
        let (y, z) = match twist {
            Twist::Plus90 => (-v.z, v.y),
            Twist::None => (v.y, v.z),
            Twist::Minus90 => (v.z, -v.y),
        };
        DVec3::new(self.c * v.x - self.s * y, self.s * v.x + self.c * y, z)
    }

    /// A symmetric matrix of frame i in frame i-1.
    #[inline(always)]
    fn up_matrix(self, twist: Twist, m: &DMat3) -> DMat3 {
        let half = DMat3::from_cols(
            self.up(twist, m.x_axis),
            self.up(twist, m.y_axis),
            self.up(twist, m.z_axis),
        )
        .transpose();
        DMat3::from_cols(
            self.up(twist, half.x_axis),
            self.up(twist, half.y_axis),
            self.up(twist, half.z_axis),
        )
    }
}

fn turns(at: &SinCos) -> [Turn; 6] {
    core::array::from_fn(|i| Turn { s: at.s[i], c: at.c[i] })
}

/// Origins of the frames seen from the one before, in the axes of the frame itself:
/// `(a, d sin alpha, d cos alpha)` (m).
fn offsets(arm: &Dynamics) -> [DVec3; 6] {
    let mut p = [DVec3::ZERO; 6];
    p[1] = DVec3::new(arm.a2_m, 0.0, 0.0);
    p[2] = DVec3::new(0.0, -arm.d3_m, 0.0);
    p[3] = DVec3::new(0.0, arm.d4_m, 0.0);
    p
}

/// Inverse dynamics of the rigid bodies with gravity (N m).
pub(super) fn newton_euler(arm: &Dynamics, at: &SinCos, qd: &Joints, qdd: &Joints) -> Joints {
    let turn = turns(at);
    let offset = offsets(arm);
    let mut force = [DVec3::ZERO; 6];
    let mut moment = [DVec3::ZERO; 6];
    let (mut w, mut wd) = (DVec3::ZERO, DVec3::ZERO);
    let mut a = DVec3::new(0.0, 0.0, arm.gravity_m_s2);
    for i in 0..6 {
        let (t, twist, p, body) = (turn[i], TWISTS[i], offset[i], &arm.bodies[i]);
        // w x (z qd) = (w.y, -w.x, 0) qd
        let turned = DVec3::new(wd.x + w.y * qd[i], wd.y - w.x * qd[i], wd.z + qdd[i]);
        wd = t.down(twist, turned);
        w = t.down(twist, DVec3::new(w.x, w.y, w.z + qd[i]));
        a = t.down(twist, a) + wd.cross(p) + w.cross(w.cross(p));
        let com = body.com_m;
        force[i] = body.mass_kg * (a + wd.cross(com) + w.cross(w.cross(com)));
        moment[i] = body.inertia_kg_m2 * wd + w.cross(body.inertia_kg_m2 * w);
    }
    gather(arm, &turn, &offset, &force, &moment)
}

/// The static case: no turning, so no moments and one turn of gravity per link.
pub(super) fn gravity(arm: &Dynamics, at: &SinCos) -> Joints {
    let turn = turns(at);
    let mut force = [DVec3::ZERO; 6];
    let mut a = DVec3::new(0.0, 0.0, arm.gravity_m_s2);
    for i in 0..6 {
        a = turn[i].down(TWISTS[i], a);
        force[i] = arm.bodies[i].mass_kg * a;
    }
    gather(arm, &turn, &offsets(arm), &force, &[DVec3::ZERO; 6])
}

/// The inward half: joint torques that carry a force at, and a moment about, each centre of mass.
#[inline(always)]
fn gather(
    arm: &Dynamics,
    turn: &[Turn; 6],
    offset: &[DVec3; 6],
    force: &[DVec3; 6],
    moment: &[DVec3; 6],
) -> Joints {
    let mut tau = Joints::zeros();
    let (mut f, mut n) = (DVec3::ZERO, DVec3::ZERO);
    for i in (0..6).rev() {
        let p = offset[i];
        n += p.cross(f) + (p + arm.bodies[i].com_m).cross(force[i]) + moment[i];
        f += force[i];
        f = turn[i].up(TWISTS[i], f);
        n = turn[i].up(TWISTS[i], n);
        tau[i] = n.z;
    }
    tau
}

/// The mass matrix of the rigid bodies by composite bodies (kg m^2).
pub(super) fn composite(arm: &Dynamics, at: &SinCos) -> Matrix6 {
    let turn = turns(at);
    let offset = offsets(arm);
    let mut out = Matrix6::zeros();
    // Everything from link i outwards: mass, first moment and inertia about the origin of frame
    // i-1.
    let (mut mass, mut first, mut inertia) = (0.0, DVec3::ZERO, DMat3::ZERO);
    for i in (0..6).rev() {
        let (body, p) = (&arm.bodies[i], offset[i]);
        // What hangs on frame i moves to the origin of frame i-1.
        inertia = inertia + carry(first, p) + steiner(mass, p);
        first += mass * p;
        let com = body.com_m + p;
        mass += body.mass_kg;
        first += body.mass_kg * com;
        inertia = inertia + body.inertia_kg_m2 + steiner(body.mass_kg, com);
        first = turn[i].up(TWISTS[i], first);
        inertia = turn[i].up_matrix(TWISTS[i], &inertia);
        // Unit acceleration about z of frame i-1: force z x first, moment inertia z.
        let mut f = DVec3::new(-first.y, first.x, 0.0);
        let mut n = inertia.z_axis;
        out[(i, i)] = n.z;
        for j in (0..i).rev() {
            n += offset[j].cross(f);
            f = turn[j].up(TWISTS[j], f);
            n = turn[j].up(TWISTS[j], n);
            out[(i, j)] = n.z;
            out[(j, i)] = n.z;
        }
    }
    out
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

/// Potential energy (J): the first moment of all bodies, carried inwards to the base.
pub(super) fn potential(arm: &Dynamics, at: &SinCos) -> f64 {
    let turn = turns(at);
    let offset = offsets(arm);
    let (mut mass, mut first) = (0.0, DVec3::ZERO);
    for i in (0..6).rev() {
        mass += arm.bodies[i].mass_kg;
        first += arm.bodies[i].mass_kg * arm.bodies[i].com_m + mass * offset[i];
        first = turn[i].up(TWISTS[i], first);
    }
    arm.gravity_m_s2 * first.z
}
