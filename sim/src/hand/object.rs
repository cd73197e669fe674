//! The object that a hand holds: a solid sphere, cylinder or cuboid that moves freely. Where a line
//! enters and leaves it gives its penetration into a fingertip's face; its lowest points carry it
//! on the support.

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;

use crate::hash::Hash;

/// Points on each rim of a cylinder that may touch the support.
const RIM_POINTS: usize = 8;
/// The most points of an object that may touch the support.
pub(super) const SUPPORT_POINTS_MAX: usize = 2 * RIM_POINTS;

/// The shape of an object, about its centre; a cylinder's axis is its own z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Solid {
    Sphere { radius_m: f64 },
    Cylinder { radius_m: f64, half_length_m: f64 },
    Cuboid { half_m: DVec3 },
}

/// Where a line is inside a body, as lengths along its direction (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chord {
    pub(super) enters_m: f64,
    pub(super) leaves_m: f64,
}

impl Chord {
    const EMPTY: Chord = Chord { enters_m: f64::INFINITY, leaves_m: f64::NEG_INFINITY };
    const WHOLE: Chord = Chord { enters_m: f64::NEG_INFINITY, leaves_m: f64::INFINITY };

    fn and(self, other: Chord) -> Chord {
        Chord {
            enters_m: self.enters_m.max(other.enters_m),
            leaves_m: self.leaves_m.min(other.leaves_m),
        }
    }

    /// The part of a line within `half` of a plane through the origin, along one axis.
    fn slab(from: f64, direction: f64, half: f64) -> Chord {
        if direction == 0.0 {
            return if from.abs() <= half { Chord::WHOLE } else { Chord::EMPTY };
        }
        let (a, b) = ((-half - from) / direction, (half - from) / direction);
        Chord { enters_m: a.min(b), leaves_m: a.max(b) }
    }

    /// The roots of `a t^2 + 2 b t + c`, between which the line is inside.
    fn between_roots(a: f64, b: f64, c: f64) -> Chord {
        if a <= 0.0 {
            return if c <= 0.0 { Chord::WHOLE } else { Chord::EMPTY };
        }
        let square = b * b - a * c;
        if square <= 0.0 {
            return Chord::EMPTY;
        }
        let root = square.sqrt();
        Chord { enters_m: (-b - root) / a, leaves_m: (-b + root) / a }
    }
}

impl Solid {
    /// Radius of the sphere about the centre that contains the body (m).
    pub(super) fn bound_m(&self) -> f64 {
        match *self {
            Solid::Sphere { radius_m } => radius_m,
            Solid::Cylinder { radius_m, half_length_m } => libm::hypot(radius_m, half_length_m),
            Solid::Cuboid { half_m } => half_m.length(),
        }
    }

    /// Principal moments of inertia of a homogeneous body (kg m^2).
    pub(super) fn moments_kg_m2(&self, mass_kg: f64) -> DVec3 {
        match *self {
            Solid::Sphere { radius_m } => DVec3::splat(0.4 * mass_kg * radius_m * radius_m),
            Solid::Cylinder { radius_m, half_length_m } => {
                let (disc, rod) = (radius_m * radius_m, half_length_m * half_length_m);
                let across = mass_kg * (disc / 4.0 + rod / 3.0);
                DVec3::new(across, across, 0.5 * mass_kg * disc)
            }
            Solid::Cuboid { half_m } => {
                let s = half_m * half_m * (mass_kg / 3.0);
                DVec3::new(s.y + s.z, s.z + s.x, s.x + s.y)
            }
        }
    }

    /// Whether a point, in the body's axes about its centre, is farther than `reach_m` from every
    /// point of the body; false where that is not known at once.
    #[inline(always)]
    pub(super) fn is_outside(&self, point: DVec3, reach_m: f64) -> bool {
        match *self {
            Solid::Sphere { radius_m } => {
                let reach = radius_m + reach_m;
                point.length_squared() > reach * reach
            }
            Solid::Cylinder { radius_m, half_length_m } => {
                let reach = radius_m + reach_m;
                point.truncate().length_squared() > reach * reach
                    || point.z.abs() > half_length_m + reach_m
            }
            Solid::Cuboid { half_m } => (point.abs() - half_m).max_element() > reach_m,
        }
    }

    /// Where the line from `origin` along `direction` (unit vector) is inside, both in the body's
    /// axes about its centre.
    #[inline(always)]
    pub(super) fn chord(&self, origin: DVec3, direction: DVec3) -> Chord {
        match *self {
            Solid::Sphere { radius_m } => Chord::between_roots(
                1.0,
                origin.dot(direction),
                origin.length_squared() - radius_m * radius_m,
            ),
            Solid::Cylinder { radius_m, half_length_m } => {
                let (o, d) = (origin.truncate(), direction.truncate());
                let c = o.length_squared() - radius_m * radius_m;
                let round = Chord::between_roots(d.length_squared(), o.dot(d), c);
                round.and(Chord::slab(origin.z, direction.z, half_length_m))
            }
            Solid::Cuboid { half_m } => Chord::slab(origin.x, direction.x, half_m.x)
                .and(Chord::slab(origin.y, direction.y, half_m.y))
                .and(Chord::slab(origin.z, direction.z, half_m.z)),
        }
    }

    /// The points of the body, from its centre in base axes (m), that may touch a level support;
    /// the number of them is returned.
    pub(super) fn support_points(
        &self,
        rotation: &DMat3,
        points: &mut [DVec3; SUPPORT_POINTS_MAX],
    ) -> usize {
        match *self {
            Solid::Sphere { radius_m } => {
                points[0] = DVec3::new(0.0, 0.0, -radius_m);
                1
            }
            Solid::Cylinder { radius_m, half_length_m } => {
                for (i, point) in points.iter_mut().enumerate() {
                    let (end, place) = (i / RIM_POINTS, i % RIM_POINTS);
                    let angle = core::f64::consts::TAU * place as f64 / RIM_POINTS as f64;
                    let (s, c) = libm::sincos(angle);
                    let z = if end == 0 { half_length_m } else { -half_length_m };
                    *point = *rotation * DVec3::new(radius_m * c, radius_m * s, z);
                }
                2 * RIM_POINTS
            }
            Solid::Cuboid { half_m } => {
                for (i, point) in points.iter_mut().enumerate().take(8) {
                    let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
                    *point = *rotation * (half_m * DVec3::new(sign(0), sign(1), sign(2)));
                }
                8
            }
        }
    }

    /// Height of the centre over a level support when the body stands or lies on it as it is turned
    /// (m).
    pub(super) fn rest_height_m(&self, rotation: &DMat3) -> f64 {
        let mut points = [DVec3::ZERO; SUPPORT_POINTS_MAX];
        let count = self.support_points(rotation, &mut points);
        points[..count].iter().fold(0.0, |height, point| height.max(-point.z))
    }
}

/// Place and motion of the object, base frame; the place is that of its centre of mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub(super) pose: Pose,
    pub(super) velocity: DVec3,
    pub(super) spin: DVec3,
}

impl Motion {
    pub(super) fn digest(&self, hash: &mut Hash) {
        hash.vector(self.pose.translation);
        for axis in [self.pose.rotation.x_axis, self.pose.rotation.y_axis] {
            hash.vector(axis);
        }
        hash.vector(self.velocity);
        hash.vector(self.spin);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_through_the_middle_is_as_long_as_the_body() {
        let (radius_m, half_length_m) = (0.02, 0.03);
        let half_m = DVec3::new(0.01, 0.02, 0.03);
        for (solid, along, half) in [
            (Solid::Sphere { radius_m }, DVec3::X, radius_m),
            (Solid::Cylinder { radius_m, half_length_m }, DVec3::X, radius_m),
            (Solid::Cylinder { radius_m, half_length_m }, DVec3::Z, half_length_m),
            (Solid::Cuboid { half_m }, DVec3::Y, 0.02),
        ] {
            let chord = solid.chord(-0.1 * along, along);
            assert!((chord.enters_m - (0.1 - half)).abs() < 1e-15, "{solid:?} {chord:?}");
            assert!((chord.leaves_m - (0.1 + half)).abs() < 1e-15, "{solid:?} {chord:?}");
            let beside = solid.chord(DVec3::splat(0.2), along);
            assert!(beside.enters_m > beside.leaves_m, "{solid:?}");
        }
    }

    #[test]
    fn a_tilted_line_enters_a_corner_where_its_planes_meet() {
        let half_m = DVec3::splat(0.01);
        let along = DVec3::ONE.normalize();
        let chord = Solid::Cuboid { half_m }.chord(-along, along);
        let corner = 1.0 - half_m.length();
        assert!((chord.enters_m - corner).abs() < 1e-15, "{chord:?}");
    }

    #[test]
    fn bodies_rest_on_their_lowest_points() {
        let level = DMat3::IDENTITY;
        let lying = taktil_mechanics::spatial::rotation_x(core::f64::consts::FRAC_PI_2);
        let solid = Solid::Cylinder { radius_m: 0.02, half_length_m: 0.03 };
        assert!((solid.rest_height_m(&level) - 0.03).abs() < 1e-15);
        assert!((solid.rest_height_m(&lying) - 0.02).abs() < 1e-15);
        let cube = Solid::Cuboid { half_m: DVec3::splat(0.02) };
        assert!((cube.rest_height_m(&level) - 0.02).abs() < 1e-15);
    }

    #[test]
    fn a_long_cylinder_turns_as_a_rod_and_a_cube_alike_about_every_axis() {
        let rod = Solid::Cylinder { radius_m: 1e-6, half_length_m: 0.5 };
        assert!((rod.moments_kg_m2(1.2).x - 0.1).abs() < 1e-9);
        let cube = Solid::Cuboid { half_m: DVec3::splat(0.5) }.moments_kg_m2(6.0);
        assert!((cube - DVec3::ONE).length() < 1e-15);
    }
}
