//! The rate of a bar's pressure when the bar rolls about its own axis while its face stays in
//! place. The displacement is proportional to the place across the bar, so the rate of the pressure
//! is odd across it. It solves the same problem of coupled slices with odd instead of even cosines,
//! on the slices in contact.
//!
//! The moment of the roll is computed from the pressure (force times place across the bar) and not
//! from the image. There is no rate for a cylinder, whose contact does not change when it rolls,
//! and for a bar without contact. Solving allocates.

use super::super::tactels::Shares;
use super::super::{Prescribed, Refusal};
use super::coupling::{CoupledSlices, Coupling, Parity};
use super::failure::SolveFailure;
use super::linear::LinearSolver;
use super::point_rule::points_for;
use super::pose::{PlanarPose, RowOrientation};
use super::row::SliceRow;
use super::solver::Pin;
use super::state::ContactState;
use super::strip::StripTable;
use core::f64::consts::PI;

/// Tolerance of the gradients, in parts of the pressure's work.
const GRADIENT_TOLERANCE: f64 = 1e-8;

/// Rate of a bar's pressure per rad of roll that lowers its side towards +u.
#[derive(Clone, Debug)]
pub struct Roll {
    row: SliceRow,
    state: ContactState,
    orientation: RowOrientation,
    /// cos(theta), then cos((2 k + 1) theta), point after point.
    rule: Vec<f64>,
}

impl Pin {
    /// The rate of the contact last pressed under a roll; none for a cylinder and without contact.
    /// Allocates.
    ///
    /// # Errors
    /// None is expected after a contact was found.
    pub fn roll(&self) -> Result<Option<Roll>, Refusal> {
        let (row, contact) = (&self.used_row().row, &self.used_row().state);
        let slices = row.along.len();
        if row.strips.is_free() || !(0..slices).any(|j| contact.touches(j)) {
            return Ok(None);
        }
        let transfer = row.layer.transfer();
        let (n, half) = (row.strips.layout.cosines, row.strips.widest());
        let refused = |failure: SolveFailure| failure.refusal(Prescribed::PenetrationMm(0.0));
        let strips = StripTable::odd(&transfer, half, n);
        let strips = strips.ok_or_else(|| refused(SolveFailure::Indefinite))?;
        let sizes = CoupledSlices { cosines: n, widest: half, slices, h: row.h };
        let coupling = Coupling::new(&transfer, row.resolution.modes, Parity::Odd, sizes);
        let mut state = ContactState::new(slices, &strips, coupling.transform_len());
        // The displacement b cos(theta) of a unit slope has the one moment b pi/2.
        state.prescribe(|j| contact.touches(j).then_some(0.5 * half));
        let row = SliceRow { strips, coupling, dense_unknowns: 0, ..row.clone() };
        let mut linear = LinearSolver::new(&row, 0);
        state.update_slices(&row, true).map_err(refused)?;
        let sums = &mut linear.sums;
        linear.gradients.solve(&row, &mut state, sums, GRADIENT_TOLERANCE).map_err(refused)?;
        let points = points_for(row.resolution.points, half);
        let mut rule = Vec::with_capacity(points * (n + 1));
        for i in 0..points {
            let angle = PI * (2 * i + 1) as f64 / (4 * points) as f64;
            rule.push(libm::cos(angle));
            rule.extend((0..n).map(|k| libm::cos((2 * k + 1) as f64 * angle)));
        }
        Ok(Some(Roll { row, state, orientation: self.orientation(), rule }))
    }
}

impl Roll {
    /// Calls with place (across, along) in mm and force in N per rad of point loads that stand for
    /// the rate.
    pub fn loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let (row, state) = (&self.row, &self.state);
        let t = row.layer.thickness_mm;
        let n = row.strips.layout.cosines;
        let points = self.rule.len() / (n + 1);
        let scale = 0.5 * PI * row.modulus_mpa() * t * t * row.h / points as f64;
        for (j, v) in row.along.iter().enumerate() {
            if !state.touches(j) {
                continue;
            }
            let (b, a) = state.slice(j);
            let v = self.orientation.along_pin(v * t);
            for point in self.rule.chunks_exact(n + 1) {
                let psi: f64 = point[1..].iter().zip(a).map(|(x, y)| x * y).sum();
                let (u, force) = (b * point[0] * t, scale * psi);
                of([u, v], force);
                of([-u, v], -force);
            }
        }
    }

    /// Moment of the rate about the bar's axis, force times place across: N mm per rad.
    #[must_use]
    pub fn moment_n_mm(&self) -> f64 {
        let (row, state) = (&self.row, &self.state);
        let t = row.layer.thickness_mm;
        let scale = 0.5 * PI * row.modulus_mpa() * t * t * t * row.h;
        let slices = (0..row.along.len()).filter(|j| state.touches(*j));
        slices.map(|j| state.slice(j)).map(|(b, a)| scale * b * a[0]).sum()
    }

    /// Adds the image's rate, MPa per rad; nothing when the pose is not finite.
    pub fn image(&self, shares: &Shares, pose: PlanarPose, image: &mut [f64]) {
        let (s, c) = (libm::sin(pose.rot_rad), libm::cos(pose.rot_rad));
        self.loads(|[u, v], force| {
            shares.add(image, [pose.x_mm + u * c - v * s, pose.y_mm + u * s + v * c], force);
        });
    }
}
