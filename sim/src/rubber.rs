//! One rubber layer under the pin, tabulated over the penetration in SI units: line load, normal
//! and tangential stiffness, contact width, all from one look-up. The contact itself is solved by
//! `taktil_mechanics::contact`; this module only re-samples it. Refuses layers that it refuses.

use taktil_mechanics::contact::cylinder::LineContact;
use taktil_mechanics::contact::layer::Layer;

use crate::scene::{Invalid, RubberConfig, invalid};

/// Penetration up to which the contact is solved, in thicknesses: the range of small strain.
const PENETRATION_MAX: f64 = 0.2;
/// Cells of the table; it stays small enough for the processor's fastest memory.
const CELLS: usize = 512;

/// What a slice of rubber does at a penetration, per metre of contact line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Response {
    /// Line load (N/m).
    pub(crate) load_n_m: f64,
    /// Its derivative (N/m^2).
    pub(crate) stiffness_n_m2: f64,
    /// Stiffness against a tangential shift of a contact that sticks (N/m^2).
    pub(crate) shear_n_m2: f64,
    /// Half the contact's width (m).
    pub(crate) half_width_m: f64,
}

/// The table, and the solved contact for what is asked rarely.
#[derive(Clone, Debug)]
pub(crate) struct Rubber {
    knots: Vec<Response>,
    per_metre: f64,
    cell_m: f64,
    deepest_m: f64,
    contact: LineContact,
    /// Damping over stiffness (s).
    pub(crate) relaxation_s: f64,
}

impl Rubber {
    /// Solves the contact of a cylinder on the layer; allocates and takes its time.
    pub(crate) fn new(
        config: &RubberConfig,
        radius_mm: f64,
        place: &str,
    ) -> Result<Rubber, Invalid> {
        let located = |e: taktil_mechanics::contact::Invalid| Invalid {
            place: format!("{place}.{}", e.place),
            what: e.what,
            remedy: e.remedy,
        };
        let layer = Layer::new(config.thickness_mm, config.youngs_mpa, config.poisson);
        let layer = layer.map_err(located)?;
        let deepest_mm = (PENETRATION_MAX * config.thickness_mm).min(0.2 * radius_mm);
        let contact = LineContact::new(&layer, radius_mm, deepest_mm).map_err(located)?;
        let knots: Vec<Response> = (0..=CELLS)
            .map(|i| {
                let delta_mm = deepest_mm * (i as f64 / CELLS as f64);
                Response {
                    load_n_m: 1e3 * contact.load_n_mm(delta_mm),
                    stiffness_n_m2: 1e6 * contact.stiffness_n_mm2(delta_mm),
                    shear_n_m2: 1e6 * contact.tangential_stiffness_n_mm2(delta_mm),
                    half_width_m: 1e-3 * contact.half_width_mm(delta_mm),
                }
            })
            .collect();
        let sound = |k: &Response| {
            [k.load_n_m, k.stiffness_n_m2, k.shear_n_m2, k.half_width_m]
                .iter()
                .all(|x| x.is_finite() && *x >= 0.0)
        };
        if !knots.iter().all(sound) {
            let what = "gives a contact that is not finite".to_owned();
            return Err(invalid(place, what, "take a rubber nearer to the defaults"));
        }
        Ok(Rubber {
            knots,
            per_metre: CELLS as f64 / (1e-3 * deepest_mm),
            cell_m: 1e-3 * deepest_mm / CELLS as f64,
            deepest_m: 1e-3 * deepest_mm,
            contact,
            relaxation_s: 1e-3 * config.relaxation_ms,
        })
    }

    /// The response at a penetration (m): nothing at or above the surface, a straight line on from
    /// the deepest solved point.
    #[inline]
    pub(crate) fn at(&self, delta_m: f64) -> Response {
        if delta_m <= 0.0 || delta_m.is_nan() {
            return Response::default();
        }
        if delta_m >= self.deepest_m {
            let end = self.knots[CELLS];
            let load_n_m = end.load_n_m + end.stiffness_n_m2 * (delta_m - self.deepest_m);
            return Response { load_n_m, ..end };
        }
        let place = delta_m * self.per_metre;
        let cell = (place as usize).min(CELLS - 1);
        let f = place - cell as f64;
        let (a, b) = (&self.knots[cell], &self.knots[cell + 1]);
        let mix = |x: f64, y: f64| x + f * (y - x);
        // The load by Hermite's cubic through loads and stiffnesses, the rest by straight lines.
        let (rise, g) = (b.load_n_m - a.load_n_m, 1.0 - f);
        let (from, to) = (self.cell_m * a.stiffness_n_m2, self.cell_m * b.stiffness_n_m2);
        let bend = f * g * (g * (from - rise) - f * (to - rise));
        Response {
            load_n_m: a.load_n_m + f * rise + bend,
            stiffness_n_m2: mix(a.stiffness_n_m2, b.stiffness_n_m2),
            shear_n_m2: mix(a.shear_n_m2, b.shear_n_m2),
            half_width_m: mix(a.half_width_m, b.half_width_m),
        }
    }

    /// Penetration at which the table carries a line load (N/m); bisection, for load time only.
    pub(crate) fn penetration_m(&self, load_n_m: f64) -> f64 {
        let (mut low, mut high) = (0.0, self.deepest_m);
        while self.at(high).load_n_m < load_n_m && high < 1.0 {
            high *= 2.0;
        }
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if self.at(middle).load_n_m < load_n_m { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Part of a line load that the layer's base carries left of `u_m` from the contact line.
    pub(crate) fn base_share(&self, delta_m: f64, u_m: f64) -> f64 {
        self.contact.base_share(1e3 * delta_m.min(self.deepest_m), 1e3 * u_m)
    }

    /// Deepest penetration that the theory covers (m).
    pub(crate) fn deepest_m(&self) -> f64 {
        self.deepest_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FingerConfig;

    fn rubber() -> Rubber {
        Rubber::new(&FingerConfig::default().rubber, 23.0, "finger.rubber").unwrap()
    }

    #[test]
    fn the_table_follows_the_solved_contact() {
        let rubber = rubber();
        for i in 1..300 {
            let delta_m = rubber.deepest_m() * f64::from(i) / 300.0;
            let exact = 1e3 * rubber.contact.load_n_mm(1e3 * delta_m);
            let got = rubber.at(delta_m).load_n_m;
            // The first touch is not smooth: its load goes as delta over a logarithm.
            let fair = if i < 5 { 5e-3 } else { 2e-4 };
            assert!((got - exact).abs() < fair * exact, "{delta_m}: {got} {exact}");
        }
    }

    #[test]
    fn nothing_pulls_and_nothing_jumps() {
        let rubber = rubber();
        for bad in [0.0, -1e-6, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(rubber.at(bad), Response::default());
        }
        let end = rubber.deepest_m();
        let step = rubber.at(end * 1.000_001).load_n_m - rubber.at(end * 0.999_999).load_n_m;
        assert!(step > 0.0 && step < 1e-4 * rubber.at(end).load_n_m);
        assert!(rubber.at(10.0 * end).load_n_m > rubber.at(end).load_n_m);
    }

    #[test]
    fn penetration_inverts_the_load() {
        let rubber = rubber();
        for load in [1e-3, 1.0, 500.0, 1e5] {
            let back = rubber.at(rubber.penetration_m(load)).load_n_m;
            assert!((back - load).abs() < 1e-9 * load, "{load} {back}");
        }
    }
}
