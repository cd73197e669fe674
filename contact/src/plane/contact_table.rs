//! The table of all contacts of one flat bar under loads at one height, for many look-ups inside a
//! control period.
//!
//! The stress is proportional to P, and its form depends on Q/P alone, that is on the place of the
//! loads' resultant over half the width, s = 2 Q h/(P W). Up to some s the whole face touches,
//! beyond it one edge is lifted. Each part is smooth and interpolated by cubics, the lifted one
//! over the logarithm of 1 - s. The relative error of the table is 1e-5 (of stresses 2e-5 of the
//! peak). A look-up neither allocates nor panics, and does not depend on earlier ones.
//!
//! The errors are those of the solver, and [`Refusal::OutsideTable`] for bars that stand nearly on
//! their corner.

use super::features::{Moments, moments};
use super::{Contact, Friction, Indenter, Load, Mode, NO_CONTACT, Refusal, Shape, Spectrum};
use crate::Accuracy;
use crate::layer::Layer;
use crate::numeric::interpolation::cubic;
use crate::{Invalid, positive};

/// Cells of the table while the whole face touches, and while an edge is lifted.
const TABLE_CELLS: [usize; 2] = [32, 384];
/// Smallest tabulated distance of the resultant from the corner, as a part of the largest.
const CORNER_DISTANCE_MIN: f64 = 0.02;
/// Halvings by which the first lifted contact is found.
const BISECTION_COUNT: usize = 40;
/// Distance from that contact at which each table begins, on its own side.
const TRANSITION_MARGIN: f64 = 1e-9;
/// Column of the first stress. The columns of a row (mm and N) are descent, slope, the edge that
/// may lift off, the moments 0 to 3, and the stresses.
const FIRST_STRESS_COLUMN: usize = 7;

/// The contacts of a bar, tabulated over the load.
#[derive(Clone, Debug)]
pub struct ContactTable {
    half_mm: f64,
    height_mm: f64,
    /// The resultant's place over half the width at which an edge lifts off.
    lift_off: f64,
    /// Rows per unit load while the whole face touches, and while the left edge is lifted.
    rows: [Vec<f64>; 2],
    points: usize,
    width: usize,
    /// Place of the last contact (which table, first row, weights) and the values read there.
    place: (usize, usize, [f64; 4]),
    read: [f64; FIRST_STRESS_COLUMN],
    contact: Contact,
}

impl ContactTable {
    /// Solves the contacts of a bar (some tenths of a second) with their base stress at `x_mm`;
    /// allocates.
    ///
    /// # Errors
    /// A layer or sizes that their checks refuse; a height of 0, at which nothing tilts; places
    /// that are not finite.
    pub fn new(
        layer: &Layer,
        width_mm: f64,
        height_mm: f64,
        friction: Friction,
        x_mm: &[f64],
    ) -> Result<Self, Invalid> {
        positive("height_mm", height_mm)?;
        for x in x_mm {
            crate::finite("x_mm", *x)?;
        }
        let shape = Shape::Flat { width_mm, height_mm };
        let solver = Indenter::new(layer, shape, friction, Accuracy::Fine)?;
        let half_mm = 0.5 * width_mm;
        let reach = x_mm.iter().fold(half_mm, |most, x| most.max(x.abs()));
        let mut builder = TableBuilder { solver, half_mm, height_mm, reach, x_mm };
        let lift_off = builder.lift_off_resultant()?;
        let width = FIRST_STRESS_COLUMN + 2 * x_mm.len();
        let mut rows = [Vec::new(), Vec::new()];
        for i in 0..=TABLE_CELLS[0] {
            let s = lift_off * (1.0 - TRANSITION_MARGIN) * i as f64 / TABLE_CELLS[0] as f64;
            builder.push(s, &mut rows[0])?;
        }
        for i in 0..=TABLE_CELLS[1] {
            let part = i as f64 / TABLE_CELLS[1] as f64;
            let left = (1.0 - lift_off)
                * (1.0 - TRANSITION_MARGIN)
                * libm::exp(part * libm::log(CORNER_DISTANCE_MIN));
            builder.push(1.0 - left, &mut rows[1])?;
        }
        Ok(Self {
            half_mm,
            height_mm,
            lift_off,
            rows,
            points: x_mm.len(),
            width,
            place: (0, 0, [0.0; 4]),
            read: [0.0; FIRST_STRESS_COLUMN],
            contact: NO_CONTACT,
        })
    }

    /// The contact under a load.
    ///
    /// # Errors
    /// See [`Refusal`]; the contact is then that of no load.
    pub fn press(&mut self, load: &Load) -> Result<Contact, Refusal> {
        self.contact = NO_CONTACT;
        let Load { p_n_mm: p, q_n_mm: q } = *load;
        if !load.is_pressing()? {
            return Ok(NO_CONTACT);
        }
        let s = (q / p * self.height_mm / self.half_mm).abs();
        if s >= 1.0 {
            return Err(Refusal::Toppling);
        }
        let (part, place) = if s <= self.lift_off {
            (0, s / self.lift_off)
        } else {
            let left = (1.0 - s) / (1.0 - self.lift_off);
            if left < CORNER_DISTANCE_MIN {
                return Err(Refusal::OutsideTable);
            }
            (1, libm::log(left) / libm::log(CORNER_DISTANCE_MIN))
        };
        let (first, weights) = rows_and_weights(TABLE_CELLS[part], place);
        self.place = (part, first, weights);
        let mut read = [0.0; FIRST_STRESS_COLUMN];
        self.gather(0, &mut read);
        self.read = read;
        let sign = if q < 0.0 { -1.0 } else { 1.0 };
        let free = read[2].clamp(-self.half_mm, self.half_mm);
        let (x_left_mm, x_right_mm, mode) = match (part, q < 0.0) {
            (0, _) => (-self.half_mm, self.half_mm, Mode::Full),
            (_, false) => (free, self.half_mm, Mode::LeftLifted),
            (_, true) => (-self.half_mm, -free, Mode::RightLifted),
        };
        self.contact = Contact {
            p_n_mm: p,
            q_n_mm: q,
            delta_mm: p * read[0],
            slope: sign * p * read[1],
            x_left_mm,
            x_right_mm,
            mode,
            residual: 0.0,
        };
        Ok(self.contact)
    }

    /// Moments of the base stress of the last contact over the infinite layer.
    #[must_use]
    pub fn moments(&self) -> Moments {
        let (p, sign) = (self.contact.p_n_mm, self.sign());
        let m = [0, 1, 2, 3].map(|k| p * self.read[3 + k] * if k % 2 == 1 { sign } else { 1.0 });
        Moments { m }
    }

    /// Writes the base stress (MPa) of the last contact at the table's places; nothing unless there
    /// is one value a place.
    pub fn base_szz_mpa(&self, out: &mut [f64]) {
        if out.len() != self.points {
            return;
        }
        self.gather(FIRST_STRESS_COLUMN + if self.sign() < 0.0 { self.points } else { 0 }, out);
        out.iter_mut().for_each(|value| *value *= self.contact.p_n_mm);
    }

    /// Columns from `column` on, per unit load, at the place of the last contact.
    fn gather(&self, column: usize, out: &mut [f64]) {
        let (part, first, w) = self.place;
        let count = out.len();
        let row = |k: usize| &self.rows[part][(first + k) * self.width + column..][..count];
        let (pairs, more) = (row(0).iter().zip(row(1)), row(2).iter().zip(row(3)));
        for (value, ((a, b), (c, d))) in out.iter_mut().zip(pairs.zip(more)) {
            *value = (w[0] * a + w[1] * b) + (w[2] * c + w[3] * d);
        }
    }

    fn sign(&self) -> f64 {
        if self.contact.q_n_mm < 0.0 { -1.0 } else { 1.0 }
    }
}

/// First row and weights of the cubic through the four rows nearest to a part of the way along a
/// table of `cells` cells.
fn rows_and_weights(cells: usize, part: f64) -> (usize, [f64; 4]) {
    let place = part.clamp(0.0, 1.0) * cells as f64;
    let first = (place as usize).clamp(1, cells - 2) - 1;
    (first, cubic(place - (first + 1) as f64))
}

/// Computes the rows of the table.
struct TableBuilder<'a> {
    solver: Indenter,
    half_mm: f64,
    height_mm: f64,
    reach: f64,
    x_mm: &'a [f64],
}

impl TableBuilder<'_> {
    fn contact(&mut self, s: f64) -> Result<Contact, Invalid> {
        let q_n_mm = s * self.half_mm / self.height_mm;
        self.solver.press(&Load { p_n_mm: 1.0, q_n_mm }).map_err(|refusal| {
            let what = format!("no contact at {s} of the way to the corner: {refusal}");
            let remedy = "give a bar nearer to the layer's thickness, or more height";
            Invalid::new("width_mm", what, remedy)
        })
    }

    /// The place of the resultant at which an edge lifts off.
    fn lift_off_resultant(&mut self) -> Result<f64, Invalid> {
        let (mut low, mut high) = (0.0, 1.0 - 1e-3);
        for _ in 0..BISECTION_COUNT {
            let middle = 0.5 * (low + high);
            if self.contact(middle)?.mode == Mode::Full { low = middle } else { high = middle }
        }
        Ok(0.5 * (low + high))
    }

    fn push(&mut self, s: f64, rows: &mut Vec<f64>) -> Result<(), Invalid> {
        let contact = self.contact(s)?;
        let layer = *self.solver.layer();
        let depth = layer.thickness_mm;
        let forces = self.solver.point_forces(depth);
        rows.extend([contact.delta_mm, contact.slope, contact.x_left_mm]);
        rows.extend(moments(&layer, &forces, depth).m);
        let stress = Spectrum::new(&layer, &forces, depth, self.reach);
        rows.extend(self.x_mm.iter().map(|x| stress.szz(*x)));
        rows.extend(self.x_mm.iter().map(|x| stress.szz(-x)));
        Ok(())
    }
}
