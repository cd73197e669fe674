//! The base inertial parameters of the PUMA 260: the smallest set of numbers that determines its
//! torques (Gautier and Khalil 1990). The part of a link's inertia that acts in the same way as a
//! part of the link before it is regrouped to that link. A link is left with no mass, a first
//! moment perpendicular to the axis of its joint and five moments of inertia, for which the
//! recursions are written.
//!
//! The regrouping is exact: the torques are those of the bodies to rounding. The twists of the PUMA
//! 260 are written into the code.

use crate::puma260::Puma260;
use crate::rigid_body::{Body, first_moment_inertia, parallel_axis_inertia};
use glam::{DMat3, DVec3};

/// The base parameters of a link that rotates about its z axis, about an origin on that axis and in
/// axes that rotate with it. Its mass, its first moment along z and its moment of inertia about y
/// are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LinkParameters {
    /// First moment of mass (kg m).
    pub(super) hx: f64,
    pub(super) hy: f64,
    /// Inertia about the origin (kg m^2).
    pub(super) xx: f64,
    pub(super) xy: f64,
    pub(super) xz: f64,
    pub(super) yz: f64,
    pub(super) zz: f64,
}

/// The base parameters of the whole arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BaseParameters {
    /// Moment of inertia of link 1 about the vertical axis of joint 1 (kg m^2).
    pub(super) vertical_inertia: f64,
    /// First moment of link 1 along the vertical (kg m).
    pub(super) vertical_first_moment: f64,
    /// Links 2 to 6.
    pub(super) links: [LinkParameters; 5],
    /// Distance from the axis of joint 2 to that of joint 3, along x (m).
    pub(super) a2: f64,
    /// Offset along the axis of joint 3, and distance along the axis of joint 4 to the wrist centre
    /// (m).
    pub(super) d3: f64,
    pub(super) d4: f64,
}

/// Sine and cosine of the twist about x from the axis of a joint to that of the next one.
struct Twist {
    sin: f64,
    cos: f64,
}

/// The twists of the six joints: +90, 0, -90, +90, -90 and 0 deg.
const TWISTS: [Twist; 6] = [
    Twist { sin: 1.0, cos: 0.0 },
    Twist { sin: 0.0, cos: 1.0 },
    Twist { sin: -1.0, cos: 0.0 },
    Twist { sin: 1.0, cos: 0.0 },
    Twist { sin: -1.0, cos: 0.0 },
    Twist { sin: 0.0, cos: 1.0 },
];

/// Mass (kg), first moment (kg m) and inertia (kg m^2) about an origin.
#[derive(Clone, Copy)]
struct Moments {
    mass: f64,
    first: DVec3,
    inertia: DMat3,
}

impl Moments {
    /// The moments of `body`, which is given in the frame of its link, about the origin of the
    /// joint of that link. `offset` is the vector from that origin to the frame, in the axes of the
    /// frame (m). `twist` takes the axes of the frame to those of the joint, which rotate with the
    /// link.
    fn new(body: &Body, offset: DVec3, twist: DMat3) -> Moments {
        let com = body.com_m + offset;
        let inertia = body.inertia_kg_m2 + parallel_axis_inertia(body.mass_kg, com);
        Moments {
            mass: body.mass_kg,
            first: twist * (body.mass_kg * com),
            inertia: twist * inertia * twist.transpose(),
        }
    }

    /// Takes out the part that a rotation about z does not change, and returns it: the mass and
    /// first moment on the axis, and equal moments of inertia about x and y.
    fn take_regrouped(&mut self) -> Moments {
        let transverse = self.inertia.y_axis.y;
        let axial = Moments {
            mass: self.mass,
            first: DVec3::new(0.0, 0.0, self.first.z),
            inertia: DMat3::from_diagonal(DVec3::new(transverse, transverse, 0.0)),
        };
        self.mass = 0.0;
        self.first.z = 0.0;
        self.inertia -= axial.inertia;
        axial
    }

    /// Adds the moments `other`, whose origin is at `place` (m) and whose axes are rotated by
    /// `twist`.
    fn add(&mut self, other: &Moments, place: DVec3, twist: DMat3) {
        let first = twist * other.first;
        let inertia = twist * other.inertia * twist.transpose();
        self.inertia +=
            inertia + first_moment_inertia(first, place) + parallel_axis_inertia(other.mass, place);
        self.first += first + other.mass * place;
        self.mass += other.mass;
    }
}

impl BaseParameters {
    /// The base parameters of six bodies, given in their distal Denavit-Hartenberg frames, on an
    /// arm with the dimensions of `arm`.
    pub(super) fn new(bodies: &[Body; 6], arm: &Puma260) -> BaseParameters {
        let (a2, d3, d4) = (arm.a2_m, arm.d3_m, arm.d4_m);
        let twists = TWISTS.map(|Twist { sin, cos }| {
            DMat3::from_cols(DVec3::X, DVec3::new(0.0, cos, sin), DVec3::new(0.0, -sin, cos))
        });
        // Vectors from the origin of each joint to that of the next one, in the axes of the former.
        let mut places = [DVec3::ZERO; 6];
        places[1] = DVec3::new(a2, 0.0, 0.0);
        places[2] = DVec3::new(0.0, 0.0, d3);
        places[3] = DVec3::new(0.0, 0.0, d4);
        let mut all: [Moments; 6] = core::array::from_fn(|i| {
            Moments::new(&bodies[i], twists[i].transpose() * places[i], twists[i])
        });
        for i in (1..6).rev() {
            let axial = all[i].take_regrouped();
            all[i - 1].add(&axial, places[i - 1], twists[i - 1]);
        }
        let links = core::array::from_fn(|i| {
            let Moments { first, inertia, .. } = &all[i + 1];
            LinkParameters {
                hx: first.x,
                hy: first.y,
                xx: inertia.x_axis.x,
                xy: inertia.x_axis.y,
                xz: inertia.x_axis.z,
                yz: inertia.y_axis.z,
                zz: inertia.z_axis.z,
            }
        });
        let Moments { first, inertia, .. } = &all[0];
        BaseParameters {
            vertical_inertia: inertia.z_axis.z,
            vertical_first_moment: first.z,
            links,
            a2,
            d3,
            d4,
        }
    }
}
