//! The image of a sphere's contact: the base pressure at a place, and its mean over each tactel,
//! computed as the flux through the tactel's edges.

use super::super::super::{Invalid, finite};
use super::super::tactels::{Array, Sampling};
use super::Sphere;

impl Sphere {
    /// Normal stress at the base (MPa, negative) at `r_mm` from the axis.
    #[must_use]
    pub fn base_szz_mpa(&self, r_mm: f64) -> f64 {
        if self.used == 0 { 0.0 } else { -self.pressure(r_mm.abs() / self.layer.thickness_mm) }
    }

    /// Base pressure at a distance from the axis in thicknesses.
    #[inline]
    fn pressure(&self, r: f64) -> f64 {
        self.pieces.as_ref().map_or_else(|| self.tables[1].at(r), |pieces| pieces[0].at(r))
    }

    /// Flux at a distance from the axis up to the table's end.
    #[inline]
    fn flux(&self, r: f64) -> f64 {
        self.pieces.as_ref().map_or_else(|| self.tables[2].at(r), |pieces| pieces[1].at(r))
    }

    /// Writes the image of the sphere with its axis at `place_mm`, row by row (row = y, column = x,
    /// both ascending), stresses in MPa.
    ///
    /// # Errors
    /// An array that [`Array::check`] refuses or an image of another length, a place that is not
    /// finite.
    pub fn image(
        &self,
        array: &Array,
        sampling: Sampling,
        place_mm: [f64; 2],
        image: &mut [f64],
    ) -> Result<(), Invalid> {
        array.check_image(image)?;
        finite("x_mm", place_mm[0])?;
        finite("y_mm", place_mm[1])?;
        image.fill(0.0);
        if self.used == 0 {
            return Ok(());
        }
        let [x0, y0] = place_mm;
        if sampling == Sampling::Centre {
            let over = 1.0 / self.layer.thickness_mm;
            for (row, values) in image.chunks_exact_mut(array.cols).enumerate() {
                let y = over * (array.y_mm(row) - y0);
                for (column, value) in values.iter_mut().enumerate() {
                    let x = over * (array.x_mm(column) - x0);
                    *value = -self.pressure((x * x + y * y).sqrt());
                }
            }
            return Ok(());
        }
        let t = self.layer.thickness_mm;
        let pitch = array.pitch_mm / t;
        let edge = |centre_mm: f64, at_mm: f64| (centre_mm - at_mm) / t - 0.5 * pitch;
        let scale = 1.0 / (pitch * pitch);
        for row in 0..=array.rows {
            let y = edge(array.y_mm(row), y0);
            for column in 0..=array.cols {
                let x = edge(array.x_mm(column), x0);
                // The edge to the right of this corner, and the one above it.
                if column < array.cols {
                    let through = scale * self.through(y, x, pitch);
                    if row > 0 {
                        image[(row - 1) * array.cols + column] -= through;
                    }
                    if row < array.rows {
                        image[row * array.cols + column] += through;
                    }
                }
                if row < array.rows {
                    let through = scale * self.through(x, y, pitch);
                    if column > 0 {
                        image[row * array.cols + column - 1] -= through;
                    }
                    if column < array.cols {
                        image[row * array.cols + column] += through;
                    }
                }
            }
        }
        Ok(())
    }

    /// Flux through the edge from `from` to `from + length` on a line at distance `level`.
    fn through(&self, level: f64, from: f64, length: f64) -> f64 {
        let (end, to) = (self.tables[2].end(), from + length);
        let total = self.total_inside();
        // Beyond the table the whole force lies inside, so the flux is proportional to the angle
        // that the edge subtends at the axis. The table is read between its ends alone, however
        // long the edge is.
        let angle = |y: f64| libm::atan2(y, level.abs());
        let seen = |from: f64, to: f64| {
            if from >= to {
                return 0.0;
            }
            let seen = total * (angle(to) - angle(from));
            if level < 0.0 { -seen } else { seen }
        };
        let reach = (end * end - level * level).max(0.0).sqrt();
        let (low, high) = (from.max(-reach), to.min(reach));
        if low >= high {
            return seen(from, to);
        }
        let panels = libm::ceil((high - low) / self.grid.panel).max(1.0);
        let half = 0.5 * (high - low) / panels;
        let mut sum = 0.0;
        for panel in 0..panels as usize {
            let middle = low + half * (2 * panel + 1) as f64;
            for (g, w) in &self.edge {
                let y = middle + g * half;
                sum += w * self.flux((level * level + y * y).sqrt().min(end));
            }
        }
        seen(from, low) + level * sum * half + seen(high, to)
    }

    /// The flux beyond the table times the square of the distance.
    pub(super) fn total_inside(&self) -> f64 {
        let flux = &self.tables[2];
        let last = flux.last();
        let r = last as f64 / self.grid.per_thickness;
        flux.sample(last) * r * r
    }
}
