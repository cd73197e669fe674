//! The tactels of an array as the solver in three dimensions divides them. It knows square tactels
//! only: tactels of two pitches are divided into whole numbers of smaller squares, over which their
//! stress is averaged. Pitches that no few squares fit are refused.

use taktil_contact::space::tactels::Array;

use crate::geometry::ArrayGeometry;
use crate::scene::{Invalid, invalid};

/// Most squares along one side of a tactel.
const DIVISIONS_MAX: usize = 6;
/// Relative difference below which two lengths are the same.
const LENGTH_TOLERANCE: f64 = 1e-9;

/// An array with the squares that its tactels consist of.
#[derive(Clone, Debug)]
pub(crate) struct SquareCells {
    array: Array,
    /// Number of squares along x and along y in each tactel.
    per_x: usize,
    per_y: usize,
    /// Room for the stresses of the squares (MPa); empty where each tactel is one square.
    cells_mpa: Box<[f64]>,
}

impl SquareCells {
    /// Divides the tactels of an array; `place` is the array's place in the scene. Allocates.
    ///
    /// # Errors
    /// Pitches that are not in a ratio of whole numbers up to [`DIVISIONS_MAX`].
    pub(crate) fn new(geometry: &ArrayGeometry, place: &str) -> Result<SquareCells, Invalid> {
        let ArrayGeometry { rows, cols, pitch_x_m, pitch_y_m } = *geometry;
        // The number of squares along y that are as long as those of so many along x.
        let per_y = |per_x: usize| {
            let side_m = pitch_x_m / per_x as f64;
            let fits = |per_y: &usize| {
                (side_m - pitch_y_m / *per_y as f64).abs() <= LENGTH_TOLERANCE * side_m
            };
            (1..=DIVISIONS_MAX).find(fits).map(|per_y| (per_x, per_y))
        };
        let Some((per_x, per_y)) = (1..=DIVISIONS_MAX).find_map(per_y) else {
            let (x, y) = (1e3 * pitch_x_m, 1e3 * pitch_y_m);
            let what = format!("is {y}, which is in no simple ratio to pitch_x_mm = {x}");
            let remedy = format!(
                "contacts in three dimensions and objects need pitches in a ratio of whole numbers \
                 up to {DIVISIONS_MAX}: change one, or roll a pin with fidelity.contact = \"line\" \
                 or \"layer-2d\""
            );
            return Err(invalid(&format!("{place}.pitch_y_mm"), what, &remedy));
        };
        let pitch_mm = 1e3 * pitch_x_m / per_x as f64;
        let array = Array { rows: rows * per_y, cols: cols * per_x, pitch_mm };
        let cells = if (per_x, per_y) == (1, 1) { 0 } else { array.len() };
        Ok(SquareCells { array, per_x, per_y, cells_mpa: vec![0.0; cells].into() })
    }

    /// The array of squares.
    pub(crate) fn array(&self) -> &Array {
        &self.array
    }

    /// Adds the stresses that `add` adds to the squares to those of the tactels (MPa).
    pub(crate) fn add(&mut self, tactels_mpa: &mut [f64], add: impl FnOnce(&Array, &mut [f64])) {
        if self.cells_mpa.is_empty() {
            add(&self.array, tactels_mpa);
            return;
        }
        self.cells_mpa.fill(0.0);
        add(&self.array, &mut self.cells_mpa);
        let (cells_of_row, cols) = (self.array.cols, self.array.cols / self.per_x);
        let share = 1.0 / (self.per_x * self.per_y) as f64;
        for (index, row) in self.cells_mpa.chunks_exact(cells_of_row).enumerate() {
            let from = index / self.per_y * cols;
            let cells = row.chunks_exact(self.per_x);
            for (tactel, cells) in tactels_mpa[from..].iter_mut().zip(cells) {
                *tactel += share * cells.iter().sum::<f64>();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geometry(pitch_x_m: f64, pitch_y_m: f64) -> ArrayGeometry {
        ArrayGeometry { rows: 2, cols: 3, pitch_x_m, pitch_y_m }
    }

    #[test]
    fn tactels_are_divided_into_as_few_squares_as_fit() {
        let cells = |x, y| {
            let cells = SquareCells::new(&geometry(x, y), "tactile").unwrap();
            (cells.per_x, cells.per_y, cells.array.rows, cells.array.cols)
        };
        assert_eq!(cells(2e-3, 2e-3), (1, 1, 2, 3));
        assert_eq!(cells(2e-3, 4e-3), (1, 2, 4, 3));
        assert_eq!(cells(3e-3, 2e-3), (3, 2, 4, 9));
        let refused = SquareCells::new(&geometry(2e-3, 1.7e-3), "tactile").unwrap_err();
        assert!(refused.place == "tactile.pitch_y_mm", "{refused}");
    }

    #[test]
    fn a_tactel_carries_the_mean_of_its_squares() {
        let mut cells = SquareCells::new(&geometry(3e-3, 2e-3), "tactile").unwrap();
        let mut tactels = [1.0; 6];
        cells.add(&mut tactels, |array, image| {
            for (i, stress) in image.iter_mut().enumerate() {
                let (row, col) = (i / array.cols, i % array.cols);
                *stress = (10 * (row / 2) + col / 3) as f64 + [-0.5, 0.0, 0.5][col % 3];
            }
        });
        let wanted = [1.0, 2.0, 3.0, 11.0, 12.0, 13.0];
        assert!(tactels.iter().zip(wanted).all(|(t, w)| (t - w).abs() < 1e-12), "{tactels:?}");
    }
}
