//! A sphere on the pad. Load, stiffness and contact radius are tabulated over the penetration from
//! the exact solution; the image is solved anew for each scan, warm from the last one. Beyond the
//! table the load goes on as a straight line. A sphere or rubber that the solver does not allow is
//! an error.
//!
//! The tangential stiffness is the sum of the half space's 8 G a / (2 - nu) (Mindlin, J. Appl.
//! Mech. 16, 1949) and of the thin layer's G pi a^2 / t, which is right for thick and for thin
//! layers.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};
use taktil_contact::Accuracy;
use taktil_contact::layer::Layer;
use taktil_contact::space::Prescribed;
use taktil_contact::space::sphere::Sphere;
use taktil_contact::space::tactels::Sampling;

use super::pad::pad_layer;
use super::{ContactLoad, RelativeMotion};
use crate::rubber;
use crate::scene::{Invalid, ObjectConfig};
use crate::spatial::PadSection;
use crate::square_cells::SquareCells;

/// Deepest penetration of the table, in thicknesses of the layer.
const PENETRATION_MAX_THICKNESSES: f64 = 0.4;
/// Deepest penetration of the table, in radii of the sphere.
const PENETRATION_MAX_RADII: f64 = 0.2;
/// Number of cells of the table; its knots stand at the squares of equal steps.
const CELL_COUNT: usize = 96;
/// Relative change of the penetration by which the stiffness is measured.
const RELATIVE_DIFFERENCE: f64 = 1e-3;
/// Smallest half-width over which a contact's load fades out as it leaves the pad (m).
const FADE_HALF_WIDTH_MIN_M: f64 = 0.25e-3;

/// The contact at one penetration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Knot {
    load_n: f64,
    stiffness_n_m: f64,
    radius_m: f64,
}

/// The sphere with its table and its solver.
#[derive(Clone, Debug)]
pub(super) struct SphereContact {
    /// Half the pad's sides (m).
    pad_half_m: DVec2,
    radius_m: f64,
    deepest_m: f64,
    knots: Vec<Knot>,
    shear_mpa: f64,
    poisson: f64,
    thickness_m: f64,
    solver: Sphere,
    /// Place on the pad (mm), penetration (mm) and share of damping of the latest evaluation.
    sections: Option<([f64; 2], f64, f64)>,
}

impl SphereContact {
    pub(super) fn new(
        config: &ObjectConfig,
        pad: &PadSection<'_>,
        place: &str,
    ) -> Result<SphereContact, Invalid> {
        let at_place = rubber::at_place(place);
        let layer = pad_layer(pad.rubber)?;
        let radius_mm = config.radius();
        let mut solver = Sphere::new(&layer, radius_mm, Accuracy::Fast).map_err(&at_place)?;
        let deepest_mm = (PENETRATION_MAX_THICKNESSES * layer.thickness_mm)
            .min(PENETRATION_MAX_RADII * radius_mm);
        let mut knots = vec![Knot::default(); CELL_COUNT + 1];
        for (i, knot) in knots.iter_mut().enumerate().skip(1).rev() {
            let part = i as f64 / CELL_COUNT as f64;
            let delta_mm = deepest_mm * part * part;
            let mut load = |part: f64| {
                let state = solver.press(Prescribed::PenetrationMm(part * delta_mm));
                let state = state.map_err(|refusal| at_place(refusal.to_invalid()))?;
                Ok::<_, Invalid>((state.force_n, state.contact_radius_mm))
            };
            let (above, below) =
                (load(1.0 + RELATIVE_DIFFERENCE)?.0, load(1.0 - RELATIVE_DIFFERENCE)?.0);
            let (load_n, radius_mm) = load(1.0)?;
            let stiffness_n_m = 1e3 * (above - below) / (2.0 * RELATIVE_DIFFERENCE * delta_mm);
            *knot = Knot { load_n, stiffness_n_m, radius_m: 1e-3 * radius_mm };
        }
        solver.release();
        let pad_half_m = pad.array.half_sides_m();
        Ok(SphereContact::tabulated(&layer, radius_mm, deepest_mm, knots, solver, pad_half_m))
    }

    fn tabulated(
        layer: &Layer,
        radius_mm: f64,
        deepest_mm: f64,
        knots: Vec<Knot>,
        solver: Sphere,
        pad_half_m: DVec2,
    ) -> SphereContact {
        SphereContact {
            pad_half_m,
            radius_m: 1e-3 * radius_mm,
            deepest_m: 1e-3 * deepest_mm,
            knots,
            shear_mpa: layer.shear_mpa(),
            poisson: layer.poisson,
            thickness_m: 1e-3 * layer.thickness_mm,
            solver,
            sections: None,
        }
    }

    /// The contact at a penetration (m) above 0.
    fn at(&self, delta_m: f64) -> Knot {
        let part = delta_m / self.deepest_m;
        if part >= 1.0 {
            let end = self.knots[CELL_COUNT];
            let load_n = end.load_n + end.stiffness_n_m * (delta_m - self.deepest_m);
            return Knot { load_n, ..end };
        }
        let place = CELL_COUNT as f64 * part.max(0.0).sqrt();
        let cell = (place as usize).min(CELL_COUNT - 1);
        let (a, b) = (&self.knots[cell], &self.knots[cell + 1]);
        let knot_m = |i: usize| {
            let part = i as f64 / CELL_COUNT as f64;
            self.deepest_m * part * part
        };
        let from_m = knot_m(cell);
        let width_m = knot_m(cell + 1) - from_m;
        let f = (delta_m - from_m) / width_m;
        let g = 1.0 - f;
        // Hermite's cubic and its slope.
        let rise = b.load_n - a.load_n;
        let (from, to) = (width_m * a.stiffness_n_m - rise, width_m * b.stiffness_n_m - rise);
        let load_n = a.load_n + f * rise + f * g * (g * from - f * to);
        let slope = rise + (1.0 - 2.0 * f) * (g * from - f * to) - f * g * (from + to);
        Knot {
            load_n: load_n.max(0.0),
            stiffness_n_m: (slope / width_m).max(0.0),
            radius_m: a.radius_m + (place - cell as f64) * (b.radius_m - a.radius_m),
        }
    }

    /// Evaluates the contact at a relative motion.
    pub(super) fn evaluate(&mut self, motion: &RelativeMotion, relaxation_s: f64) -> ContactLoad {
        let mut sums = ContactLoad::default();
        self.sections = None;
        let centre = motion.place - self.radius_m * motion.turn.z_axis;
        let delta_m = self.radius_m - centre.z;
        // The plane of the face is infinite, the finger is not.
        if !(delta_m > 0.0 && centre.z > 0.0) {
            return sums;
        }
        let at = centre.truncate();
        let knot = self.at(delta_m);
        let width_m = knot.radius_m.max(FADE_HALF_WIDTH_MIN_M);
        let pad = self.pad_half_m;
        let part = |u: f64, half: f64| (0.5 * (half + width_m - u.abs()) / width_m).clamp(0.0, 1.0);
        let cover = part(at.x, pad.x) * part(at.y, pad.y);
        let rate = motion.closing(at.x, at.y);
        let damped_n = knot.load_n + knot.stiffness_n_m * relaxation_s * rate;
        if damped_n <= 0.0 || cover <= 0.0 {
            return sums;
        }
        let weight = cover * knot.stiffness_n_m * (motion.h + relaxation_s);
        sums.add(at.clamp(-pad, pad), cover * damped_n, weight);
        let (g_pa, a_m) = (1e6 * self.shear_mpa, knot.radius_m);
        let thin = PI * a_m * a_m / self.thickness_m;
        sums.shear_n_m = cover * g_pa * (thin + 8.0 * a_m / (2.0 - self.poisson));
        sums.half_width_m = a_m;
        let carried = motion.velocity + motion.spin.cross(centre);
        sums.travel_m_s = DVec3::new(carried.x, carried.y, 0.0).length();
        sums.deepest_m = delta_m;
        self.sections = Some(([1e3 * at.x, 1e3 * at.y], 1e3 * delta_m, damped_n / knot.load_n));
        sums
    }

    /// Adds the stresses of the latest evaluation (MPa).
    pub(super) fn image(&mut self, cells: &mut SquareCells, image: &mut [f64]) {
        let Some((place_mm, delta_mm, damping)) = self.sections else { return };
        let deepest_mm = 1e3 * self.deepest_m;
        let solved = self.solver.press(Prescribed::PenetrationMm(delta_mm.min(deepest_mm)));
        let Ok(state) = solved else { return };
        // Beyond the table the load keeps the distribution of the table's end; so does the viscous
        // part.
        let scale = self.at(1e-3 * delta_mm).load_n / state.force_n * damping.clamp(0.0, 2.0);
        cells.add(image, |array, image| {
            // An array that the solver refuses shows nothing.
            let _ = self.solver.image(array, Sampling::Area, place_mm, image);
        });
        image.iter_mut().for_each(|value| *value *= scale);
    }
}
