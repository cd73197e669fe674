//! The fixture that holds the pin to its place on the table until the finger presses on it, as a
//! steadying hand does. It is a spring and a damper against sliding in the table's plane, against
//! turning about the normal and against rolling; it exerts no force along the normal. It follows a
//! moving table. Once it has released the pin it does not hold it again.

use glam::{DMat3, DQuat, DVec3};

use crate::contact::Surface;
use crate::pin::Pin;

/// Natural frequency of the pin in the fixture (rad/s); it is critically damped.
const FIXTURE_FREQUENCY_RAD_S: f64 = 100.0;

/// The place and orientation in which the pin was put down, relative to the table.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PinFixture {
    place: DVec3,
    orientation: DQuat,
    release_force_n: f64,
    pub(crate) holding: bool,
}

impl PinFixture {
    pub(crate) fn new(
        pin: &Pin,
        axes: &DMat3,
        surface: &Surface,
        release_force_n: f64,
    ) -> PinFixture {
        let back = DQuat::from_mat3(axes).normalize().conjugate();
        PinFixture {
            place: back * (pin.position - surface.origin),
            orientation: back * pin.orientation,
            release_force_n,
            holding: true,
        }
    }

    /// Releases the pin when the finger presses hard enough.
    pub(crate) fn update(&mut self, finger_n: f64) {
        self.holding &= finger_n < self.release_force_n;
    }

    /// Derivatives of force and moment with respect to the speeds at the end of a step of `h`
    /// seconds (N s/m, N m s/rad).
    pub(crate) fn tangent(&self, pin: &Pin, h: f64) -> (f64, f64) {
        let weight = pin.mass_kg * FIXTURE_FREQUENCY_RAD_S * (FIXTURE_FREQUENCY_RAD_S * h + 2.0);
        (weight, pin.radius_m * pin.radius_m * weight)
    }

    /// Force on the pin and moment about its centre (N, N m).
    pub(crate) fn force_and_moment(
        &self,
        pin: &Pin,
        axes: &DMat3,
        surface: &Surface,
    ) -> (DVec3, DVec3) {
        let stiffness = pin.mass_kg * FIXTURE_FREQUENCY_RAD_S * FIXTURE_FREQUENCY_RAD_S;
        let damping = 2.0 * pin.mass_kg * FIXTURE_FREQUENCY_RAD_S;
        let place = surface.origin + *axes * self.place;
        let carried = surface.velocity + surface.spin.cross(place - surface.origin);
        let pull = -stiffness * (pin.position - place) - damping * (pin.velocity - carried);
        let force = pull - pull.dot(surface.normal) * surface.normal;

        let due = DQuat::from_mat3(axes).normalize() * self.orientation;
        let off = pin.orientation * due.conjugate();
        let sign = if off.w < 0.0 { -2.0 } else { 2.0 };
        let turned = sign * DVec3::new(off.x, off.y, off.z);
        let lever2 = pin.radius_m * pin.radius_m;
        let twist = -lever2 * (stiffness * turned + damping * (pin.spin - surface.spin));
        // The moment about the direction across the pin is left to the rubber.
        let across = pin.axis().cross(surface.normal);
        (force, twist - twist.dot(across) / across.length_squared() * across)
    }
}
