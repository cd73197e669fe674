//! The rubber of a fingertip as a foundation: the pressure at a place depends on the penetration at
//! that place alone, by a power law whose two numbers reproduce the load of the exact solution
//! (`taktil_contact`) for the object's shape at two penetrations.
//!
//! Source: K. L. Johnson, *Contact Mechanics*, Cambridge 1985, section 4.3, for the foundation. Its
//! modulus and exponent are fitted here, because a bonded layer of nearly incompressible rubber is
//! no foundation: its load grows faster with the penetration. The distribution of the pressure is
//! the foundation's, narrower or wider than the exact one; how far off stands in
//! `docs/measurements/hand.md`.

use core::f64::consts::PI;

use taktil_contact::Accuracy;
use taktil_contact::plane::{Friction, Indenter, Load, Shape};
use taktil_contact::space::Prescribed;
use taktil_contact::space::sphere::Sphere;

use super::object::Solid;
use crate::rubber::{Rubber, at_place, layer};
use crate::scene::{Invalid, RubberConfig, invalid};

/// Penetrations at which the exact load is reproduced, in thicknesses of the layer: a light touch
/// and a firm grip.
const FITTED_THICKNESSES: [f64; 2] = [0.05, 0.15];
/// Largest penetration at which a sphere is solved, in its radii.
const PENETRATION_MAX_RADII: f64 = 0.1;
/// Penetration beyond which small strain was left, in thicknesses.
const SMALL_STRAIN_THICKNESSES: f64 = 0.2;
/// Smallest penetration for which a slope is formed (m): with an exponent below one the slope of
/// the law grows without bound towards zero.
const SLOPE_PENETRATION_MIN_M: f64 = 1e-6;

/// Pressure over penetration, and the rubber's tangential and viscous constants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Foundation {
    /// Pressure at a penetration of one metre (Pa).
    scale_pa: f64,
    exponent: f64,
    /// Mean pressure of a parabola over its half-width, relative to the largest pressure.
    parabola_share: f64,
    /// Shear modulus (Pa), thickness (m) and Poisson's ratio.
    shear_pa: f64,
    thickness_m: f64,
    poisson: f64,
    /// Kelvin-Voigt relaxation time (s).
    pub(super) relaxation_s: f64,
}

/// Pressure and its derivative at one place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Pressure {
    pub(super) pa: f64,
    pub(super) slope_pa_m: f64,
}

/// The contact of a paraboloid of revolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ParaboloidContact {
    pub(super) load_n: f64,
    pub(super) stiffness_n_m: f64,
    /// Radius of the contact (m).
    pub(super) edge_m: f64,
    /// Root mean square distance of the load from its middle (m), and that of the stiffness.
    pub(super) load_radius_m: f64,
    pub(super) stiffness_radius_m: f64,
}

impl Foundation {
    /// The foundation that reproduces the load of a solid on this rubber.
    ///
    /// # Errors
    /// A rubber or a size that the solver does not allow.
    pub(super) fn new(rubber: &RubberConfig, solid: &Solid) -> Result<Foundation, Invalid> {
        const PLACE: &str = "finger.rubber";
        let bonded = layer(rubber).map_err(at_place(PLACE))?;
        let thickness_m = 1e-3 * bonded.thickness_mm;
        let shape = |scale_pa, exponent| Foundation {
            scale_pa,
            exponent,
            parabola_share: parabola_share(exponent),
            shear_pa: 1e6 * bonded.shear_mpa(),
            thickness_m,
            poisson: bonded.poisson,
            relaxation_s: 1e-3 * rubber.relaxation_ms,
        };
        let fitted = FITTED_THICKNESSES.map(|part| part * thickness_m);
        match *solid {
            Solid::Sphere { radius_m } => {
                let mut sphere = Sphere::new(&bonded, 1e3 * radius_m, Accuracy::Fast)
                    .map_err(at_place("hand.radius_mm"))?;
                let largest = (PENETRATION_MAX_RADII * radius_m / fitted[1]).min(1.0);
                let places = fitted.map(|delta_m| largest * delta_m);
                let mut loads = [0.0; 2];
                for (load, delta_m) in loads.iter_mut().zip(places) {
                    let state = sphere
                        .press(Prescribed::PenetrationMm(1e3 * delta_m))
                        .map_err(|refusal| at_place(PLACE)(refusal.to_invalid()))?;
                    *load = state.force_n;
                }
                // N = 2 pi R k delta^(m + 1) / (m + 1) for p = k d^m under a paraboloid.
                let power = power_of(&places, &loads);
                let scale = loads[1] * power / (2.0 * PI * radius_m * libm::pow(places[1], power));
                Ok(shape(scale, power - 1.0))
            }
            Solid::Cylinder { radius_m, .. } => {
                let table = Rubber::without_base_shares(rubber, 1e3 * radius_m, PLACE)?;
                let loads = fitted.map(|delta_m| table.at(delta_m).load_n_m);
                // q = k sqrt(2 R) delta^(m + 1/2) B(m) for p = k d^m under a parabola.
                let power = power_of(&fitted, &loads);
                let exponent = power - 0.5;
                let width = (2.0 * radius_m).sqrt()
                    * parabola_share(exponent)
                    * libm::pow(fitted[1], power);
                Ok(shape(loads[1] / width, exponent))
            }
            Solid::Cuboid { half_m } => {
                // A flat face has no length of its own: the load is proportional to the
                // penetration, and its mean over the shorter side gives the modulus.
                let width_mm = 2e3 * half_m.min_element();
                let face = Shape::Flat { width_mm, height_mm: 1.0 };
                let pressed = Indenter::new(&bonded, face, Friction::None, Accuracy::Default)
                    .map_err(at_place("hand.size_mm"))?
                    .press(&Load { p_n_mm: 1.0, q_n_mm: 0.0 })
                    .map_err(|refusal| {
                        let what = format!("gives no contact: {refusal}");
                        invalid("hand.size_mm", what, "give other sides")
                    })?;
                // N/mm over mm and mm is N/mm^3, a thousand million N/m^3.
                Ok(shape(1e9 / (width_mm * pressed.delta_mm), 1.0))
            }
        }
    }

    /// The pressure at a penetration (m).
    #[inline(always)]
    pub(super) fn pressure(&self, depth_m: f64) -> Pressure {
        if depth_m <= 0.0 {
            return Pressure::default();
        }
        if self.exponent == 1.0 {
            return Pressure { pa: self.scale_pa * depth_m, slope_pa_m: self.scale_pa };
        }
        let pa = self.scale_pa * libm::exp(self.exponent * libm::log(depth_m));
        Pressure { pa, slope_pa_m: self.exponent * pa / depth_m.max(SLOPE_PENETRATION_MIN_M) }
    }

    /// The contact of a paraboloid of revolution whose lowest point is so deep (m): the closed form
    /// of the foundation.
    pub(super) fn paraboloid(&self, radius_m: f64, depth_m: f64) -> ParaboloidContact {
        let m = self.exponent;
        let square = 2.0 * radius_m * depth_m;
        let pressure = self.pressure(depth_m).pa;
        ParaboloidContact {
            load_n: 2.0 * PI * radius_m * depth_m * pressure / (m + 1.0),
            stiffness_n_m: 2.0 * PI * radius_m * pressure,
            edge_m: square.sqrt(),
            load_radius_m: (square / (m + 2.0)).sqrt(),
            stiffness_radius_m: (square / (m + 1.0)).sqrt(),
        }
    }

    /// The contact of a parabola under a line, per metre of the line (N/m, N/m^2), with the mean
    /// distances across it.
    pub(super) fn parabola(&self, radius_m: f64, depth_m: f64) -> ParaboloidContact {
        let m = self.exponent;
        let square = 2.0 * radius_m * depth_m;
        let edge_m = square.sqrt();
        let load_n = self.pressure(depth_m).pa * edge_m * self.parabola_share;
        ParaboloidContact {
            load_n,
            stiffness_n_m: load_n * (m + 0.5) / depth_m,
            edge_m,
            load_radius_m: (square / (2.0 * m + 3.0)).sqrt(),
            stiffness_radius_m: (square / (2.0 * m + 1.0)).sqrt(),
        }
    }

    /// Stiffness against a tangential shift of a contact of this area that sticks (N/m): the thin
    /// layer's `G A / t`, and Mindlin's half space's `8 G a / (2 - nu)` for a disc of that area.
    pub(super) fn tangential_n_m(&self, area_m2: f64) -> f64 {
        let radius_m = (area_m2 / PI).sqrt();
        let half_space = 8.0 * radius_m / (2.0 - self.poisson);
        self.shear_pa * (area_m2 / self.thickness_m + half_space)
    }

    /// Whether a penetration (m) is beyond small strain.
    pub(super) fn is_beyond_small_strain(&self, depth_m: f64) -> bool {
        depth_m > SMALL_STRAIN_THICKNESSES * self.thickness_m
    }
}

/// The integral of `(1 - s^2)^m` from -1 to 1.
fn parabola_share(m: f64) -> f64 {
    PI.sqrt() * libm::tgamma(m + 1.0) / libm::tgamma(m + 1.5)
}

/// The power by which loads grow between two penetrations.
fn power_of(places: &[f64; 2], loads: &[f64; 2]) -> f64 {
    libm::log(loads[1] / loads[0]) / libm::log(places[1] / places[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::WorldConfig;
    use glam::DVec3;

    fn rubber() -> RubberConfig {
        WorldConfig::default().finger.rubber
    }

    /// Load of a paraboloid of revolution on the foundation, by Simpson's rule over its rings.
    fn sphere_load_n(law: &Foundation, radius_m: f64, delta_m: f64) -> f64 {
        let edge = (2.0 * radius_m * delta_m).sqrt();
        let n = 4000;
        let at = |i: usize| {
            let r = edge * i as f64 / n as f64;
            2.0 * PI * r * law.pressure(delta_m - r * r / (2.0 * radius_m)).pa
        };
        let sum: f64 = (1..n).map(|i| at(i) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
        (sum + at(0) + at(n)) * edge / (3.0 * n as f64)
    }

    #[test]
    fn a_sphere_has_the_exact_load_at_both_fitted_places_and_nearly_between() {
        let radius_m = 0.02;
        let law = Foundation::new(&rubber(), &Solid::Sphere { radius_m }).unwrap();
        let bonded = layer(&rubber()).unwrap();
        let mut sphere = Sphere::new(&bonded, 1e3 * radius_m, Accuracy::Fast).unwrap();
        for (part, most) in [(0.05, 1e-3), (0.15, 1e-3), (0.10, 0.03), (0.03, 0.15), (0.2, 0.05)] {
            let delta_m = part * 1e-3 * bonded.thickness_mm;
            let exact = sphere.press(Prescribed::PenetrationMm(1e3 * delta_m)).unwrap().force_n;
            let found = sphere_load_n(&law, radius_m, delta_m);
            let closed = law.paraboloid(radius_m, delta_m).load_n;
            assert!((found / closed - 1.0).abs() < 1e-5, "{found} {closed}");
            let off = found / exact - 1.0;
            println!("sphere, {part} thicknesses: {exact:.3} N, off {:.2} %", 100.0 * off);
            assert!(off.abs() < most, "{part}: {found} {exact}");
        }
    }

    #[test]
    fn a_cylinder_has_the_exact_line_load_at_both_fitted_places() {
        let radius_m = 0.023;
        let solid = Solid::Cylinder { radius_m, half_length_m: 0.03 };
        let law = Foundation::new(&rubber(), &solid).unwrap();
        let table = Rubber::without_base_shares(&rubber(), 23.0, "finger.rubber").unwrap();
        for part in FITTED_THICKNESSES {
            let delta_m = part * law.thickness_m;
            let edge = (2.0 * radius_m * delta_m).sqrt();
            let n = 20_000;
            let sum: f64 = (0..n)
                .map(|i| {
                    let x = edge * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
                    law.pressure(delta_m - x * x / (2.0 * radius_m)).pa
                })
                .sum();
            let (found, exact) = (sum * 2.0 * edge / n as f64, table.at(delta_m).load_n_m);
            let closed = law.parabola(radius_m, delta_m).load_n;
            assert!((found / closed - 1.0).abs() < 1e-4, "{part}: {found} {closed}");
            assert!((found / exact - 1.0).abs() < 1e-3, "{part}: {found} {exact}");
        }
    }

    #[test]
    fn slopes_are_derivatives_and_nothing_pulls() {
        for solid in [
            Solid::Sphere { radius_m: 0.02 },
            Solid::Cuboid { half_m: DVec3::new(0.02, 0.02, 0.03) },
        ] {
            let law = Foundation::new(&rubber(), &solid).unwrap();
            for depth in [1e-5, 5e-5, 2e-4] {
                let step = 1e-3 * depth;
                let rise = law.pressure(depth + step).pa - law.pressure(depth - step).pa;
                let slope = law.pressure(depth).slope_pa_m;
                assert!((rise / (2.0 * step) / slope - 1.0).abs() < 1e-5, "{depth}");
            }
            assert_eq!(law.pressure(-1.0), Pressure::default());
            assert_eq!(law.pressure(0.0), Pressure::default());
        }
    }

    #[test]
    fn a_sphere_that_the_solver_refuses_is_refused_here() {
        let none = Foundation::new(&rubber(), &Solid::Sphere { radius_m: f64::NAN });
        assert!(none.unwrap_err().place.starts_with("hand.radius_mm"));
    }
}
