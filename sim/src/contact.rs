//! The line contact between the pin and a flat rubber surface, computed in slices along the pin's
//! axis. Each slice has a normal load with Kelvin-Voigt damping that never pulls, and a brush of
//! bristles that resists tangential motion. Rolling, slip, yaw torque and tilting moments result
//! from these forces; no separate law states them. A pin that stands on end on a pad (axis within
//! 11.5 deg of the normal) has no contact with it, because no row crosses it. The table carries
//! such a pin on the lowest places of its rim.
//!
//! The brush is Kalker's simplified theory in its one-point form: bristles enter the contact
//! unstressed at its leading edge and are carried through its width `2b`, so their mean deflection
//! `xi` obeys `d xi/dt = v - (u / b) xi`, with `v` the velocity of the pin's surface over the
//! rubber and `u` the speed at which the contact line travels over it. Growing contact adds
//! unstressed bristles (the force stays, `xi` shrinks); a force that leaves Coulomb's cone is
//! returned to it.

mod slices;

use glam::DVec3;
use taktil_mechanics::spatial::linear_and_angular;
use taktil_mechanics::{Joints, Pose};

use crate::geometry::ArrayGeometry;
use crate::hash::Hash;
use crate::pin::Pin;
use crate::rubber::Rubber;
use slices::ContactLaw;
pub(crate) use slices::{BristleState, Slice, Slices, slip_compliance_m_n};

/// Distance over which the load fades out as the contact line leaves the pad (m).
const EDGE_FADE_M: f64 = 0.5e-3;
/// Smallest sine of the angle between axis and normal for which a pad has a contact line.
const AXIS_SINE_MIN: f64 = 0.2;
/// Sine of the angle between axis and normal below which a pin that stands on end on the table has
/// no lowest side.
const UPRIGHT_SINE: f64 = 1e-6;
/// Half-width of the narrowest contact through which bristles travel (m).
const HALF_WIDTH_MIN_M: f64 = 1e-9;
/// Spin at which rolling resistance reaches its full moment (rad/s).
const FULL_RESISTANCE_SPIN_RAD_S: f64 = 0.1;

/// A plane of rubber that moves as a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// A point of the undeformed surface (m, base frame).
    pub origin: DVec3,
    /// Unit normal out of the rubber.
    pub normal: DVec3,
    /// Velocity of the material at the origin (m/s).
    pub velocity: DVec3,
    /// Angular velocity (rad/s).
    pub spin: DVec3,
}

impl Surface {
    /// The face of a pad with this frame, whose origin moves with this twist.
    pub(crate) fn of_pad(pose: &Pose, twist: &Joints) -> Surface {
        let (velocity, spin) = linear_and_angular(twist);
        Surface { origin: pose.translation, normal: pose.rotation.z_axis, velocity, spin }
    }
}

/// A quantity that varies linearly along the pin's axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Linear {
    /// Value at s = 0, the pin's centre.
    pub(crate) at_centre: f64,
    /// Change per metre of s.
    pub(crate) per_m: f64,
}

impl Linear {
    const fn new(at_centre: f64, per_m: f64) -> Linear {
        Linear { at_centre, per_m }
    }

    /// Value at a place along the axis (m from the pin's centre).
    #[inline(always)]
    pub(crate) fn at(self, s_m: f64) -> f64 {
        self.at_centre + self.per_m * s_m
    }
}

/// The pin's generatrix nearest to a surface and everything that varies linearly along it; s is the
/// place along the pin's axis from its centre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ContactLine {
    /// The generatrix at s = 0 (m).
    pub(crate) foot: DVec3,
    /// From the pin's centre to the generatrix at s = 0 (m).
    pub(crate) radius: DVec3,
    pub(crate) axis: DVec3,
    pub(crate) normal: DVec3,
    /// Rolling direction in the surface.
    pub(crate) across: DVec3,
    /// Direction of the axis projected onto the surface.
    pub(crate) along: DVec3,
    /// Height of the generatrix over the surface (m).
    pub(crate) height: Linear,
    /// Speed of approach (m/s).
    closing: Linear,
    /// Velocity of the pin's surface over the rubber across and along the axis (m/s).
    creep_across: Linear,
    creep_along: Linear,
    /// Speed at which the contact line travels over the rubber (m/s).
    travel: Linear,
    /// Spin of the pin over the surface about `along` (rad/s).
    roll: f64,
}

impl ContactLine {
    /// The contact line on a pad; none for a pin that stands on end.
    pub(crate) fn on_pad(pin: &Pin, axis: DVec3, surface: &Surface) -> Option<ContactLine> {
        ContactLine::with_axis_sine(pin, axis, surface, AXIS_SINE_MIN)
    }

    /// The contact line on the table, which also bears a pin that has tipped over.
    pub(crate) fn on_table(pin: &Pin, axis: DVec3, surface: &Surface) -> Option<ContactLine> {
        ContactLine::with_axis_sine(pin, axis, surface, UPRIGHT_SINE)
    }

    fn with_axis_sine(
        pin: &Pin,
        axis: DVec3,
        surface: &Surface,
        sine_min: f64,
    ) -> Option<ContactLine> {
        let normal = surface.normal;
        let dip = axis.dot(normal);
        let sine2 = 1.0 - dip * dip;
        if sine2 < sine_min * sine_min && sine_min > UPRIGHT_SINE {
            return None;
        }
        let (along, radius) = if sine2 < UPRIGHT_SINE * UPRIGHT_SINE {
            // A pin on end has no lowest side: any direction in the surface serves.
            let along = normal.any_orthonormal_vector();
            (along, dip * pin.radius_m * along)
        } else {
            let inverse = 1.0 / sine2.sqrt();
            let along = (axis - dip * normal) * inverse;
            (along, (dip * axis - normal) * (inverse * pin.radius_m))
        };
        let across = along.cross(normal);
        let foot = pin.position + radius;
        let lever = foot - surface.origin;
        let rubber = surface.velocity + surface.spin.cross(lever);
        let relative = pin.velocity + pin.spin.cross(radius) - rubber;
        let slope = (pin.spin - surface.spin).cross(axis);
        // The contact line follows the axis of the pin and, when the surface turns, moves around
        // the pin.
        let walk = pin.velocity - rubber - pin.radius_m * surface.spin.cross(normal);
        Some(ContactLine {
            foot,
            radius,
            axis,
            normal,
            across,
            along,
            height: Linear::new(lever.dot(normal), dip),
            closing: Linear::new(-relative.dot(normal), -slope.dot(normal)),
            creep_across: Linear::new(relative.dot(across), slope.dot(across)),
            creep_along: Linear::new(relative.dot(along), slope.dot(along)),
            travel: Linear::new(walk.dot(across), slope.dot(across)),
            roll: (pin.spin - surface.spin).dot(along),
        })
    }
}

impl ContactLine {
    /// Whether no place of a pin of this length, and of a row of `pitch_y_m` beyond its end,
    /// reaches the surface.
    pub(crate) fn is_clear(&self, pin_length_m: f64, pitch_y_m: f64) -> bool {
        self.height.at_centre
            - self.height.per_m.abs() * (0.5 * pin_length_m + pitch_y_m / AXIS_SINE_MIN)
            > 0.0
    }
}

/// Force and moment of a contact on the pin; those on the surface are opposite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Reaction {
    /// Force on the pin (N).
    pub(crate) force: DVec3,
    /// Moment on the pin about its centre (N m).
    pub(crate) moment: DVec3,
    /// Sum of the normal forces (N).
    pub(crate) normal_n: f64,
    /// Tangential force on the pin across and along its axis (N).
    pub(crate) tangential_n: (f64, f64),
    /// Speed of the fastest slice that slides (m/s), 0 when all slices stick.
    pub(crate) slip_m_s: f64,
    /// Motion of the pin's surface over the rubber at the pin's middle, across and along (m/s).
    pub(crate) creep_m_s: (f64, f64),
    /// Speed at which the contact line travels over the rubber at the pin's middle (m/s).
    pub(crate) travel_m_s: f64,
}

impl Reaction {
    /// The moment about another point than the pin's centre (N m).
    pub(crate) fn moment_about(&self, point: DVec3, pin_centre: DVec3) -> DVec3 {
        self.moment + (pin_centre - point).cross(self.force)
    }
}

/// The contact of the pin with one rubber.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    pub(crate) rubber: Rubber,
    friction: f64,
    rolling_m: f64,
    /// Ratio of the rows' loads to their plane solutions.
    pub(crate) load_factor: LoadFactor,
    pub(crate) slices: Slices,
}

/// Ratio of a row's load to the load of its plane solution, linear along the pin's axis: how the
/// rows of a layer in three dimensions carry each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LoadFactor {
    /// Ratio at the middle of the axis.
    pub(crate) at_centre: f64,
    /// Change per metre along the axis (1/m).
    pub(crate) per_m: f64,
}

impl LoadFactor {
    /// The factor of rows that do not influence each other.
    pub(crate) const ONE: LoadFactor = LoadFactor { at_centre: 1.0, per_m: 0.0 };

    pub(crate) fn at(self, s_m: f64) -> f64 {
        (self.at_centre + self.per_m * s_m).max(0.0)
    }
}

/// Derivative of a reaction with respect to the motion at the end of a step. For each direction
/// (normal, across, along) the weights are the sums over the slices of w, w s and w s^2, where w is
/// the force per speed of approach (N s/m) and s the place along the axis (m). The rolling entry is
/// the moment per spin of rolling (N m s/rad).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tangent {
    pub(crate) weights: [[f64; 3]; 3],
    pub(crate) rolling: f64,
}

impl Patch {
    /// The contact with a pad, in slices at its rows.
    pub(crate) fn on_pad(
        rubber: Rubber,
        friction: f64,
        rolling_m: f64,
        array: &ArrayGeometry,
    ) -> Patch {
        let slices = Slices::on_pad(array);
        Patch { rubber, friction, rolling_m, load_factor: LoadFactor::ONE, slices }
    }

    /// The contact with a table, in slices over the whole length of a pin.
    pub(crate) fn on_table(
        rubber: Rubber,
        friction: f64,
        rolling_m: f64,
        pin_length_m: f64,
    ) -> Patch {
        let slices = Slices::along_pin(pin_length_m);
        Patch { rubber, friction, rolling_m, load_factor: LoadFactor::ONE, slices }
    }

    /// Ends the contact: the bristles spring back.
    pub(crate) fn release(&mut self) -> Reaction {
        self.slices.release();
        Reaction::default()
    }

    /// Ends the contact below a pin that moves past the surface; the reaction still reports creep
    /// and travel.
    pub(crate) fn release_above(&mut self, line: &ContactLine) -> Reaction {
        Reaction {
            creep_m_s: (line.creep_across.at_centre, line.creep_along.at_centre),
            travel_m_s: line.travel.at_centre,
            ..self.release()
        }
    }

    /// Moves the bristles by `h` seconds from the state `from`, with `line` the contact line at the
    /// end of the step. Returns the reaction and its derivative. With `h` = 0 only the forces are
    /// evaluated.
    pub(crate) fn evaluate(
        &mut self,
        line: &ContactLine,
        from: &BristleState,
        h: f64,
    ) -> (Reaction, Tangent) {
        let law = ContactLaw {
            rubber: &self.rubber,
            load_factor: self.load_factor,
            friction: self.friction,
            h,
        };
        let sums = self.slices.evaluate(from, line, &law);
        let mut tangent = Tangent { weights: sums.weights, rolling: 0.0 };
        let [normal, across, along] = sums.force.map(|[force, _]| force);
        let turning = (line.roll / FULL_RESISTANCE_SPIN_RAD_S).clamp(-1.0, 1.0);
        let most = self.rolling_m * normal;
        if turning.abs() < 1.0 {
            tangent.rolling = most / FULL_RESISTANCE_SPIN_RAD_S;
        }
        let frame = |power: usize| {
            let [n, x, y] = sums.force.map(|moments| moments[power]);
            n * line.normal + x * line.across + y * line.along
        };
        let force = frame(0);
        let moment = line.radius.cross(force) + line.axis.cross(frame(1));
        let reaction = Reaction {
            force,
            moment: moment - most * turning * line.along,
            normal_n: normal,
            tangential_n: (across, along),
            slip_m_s: sums.slip_m_s,
            creep_m_s: (line.creep_across.at_centre, line.creep_along.at_centre),
            travel_m_s: line.travel.at_centre,
        };
        (reaction, tangent)
    }

    /// Energy stored in the rubber and its bristles (J).
    pub(crate) fn stored_energy_j(&self) -> f64 {
        let slice_j = |slice: Slice| {
            let length_m = slice.length_m * self.load_factor.at(slice.s_m);
            let (x, y) = (slice.across_m, slice.along_m);
            self.rubber.stored_j_m(slice.delta_m) * length_m
                + 0.5 * slice.shear_n_m * (x * x + y * y)
        };
        self.slices.iter().map(slice_j).sum()
    }

    pub(crate) fn digest(&self, hash: &mut Hash) {
        self.slices.bristles.digest(hash);
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::pin::CylinderSize;
    use crate::scene::{FingerConfig, RubberConfig};

    #[test]
    fn a_damped_contact_that_begins_to_slide_stores_no_more_than_the_work_done_on_it() {
        for relaxation_ms in [0.0, 0.3, 100.0] {
            let config = RubberConfig { relaxation_ms, ..FingerConfig::default().rubber };
            let rubber = Rubber::without_base_shares(&config, 23.0, "table.rubber").unwrap();
            let mut patch = Patch::on_table(rubber, 0.3, 0.0, 0.08);
            let place = DVec3::new(0.0, 0.0, 0.023 - 1e-4);
            let size = CylinderSize { radius_m: 0.023, length_m: 0.08 };
            let mut pin = Pin::at_rest(place, &DMat3::IDENTITY, size, 0.2);
            pin.velocity = DVec3::new(0.0, 0.5, 0.0);
            let (origin, none) = (DVec3::ZERO, DVec3::ZERO);
            let table = Surface { origin, normal: DVec3::Z, velocity: none, spin: none };
            let line = ContactLine::on_table(&pin, pin.axis(), &table).unwrap();
            let bristles_j = |patch: &Patch| {
                let one = |slice: Slice| {
                    let (x, y) = (slice.across_m, slice.along_m);
                    0.5 * slice.shear_n_m * (x * x + y * y)
                };
                patch.slices.iter().map(one).sum::<f64>()
            };
            let (h, mut done_j, mut slid) = (1e-5, 0.0, false);
            for _ in 0..100 {
                let from = patch.slices.bristles.clone();
                let (reaction, _) = patch.evaluate(&line, &from, h);
                done_j -= h * reaction.force.dot(pin.velocity);
                let held_j = bristles_j(&patch);
                slid |= reaction.slip_m_s > 0.0;
                assert!(held_j <= done_j, "{relaxation_ms} ms: {held_j:e} J of {done_j:e} J");
            }
            assert!(slid && bristles_j(&patch) > 0.0);
        }
    }
}
