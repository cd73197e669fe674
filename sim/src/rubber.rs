//! The response of one rubber layer under the pin, tabulated over the penetration in SI units: line
//! load, normal and tangential stiffness and contact width from one look-up. `taktil_contact`
//! solves the contact; this module samples the solution. A layer that the solver does not allow is
//! an error.

use taktil_contact::cylinder::{BaseShares, LineContact};
use taktil_contact::field::{LineLoad, line};
use taktil_contact::layer::Layer;
use taktil_contact::solved::line_contact;

use crate::scene::{Invalid, RubberConfig, invalid};

/// Penetration up to which the contact is solved, in thicknesses of the layer: the range of small
/// strain.
const PENETRATION_MAX_THICKNESSES: f64 = 0.2;
/// Number of cells of the table; the table stays small enough for the processor's first cache.
const CELL_COUNT: usize = 512;

/// Response of the rubber to a penetration, per metre of contact line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct LineResponse {
    /// Line load (N/m).
    pub(crate) load_n_m: f64,
    /// Derivative of the line load with respect to the penetration (N/m^2).
    pub(crate) stiffness_n_m2: f64,
    /// Stiffness against a tangential shift of a contact that sticks (N/m^2).
    pub(crate) shear_n_m2: f64,
    /// Half the contact's width (m).
    pub(crate) half_width_m: f64,
}

/// Distance from a tangential line load up to which its pressure at the base is tabulated, in
/// thicknesses of the layer, and the number of cells.
const INFLUENCE_REACH_THICKNESSES: f64 = 16.0;
const INFLUENCE_POINT_COUNT: usize = 512;
/// Number of point loads that represent a traction over the contact's width.
const TRACTION_POINT_COUNT: usize = 8;

/// Pressure at the base under a tangential line load of 1 N/m along +x, integrated from the left up
/// to each place; it is even in the place. A tangential load presses in front of itself and lifts
/// behind.
#[derive(Clone, Debug)]
pub(crate) struct TangentialInfluence {
    left_of: Vec<f64>,
    per_m: f64,
    /// Places of the point loads, as cosines, and their weights for a traction in proportion to
    /// sqrt(1 - (u/b)^2).
    points: [(f64, f64); TRACTION_POINT_COUNT],
}

impl TangentialInfluence {
    fn new(layer: &Layer) -> Result<TangentialInfluence, taktil_contact::Invalid> {
        let step_mm =
            INFLUENCE_REACH_THICKNESSES * layer.thickness_mm / INFLUENCE_POINT_COUNT as f64;
        let places: Vec<f64> = (0..=INFLUENCE_POINT_COUNT).map(|i| step_mm * i as f64).collect();
        let load = LineLoad { p_n_mm: 0.0, q_n_mm: 1.0 };
        let stresses = line(layer, &load, layer.thickness_mm, &places)?;
        let pressed = |i: usize| -stresses[i].szz_mpa.unwrap_or(0.0);
        // The integral starts far away and sums trapezia.
        let mut left_of = vec![0.0; INFLUENCE_POINT_COUNT + 1];
        for i in (0..INFLUENCE_POINT_COUNT).rev() {
            let cell = 0.5 * step_mm * (pressed(i) + pressed(i + 1));
            left_of[i] = left_of[i + 1] - cell;
        }
        let (n, mut points) = (TRACTION_POINT_COUNT as f64, [(0.0, 0.0); TRACTION_POINT_COUNT]);
        for (i, point) in points.iter_mut().enumerate() {
            // These are places and weights of the Gauss-Chebyshev rule of the second kind.
            let angle = core::f64::consts::PI * (i as f64 + 1.0) / (n + 1.0);
            let sine = libm::sin(angle);
            *point = (libm::cos(angle), 2.0 / (n + 1.0) * sine * sine);
        }
        Ok(TangentialInfluence { left_of, per_m: 1e3 / step_mm, points })
    }

    /// Part of a tangential load that presses left of `u_m` from the middle of its contact.
    pub(crate) fn left_of(&self, half_width_m: f64, u_m: f64) -> f64 {
        let at = |u: f64| {
            let place = u.abs() * self.per_m;
            let cell = place as usize;
            if cell >= INFLUENCE_POINT_COUNT {
                return 0.0;
            }
            let (a, b) = (self.left_of[cell], self.left_of[cell + 1]);
            a + (place - cell as f64) * (b - a)
        };
        self.points.iter().map(|(cosine, weight)| weight * at(u_m - half_width_m * cosine)).sum()
    }
}

/// The layer that a configuration describes.
pub(crate) fn layer(config: &RubberConfig) -> Result<Layer, taktil_contact::Invalid> {
    Layer::new(config.thickness_mm, config.youngs_mpa, config.poisson)
}

/// Moves the place of a solver's error to the place of its rubber in the scene.
pub(crate) fn at_place(place: &str) -> impl Fn(taktil_contact::Invalid) -> Invalid {
    move |e| Invalid::new(e.place, e.what, e.remedy).within(place)
}

/// How many numbers a response has.
const RESPONSE_VALUES: usize = 4;

impl LineResponse {
    fn values(&self) -> [f64; RESPONSE_VALUES] {
        [self.load_n_m, self.stiffness_n_m2, self.shear_n_m2, self.half_width_m]
    }
}

impl From<[f64; RESPONSE_VALUES]> for LineResponse {
    #[inline(always)]
    fn from(
        [load_n_m, stiffness_n_m2, shear_n_m2, half_width_m]: [f64; RESPONSE_VALUES],
    ) -> LineResponse {
        LineResponse { load_n_m, stiffness_n_m2, shear_n_m2, half_width_m }
    }
}

/// One cell of the table, between two knots.
#[derive(Clone, Copy, Debug)]
struct Cell {
    from: [f64; RESPONSE_VALUES],
    /// Increase of each value over the cell.
    rise: [f64; RESPONSE_VALUES],
    /// Difference of Hermite's cubic through loads and stiffnesses to the straight line, as a
    /// coefficient at either end (N/m).
    bend: [f64; 2],
}

impl Cell {
    fn between(a: &LineResponse, b: &LineResponse, cell_m: f64) -> Cell {
        let (from, to) = (a.values(), b.values());
        let rise: [f64; RESPONSE_VALUES] = core::array::from_fn(|part| to[part] - from[part]);
        let bend = [a, b].map(|knot| cell_m * knot.stiffness_n_m2 - rise[0]);
        Cell { from, rise, bend }
    }
}

/// The table, and the solved contact for quantities that are needed rarely.
#[derive(Clone, Debug)]
pub(crate) struct Rubber {
    cells: Vec<Cell>,
    /// The response at the deepest solved point.
    end: LineResponse,
    /// Work up to each knot, per metre of line (J/m).
    stored_j_m: Vec<f64>,
    per_metre: f64,
    cell_m: f64,
    deepest_m: f64,
    contact: LineContact,
    tangential_influence: Option<TangentialInfluence>,
    /// Damping over stiffness (s).
    pub(crate) relaxation_s: f64,
}

impl Rubber {
    /// Solves the contact of a cylinder on the layer, which allocates and takes long.
    pub(crate) fn new(
        config: &RubberConfig,
        radius_mm: f64,
        place: &str,
    ) -> Result<Rubber, Invalid> {
        Rubber::with_base(config, radius_mm, place, true)
    }

    /// Does the same for a layer without tactels under its base.
    pub(crate) fn without_base_shares(
        config: &RubberConfig,
        radius_mm: f64,
        place: &str,
    ) -> Result<Rubber, Invalid> {
        Rubber::with_base(config, radius_mm, place, false)
    }

    fn with_base(
        config: &RubberConfig,
        radius_mm: f64,
        place: &str,
        has_base: bool,
    ) -> Result<Rubber, Invalid> {
        let at_place = at_place(place);
        let layer = layer(config).map_err(&at_place)?;
        let deepest_mm = (PENETRATION_MAX_THICKNESSES * config.thickness_mm).min(0.2 * radius_mm);
        let contact = line_contact(&layer, radius_mm, deepest_mm, has_base).map_err(&at_place)?;
        let knots: Vec<LineResponse> = (0..=CELL_COUNT)
            .map(|i| {
                let delta_mm = deepest_mm * (i as f64 / CELL_COUNT as f64);
                LineResponse {
                    load_n_m: 1e3 * contact.load_n_mm(delta_mm),
                    stiffness_n_m2: 1e6 * contact.stiffness_n_mm2(delta_mm),
                    shear_n_m2: 1e6 * contact.tangential_stiffness_n_mm2(delta_mm),
                    half_width_m: 1e-3 * contact.half_width_mm(delta_mm),
                }
            })
            .collect();
        let sound = |k: &LineResponse| {
            [k.load_n_m, k.stiffness_n_m2, k.shear_n_m2, k.half_width_m]
                .iter()
                .all(|x| x.is_finite() && *x >= 0.0)
        };
        if !knots.iter().all(sound) {
            let what = "gives a contact that is not finite".to_owned();
            return Err(invalid(place, what, "take a rubber nearer to the defaults"));
        }
        let cell_m = 1e-3 * deepest_mm / CELL_COUNT as f64;
        let mut stored_j_m = vec![0.0; CELL_COUNT + 1];
        for (i, pair) in knots.windows(2).enumerate() {
            let mean = 0.5 * (pair[0].load_n_m + pair[1].load_n_m);
            let bend = cell_m / 12.0 * (pair[0].stiffness_n_m2 - pair[1].stiffness_n_m2);
            stored_j_m[i + 1] = stored_j_m[i] + cell_m * (mean + bend);
        }
        let cells =
            knots.windows(2).map(|pair| Cell::between(&pair[0], &pair[1], cell_m)).collect();
        Ok(Rubber {
            cells,
            end: knots[CELL_COUNT],
            stored_j_m,
            per_metre: CELL_COUNT as f64 / (1e-3 * deepest_mm),
            cell_m,
            deepest_m: 1e-3 * deepest_mm,
            contact,
            tangential_influence: None,
            relaxation_s: 1e-3 * config.relaxation_ms,
        })
    }

    /// Adds the table of the tangential influence at the base.
    pub(crate) fn with_tangential_influence(
        mut self,
        config: &RubberConfig,
        place: &str,
    ) -> Result<Rubber, Invalid> {
        let at_place = at_place(place);
        let layer = layer(config).map_err(&at_place)?;
        self.tangential_influence = Some(TangentialInfluence::new(&layer).map_err(&at_place)?);
        Ok(self)
    }

    /// The tangential influence at the base, if it was asked for.
    pub(crate) fn tangential_influence(&self) -> Option<&TangentialInfluence> {
        self.tangential_influence.as_ref()
    }

    /// The response at a penetration (m). It is zero at or above the surface, and goes on as a
    /// straight line from the deepest solved point.
    #[inline]
    pub(crate) fn at(&self, delta_m: f64) -> LineResponse {
        if delta_m <= 0.0 || delta_m.is_nan() {
            return LineResponse::default();
        }
        if delta_m >= self.deepest_m {
            let end = self.end;
            let load_n_m = end.load_n_m + end.stiffness_n_m2 * (delta_m - self.deepest_m);
            return LineResponse { load_n_m, ..end };
        }
        let place = delta_m * self.per_metre;
        let cell = (place as u32 as usize).min(CELL_COUNT - 1);
        let f = place - cell as f64;
        let Cell { from, rise, bend } = &self.cells[cell];
        // The load follows Hermite's cubic, the other values straight lines.
        let mut values: [f64; RESPONSE_VALUES] =
            core::array::from_fn(|part| from[part] + f * rise[part]);
        let g = 1.0 - f;
        values[0] += f * g * (g * bend[0] - f * bend[1]);
        values.into()
    }

    /// Work to press in by `delta_m`, per metre of line (J/m): the integral of the load.
    pub(crate) fn stored_j_m(&self, delta_m: f64) -> f64 {
        if delta_m <= 0.0 || delta_m.is_nan() {
            return 0.0;
        }
        let cell = ((delta_m * self.per_metre) as usize).min(CELL_COUNT);
        let from_m = self.cell_m * cell as f64;
        let load = |x: f64| self.at(x).load_n_m;
        // Simpson's rule is exact for the cubic of one cell.
        let middle = load(0.5 * (from_m + delta_m));
        let sum = load(from_m) + 4.0 * middle + load(delta_m);
        self.stored_j_m[cell] + (delta_m - from_m) / 6.0 * sum
    }

    /// Penetration at which the layer carries a line load (N/m), by bisection; only for building a
    /// scene.
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

    /// Distribution of a line load at the layer's base, as the part of it left of places (mm) from
    /// the line.
    pub(crate) fn base_shares(&self, delta_m: f64) -> BaseShares<'_> {
        self.contact.base_shares(1e3 * delta_m.min(self.deepest_m))
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
    fn loads_never_pull_and_never_jump() {
        let rubber = rubber();
        for bad in [0.0, -1e-6, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(rubber.at(bad), LineResponse::default());
        }
        let end = rubber.deepest_m();
        let step = rubber.at(end * 1.000_001).load_n_m - rubber.at(end * 0.999_999).load_n_m;
        assert!(step > 0.0 && step < 1e-4 * rubber.at(end).load_n_m);
        assert!(rubber.at(10.0 * end).load_n_m > rubber.at(end).load_n_m);
    }

    #[test]
    fn a_tangential_load_moves_the_load_at_the_base_by_the_thickness() {
        let config = FingerConfig::default().rubber;
        let rubber = rubber().with_tangential_influence(&config, "finger.rubber").unwrap();
        let tangential_influence = rubber.tangential_influence().unwrap();
        let (n, step_m) = (4000, 1e-5);
        let (mut sum, mut moment) = (0.0, 0.0);
        for i in -n..n {
            let (from, to) = (step_m * f64::from(i), step_m * f64::from(i + 1));
            let part =
                tangential_influence.left_of(1e-3, to) - tangential_influence.left_of(1e-3, from);
            sum += part;
            moment += 0.5 * (from + to) * part;
        }
        // Exact: M0 does not feel a tangential load, M1 gains its moment about the base.
        assert!(sum.abs() < 1e-9 && (moment / 0.8e-3 - 1.0).abs() < 1e-3, "{sum} {moment}");
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
