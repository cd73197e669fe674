//! What rolling a bar about its own axis does to its pressure: the rate of a contact whose face
//! stays where it is. Across the bar the descent grows with the place, so the pressure's rate is
//! odd; it is the slices' problem with odd cosines for even ones, on the slices that touch.
//!
//! The moment it takes is the statics' own: force times place across, whatever the image says of
//! it. It allocates. It has nothing to say of cylinders, which roll without changing anything, and
//! of bars that do not touch.

use super::super::tactels::Shares;
use super::super::{Drive, Refusal};
use super::couple::{Coupling, Parity};
use super::row::{Row, points_for};
use super::strip::Strips;
use super::work::{Trouble, Work};
use super::{Lie, Pin, Stand};
use core::f64::consts::PI;

/// Tolerance of the solution, in parts of the pressure's work.
const TOLERANCE: f64 = 1e-8;

/// Rate of a bar's pressure per rad of roll that lowers its side towards +u.
#[derive(Clone, Debug)]
pub struct Roll {
    row: Row,
    lie: Lie,
    /// cos(theta), then cos((2 k + 1) theta), point after point.
    rule: Vec<f64>,
}

impl Pin {
    /// The rate of the contact last pressed under a roll; none for a cylinder and without contact.
    ///
    /// # Errors
    /// None is expected after a contact was found.
    pub fn roll(&self) -> Result<Option<Roll>, Refusal> {
        let row = &self.rows[self.at];
        let slices = row.along.len();
        if row.strips.is_free() || !(0..slices).any(|j| row.work.touches(j)) {
            return Ok(None);
        }
        let transfer = row.layer.transfer();
        let (n, half) = (row.strips.places.cosines, row.strips.widest());
        let refused = |trouble: Trouble| trouble.refused(Drive::PenetrationMm(0.0));
        let strips = Strips::odd(&transfer, half, n);
        let strips = strips.ok_or_else(|| refused(Trouble::Indefinite))?;
        let modes = (row.fineness.modes, Parity::Odd);
        let coupling = Coupling::new(&transfer, modes, (n, half), (slices, row.h));
        let mut work = Work::new(slices, &strips, (coupling.transform_len(), 0));
        // The descent b cos(theta) of a unit slope has the one moment b pi/2.
        work.hold(|j| row.work.touches(j).then_some(0.5 * half));
        let mut rate = Row { strips, coupling, work, nested: None, ..row.clone() };
        rate.prepare(true).map_err(refused)?;
        rate.gradients(TOLERANCE).map_err(refused)?;
        let points = points_for(rate.fineness.points, half);
        let mut rule = Vec::with_capacity(points * (n + 1));
        for i in 0..points {
            let angle = PI * (2 * i + 1) as f64 / (4 * points) as f64;
            rule.push(libm::cos(angle));
            rule.extend((0..n).map(|k| libm::cos((2 * k + 1) as f64 * angle)));
        }
        Ok(Some(Roll { row: rate, lie: self.lie(), rule }))
    }
}

impl Roll {
    /// Calls with place (across, along) in mm and force in N per rad of point loads that stand for
    /// the rate.
    pub fn loads(&self, mut of: impl FnMut([f64; 2], f64)) {
        let row = &self.row;
        let t = row.layer.thickness_mm;
        let n = row.strips.places.cosines;
        let points = self.rule.len() / (n + 1);
        let scale = 0.5 * PI * row.modulus_mpa() * t * t * row.h / points as f64;
        for (j, v) in row.along.iter().enumerate() {
            if !row.work.touches(j) {
                continue;
            }
            let (b, a) = row.work.slice(j);
            let v = self.lie.place(v * t);
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
        let row = &self.row;
        let t = row.layer.thickness_mm;
        let scale = 0.5 * PI * row.modulus_mpa() * t * t * t * row.h;
        let slices = (0..row.along.len()).filter(|j| row.work.touches(*j));
        slices.map(|j| row.work.slice(j)).map(|(b, a)| scale * b * a[0]).sum()
    }

    /// Adds the image's rate, MPa per rad; nothing when the stand is not finite.
    pub fn image(&self, shares: &Shares, stand: Stand, image: &mut [f64]) {
        let (s, c) = (libm::sin(stand.rot_rad), libm::cos(stand.rot_rad));
        self.loads(|[u, v], force| {
            shares.add(image, [stand.x_mm + u * c - v * s, stand.y_mm + u * s + v * c], force);
        });
    }
}
