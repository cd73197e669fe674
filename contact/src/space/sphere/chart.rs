//! The contacts of one sphere, tabulated over the square root of the penetration: force, contact
//! radius, stiffness, and base pressure and flux over the distance from the axis, solved for a grid
//! of that root when the chart is made and read with six neighbours afterwards. A contact of a
//! given depth or force then costs a sum of six rows and no solution of equations, whatever the
//! contact before. Each quantity is stored relative to its law at the lightest contact (Hertz's),
//! so that the chart is valid down to no contact.
//!
//! The chart covers contacts up to a radius of [`RADIUS_MAX`] thicknesses; for larger ones it
//! returns nothing, and the caller solves the contact.

use super::{Prescribed, RULE_POINTS, Refusal, Sphere, rule_for};
use crate::numeric::interpolation::Stencil;
use core::f64::consts::PI;

/// Largest contact radius of a chart, in thicknesses.
const RADIUS_MAX: f64 = 16.0;
/// Steps of the root of the penetration over which the contact radius grows by a thickness.
const STEPS_PER_THICKNESS: f64 = 6.0;
/// Fewest steps: the interpolation needs its neighbours.
const STEPS_MIN: usize = 16;
/// Deepest penetration of a chart, in thicknesses.
const DEPTH_MAX: f64 = 0.5;
/// Newton's steps for the depth of a force.
const NEWTON_STEPS_MAX: usize = 20;

/// One sphere's contacts; lengths in thicknesses, forces in G/(1 - nu) thickness^2.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    /// Root of the deepest penetration.
    end: f64,
    /// Force over u^3, contact radius and stiffness over u, u the root of the penetration.
    force: Vec<f64>,
    radius: Vec<f64>,
    stiffness: Vec<f64>,
    /// Base pressure and flux for a unit of force, a row a step.
    rows: [Vec<f64>; 2],
    /// Length of a row.
    width: usize,
    /// Largest difference to a solved force half way between steps.
    residual: f64,
}

/// A contact of the chart.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChartContact {
    /// Root of the penetration.
    pub(super) root: f64,
    pub(super) force: f64,
    pub(super) radius: f64,
    pub(super) residual: f64,
}

impl Chart {
    /// Solves the contacts; leaves the sphere without contact.
    ///
    /// # Errors
    /// As [`Sphere::press`]; none is expected within the chart's bounds.
    pub(super) fn new(sphere: &mut Sphere) -> Result<Self, Refusal> {
        let radius = sphere.radius_mm / sphere.layer.thickness_mm;
        let [deepest, widest] = Self::largest(sphere)?;
        let count = (libm::ceil(STEPS_PER_THICKNESS * widest) as usize).max(STEPS_MIN);
        let end = deepest.sqrt();
        let width = sphere.grid.count(widest) + 1;
        let mut chart = Self {
            end,
            force: vec![8.0 / 3.0 * radius.sqrt(); count + 1],
            radius: vec![radius.sqrt(); count + 1],
            stiffness: vec![4.0 * radius.sqrt(); count + 1],
            rows: [vec![0.0; (count + 1) * width], vec![0.0; (count + 1) * width]],
            width,
            residual: 0.0,
        };
        for i in (1..=count).rev() {
            let u = chart.root(i as f64);
            let [force, a, stiffness] = chart.solve_contact(sphere, u * u)?;
            (chart.force[i], chart.radius[i], chart.stiffness[i]) =
                (force / (u * u * u), a / u, stiffness / u);
            chart.store_fields(sphere, i, force);
        }
        sphere.set_point_contact();
        chart.store_fields(sphere, 0, 2.0 * PI);
        for i in [0, 1, 2, count / 2, count - 1] {
            let u = chart.root(i as f64 + 0.5);
            let [force, ..] = chart.solve_contact(sphere, u * u)?;
            chart.residual = chart.residual.max((chart.force_at(u) / force - 1.0).abs());
        }
        sphere.release();
        Ok(chart)
    }

    /// Penetration and radius of the chart's largest contact.
    fn largest(sphere: &mut Sphere) -> Result<[f64; 2], Refusal> {
        let bound = RADIUS_MAX.min(0.999 * sphere.widest());
        if let Some(solve_contact) = sphere
            .solve(bound, rule_for(bound, RULE_POINTS))
            .filter(|solve_contact| solve_contact.delta < DEPTH_MAX)
        {
            return Ok([solve_contact.delta, bound]);
        }
        let t = sphere.layer.thickness_mm;
        sphere.press_solved(Prescribed::PenetrationMm(DEPTH_MAX * t))?;
        Ok([DEPTH_MAX, sphere.state.contact_radius_mm / t])
    }

    /// Stores the fields of the sphere's contact as those of step `i`.
    fn store_fields(&mut self, sphere: &Sphere, i: usize, force: f64) {
        for place in 0..self.width {
            for (row, field) in self.rows.iter_mut().zip(sphere.fields(place)) {
                row[i * self.width + place] = field / force;
            }
        }
    }

    /// Force, contact radius and stiffness of a contact that is solved.
    fn solve_contact(&self, sphere: &mut Sphere, delta: f64) -> Result<[f64; 3], Refusal> {
        let t = sphere.layer.thickness_mm;
        let stiffness = sphere.press_solved(Prescribed::PenetrationMm(delta * t))?;
        let force = sphere.state.force_n / (sphere.modulus() * t * t);
        Ok([force, sphere.state.contact_radius_mm / t, stiffness])
    }

    /// The contact at a penetration above 0; absent beyond the chart.
    pub(super) fn at_depth(&self, delta: f64) -> Option<ChartContact> {
        let root = delta.sqrt();
        (root <= self.end).then(|| self.contact(root))
    }

    /// The contact under a force above 0; absent beyond the chart.
    pub(super) fn under_force(&self, force: f64) -> Option<ChartContact> {
        let end = self.end;
        if force.is_nan() || force > self.force_at(end) {
            return None;
        }
        let mut root = libm::cbrt(force / self.force[0]).min(end);
        for _ in 0..NEWTON_STEPS_MAX {
            let at = self.stencil(root);
            let slope = 2.0 * root * root * at.of(&self.stiffness);
            let miss = root * root * root * at.of(&self.force) - force;
            let next = (root - miss / slope).clamp(0.5 * root, end);
            let change = (next - root).abs();
            root = next;
            if change <= 1e-14 * root {
                break;
            }
        }
        Some(ChartContact { force, ..self.contact(root) })
    }

    /// Root of the penetration at a place of the chart, in steps. The steps are three times as long
    /// at the end as at the beginning, where the effect of the layer's base sets in.
    fn root(&self, place: f64) -> f64 {
        let part = place / (self.force.len() - 1) as f64;
        0.5 * self.end * part * (1.0 + part)
    }

    fn stencil(&self, root: f64) -> Stencil {
        let part = 0.5 * ((1.0 + 8.0 * root / self.end).sqrt() - 1.0);
        Stencil::new(self.force.len(), part * (self.force.len() - 1) as f64 - 2.0)
    }

    fn force_at(&self, root: f64) -> f64 {
        root * root * root * self.stencil(root).of(&self.force)
    }

    fn contact(&self, root: f64) -> ChartContact {
        ChartContact {
            root,
            force: self.force_at(root),
            radius: root * self.stencil(root).of(&self.radius),
            residual: self.residual,
        }
    }

    /// Base pressure (0) or flux (1) of a contact at a place outwards from the axis, as many as a
    /// row holds.
    pub(super) fn field(&self, contact: &ChartContact, which: usize) -> impl Fn(usize) -> f64 {
        let at = self.stencil(contact.root);
        let weights = at.weights().map(|weight| weight * contact.force);
        let rows = [0, 1, 2, 3, 4, 5].map(|k| {
            let start = (at.first() + k) * self.width;
            &self.rows[which][start..start + self.width]
        });
        move |place| rows.iter().zip(&weights).map(|(row, weight)| weight * row[place]).sum()
    }
}
