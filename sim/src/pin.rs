//! The pin: a free rigid body, a solid cylinder with its axis along its own y. It is moved by the
//! force and the moment that the contacts give.

use glam::{DMat3, DQuat, DVec3};

use crate::hash::Hash;

/// Radius and length of a cylinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CylinderSize {
    pub(crate) radius_m: f64,
    pub(crate) length_m: f64,
}

/// State and inertia of the pin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pin {
    /// Centre of mass (m, base frame).
    pub(crate) position: DVec3,
    /// Body axes in the base frame; the cylinder's axis is the body's y.
    pub(crate) orientation: DQuat,
    /// Velocity of the centre (m/s).
    pub(crate) velocity: DVec3,
    /// Angular velocity (rad/s, base frame).
    pub(crate) spin: DVec3,
    /// Angle turned about the pin's own axis since the start (rad), not wrapped.
    pub(crate) roll_rad: f64,
    /// Radius (m).
    pub(crate) radius_m: f64,
    /// Length (m).
    pub(crate) length_m: f64,
    /// Mass (kg).
    pub(crate) mass_kg: f64,
}

impl Pin {
    /// A pin at rest whose body axes are the given columns.
    #[must_use]
    pub(crate) fn at_rest(position: DVec3, axes: &DMat3, size: CylinderSize, mass_kg: f64) -> Pin {
        Pin {
            position,
            orientation: DQuat::from_mat3(axes).normalize(),
            velocity: DVec3::ZERO,
            spin: DVec3::ZERO,
            roll_rad: 0.0,
            radius_m: size.radius_m,
            length_m: size.length_m,
            mass_kg,
        }
    }

    /// The cylinder's axis (unit vector, base frame).
    #[must_use]
    pub(crate) fn axis(&self) -> DVec3 {
        self.orientation * DVec3::Y
    }

    /// Moments of inertia about the axis and across it (kg m^2).
    #[must_use]
    pub(crate) fn principal_inertia_kg_m2(&self) -> (f64, f64) {
        let r2 = self.radius_m * self.radius_m;
        let along = 0.5 * self.mass_kg * r2;
        let across = self.mass_kg * (3.0 * r2 + self.length_m * self.length_m) / 12.0;
        (along, across)
    }

    /// Inertia tensor about the centre in base axes (kg m^2).
    #[must_use]
    pub(crate) fn inertia_tensor(&self) -> DMat3 {
        let (along, across) = self.principal_inertia_kg_m2();
        let (a, rest) = (self.axis(), along - across);
        let outer = DMat3::from_cols(a * a.x, a * a.y, a * a.z);
        DMat3::from_diagonal(DVec3::splat(across)) + outer * rest
    }

    /// Angular momentum about the centre (kg m^2/s).
    #[must_use]
    pub(crate) fn angular_momentum(&self) -> DVec3 {
        let (along, across) = self.principal_inertia_kg_m2();
        let a = self.axis();
        across * self.spin + (along - across) * a.dot(self.spin) * a
    }

    /// The pin after `h` seconds of motion at this velocity and spin, which it has at the end.
    #[must_use]
    pub(crate) fn moved(&self, velocity: DVec3, spin: DVec3, h: f64) -> Pin {
        let half = 0.5 * h * spin;
        let turn = DQuat::from_xyzw(half.x, half.y, half.z, 1.0);
        let orientation = (turn * self.orientation).normalize();
        let axis = orientation * DVec3::Y;
        Pin {
            position: self.position + h * velocity,
            orientation,
            velocity,
            spin,
            roll_rad: self.roll_rad + h * spin.dot(axis),
            ..*self
        }
    }

    /// Kinetic energy (J).
    #[must_use]
    pub(crate) fn kinetic_j(&self) -> f64 {
        let (along, across) = self.principal_inertia_kg_m2();
        let roll = self.spin.dot(self.axis());
        let rest = (self.spin.length_squared() - roll * roll).max(0.0);
        0.5 * (self.mass_kg * self.velocity.length_squared() + along * roll * roll + across * rest)
    }

    /// One semi-implicit Euler step of `h` seconds under a force (N) and a moment about the centre
    /// (N m): Euler's equations of a body with an axis of symmetry.
    pub(crate) fn step(&mut self, h: f64, axis: DVec3, force: DVec3, moment: DVec3) {
        let (along, across) = self.principal_inertia_kg_m2();
        // I w = across w + (along - across) (a.w) a, so w x (I w) = (along - across) (a.w) (w x a)
        let roll = self.spin.dot(axis);
        let torque = moment - (along - across) * roll * self.spin.cross(axis);
        let torque_along = torque.dot(axis);
        let change = torque / across + (1.0 / along - 1.0 / across) * torque_along * axis;
        *self = self.moved(self.velocity + h / self.mass_kg * force, self.spin + h * change, h);
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        hash.vector(self.position);
        hash.numbers(&self.orientation.to_array());
        hash.vector(self.velocity);
        hash.vector(self.spin);
        hash.number(self.roll_rad);
    }
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;

    fn pin() -> Pin {
        Pin::at_rest(
            DVec3::ZERO,
            &DMat3::IDENTITY,
            CylinderSize { radius_m: 0.023, length_m: 0.08 },
            0.2,
        )
    }

    #[test]
    fn a_free_pin_falls_with_gravity() {
        let mut pin = pin();
        let (h, n) = (1e-4, 10_000);
        for _ in 0..n {
            let axis = pin.axis();
            pin.step(h, axis, DVec3::new(0.0, 0.0, -9.81 * 0.2), DVec3::ZERO);
        }
        assert!((pin.velocity.z + 9.81).abs() < 1e-9);
        assert!((pin.position.z + 0.5 * 9.81).abs() < 1e-3);
        assert_eq!(pin.spin, DVec3::ZERO);
    }

    #[test]
    fn a_tumbling_pin_keeps_its_angular_momentum() {
        let mut pin = pin();
        pin.spin = DVec3::new(3.0, 10.0, -2.0);
        let momentum = |pin: &Pin| {
            let (along, across) = pin.principal_inertia_kg_m2();
            let a = pin.axis();
            across * pin.spin + (along - across) * a.dot(pin.spin) * a
        };
        let (before, energy) = (momentum(&pin), pin.kinetic_j());
        for _ in 0..10_000 {
            let axis = pin.axis();
            pin.step(1e-5, axis, DVec3::ZERO, DVec3::ZERO);
        }
        assert!((momentum(&pin) - before).length() < 2e-4 * before.length());
        assert!((pin.kinetic_j() / energy - 1.0).abs() < 2e-4);
    }

    #[test]
    fn the_default_pin_is_a_plastic_bar() {
        let pin = pin();
        let volume = PI * pin.radius_m * pin.radius_m * pin.length_m;
        let density = pin.mass_kg / volume;
        assert!((1000.0..2000.0).contains(&density), "{density}");
    }
}
