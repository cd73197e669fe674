//! The arm's inertia in the fewest numbers: what of a link does not tell its own turning from that
//! of the link before it is handed on inwards (Gautier and Khalil 1990). A link is left with no
//! mass, a first moment across its joint's axis and five moments of inertia; the recursions of the
//! module beside are written for such links. Refuses any chain but the PUMA's: its twists are here.
//!
//! All of it is exact: the torques are those of the bodies, to rounding.

use crate::rigid_body::{Body, first_moment_inertia, parallel_axis_inertia};
use glam::{DMat3, DVec3};

/// A link that turns about its z axis, seen from an origin on that axis, in axes that turn with it:
/// no mass, nothing along the axis, no moment of inertia about y.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LinkParameters {
    /// First moment (kg m).
    pub(super) hx: f64,
    pub(super) hy: f64,
    /// Inertia about the origin (kg m^2).
    pub(super) xx: f64,
    pub(super) xy: f64,
    pub(super) xz: f64,
    pub(super) yz: f64,
    pub(super) zz: f64,
}

/// The whole arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct BaseParameters {
    /// Moment of inertia of link 1 about the vertical (kg m^2).
    pub(super) vertical_inertia: f64,
    /// Its first moment along the vertical (kg m).
    pub(super) vertical_first_moment: f64,
    /// ArmDynamics 2 to 6.
    pub(super) links: [LinkParameters; 5],
    /// From the shoulder's axis to the elbow's, along x (m).
    pub(super) a2: f64,
    /// Along the elbow's axis to the next one's, and along that to the wrist's centre (m).
    pub(super) d3: f64,
    pub(super) d4: f64,
}

/// Turn about x from a joint's axis to the next one's: signs of `(sin, cos)`, a quarter turn or
/// none.
const TWIST_SIN_COS: [(f64, f64); 6] =
    [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0)];

/// Mass, first moment and inertia about an origin.
#[derive(Clone, Copy)]
struct Moments {
    mass: f64,
    first: DVec3,
    inertia: DMat3,
}

impl Moments {
    /// A body of a link's frame about the origin of the joint before it, in axes of that joint that
    /// turn with the link; `offset` leads from that origin to the frame, in the frame's axes.
    fn new(body: &Body, offset: DVec3, turn: DMat3) -> Moments {
        let com = body.com_m + offset;
        let inertia = body.inertia_kg_m2 + parallel_axis_inertia(body.mass_kg, com);
        Moments {
            mass: body.mass_kg,
            first: turn * (body.mass_kg * com),
            inertia: turn * inertia * turn.transpose(),
        }
    }

    /// What does not notice a turn about z, taken out: a mass on the axis and equal moments of
    /// inertia across it.
    fn take_regrouped(&mut self) -> Moments {
        let across = self.inertia.y_axis.y;
        let axial = Moments {
            mass: self.mass,
            first: DVec3::new(0.0, 0.0, self.first.z),
            inertia: DMat3::from_diagonal(DVec3::new(across, across, 0.0)),
        };
        self.mass = 0.0;
        self.first.z = 0.0;
        self.inertia -= axial.inertia;
        axial
    }

    /// Adds what is seen from an origin at `place`, in axes turned by `turn`.
    fn add(&mut self, other: &Moments, place: DVec3, turn: DMat3) {
        let first = turn * other.first;
        let inertia = turn * other.inertia * turn.transpose();
        self.inertia +=
            inertia + first_moment_inertia(first, place) + parallel_axis_inertia(other.mass, place);
        self.first += first + other.mass * place;
        self.mass += other.mass;
    }
}

impl BaseParameters {
    /// Of the links' bodies in their distal Denavit-Hartenberg frames.
    pub(super) fn new(bodies: &[Body; 6], (a2, d3, d4): (f64, f64, f64)) -> BaseParameters {
        let turns = TWIST_SIN_COS.map(|(sin, cos)| {
            DMat3::from_cols(DVec3::X, DVec3::new(0.0, cos, sin), DVec3::new(0.0, -sin, cos))
        });
        // From each joint to the next, in axes of that joint that turn with its link.
        let mut places = [DVec3::ZERO; 6];
        places[1] = DVec3::new(a2, 0.0, 0.0);
        places[2] = DVec3::new(0.0, 0.0, d3);
        places[3] = DVec3::new(0.0, 0.0, d4);
        let mut all: [Moments; 6] = core::array::from_fn(|i| {
            Moments::new(&bodies[i], turns[i].transpose() * places[i], turns[i])
        });
        for i in (1..6).rev() {
            let axial = all[i].take_regrouped();
            all[i - 1].add(&axial, places[i - 1], turns[i - 1]);
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
